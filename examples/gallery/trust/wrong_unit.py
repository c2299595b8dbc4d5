"""
Wrong record: g taken for m/s²
==============================

One accelerometer was calibrated in g, its column says m/s². A factor of 9.81 in one channel pulls masses and
stiffnesses astray, and no single number of the fit shows why. One learns to let gains of channels be unknown with a
prior where calibration is in doubt, and to read what comes out.
"""

import numpy as np

import structid as sid


def beam(stiffness):
    """A cantilever of four elements."""
    elements = sid.Beam("beam", [[i, i + 1] for i in range(4)], 2.0, stiffness, loss_factor=0.01)
    return sid.Structure({i: 0.25 * i for i in range(5)}, [elements], ["0Y", "0RZ"])


truth, model = beam(80.0), beam(70.0)
lines = np.arange(2.0, 120.0, 0.5)
like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("1Y", "3Y", "4Y"), ("4Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(2))
in_g = record.values * np.array([1.0, 1 / 9.80665, 1.0])[:, None]
wrong = sid.with_declared_noise(sid.FrfRecord(lines, in_g, record.outputs, record.inputs, "accelerance"), 0.01)

# %%
# As it is
# --------
unknown = sid.parameters(model, [sid.Unknown("bending_stiffness", "beam"), sid.Unknown("mass", "beam")])
found = sid.identify(model, unknown, wrong)
print(found.estimate)
figure = found.plot_frf("3Y")

# %%
# With the gains of all sensors unknown, their mean held by the calibration of the others
# ----------------------------------------------------------------------------------------
gains = [
    sid.ChannelUnknown("gain", "3Y"),
    sid.ChannelUnknown("gain", ["1Y", "4Y"], each=True, prior=sid.Prior(1.0, 0.01)),
]
found = sid.identify(model, unknown, wrong, channel_unknowns=gains)
print(found.estimate)

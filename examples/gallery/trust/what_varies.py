"""
What differs from record to record
==================================

Eight set-ups, and each time the clamp was tightened a little differently. One value for all is a wrong model;
``varies=True`` gives each record its own, drawn about a common one by a scatter that the data choose. One learns that
the common value then has an honest interval, and which record stands out.
"""

import numpy as np

import structid as sid


def beam(clamp):
    """A strip on a turning clamp."""
    parts = [
        sid.Beam("strip", [[i, i + 1] for i in range(4)], 1.0, 40.0, loss_factor=0.01),
        sid.Spring("clamp", "0RZ", stiffness=clamp, loss_factor=0.02),
    ]
    return sid.Structure({i: 0.2 * i for i in range(5)}, parts, ["0Y"])


rng = np.random.default_rng(8)
lines = np.arange(2.0, 60.0, 0.5)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("2Y", "4Y"), ("2Y",), "accelerance")
clamps = 500.0 * np.exp(0.08 * rng.standard_normal(8))
model = beam(400.0)
stiffness = sid.Unknown("bending_stiffness", "strip")
setups = []
for clamp in clamps:
    truth = beam(clamp)
    record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.02, rng)
    unknown = sid.parameters(model, [stiffness, sid.Unknown("stiffness", "clamp", varies=True)])
    setups.append(sid.Setup(model, unknown, record))

# %%
# The answer
# ----------
found = sid.identify_together(setups)
print(found.estimate)
print("the clamps truly have", np.round(clamps))
for one in found.priors.varied:
    print(one.words)
figure = found.plot_parameters()

"""
What is known before: priors
============================

Modes or an uncalibrated sensor leave a common scale of masses and stiffnesses free. A weighed mass with its
tolerance, as a prior, fixes it, and the answer says how much of each interval the prior gave. One learns the
difference between fixing a value and knowing it to 2 %.
"""

import numpy as np

import structid as sid


def chain(stiffness):
    """Three masses on springs."""
    spring = sid.Spring("spring", ["0X", "1X", "2X"], ["1X", "2X", "3X"], stiffness=stiffness, loss_factor=0.02)
    parts = [sid.PointMass("mass", [1, 2, 3], [2.0, 3.0, 1.0]), spring]
    return sid.Structure({i: float(i) for i in range(4)}, parts, ["0X"], active=["X"])


truth, model = chain(1000.0), chain(900.0)
lines = np.arange(0.5, 12.0, 0.05)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("1X", "3X"), ("3X",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(1))
gain = [sid.ChannelUnknown("gain", "all", name="sensors")]

# %%
# Without a prior the scale is free
# ---------------------------------
stiffness = sid.Unknown("stiffness", "spring", each=True)
free = sid.parameters(model, [sid.Unknown("mass", "mass", each=True), stiffness])
found = sid.identify(model, free, record, channel_unknowns=gain)
print("status:", found.estimate.status.value)

# %%
# With the second mass weighed to 2 %
# -----------------------------------
masses = [sid.Unknown("mass", f"mass:{i}", prior=sid.Prior(3.0, 0.06) if i == 2 else None) for i in (1, 2, 3)]
found = sid.identify(model, sid.parameters(model, [*masses, stiffness]), record, channel_unknowns=gain)
print(found.estimate)
for name, share in zip(found.estimate.names, found.priors.variance_fraction, strict=True):
    print(f"{name}: {100 * share:.1f} % of the variance stems from the prior")
figure = found.plot_correlation()

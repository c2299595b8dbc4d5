"""
A parameter at its bound
========================

A stiffness was given bounds, and the truth lies outside. The answer says that the parameter is at its bound and how
hard the data push, in standard deviations. One learns to doubt the bound or the model instead of reading the value.
"""

import numpy as np

import structid as sid


def chain(stiffness):
    """Three masses on springs."""
    spring = sid.Spring("spring", ["0X", "1X", "2X"], ["1X", "2X", "3X"], stiffness=stiffness, loss_factor=0.02)
    parts = [sid.PointMass("mass", [1, 2, 3], [2.0, 3.0, 1.0]), spring]
    return sid.Structure({i: float(i) for i in range(4)}, parts, ["0X"], active=["X"])


truth, model = chain([1000.0, 800.0, 1000.0]), chain(1000.0)
lines = np.arange(0.5, 12.0, 0.05)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("1X", "3X"), ("3X",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(1))

# %%
# The second spring is said to have 900 N/m at least
# --------------------------------------------------
bounds = {1: None, 2: (900.0, 1200.0), 3: None}
unknown = [sid.Unknown("stiffness", f"spring:{i}", bounds=bound) for i, bound in bounds.items()]
found = sid.identify(model, sid.parameters(model, unknown), record)
print(found.estimate)
for one in found.estimate.spread.at_bound:
    print(found.estimate.names[one.index], "is at its", one.side, "bound; the data push by", round(one.push, 1), "std")
figure = found.plot_frf()

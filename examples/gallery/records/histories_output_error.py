"""
Histories: output error, from a start that is not at rest
=========================================================

The motion of three masses is measured in three quantities at once, acceleration, velocity and displacement, and the
record begins in the middle of a motion. ``method="output_error"`` fits the histories sample by sample with the state
at the first sample unknown. One learns that twelve seconds of a short record tell every mass, spring and damper.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid

parts = [
    sid.PointMass("mass", [1, 2, 3], [1.8, 1.2, 1.5]),
    sid.Spring("spring", ["0X", "1X", "2X"], ["1X", "2X", "3X"], stiffness=[60.0, 90.0, 70.0]),
    sid.Dashpot("damper", ["0X", "1X", "2X"], ["1X", "2X", "3X"], viscous_damping=[0.5, 0.8, 0.6]),
]
structure = sid.Structure({i: float(i) for i in range(4)}, parts, ["0X"], active=["X"])
properties = (("mass", "mass"), ("stiffness", "spring"), ("viscous_damping", "damper"))
truth = sid.parameters(structure, [sid.Unknown(p, e, each=True) for p, e in properties])

# %%
# The record: 240 samples, 2 % noise of each channel.
rng = np.random.default_rng(2)
options = sid.TimeOptions(initial="unknown")
channels, kinds = ("1X", "2X", "3X", "1X"), ("acceleration", "velocity", "displacement", "force")
blank = sid.TimeRecord(20.0, np.column_stack([np.zeros((240, 3)), rng.standard_normal(240)]), channels, kinds)
state = np.array([0.1, -0.2, 0.3, 1.0, 0.0, -0.5])
clean = sid.simulated_time_record(structure, truth, blank, options, initial=state).values
error = 0.02 * clean.std(axis=0) * [1, 1, 1, 0]
record = sid.TimeRecord(20.0, clean + error * rng.standard_normal(clean.shape), channels, kinds, error**2)

# %%
# The answer
# ----------
start = truth.started_at(truth.start * np.exp(0.2 * rng.standard_normal(truth.n_params)))
found = sid.identify_time(structure, start, record, options)
print(found)

# %%
# Found over true, with 95 %:
figure = Figure(figsize=(7, 3), layout="constrained")
axes = figure.subplots()
axes.errorbar(found.names, found.values / truth.start, 1.96 * found.std / truth.start, fmt="o", capsize=3)
axes.axhline(1.0, color="black", lw=0.8)
axes.tick_params(axis="x", rotation=45)
axes.set_ylabel("found over true, 95 %")

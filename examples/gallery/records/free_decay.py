"""
Modes of a free decay
=====================

A beam is let go and rings down; three accelerometers listen. The default method ends free decays with maximum
likelihood on all samples, so that the damping ratio has a standard deviation of parts of a per cent. One learns to
read which modes a decay tells well, and which it hardly holds.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid

rng = np.random.default_rng(7)
time = np.arange(0, 12, 1 / 200)
frequency, ratio = np.array([3.2, 9.1, 18.4]), np.array([0.006, 0.009, 0.012])
shapes = np.array([[0.4, 1.0, 1.0], [0.8, 0.3, -0.9], [1.0, -0.9, 0.5]])
omega = 2 * np.pi * frequency
decay = np.exp(-np.outer(time, ratio * omega)) * np.cos(np.outer(time, omega * np.sqrt(1 - ratio**2)))
values = decay * [1.0, 0.4, 0.1] @ shapes.T
values = values + 0.01 * values.std(axis=0) * rng.standard_normal(values.shape)
record = sid.TimeRecord(200.0, values, ("1Y", "2Y", "3Y"), ("acceleration",) * 3)

# %%
# The modes
# ---------
modes = sid.identify_modes(record)
modes

# %%
# How far from the truth, in standard deviations:
std = np.sqrt(np.diag(modes.covariance))
errors = (np.concatenate([modes.frequency[:3], modes.damping_ratio[:3]]) - np.concatenate([frequency, ratio])) / (
    np.concatenate([std[:3], std[len(modes.frequency) :][:3]])
)
print(np.round(errors, 2))

# %%
# The shapes at the three sensors:
figure = Figure(figsize=(7, 3), layout="constrained")
axes = figure.subplots()
for k in range(3):
    axes.errorbar(
        [1, 2, 3], modes.mode_shapes[:, k].real, 2 * modes.shape_std[:, k], marker="o", capsize=3, label=f"mode {k + 1}"
    )
axes.set_xticks([1, 2, 3])
axes.set_xlabel("sensor")
axes.set_ylabel("shape, ± 2 std")
axes.legend(frameon=False)

"""
An ambient test with set-ups merged
===================================

Four sensors for eight storeys: two stay at their reference places, two move, and four records are taken one after
another. The modes of each are found and merged to shapes at all storeys. One learns what references must see, and
gets a standard deviation for every point of every shape.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid

n = 8
here, below = [f"{i}X" for i in range(1, n + 1)], [f"{i}X" for i in range(n)]
parts = [
    sid.PointMass("floor", list(range(1, n + 1)), 2.0e4),
    sid.Spring("storey", below, here, stiffness=3.0e7),
    sid.Dashpot("damper", below, here, viscous_damping=8e4),
]
tower = sid.Structure({i: 3.0 * i for i in range(n + 1)}, parts, ["0X"], active=["X"])
known = sid.parameters(tower, [])


def wind(sensors, seed, rate=25.0, samples=7500):
    """Five minutes of acceleration at these sensors under random forces on all floors."""
    rng = np.random.default_rng(seed)
    table = np.column_stack([np.zeros((samples, len(sensors))), 1e3 * rng.standard_normal((samples, n))])
    kinds = ("acceleration",) * len(sensors) + ("force",) * n
    motion = sid.simulated_time_record(tower, known, sid.TimeRecord(rate, table, (*sensors, *here), kinds))
    values = motion.values[:, : len(sensors)]
    values = values + 0.02 * values.std(axis=0) * rng.standard_normal(values.shape)
    return sid.TimeRecord(rate, values, tuple(sensors), kinds[: len(sensors)])


# %%
# Four set-ups, with the references at floors 8 and 5
# ----------------------------------------------------
setups = [("8X", "5X", "1X"), ("8X", "5X", "2X", "3X"), ("8X", "5X", "4X"), ("8X", "5X", "6X", "7X")]
parts_of_modes = [
    sid.identify_modes(wind(sensors, seed), "ssi_cov", frequencies=(1.1, 3.3, 5.4))
    for seed, sensors in enumerate(setups)
]
modes = sid.merge_modes(parts_of_modes, references=["8X", "5X"])
modes

# %%
# The shapes over the height, with two standard deviations:
order = np.argsort([dof.node for dof in modes.channels])
height = 3.0 * np.array([dof.node for dof in modes.channels])[order]
figure = Figure(figsize=(7, 3.6), layout="constrained")
for k, axes in enumerate(figure.subplots(1, len(modes.frequency), sharey=True)):
    shape, std = modes.mode_shapes[order, k].real, modes.shape_std[order, k]
    axes.errorbar(shape, height, xerr=2 * std, fmt="o-", ms=3, capsize=3)
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set_title(f"{modes.frequency[k]:.3f} Hz", fontsize=9)
figure.axes[0].set_ylabel("height (m)")

"""
The IASC-ASCE frame: braces removed from the first storey
=========================================================

Phase I of the benchmark (Johnson, Lam, Katafygiotis and Beck 2004, J. Eng. Mech. 130, 3-15): four storeys, shear
frame, braces of the first storey removed in pattern 1, of the first and the third in pattern 2. The frame is built
here from its published masses and storey stiffnesses, with 10 % noise on every channel. One learns that the lost
stiffness is found storey by storey, and that nothing is declared where nothing was lost.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid

MASS, STIFFNESS = [3452.4, 2652.4, 2652.4, 1809.9], 67.90e6  # kg; N/m in y, every storey
LOST = {"pattern 1": [0.7103, 0, 0, 0], "pattern 2": [0.7103, 0, 0.7103, 0]}
here, below = ["1Y", "2Y", "3Y", "4Y"], ["0Y", "1Y", "2Y", "3Y"]


def frame(lost):
    """Motion along y."""
    parts = [
        sid.PointMass("floor", [1, 2, 3, 4], MASS),
        sid.Spring("storey", below, here, stiffness=STIFFNESS * (1 - np.array(lost))),
        sid.Dashpot("damper", below, here, viscous_damping=1.5e4),
    ]
    return sid.Structure({i: [0.0, 0.0, 0.9 * i] for i in range(5)}, parts, ["0Y"], active=["Y"])


def measured(structure, seed):
    """Forces at the floors, accelerations with 10 % noise, 20 s at 500 Hz."""
    rng = np.random.default_rng(seed)
    force = 150 * rng.standard_normal((10000, 4))
    blank = np.column_stack([np.zeros((10000, 4)), force])
    kinds = ("acceleration",) * 4 + ("force",) * 4
    record = sid.TimeRecord(500.0, blank, (*here, *here), kinds)
    values = sid.simulated_time_record(structure, sid.parameters(structure, []), record).values
    std = np.where(np.arange(8) < 4, 0.1 * values[:, :4].std(axis=0).max(), 0.0)
    return sid.TimeRecord(500.0, values + std * rng.standard_normal(values.shape), record.channels, kinds, std**2)


def identified(structure, seed):
    """Stiffness and damping of every storey by output error."""
    nominal = frame([0, 0, 0, 0])
    unknown = [sid.Unknown("stiffness", "storey", each=True), sid.Unknown("viscous_damping", "damper")]
    return sid.identify_time(nominal, sid.parameters(nominal, unknown), measured(structure, seed))


# %%
# Undamaged, and both patterns
# ----------------------------
new = identified(frame([0, 0, 0, 0]), 1)
print(new)
figure = Figure(figsize=(7, 3.2), layout="constrained")
axes = figure.subplots()
at = np.arange(1, 5)
for k, (name, lost) in enumerate(LOST.items()):
    found = sid.compare_states(new, identified(frame(lost), 2 + k))
    axes.bar(at + 0.3 * k - 0.15, -100 * found.relative_change[:4], 0.28, label=f"{name}, found")
    axes.plot(at + 0.3 * k - 0.15, 100 * np.array(lost), "k_", ms=16, label="true" if k else None)
    print(name, [one for one, changed in zip(found.names, found.changed, strict=True) if changed])
axes.set_xticks(at)
axes.set_xlabel("storey")
axes.set_ylabel("stiffness lost (%)")
axes.legend(frameon=False)

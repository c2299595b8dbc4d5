"""
Modes of an ambient record
==========================

Three storeys under wind, no force measured: ``structid modes`` finds frequencies, damping ratios and shapes with
their uncertainty, no option needed. One learns to read a stabilization diagram: a pole that keeps its place from
order to order belongs to a mode.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import structid as sid
from structid.cli.app import app as structid

# %%
# Four minutes of simulated motion: storeys of 1 kg on springs of 400 N/m, under random forces on every floor.
here, below = ["1X", "2X", "3X"], ["0X", "1X", "2X"]
parts = [
    sid.PointMass("floor", [1, 2, 3], 1.0),
    sid.Spring("storey", below, here, stiffness=400.0),
    sid.Dashpot("damper", below, here, viscous_damping=0.3),
]
tower = sid.Structure({i: float(i) for i in range(4)}, parts, ["0X"], active=["X"])
random = np.random.default_rng(0)
blank = np.column_stack([np.zeros((6000, 3)), random.standard_normal((6000, 3))])
kinds = ("acceleration",) * 3 + ("force",) * 3
record = sid.TimeRecord(25.0, blank, (*here, *here), kinds)
motion = sid.simulated_time_record(tower, sid.parameters(tower, []), record).values[:, :3]
motion = motion + 0.02 * motion.std(axis=0) * random.standard_normal(motion.shape)
path = Path(mkdtemp()) / "wind.npz"
sid.write_record(path, sid.TimeRecord(25.0, motion, tuple(here), kinds[:3]))

# %%
# The command
# -----------
code = structid(["modes", str(path), "--out", str(path.with_name("wind_modes")), "--no-report"], standalone_mode=False)

# %%
# From Python, with the diagram and a shape:
found = sid.modes_of_file(path)
diagram = found.plot_stabilization()
shape = found.plot_modes(2)

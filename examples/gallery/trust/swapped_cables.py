"""
Wrong record: swapped cables
============================

Two cables were exchanged at the front end. The fit cannot succeed, and ``structid identify`` names the pair among
hundreds of other things that could be wrong. One learns that a wrong model may be a wrong record, and that the answer
comes with a study that puts it right.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import structid as sid
from structid.cli.app import app as structid

folder = Path(mkdtemp())
STUDY = """
title = "Three masses, and somebody in a hurry"
[structure]
active = ["X"]
fixed = ["0X"]
[structure.nodes]
0 = 0.0
1 = 1.0
2 = 2.0
3 = 3.0
[[structure.point_mass]]
name = "mass"
nodes = [1, 2, 3]
mass = [2.0, 3.0, 1.0]
[[structure.spring]]
name = "spring"
first = ["0X", "1X", "2X"]
second = ["1X", "2X", "3X"]
stiffness = 900.0
loss_factor = 0.02
[[unknown]]
property = "stiffness"
elements = "spring"
each = true
[record]
path = "frf.npz"
noise = { relative = 0.01 }
"""
(folder / "study.toml").write_text(STUDY)

# %%
# The record: springs of 1000 N/m, and the readings of masses 1 and 2 in each other's column.
spring = sid.Spring("spring", ["0X", "1X", "2X"], ["1X", "2X", "3X"], stiffness=1000.0, loss_factor=0.02)
parts = [sid.PointMass("mass", [1, 2, 3], [2.0, 3.0, 1.0]), spring]
truth = sid.Structure({i: float(i) for i in range(4)}, parts, ["0X"], active=["X"])
lines = np.arange(0.5, 12.0, 0.05)
like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("1X", "2X", "3X"), ("3X",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(1))
swapped = sid.FrfRecord(lines, record.values[:, [1, 0, 2]], record.outputs, record.inputs, "accelerance")
sid.write_record(folder / "frf.npz", swapped)

# %%
# The command
# -----------
out = folder / "out"
code = structid(["identify", str(folder / "study.toml"), "--out", str(out), "--no-report"], standalone_mode=False)

# %%
# The suggested study, run:
better = sorted((out / "suggestions").glob("1-*.toml"))[0]
found = sid.run_study(sid.load_study(better)).identification
print(found.estimate)
figure = found.plot_frf("1X")

"""
Plan a test before it is run
============================

Where should two accelerometers sit so that the mass and bending stiffness of every element of a cantilever come out?
``structid plan`` answers from the model alone, with the standard deviation that each parameter will have. One learns
how much a second sensor brings, and that a few good lines do better than many even ones.
"""

from pathlib import Path
from tempfile import mkdtemp

from structid.cli.app import app as structid

study = Path(mkdtemp()) / "beam.toml"
study.write_text("""
title = "Cantilever of six elements"
[structure]
fixed = ["0 Y RZ"]
[structure.nodes]
0 = 0.0
1 = 1.0
2 = 2.0
3 = 3.0
4 = 4.0
5 = 5.0
6 = 6.0
[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6]]
mass = 1.0
bending_stiffness = 1000.0
loss_factor = 0.01
[[unknown]]
property = "mass"
elements = "beam"
each = true
[[unknown]]
property = "bending_stiffness"
elements = "beam"
each = true
[plan]
loads = ["6Y", "3Y"]
installed_sensors = ["6Y"]
installed_loads = ["6Y"]
band = [0.2, 40.0]
n_lines = 400
spacing = "log"
n_sensors = 2
n_frequencies = 24
target = 0.02
noise = { relative = 0.01, absolute = 0.001 }
""")

# %%
# The command
# -----------
out = study.with_name("planned")
code = structid(["plan", str(study), "--out", str(out), "--png"], standalone_mode=False)

# %%
# What each test would tell of each parameter, as the page shows it:
picture = sorted((out / "figures").glob("*.png"))[0]

"""
What has changed?
=================

A beam before and after the stiffness of one element fell by a tenth. Both states are identified, every change is
tested, and changes that could not have been seen are said too. One learns that it pays to say what did not change:
here the masses. The command is ``structid compare before.toml after.toml --unchanged mass``.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import structid as sid
from structid.cli.app import app as structid

folder = Path(mkdtemp())
nodes = "\n".join(f"{i} = {0.2 * i}" for i in range(7))
random = np.random.default_rng(6)
for state, factor in (("before", 1.0), ("after", 0.9)):
    stiffness = 80.0 * np.array([1, 1, factor, 1, 1, 1])
    beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], 2.0, stiffness, loss_factor=0.01)
    structure = sid.Structure({i: 0.2 * i for i in range(7)}, [beam], ["0Y", "0RZ"])
    lines = np.arange(2.0, 160.0, 0.5)
    like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("2Y", "4Y", "6Y"), ("6Y",), "accelerance")
    record = sid.simulated_record(structure, sid.parameters(structure, []), like, 0.01, random)
    sid.write_record(folder / f"{state}.npz", record)
    (folder / f"{state}.toml").write_text(f"""
[structure]
fixed = ["0Y", "0RZ"]
[structure.nodes]
{nodes}
[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6]]
mass = 2.0
bending_stiffness = 80.0
loss_factor = 0.01
[[unknown]]
property = "mass"
elements = "beam"
each = true
[[unknown]]
property = "bending_stiffness"
elements = "beam"
each = true
[record]
path = "{state}.npz"
noise = {{ relative = 0.01 }}
""")

# %%
# The command
# -----------
words = ["compare", str(folder / "before.toml"), str(folder / "after.toml"), "--unchanged", "mass"]
code = structid([*words, "--out", str(folder / "changes"), "--png"], standalone_mode=False)

# %%
# All changes with their intervals:
picture = sorted((folder / "changes" / "figures").glob("*change*.png"))[0]

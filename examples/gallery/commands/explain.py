"""
Why does the model not fit?
===========================

A cantilever is modelled as clamped, but its clamp turns a little. ``structid explain`` tries hundreds of single
changes of the model and the record and ranks them by the misfit that they remove. One learns the cause with the study
that mends it, and that alternatives which the data cannot tell apart are listed together.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import structid as sid
from structid.cli.app import app as structid

folder = Path(mkdtemp())

# %%
# The truth has a spring of 400 N m/rad where the model has a clamp.
beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], 0.8, 30.0, loss_factor=0.01)
clamp = sid.Spring("clamp", "0RZ", stiffness=400.0)
truth = sid.Structure({i: 0.1 * i for i in range(7)}, [beam, clamp], ["0Y"])
lines = np.arange(3.0, 200.0, 0.5)
like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("2Y", "4Y", "6Y"), ("4Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(4))
sid.write_record(folder / "frf.npz", record)
(folder / "study.toml").write_text("""
title = "A clamp that is none"
[structure]
fixed = ["0Y", "0RZ"]
[structure.nodes]
0 = 0.0
1 = 0.1
2 = 0.2
3 = 0.3
4 = 0.4
5 = 0.5
6 = 0.6
[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6]]
mass = 0.8
bending_stiffness = 28.0
loss_factor = 0.01
[[unknown]]
property = "bending_stiffness"
elements = "beam"
[[unknown]]
property = "loss_factor"
elements = "beam"
[record]
path = "frf.npz"
noise = { relative = 0.01 }
""")

# %%
# The command
# -----------
out = folder / "explained"
code = structid(["explain", str(folder / "study.toml"), "--out", str(out), "--no-report"], standalone_mode=False)

# %%
# The first suggestion runs as it is:
better = sorted((out / "suggestions").glob("1-*.toml"))[0]
found = sid.run_study(sid.load_study(better)).identification
print(found.estimate)
figure = found.plot_frf("6Y")

"""
Every mass, spring and damper in one pass
=========================================

Where the motion of every floor is known with the forces, the equations of motion are linear in masses, springs and
dampers: ``structid motion`` needs no start and no iteration. One learns what five seconds of a camera's record tell
of eighteen parameters.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.cli.app import app as structid

study = Path("../../motion_of_a_frame/study.toml")
out = Path(mkdtemp()) / "motion"

# %%
# The command
# -----------
code = structid(["motion", str(study), "--out", str(out)], standalone_mode=False)

# %%
# What was found over what the frame was made of:
table = np.genfromtxt(out / "parameters.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
truth = [410, 395, 400, 388, 402, 300, 2.1e6, 2.0e6, 1.5e6, 1.9e6, 1.8e6, 1.2e6, 900, 850, 1400, 800, 780, 500]
figure = Figure(figsize=(7, 3.2), layout="constrained")
axes = figure.subplots()
axes.errorbar(range(18), table["value"] / truth, 2 * table["standard_deviation"] / truth, fmt="o", capsize=3)
axes.axhline(1.0, color="black", lw=0.8)
axes.set_xticks(range(18), table["name"] if "name" in table.dtype.names else range(18), rotation=60, ha="right")
axes.set_ylabel("found over true, ± 2 std")
record = sid.read_record(study.with_name("motion.h5"))
print(record)

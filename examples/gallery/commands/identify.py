"""
Identify, and do as the answer says
===================================

A shaken strip with a mass at its tip, from a laboratory's CSV. The first model is wrong, and ``structid identify``
says so in its first line, with the cause. One learns to read the verdict before the values, and to run the study that
was suggested.
"""

from pathlib import Path
from tempfile import mkdtemp

import structid as sid
from structid.cli.app import app as structid

study = Path("../../first_structure/study.toml")
out = Path(mkdtemp())

# %%
# First try
# ---------
code = structid(["identify", str(study), "--out", str(out / "first"), "--no-report"], standalone_mode=False)
print("exit code", code)

# %%
# The study that was suggested
# ----------------------------
better = out / "first" / "suggestions" / "1-mesh-all-lines.toml"
code = structid(["identify", str(better), "--out", str(out / "second"), "--no-report"], standalone_mode=False)
print("exit code", code)

# %%
# From Python, with the channel that fits worst:
found = sid.run_study(sid.load_study(better)).identification
figure = found.plot_frf()

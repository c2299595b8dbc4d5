"""
Ask the doctor
==============

``structid doctor`` says what the machine can do (threads, memory, what is installed) and what a study will cost on
it: seconds and gigabytes. One learns before a long run whether it fits, and which extra would make it faster.
"""

from pathlib import Path

import structid as sid
from structid.cli.app import app as structid

study = Path("../../plate_from_mesh/study.toml")

# %%
# The command
# -----------
code = structid(["doctor", str(study)], standalone_mode=False)

# %%
# What it was asked about:
structure = sid.load_study(study).structure.plot_structure()

"""
Look before the fit
===================

``structid check`` reads a study with its record and fits nothing: which sensor sees what, the modes of the first
guess, how surely each unknown could be known. One learns that the model is too coarse for the third mode before any
time goes into a search. The study is that of :doc:`/first-structure`.
"""

from pathlib import Path

import structid as sid
from structid.cli.app import app as structid

study = Path("../../first_structure/study.toml")

# %%
# The command
# -----------
code = structid(["check", str(study)], standalone_mode=False)

# %%
# The structure that was read, from Python:
figure = sid.load_study(study).structure.plot_structure()

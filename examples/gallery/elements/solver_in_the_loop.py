"""
A solver in the loop: CalculiX
==============================

The model stays in its solver: numbers in the deck are marked, structid runs the solver with other ones and compares
its matrices or modes with the measurement. One learns that a study with ``[structure.solver]`` is as any other, and
that the updated deck stands beside the answer. Without CalculiX (``ccx``) on the path the example is skipped.
"""

import shutil
from pathlib import Path

import structid as sid

study = Path("../../plate_in_calculix/study.toml")
print(study.read_text(encoding="utf-8")[:900], "...")

# %%
# The answer, where the solver is
# -------------------------------
if shutil.which("ccx"):
    found = sid.run_study(sid.load_study(study)).identification
    print(found.estimate)
    figure = found.plot_parameters()
else:
    print("skipped: CalculiX (ccx) is not on the path; it is free, see calculix.de")

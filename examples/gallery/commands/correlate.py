"""
Test and model side by side
===========================

``structid correlate`` holds measured modes against the model before anything is fitted: pairs, MAC, sensors that
disagree, orthogonality. One learns whether the first guess is near enough for a fit, and which modes belong together.
"""

from pathlib import Path
from tempfile import mkdtemp

from structid.cli.app import app as structid

study = Path("../../ambient_storeys/study.toml")
out = Path(mkdtemp()) / "correlation"

# %%
# The command
# -----------
code = structid(["correlate", str(study), "--out", str(out), "--png"], standalone_mode=False)

# %%
# MAC of measured and modelled modes:
picture = sorted((out / "figures").glob("*mac*.png"))[0]

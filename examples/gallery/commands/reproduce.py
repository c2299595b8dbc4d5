"""
Published numbers, run again
============================

``structid reproduce`` runs the examples of the dissertation that the package grew from (Norris 1986) and sets its
printed numbers beside those found now. One learns how the methods do on problems that anyone can check.
"""

from pathlib import Path
from tempfile import mkdtemp

from structid.cli.app import app as structid

out = Path(mkdtemp()) / "chapter_5"

# %%
# The command
# -----------
code = structid(["reproduce", "--chapter", "5", "--out", str(out), "--png"], standalone_mode=False)

# %%
# One of its figures, drawn again:
picture = out / "figures" / "figure_5_1.png"

"""
A bare array becomes a record
=============================

Arrays without names say nothing of sensors and units. ``structid convert`` is told once, checks, and writes a file
that describes itself, in SI. One learns the few words that every other command would otherwise need again.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import structid as sid
from structid.cli.app import app as structid

folder = Path(mkdtemp())
time = np.arange(0, 8, 1 / 256)
readings = np.column_stack([np.exp(-0.8 * time) * np.sin(2 * np.pi * f * time) for f in (11.0, 17.0)])
np.save(folder / "logger.npy", readings)  # in g

# %%
# The command
# -----------
words = ["convert", str(folder / "logger.npy"), str(folder / "decay.h5"), "--sampling-rate", "256"]
code = structid([*words, "--channels", "3Z+,5Z-", "--units", "g,g"], standalone_mode=False)

# %%
# What is now in the file:
record = sid.read_record(folder / "decay.h5")
record

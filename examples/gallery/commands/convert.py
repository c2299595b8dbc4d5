"""
A bare array becomes a record
=============================

Arrays without names say nothing of sensors and units. ``structid convert`` is told once, checks, and writes a file
that describes itself, in SI. One learns the few words that every other command would otherwise need again.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

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

# %%
# The same motion, as the logger wrote it and as the record has it. The sensor at 5 looks backwards; its name says so.
figure = Figure(figsize=(7, 3.2), layout="constrained")
upper, lower = figure.subplots(2, sharex=True)
upper.plot(time[:512], readings[:512], lw=0.8)
upper.set_ylabel("logger.npy (g)")
lower.plot(record.time[:512], record.values[:512], lw=0.8, label=[str(channel) for channel in record.channels])
lower.set_ylabel("decay.h5 (m/s²)")
lower.set_xlabel("time (s)")
lower.legend(frameon=False)

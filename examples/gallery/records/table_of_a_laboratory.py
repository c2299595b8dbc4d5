"""
A laboratory's table, as it is
==============================

Semicolons, decimal commas, a line above the header, units below the names, a column of temperatures: the table is
read as it is. What was understood is said in the record. One learns the few words that a table needs, and that what
could be read in two ways is refused.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import structid as sid

rng = np.random.default_rng(12)
time = np.arange(0, 20, 1 / 128)
motion = np.exp(-0.25 * time) * np.sin(2 * np.pi * 6.0 * time)
table = np.column_stack([time, motion, -0.6 * motion, 21.5 + 0 * time])
table[:, 1:3] += 0.005 * rng.standard_normal((len(time), 2))
lines = ["Measured by N.N.", "Zeit;A 1;Tip;Temp", "s;g;g;degC"]
lines += [";".join(f"{x:.6f}" for x in row).replace(".", ",") for row in table]
path = Path(mkdtemp()) / "lab.csv"
path.write_text("\n".join(lines) + "\n", encoding="utf-8")
print("\n".join(lines[:5]))

# %%
# Read
# ----
read = sid.ReadOptions(columns=("A 1", "Tip"), channels=("2Y", "4Y"), csv=sid.CsvLayout(skip_rows=1))
record = sid.read_record(path, read)
print(record.source)
figure = Figure(figsize=(7, 2.6), layout="constrained")
axes = figure.subplots()
axes.plot(record.time, record.values, lw=0.7, label=[str(channel) for channel in record.channels])
axes.set_xlabel("time (s)")
axes.set_ylabel("acceleration (m/s²)")
axes.legend(frameon=False)
record

# %%
# Its one mode
# ------------
modes = sid.identify_modes(record)
modes

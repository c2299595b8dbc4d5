"""
The answer goes back into the deck
==================================

A model lives in the program that made it. Here a strip of shells stands in a deck of Abaqus, its outer half is softer than
drawn, and the identified moduli go back: into the deck itself, in which nothing else changes, and onto a grid for ParaView.
One learns what ``structid export`` gives, and that each change comes with its deviation and its significance.
"""

import difflib
from pathlib import Path
from tempfile import mkdtemp

import meshio
import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.cli.app import app as structid

folder = Path(mkdtemp())
N = 8  # cells along the strip of 0.8 m, two across

# %%
# The deck, and a study on it: both halves begin at the modulus of the drawing.
lines = ["*NODE"]
lines += [f"{1 + i + (N + 1) * j}, {0.1 * i:.1f}, {0.1 * j:.1f}, 0.0" for j in range(3) for i in range(N + 1)]
for name, cells in (("INNER", range(N // 2)), ("OUTER", range(N // 2, N))):
    lines.append(f"*ELEMENT, TYPE=S4, ELSET={name}")
    for j in range(2):
        for i in cells:
            first = 1 + i + (N + 1) * j
            lines.append(f"{i + 1 + N * j}, {first}, {first + 1}, {first + N + 2}, {first + N + 1}")
for name in ("INNER", "OUTER"):
    lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", "70.0E9, 0.33", "*DENSITY", "2700."]
    lines += [f"*SHELL SECTION, ELSET={name}, MATERIAL={name}", "0.004"]
(folder / "strip.inp").write_text("\n".join([*lines, ""]))

study = 'title = "Strip"\n[structure]\nmesh = "strip.inp"\n[[structure.support]]\nx = 0.0\n'
for name in ("inner", "outer"):
    study += (
        f'[[structure.shell]]\nname = "{name}"\ngroup = "{name.upper()}"\nyoungs_modulus = 70e9\ndensity = 2700.0\n'
    )
    study += "thickness = 0.004\npoisson = 0.33\nloss_factor = 0.01\n"
    study += f'[[unknown]]\nproperty = "youngs_modulus"\nelements = "{name}"\n'
(folder / "strip.toml").write_text(study + '[record]\npath = "hammer.npz"\n')

# %%
# What is measured: two accelerometers, a hammer at a corner, 1 % of noise. The outer half is 15 % softer than drawn.
frequency = np.linspace(2.0, 120.0, 300)
like = sid.FrfRecord(frequency, np.ones((300, 2, 1)), ["9Z", "23Z"], ["9Z"], "accelerance")
sid.write_record(folder / "hammer.npz", like)
drawn = sid.load_study(folder / "strip.toml")
built = drawn.parameters.started_at(np.array([70e9, 0.85 * 70e9]))
sid.write_record(
    folder / "hammer.npz", sid.simulated_record(drawn.structure, built, like, 0.01, np.random.default_rng(1))
)

# %%
# Identify, list what the results can give, and write three files.
results = str(folder / "strip_results")
code = structid(["identify", str(folder / "strip.toml"), "--out", results, "--no-report"], standalone_mode=False)
structid(["export", results], standalone_mode=False)
files = [
    "--deck",
    str(folder / "new.inp"),
    "--mesh",
    str(folder / "strip.vtu"),
    "--mode-shapes",
    str(folder / "strip.uff"),
]
structid(["export", results, *files], standalone_mode=False)

# %%
# The lines of the deck that differ:
old, new = ((folder / name).read_text().splitlines() for name in ("strip.inp", "new.inp"))
changed = [
    line
    for line in difflib.unified_diff(old, new, lineterm="", n=0)
    if line[0] in "+-" and line[:3] not in ("+++", "---")
]
print("\n".join(changed))

# %%
# The grid, as meshio or ParaView reads it: each cell by the relative change of its modulus, and by how significant that is.
grid = meshio.read(folder / "strip.vtu")
change = grid.cell_data["youngs_modulus relative change"][0]
significance = grid.cell_data["youngs_modulus significance"][0]
figure = Figure(figsize=(7, 3.4), layout="constrained")
for axes, values, words in zip(
    figure.subplots(2),
    (100 * change, significance),
    ("change (%)", "over deviation"),
    strict=True,
):
    centres = grid.points[grid.cells[0].data].mean(axis=1)
    most = abs(values).max()
    shown = axes.scatter(*centres[:, :2].T, c=values, marker="s", s=900, cmap="RdBu", vmin=-most, vmax=most)
    axes.set(aspect="equal", xlim=(0, 0.8), ylim=(0, 0.2), ylabel="y (m)")
    figure.colorbar(shown, ax=axes, label=words)
axes.set_xlabel("x (m)")

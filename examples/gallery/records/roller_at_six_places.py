"""
A roller at six places
======================

A steel strip lies on two bearings and on a roller, which is moved from place to place; at each a hammer blow is recorded.
Where was the roller, each time? One study has all six records: the bending stiffness is one unknown in all of them, each
place an unknown of its own. One learns to say in a study file what differs from record to record, and that six places
come out as six values rather than as scatter about one.
"""

from itertools import pairwise
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.dynamics import modes
from structid.modal.formats.files import write_modes

folder, random = Path(mkdtemp()), np.random.default_rng(1)

# %%
# Six records
# -----------
# The truth: a finer model, its modes below 200 Hz with damping ratios of 0.2 to 1 %, four accelerometers, noise of 1 %. No
# strip is its model: each frequency is off by some 0.05 %, which the study states as ``frequency_error``.
places = np.array([0.552, 0.603, 0.648, 0.701, 0.752, 0.797])
sensors, names = (0.125, 0.3, 0.45, 0.9), ("1Y", "2Y", "3Y", "9Y")


def blow(place):
    """The accelerations after a blow beside the third sensor, with the roller at `place`."""
    points = np.unique(np.round([*np.linspace(0.0, 1.0, 41), place, *sensors], 6))
    node = {x: int(np.abs(points - x).argmin()) for x in (*sensors, place)}
    strip = sid.Beam("strip", [[i, i + 1] for i in range(len(points) - 1)], 0.8, 9.0)
    held = ["0Y", f"{node[place]}Y", f"{len(points) - 1}Y"]
    structure = sid.Structure(dict(enumerate(points.tolist())), [strip], held)
    normal = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=6)
    few = normal.frequency < 200.0
    rows = [[str(dof) for dof in structure.dofs].index(f"{node[x]}Y+") for x in sensors]
    shapes, omega = normal.mode_shapes[rows][:, few], 2 * np.pi * normal.frequency[few]
    omega = omega * (1 + 0.0005 * random.standard_normal(few.sum()))
    ratio, time = random.uniform(0.002, 0.01, few.sum()), np.arange(1500) / 500.0
    poles = omega * (1j * np.sqrt(1 - ratio**2) - ratio)
    values = (np.exp(np.outer(time, poles)) * shapes[2] * omega).imag @ shapes.T
    values = values + 0.01 * values.std(axis=0) * random.standard_normal(values.shape)
    return sid.TimeRecord(500.0, values, names, ("acceleration",) * 4)


for number, place in enumerate(places, 1):
    measured = sid.identify_modes(blow(place), orders=range(2, 31, 2))
    write_modes(folder / f"place_{number}.json", measured)
    print(f"{1e3 * place:.0f} mm:", " ".join(f"{f:.2f}" for f in measured.frequency), "Hz")

# %%
# One study
# ---------
# The nodes 10 to 15 may slide; they are drawn where the roller was meant to be. In each record another one of them is held.
x = {0: 0.0, 1: 0.125, 2: 0.3, 3: 0.45, 10: 0.55, 4: 0.575, 11: 0.60, 5: 0.625, 12: 0.65, 6: 0.675, 13: 0.70, 7: 0.725}
x |= {14: 0.75, 8: 0.775, 15: 0.80, 9: 0.9, 16: 1.0}
along, rollers = list(x), range(10, 16)
text = f"""
title = "A roller at six places"
[structure]
fixed = ["0Y", "16Y"]
sliding = {list(rollers)}
[structure.nodes]
{chr(10).join(f"{node} = {place}" for node, place in x.items())}
[[structure.beam]]
name = "strip"
nodes = {[list(pair) for pair in pairwise(along)]}
mass = 0.8                                # kg/m, weighed
bending_stiffness = 10.0
[[unknown]]
property = "bending_stiffness"
elements = "strip"
"""
for number, node in enumerate(rollers, 1):
    text += f"""
[[unknown]]
property = "position"
elements = "node {node}"
[[record]]
path = "place_{number}.json"
modes = {{ frequency_error = 0.0005, shape_error = 0.003 }}
structure = {{ fixed = ["0Y", "{node}Y", "16Y"] }}
"""
(folder / "study.toml").write_text(text)
print(text[text.rindex("[[unknown]]") :])  # the last place

# %%
# Six values
# ----------
estimate = sid.run_study(sid.load_study(folder / "study.toml")).identification.estimate
print(estimate)

# %%
# Positions count from the neighbour where the first beam begins; its place and the answer are the place on the strip.
before = np.array([x[along[along.index(node) - 1]] for node in rollers])
index = [next(i for i, name in enumerate(estimate.names) if f"node {node}" in name) for node in rollers]
answer, std = before + estimate.values[index], estimate.std[index]
for place, value, error in zip(places, answer, std, strict=True):
    print(f"true {1e3 * place:.0f} mm: {1e3 * value:.2f} ± {1e3 * error:.2f} mm")

figure = Figure(figsize=(7, 3.2), layout="constrained")
axes = figure.subplots()
axes.errorbar(1e3 * places, 1e3 * (answer - places), 1.96e3 * std, fmt="o", capsize=3)
axes.set(xlabel="true place of the roller (mm)", ylabel="identified less true (mm), 95 %")

"""A mast with sensors along lines of their own, its modes measured on a stiffer one: a study and what it was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid import ModalRecord, SpaceBeam, Structure
from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof, parse_dofs
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.modal.formats.files import write_modes

NODES = {k: (0.0, 0.0, float(k - 1)) for k in range(1, 10)}
STIFF = 2e6
#: Channels by name, with the node that each reads and its direction.
CHANNELS = {
    "101X": (4, (1.0, 1.0, 0.0)),
    "102X": (7, (0.3, 0.95, 0.0)),
    "9X": (9, (0.8, -0.6, 0.0)),
    "9Y": (9, (0.6, 0.8, 0.0)),
    "6X": (6, (1.0, 0.0, 0.0)),
    "6Y": (6, (0.0, 1.0, 0.0)),
}
SENSORS = """
[record.sensors]
"101X" = { node = 4, direction = [1.0, 1.0, 0.0] }
"102X" = { point = [0.01, 0.0, 6.0], direction = [0.3, 0.95, 0.0], tolerance = 0.05 }
"9X" = { direction = [0.8, -0.6, 0.0] }
"9Y" = { direction = [0.6, 0.8, 0.0] }
"""
STUDY = f"""\
title = "Mast"
[structure]
fixed = ["1"]
[structure.nodes]
{"".join(f"{label} = {list(place)}{chr(10)}" for label, place in NODES.items())}
[[structure.space_beam]]
name = "mast"
nodes = {[[k, k + 1] for k in range(1, 9)]}
mass = 50.0
bending_stiffness_y = {STIFF}
bending_stiffness_z = 2.2e6
axial_stiffness = 1e9
torsional_stiffness = 5e6
polar_inertia = 1.0
orientation = [1.0, 0.0, 0.0]
[[unknown]]
property = "bending_stiffness_y"
elements = "mast"
[record]
path = "modes.csv"
[record.modes]
frequency_error = 0.005
shape_error = 0.02
"""


def mast(stiffness: float = STIFF) -> Structure:
    """The structure of the study."""
    beam = SpaceBeam(
        "mast", [(k, k + 1) for k in range(1, 9)], mass=50.0, bending_stiffness_y=stiffness, bending_stiffness_z=2.2e6,
        axial_stiffness=1e9, torsional_stiffness=5e6, polar_inertia=1.0, orientation=(1.0, 0.0, 0.0),
    )  # fmt: skip
    return Structure(NODES, [beam], [f"1{d}" for d in DIRECTIONS])


def seen(structure: Structure, found: Modes) -> FloatArray:
    """The modes at `CHANNELS`, (n_channels, n_modes), by products of vectors."""
    rows = []
    for node, direction in CHANNELS.values():
        motion = structure.selection([Dof(node, d) for d in "XYZ"]).toarray().T @ found.mode_shapes
        rows.append(np.array(direction) @ motion / np.linalg.norm(direction))
    return np.array(rows)


def written(folder: Path, text: str = STUDY + SENSORS, noise: float = 0.01, n_modes: int = 4) -> Path:
    """The study in `folder`, with modes of a mast whose bending stiffness along Y is 1.2 times that of the model."""
    folder.mkdir(exist_ok=True)
    structure = mast(1.2 * STIFF)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=n_modes)
    shapes = seen(structure, found)
    shapes /= np.abs(shapes).max(axis=0)
    shapes += noise * np.random.default_rng(3).standard_normal(shapes.shape)
    record = ModalRecord(found.frequency, np.full(n_modes, 0.01), shapes, parse_dofs(CHANNELS))
    write_modes(folder / "modes.csv", record)
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder / "study.toml"

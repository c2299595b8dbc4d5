"""The modes of the example: structid's own hexahedra with the moduli that are to be found, and noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.dof import parse_dofs
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.fem.elements import Solid
from structid.fem.meshes import read_mesh
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes

HERE = Path(__file__).parent
#: N/m^2, of the steel and the aluminium half.
TRUTH = {"E_left": 1.95e11, "E_right": 7.4e10}
SENSORS = parse_dofs(["5Z", "10Z", "15Z", "3Z", "8Z", "13Z", "5Y", "15Y", "5X"])
FREQUENCY_ERROR, SHAPE_ERROR = 0.001, 0.01


def record(rng: np.random.Generator) -> ModalRecord:
    """Six modes at nine sensors."""
    mesh = read_mesh(HERE / "plate.inp")
    held = [f"{label}{direction}" for label, place in mesh.nodes.items() if place[0] == 0 for direction in "XYZ"]
    sets = [
        Solid(
            "left", mesh.cells("LEFT"), youngs_modulus=TRUTH["E_left"], density=7800.0, poisson=0.3, formulation="full"
        ),
        Solid(
            "right",
            mesh.cells("RIGHT"),
            youngs_modulus=TRUTH["E_right"],
            density=2700.0,
            poisson=0.3,
            formulation="full",
        ),
    ]
    structure = Structure(mesh.nodes, sets, held)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=6)
    shapes = structure.selection(SENSORS).toarray().T @ found.mode_shapes
    shapes = shapes / np.abs(shapes).max(axis=0) + SHAPE_ERROR * rng.standard_normal((len(SENSORS), 6))
    frequency = found.frequency * (1 + FREQUENCY_ERROR * rng.standard_normal(6))
    return ModalRecord(frequency, np.full(6, np.nan), shapes, SENSORS, source="simulated")


if __name__ == "__main__":
    write_modes(HERE / "modes.csv", record(np.random.default_rng(5)))

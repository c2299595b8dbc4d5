"""`structid export`: an identified model in files of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem.importers import ImportedMatrix, write_matrices
from structid.files import atomic_write
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.options import ExportOptions
from structid.prediction.state_space import state_space

#: Names of the matrices, as programs of finite elements call those of an analysis set, and the laws that they enter by.
_MATRICES = {"MAA": "inertia", "BAA": "viscous", "KAA": "elastic", "K4AA": "structural"}


def export_state_space(model: IdentifiedModel, options: ExportOptions, path: Path) -> str:
    """Write state equations to `path`; what they are, in a line.

    Raises
    ------
    InputError
        If sensors, loads or the band are missing or cannot be used.
    """
    sensors, loads = (
        [part.strip() for part in text.split(",") if part.strip()] for text in (options.sensors, options.loads)
    )
    for name, value in (("sensors", sensors), ("loads", loads), ("band", options.band)):
        if not value:
            raise InputError(f"`{name}` must be given for state equations, got none", name)
    made = state_space(
        model,
        sensors,
        loads,
        options.band or (0.0, 0.0),
        options.motion,
        options.order,
        options.error,
        options.sampling_rate,
        options.draws,
    )
    made.write(path)
    return f"{path}: {made.overview().words}"


def export_matrices(model: IdentifiedModel, path: Path) -> list[str]:
    """Write mass, damping and stiffness to `path`, and the node and component of each row beside it; what was written, in lines.

    Raises
    ------
    InputError
        If the structure has no matrices.
    """
    structure = model.structure
    structure.require_modes("matrices")
    rows = structure.dofs
    table = np.array([_component(dof) for dof in rows])
    items = []
    for name, law in _MATRICES.items():
        matrix = structure.matrix(law, model.values)
        if matrix.nnz:
            items.append(ImportedMatrix(name, matrix, table))
    write_matrices(path, items)
    numbering = path.with_suffix(".dofs.txt")
    with atomic_write(numbering) as temporary:
        temporary.write_text("".join(f"{node} {component}\n" for node, component in table.tolist()), encoding="ascii")
    names = ", ".join(item.name for item in items)
    return [
        f"{path}: {names} of {len(rows)} degrees of freedom, SI units; K4AA is the imaginary part of the stiffness"
        if any(item.name == "K4AA" for item in items)
        else f"{path}: {names} of {len(rows)} degrees of freedom, SI units",
        f"{numbering}: node and component of each row",
    ]


def _component(dof: Dof) -> tuple[int, int]:
    """Node and component, 1 to 6, of a row."""
    return dof.node, dof.axis + 1

"""`structid export`: an identified model in files of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.constraints import split_commas
from structid.core.errors import InputError
from structid.fem.importers import ImportedMatrix, write_matrices, write_numbering
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
    sensors, loads = split_commas(options.sensors), split_commas(options.loads)
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
    table = np.array([(dof.node, dof.axis + 1) for dof in structure.dofs])
    matrices = {name: structure.matrix(law, model.values) for name, law in _MATRICES.items()}
    items = [ImportedMatrix(name, matrix, table) for name, matrix in matrices.items() if matrix.nnz]
    write_matrices(path, items)
    numbering = path.with_suffix(".dofs.txt")
    write_numbering(numbering, table)
    names = [item.name for item in items]
    imaginary = "; K4AA is the imaginary part of the stiffness" if "K4AA" in names else ""
    return [
        f"{path}: {', '.join(names)} of {len(table)} degrees of freedom, SI units{imaginary}",
        f"{numbering}: node and component of each row",
    ]

"""Ansys: assembled matrices (.full) and element matrices (.emat), by the library `ansys-mapdl-reader` (MIT).

The binary files are read by that library in the child of `structid.files.contained`. What is kept: stiffness, mass and
damping, node and component of each row, the element of each entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix, codes_of, complete_triangles, from_elements, from_triangle
from structid.files import damage_told
from structid.files.contained import ReaderError, read_in_child
from structid.files.sparse import checked_sparse_matrix

_KINDS = {"stress": "STIFFNESS", "mass": "MASS", "damping": "DAMPING"}


def read(path: Path) -> list[ImportedMatrix]:
    """Stiffness and mass matrices in the Ansys file at `path` (``.full`` or ``.emat``), as a list of one each.

    Rows have node and component. Those of a ``.emat`` file are assembled, have the entries of each element beside, and
    damping may be among them. The file is read in a child process.

    Raises
    ------
    FileError
        If `ansys-mapdl-reader` is not installed, cannot read the file, or the file has neither.
    """
    try:
        content = read_in_child(path, "ansys")
    except ReaderError as error:
        if error.kind in ("ImportError", "ModuleNotFoundError"):
            raise FileError(
                f"{path}: needs the library ansys-mapdl-reader; install it with `pip install ansys-mapdl-reader`, or write "
                "the matrices from Ansys with HBMAT, or as MatrixMarket with *SMAT and *EXPORT, and give those"
            ) from error
        raise FileError(
            f"{path}: ansys-mapdl-reader cannot read it ({error}); write it again with EMATWRITE,YES or WRFULL"
        ) from error
    with damage_told(path, "a whole file of Ansys", "write it again with EMATWRITE,YES or WRFULL"):
        matrices = _assembled_matrices(content) if "dofs" in content else _element_matrices(content)
    if not matrices:
        raise FileError(f"{path}: holds neither stiffness nor mass; write it from a modal analysis")
    return matrices


def _assembled_matrices(content: Mapping[str, Any]) -> list[ImportedMatrix]:
    """Stiffness and mass from the `content` of a ``.full`` file, both triangles, on the free degrees of freedom.

    `content` has node and component (from 0) of each row, those that are constrained, and one triangle of each matrix.
    """
    table = content["dofs"] + np.array([0, 1])
    constrained = content["held"].reshape(-1, 2) + np.array([0, 1])
    free = ~np.isin(codes_of(table), codes_of(constrained))
    matrices = []
    for name in ("STIFFNESS", "MASS"):
        if name in content:
            shape, starts, rows, values = content[name]
            part = complete_triangles(checked_sparse_matrix(shape, starts, rows, values), name, True)[free][:, free]
            matrices.append(ImportedMatrix(name, part, table[free], constrained=constrained))
    return matrices


def _element_matrices(content: Mapping[str, Any]) -> list[ImportedMatrix]:
    """Assembled matrices, with the entries of each element, from the `content` of a ``.emat`` file.

    `content` has lower triangles by rows, or diagonals, with numbers of equations: (index of the node) n_dof +
    component, both from 0. Raises `ValueError` for another number of values.
    """
    parts: dict[str, list[tuple[int, IntArray, FloatArray]]] = {}
    nodes, labels, n_dof = content["nodes"], content["labels"].tolist(), content["n_dof"]
    for label, (equations, data) in zip(labels, content["elements"], strict=True):
        dofs = np.stack([nodes[equations // n_dof], equations % n_dof + 1], axis=1)
        for key in set(data) & set(_KINDS):
            values = data[key]
            square = np.diag(values) if len(values) == len(equations) else from_triangle(values, len(equations))
            if square is None:
                raise ValueError(f"element {label} has {len(values)} values for {len(equations)} rows")
            parts.setdefault(_KINDS[key], []).append((label, dofs, square))
    return [from_elements(name, parts[name]) for name in _KINDS.values() if name in parts]

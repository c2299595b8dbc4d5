"""Ansys: assembled matrices (.full) and element matrices (.emat), by the library `ansys-mapdl-reader` (MIT).

The binary files are read by that library, which is loaded when a file asks for it. What is kept: stiffness, mass and
damping, node and component of each row, the element of each entry.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray
from structid.errors import FileError
from structid.structure.importers.imported import ImportedMatrix, codes_of, completed, from_elements, from_triangle

SUFFIXES: tuple[str, ...] = (".full", ".emat")

_KINDS = {"stress": "STIFFNESS", "mass": "MASS", "damping": "DAMPING"}


def read(path: Path) -> list[ImportedMatrix]:
    """Stiffness and mass of a ``.full`` file, or of a ``.emat`` file element by element.

    Raises
    ------
    FileError
        If `ansys-mapdl-reader` is not installed, or cannot read the file.
    """
    try:
        from ansys.mapdl.reader import read_binary
    except ImportError as error:
        raise FileError(
            f"{path}: needs the library ansys-mapdl-reader; install it with `pip install ansys-mapdl-reader`, or write "
            "the matrices from Ansys with HBMAT, or as MatrixMarket with *SMAT and *EXPORT, and give those"
        ) from error
    try:
        opened = read_binary(str(path))
        found = _full(opened) if path.suffix.lower() == ".full" else _elements(opened)
    except (ValueError, OSError, RuntimeError, NotImplementedError, KeyError, IndexError, TypeError) as error:
        raise FileError(
            f"{path}: ansys-mapdl-reader cannot read it ({error}); write it again with EMATWRITE,YES or WRFULL"
        ) from error
    if not found:
        raise FileError(f"{path}: holds neither stiffness nor mass; write it from a modal analysis")
    return found


def _full(opened: Any) -> list[ImportedMatrix]:
    """Matrices of a `FullFile`: one triangle, rows named by (node, component from 0); held rows are empty."""
    dofs, stiffness, mass = opened.load_km(sort=True)
    table = np.asarray(dofs, dtype=np.int64) + np.array([0, 1])
    held = np.asarray(opened.const, dtype=np.int64).reshape(-1, 2) + np.array([0, 1])
    free = ~np.isin(codes_of(table), codes_of(held))
    made = []
    for name, matrix in (("STIFFNESS", stiffness), ("MASS", mass)):
        if matrix is not None:
            part = completed(sparse.csc_array(matrix), name, True)[free][:, free]
            made.append(ImportedMatrix(name, part, table[free], held=held))
    return made


def _elements(opened: Any) -> list[ImportedMatrix]:
    """Matrices of an `EmatFile`: lower triangles by rows, at (position of the node, component) counted from 0."""
    parts: dict[str, list[tuple[int, IntArray, FloatArray]]] = {}
    nodes = np.asarray(opened.neqv, dtype=np.int64)
    labels = np.asarray(opened.eeqv, dtype=np.int64)
    for index in range(opened.n_elements):
        where, data = opened.read_element(index)
        where = np.asarray(where, dtype=np.int64)
        dofs = np.stack([nodes[where // opened.n_dof], where % opened.n_dof + 1], axis=1)
        for key in set(data) & set(_KINDS):
            values = np.asarray(data[key], dtype=np.float64)
            square = np.diag(values) if len(values) == len(where) else from_triangle(values, len(where))
            if square is None:
                raise ValueError(f"element {labels[index]} has {len(values)} values for {len(where)} rows")
            parts.setdefault(_KINDS[key], []).append((int(labels[index]), dofs, square))
    return [from_elements(name, parts[name]) for name in _KINDS.values() if name in parts]

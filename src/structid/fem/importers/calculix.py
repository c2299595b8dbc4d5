"""CalculiX matrices of ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: ``.sti`` and ``.mas``, numbered by the ``.dof`` file.

Lines of row, column and value of the upper triangle. What is kept: values as printed (14 digits).

References
----------
Dhondt (2022), CalculiX CrunchiX user's manual 2.20, *FREQUENCY.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix, complete_triangles
from structid.files import require_readable

_NAMES = {".sti": "STIFFNESS", ".mas": "MASS"}
_REMEDY = "run CalculiX again with *FREQUENCY, SOLVER=MATRIXSTORAGE"


def read(path: Path) -> list[ImportedMatrix]:
    """The symmetric matrix in the CalculiX file at `path` (``.sti`` or ``.mas``), both triangles, as a list of one.

    The ``.dof`` file beside it gives node and component of each row.

    Raises
    ------
    FileError
        If the ``.dof`` file is missing, a line of either file cannot be read, a value is not finite, rows lie outside
        the numbering, or one lacks its diagonal entry.
    """
    dofs = _read_dof_file(require_readable(path.with_suffix(".dof")))
    name, n = _NAMES[path.suffix.lower()], len(dofs)
    table = _read_entries(path)
    rows, columns = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    if len(table) and not ((table[:, :2] >= 1) & (table[:, :2] <= n)).all():
        raise FileError(f"{path}: must have rows and columns from 1 to {n} like its .dof file; {_REMEDY}")
    lacking = np.setdiff1d(np.arange(1, n + 1), rows[rows == columns])
    if len(lacking):
        raise FileError(
            f"{path}: lacks the diagonal entries of {len(lacking)} of its {n} rows, the first of row {lacking[0]}; the file is cut"
            f" short, {_REMEDY}"
        )
    matrix = sparse.coo_array((table[:, 2], (rows - 1, columns - 1)), (n, n)).tocsc()
    return [ImportedMatrix(name, complete_triangles(matrix, name, symmetric=True), dofs)]


def _read_entries(path: Path) -> FloatArray:
    """Row, column (from 1) and value of each entry in the file, (n_entries, 3).

    Raises `FileError` if a line is cut or holds something else, or a value is not finite.
    """
    content = path.read_bytes()
    if not content.endswith(b"\n"):
        raise FileError(f"{path}: ends within a line; the file is cut short, {_REMEDY}")
    words = content.split()
    if len(words) != 3 * content.count(b"\n"):
        raise FileError(f"{path}: must have lines of row, column and value; {_REMEDY}")
    try:
        table = np.array(words, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise FileError(f"{path}: must have lines of row, column and value ({error}); {_REMEDY}") from error
    if not np.isfinite(table).all():
        raise FileError(f"{path}: holds values that are not finite; check the model, then {_REMEDY}")
    return table


def _read_dof_file(path: Path) -> IntArray:
    """Node and component of each row of the matrix, (n_rows, 2), from lines such as ``12.3``.

    Raises `FileError` for other lines.
    """
    rows = []
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), 1):
        node, _, component = line.strip().partition(".")
        if not (node.isdigit() and component.isdigit()) or len(node) > 12:
            raise FileError(f"{path}, line {number}: must be node.direction, got {line.strip()[:40]!r}; {_REMEDY}")
        rows.append((int(node), int(component)))
    return np.array(rows, dtype=np.int64).reshape(-1, 2)

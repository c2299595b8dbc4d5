"""Abaqus matrix files (.mtx): assembled with labels or as coordinates, entry by entry of each element, or user elements.

What is kept: values, node and component of each row, the element of each entry. An assembled symmetric matrix has one
triangle in the file. Diagonal entries of 1e36, by which Abaqus holds a degree of freedom, are taken out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError, InputError
from structid.fem.importers.abaqus_elements import read_user_elements
from structid.fem.importers.imported import (
    ElementEntries,
    ImportedMatrix,
    codes_of,
    complete_triangles,
    matrix_from_entries,
    tables_of,
)
from structid.files.sparse import coordinates

Form = Literal["labels", "coordinate", "elements"]

_HELD = 1e30
_COORDINATE, _ELEMENT_COORDINATE, _LABELS, _ELEMENT_LABELS = 3, 4, 5, 6
_REMEDY = "the file is cut short or of another form; write it again with FORMAT=MATRIX INPUT"


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the Abaqus file at `path`, or the stiffness and mass matrices of a file of user elements.

    Raises
    ------
    FileError
        If a line has another number of values than the first, or one that is no number; with the line.
    """
    content = path.read_bytes()
    upper = content.upper()
    if b"*USER ELEMENT" in upper or re.search(rb"^\*MATRIX *,", upper, re.MULTILINE):
        return read_user_elements(path, upper)
    table, commas = _read_table(path, content)
    name = path.stem.upper()
    width = table.shape[1]
    if width == _COORDINATE and commas:
        raise FileError(f"{path}: holds a load vector (node, component, value); give the file of a matrix")
    if width == _ELEMENT_COORDINATE:
        raise FileError(
            f"{path}: holds rows and columns within each element, without nodes; write it with FORMAT=MATRIX INPUT or LABELS"
        )
    _require_whole(path, table[:, :-1])
    try:
        if width == _COORDINATE:
            return [_matrix_of_coordinates(path, name, table)]
        if width == _LABELS:
            return [_labels(name, table)]
        return [_matrix_of_elements(name, table)]
    except (InputError, ValueError) as error:
        raise FileError(f"{path}: {error}; {_REMEDY}") from error


def _read_table(path: Path, content: bytes) -> tuple[FloatArray, bool]:
    """Numbers of all lines except comments and keywords, (n_lines, 3 to 6), and True if they are separated by commas.

    `content` is the text of the file. Raises `FileError` for a line that differs from the first in length, or is no number.
    """
    if b"*" in content:
        lines = content.split(b"\n")
        content = b"\n".join(b"" if line.lstrip().startswith(b"*") else line for line in lines)
    first = next((line for line in content.split(b"\n") if line.strip()), b"")
    commas = b"," in first
    width = len(first.replace(b",", b" ").split())
    if not _COORDINATE <= width <= _ELEMENT_LABELS:
        shown = first.decode("latin-1").strip()[:40]
        raise FileError(f"{path}: must have 3 to 6 values a line, the first line with values is {shown!r}; {_REMEDY}")
    text = content.translate(bytes.maketrans(b",DdQq", b" EEEE"))
    counts = np.unique([len(line.split()) for line in text.split(b"\n")])
    if not set(counts.tolist()) <= {0, width}:
        raise _bad_line_error(path, text, width)
    try:
        numbers = np.array(text.split()).astype(np.float64)
    except ValueError:
        raise _bad_line_error(path, text, width) from None
    return numbers.reshape(-1, width), commas


def _bad_line_error(path: Path, text: bytes, width: int) -> FileError:
    """The error for the first line of `text` that does not have `width` numbers."""
    lines = text.split(b"\n")
    number = next(i for i, line in enumerate(lines) if not _is_good(line, width))
    shown = lines[number].decode("latin-1").strip()[:60]
    return FileError(f"{path}, line {number + 1}: must have {width} numbers like the first, got {shown!r}; {_REMEDY}")


def _is_good(line: bytes, width: int) -> bool:
    try:
        return len([float(word) for word in line.split()]) in (0, width)
    except ValueError:
        return False


def _require_whole(path: Path, labels: FloatArray) -> None:
    """Raise `FileError` unless all labels, (n_entries, n_labels), are whole numbers."""
    bad = ~((labels == np.round(labels)) & (abs(labels) < 2**50)).all(axis=1)
    if bad.any():
        entry = int(np.argmax(bad))
        raise FileError(
            f"{path}: entry {entry + 1} has labels {labels[entry].tolist()}, which must be whole numbers below 2^50; {_REMEDY}"
        )


def _matrix_of_coordinates(path: Path, name: str, table: FloatArray) -> ImportedMatrix:
    """The matrix `name` without numbering, from rows (row, column, value) of `table`, counted from 1; a missing triangle is added.

    Raises `FileError` if a row or column is below 1.
    """
    row, column = table[:, 0].astype(np.int64) - 1, table[:, 1].astype(np.int64) - 1
    if min(row.min(), column.min()) < 0:
        entry = int(np.argmax((row < 0) | (column < 0)))
        raise FileError(
            f"{path}: entry {entry + 1} has row {row[entry] + 1} and column {column[entry] + 1}; rows count from 1 in the form "
            "COORDINATE (negative ones belong to internal nodes), write it with FORMAT=MATRIX INPUT"
        )
    size = int(max(row.max(), column.max())) + 1
    matrix = coordinates((size, size), row, column, table[:, 2])
    return ImportedMatrix(name, complete_triangles(matrix, name))


def _labels(name: str, table: FloatArray) -> ImportedMatrix:
    labels = table[:, :4].astype(np.int64)
    return _without_constrained(matrix_from_entries(name, labels[:, :2], labels[:, 2:], table[:, 4], None))


def _without_constrained(item: ImportedMatrix) -> ImportedMatrix:
    """The matrix without rows whose diagonal of 1e30 or more marks a constrained degree of freedom.

    Node and component of these rows are kept in `constrained`.
    """
    assert item.dofs is not None
    constrained = item.matrix.diagonal() >= _HELD
    if not constrained.any():
        return item
    matrix = item.matrix[~constrained][:, ~constrained]
    return ImportedMatrix(item.name, matrix, item.dofs[~constrained], constrained=item.dofs[constrained])


def _matrix_of_elements(name: str, table: FloatArray) -> ImportedMatrix:
    """The assembled matrix `name`, with the entries of each element (both triangles), from rows of a file.

    `table` (n_entries, 6) has element, node and component of the row, node and component of the column, and value.
    """
    labels = table[:, 1:5].astype(np.int64)
    element, value = table[:, 0].astype(np.int64), table[:, 5]
    codes, index = np.unique(np.concatenate([codes_of(labels[:, :2]), codes_of(labels[:, 2:])]), return_inverse=True)
    n, size = len(element), np.int64(len(codes))
    row, column = index[:n].astype(np.int64), index[n:].astype(np.int64)
    _, number = np.unique(element, return_inverse=True)
    key, mirror = (number * size + row) * size + column, (number * size + column) * size + row
    off_diagonal = row != column
    if not np.isin(key[off_diagonal], mirror[off_diagonal]).any():  # one triangle of every element
        element = np.concatenate([element, element[off_diagonal]])
        value = np.concatenate([value, value[off_diagonal]])
        row, column = np.concatenate([row, column[off_diagonal]]), np.concatenate([column, row[off_diagonal]])
    matrix = sparse.coo_array((value, (row, column)), (len(codes), len(codes)))
    return ImportedMatrix(name, matrix.tocsc(), tables_of(codes), elements=ElementEntries(element, row, column, value))


def file_text(path: Path, item: ImportedMatrix, form: Form = "labels") -> str:
    """Text of an Abaqus matrix file of `item` in the given form; only the lower triangle of a symmetric matrix.

    Parameters
    ----------
    path : Path
        The file, for errors.
    item : ImportedMatrix
    form : {"labels", "coordinate", "elements"}
        Entries by node and component, by row and column from 1, or by element with node and component.

    Raises
    ------
    FileError
        If it has no numbering or elements, where the form needs them, or is complex or rectangular.
    """
    if form not in ("labels", "coordinate", "elements"):
        raise InputError(f"`form` must be 'labels', 'coordinate' or 'elements', got {form!r}")
    if np.iscomplexobj(item.matrix.data) or not item.is_square:
        raise FileError(f"{path}: {item.name!r} must be real and square; write OP4 or DMIG instead")
    if form == "elements":
        return _element_text(path, item)
    symmetric = abs(item.matrix - item.matrix.T).nnz == 0
    stored = sparse.tril(item.matrix) if symmetric else item.matrix.tocoo()
    triples = zip((stored.row + 1).tolist(), (stored.col + 1).tolist(), stored.data.tolist(), strict=True)
    if form == "coordinate":
        return "".join(f"{i} {j} {value:.16e}\n" for i, j, value in triples)
    if item.dofs is None:
        raise FileError(
            f"{path}: {item.name!r} has no node and component of its rows; give `dofs`, or form 'coordinate'"
        )
    dofs = item.dofs.tolist()
    return "".join(_entry(dofs[i - 1], dofs[j - 1], value) for i, j, value in triples)


def _entry(row: list[int], column: list[int], value: float) -> str:
    return f"{row[0]},{row[1]}, {column[0]},{column[1]}, {value:.16e}\n"


def _element_text(path: Path, item: ImportedMatrix) -> str:
    """Text of an Abaqus matrix file with the lower triangle of each element of the matrix `item`.

    Raises `FileError`, which names `path`, if the matrix is only assembled or has no numbering.
    """
    if item.elements is None or item.dofs is None:
        raise FileError(f"{path}: {item.name!r} is assembled; its elements cannot be written apart")
    parts: ElementEntries = item.elements
    dofs = item.dofs.tolist()
    entries: tuple[IntArray, ...] = (parts.element, parts.row, parts.column)
    lines = []
    for e, i, j, value in zip(*(a.tolist() for a in entries), parts.value.tolist(), strict=True):
        if i >= j:
            lines.append(f"{e}, {_entry(dofs[i], dofs[j], value)}")
    return "".join(lines)

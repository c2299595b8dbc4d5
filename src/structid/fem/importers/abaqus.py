"""Abaqus matrix files (.mtx): assembled with labels or as coordinates, element by element, or user elements.

What is kept: values, node and component of each row, the element of each entry. An assembled symmetric matrix has one
triangle in the file. Diagonal entries of 1e36, by which Abaqus holds a degree of freedom, are taken out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError, InputError
from structid.fem.importers.imported import (
    ElementEntries,
    ImportedMatrix,
    codes_of,
    complete_triangles,
    from_elements,
    from_triangle,
    matrix_from_entries,
    tables_of,
)
from structid.files.sparse import coordinates

Form = Literal["labels", "coordinate", "elements"]
_HELD = 1e30
_COORDINATE, _ELEMENT_COORDINATE, _LABELS, _ELEMENT_LABELS = 3, 4, 5, 6
_REMEDY = "the file is cut short or of another form; write it again with FORMAT=MATRIX INPUT"
_ELEMENT_NUMBER = re.compile(rb"ELEMENT NUMBER\s+(\d+)")
_NODES = re.compile(rb"NODES\s*=\s*(\d+)")
_TYPE = re.compile(rb"TYPE\s*=\s*([A-Z ]+)")
_KINDS = {"STIFFNESS", "MASS", "VISCOUSDAMPING", "STRUCTURALDAMPING"}
_USER_ELEMENT_REMEDY = "the file is cut short or damaged; write it again"


def read(path: Path) -> list[ImportedMatrix]:
    """The matrix in the Abaqus file at `path`, or stiffness and mass matrices of a file of user elements, as a list.

    A matrix by node or element comes with the node and component of its rows.

    Raises
    ------
    FileError
        If a line has another number of values than the first, or one that is no number, with the line; or if user
        elements lack nodes, degrees of freedom or matrices of their size.
    """
    content = path.read_bytes()
    upper = content.upper()
    if b"*USER ELEMENT" in upper or re.search(rb"^\*MATRIX *,", upper, re.MULTILINE):
        return _read_user_elements(path, upper)
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
    """Numbers of all lines except comments and keywords, (n_lines, 3 to 6), and True if commas are in the first line.

    `content` is the text of the file. Raises `FileError`, which names `path`, for a first line of another length, one
    that differs from the first in length, or is no number.
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
    """The error, with `path` and line number, for the first line of `text` that does not have `width` numbers.

    Blank lines are good.
    """
    lines = text.split(b"\n")
    number = next(i for i, line in enumerate(lines) if not _is_good(line, width))
    shown = lines[number].decode("latin-1").strip()[:60]
    return FileError(f"{path}, line {number + 1}: must have {width} numbers like the first, got {shown!r}; {_REMEDY}")


def _is_good(line: bytes, width: int) -> bool:
    """True if `line` holds no words, or `width` numbers."""
    try:
        return len([float(word) for word in line.split()]) in (0, width)
    except ValueError:
        return False


def _require_whole(path: Path, labels: FloatArray) -> None:
    """Raise `FileError`, which names `path`, unless all labels, (n_entries, n_labels), are whole numbers below 2^50."""
    bad = ~((labels == np.round(labels)) & (abs(labels) < 2**50)).all(axis=1)
    if bad.any():
        entry = int(np.argmax(bad))
        raise FileError(
            f"{path}: entry {entry + 1} has labels {labels[entry].tolist()}, which must be whole numbers below 2^50; {_REMEDY}"
        )


def _matrix_of_coordinates(path: Path, name: str, table: FloatArray) -> ImportedMatrix:
    """The matrix `name` without numbering, from rows (row, column, value) of `table`, counted from 1.

    A missing triangle is added. Raises `FileError` if a row or column is below 1.
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
    """The matrix without the rows and columns whose diagonal of 1e30 or more marks a constrained degree of freedom.

    Node and component of these rows are stored in `constrained`; the same object is returned if there is none.
    """
    assert item.dofs is not None
    constrained = item.matrix.diagonal() >= _HELD
    if not constrained.any():
        return item
    matrix = item.matrix[~constrained][:, ~constrained]
    return ImportedMatrix(item.name, matrix, item.dofs[~constrained], constrained=item.dofs[constrained])


def _matrix_of_elements(name: str, table: FloatArray) -> ImportedMatrix:
    """The assembled matrix `name` with the entries of each element, both triangles, from rows of a file.

    `table` (n_entries, 6) has element, node and component of the row, node and component of the column, and value. A
    missing triangle is added. Rows are all nodes and components in it, sorted.
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
    InputError
        If `form` is none of these.
    FileError
        If the matrix has no numbering or elements, where the form needs them, or is complex or rectangular.
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


@dataclass(eq=False)
class _Element:
    """One user element in the making: what its lines have said so far."""

    line: int
    label: int
    n_nodes: int
    nodes: list[int] = field(default_factory=list)
    dof_lines: list[list[int]] = field(default_factory=list)
    kind: str = ""
    values: list[bytes] = field(default_factory=list)


def _read_user_elements(path: Path, content: bytes) -> list[ImportedMatrix]:
    """One matrix for each kind (stiffness, mass, damping) of the element matrices in `content`, the file in upper case.

    Raises
    ------
    FileError
        If there is no matrix, an element lacks nodes or degrees of freedom, its matrix has another number of values
        than these ask for, or a line cannot be read.
    """
    parts_of_kind: dict[str, list[tuple[int, IntArray, FloatArray]]] = {}
    for element in _read_elements(path, content):
        dofs = _row_dofs(path, element)
        parts_of_kind.setdefault(element.kind, []).append((element.label, dofs, _full_matrix(path, element, len(dofs))))
    if not parts_of_kind:
        raise FileError(f"{path}: holds no *MATRIX, TYPE=STIFFNESS or MASS; {_USER_ELEMENT_REMEDY}")
    return [from_elements(kind, parts) for kind, parts in parts_of_kind.items()]


def _read_elements(path: Path, content: bytes) -> list[_Element]:
    """Every element matrix in `content` with its nodes and degrees of freedom; one with two matrices comes twice.

    `content` is the file in upper case, `path` its name for errors. Elements are counted from 1 if none has a number in
    comments. Raises `FileError` if only some have, or a line cannot be read.
    """
    elements: list[_Element] = []
    label, n_elements, n_numbered, nodes_follow = 0, 0, 0, False
    current: _Element | None = None
    for number, raw in enumerate(content.split(b"\n"), 1):
        line = raw.strip()
        if line.startswith(b"**"):
            match = _ELEMENT_NUMBER.search(line)
            label = int(match[1]) if match else label
            if b"ELEMENT NODES" in line or b"NODES" in line.split():
                nodes_follow = True
            elif current is not None and nodes_follow and re.fullmatch(rb"\*\*[\s\d,]+", line):
                current.nodes.extend(int(word) for word in line[2:].replace(b",", b" ").split())
            else:
                nodes_follow = False
        elif line.startswith(b"*USER ELEMENT"):
            count = _NODES.search(line)
            if count is None:
                raise FileError(f"{path}, line {number}: *USER ELEMENT must have NODES=; {_USER_ELEMENT_REMEDY}")
            n_elements, n_numbered = n_elements + 1, n_numbered + (label > 0)
            if n_numbered not in (0, n_elements):
                raise FileError(
                    f"{path}, line {number}: *USER ELEMENT must have '** ELEMENT NUMBER' above it for each element or for none;"
                    f" {_USER_ELEMENT_REMEDY}"
                )
            current = _Element(number, label or n_elements, int(count[1]))
            label = 0
        elif line.startswith(b"*MATRIX"):
            current = _with_kind(path, number, line, current)
            elements.append(current)
        elif line.startswith(b"*"):
            nodes_follow = False
        elif line and current is not None:
            if current.kind:
                current.values.append(line)
            else:
                current.dof_lines.append(_whole_numbers(path, number, line))
    return elements


def _with_kind(path: Path, number: int, line: bytes, current: _Element | None) -> _Element:
    """A new element matrix of the kind that the *MATRIX `line` states, on the nodes of `current`.

    Raises `FileError`, with the line's `number`, if `current` is None or the kind is unknown.
    """
    kind = _TYPE.search(line)
    name = kind[1].replace(b" ", b"").decode() if kind else ""
    if current is None or name not in _KINDS:
        raise FileError(
            f"{path}, line {number}: must be *MATRIX, TYPE=STIFFNESS or MASS after a *USER ELEMENT, got "
            f"{line.decode('latin-1')[:40]!r}; {_USER_ELEMENT_REMEDY}"
        )
    return _Element(number, current.label, current.n_nodes, current.nodes, current.dof_lines, name)


def _whole_numbers(path: Path, number: int, line: bytes) -> list[int]:
    """The whole numbers in a line of degrees of freedom; `FileError` with its `number` if there is something else."""
    try:
        return [int(word) for word in line.replace(b",", b" ").split()]
    except ValueError:
        shown = line.decode("latin-1")[:40]
        raise FileError(
            f"{path}, line {number}: must be degrees of freedom, got {shown!r}; {_USER_ELEMENT_REMEDY}"
        ) from None


def _row_dofs(path: Path, element: _Element) -> IntArray:
    """Node and component of each row of the element matrix, (n_rows, 2).

    The components of the first line of degrees of freedom hold until a later line changes them. Raises `FileError` if
    nodes or that line are missing.
    """
    where = f"{path}, line {element.line}: element {element.label}"
    if len(element.nodes) != element.n_nodes:
        raise FileError(
            f"{where} has {element.n_nodes} nodes, but {len(element.nodes)} labels under '** ELEMENT NODES'; {_USER_ELEMENT_REMEDY}"
        )
    if not element.dof_lines:
        raise FileError(f"{where} has no line of degrees of freedom; {_USER_ELEMENT_REMEDY}")
    changes = {0: element.dof_lines[0]}
    changes.update({line[0] - 1: line[1:] for line in element.dof_lines[1:] if line})
    rows: list[tuple[int, int]] = []
    components: list[int] = []
    for position, node in enumerate(element.nodes):
        components = changes.get(position, components)
        rows.extend((node, component) for component in components)
    return np.array(rows, dtype=np.int64)


def _full_matrix(path: Path, element: _Element, n: int) -> FloatArray:
    """The element matrix (n, n) from its values, which are a lower triangle by rows or all columns.

    Raises `FileError` for another number of values. `n` is the number of its degrees of freedom.
    """
    text = b" ".join(element.values).translate(bytes.maketrans(b",D", b" E"))
    try:
        values = np.array(text.split()).astype(np.float64)
    except ValueError as error:
        raise FileError(
            f"{path}, line {element.line}: the {element.kind.lower()} of element {element.label} holds something that is no "
            f"number ({error}); {_USER_ELEMENT_REMEDY}"
        ) from None
    square = from_triangle(values, n)
    if square is not None:
        return square
    raise FileError(
        f"{path}, line {element.line}: the {element.kind.lower()} of element {element.label} has {len(values)} values; "
        f"{n} degrees of freedom need {n * (n + 1) // 2} (symmetric) or {n * n}; {_USER_ELEMENT_REMEDY}"
    )

"""Abaqus files of user elements: `*ELEMENT MATRIX OUTPUT` and `*SUBSTRUCTURE MATRIX OUTPUT` with OUTPUT FILE=USER DEFINED."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.imported import ImportedMatrix, from_elements, from_triangle

_NUMBER = re.compile(rb"ELEMENT NUMBER\s+(\d+)")
_NODES = re.compile(rb"NODES\s*=\s*(\d+)")
_TYPE = re.compile(rb"TYPE\s*=\s*([A-Z ]+)")
_KINDS = {"STIFFNESS", "MASS", "VISCOUSDAMPING", "STRUCTURALDAMPING"}
_REMEDY = "the file is cut short or damaged; write it again"


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


def read_user_elements(path: Path, content: bytes) -> list[ImportedMatrix]:
    """One matrix for each kind (stiffness, mass, damping) of the element matrices in `content`, the file in upper case.

    Raises
    ------
    FileError
        If an element has no nodes, or its matrix another number of values than its degrees of freedom ask for.
    """
    parts_of_kind: dict[str, list[tuple[int, IntArray, FloatArray]]] = {}
    for element in _read_elements(path, content):
        dofs = _row_dofs(path, element)
        parts_of_kind.setdefault(element.kind, []).append((element.label, dofs, _full_matrix(path, element, len(dofs))))
    if not parts_of_kind:
        raise FileError(f"{path}: holds no *MATRIX, TYPE=STIFFNESS or MASS; {_REMEDY}")
    return [from_elements(kind, parts) for kind, parts in parts_of_kind.items()]


def _read_elements(path: Path, content: bytes) -> list[_Element]:
    """Every element matrix in `content` with its nodes and degrees of freedom; an element with two matrices comes twice.

    `content` is the file in upper case. Elements without a number in comments are counted from 1.
    """
    elements: list[_Element] = []
    label, nodes_follow = 0, False
    current: _Element | None = None
    for number, raw in enumerate(content.split(b"\n"), 1):
        line = raw.strip()
        if line.startswith(b"**"):
            match = _NUMBER.search(line)
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
                raise FileError(f"{path}, line {number}: *USER ELEMENT must have NODES=; {_REMEDY}")
            current = _Element(number, label or len(elements) + 1, int(count[1]))
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
            f"{line.decode('latin-1')[:40]!r}; {_REMEDY}"
        )
    return _Element(number, current.label, current.n_nodes, current.nodes, current.dof_lines, name)


def _whole_numbers(path: Path, number: int, line: bytes) -> list[int]:
    """The whole numbers in a line; `FileError` with its `number` if there is something else."""
    try:
        return [int(word) for word in line.replace(b",", b" ").split()]
    except ValueError:
        shown = line.decode("latin-1")[:40]
        raise FileError(f"{path}, line {number}: must be degrees of freedom, got {shown!r}; {_REMEDY}") from None


def _row_dofs(path: Path, element: _Element) -> IntArray:
    """Node and component of each row of the element matrix, (n_rows, 2).

    The components of the first line of degrees of freedom hold until a later line changes them. Raises `FileError` if nodes
    or that line are missing.
    """
    where = f"{path}, line {element.line}: element {element.label}"
    if len(element.nodes) != element.n_nodes:
        raise FileError(
            f"{where} has {element.n_nodes} nodes, but {len(element.nodes)} labels under '** ELEMENT NODES'; {_REMEDY}"
        )
    if not element.dof_lines:
        raise FileError(f"{where} has no line of degrees of freedom; {_REMEDY}")
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

    Raises `FileError` for another number of values.
    """
    text = b" ".join(element.values).translate(bytes.maketrans(b",D", b" E"))
    try:
        values = np.array(text.split()).astype(np.float64)
    except ValueError as error:
        raise FileError(
            f"{path}, line {element.line}: the {element.kind.lower()} of element {element.label} holds something that is no "
            f"number ({error}); {_REMEDY}"
        ) from None
    square = from_triangle(values, n)
    if square is not None:
        return square
    raise FileError(
        f"{path}, line {element.line}: the {element.kind.lower()} of element {element.label} has {len(values)} values; "
        f"{n} degrees of freedom need {n * (n + 1) // 2} (symmetric) or {n * n}; {_REMEDY}"
    )

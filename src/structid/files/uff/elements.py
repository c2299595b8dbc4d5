"""Elements of universal files: dataset 2412.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, dataset 2412.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from structid.core.errors import FileError
from structid.files.uff.datasets import UffDataset, integers

#: Order in which the nodes of the cells stand in a file, as places among those of VTK; mid-side nodes stand between corners.
_ORDERS = {
    "triangle6": (0, 3, 1, 4, 2, 5),
    "quad8": (0, 4, 1, 5, 2, 6, 3, 7),
    "tetra10": (0, 4, 1, 5, 2, 6, 7, 8, 9, 3),
    "wedge15": (0, 6, 1, 7, 2, 8, 12, 13, 14, 3, 9, 4, 10, 5, 11),
    "hexahedron20": (0, 8, 1, 9, 2, 10, 3, 11, 16, 17, 18, 19, 4, 12, 5, 13, 6, 14, 7, 15),
    "line3": (0, 2, 1),
}
#: Cell type by the descriptor of an element: rods, beams, plane stress and strain, plates, membranes, shells, solids.
_CELLS = {
    11: "line", 21: "line", 22: "line", 24: "line3",
    **{
        base + k: kind
        for base in (40, 50, 60, 90)
        for k, kind in ((1, "triangle"), (2, "triangle6"), (4, "quad"), (5, "quad8"))
    },
    71: "quad", 72: "triangle6", 74: "triangle", 75: "quad8",  # membranes have it the other way
    111: "tetra", 112: "wedge", 113: "wedge15", 115: "hexahedron", 116: "hexahedron20", 118: "tetra10",
}  # fmt: skip
_COUNTS = {
    "line": 2, "line3": 3, "triangle": 3, "triangle6": 6, "quad": 4, "quad8": 8, "tetra": 4, "tetra10": 10, "wedge": 6,
    "wedge15": 15, "hexahedron": 8, "hexahedron20": 20,
}  # fmt: skip
#: Elements that have a line more, with their orientation.
_BEAMS = (11, 21, 22, 23, 24)
#: A tapered beam of I-DEAS, and a line with a node in its middle where Salome writes three nodes.
_SALOME_CURVE = 22
_AXISYMMETRIC = range(81, 86)
_BESIDE = {
    121: "rigid bar", 122: "rigid element", 136: "spring between nodes", 137: "rotational spring between nodes",
    138: "spring to ground", 139: "rotational spring to ground", 141: "damper between nodes", 142: "damper to ground",
    151: "gap between nodes", 152: "gap to ground", 161: "lumped mass",
}  # fmt: skip
_EDGES = {
    "line": ((0, 1),),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "hexahedron": (
        *((0, 1), (1, 2), (2, 3), (3, 0)), *((4, 5), (5, 6), (6, 7), (7, 4)), *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class UniversalElements:
    """Elements of a universal file.

    Attributes
    ----------
    nodes : dict of str to list of lists of int
        Node labels of the elements of each cell type, in the order of VTK.
    labels : dict of str to list of int
        Their labels.
    beside : Counter of str
        How many there are of what is no cell: masses, springs, rigid elements.
    """

    nodes: dict[str, list[list[int]]] = field(default_factory=dict)
    labels: dict[str, list[int]] = field(default_factory=dict)
    beside: Counter[str] = field(default_factory=Counter)

    def edges(self) -> list[tuple[int, int]]:
        """Pairs of corner nodes (lower label first) that an element edge joins, each once."""
        pairs = (
            (row[i], row[j])
            for kind, rows in self.nodes.items()
            for row in rows
            for i, j in _EDGES[kind.rstrip("0123456789")]
        )
        return list(dict.fromkeys((min(pair), max(pair)) for pair in pairs))


def read_elements(path: Path, blocks: Sequence[UffDataset]) -> UniversalElements:
    """The elements in the datasets 2412 among `blocks`, all datasets of the universal file at `path`.

    Raises
    ------
    FileError
        If a dataset is damaged, or an element is axisymmetric or lacks nodes.
    """
    elements, rows = UniversalElements(), dict[int, tuple[str, list[int]]]()
    for block in blocks:
        if block.number == 2412:
            _add_elements(f"{path}: dataset {block.ordinal} (2412)", block.lines, elements, rows)
    return elements


def _add_elements(
    where: str, lines: list[str], elements: UniversalElements, rows: dict[int, tuple[str, list[int]]]
) -> None:
    """Add the elements in the `lines` of one dataset 2412 to `elements`; a repeated element counts once.

    `rows` has cell type and nodes of the elements so far by label, and is added to. Elements of types without a cell
    are only counted, by name. `where` names the dataset in errors. `FileError` if an element is damaged, axisymmetric,
    lacks nodes, or stands there twice with other nodes.
    """
    row_index = 0
    while row_index < len(lines):
        label, descriptor, *_, count = row_of_integers(where, lines, row_index, 6)
        begin = row_index + (2 if descriptor in _BEAMS else 1)
        row_index = begin + -(-count // 8)
        if not 1 <= count <= 60 or row_index > len(lines):
            raise FileError(f"{where} has {count} nodes in element {label}, or ends within it; export the mesh again")
        nodes = [node for index in range(begin, row_index) for node in row_of_integers(where, lines, index, 8)][:count]
        if descriptor in _AXISYMMETRIC:
            raise FileError(
                f"{where}: element {label} is axisymmetric (type {descriptor}); model the part in plates or solids"
            )
        kind = "line3" if descriptor == _SALOME_CURVE and count == 3 else _CELLS.get(descriptor)
        if kind is None:
            elements.beside[_BESIDE.get(descriptor, f"element of type {descriptor}")] += 1
            continue
        if len(nodes) != _COUNTS[kind] or 0 in nodes:
            raise FileError(
                f"{where}: element {label} of type {descriptor} has {sum(node > 0 for node in nodes)} nodes instead of"
                f" {_COUNTS[kind]}; give all of them, or corners only"
            )
        order = _ORDERS.get(kind, range(len(nodes)))
        row = [0] * len(nodes)
        for position, node in zip(order, nodes, strict=True):
            row[position] = node
        first = rows.setdefault(label, (kind, row))
        if first != (kind, row):
            raise FileError(f"{where} gives element {label} twice, with other nodes; number the elements anew")
        if first[1] is row:
            elements.nodes.setdefault(kind, []).append(row)
            elements.labels.setdefault(kind, []).append(label)


def row_of_integers(where: str, lines: list[str], row_index: int, count: int) -> list[int]:
    """The first `count` whole numbers of line `row_index` of `lines`, in columns of ten characters; blanks count as 0.

    Raises `FileError`, which begins with `where`, if there is no such line or it holds something else.
    """
    if row_index >= len(lines):
        raise FileError(f"{where} ends within an element or group; export the mesh again")
    try:
        return integers(lines[row_index], (10,) * count)
    except ValueError:
        raise FileError(
            f"{where} must hold whole numbers in its line {row_index + 1}, got {lines[row_index][:60]!r}; export the mesh again"
        ) from None

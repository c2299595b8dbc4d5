"""Nodes and elements of a universal file: positions in global coordinates, and the axes along which motion is given.

A node has two coordinate systems: that of its position (definition) and that of its motion (displacement). Both are Cartesian,
cylindrical (r, theta in deg, z) or spherical (r, theta from the third axis in deg, phi about it in deg), in a place and turned as
dataset 18 or 2420 says.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 15, 18, 781, 2411, 2412, 2420.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError
from structid.files.uff.datasets import (
    UffDataset,
    integers,
    read_blocks,
    read_reals,
    read_unit_factors,
    real_number,
    reals,
)

Point = tuple[float, float, float]

_CARTESIAN, _CYLINDRICAL, _SPHERICAL = range(3)
#: Labels that stand for the global axes where no dataset defines them.
_GLOBAL = (0, 1)
_SQUARE = 1e-4
#: Distance of two origins, m, that is rounding beside an origin at 0.
_SAME_PLACE = 1e-9
#: Distance from an axis, as a part of the distance from the origin, at which no direction around it is left.
_ON_AXIS = 1e-9
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
class CoordinateSystem:
    """A coordinate system in global axes.

    Attributes
    ----------
    label : int
    kind : int
        0 Cartesian, 1 cylindrical, 2 spherical.
    origin : (3,) float array
        m.
    axes : (3, 3) float array
        Its axes as rows.
    """

    label: int
    kind: int
    origin: FloatArray
    axes: FloatArray

    def point(self, coordinates: Sequence[float], scale: float) -> FloatArray:
        """Global position in m, (3,), of three `coordinates` in this system.

        They are x, y, z; or radius, angle, z; or radius, polar angle, azimuth. `scale` turns lengths into m; angles are
        in deg, the polar one from the z axis.
        """
        first, second, third = coordinates
        if self.kind == _CARTESIAN:
            local = np.array([first, second, third]) * scale
        elif self.kind == _CYLINDRICAL:
            angle = np.deg2rad(second)
            local = np.array([first * np.cos(angle), first * np.sin(angle), third]) * scale
        else:
            polar, around = np.deg2rad(second), np.deg2rad(third)
            local = (
                first
                * scale
                * np.array([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
            )
        return np.asarray(self.origin + local @ self.axes)

    def axes_at(self, point: FloatArray) -> FloatArray | None:
        """Directions in which a motion at the global `point` (m) is given, as rows in global axes, (3, 3).

        They are x, y, z; or radial, tangential, z; or radial, polar, azimuthal. None on the polar axis of a cylindrical
        or spherical system.
        """
        if self.kind == _CARTESIAN:
            return self.axes
        x, y, z = self.axes @ (point - self.origin)
        distance = np.hypot(x, y)
        if distance <= _ON_AXIS * max(
            float(np.abs(point - self.origin).max()), float(np.abs(self.origin).max()), 1e-300
        ):
            return None
        outward, around = np.array([x, y, 0.0]) / distance, np.array([-y, x, 0.0]) / distance
        if self.kind == _CYLINDRICAL:
            local = np.stack([outward, around, [0.0, 0.0, 1.0]])
        else:
            radius = np.hypot(distance, z)
            sine, cosine = distance / radius, z / radius
            local = np.stack([
                sine * outward + [0.0, 0.0, cosine], cosine * outward - [0.0, 0.0, sine], around
            ])  # fmt: skip
        return np.asarray(local @ self.axes)


@dataclass(frozen=True, eq=False)
class UniversalNodes:
    """Nodes of a universal file.

    Attributes
    ----------
    path : Path
        For messages.
    points : dict of int to (x, y, z)
        Global position of each node label, m.
    turned : dict of int to (3, 3) float array
        Axes, as rows in global axes, along which the motion of a node is given; nodes that move along the global axes are
        left out. A motion u along them is ``u @ axes`` in global axes, and the global motion v is ``axes @ v`` along them.
    unknown : dict of int to str
        Why the axes of a node cannot be told.
    """

    path: Path
    points: dict[int, Point]
    turned: dict[int, FloatArray] = field(default_factory=dict)
    unknown: dict[int, str] = field(default_factory=dict)

    def axes(self, node: int, remedy: str = "export the coordinate systems too (dataset 2420)") -> FloatArray | None:
        """Axes of the motion at `node` as rows, (3, 3); None where they are the global ones or the file has no such node.

        Raises
        ------
        FileError
            If the file does not tell them; the message ends with `remedy`.
        """
        if node in self.unknown:
            raise FileError(f"{self.path}: {self.unknown[node]}; {remedy}")
        return self.turned.get(node)


def read_nodes(path: Path, blocks: Sequence[UffDataset] | None = None) -> UniversalNodes:
    """The nodes of datasets 15, 781 and 2411 of the universal file at `path`, in m and global axes.

    A node in several of them is taken from the last of 15, 781, 2411; the latter two have more digits. Labels 0 and 1
    stand for the global axes where the file does not define them. A node whose directions of motion are not known is
    listed with the reason, one with turned directions with its axes (3, 3).

    Parameters
    ----------
    path : Path
        The universal file.
    blocks : sequence of UffDataset, optional
        Datasets of the file, if they were read already.

    Raises
    ------
    FileError
        If a dataset is damaged, a node has two positions in one kind of dataset or motions along different axes in two,
        or its position is in a coordinate system that is not defined.
    """
    blocks = read_blocks(path) if blocks is None else blocks
    factors = read_unit_factors(path, blocks)
    scale = 1.0 if factors is None else 1 / factors.length
    systems = _read_systems(path, blocks, scale)
    rows = {number: _read_node_rows(path, [b for b in blocks if b.number == number]) for number in (15, 781, 2411)}
    nodes: dict[int, _Node] = {}
    for number in rows:
        for label, node in rows[number].items():
            _require_one_motion(path, label, nodes.get(label, node), node, systems)
        nodes.update(rows[number])
    points: dict[int, Point] = {}
    turned: dict[int, FloatArray] = {}
    unknown: dict[int, str] = {}
    for label, node in nodes.items():
        definition = systems.get(node.definition)
        if definition is None and node.definition not in _GLOBAL:
            raise FileError(
                f"{path}: the position of node {label} is in coordinate system {node.definition}, which the file does not define;"
                " export the coordinate systems too (dataset 2420), or positions in global coordinates"
            )
        position = (
            np.array(node.coordinates) * scale if definition is None else definition.point(node.coordinates, scale)
        )
        x, y, z = position.tolist()
        points[label] = (x, y, z)
        displacement = systems.get(node.displacement)
        if displacement is None:
            if node.displacement not in _GLOBAL:
                unknown[label] = (
                    f"the motion of node {label} is given in coordinate system {node.displacement}, which the file does not define"
                )
            continue
        axes = displacement.axes_at(position)
        if axes is None:
            unknown[label] = (
                f"node {label} lies on the axis of coordinate system {node.displacement}, in which its motion is given and which"
                " has no directions there"
            )
        elif not np.allclose(axes, np.eye(3), atol=1e-12, rtol=0):
            turned[label] = axes
    return UniversalNodes(path, points, turned, unknown)


@dataclass(frozen=True)
class _Node:
    definition: int
    displacement: int
    coordinates: tuple[float, ...]


def _read_node_rows(path: Path, tables: Sequence[UffDataset]) -> dict[int, _Node]:
    """Nodes by label in `tables`, datasets of the same number (15, 781 or 2411), as the file has them.

    Raises `FileError` if a line cannot be read, a position is not finite, or a node is stated twice in different ways.
    """
    nodes: dict[int, _Node] = {}
    for block in tables:
        where, lines = f"{path}: dataset {block.ordinal} ({block.number})", block.lines
        step = 1 if block.number == 15 else 2
        if len(lines) % step:
            raise FileError(f"{where} ends within a node; export the geometry again")
        for line_index in range(0, len(lines), step):
            try:
                label, definition, displacement, *coordinates = (
                    _short_node(lines[line_index])
                    if step == 1
                    else _long_node(lines[line_index], lines[line_index + 1])
                )
            except ValueError as error:
                raise FileError(
                    f"{where} must hold a node in its line {line_index + 1}, got {lines[line_index][:80]!r};"
                    " export the geometry again"
                ) from error
            if not np.isfinite(coordinates).all():
                raise FileError(f"{where}: the position of node {int(label)} is not finite; export the geometry again")
            node = _Node(int(definition), int(displacement), tuple(coordinates))
            if nodes.setdefault(int(label), node) != node:
                raise FileError(f"{where} gives node {int(label)} two positions; keep one")
    return nodes


def _require_one_motion(
    path: Path, label: int, first: _Node, other: _Node, systems: Mapping[int, CoordinateSystem]
) -> None:
    """Raise `FileError` if two datasets of a node give its motion along different axes.

    `path` and `label` of the node are for the message. `first` and `other` are the node's entries, `systems` the
    coordinate systems by label. Labels 0 and 1 are the same axes unless `systems` defines them.
    """
    named = {node.displacement for node in (first, other)}
    named = {0 if system in _GLOBAL and system not in systems else system for system in named}
    if len(named) > 1:
        raise FileError(
            f"{path}: node {label} stands in two datasets, with its motion in coordinate systems {first.displacement} and"
            f" {other.displacement}; keep one"
        )


def _short_node(line: str) -> list[float]:
    """Label, two coordinate systems (definition, displacement) and three coordinates of one line of dataset 15.

    Seven words are taken as fields, any other line by columns. `ValueError` if it cannot be read.
    """
    words = line.split()
    if len(words) == 7:
        return [*map(int, words[:3]), *map(real_number, words[4:])]
    return [*integers(line[:40], (10,) * 4)[:3], *reals(line[40:], (13,) * 3)]


def _long_node(first: str, second: str) -> list[float]:
    """Label, two coordinate systems (definition, displacement) and three coordinates of a node of dataset 2411 or 781.

    `first` and `second` are its two lines. Raises `ValueError` if they cannot be read.
    """
    coordinates = read_reals(second.encode("ascii", errors="replace"))
    if coordinates.size != 3:
        raise ValueError(f"{coordinates.size} coordinates")
    return [*integers(first, (10,) * 4)[:3], *coordinates.tolist()]


def _read_systems(path: Path, blocks: Sequence[UffDataset], scale: float) -> dict[int, CoordinateSystem]:
    """Coordinate systems of datasets 18 and 2420 by their labels, in global axes; `scale` turns the file's lengths into m.

    Raises `FileError` if one is damaged, or defined twice in different ways.
    """
    systems: dict[int, CoordinateSystem] = {}
    for block in blocks:
        if block.number == 2420:
            for system in _matrix_systems(path, block, scale):
                _add_system(path, systems, system)
    by_points: dict[int, tuple[str, int, int, FloatArray]] = {}
    for block in blocks:
        if block.number == 18:
            for label, stated in _point_systems(path, block):
                first = by_points.setdefault(label, stated)
                if first[1:3] != stated[1:3] or not np.array_equal(first[3], stated[3]):
                    raise _defined_twice(path, label)
    for label in by_points:
        _add_system(path, systems, _resolve_point_system(path, label, by_points, systems, scale, ()))
    return systems


def _add_system(path: Path, systems: dict[int, CoordinateSystem], system: CoordinateSystem) -> None:
    """Add `system` to `systems` by its label; `FileError` if another definition has that label.

    Definitions are the same if kind and axes (to 1e-4) and origins (to 1e-4 of their size) agree.
    """
    other = systems.setdefault(system.label, system)
    same = other.kind == system.kind and np.allclose(other.axes, system.axes, atol=_SQUARE)
    size = max(float(np.abs(other.origin).max()), float(np.abs(system.origin).max()))
    if not (same and np.abs(other.origin - system.origin).max() <= _SQUARE * size + _SAME_PLACE):
        raise _defined_twice(path, system.label)


def _defined_twice(path: Path, label: int) -> FileError:
    return FileError(f"{path}: defines coordinate system {label} twice, differently; keep one")


def _kind(where: str, label: int, kind: int) -> int:
    """The number `kind` of the type of coordinate system `label`; `FileError`, which begins with `where`, if it is unknown."""
    if kind not in (_CARTESIAN, _CYLINDRICAL, _SPHERICAL):
        raise FileError(
            f"{where}: coordinate system {label} is of type {kind}; it must be 0 (Cartesian), 1 (cylindrical) or 2 (spherical)"
        )
    return kind


def _matrix_systems(path: Path, block: UffDataset, scale: float) -> list[CoordinateSystem]:
    """Coordinate systems of one dataset 2420, in m and global axes; its matrices have the axes in rows, then the origin.

    `scale` turns lengths of the file into m. Raises `FileError` unless the axes are of length 1, at right angles and
    right-handed.
    """
    where, lines = f"{path}: dataset {block.ordinal} (2420)", block.lines
    systems = []
    for first_line in range(2, len(lines), 6):
        try:
            label, kind = integers(lines[first_line], (10, 10, 10))[:2]
            matrix = read_reals(
                "\n".join(lines[first_line + 2 : first_line + 6]).encode("ascii", errors="replace")
            ).reshape(4, 3)
        except ValueError as error:
            raise FileError(f"{where} is damaged near its line {first_line + 1} ({error}); export it again") from error
        axes = matrix[:3]
        if (
            not np.isfinite(matrix).all()
            or np.abs(axes @ axes.T - np.eye(3)).max() > _SQUARE
            or np.linalg.det(axes) < 0
        ):
            raise FileError(
                f"{where}: the axes of coordinate system {label} must be three rows of length 1 at right angles, right-handed;"
                " correct them or export it again"
            )
        systems.append(CoordinateSystem(label, _kind(where, label, kind), matrix[3] * scale, axes))
    return systems


def _point_systems(path: Path, block: UffDataset) -> list[tuple[int, tuple[str, int, int, FloatArray]]]:
    """Definitions in one dataset 18, in order, as label and (place for errors, type, reference system, points (3, 3)).

    The points are in the unit of the file and in the reference system: origin, one on +x, one in the +xz plane.
    `FileError` if one is damaged or defined in another way.
    """
    where, lines = f"{path}: dataset {block.ordinal} (18)", block.lines
    systems = []
    for first_line in range(0, len(lines), 4):
        try:
            label, kind, reference, _, method = integers(lines[first_line], (10,) * 5)
            numbers = read_reals(
                "\n".join(lines[first_line + 2 : first_line + 4]).encode("ascii", errors="replace")
            ).reshape(3, 3)
        except ValueError as error:
            raise FileError(f"{where} is damaged near its line {first_line + 1} ({error}); export it again") from error
        if method not in (0, 1):
            raise FileError(
                f"{where}: coordinate system {label} is defined by method {method}; only 1 is described (origin, point on +x,"
                " point in the +xz plane): export it so"
            )
        systems.append((label, (where, _kind(where, label, kind), reference, numbers)))
    return systems


def _resolve_point_system(
    path: Path,
    label: int,
    by_points: dict[int, tuple[str, int, int, FloatArray]],
    systems: dict[int, CoordinateSystem],
    scale: float,
    above: tuple[int, ...],
) -> CoordinateSystem:
    """The coordinate system `label` of dataset 18 in global axes and m, resolved through its chain of reference systems.

    `by_points` has the definitions of dataset 18, `systems` the systems that are known, `above` the labels on the way here;
    `scale` is the file's unit of length in m. Raises `FileError` if the chain runs in a circle or to a system that is not
    defined, or the three points lie on a line.
    """
    where, kind, reference, numbers = by_points[label]
    if label in above:
        raise FileError(f"{where}: coordinate system {label} refers to itself; correct the reference system")
    if reference in by_points:
        base = _resolve_point_system(path, reference, by_points, systems, scale, (*above, label))
        points = np.array([base.point(row, scale) for row in numbers.tolist()])
    elif reference in systems:
        points = np.array([systems[reference].point(row, scale) for row in numbers.tolist()])
    elif reference in _GLOBAL:
        points = numbers * scale
    else:
        raise FileError(
            f"{where}: coordinate system {label} refers to {reference}, which the file does not define; export it too"
        )
    first, upper = points[1] - points[0], points[2] - points[0]
    second = np.cross(upper, first)
    lengths = np.linalg.norm(first), np.linalg.norm(second)
    if not (np.isfinite(points).all() and lengths[0] > 0 and lengths[1] > 1e-9 * lengths[0] * np.linalg.norm(upper)):
        raise FileError(
            f"{where}: the three points of coordinate system {label} must not lie on one line; correct them"
        )
    x_axis, y_axis = first / lengths[0], second / lengths[1]
    return CoordinateSystem(label, kind, points[0], np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)]))


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

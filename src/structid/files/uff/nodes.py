"""Nodes of a universal file in global coordinates, and the axes along which their motion is given.

A node has two coordinate systems: that of its position (definition) and that of its motion (displacement). Both are Cartesian,
cylindrical (r, theta in deg, z) or spherical (r, theta from the third axis in deg, phi about it in deg), in a place and turned as
dataset 18 or 2420 says.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 15, 18, 781, 2411, 2420.
"""

from __future__ import annotations

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

"""Surfaces of Abaqus and CalculiX input files: faces of elements or nodes, and where points are on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import is_whole_number
from structid.fem.elements.cells import CELLS, CellShape
from structid.fem.meshes.abaqus_assembly import Assembly, PartData
from structid.fem.meshes.abaqus_keywords import KeywordBlock, number_of

#: Corners of the faces S1, S2, ... of solids, counted from 0.
_FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "pyramid": ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
#: Ends of the sides with middle nodes, in the order of these.
_EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "tetra": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "hexahedron": (
        *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}
_FACETS = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8"}
_SHELLS = ("triangle", "quad", "triangle6", "quad8")
_SIDES = ("SPOS", "SNEG", "POS", "NEG")
_STEPS, _CLOSE = 30, 1e-12


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface of a file.

    Attributes
    ----------
    faces : list of (tuple of int, bool)
        Labels in the mesh of each face, corners before middles, and whether it is a shell.
    nodes : list of int
        All of its nodes, each once.
    weights : dict of int to float
        Weight of each node of a surface of nodes in a coupling that distributes; all 1 where none is stated, else those that
        are not stated 0. Empty for surfaces of faces.
    """

    faces: list[tuple[tuple[int, ...], bool]]
    nodes: list[int]
    weights: dict[int, float] = field(default_factory=dict)


class Surfaces:
    """The surfaces of an assembly by their names.

    Parameters
    ----------
    assembly : Assembly
    kind_of : callable
        Cell type and number of nodes of an element type.
    """

    def __init__(self, assembly: Assembly, kind_of: Callable[[str], tuple[str, int]]) -> None:
        self._assembly, self._kind_of = assembly, kind_of

    def read(self, scope: PartData, name: str) -> Surface:
        """The surface that is called `name` in `scope`, or ``INSTANCE.NAME``: its faces and nodes, by mesh labels.

        `scope` is a part, an instance or the assembly; other instances are searched after it. A surface of nodes has no
        faces.

        Raises
        ------
        ValueError
            If there is none, or it is of a kind that is not read.
        """
        holder, block = self._block(scope, name)
        if block.options.keys() & {"COMBINE", "CROP", "MAX RATIO"}:
            raise ValueError(f"surface {name!r} is made of others")
        kind = block.options.get("TYPE", "ELEMENT").upper()
        rows = [[word for word in row if word] for row in block.rows if any(row)]
        if kind == "NODE":
            are_stated = any(len(row) > 1 for row in rows)
            weights = {
                node: number_of(row[1]) if len(row) > 1 else float(not are_stated)
                for row in rows
                for node in self._assembly.nodes(holder, row[0])
            }
            return Surface([], list(weights), weights)
        if kind != "ELEMENT":
            raise ValueError(f"surface {name!r} is of type {kind}")
        faces = []
        for row in rows:
            if len(row) < 2:
                raise ValueError(f"surface {name!r} names no faces, so that all free ones are meant")
            for owner, label in self._members(holder, row[0]):
                faces.append(self._face(owner, label, row[1].upper()))
        return Surface(faces, list(dict.fromkeys(node for face, _ in faces for node in face)))

    def _block(self, scope: PartData, name: str) -> tuple[PartData, KeywordBlock]:
        """The part, instance or assembly with the *SURFACE block called `name`, and that block.

        ``INSTANCE.NAME`` is looked for in that instance, other names in `scope` first, then in the assembly and all its
        instances. Raises `ValueError` if there is none.
        """
        assembly_part = self._assembly.own
        owner, dot, bare = name.replace('"', "").upper().rpartition(".")
        every = [*([assembly_part] if assembly_part is not None else []), *self._assembly.scopes]
        holders = [self._assembly.scope(owner)] if dot else [scope, *(other for other in every if other is not scope)]
        for holder in holders:
            for block in holder.blocks:
                if block.keyword == "SURFACE" and block.options.get("NAME", "").upper() == bare:
                    return holder, block
        raise ValueError(f"there is no surface {name!r}")

    def _members(self, scope: PartData, word: str) -> Iterable[tuple[PartData, int]]:
        """Elements that `word` names, a set or a label, as pairs of the instance (or assembly) and the label in it.

        ``INSTANCE.SET`` is looked up in that instance, other names in `scope`. Raises `ValueError` if there is no such
        set.
        """
        owner, dot, bare = word.replace('"', "").rpartition(".")
        holder = self._assembly.scope(owner) if dot else scope
        if is_whole_number(bare):
            return [(holder, int(bare))]
        key = bare.upper()
        if holder is self._assembly.own and key in self._assembly.cell_sets:
            by_owner = self._assembly.cell_sets[key]
            return [
                (holder if owner == holder.name.upper() else self._assembly.scope(owner), label)
                for owner, labels in by_owner.items()
                for label in sorted(labels)
            ]
        if key not in holder.cell_sets:
            raise ValueError(f"there is no element set {word!r}")
        return [(holder, label) for label in sorted(holder.cell_sets[key])]

    def _face(self, scope: PartData, label: int, side: str) -> tuple[tuple[int, ...], bool]:
        """Labels in the mesh of the nodes of a face, corners before middles, and True if the element is a shell.

        `label` is that of the element in its `scope`; `side` is S1, S2, ... of a solid, or a side of a shell such as
        SPOS. Raises `ValueError` if there is no such element or face.
        """
        for name, table in scope.elements.items():
            if label in table:
                kind = self._kind_of(name)[0]
                nodes = [self._assembly.node(scope, word) for word in table[label]]
                break
        else:
            raise ValueError(f"there is no element {label}")
        if kind in _SHELLS and side in _SIDES:
            return tuple(nodes), True
        solid = kind.rstrip("0123456789")
        number = int(side[1:]) - 1 if side[:1] == "S" and is_whole_number(side[1:]) else -1
        if solid not in _FACES or not 0 <= number < len(_FACES[solid]):
            raise ValueError(f"face {side} of element {label} ({name}) is not read")
        corners = _FACES[solid][number]
        middles: list[int] = []
        if kind in ("tetra10", "wedge15", "hexahedron20"):
            edges = [frozenset(edge) for edge in _EDGES[solid]]
            first = len(nodes) - len(edges)
            pairs = zip(corners, (*corners[1:], corners[0]), strict=True)
            middles = [nodes[first + edges.index(frozenset(pair))] for pair in pairs]
        elif kind != solid:
            raise ValueError(f"faces of {name} are not read")
        return (*(nodes[corner] for corner in corners), *middles), False


def nodal_areas(surface: Surface, positions: Callable[[int], FloatArray]) -> dict[int, float]:
    """Area that belongs to each node of a surface, the integral of its interpolation, by label.

    In the square of the unit of `positions`, which returns that of a label. Raises `ValueError` for quadratic faces.
    """
    areas: dict[int, float] = {}
    for face, _ in surface.faces:
        if len(face) > 4:
            raise ValueError("its faces are quadratic, whose nodes have no areas of their own")
        shape = CELLS[_FACETS[len(face)]]
        points = np.array([positions(node) for node in face])
        tangents = shape.slopes(shape.mass_points) @ points
        sizes = np.linalg.norm(np.cross(tangents[:, 0], tangents[:, 1]), axis=1)
        for node, area in zip(face, (shape.mass_weights * sizes) @ shape.values(shape.mass_points), strict=True):
            areas[node] = areas.get(node, 0.0) + float(area)
    return areas


@dataclass(frozen=True, eq=False)
class Footpoint:
    """The point of a face that is nearest to a point.

    Attributes
    ----------
    distance : float
    weights : (n_nodes,) float array
        Weights of the nodes in the interpolation at that point.
    motion : (n_nodes, 3, 3) float array
        Displacement of the other point, carried by the face at its distance, per displacement of each node; exact
        for rigid motion.
    """

    distance: float
    weights: FloatArray
    motion: FloatArray


def footpoint(point: FloatArray, corners: FloatArray) -> Footpoint:
    """The point of a face nearest to `point` (3,), with the interpolation there and the motion it gives to `point`.

    `corners` (n_nodes, 3) are positions of all nodes of the face, 3, 4, 6 or 8, in the unit of `point`. The result has
    the distance, the weights (n_nodes,) of the interpolation, and the motion (n_nodes, 3, 3) of `point`, carried by the
    face, by that of each node.
    """
    shape = CELLS[_FACETS[len(corners)]]
    local = _nearest(shape, point, corners)
    weights = shape.values(local[None])[0]
    slopes = shape.slopes(local[None])[0]
    tangents = slopes @ corners
    away = point - weights @ corners
    metric = np.linalg.inv(tangents @ tangents.T)
    reciprocal = metric @ tangents
    normal = np.cross(tangents[0], tangents[1])
    normal /= np.linalg.norm(normal)
    within = reciprocal @ away  # parts of `away` along the tangents, which turn with these
    motion = (weights + within @ slopes)[:, None, None] * np.eye(3)
    turning = np.einsum("ak,ai,j->kij", slopes, reciprocal, normal)
    motion = motion - float(away @ normal) * turning
    rounded = np.round(motion)
    motion = np.where(np.abs(motion - rounded) < 1e-9, rounded, motion)
    return Footpoint(float(np.linalg.norm(away)), weights, motion)


def _nearest(shape: CellShape, point: FloatArray, corners: FloatArray) -> FloatArray:
    """Reference coordinates (2,) of the point of a face nearest to `point`, by Gauss-Newton steps that stay on it.

    `point` is (3,), `corners` (n_nodes, 3) are the positions of all nodes of the face, whose interpolation is `shape`.
    The first step begins at the middle of the face; at most 30 are made.
    """
    local = shape.corners.mean(axis=0)
    for _ in range(_STEPS):
        tangents = shape.slopes(local[None])[0] @ corners
        away = point - shape.values(local[None])[0] @ corners
        step = np.linalg.lstsq(tangents.T, away, rcond=None)[0]
        moved = _on_face(shape, local + step, tangents)
        if np.abs(moved - local).max() < _CLOSE:
            break
        local = moved
    return local


def _on_face(shape: CellShape, local: FloatArray, tangents: FloatArray) -> FloatArray:
    """The point (2,) of the reference square or triangle of `shape` nearest to `local` (2,), itself if it is inside.

    Distances are those that `tangents` (2, 3), the derivatives of the position, give.
    """
    is_square = shape.name.startswith("quad")
    sides = [((-1, -1), (1, -1)), ((1, -1), (1, 1)), ((1, 1), (-1, 1)), ((-1, 1), (-1, -1))]
    sides = sides if is_square else [((0, 0), (1, 0)), ((1, 0), (0, 1)), ((0, 1), (0, 0))]
    inside = (np.abs(local) <= 1).all() if is_square else bool((local >= 0).all() and local.sum() <= 1)
    if inside:
        return local
    best, least = local, np.inf
    for start, end in ((np.array(a, float), np.array(b, float)) for a, b in sides):
        along, gap = (end - start) @ tangents, (local - start) @ tangents
        share = float(np.clip(gap @ along / (along @ along), 0.0, 1.0))
        distance = float(np.linalg.norm(gap - share * along))
        if distance < least:
            best, least = start + share * (end - start), distance
    return best


def mean_side(faces: Sequence[FloatArray]) -> float:
    """Mean length of the sides of `faces`, by their corners alone.

    Each face is an array (3, 4, 6 or 8 nodes, 3) of positions.
    """
    lengths = []
    for positions in faces:
        corners = positions[: {3: 3, 6: 3, 4: 4, 8: 4}[len(positions)]]
        lengths += np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).tolist()
    return float(np.mean(lengths))

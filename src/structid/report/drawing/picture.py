"""Parts of a drawing of a structure, in drawing units, and the projection of space to paper.

Cells of a mesh are faces: plates and shells whole, solids by the outer faces that the eye sees.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.report.rendering import plot

_AZIMUTH, _ELEVATION = np.radians(-62.0), np.radians(22.0)
#: Paper's directions of the global axes, one a row, of structures that fill space.
SPACE_AXES = np.array(
    [
        [-np.sin(_AZIMUTH), -np.sin(_ELEVATION) * np.cos(_AZIMUTH)],
        [np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH)],
        [0.0, np.cos(_ELEVATION)],
    ]
)
#: Of those that lie in the plane of X and Y.
PLANE_AXES = np.array([[1.0, 0.0], [0.0, 1.0], [-0.5, -0.5]])


@dataclass(frozen=True, eq=False)
class Mark:
    """Drawing of one element or of one of its faces.

    Attributes
    ----------
    element, index, label : str, int, str
        Element set, which of its elements, and the name of that.
    path : (n, 2) float array
        What is drawn; NaN lifts the pen.
    filled : bool
        Whether it is an area.
    centre : (2,) float array
    nodes : tuple of int
        Of a face.
    outline : (n, 2) float array
        Of a face, from node to node.
    """

    element: str
    index: int
    label: str
    path: FloatArray
    filled: bool
    centre: FloatArray
    nodes: tuple[int, ...] = ()
    outline: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Picture:
    """A structure on paper: elements, what stands before and behind them, and what the reader should know (`notes`).

    `bounds` are left, right, bottom and top.
    """

    behind: tuple[plot.Trace, ...]
    marks: tuple[Mark, ...]
    before: tuple[plot.Trace, ...]
    bounds: tuple[float, float, float, float]
    notes: tuple[str, ...]

    @property
    def aspect(self) -> float:
        """Width over height."""
        left, right, bottom, top = self.bounds
        return (right - left) / (top - bottom)

    @property
    def is_wide(self) -> bool:
        """True if panels belong below instead of beside each other."""
        return self.aspect > 1.6


def curve(path: FloatArray, pen: plot.Pen, label: str = "") -> plot.Curve:
    """Plot curve along `path` (n, 2), where NaN rows lift the pen."""
    return plot.Curve(path[:, 0], path[:, 1], pen, label=label)


def points(positions: FloatArray, texts: tuple[str, ...], marker: plot.Marker = plot.UNSEEN) -> plot.Curve:
    """Points at `positions` (n, 2) that show `texts` under the mouse; invisible by default."""
    return plot.Curve(positions[:, 0], positions[:, 1], None, marker, hover=texts)


def is_spatial(structure: Structure) -> bool:
    """True if the structure has three dimensions and nodes at different heights Z."""
    return structure.dimension == 3 and len({place[2] for place in structure.nodes.values()}) > 1


def paper_axes(structure: Structure) -> FloatArray:
    """Directions on paper of the global axes, (3, 2): a row for each of X, Y and Z."""
    return SPACE_AXES if is_spatial(structure) else PLANE_AXES


def sight(structure: Structure) -> FloatArray:
    """Unit vector towards the viewer in global axes, (dimension,); zero for structures in one or two dimensions."""
    if is_spatial(structure):
        return np.cross(*SPACE_AXES.T)
    return np.array([0.0, 0.0, 1.0])[: structure.dimension]


#: Corners of the faces of a solid cell by its number of corners, each in order round the face.
SOLID_FACES = {
    4: ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    5: ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
SOLID_CORNERS = {4: 4, 10: 4, 5: 5, 6: 6, 15: 6, 8: 8, 20: 8, 27: 8}
#: Corners of a flat cell by its number of nodes.
AREA_CORNERS = {3: 3, 6: 3, 4: 4, 8: 4, 9: 4}
#: Size of a flat cell as drawn, so that a gap shows between neighbours.
_SHRUNK = 0.94
#: Nodes times faces beyond which no node of cells is drawn.
_MOST_PAIRS = 20_000_000
#: Marks beyond which names of element sets are not moved to where they are seen best.
_MOST_LABELLED = 1000


def is_cells(element: ElementSet) -> bool:
    """True if an element set is drawn by `cell_faces`."""
    return bool(element.cells)


def cell_faces(structure: Structure, points: Mapping[int, FloatArray]) -> list[Mark]:
    """Marks for drawing cells, farthest first: one for each plate or shell cell, and for each visible outer face of a solid.

    Parameters
    ----------
    structure : Structure
    points : mapping of node to (2,) float array
        Position of each node on paper.
    """
    eye = sight(structure)
    faces = _seen_faces(structure, eye)
    for element in structure.elements:
        if element.symbol in ("flat", "shell"):
            rows = (row[row >= 0] for row in element.nodes)
            faces += [(element, index, row[: AREA_CORNERS[len(row)]]) for index, row in enumerate(rows)]
    marks: list[tuple[float, Mark]] = []
    for element, index, nodes in faces:
        outline = np.array([points[int(n)] for n in nodes])
        if not _is_counter_clockwise(outline):  # else overlapping ones would cut holes into each other
            outline, nodes = outline[::-1], nodes[::-1]
        centre = outline.mean(axis=0)
        share = _SHRUNK if element.symbol == "flat" else 1.0
        name = element.name if len(element.nodes) == 1 else f"{element.name}:{index + 1}"
        labels = tuple(int(n) for n in nodes)
        depth = float(np.mean([structure.nodes[n] @ eye for n in labels]))
        path = centre + share * (outline - centre)
        marks.append((depth, Mark(element.name, index, name, path, True, centre, labels, outline)))
    return [mark for _, mark in sorted(marks, key=lambda pair: pair[0])]


def cell_edges(element: ElementSet) -> list[tuple[int, int]]:
    """Pairs of corner nodes of the edges of every cell of `element`; for solids of the outer faces only.

    An edge that two cells share occurs twice.
    """
    rows = [np.asarray(row[row >= 0]) for row in element.nodes]
    if element.symbol == "solid":
        outlines = [nodes for _, nodes in _outer_faces(rows)]
    else:
        outlines = [row[: AREA_CORNERS[len(row)]] for row in rows]
    return [
        (int(first), int(second))
        for outline in outlines
        for first, second in zip(outline, np.roll(outline, -1), strict=True)
    ]


def _is_counter_clockwise(outline: FloatArray) -> bool:
    x, y = outline.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) >= 0


def _seen_faces(structure: Structure, eye: FloatArray) -> list[tuple[ElementSet, int, IntArray]]:
    """Outer faces of all solids that the viewer sees: element set, element's row in it, and corner nodes.

    `eye` (3,) is the direction towards the viewer.
    """
    owners = [(e, index) for e in structure.elements if e.symbol == "solid" for index in range(len(e.nodes))]
    rows = [np.asarray(e.nodes[index]) for e, index in owners]
    rows = [row[row >= 0] for row in rows]
    facing: list[tuple[ElementSet, int, IntArray]] = []
    for number, nodes in _outer_faces(rows):
        corners = np.array([structure.nodes[int(n)] for n in nodes])
        middle = np.mean([structure.nodes[int(n)] for n in rows[number]], axis=0)
        normal = np.cross(corners[1] - corners[0], corners[-1] - corners[0])
        outward = normal * np.sign(normal @ (corners.mean(axis=0) - middle))
        if outward @ eye > 0:
            facing.append((*owners[number], nodes))
    return facing


def _outer_faces(rows: list[IntArray]) -> list[tuple[int, IntArray]]:
    """Faces that belong to a single cell, as pairs of cell number and corner nodes, (3,) or (4,) labels.

    `rows` holds the nodes (n_nodes,) of each cell.
    """
    faces = [
        (index, row[list(face)]) for index, row in enumerate(rows) for face in SOLID_FACES[SOLID_CORNERS[len(row)]]
    ]
    count = Counter(tuple(sorted(nodes.tolist())) for _, nodes in faces)
    return [(index, nodes) for index, nodes in faces if count[tuple(sorted(nodes.tolist()))] == 1]


def hidden_nodes(structure: Structure, points: Mapping[int, FloatArray], marks: Sequence[Mark]) -> frozenset[int]:
    """Nodes of cells that faces hide from view, by label; empty for structures in a plane or without faces.

    Nodes of cells that are no corner of a face in `marks`, such as inner ones of solids, count as hidden; a node of
    another element never does. If nodes times faces exceed 20 million, all nodes that only cells have are hidden.
    `points` are node positions (2,) on paper, `marks` those of `cell_faces`.
    """
    faces = [mark for mark in marks if mark.nodes]
    if not is_spatial(structure) or not faces:
        return frozenset()
    own = {int(n) for e in structure.elements if is_cells(e) for n in np.unique(e.nodes) if n >= 0}
    own -= {int(n) for e in structure.elements if not is_cells(e) for n in np.unique(e.nodes)}
    labels = np.array(sorted(own), dtype=np.int64)
    if len(labels) * len(faces) > _MOST_PAIRS:
        return frozenset(own)
    coordinates = np.array([points[int(n)] for n in labels]).reshape(-1, 2)
    depth = np.array([structure.nodes[int(n)] @ sight(structure) for n in labels])
    slack = 1e-3 * float(np.ptp(coordinates, axis=0).max(initial=0.0))
    covered = np.zeros(len(labels), dtype=bool)
    for mark in faces:
        corners = np.array([points[n] for n in mark.nodes])
        heights = np.array([structure.nodes[n] @ sight(structure) for n in mark.nodes])
        plane = np.linalg.lstsq(np.column_stack([corners, np.ones(len(corners))]), heights, rcond=1e-9)[0]
        behind = depth < coordinates @ plane[:2] + plane[2] - slack
        covered |= _is_inside(corners, coordinates) & behind & ~np.isin(labels, mark.nodes)
    seen = {node for mark in faces for node in mark.nodes}
    return frozenset(labels[covered].tolist()) | (own - seen)


def _is_inside(corners: FloatArray, points: FloatArray) -> np.ndarray:
    """Mask (n,) of the `points` (n, 2) that lie in the convex polygon with the corners `corners` (m, 2), in order round it."""
    sides = np.roll(corners, -1, axis=0) - corners
    away = points[:, None] - corners
    turns = sides[:, 0] * away[:, :, 1] - sides[:, 1] * away[:, :, 0]
    return np.asarray((turns >= 0).all(axis=1) | (turns <= 0).all(axis=1))


def labelled_marks(marks: Sequence[Mark]) -> list[Mark]:
    """Mark of each element set at which its name is written: the nearest face whose centre no other set covers.

    The last mark of the set if there is no such face, or if there are more than 1000 `marks`. These are in drawing
    order, farthest first.
    """
    last = {mark.element: mark for mark in marks}
    open_: dict[str, Mark] = {}
    for k, mark in reversed(list(enumerate(marks))):
        if not mark.nodes or mark.element in open_ or len(marks) > _MOST_LABELLED:
            continue
        others = (m for m in marks[k + 1 :] if m.nodes and m.element != mark.element)
        if not any(_is_inside(m.path, mark.centre[None])[0] for m in others):
            open_[mark.element] = mark
    return list((last | open_).values())

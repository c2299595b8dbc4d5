"""Outlines of all elements of a mesh on paper, farthest first: cells, the outer faces of solids, and lines."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.report.drawing.projection import PLANE_AXES, SPACE_AXES
from structid.structure import Solid, Structure
from structid.structure.elements import ElementSet

#: Corners of the faces of a solid cell by its number of corners, each in order round the face.
_FACES = {
    4: ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    5: ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
_SOLID_CORNERS = {4: 4, 10: 4, 5: 5, 6: 6, 15: 6, 8: 8, 20: 8, 27: 8}
#: Corners of a flat cell by its number of nodes.
AREA_CORNERS = {3: 3, 6: 3, 4: 4, 8: 4, 9: 4}


@dataclass(frozen=True, eq=False)
class Outlines:
    """What a drawing of a mesh consists of.

    Attributes
    ----------
    paths : list of (n_corners, 2) float arrays
        Corners on paper: two of a line, three or more of an area.
    owners : list of (str, int)
        Element set and number of the element that each path belongs to.
    axes : (dimension, 2) float array
        Projection from space to paper.
    """

    paths: list[FloatArray]
    owners: list[tuple[str, int]]
    axes: FloatArray

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates on paper."""
        corners = np.concatenate(self.paths)
        return corners.min(axis=0), corners.max(axis=0)

    def projected(self, points: FloatArray) -> FloatArray:
        """Points of the structure on paper, (n, 2)."""
        return points @ self.axes


def outlines(structure: Structure) -> Outlines:
    """The outlines of all elements of `structure` that have an extent."""
    labels = np.array(list(structure.nodes))
    table = np.array([structure.nodes[int(label)] for label in labels], dtype=float)
    order = np.argsort(labels)
    is_flat = table.shape[1] < 3 or float(np.ptp(table[:, 2])) == 0
    axes = PLANE_AXES[: table.shape[1]] if is_flat else SPACE_AXES
    sight = np.array([0.0, 0.0, 1.0])[: table.shape[1]] if is_flat else np.cross(*SPACE_AXES.T)
    paths: list[FloatArray] = []
    owners: list[tuple[str, int]] = []
    depth: list[float] = []
    for element in structure.elements:
        for index, nodes in _shapes(element):
            at = table[order[np.searchsorted(labels[order], nodes)]]
            paths.append(at @ axes)
            owners.append((element.name, index))
            depth.append(float((at @ sight).mean()))
    sorted_ = np.argsort(depth, kind="stable")
    return Outlines([paths[k] for k in sorted_], [owners[k] for k in sorted_], axes)


def _shapes(element: ElementSet) -> list[tuple[int, IntArray]]:
    """Number of the element and nodes of each outline."""
    rows = [row[row >= 0] for row in np.asarray(element.nodes)]
    if isinstance(element, Solid):
        return outer_faces(rows)
    return [
        (index, row[: AREA_CORNERS.get(len(row), len(row))])
        for index, row in enumerate(rows)
        if len(row) > 1 and len(np.unique(row)) == len(row)
    ]


def outer_faces(rows: list[IntArray]) -> list[tuple[int, IntArray]]:
    """The faces that only one cell has."""
    faces = [(index, row[list(face)]) for index, row in enumerate(rows) for face in _FACES[_SOLID_CORNERS[len(row)]]]
    count = Counter(tuple(sorted(nodes.tolist())) for _, nodes in faces)
    return [(index, nodes) for index, nodes in faces if count[tuple(sorted(nodes.tolist()))] == 1]

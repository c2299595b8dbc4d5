"""Flat facets in space: their own axes, their corners in the plane, and matrices turned into global axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.elements.cells.isoparametric import require_none

_FLAT = 1e-12
#: Distance of corners from the plane of a quadrilateral over the square root of its area.
_MOST_WARPED = 0.1


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles or quadrilaterals with axes of their own.

    Attributes
    ----------
    corners : (n_cells, n_corners, 2) float array
        In the facet's axes, counter-clockwise about the third, m.
    axes : (n_cells, 3, 3) float array
        Rows are the facet's axes in global ones; the third is the normal.
    height : (n_cells, n_corners) float array
        Of the nodes above the plane, m; zero but for warped quadrilaterals.
    """

    corners: FloatArray
    axes: FloatArray
    height: FloatArray

    def in_space(self, local: FloatArray) -> FloatArray:
        """Matrices on (u, v, w, rotations) of each corner in the facet's axes, turned to global axes, (n_cells, 6 n, 6 n).

        Nodes out of the plane are joined to it by rigid links along the normal.
        """
        n_cells, n = self.height.shape
        if self.height.any():
            links = self._links()
            local = np.swapaxes(links, 1, 2) @ local @ links
        triples = local.reshape(n_cells, 2 * n, 3, 2 * n, 3)
        turned = np.einsum("eac,eiajb->eicjb", self.axes, triples, optimize=True)
        turned = np.einsum("eicjb,ebd->eicjd", turned, self.axes, optimize=True)
        return turned.reshape(local.shape)

    def to_facet(self, maps: FloatArray) -> FloatArray:
        """Maps (..., 6 n) of the first facet's motion, in its axes, as maps of motion in global axes."""
        n = self.height.shape[1]
        linked = maps @ self._links()[0]
        return (linked.reshape(*maps.shape[:-1], 2 * n, 3) @ self.axes[0]).reshape(maps.shape)

    def _links(self) -> FloatArray:
        """From motion at the nodes to motion of the corners in the plane below them, (n_cells, 6 n, 6 n)."""
        n_cells, n = self.height.shape
        links = np.tile(np.eye(6 * n), (n_cells, 1, 1))
        for k in range(n):
            links[:, 6 * k, 6 * k + 4] = -self.height[:, k]
            links[:, 6 * k + 1, 6 * k + 3] = self.height[:, k]
        return links


def facets(name: str, nodes: IntArray, positions: FloatArray) -> Facets:
    """Flat facets of cells in space: their axes, and their corners in the plane.

    Parameters
    ----------
    name : str
        Name of the element set, for messages.
    nodes : (n_cells, 3 or 4) int array
        Labels, for messages.
    positions : (n_cells, 3 or 4, 3) float array
        m.

    Raises
    ------
    InputError
        If a facet has no area, or is too far from flat.
    """
    n = positions.shape[1]
    if n == 3:
        first, second = positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]
        along = first
    else:
        first, second = positions[:, 2] - positions[:, 0], positions[:, 3] - positions[:, 1]
        along = first - second
    normal = np.cross(first, second)
    twice = np.linalg.norm(normal, axis=1)
    size = np.ptp(positions, axis=1).max(axis=1)
    require_none(twice <= _FLAT * size**2, name, nodes, "has no area", "remove it, or repair the mesh")
    normal = normal / twice[:, None]
    x = along / np.linalg.norm(along, axis=1)[:, None]
    axes = np.stack([x, np.cross(normal, x), normal], axis=1)
    inside = np.einsum("eij,ekj->eki", axes, positions - positions.mean(axis=1, keepdims=True))
    height = inside[:, :, 2].copy()
    height[np.abs(height) <= 1e-10 * size[:, None]] = 0.0
    warped = np.abs(height).max(axis=1) > _MOST_WARPED * np.sqrt(twice / 2)
    require_none(warped, name, nodes, "is too far from flat", "divide it into two triangles, or refine the mesh")
    return Facets(inside[:, :, :2], axes, height)

"""Thin shells of flat facets in space: stretching and bending of triangles and quadrilaterals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import Limits
from structid.core.dof import DIRECTIONS
from structid.fem.elements.cells.cells import cell_positions
from structid.fem.elements.cells.drilling_membrane import drilling_stiffness
from structid.fem.elements.cells.elastic import plane_law, unit_mass
from structid.fem.elements.cells.isoparametric import require_none
from structid.fem.elements.cells.kirchhoff import bending_stiffness, plate_mass
from structid.fem.elements.element import Matrices, Positions, declared, element
from structid.fem.elements.plate import ThinSet

_FLAT = 1e-12
#: Distance of corners from the plane of a quadrilateral over the square root of its area.
_MOST_WARPED = 0.1


@element
class Shell(ThinSet):
    """Thin shells of flat facets: all six degrees of freedom at each corner, whose positions are on the middle surface.

    Notes
    -----
    Bending is that of `Plate` (discrete Kirchhoff, no shear strain). Stretching is the membrane of Felippa (2003), in which
    the rotation about the normal is that of the material, so that no spring holds it. Rotary inertia is
    thickness^3 / 12 times density about all three axes: about the normal this is none of nature's, and changes
    in-plane waves of wave number k by (k thickness)^2 / 96 in frequency, but every degree of freedom has mass.
    Corners of a warped quadrilateral are joined to its mean plane by rigid links.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18, 1655-1677;
    Felippa (2003), Comput. Methods Appl. Mech. Engrg. 192, 2125-2168.
    """

    moves = DIRECTIONS

    linear_strains: Annotated[float, "float", Limits(above=0, most=1)] = declared(
        "Share of the stiffness against strains that vary linearly within a facet. 1 is exact for webs one cell deep that"
        " bend in their plane; less spares thin curved shells, whose facets meet at angles, a false stiffness",
        default=0.1,
    )

    def matrices(self, positions: Positions, present: IntArray) -> Matrices:
        """Element matrices of density and Young's modulus, for stretching and bending; see `ElementSet.matrices`."""
        corners = cell_positions(self.name, self.nodes, positions, 3)
        law = plane_law(self.poisson, strain=False)
        stretching = partial(_stretching, law=law, poisson=self.poisson, linear_strains=self.linear_strains)
        return {
            "density": (
                self.matrix_term(corners, _mass, power=1),
                self.matrix_term(corners, _rotary_inertia, power=3, directions=DIRECTIONS[3:]),
            ),
            "youngs_modulus": (
                self.matrix_term(corners, stretching, power=1),
                self.matrix_term(corners, partial(_bending, law=law), power=3),
            ),
        }


def _stretching(
    name: str, nodes: IntArray, at: FloatArray, cell: str, law: FloatArray, poisson: float, linear_strains: float
) -> FloatArray:
    flat = facets(name, nodes, at)
    return flat.in_space(_on_all_coordinates(drilling_stiffness(flat.corners, law, poisson, linear_strains), (0, 1, 5)))


def _bending(name: str, nodes: IntArray, at: FloatArray, cell: str, law: FloatArray) -> FloatArray:
    flat = facets(name, nodes, at)
    return flat.in_space(_on_all_coordinates(bending_stiffness(name, nodes, flat.corners, cell, law), (2, 3, 4)))


def _mass(name: str, nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
    flat = facets(name, nodes, at)
    across = _on_all_coordinates(plate_mass(name, nodes, flat.corners, cell), (2, 3, 4))
    return flat.in_space(across + _on_all_coordinates(unit_mass(name, nodes, flat.corners, cell), (0, 1)))


def _rotary_inertia(name: str, nodes: IntArray, at: FloatArray, cell: str) -> FloatArray:
    linear = unit_mass(name, nodes, facets(name, nodes, at).corners, cell)[:, ::2, ::2]
    return np.einsum("eij,kl->eikjl", linear / 12, np.eye(3)).reshape(len(nodes), 3 * nodes.shape[1], -1)


def _on_all_coordinates(small: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Matrices on some coordinates (`axes`) of each corner as matrices on all six, (n_cells, 6 n, 6 n)."""
    n = small.shape[1] // len(axes)
    rows = np.ravel([[6 * k + axis for axis in axes] for k in range(n)])
    full = np.zeros((len(small), 6 * n, 6 * n))
    full[:, rows[:, None], rows[None]] = small
    return full


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
            links = np.tile(np.eye(6 * n), (n_cells, 1, 1))
            for k in range(n):
                links[:, 6 * k, 6 * k + 4] = -self.height[:, k]
                links[:, 6 * k + 1, 6 * k + 3] = self.height[:, k]
            local = np.swapaxes(links, 1, 2) @ local @ links
        triples = local.reshape(n_cells, 2 * n, 3, 2 * n, 3)
        turned = np.einsum("eac,eiajb->eicjb", self.axes, triples, optimize=True)
        turned = np.einsum("eicjb,ebd->eicjd", turned, self.axes, optimize=True)
        return turned.reshape(local.shape)


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

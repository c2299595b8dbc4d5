"""Thin shells of flat facets in space: stretching and bending of triangles and quadrilaterals.

Membranes whose corners turn about the normal: the triangle is the optimal one of Felippa (2003), constant strains by
lumped tractions, which pass the patch test, and on top of them the linear strains that corner rotations beyond the mean
rotation make, with coefficients for which pure bending in the plane is exact at every aspect ratio of a rectangle of
triangles. The rotation is that of the material, and its stiffness that of the material: no spring holds it. A
quadrilateral is the mean of its two divisions into triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import Limits
from structid.core.dof import DIRECTIONS
from structid.fem.elements.cells import cell_positions, require_none
from structid.fem.elements.elastic import plane_elasticity, unit_mass
from structid.fem.elements.element import Matrices, NodeCoordinates, declared, element
from structid.fem.elements.plate import ThinSet, bending_stiffness, centre_curvatures, plate_mass

_FLAT = 1e-12
#: Distance of corners from the plane of a quadrilateral over the square root of its area.
_MOST_WARPED = 0.1
#: Share of side rotations in the lumped tractions (alpha_b of the reference).
_TRACTIONS = 1.5
#: Natural strains along the sides from corner rotations, at corner 1 (beta_1 to beta_9 of the reference).
_STRAINS = np.array([[1.0, 2.0, 1.0], [0.0, 1.0, -1.0], [-1.0, -1.0, -2.0]])
_LEAST_HIGHER = 0.01
_DIVISIONS = ((0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3))


@dataclass(frozen=True, eq=False)
class _Facets:
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
        """Matrices on all six motions of each corner, turned from the facet's axes to global axes, (n_cells, 6 n, 6 n).

        `local` (n_cells, 6 n, 6 n) are those in the facet's axes, corner by corner. Nodes out of the plane are joined
        to it by rigid links along the normal.
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
        """The `maps` (..., 6 n) of motion in the first facet's axes as maps of global node motion, (..., 6 n)."""
        n = self.height.shape[1]
        linked = maps @ self._links()[0]
        return (linked.reshape(*maps.shape[:-1], 2 * n, 3) @ self.axes[0]).reshape(maps.shape)

    def _links(self) -> FloatArray:
        """Maps from motion at the nodes to motion of corners in the facet plane, (n_cells, 6 n, 6 n), in facet axes.

        A node at a height above the plane is joined to its corner by a rigid link along the normal.
        """
        n_cells, n = self.height.shape
        links = np.tile(np.eye(6 * n), (n_cells, 1, 1))
        for k in range(n):
            links[:, 6 * k, 6 * k + 4] = -self.height[:, k]
            links[:, 6 * k + 1, 6 * k + 3] = self.height[:, k]
        return links


def facets(name: str, nodes: IntArray, positions: FloatArray) -> _Facets:
    """Flat facets of cells in space: their axes, corners in the plane and heights above it.

    The first axis runs along the first side of a triangle, and between the midpoints of two opposite sides of a
    quadrilateral.

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
        If a facet has no area, or a corner is farther from its plane than a tenth of the square root of the area.
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
    return _Facets(inside[:, :, :2], axes, height)


#: Part of global X in the plane of a facet below which X is its normal.
_ALONG_NORMAL = 0.01


@element
class Shell(ThinSet):
    """Thin shells of flat facets: all six degrees of freedom at each corner, whose positions are on the middle surface.

    Notes
    -----
    Bending is that of `Plate` (discrete Kirchhoff, no shear strain). Stretching is the membrane of Felippa (2003), in
    which the rotation about the normal is that of the material, so that no spring holds it. Rotary inertia is
    thickness^3 / 12 times density about all three axes: about the normal this is none of nature's, and changes in-plane
    waves of wave number k by (k thickness)^2 / 96 in frequency, but every degree of freedom has mass. Corners of a
    warped quadrilateral are joined to its mean plane by rigid links.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18,
    1655-1677; Felippa (2003), Comput. Methods Appl. Mech. Engrg. 192, 2125-2168.
    """

    moves = DIRECTIONS
    symbol = "shell"

    linear_strains: Annotated[float, "float", Limits(above=0, most=1)] = declared(
        "Share of the stiffness against strains that vary linearly within a facet. 1 is exact for webs one cell deep that"
        " bend in their plane; less spares thin curved shells, whose facets meet at angles, a false stiffness",
        default=0.1,
    )

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices by property, for unit density (mass, rotary inertia) and unit modulus (stretching, bending).

        They are for unit thickness to the power that they go with, 1 or 3. `positions` are node coordinates in m by
        label; `used_codes` (degrees of freedom of other elements) are not needed. Raises `InputError` if a facet has no
        area or is far from flat.
        """
        corners = cell_positions(self.name, self.nodes, positions, 3)
        elasticity = plane_elasticity(self.poisson, strain=False)
        stretching = partial(
            _stretching, elasticity=elasticity, poisson=self.poisson, linear_strains=self.linear_strains
        )
        return {
            "density": (
                self.matrix_term(corners, _mass, power=1),
                self.matrix_term(corners, _rotary_inertia, power=3, directions=DIRECTIONS[3:]),
            ),
            "youngs_modulus": (
                self.matrix_term(corners, stretching, power=1),
                self.matrix_term(corners, partial(_bending, elasticity=elasticity), power=3),
            ),
        }

    def centre_strains(self, positions: NodeCoordinates, row: int) -> tuple[FloatArray, FloatArray]:
        """Maps from the motion of the element in `row` to in-plane strains, and to strains per height, at its centre.

        Both are (3, 6 n_corners), 1 and 1/m: strains are xx, yy and engineering xy on axes in the element's plane with
        x near global X (Y where the normal runs along X), motions the six global ones corner by corner. `positions` of
        nodes in m.
        """
        nodes = self.nodes[row][self.nodes[row] >= 0][None]
        flat = facets(self.name, nodes, cell_positions(self.name, nodes, positions, 3))
        n = nodes.shape[1]
        maps = np.zeros((2, 3, n, 6))
        maps[0][..., [0, 1, 5]] = mean_strains(flat.corners).reshape(3, n, 3)
        bending = centre_curvatures(self.name, nodes, flat.corners, self.cells[n])
        maps[1][..., [2, 3, 4]] = bending.reshape(3, n, 3)
        membrane, curvature = (
            _turned_strains(flat.axes[0]) @ each for each in flat.to_facet(maps.reshape(2, 3, 6 * n))
        )
        return membrane, curvature


def _turned_strains(axes: FloatArray) -> FloatArray:
    """Map (3, 3) of strains (xx, yy, engineering xy) from a facet's axes to axes in its plane with x near global X.

    That x is the part of global X in the plane, or of global Y where the normal runs along X to about half a degree.
    `axes` (3, 3) has the facet's axes as rows.
    """
    c, s = axes[:2, 0]
    if np.hypot(c, s) < _ALONG_NORMAL:
        c, s = axes[:2, 1]
    c, s = c / np.hypot(c, s), s / np.hypot(c, s)
    return np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])


def _stretching(
    name: str,
    nodes: IntArray,
    points: FloatArray,
    cell: str,
    elasticity: FloatArray,
    poisson: float,
    linear_strains: float,
) -> FloatArray:
    flat = facets(name, nodes, points)
    return flat.in_space(
        _on_all_coordinates(drilling_stiffness(flat.corners, elasticity, poisson, linear_strains), (0, 1, 5))
    )


def _bending(name: str, nodes: IntArray, points: FloatArray, cell: str, elasticity: FloatArray) -> FloatArray:
    """Bending stiffness of shells in global axes, (n_cells, n_local, n_local), for unit modulus and thickness cubed.

    `elasticity` (3, 3) gives plane stress from strain for unit modulus. `points` are the corners in m; `name` and
    `nodes` are those of the element set, for errors.
    """
    flat = facets(name, nodes, points)
    return flat.in_space(_on_all_coordinates(bending_stiffness(name, nodes, flat.corners, cell, elasticity), (2, 3, 4)))


def _mass(name: str, nodes: IntArray, points: FloatArray, cell: str) -> FloatArray:
    """Mass matrices of shells of unit mass per area, in global axes, (n_cells, n_local, n_local).

    `points` are the corners in m, `name` and `nodes` those of the element set, for errors. Turning of the thickness is
    left out.
    """
    flat = facets(name, nodes, points)
    across = _on_all_coordinates(plate_mass(name, nodes, flat.corners, cell), (2, 3, 4))
    return flat.in_space(across + _on_all_coordinates(unit_mass(name, nodes, flat.corners, cell), (0, 1)))


def _rotary_inertia(name: str, nodes: IntArray, points: FloatArray, cell: str) -> FloatArray:
    """Mass matrices of the turning of shells, for unit density times thickness cubed, (n_cells, 3 n, 3 n)."""
    linear = unit_mass(name, nodes, facets(name, nodes, points).corners, cell)[:, ::2, ::2]
    return np.einsum("eij,kl->eikjl", linear / 12, np.eye(3)).reshape(len(nodes), 3 * nodes.shape[1], -1)


def _on_all_coordinates(small: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Matrices on some coordinates (`axes`, 0 to 5) of each corner as matrices on all six, (n_cells, 6 n, 6 n).

    `small` (n_cells, m n, m n) are those matrices, corner by corner, m the number of `axes`; other entries are zero.
    """
    n = small.shape[1] // len(axes)
    rows = np.ravel([[6 * k + axis for axis in axes] for k in range(n)])
    full = np.zeros((len(small), 6 * n, 6 * n))
    full[:, rows[:, None], rows[None]] = small
    return full


def drilling_stiffness(
    corners: FloatArray, elasticity: FloatArray, poisson: float, linear_strains: float = 1.0
) -> FloatArray:
    """Stiffness for unit thickness on (u, v, rotation about the normal) at each corner, (n_cells, 3 n, 3 n).

    n is the number of corners. A quadrilateral is the mean of its two divisions into triangles.

    Parameters
    ----------
    corners : (n_cells, 3 or 4, 2) float array
        Counter-clockwise, m.
    elasticity : (3, 3) float array
        Plane stress from strain for unit modulus.
    poisson : float
        Poisson's ratio; (1 - 4 poisson^2) / 2, but at least 0.01, multiplies the stiffness against linear strains.
    linear_strains : float
        Further factor on that stiffness; 1 gives the element of the reference, exact for in-plane bending.

    References
    ----------
    Felippa (2003), Comput. Methods Appl. Mech. Engrg. 192, 2125-2168 (the element called OPT).
    """
    higher = linear_strains * max(0.5 * (1 - 4 * poisson**2), _LEAST_HIGHER)
    n = corners.shape[1]
    if n == 3:
        return _triangle_stiffness(corners, elasticity, higher)
    total = np.zeros((len(corners), 3 * n, 3 * n))
    for division in _DIVISIONS:
        rows = np.ravel([[3 * k, 3 * k + 1, 3 * k + 2] for k in division])
        total[:, rows[:, None], rows] += 0.5 * _triangle_stiffness(corners[:, division], elasticity, higher)
    return total


def mean_strains(corners: FloatArray) -> FloatArray:
    """Maps (n_cells, 3, 3 n_corners) to the mean strains (xx, yy, engineering xy) of cells, from their corner motions.

    These are (u, v, rotation) corner by corner. The maps are L' / area of the lumped tractions L. `corners`
    (n_cells, 3 or 4, 2) are positions in m, counter-clockwise.
    """
    n = corners.shape[1]
    divisions, fraction = (((0, 1, 2),), 1.0) if n == 3 else (_DIVISIONS, 0.5)
    total = np.zeros((len(corners), 3, 3 * n))
    area = np.zeros(len(corners))
    for division in divisions:
        rows = np.ravel([[3 * k, 3 * k + 1, 3 * k + 2] for k in division])
        total[:, :, rows] += fraction * np.swapaxes(_lumped_tractions(corners[:, division]), 1, 2)
        area += fraction * _area(corners[:, division])
    return total / area[:, None, None]


def _triangle_stiffness(corners: FloatArray, elasticity: FloatArray, higher: float) -> FloatArray:
    """Stiffness of triangles on (u, v, rotation) of each corner for unit thickness, (n_cells, 9, 9).

    `corners` (n_cells, 3, 2) are positions in m, `elasticity` (3, 3) is stress from strain in plane stress, and
    `higher` the factor on the stiffness against linear strains.
    """
    area = _area(corners)
    tractions = _lumped_tractions(corners)
    basic = tractions @ elasticity @ np.swapaxes(tractions, 1, 2) / area[:, None, None]
    beyond = _rotation_beyond_mean(corners, area)
    natural = _strain_from_natural(corners)
    inner = np.swapaxes(natural, 1, 2) @ elasticity @ natural
    at_corners = _natural_strains(corners, area)
    total = np.zeros((len(corners), 3, 3))
    for a, b in ((0, 1), (1, 2), (2, 0)):  # a rule of three points, at the middles of the sides
        middle = 0.5 * (at_corners[a] + at_corners[b])
        total += np.swapaxes(middle, 1, 2) @ inner @ middle
    linear = 0.75 * higher * area[:, None, None] * total
    stiffness = basic + np.swapaxes(beyond, 1, 2) @ linear @ beyond
    return 0.5 * (stiffness + np.swapaxes(stiffness, 1, 2))


def _area(corners: FloatArray) -> FloatArray:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _lumped_tractions(corners: FloatArray) -> FloatArray:
    """Nodal forces (u, v, rotation of each corner) of unit constant stresses (xx, yy, xy), (n_cells, 9, 3).

    `corners` (n_cells, 3, 2) are positions.
    """
    forces = np.zeros((len(corners), 9, 3))
    for k in range(3):
        before, after = corners[:, (k + 2) % 3], corners[:, (k + 1) % 3]
        x, y = (before - after).T  # of corner k: x32 and y32
        next_x, next_y = (corners[:, k] - after).T  # x12, y12
        last_x, last_y = (before - corners[:, k]).T  # x31, y31
        forces[:, 3 * k, 0] = forces[:, 3 * k + 1, 2] = -y
        forces[:, 3 * k + 1, 1] = forces[:, 3 * k, 2] = x
        forces[:, 3 * k + 2, 0] = -_TRACTIONS / 6 * y * (next_y - last_y)
        forces[:, 3 * k + 2, 1] = _TRACTIONS / 6 * x * (last_x - next_x)
        forces[:, 3 * k + 2, 2] = _TRACTIONS / 3 * (next_x * next_y - last_x * last_y)
    return forces / 2


def _rotation_beyond_mean(corners: FloatArray, area: FloatArray) -> FloatArray:
    """Map from corner displacements and rotations to corner rotations less the mean rotation, (n_cells, 3, 9).

    `corners` (n_cells, 3, 2) are positions, `area` (n_cells,) that of each cell.
    """
    maps = np.zeros((len(corners), 3, 9))
    for k in range(3):
        x, y = (corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3]).T
        maps[:, :, 3 * k] = (x / area / 4)[:, None]
        maps[:, :, 3 * k + 1] = (y / area / 4)[:, None]
        maps[:, k, 3 * k + 2] = 1.0
    return maps


def _side(corners: FloatArray, k: int) -> FloatArray:
    """Vectors from corner `k` to the next corner, (n_cells, 2)."""
    return corners[:, (k + 1) % 3] - corners[:, k]


def _strain_from_natural(corners: FloatArray) -> FloatArray:
    """Map from strains along the sides 12, 23, 31 to strains (xx, yy, engineering xy), (n_cells, 3, 3).

    `corners` (n_cells, 3, 2) are positions.
    """
    rows = np.empty((len(corners), 3, 3))
    for k in range(3):
        side = _side(corners, k)
        c, s = (side / np.linalg.norm(side, axis=1)[:, None]).T
        rows[:, k] = np.stack([c**2, s**2, c * s], axis=1)
    return np.linalg.inv(rows)


def _natural_strains(corners: FloatArray, area: FloatArray) -> list[FloatArray]:
    """Strains along the three sides at each corner per corner rotation: three maps (n_cells, 3, 3), one a corner.

    Rows are sides, columns the rotations beyond the mean one. `corners` (n_cells, 3, 2) are positions, `area`
    (n_cells,) that of each cell.
    """
    sides = np.stack([(_side(corners, k) ** 2).sum(axis=1) for k in range(3)], axis=1)
    scale = 2 * area[:, None, None] / 3 / sides[:, :, None]
    turned = (np.roll(_STRAINS, (k, k), axis=(0, 1)) for k in range(3))
    return [scale * each for each in turned]

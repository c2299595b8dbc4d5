"""Thin plates in bending: discrete Kirchhoff triangles and quadrilaterals.

Rotations of the normal are quadratic on a cell with straight sides. Along each side the deflection is the cubic of a
beam; at mid-side the rotation along the side is the slope of that cubic (no shear strain there), and the rotation
across it the mean of the two corners. What remains are deflection and two rotations at each corner (Batoz, Bathe and Ho
1980 for triangles; Batoz and Ben Tahar 1982 for quadrilaterals).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.elements.cells import (
    CELLS,
    DENSITY,
    POISSON,
    YOUNGS_MODULUS,
    CellSet,
    Poisson,
    box_rule,
    cell_positions,
    cell_table,
    gradients,
    triangle_rule,
)
from structid.fem.elements.elastic import plane_elasticity
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    element,
)

#: Cell types by number of nodes.
_PLATE_CELLS = {3: "triangle", 4: "quad"}
#: Cell that interpolates the rotations of a cell.
_ROTATIONS = {"triangle": "triangle6", "quad": "quad8"}


@element
class ThinSet(CellSet):
    """Thin triangles and quadrilaterals, of plates and shells."""

    cells = _PLATE_CELLS

    nodes: Nodes = declared(
        "Node labels, 3 (triangles) or 4 (quadrilaterals) an element; rows of a set with both end in -1",
        stored=cell_table(_PLATE_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    thickness: Values = declared(
        "Mass and stretching go with its first power, bending and rotary inertia with its third",
        "thickness",
        "m",
        positive=True,
    )
    poisson: Poisson = declared(POISSON)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)

    def centre_strains(self, positions: NodeCoordinates, row: int) -> tuple[FloatArray, FloatArray]:
        """Maps from an element's motion to the strains of its middle surface at its centre, and to those per height.

        Both are (3, n_coordinates): strains xx, yy and engineering xy, from what its corners move in, corner by corner.
        The axis x is the part of global X in the plane of the element, or of global Y where X is normal to it; height
        counts along the normal, about which the corners run counter-clockwise, and along Z in a plate.
        """
        raise NotImplementedError


@element
class Plate(ThinSet):
    """Thin plates in the x-y plane that bend: deflection Z and rotations RX, RY at each corner.

    Nodes are numbered in either sense; positions are 2-D, or 3-D with equal z in an element.

    Notes
    -----
    No shear strain and no rotary inertia: for wavelengths of more than about 20 thicknesses. Rotations of the sensor's
    node are RX = dw/dy and RY = -dw/dx.

    References
    ----------
    Batoz, Bathe and Ho (1980), Int. J. Numer. Meth. Eng. 15, 1771-1812; Batoz and Ben Tahar (1982), ibid. 18,
    1655-1677.
    """

    moves = ("Z", "RX", "RY")
    symbol = "flat"

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of density (mass) and Young's modulus (bending stiffness), by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        bending = partial(bending_stiffness, elasticity=plane_elasticity(self.poisson, strain=False))
        return {
            "density": (self.matrix_term(corners, plate_mass, power=1),),
            "youngs_modulus": (self.matrix_term(corners, bending, power=3),),
        }

    def centre_strains(self, positions: NodeCoordinates, row: int) -> tuple[FloatArray, FloatArray]:
        """Maps from the motion of the element in `row` to in-plane strains, all zero, and to strains per height (1/m).

        Both are (3, 3 n_corners), at the centre of the element: strains are xx, yy and engineering xy, motions (w,
        theta_x, theta_y) corner by corner. `positions` of nodes in m.
        """
        nodes = self.nodes[row][self.nodes[row] >= 0][None]
        corners = cell_positions(self.name, nodes, positions, 2)
        curvatures = centre_curvatures(self.name, nodes, corners, _PLATE_CELLS[nodes.shape[1]])[0]
        return np.zeros_like(curvatures), curvatures


def bending_stiffness(name: str, nodes: IntArray, corners: FloatArray, cell: str, elasticity: FloatArray) -> FloatArray:
    """Bending stiffness of thin plates for unit modulus and unit thickness cubed, (n_cells, 3 n_corners, 3 n_corners).

    Rows are the motions (w, theta_x, theta_y) corner by corner.

    Parameters
    ----------
    name : str
        Name of the element set, for messages.
    nodes : (n_cells, n_corners) int array
        Labels, for messages.
    corners : (n_cells, n_corners, 2) float array
        m.
    cell : {"triangle", "quad"}
    elasticity : (3, 3) float array
        Plane stress from strain for unit modulus; moments are elasticity / 12 times curvatures.
    """
    shape = CELLS[cell]
    gradients(name, nodes, corners, shape, shape.corners)  # so that a folded cell is told
    rotations = CELLS[_ROTATIONS[cell]]
    points, weights = (shape.points, shape.weights) if cell == "quad" else (rotations.points, rotations.weights)
    curvatures, determinant = _curvatures(name, nodes, corners, cell, points)
    total = np.zeros((len(nodes), 3 * shape.n_nodes, 3 * shape.n_nodes))
    for bending, weight in zip(curvatures, weights[:, None] * determinant, strict=True):
        total += np.swapaxes(bending, 1, 2) @ (elasticity / 12 @ bending * weight[:, None, None])
    return 0.5 * (total + np.swapaxes(total, 1, 2))


def centre_curvatures(name: str, nodes: IntArray, corners: FloatArray, cell: str) -> FloatArray:
    """Strains per height (xx, yy, engineering xy) at the centre of thin plates, (n_cells, 3, 3 n_corners).

    They are derivatives of the rotations (beta_x, beta_y) of the normal, from (w, theta_x, theta_y) at the corners; the
    other arguments are those of `bending_stiffness`.
    """
    centre = CELLS[cell].corners.mean(axis=0)[None]
    return _curvatures(name, nodes, corners, cell, centre)[0][0]


def _curvatures(
    name: str, nodes: IntArray, corners: FloatArray, cell: str, points: FloatArray
) -> tuple[list[FloatArray], FloatArray]:
    """Maps (n_cells, 3, 3 n) from corner motions to strains per height, for each point, and determinants.

    The determinants are (n_points, n_cells). Motions are (w, theta_x, theta_y) corner by corner, strains xx, yy and
    engineering xy; `points` are reference points. `corners` (n_cells, n, 2) are positions in m, `cell` is "triangle" or
    "quad"; `name` and `nodes` (labels) are for messages.
    """
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    rotations = CELLS[_ROTATIONS[cell]]
    slopes, determinant = gradients(name, nodes, np.concatenate([corners, middles], axis=1), rotations, points)
    tangent, n = _rotation_map(corners), rotations.n_nodes
    maps: list[FloatArray] = []
    for dx in slopes:
        rows = np.zeros((len(nodes), 3, n, 2))  # from (beta_x, beta_y)
        rows[:, 0, :, 0] = dx[:, 0]
        rows[:, 1, :, 1] = dx[:, 1]
        rows[:, 2, :, 0], rows[:, 2, :, 1] = dx[:, 1], dx[:, 0]
        maps.append(rows.reshape(len(nodes), 3, 2 * n) @ tangent)
    return maps, determinant


def _rotation_map(corners: FloatArray) -> FloatArray:
    """Map from (w, theta_x, theta_y) at corners to (beta_x, beta_y) at corners and mid-sides, (n_cells, 4 n, 3 n).

    `corners` (n_cells, n, 2) are positions in m. beta = -grad w without shear; theta_x = dw/dy = -beta_y and theta_y =
    -dw/dx = beta_x. Along a side w is cubic and beta across it linear.
    """
    n_cells, n, _ = corners.shape
    maps = np.zeros((n_cells, 2 * n, 2, n, 3))
    for k in range(n):
        maps[:, k, 0, k, 2] = 1.0
        maps[:, k, 1, k, 1] = -1.0
    sides = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(sides, axis=2)
    along = sides / length[:, :, None]
    for k in range(n):
        ends = (k, (k + 1) % n)
        at_middle = maps[:, n + k]
        mean = (maps[:, ends[0]] + maps[:, ends[1]]) / 2
        s = along[:, k]
        # slope of the cubic at the middle: 1.5 (w2 - w1) / l - (slopes at the ends) / 4, and slope = -beta along s
        tangential = -np.einsum("ed,edkc->ekc", s, mean) / 2
        tangential[:, ends[0], 0] += 1.5 / length[:, k]
        tangential[:, ends[1], 0] -= 1.5 / length[:, k]
        across = mean - s[:, :, None, None] * np.einsum("ed,edkc->ekc", s, mean)[:, None]
        at_middle += across + s[:, :, None, None] * tangential[:, None]
    return maps.reshape(n_cells, 4 * n, 3 * n)


def plate_mass(name: str, nodes: IntArray, corners: FloatArray, cell: str) -> FloatArray:
    """Mass matrices of plates for unit mass per area, (n_cells, 3 n_corners, 3 n_corners), integrated exactly.

    Rows are (w, theta_x, theta_y) corner by corner. Triangles take the nine functions of Bazeley, Cheung, Irons and
    Zienkiewicz (1965), quadrilaterals the twelve of Melosh (1963) on the reference square. Both hold every rigid motion
    exactly. `corners` (n_cells, n_corners, 2) are positions in m, `cell` is "triangle" or "quad"; `name` and `nodes`
    (labels) are for messages.
    """
    shape = CELLS[cell]
    corner_slopes = np.einsum("qdk,ekc->eqdc", shape.slopes(shape.corners), corners)
    points, weights = triangle_rule(4) if cell == "triangle" else box_rule(4, 4)
    _, determinant = gradients(name, nodes, corners, shape, points)
    functions = _triangle_functions(points) if cell == "triangle" else _square_functions(points)
    # nodal (w, dw/dxi, dw/deta) from (w, theta_x, theta_y): dw/dx = -theta_y, dw/dy = theta_x
    slope_map = np.zeros((*corner_slopes.shape[:2], 3, 3))
    slope_map[:, :, 0, 0] = 1.0
    slope_map[:, :, 1:, 1] = corner_slopes[..., 1]
    slope_map[:, :, 1:, 2] = -corner_slopes[..., 0]
    values = np.einsum("qka,ekab->eqkb", functions, slope_map).reshape(len(nodes), len(points), -1)
    return np.swapaxes(values, 1, 2) @ (values * (weights[:, None] * determinant).T[:, :, None])


def _square_functions(points: FloatArray) -> FloatArray:
    """Values of the twelve shape functions of the square at `points` (n_points, 2), (n_points, 4, 3).

    Axes are points, corners, and the corner values (w, dw/dxi, dw/deta) that the functions belong to.
    """
    values = np.empty((len(points), 4, 3))
    for k, (a, b) in enumerate(CELLS["quad"].corners):
        x, y = points[:, 0] * a, points[:, 1] * b
        both = (1 + x) * (1 + y) / 8
        values[:, k, 0] = both * (2 + x + y - x**2 - y**2)
        values[:, k, 1] = -a * both * (1 - x**2)
        values[:, k, 2] = -b * both * (1 - y**2)
    return values


def _triangle_functions(points: FloatArray) -> FloatArray:
    """Values of the nine shape functions of the triangle at `points` (n_points, 2), (n_points, 3, 3).

    Axes are points, corners, and the corner values (w, dw/dxi, dw/deta) that the functions belong to.
    """
    area = np.column_stack([1 - points.sum(axis=1), points])
    corners = CELLS["triangle"].corners
    bubble = area.prod(axis=1)
    values = np.empty((len(points), 3, 3))
    for k in range(3):
        j, m = (k + 1) % 3, (k + 2) % 3
        lk, lj, lm = area[:, k], area[:, j], area[:, m]
        values[:, k, 0] = lk + lk**2 * (lj + lm) - lk * (lj**2 + lm**2)
        to_j = (lk**2 * lj + bubble / 2)[:, None] * (corners[j] - corners[k])
        to_m = (lk**2 * lm + bubble / 2)[:, None] * (corners[m] - corners[k])
        values[:, k, 1:] = to_j + to_m
    return values

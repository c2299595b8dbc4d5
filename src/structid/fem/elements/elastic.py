"""Elastic cells: plates in plane stress or plane strain, solids, and stretched membranes that move across their plane.

Stiffness and mass are isoparametric, for unit modulus and density, all cells of a type at once.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.elements.cells import (
    CELLS,
    DENSITY,
    PLANE_CELLS,
    POISSON,
    SOLID_CELLS,
    YOUNGS_MODULUS,
    CellSet,
    CellShape,
    Formulation,
    Poisson,
    cell_positions,
    cell_table,
    gradients,
)
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    TRANSLATIONS,
    ElementMatrixTerm,
    Matrices,
    NodeCoordinates,
    Nodes,
    Values,
    declared,
    element,
    node_codes,
)

#: Cells that take incompatible bending modes.
_BENDING_CELLS = ("quad", "hexahedron")
_CELLS = {3: "triangle"}


@element
class Plane(CellSet):
    """Plane stress or plane strain in the x-y plane; moves along X and Y.

    References
    ----------
    Taylor, Beresford and Wilson (1976), Int. J. Numer. Meth. Eng. 10, 1211-1219 (incompatible modes).
    """

    cells = PLANE_CELLS
    symbol = "flat"
    moves = ("X", "Y")

    nodes: Nodes = declared(
        "Node labels: 3 or 6 (triangles), 4, 8 or 9 (quadrilaterals) an element, in either sense, mid-side nodes after the"
        " corners; rows of a set with several cell types end in -1. Positions are 2-D, or 3-D with equal z in an element",
        stored=cell_table(PLANE_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    thickness: Values = declared("Mass and stiffness go with its first power", "thickness", "m", positive=True)
    poisson: Poisson = declared(POISSON)
    state: Literal["stress", "strain"] = declared(
        "Plane stress (thin plates) or plane strain (long prisms)", default="stress"
    )
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)
    formulation: Formulation = declared("Of four-node quadrilaterals; see `elastic_stiffness`", default="incompatible")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices by property for unit density (mass) and Young's modulus (stiffness), and unit thickness.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed. Raises `InputError` if a cell is flat, folded or not parallel to the x-y plane.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        elasticity = plane_elasticity(self.poisson, self.state == "strain")
        stiffness = partial(elastic_stiffness, elasticity=elasticity, formulation=self.formulation)
        return {
            "density": (self.matrix_term(corners, unit_mass, power=1),),
            "youngs_modulus": (self.matrix_term(corners, stiffness, power=1),),
        }


@element
class Solid(CellSet):
    """Isotropic elastic solids; move along X, Y and Z.

    Notes
    -----
    Four-node tetrahedra and plain hexahedra are far too stiff in bending; take ten nodes or incompatible modes.
    """

    cells = SOLID_CELLS
    symbol = "solid"
    moves = TRANSLATIONS

    nodes: Nodes = declared(
        "Node labels, numbered as in VTK: 4 or 10 (tetrahedra), 5 (pyramids), 6 or 15 (wedges), 8, 20 or 27 (hexahedra) an"
        " element; rows of a set with several cell types end in -1. Positions are 3-D",
        stored=cell_table(SOLID_CELLS),
    )
    youngs_modulus: Values = declared(*YOUNGS_MODULUS)
    density: Values = declared(*DENSITY)
    poisson: Poisson = declared(POISSON)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^4", "density", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "Pa s", "youngs_modulus", default=0.0)
    formulation: Formulation = declared("Of eight-node hexahedra; see `elastic_stiffness`", default="incompatible")

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices of density (mass) and Young's modulus (stiffness), by property.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed.
        """
        corners = cell_positions(self.name, self.nodes, positions, 3)
        stiffness = partial(elastic_stiffness, elasticity=_solid_elasticity(self.poisson), formulation=self.formulation)
        return {
            "density": (self.matrix_term(corners, unit_mass),),
            "youngs_modulus": (self.matrix_term(corners, stiffness),),
        }


def plane_elasticity(poisson: float, strain: bool) -> FloatArray:
    """Stress-strain matrix (3, 3) of xx, yy and engineering xy for unit Young's modulus.

    Plane strain if `strain`, else plane stress; `poisson` is Poisson's ratio.
    """
    if strain:
        return _solid_elasticity(poisson)[np.ix_([0, 1, 3], [0, 1, 3])]
    elasticity = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])
    return elasticity / (1 - poisson**2)


def _solid_elasticity(poisson: float) -> FloatArray:
    """Stress-strain matrix (xx, yy, zz, engineering xy, yz, zx) for unit Young's modulus, (6, 6).

    `poisson` is Poisson's ratio.
    """
    elasticity = np.zeros((6, 6))
    elasticity[:3, :3] = poisson
    elasticity[np.diag_indices(3)] = 1 - poisson
    elasticity[range(3, 6), range(3, 6)] = 0.5 - poisson
    return elasticity / ((1 + poisson) * (1 - 2 * poisson))


def _strain_rows(slopes: FloatArray) -> FloatArray:
    """Strain-displacement matrices (..., n_strains, d n_nodes) from gradients `slopes` (..., d, n_nodes), d = 2 or 3.

    Strains are xx, yy, engineering xy, or xx, yy, zz, engineering xy, yz, zx; displacements go node by node.
    """
    d, n = slopes.shape[-2:]
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    rows = np.zeros((*slopes.shape[:-2], d + len(pairs), n, d))
    for axis in range(d):
        rows[..., axis, :, axis] = slopes[..., axis, :]
    for k, (a, b) in enumerate(pairs, d):
        rows[..., k, :, a], rows[..., k, :, b] = slopes[..., b, :], slopes[..., a, :]
    return rows.reshape(*slopes.shape[:-2], d + len(pairs), n * d)


def elastic_stiffness(
    name: str, nodes: IntArray, positions: FloatArray, cell: str, elasticity: FloatArray, formulation: str
) -> FloatArray:
    """Stiffness matrices of elastic cells for the stress-strain matrix `elasticity`, (n_cells, n_local, n_local).

    Parameters
    ----------
    name : str
        Name of the element set, for messages.
    nodes : (n_cells, n_nodes) int array
    positions : (n_cells, n_nodes, n_dimensions) float array
        m.
    cell : str
        Cell type, such as ``quad`` or ``hexahedron20``.
    elasticity : (n_strains, n_strains) float array
        Stress from strain.
    formulation : {"incompatible", "full", "mean_dilatation"}
        ``incompatible``: quadrilaterals and hexahedra with bending modes that are condensed (Taylor, Beresford and
        Wilson 1976); ``full``: plain interpolation; ``mean_dilatation``: the volume change of a cell is its mean
        (Hughes 1980), for nearly incompressible material. Other cells are plain but for ``mean_dilatation``.
    """
    shape = CELLS[cell]
    slopes, determinant = gradients(name, nodes, positions, shape, shape.points)
    measure = shape.weights[:, None] * determinant
    rows = _strain_rows(slopes)
    if formulation == "mean_dilatation":
        rows = _with_mean_dilatation(rows, measure, positions.shape[2])
    stiffness = _products(rows, elasticity, rows, measure)
    if formulation == "incompatible" and cell in _BENDING_CELLS:
        bending = _strain_rows(_bending_slopes(shape, positions, determinant))
        coupling = _products(bending, elasticity, rows, measure)
        incompatible = _products(bending, elasticity, bending, measure)
        stiffness = stiffness - np.swapaxes(coupling, 1, 2) @ np.linalg.solve(incompatible, coupling)
    return 0.5 * (stiffness + np.swapaxes(stiffness, 1, 2))


def _products(left: FloatArray, elasticity: FloatArray, right: FloatArray, measure: FloatArray) -> FloatArray:
    """Integrals of left' D right over each cell, (n_cells, n_left, n_right), with D = `elasticity`.

    `left` and `right` are (n_points, n_cells, n_strains, n); `measure` (n_points, n_cells) weighs the points.
    `elasticity` is (n_strains, n_strains), or one for each cell.
    """
    total = np.zeros((left.shape[1], left.shape[3], right.shape[3]))
    for a, b, weight in zip(left, right, measure, strict=True):
        total += np.swapaxes(a, 1, 2) @ (elasticity @ b * weight[:, None, None])
    return total


def _bending_slopes(shape: CellShape, positions: FloatArray, determinant: FloatArray) -> FloatArray:
    """Gradients of the incompatible modes 1 - xi_i^2, by the Jacobian of the cell's centre, (n_points, n_cells, d, d).

    Axes of the gradient come before modes. They are scaled by the ratio of determinants, centre to point, so that their
    integrals vanish, as the patch test asks. `positions` (n_cells, n_nodes, d) are in m, `shape` has slopes and
    integration points, `determinant` (n_points, n_cells) is that of the Jacobian.
    """
    d = positions.shape[2]
    centre = np.einsum("dk,ekc->edc", shape.slopes(np.zeros((1, d)))[0], positions)
    inverse = np.linalg.inv(centre)
    slopes = -2 * shape.points[:, None, None, :] * inverse[None]
    middle = np.abs(np.linalg.det(centre))
    return slopes * (middle / determinant)[:, :, None, None]


def _with_mean_dilatation(rows: FloatArray, measure: FloatArray, d: int) -> FloatArray:
    """Strain rows (n_points, n_cells, n_strains, n_local) whose trace is replaced by its mean over the cell.

    `measure` (n_points, n_cells) are the integration weights, `d` is the number of dimensions.
    """
    trace = rows[:, :, :d].sum(axis=2)
    mean = np.einsum("qe,qen->en", measure, trace) / measure.sum(axis=0)[:, None]
    changed = rows.copy()
    changed[:, :, :d] += ((mean - trace) / d)[:, :, None, :]
    return changed


def unit_mass(name: str, nodes: IntArray, positions: FloatArray, cell: str) -> FloatArray:
    """Consistent mass matrices of all cells for unit density, (n_cells, d n_nodes, d n_nodes), node by node.

    `positions` (n_cells, n_nodes, d) are in m, `cell` is the type; `name` and `nodes` are for messages.
    """
    shape = CELLS[cell]
    d = positions.shape[2]
    _, determinant = gradients(name, nodes, positions, shape, shape.mass_points)
    values = shape.values(shape.mass_points)
    scalar = np.einsum("q,qe,qi,qj->eij", shape.mass_weights, determinant, values, values, optimize=True)
    return np.einsum("eij,kl->eikjl", scalar, np.eye(d)).reshape(len(nodes), d * shape.n_nodes, -1)


def triangle_mass(area: FloatArray, lumped: bool = False) -> FloatArray:
    """Mass of linear triangles of unit mass per area, (n, 3, 3).

    Parameters
    ----------
    area : (n,) float array
        m^2.
    lumped : bool
        A third of the mass at each corner instead of the consistent area / 12 (1 + delta_ij).

    References
    ----------
    Zienkiewicz and Taylor (2000), The Finite Element Method, 5th ed., vol. 1, section 17.2.
    """
    unit = np.eye(3) / 3 if lumped else (np.ones((3, 3)) + np.eye(3)) / 12
    return unit * area[:, None, None]


def triangle_stiffness(corners: FloatArray, area: FloatArray) -> FloatArray:
    """Stiffness of linear triangles under unit tension, (n, 3, 3): area times the products of shape gradients.

    The gradient of corner i's shape function is the opposite side, turned by 90 degrees, over twice the area.

    Parameters
    ----------
    corners : (n, 3, 2) float array
        Positions in m.
    area : (n,) float array
        m^2.
    """
    sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    return sides @ np.swapaxes(sides, 1, 2) / (4 * area)[:, None, None]


@element
class Membrane(CellSet):
    """Membranes under uniform tension: linear triangles in the x-y plane that move along Z.

    The matrices are closed forms, computed for all triangles at once; they need no mesh library.

    Notes
    -----
    Frequencies of the consistent form lie above those of the continuum, by O(h^2 omega^2) for sides h.
    A structure with 2-D nodes moves along Z where it holds a membrane; see `Structure`.
    """

    cells = _CELLS
    symbol = "flat"
    moves = ("Z",)

    nodes: Nodes = declared(
        "Node labels of the corners, in either sense. Positions are 2-D, or 3-D with equal z in a triangle",
        stored=cell_table(_CELLS),
    )
    mass: Values = declared("Mass per area", "mass", "kg/m^2")
    tension: Values = declared("Force per length", "stiffness", "N/m")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^3", "mass", default=0.0)
    lumped: bool = declared(
        "A third of each triangle's mass (and mass-like damping) at each corner instead of the consistent matrix",
        default=False,
    )

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices for unit mass per area and unit tension, by property, on the motions normal to the membrane.

        `positions` are node coordinates in m by label; `used_codes` (degrees of freedom of other elements) are not
        needed. Raises `InputError` if a triangle has no area.
        """
        corners = cell_positions(self.name, self.nodes, positions, 2)
        gradients(self.name, self.nodes, corners, CELLS["triangle"], np.zeros((1, 2)))  # so that a flat one is told
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        codes = node_codes(self.nodes, self.moves)
        mass = triangle_mass(area, self.lumped)
        return {
            "mass": (ElementMatrixTerm(codes, mass),),
            "tension": (ElementMatrixTerm(codes, triangle_stiffness(corners, area)),),
        }

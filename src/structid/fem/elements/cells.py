"""Cells: interpolation, quadrature and gradients, and what element sets of cells share (positions, types, matrices)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.constraints import Limits
from structid.core.errors import InputError
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    Kind,
    NodeCoordinates,
    Store,
    element,
    node_codes,
)

_TRIANGLE = [(0, 0), (1, 0), (0, 1)]
_SQUARE = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
_TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
_CUBE = [(x, y, z) for z in (-1, 1) for x, y in _SQUARE]
_WEDGE = [(x, y, z) for z in (-1, 1) for x, y in _TRIANGLE]
_PYRAMID = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (0, 0, 0)]
_TRIANGLE_SIDES = [(0, 1), (1, 2), (2, 0)]
_SQUARE_SIDES = [(0, 1), (1, 2), (2, 3), (3, 0)]
_TETRAHEDRON_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
_CUBE_EDGES = [*_SQUARE_SIDES, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
_CUBE_FACES = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
_WEDGE_EDGES = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
#: Least ratio of the smallest to the mean Jacobian determinant in a cell.
_FLAT = 1e-9
Poisson: TypeAlias = Annotated[float, "float", Limits(above=-1, below=0.5)]
#: How strains are interpolated; see `elastic_stiffness`.
Formulation = Literal["incompatible", "full", "mean_dilatation"]
#: Matrices of cells of one type from the name of the set, labels, positions and the cell type.
CellMatrices = Callable[[str, IntArray, FloatArray, str], FloatArray]

YOUNGS_MODULUS: tuple[str, Kind, str] = ("Young's modulus", "stiffness", "Pa")
DENSITY: tuple[str, Kind, str] = ("Density", "mass", "kg/m^3")
POISSON = "Poisson's ratio, known"


@dataclass(frozen=True, eq=False)
class CellShape:
    """Interpolation on one cell type.

    Attributes
    ----------
    name : str
        As mesh files call it, such as ``hexahedron``; nodes are numbered as in VTK.
    corners : (n_nodes, n_dimensions) float array
        Reference positions of the nodes.
    exponents : (n_nodes, n_dimensions) int array
        Monomials that span the interpolation; a negative one belongs to the rational x y / z of a pyramid, 0 at its
        tip.
    points : (n_points, n_dimensions) float array
        Quadrature of the stiffness.
    weights : (n_points,) float array
    mass_points, mass_weights : the same of the mass
    """

    name: str
    corners: FloatArray
    exponents: IntArray
    points: FloatArray
    weights: FloatArray
    mass_points: FloatArray
    mass_weights: FloatArray

    @property
    def n_nodes(self) -> int:
        return len(self.corners)

    def values(self, points: FloatArray) -> FloatArray:
        """Interpolation functions at reference points `points`, (n_points, n_nodes)."""
        return _monomials(points, self.exponents) @ np.linalg.inv(_monomials(self.corners, self.exponents))

    def slopes(self, points: FloatArray) -> FloatArray:
        """Derivatives (n_points, n_dimensions, n_nodes) of the shape functions along the reference axes.

        `points` (n_points, n_dimensions) are reference coordinates.
        """
        coefficients = np.linalg.inv(_monomials(self.corners, self.exponents))
        axes = range(self.corners.shape[1])
        return np.stack([_monomial_slopes(points, self.exponents, axis) @ coefficients for axis in axes], axis=1)


def _monomials(points: FloatArray, exponents: IntArray) -> FloatArray:
    """Values (n_points, n_monomials) of monomials with `exponents` (n_monomials, n_axes) at `points`.

    A coordinate of 0 with a negative exponent counts as 1: the factor 0 of such a slope is taken elsewhere.
    """
    base = np.where((points[:, None, :] == 0) & (exponents[None] < 0), 1.0, points[:, None, :])
    powers: FloatArray = np.prod(base ** exponents[None], axis=2)
    return powers


def _monomial_slopes(points: FloatArray, exponents: IntArray, axis: int) -> FloatArray:
    """Derivatives (n_points, n_monomials) by coordinate `axis` of monomials with `exponents` at `points`."""
    lowered = exponents.copy()
    lowered[:, axis] -= lowered[:, axis] != 0
    return exponents[:, axis] * _monomials(points, lowered)


def box_rule(*orders: int) -> tuple[FloatArray, FloatArray]:
    """Gauss points (n_points, d) and weights (n_points,) on the reference line, square or cube from -1 to 1.

    `orders` are the numbers of points along each axis; points vary fastest along the last axis.
    """
    rules = [np.polynomial.legendre.leggauss(n) for n in orders]
    points = np.stack(np.meshgrid(*[x for x, _ in rules], indexing="ij"), axis=-1).reshape(-1, len(orders))
    weights = np.prod(np.stack(np.meshgrid(*[w for _, w in rules], indexing="ij"), axis=-1), axis=-1).ravel()
    return points, weights


def triangle_rule(order: int) -> tuple[FloatArray, FloatArray]:
    """Points (n_points, 2) and weights of the reference triangle by collapsed Gauss points, of degree 2 `order` - 2."""
    (points, weights) = box_rule(order, order)
    s, t = (points.T + 1) / 2
    return np.stack([s * (1 - t), t], axis=1), weights / 4 * (1 - t)


def _tetrahedron(order: int) -> tuple[FloatArray, FloatArray]:
    """Points (n_points, 3) and weights of the reference tetrahedron, exact to degree 2 `order` - 3."""
    points, weights = box_rule(order, order, order)
    r, s, t = (points.T + 1) / 2
    return np.stack([r * (1 - s) * (1 - t), s * (1 - t), t], axis=1), weights / 8 * (1 - s) * (1 - t) ** 2


def _pyramid(order: int) -> tuple[FloatArray, FloatArray]:
    """Points (n_points, 3) and weights of the reference pyramid, a square at z = -1 that shrinks towards the tip at 0.

    `order` points along each side of the square, three along the height.
    """
    points, weights = box_rule(order, order, 3)
    s, t, height = points[:, 0], points[:, 1], (points[:, 2] + 1) / 2
    return np.stack([s * height, t * height, -height], axis=1), weights / 2 * height**2


def _wedge_rule(order: int, along_axis: int = 2) -> tuple[FloatArray, FloatArray]:
    """Points (n_points, 3) and weights (n_points,) of the reference wedge: a triangle rule times Gauss points.

    `order` is that of the triangle rule, `along_axis` the number of Gauss points from -1 to 1 along the axis, which
    vary slowest.
    """
    flat, weights = triangle_rule(order)
    along, others = np.polynomial.legendre.leggauss(along_axis)
    points = np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in along])
    return points, np.concatenate([weights * w for w in others])


def _middles(corners: Sequence[tuple[int, ...]], edges: Sequence[tuple[int, int]]) -> list[tuple[float, ...]]:
    middles = [tuple((np.array(corners[a]) + np.array(corners[b])) / 2) for a, b in edges]
    return [*corners, *middles]


def _up_to(degree: int, dimension: int) -> list[tuple[int, ...]]:
    every = np.ndindex(*[degree + 1] * dimension)
    return [e for e in every if sum(e) <= degree]


def _serendipity(dimension: int) -> list[tuple[int, ...]]:
    """Exponents of the quadratic serendipity family: superlinear degree at most 2."""
    every = np.ndindex(*[3] * dimension)
    return [e for e in every if sum(p for p in e if p > 1) <= 2]


def _make_cells() -> dict[str, CellShape]:
    """The shape of each cell type by name: reference nodes, exponents of its polynomials, rules of integration.

    There are two rules, one for stiffness and a finer or equal one for mass.
    """
    bilinear, trilinear = list(np.ndindex(2, 2)), list(np.ndindex(2, 2, 2))
    prism = [(*a, b) for a in _up_to(1, 2) for b in (0, 1)]
    prism15 = [*((*a, b) for a in _up_to(2, 2) for b in (0, 1)), *((*a, 2) for a in _up_to(1, 2))]
    triangle6, square8 = _middles(_TRIANGLE, _TRIANGLE_SIDES), _middles(_SQUARE, _SQUARE_SIDES)
    tetra10, cube20 = _middles(_TETRAHEDRON, _TETRAHEDRON_EDGES), _middles(_CUBE, _CUBE_EDGES)
    cube27, wedge15 = [*cube20, *_CUBE_FACES, (0, 0, 0)], _middles(_WEDGE, _WEDGE_EDGES)
    table: dict[str, tuple[ArrayLike, ArrayLike, tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]] = {
        "triangle": (_TRIANGLE, _up_to(1, 2), triangle_rule(1), triangle_rule(2)),
        "triangle6": (triangle6, _up_to(2, 2), triangle_rule(2), triangle_rule(3)),
        "quad": (_SQUARE, bilinear, box_rule(2, 2), box_rule(2, 2)),
        "quad8": (square8, _serendipity(2), box_rule(3, 3), box_rule(3, 3)),
        "quad9": ([*square8, (0, 0)], list(np.ndindex(3, 3)), box_rule(3, 3), box_rule(3, 3)),
        "tetra": (_TETRAHEDRON, _up_to(1, 3), _tetrahedron(2), _tetrahedron(3)),
        "tetra10": (tetra10, _up_to(2, 3), _tetrahedron(3), _tetrahedron(4)),
        "pyramid": (_PYRAMID, [*_up_to(1, 3), (1, 1, -1)], _pyramid(2), _pyramid(3)),
        "wedge": (_WEDGE, prism, _wedge_rule(2), _wedge_rule(3)),
        "wedge15": (wedge15, prism15, _wedge_rule(3, 3), _wedge_rule(4, 3)),
        "hexahedron": (_CUBE, trilinear, box_rule(2, 2, 2), box_rule(2, 2, 2)),
        "hexahedron20": (cube20, _serendipity(3), box_rule(3, 3, 3), box_rule(3, 3, 3)),
        "hexahedron27": (cube27, list(np.ndindex(3, 3, 3)), box_rule(3, 3, 3), box_rule(3, 3, 3)),
    }
    return {
        name: CellShape(
            name,
            locked(corners, np.float64),
            locked(exponents, np.int64),
            *(locked(part, np.float64) for part in (*stiffness, *mass)),
        )
        for name, (corners, exponents, stiffness, mass) in table.items()
    }


#: Every cell type by its name.
CELLS = _make_cells()
#: Cell types by number of nodes, of plane and of solid elements.
PLANE_CELLS, SOLID_CELLS = (
    {shape.n_nodes: name for name, shape in CELLS.items() if shape.corners.shape[1] == d} for d in (2, 3)
)


def gradients(
    name: str, nodes: IntArray, positions: FloatArray, shape: CellShape, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gradients of the interpolation in physical axes, and Jacobian determinants.

    Parameters
    ----------
    name : str
        Name of the element set, for messages.
    nodes : (n_cells, n_nodes) int array
        Labels, for messages.
    positions : (n_cells, n_nodes, n_dimensions) float array
        m.
    shape : CellShape
    points : (n_points, n_dimensions) float array
        Reference points.

    Returns
    -------
    (n_points, n_cells, n_dimensions, n_nodes) and (n_points, n_cells) float arrays
        The determinants are positive; in a plane, cells may be numbered in either sense.

    Raises
    ------
    InputError
        If a cell has no volume (area), is turned inside out, or is folded.
    """
    jacobian = np.einsum("qdk,ekc->qedc", shape.slopes(points), positions)
    determinant: FloatArray = np.linalg.det(jacobian)
    if positions.shape[2] == 2:
        determinant = determinant * np.where(determinant.mean(axis=0) < 0, -1.0, 1.0)
    require_regular(name, nodes, positions, determinant)
    return np.linalg.solve(jacobian, shape.slopes(points)[:, None]), determinant


def require_regular(name: str, nodes: IntArray, positions: FloatArray, determinant: FloatArray) -> None:
    """Raise `InputError` if a cell has no volume (area), is turned inside out (negative mean) or folded.

    Thresholds are 1e-9 of the cell's span to the power d, and of its mean determinant. `nodes` (n_cells, n_nodes)
    are labels, `positions` (n_cells, n_nodes, d) are in m, `determinant` (n_points, n_cells) is that of the Jacobian;
    `name` is that of the set.
    """
    size = np.ptp(positions, axis=1).max(axis=1) ** positions.shape[2]
    word = "area" if positions.shape[2] == 2 else "volume"
    mean = determinant.mean(axis=0)
    flat, folded = np.abs(determinant).max(axis=0) <= _FLAT * size, determinant.min(axis=0) <= _FLAT * mean
    require_none(flat, name, nodes, f"has no {word}", "remove it, or repair the mesh")
    turned = "reverse the order of its nodes in each face, or export the mesh anew"
    require_none(mean < 0, name, nodes, "is turned inside out", turned)
    require_none(folded, name, nodes, "is folded", "move its nodes so that no corner reaches 180 degrees")


def require_none(bad: np.ndarray, name: str, nodes: IntArray, words: str, remedy: str) -> None:
    """Raise `InputError` for the first cell where `bad` (n_cells,) is True, and say how many others there are.

    `name` is that of the set, `nodes` are labels (n_cells, n_nodes). `words` say what is wrong, `remedy` ends the
    message.
    """
    if bad.any():
        e, others = int(np.argmax(bad)), int(bad.sum()) - 1
        more = "" if not others else ", as is 1 other" if others == 1 else f", as are {others} others"
        labels = ", ".join(map(str, nodes[e]))
        raise InputError(f"element {e + 1} of {name!r} {words}{more}: nodes {labels}; {remedy}")


def cell_table(cells: Mapping[int, str]) -> Store:
    """A function that checks and stores node labels of cells as (n_cells, most nodes).

    Rows of smaller cells end in -1, as they are given. `cells` maps allowed numbers of nodes to cell types. The
    function takes the name of the set, for errors, and the labels, and raises `InputError` if they are no whole numbers
    or too many or few.
    """

    def stored(name: str, nodes: ArrayLike) -> IntArray:
        """Table of the node labels `nodes` of the set `name`, (n_cells, most nodes); -1 where a row has ended.

        Raises `InputError` unless they are whole numbers and each row has a number of nodes that `cells` allows.
        """
        table = np.atleast_2d(np.asarray(nodes))
        if table.ndim != 2 or table.size == 0 or not np.issubdtype(table.dtype, np.integer):
            raise InputError(f"`nodes` of {name!r} must be a table of whole numbers, got shape {table.shape}")
        counts = (table >= 0).sum(axis=1)
        is_wrong = ~np.isin(counts, list(cells))
        if is_wrong.any():
            e = int(np.argmax(is_wrong))
            allowed = ", ".join(f"{count} ({kind})" for count, kind in cells.items())
            raise InputError(
                f"element {e + 1} of {name!r} has {counts[e]} nodes; it can have {allowed}; mesh with these"
            )
        return locked(table, np.int64)

    return stored


@element
class CellSet(ElementSet):
    """Cells of a mesh, possibly of several types, whose nodes all move alike."""

    def matrix_term(
        self, corners: FloatArray, matrices_of: CellMatrices, power: int = 0, directions: Sequence[str] | None = None
    ) -> ElementMatrixTerm:
        """Element matrices of all cells of the set with their degrees of freedom, made type by type.

        Matrices of cells with fewer nodes than the largest are padded with zeros, to (n_cells, n_local, n_local).

        Parameters
        ----------
        corners : (n_cells, n_nodes, n_dimensions) float array
            Positions of the nodes, m.
        matrices_of : callable
            Takes the name of the set, node labels, positions and type of cells, and returns their matrices.
        power : int
            Power of the thickness that they go with.
        directions : sequence of str, optional
            Directions of each node that the matrices have; by default all in which the nodes move.
        """
        axes = self.moves if directions is None else directions
        counts = (self.nodes >= 0).sum(axis=1)
        size = len(axes) * self.nodes.shape[1]
        total = np.zeros((len(self.nodes), size, size))
        for count in np.unique(counts).tolist():
            rows, n = np.flatnonzero(counts == count), len(axes) * count
            nodes, nodes_at = self.nodes[rows, :count], corners[rows, :count]
            total[rows, :n, :n] = matrices_of(self.name, nodes, nodes_at, self.cells[count])
        return ElementMatrixTerm(node_codes(self.nodes, axes), total, power)


def cell_positions(name: str, nodes: IntArray, positions: NodeCoordinates, dimensions: int) -> FloatArray:
    """Positions in m of the cells' nodes along the first axes, (n_cells, n_nodes, dimensions).

    They are 0 where a row has ended. `nodes` (n_cells, n_nodes) are labels, -1 where a row has ended; `positions` map
    labels to coordinates. Raises `InputError`, which names the set `name`, if nodes have fewer than `dimensions`
    coordinates, or more and a cell is not parallel to the x-y plane.
    """
    size = len(next(iter(positions.values())))
    if size < dimensions:
        raise InputError(f"{name!r} needs {dimensions}-D nodes, got positions with {size} coordinates")
    labels, index = np.unique(nodes, return_inverse=True)
    table = np.array([positions[int(label)] if label >= 0 else np.zeros(size) for label in labels])
    by_cell = table[index.reshape(nodes.shape)]
    if size > dimensions:
        _require_flat(name, nodes, by_cell)
    flat: FloatArray = by_cell[..., :dimensions]
    return flat


def _require_flat(name: str, nodes: IntArray, corners: FloatArray) -> None:
    """Raise `InputError`, which names the set `name`, if z differs within a cell by more than 1e-9 of its size.

    `nodes` (n_cells, n_nodes) are labels, -1 where a row has ended, and `corners` positions (n_cells, n_nodes, 3).
    """
    used = nodes >= 0
    high = np.where(used, corners[..., 2], -np.inf).max(axis=1)
    low = np.where(used, corners[..., 2], np.inf).min(axis=1)
    first = corners[:, :1, :2]
    span = np.where(used, np.linalg.norm(corners[..., :2] - first, axis=2), 0.0).max(axis=1)
    tilted = high - low > 1e-9 * span
    if tilted.any():
        e = int(np.argmax(tilted))
        labels = ", ".join(map(str, nodes[e][used[e]]))
        raise InputError(
            f"element {e + 1} of {name!r} is not parallel to the x-y plane: nodes {labels} have z from {low[e]:g} to"
            f" {high[e]:g}; turn the model so that it lies in x-y, or make it a shell"
        )

"""Nodes whose position along the straight line of the bars and beams that meet there is a property."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.fem.elements.element import (
    ElementMatrixTerm,
    ElementSet,
    NodeCoordinates,
    PropertyMatrices,
    element_vectors,
)
from structid.fem.supports import RigidLink, Tie

#: Powers of its length that a matrix of a bar or beam has.
_POWERS = range(-3, 4)
#: How far from a straight line a node may be, and entries that are none, in parts.
_STRAIGHT, _ROUNDING = 1e-9, 1e-11
#: Least length of an element beside a node that slides, in parts of the distance of its neighbours: in a beam of ten
#: elements rounding of the stiffness matrix then stays below 1e-7 of a frequency and of FRFs; it goes with the third power.
_SHORTEST = 1e-3


@dataclass(frozen=True, eq=False)
class NodePosition:
    """The line on which a node of variable position lies, and where on it the node is nominally.

    Attributes
    ----------
    node : int
    start : int
        The neighbouring node that its position is measured from.
    direction : (n_coordinates,) float array
        Unit vector from `start` to the node.
    position : float
        Distance from `start`, m.
    limit : float
        Distance of the neighbour beyond, m; infinite where there is none.
    """

    node: int
    start: int
    direction: FloatArray
    position: float
    limit: float

    @property
    def name(self) -> str:
        """The name that the position has where properties are named by element set, such as ``node 2``."""
        return f"node {self.node}"

    @property
    def term(self) -> PropertyMatrices:
        """The position as a property of kind "position", m, with limits that keep the elements there from vanishing.

        An element stays at least a thousandth of the distance of the neighbours long (of the position, if nothing lies
        beyond), or half as long as it is nominally, whichever is less.
        """
        beyond = self.limit - self.position
        shortest = _SHORTEST * (self.limit if np.isfinite(self.limit) else self.position)
        limits = min(shortest, 0.5 * self.position), self.limit - min(shortest, 0.5 * beyond)
        return PropertyMatrices("position", "position", "m", locked([self.position]), limits=limits)


@dataclass(frozen=True, eq=False)
class LengthDependence:
    """Dependence of the lengths of a set's elements on the variable positions of nodes.

    Attributes
    ----------
    lengths : (n_elements,) float array
        Nominal, m.
    at : tuple of (n_elements,) int arrays
        For each end with a variable position in some element: index of the position among the values of the structure;
        any index in an element where that end is fixed.
    slopes : tuple of (n_elements,) float arrays
        Derivative of the length by that position: 1, -1, or 0 where the end is fixed. By a common factor on all
        lengths, which may stand beside the positions, it is the length.
    nominal : tuple of (n_elements,) float arrays
        Nominal positions, m; 1 of the factor.
    """

    lengths: FloatArray
    at: tuple[IntArray, ...]
    slopes: tuple[FloatArray, ...]
    nominal: tuple[FloatArray, ...]

    def followed_by(self, other: LengthDependence) -> LengthDependence:
        """Dependence on the properties of this and then of `other`, for the same elements; length changes add."""
        return LengthDependence(
            self.lengths,
            (*self.at, *other.at),
            (*self.slopes, *other.slopes),
            (*self.nominal, *other.nominal),
        )

    def ratio(self, values: FloatArray) -> FloatArray:
        """Length of each element over its nominal length, (n_elements,), at all property values (n_values,).

        It is 1 at the nominal values, and linear in the values.
        """
        ratio = np.ones_like(self.lengths)
        for rows, slope, nominal in zip(self.at, self.slopes, self.nominal, strict=True):
            ratio = ratio + slope * (values[rows] - nominal) / self.lengths
        return ratio


def node_positions(
    nodes: Sequence[int], elements: Sequence[ElementSet], positions: NodeCoordinates, ties: Sequence[Tie]
) -> tuple[NodePosition, ...]:
    """The line and nominal position of each of the `nodes` whose position is a property, in order, each once.

    A node may move along the straight line of the bars or beams that end there. `positions` are those of all nodes, m;
    `elements` and `ties` are all of the structure.

    Raises
    ------
    InputError
        If a node is not there, has no bar or beam, is a corner of cells or in a rigid link, or the lines that meet
        there are not straight.
    """
    made = tuple(_make_node_position(node, elements, positions) for node in dict.fromkeys(nodes))
    for node in dict.fromkeys(nodes):
        for tie in ties:
            if isinstance(tie, RigidLink) and node in (tie.main, *tie.dependents):
                raise InputError(f"node {node} of `sliding` is in rigid link {tie.name!r}; take it out of one of them")
    return made


def _make_node_position(node: int, elements: Sequence[ElementSet], positions: NodeCoordinates) -> NodePosition:
    """The line along which `node` may move, its nominal position on it, m, and where the next node lies.

    The position is measured from the start node of the first element that ends at `node`, or from the end node of the
    first that begins there if none ends there; the limit is infinite without a node beyond. Raises `InputError` if
    there is no such element, they are not on a line, or two neighbours are on one side.
    """
    if node not in positions:
        raise InputError(f"`sliding` names node {node}, which the structure does not have")
    for element in elements:
        if element.cells and (element.nodes == node).any():
            raise InputError(
                f"node {node} of `sliding` is a corner of cells of {element.name!r}; only bars and beams let it slide"
            )
    rows = [row for element in elements if element.is_line for row in element.nodes.tolist() if node in row]
    before = [row[0] for row in rows if row[1] == node]
    others = before + [row[1] for row in rows if row[0] == node]
    if not others:
        raise InputError(f"node {node} of `sliding` is no end of a bar or beam; name one that is")
    position, start = positions[node], others[0]
    length = float(np.linalg.norm(position - positions[start]))
    direction = (position - positions[start]) / length
    limit = np.inf
    for other in others:
        away = position - positions[other]
        along = float(away @ direction)
        if np.linalg.norm(away - along * direction) > _STRAIGHT * np.linalg.norm(away):
            raise InputError(
                f"node {node} of `sliding` is where lines to nodes {start} and {other} meet at an angle; it can slide along a"
                " straight line only"
            )
        if along < 0:
            limit = min(limit, length - along)
        elif abs(along - length) > _STRAIGHT * length:
            raise InputError(
                f"node {node} of `sliding` has two neighbours on one side, {start} and {other}; join it to the nearer"
            )
    return NodePosition(node, start, direction, length, limit)


def split_by_length_power(
    name: str, terms_of: Callable[[NodeCoordinates], Sequence[PropertyMatrices]], positions: NodeCoordinates
) -> tuple[PropertyMatrices, ...]:
    """Terms of bars or beams, with each matrix split by the power of the element length it is proportional to.

    Matrices are sums of powers from -3 to 3, separated by evaluation at all lengths times 2^k, k from -3 to 3.

    Parameters
    ----------
    name : str
        Name of the element set, for errors.
    terms_of : callable
        Returns the terms of the set for a mapping of node positions.
    positions : mapping of int to position
        Nominal positions, m.

    Raises
    ------
    InputError
        If the beams are flexible in shear, which is no sum of powers.
    """
    scales = [2.0**k for k in _POWERS]
    made = [terms_of({label: scale * position for label, position in positions.items()}) for scale in scales]
    nominal = made[scales.index(1.0)]
    if any(matrix_term.shear is not None for term in nominal for matrix_term in term.matrix_terms):
        raise InputError(
            f"beams of {name!r} shear, so that no end of theirs can be in `sliding`, nor their length have a tolerance; leave the"
            " shear out"
        )
    split: dict[int, list[ElementMatrixTerm]] = {}
    for number, term in enumerate(nominal):
        for position, matrix_term in enumerate(term.matrix_terms):
            if id(matrix_term) not in split:
                split[id(matrix_term)] = _split_by_power(
                    matrix_term, np.array([terms[number].matrix_terms[position].local for terms in made])
                )
    return tuple(
        replace(term, matrix_terms=[part for matrix_term in term.matrix_terms for part in split[id(matrix_term)]])
        for term in nominal
    )


def _split_by_power(matrix_term: ElementMatrixTerm, local: FloatArray) -> list[ElementMatrixTerm]:
    """The parts of a matrix term by powers of the length, one matrix term each; parts that are zero are left out.

    `local` (n_scales, n_elements, n, n) are its matrices at lengths scaled by 2^k for each k from -3 to 3.
    """
    parts = np.einsum("pk,kenm->penm", _WEIGHTS, local)
    least = _ROUNDING * np.abs(matrix_term.local).max(axis=(1, 2), keepdims=True)
    cleaned = [np.where(np.abs(part) > least, part, 0.0) for part in parts]
    return [
        replace(matrix_term, local=part, length_power=p) for p, part in zip(_POWERS, cleaned, strict=True) if part.any()
    ]


def _power_weights() -> FloatArray:
    """Weights (n_powers, n_scales) that split a matrix, known at scaled lengths, into its parts by powers of length.

    Lengths are scaled by 2^k, and a part goes with the power p, both from -3 to 3. The inverse of the matrix 2^(k p),
    computed in fractions without rounding.
    """
    n = len(_POWERS)
    rows = [[*(Fraction(2) ** (k * p) for p in _POWERS), *(Fraction(int(k == j)) for j in _POWERS)] for k in _POWERS]
    for i in range(n):
        pivot = next(r for r in range(i, n) if rows[r][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for r in range(n):
            if r != i:
                rows[r] = [x - rows[r][i] * y for x, y in zip(rows[r], rows[i], strict=True)]
    return np.array([[float(x) for x in row[n:]] for row in rows])


_WEIGHTS = _power_weights()


def stretched_lengths(element: ElementSet, positions: NodeCoordinates, index: int) -> LengthDependence:
    """The dependence of all lengths of a set on one common factor, nominally 1, at `index` among the values.

    `positions` are those of the nodes, m.
    """
    lengths, _ = element_vectors(element.name, element.nodes, positions)
    return LengthDependence(lengths, (np.full(len(lengths), index),), (lengths,), (np.ones(len(lengths)),))


def length_dependence(
    element: ElementSet,
    position_of_node: Mapping[int, NodePosition],
    positions: NodeCoordinates,
    index_of_value: Mapping[str, int],
) -> LengthDependence:
    """Dependence of the lengths of a set of lines on the positions of the nodes that slide.

    It has, for each end of the set that slides anywhere, the index of the position among the property values, the slope
    of the length (+1, -1 or 0) and the nominal position, (n_elements,) each. `position_of_node` maps the label of such
    a node to its line, `positions` all labels to coordinates in m, and `index_of_value` the name of each position, such
    as ``node 2``, to its index among the values of the structure.
    """
    lengths, along = element_vectors(element.name, element.nodes, positions)
    moving_ends = [end for end in (0, 1) if np.isin(element.nodes[:, end], list(position_of_node)).any()]
    value_index = np.full((len(moving_ends), len(lengths)), next(iter(index_of_value.values())))
    slope, nominal = np.zeros(value_index.shape), np.zeros(value_index.shape)
    for k, end in enumerate(moving_ends):
        for e, node in enumerate(element.nodes[:, end].tolist()):
            if node in position_of_node:
                node_position = position_of_node[node]
                away = along[e] if end else -along[e]
                value_index[k, e], nominal[k, e] = index_of_value[node_position.name], node_position.position
                slope[k, e] = np.sign(away @ node_position.direction)
    return LengthDependence(lengths, tuple(value_index), tuple(slope), tuple(nominal))

"""Nodes that slide along the straight line of the bars and beams that meet there: their places as properties."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.fem.elements.element import ElementSet, Layer, Positions, Term

#: Powers of its length that a matrix of a bar or beam has.
_POWERS = range(-3, 4)
#: How far from a straight line a node may be, and entries that are none, in parts.
_STRAIGHT, _ROUNDING = 1e-9, 1e-11
#: Least length of an element beside a node that slides, in parts of the distance of its neighbours: in a beam of ten
#: elements rounding of the stiffness matrix then stays below 1e-7 of a frequency and of FRFs; it goes with the third power.
_SHORTEST = 1e-3


@dataclass(frozen=True, eq=False)
class Slide:
    """Where a node slides.

    Attributes
    ----------
    node : int
    start : int
        The neighbour that its place is measured from.
    direction : (n_coordinates,) float array
        From there to the node, of length 1.
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
        """What stands for it where properties name element sets."""
        return f"node {self.node}"

    @property
    def term(self) -> Term:
        """Its place as a property, no nearer to its neighbours than an element can be short."""
        beyond = self.limit - self.position
        shortest = _SHORTEST * (self.limit if np.isfinite(self.limit) else self.position)
        limits = min(shortest, 0.5 * self.position), self.limit - min(shortest, 0.5 * beyond)
        return Term("position", "position", "m", locked([self.position]), limits=limits)


@dataclass(frozen=True, eq=False)
class Lengthening:
    """How the lengths of the elements of a set change with the places of nodes.

    Attributes
    ----------
    lengths : (n_elements,) float array
        Nominal, m.
    at : tuple of (n_elements,) int arrays
        For each end that slides somewhere: where its place stands among the values of the structure; any of them where it
        does not slide.
    slopes : tuple of (n_elements,) float arrays
        Change of the length with that place: 1, -1, or 0 where the end does not slide.
    nominal : tuple of (n_elements,) float arrays
        The nominal places, m.
    """

    lengths: FloatArray
    at: tuple[IntArray, ...]
    slopes: tuple[FloatArray, ...]
    nominal: tuple[FloatArray, ...]

    def ratio(self, values: FloatArray) -> FloatArray:
        """Lengths over the nominal ones, (n_elements,)."""
        found = np.ones_like(self.lengths)
        for at, slope, nominal in zip(self.at, self.slopes, self.nominal, strict=True):
            found = found + slope * (values[at] - nominal) / self.lengths
        return found


def slides(nodes: Sequence[int], elements: Sequence[ElementSet], positions: Positions) -> tuple[Slide, ...]:
    """Where `nodes` slide.

    Raises
    ------
    InputError
        If one is not there, has no bar or beam, is a corner of cells, or lines that meet there are not straight.
    """
    return tuple(_slide(node, elements, positions) for node in dict.fromkeys(nodes))


def _slide(node: int, elements: Sequence[ElementSet], positions: Positions) -> Slide:
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
    here, start = positions[node], others[0]
    length = float(np.linalg.norm(here - positions[start]))
    direction = (here - positions[start]) / length
    limit = np.inf
    for other in others:
        away = here - positions[other]
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
    return Slide(node, start, direction, length, limit)


def stretched(name: str, terms_of: Callable[[Positions], Sequence[Term]], positions: Positions) -> tuple[Term, ...]:
    """Terms of bars or beams whose layers each go with one power of the length of their element.

    Matrices are sums of such powers; they are told apart by lengths that are all twice, four times, half as large and so on.

    Parameters
    ----------
    name : str
        Of the set.
    terms_of : callable
        The terms on nodes at given positions.
    positions : mapping of int to position
    """
    scales = [2.0**k for k in _POWERS]
    made = [terms_of({label: scale * place for label, place in positions.items()}) for scale in scales]
    nominal = made[scales.index(1.0)]
    if any(layer.shear is not None for term in nominal for layer in term.layers):
        raise InputError(f"beams of {name!r} shear, so that no end of theirs can be in `sliding`; leave the shear out")
    split: dict[int, list[Layer]] = {}
    for number, term in enumerate(nominal):
        for place, layer in enumerate(term.layers):
            if id(layer) not in split:
                split[id(layer)] = _powers(layer, np.array([terms[number].layers[place].local for terms in made]))
    return tuple(replace(term, layers=[part for layer in term.layers for part in split[id(layer)]]) for term in nominal)


def _powers(layer: Layer, local: FloatArray) -> list[Layer]:
    """The parts of a layer by powers of the length, from its matrices at every scale (n_scales, n_elements, n, n)."""
    parts = np.einsum("pk,kenm->penm", _WEIGHTS, local)
    least = _ROUNDING * np.abs(layer.local).max(axis=(1, 2), keepdims=True)
    found = [np.where(np.abs(part) > least, part, 0.0) for part in parts]
    return [replace(layer, local=part, stretch=p) for p, part in zip(_POWERS, found, strict=True) if part.any()]


def _inverse() -> FloatArray:
    """What makes powers of matrices at all scales: the inverse of 2^(k p), exactly, then rounded."""
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


_WEIGHTS = _inverse()


def lengthening(
    element: ElementSet, slides_of: Mapping[int, Slide], positions: Positions, places: Mapping[str, int]
) -> Lengthening:
    """The `Lengthening` of a set; `places` says where the place of each slide stands among the values of the structure."""
    ends = np.array([[positions[int(n)] for n in row] for row in element.nodes])
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    sliding = [end for end in (0, 1) if np.isin(element.nodes[:, end], list(slides_of)).any()]
    at = np.full((len(sliding), len(lengths)), next(iter(places.values())))
    slope, nominal = np.zeros(at.shape), np.zeros(at.shape)
    for k, end in enumerate(sliding):
        for e, node in enumerate(element.nodes[:, end].tolist()):
            if node in slides_of:
                slide = slides_of[node]
                away = ends[e, end] - ends[e, 1 - end]
                at[k, e], nominal[k, e] = places[slide.name], slide.position
                slope[k, e] = np.sign(away @ slide.direction)
    return Lengthening(lengths, tuple(at), tuple(slope), tuple(nominal))

"""What moves inside elements besides their nodes, numbered above all nodes: between equal pieces, and ends let go."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import InputError
from structid.fem.elements.element import (
    TRANSLATIONS,
    ElementSet,
    Layer,
    Positions,
    Term,
    dof_code,
    element_vectors,
)
from structid.fem.sliding import stretched

_ELEMENT = re.compile(r"^(?P<name>.+):(?P<number>\d+)$")
#: Part of the largest entry of a matrix below which an entry is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class NumberedTerms:
    """The terms of all element sets, with codes for what is inside them.

    Attributes
    ----------
    terms : mapping of str to tuple of Term
        By the name of the set, in order.
    owners : mapping of int to str
        What is at each label above those of the nodes: the element or joint.
    free : int array
        Codes between pieces that move with the active directions, though these may leave them out: a beam whose ends do
        not turn bends between them.
    """

    terms: Mapping[str, tuple[Term, ...]]
    owners: Mapping[int, str]
    free: IntArray


def numbered_terms(
    elements: Sequence[ElementSet],
    positions: Positions,
    present: IntArray,
    active: Sequence[str],
    pieces: int = 1,
    sliding: Sequence[int] = (),
) -> NumberedTerms:
    """The terms of `elements` with divisible lines cut into equal `pieces` and joints made; see `ElementSet.terms`.

    An element owns its pieces: it keeps one matrix for each property, on the nodes between them too. The end that a joint
    lets go has a degree of freedom of its own in the element's matrices, in place of the node's; all others stay the
    node's. Matrices of bars and beams with an end at one of the nodes `sliding` are told apart by powers of the length.

    Raises
    ------
    InputError
        If a joint cannot be: its element, node or direction is not there, or the element has no stiffness in it.
    """
    terms: dict[str, tuple[Term, ...]] = {}
    owners: dict[int, str] = {}
    free: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    first = max(positions) + 1
    for element in elements:
        is_cut = pieces > 1 and is_divisible(element, positions, active)
        terms_of = partial(_terms, element, present, pieces if is_cut else 1, first + len(owners))
        if element.is_line and np.isin(element.nodes, sliding).any():
            terms[element.name] = stretched(element.name, terms_of, positions)
        else:
            terms[element.name] = terms_of(positions)
        if is_cut:
            names = (f"{element.name}:{row + 1}" for row in range(len(element.nodes)) for _ in range(pieces - 1))
            owners.update(enumerate(names, first + len(owners)))
            free.append(_free_between(terms[element.name], pieces, active))
    loosened: dict[tuple[str, int, int], str] = {}
    for joint in elements:
        if joint.loosened is not None:
            text, at = joint.loosened
            target, row = _element(joint.name, text, elements)
            own, label = dof_code(at.node, at.direction), first + len(owners)
            other = loosened.setdefault((target.name, row, own), joint.name)
            if other != joint.name:
                raise InputError(f"joint {joint.name!r} is in the place of joint {other!r}; take one of them out")
            _require_way(joint.name, text, at, target.nodes[row], _ways(terms[target.name], row, at.node), active)
            owners[label] = joint.name
            end = dof_code(label, at.direction)
            terms[joint.name] = _recoded(terms[joint.name], slice(None), -1, end)
            terms[target.name] = _recoded(terms[target.name], row, own, end)
    return NumberedTerms(terms, owners, np.concatenate(free))


def is_divisible(element: ElementSet, positions: Positions, active: Sequence[str]) -> bool:
    """Whether the elements of a set are lines whose pieces are held sideways, so that they can be cut.

    A node between two bars that moves across them would have mass and no stiffness. Bars on a line have no such motion, and
    beams have bending stiffness against it.
    """
    if not element.is_line:
        return False
    _, along = element_vectors(element.name, element.nodes, positions)
    size = along.shape[1]
    held: FloatArray = np.zeros((len(along), 3, 3))
    held[:, :size, :size] = along[:, :, None] * along[:, None, :]
    axes: set[int] = set()
    for term in element.terms(positions, np.zeros(0, dtype=np.int64)):
        for layer in term.layers if term.kind in ("stiffness", "axial_force") else ():
            own = np.flatnonzero(layer.codes[0, : layer.codes.shape[1] // 2] % 6 < len(TRANSLATIONS))
            at = layer.codes[0, own] % 6
            axes |= set(at.tolist())
            held[:, at[:, None], at] += (term.values > 0)[:, None, None] * layer.local[:, own[:, None], own]
    moving = [axis for axis in sorted(axes) if DIRECTIONS[axis] in active]
    stiff = np.linalg.eigvalsh(held[:, moving][:, :, moving])
    return bool((stiff > _ROUNDING * stiff.max(initial=0.0)).all())


def _terms(element: ElementSet, present: IntArray, pieces: int, first: int, positions: Positions) -> tuple[Term, ...]:
    """Terms of a set, its lines cut into equal pieces."""
    if pieces > 1:
        return _cut(element, positions, present, pieces, first)
    return element.terms(positions, present)


def _cut(element: ElementSet, positions: Positions, present: IntArray, pieces: int, first: int) -> tuple[Term, ...]:
    """Terms of lines that are each a chain of equal pieces, the nodes between labelled from `first` line by line."""
    nearer = {label: place / pieces for label, place in positions.items()}  # lines as long as one piece
    between = first + np.arange(len(element.nodes) * (pieces - 1)).reshape(-1, pieces - 1)
    terms = element.terms(nearer, present)
    made = {id(layer): _chained(layer, between) for term in terms for layer in term.layers}
    return tuple(replace(term, layers=[made[id(layer)] for layer in term.layers]) for term in terms)


def _chained(layer: Layer, between: IntArray) -> Layer:
    """Matrices of chains of pieces with the nodes `between` (n_elements, n_pieces - 1), from those of one piece."""
    n, width = layer.codes.shape
    half, pieces = width // 2, between.shape[1] + 1
    start, end = layer.codes[:, :half], layer.codes[:, half:]
    middle = 6 * between[:, :, None] + (start % 6)[:, None, :]
    local: FloatArray = np.zeros((n, (pieces + 1) * half, (pieces + 1) * half))
    for piece in range(pieces):
        own = slice(piece * half, piece * half + width)
        local[:, own, own] += layer.local
    return replace(layer, codes=np.concatenate([start, middle.reshape(n, -1), end], axis=1), local=local)


def _free_between(terms: Sequence[Term], pieces: int, active: Sequence[str]) -> IntArray:
    """Codes between the pieces of bending lines in the directions that their stiffness couples with the active ones."""
    layers = [layer for term in terms if term.kind == "stiffness" for layer in term.layers]
    if not any((layer.codes % 6 >= 3).any() for layer in layers):
        return np.zeros(0, dtype=np.int64)
    coupled = np.zeros((len(layers[0].codes), 6, 6), dtype=bool)
    for layer in layers:
        size = np.abs(layer.local)
        e, i, j = np.nonzero(size > _ROUNDING * size.max(initial=0.0))
        coupled[e, layer.codes[e, i] % 6, layer.codes[e, j] % 6] = True
    moves = np.tile(np.isin(DIRECTIONS, active), (len(coupled), 1))
    for _ in DIRECTIONS:
        moves |= (coupled & moves[:, None, :]).any(axis=2)
    found = []
    for layer in layers:
        half = layer.codes.shape[1] // (pieces + 1)
        between = layer.codes[:, half:-half]
        found.append(between[np.take_along_axis(moves, between % 6, axis=1)])
    return np.unique(np.concatenate(found))


def _recoded(terms: Sequence[Term], rows: int | slice, old: int, new: int) -> tuple[Term, ...]:
    """`terms` with another code at some elements; properties that share matrices go on sharing them."""

    def changed(codes: IntArray) -> IntArray:
        table = codes.copy()
        table[rows] = np.where(table[rows] == old, new, table[rows])
        return table

    made = {id(layer): replace(layer, codes=changed(layer.codes)) for term in terms for layer in term.layers}
    return tuple(replace(term, layers=[made[id(layer)] for layer in term.layers]) for term in terms)


def _element(joint: str, text: str, elements: Sequence[ElementSet]) -> tuple[ElementSet, int]:
    """The set and the row that `text` names."""
    sets = {element.name: element for element in elements if element.is_line}
    chosen = None if text in sets else _ELEMENT.match(text)
    name, number = (text, 1) if chosen is None else (chosen["name"], int(chosen["number"]))
    if name not in sets:
        near = difflib.get_close_matches(name, sets, 1, 0.0)
        nearest = f"the nearest is {near[0]}" if near else "there is none"
        raise InputError(f"joint {joint!r}: there is no set of bars or beams called {name}; {nearest}")
    count = len(sets[name].nodes)
    if chosen is None and count > 1:
        raise InputError(f"joint {joint!r}: {name} has {count} elements; say which, as in {name}:{count}")
    if not 1 <= number <= count:
        raise InputError(f"joint {joint!r}: there is no element {text}; {name} has 1 to {count}")
    return sets[name], number - 1


def _ways(terms: Sequence[Term], row: int, node: int) -> list[str]:
    """Directions in which an element has stiffness at one of its nodes."""
    found = set()
    for term in terms:
        if term.kind == "stiffness" and term.values[row] > 0:
            for layer in term.layers:
                diagonal = np.diagonal(layer.local[row])
                stiff = diagonal > _ROUNDING * np.abs(layer.local[row]).max()
                codes = layer.codes[row]
                found |= {int(code) % 6 for code in codes[stiff & (codes // 6 == node)]}
    return [DIRECTIONS[axis] for axis in sorted(found)]


def _require_way(joint: str, text: str, at: Dof, nodes: IntArray, ways: Sequence[str], active: Sequence[str]) -> None:
    """Raise `InputError` where nothing could give way at `at`."""
    place = at.place
    if at.node not in nodes:
        raise InputError(f"joint {joint!r}: node {at.node} is none of {text}, which runs from {nodes[0]} to {nodes[1]}")
    if at.direction not in active:
        raise InputError(
            f"joint {joint!r}: {place} is held, as the structure moves in {' '.join(active)} only; take one of these"
            " directions, or add it to `active`"
        )
    if at.direction not in ways:
        raise InputError(
            f"joint {joint!r}: {text} has no stiffness in {place}, so that nothing would hold the joint's spring; it has"
            f" some in {' '.join(ways) or 'no direction'}"
        )

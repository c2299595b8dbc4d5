"""Degrees of freedom inside elements, numbered above all nodes: between equal pieces, at ends released by joints."""

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
    ElementMatrixTerm,
    ElementSet,
    NodeCoordinates,
    PropertyMatrices,
    dof_code,
    element_vectors,
)
from structid.fem.node_positions import split_by_length_power

_ELEMENT = re.compile(r"^(?P<name>.+):(?P<number>\d+)$")
#: Part of the largest entry of a matrix below which an entry is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class NumberedTerms:
    """The properties and matrices of all element sets, with codes for the degrees of freedom inside elements.

    Attributes
    ----------
    terms : mapping of str to tuple of PropertyMatrices
        By the name of the set, in order.
    owners : mapping of int to str
        Element or joint at each label above those of the nodes.
    free : int array
        Codes between pieces that move with the active directions, though these may leave them out: a beam whose ends do
        not turn bends between them.
    """

    terms: Mapping[str, tuple[PropertyMatrices, ...]]
    owners: Mapping[int, str]
    free: IntArray


def numbered_terms(
    elements: Sequence[ElementSet],
    positions: NodeCoordinates,
    used_codes: IntArray,
    active: Sequence[str],
    pieces: int = 1,
    sliding: Sequence[int] = (),
) -> NumberedTerms:
    """The terms of `elements` with lines cut into equal `pieces` and ends released by joints, with the new node labels.

    A term is a property with its values and element matrices. An element owns its pieces: it keeps one matrix for each
    property, on the nodes between them too. The end that a joint releases has a degree of freedom of its own in the
    element's matrices, in place of the node's; all others stay the node's. Matrices of bars and beams with an end at
    one of the nodes `sliding`, or with a tolerance of their lengths, are split by powers of the length.

    Parameters
    ----------
    elements : sequence of ElementSet
    positions : mapping of int to position
        All nodes, m.
    used_codes : (n,) int array
        Codes of the degrees of freedom that elements use, but for those that follow others (masses, joints), and ties.
    active : sequence of str
        Directions in which nodes move.
    pieces : int
        1 leaves the lines whole.
    sliding : sequence of int
        Nodes whose position is a property.

    Returns
    -------
    NumberedTerms
        Terms of each set by its name, the element or joint that each new node label belongs to, and the codes between
        pieces that are free to move.

    Raises
    ------
    InputError
        If a joint cannot be: its element, node or direction is not there, the element has no stiffness in it, or
        another joint is in its place.
    """
    terms: dict[str, tuple[PropertyMatrices, ...]] = {}
    owners: dict[int, str] = {}
    free: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    first = max(positions) + 1
    for element in elements:
        is_cut = pieces > 1 and is_divisible(element, positions, active)
        terms_of = partial(_terms, element, used_codes, pieces if is_cut else 1, first + len(owners))
        if element.has_uncertain_length or (element.is_line and np.isin(element.nodes, sliding).any()):
            terms[element.name] = split_by_length_power(element.name, terms_of, positions)
        else:
            terms[element.name] = terms_of(positions)
        if is_cut:
            names = (f"{element.name}:{row + 1}" for row in range(len(element.nodes)) for _ in range(pieces - 1))
            owners.update(enumerate(names, first + len(owners)))
            free.append(_free_between(terms[element.name], pieces, active))
    loosened: dict[tuple[str, int, int], str] = {}
    for joint in elements:
        if joint.loosened is not None:
            text, dof = joint.loosened
            target, row = _find_element(joint.name, text, elements)
            code, label = dof_code(dof.node, dof.direction), first + len(owners)
            other = loosened.setdefault((target.name, row, code), joint.name)
            if other != joint.name:
                raise InputError(f"joint {joint.name!r} is in the place of joint {other!r}; take one of them out")
            _require_stiff_direction(
                joint.name, text, dof, target.nodes[row], _stiff_directions(terms[target.name], row, dof.node), active
            )
            owners[label] = joint.name
            end = dof_code(label, dof.direction)
            terms[joint.name] = _replace_code(terms[joint.name], slice(None), -1, end)
            terms[target.name] = _replace_code(terms[target.name], row, code, end)
    return NumberedTerms(terms, owners, np.concatenate(free))


def is_divisible(element: ElementSet, positions: NodeCoordinates, active: Sequence[str]) -> bool:
    """True if the elements of a set are lines that can be cut: their pieces cannot move sideways without stiffness.

    A node between two bars that moves across them would have mass and no stiffness. Bars on a line have no such motion,
    and beams have bending stiffness against it. `positions` are those of the nodes, m; `active` the directions in which
    nodes move.
    """
    if not element.is_line:
        return False
    _, along = element_vectors(element.name, element.nodes, positions)
    size = along.shape[1]
    stiffness: FloatArray = np.zeros((len(along), 3, 3))
    stiffness[:, :size, :size] = along[:, :, None] * along[:, None, :]
    axes: set[int] = set()
    for term in element.property_matrices(positions, np.zeros(0, dtype=np.int64)):
        for matrix_term in term.matrix_terms if term.kind in ("stiffness", "axial_force") else ():
            columns = np.flatnonzero(matrix_term.codes[0, : matrix_term.codes.shape[1] // 2] % 6 < len(TRANSLATIONS))
            axis_of = matrix_term.codes[0, columns] % 6
            axes |= set(axis_of.tolist())
            stiffness[:, axis_of[:, None], axis_of] += (term.values > 0)[:, None, None] * matrix_term.local[
                :, columns[:, None], columns
            ]
    moving = [axis for axis in sorted(axes) if DIRECTIONS[axis] in active]
    stiff = np.linalg.eigvalsh(stiffness[:, moving][:, :, moving])
    return bool((stiff > _ROUNDING * stiff.max(initial=0.0)).all())


def _terms(
    element: ElementSet, used_codes: IntArray, pieces: int, first: int, positions: NodeCoordinates
) -> tuple[PropertyMatrices, ...]:
    """The terms of a set whose lines are cut into `pieces`, with inner nodes labelled from `first` on.

    Lines stay whole if `pieces` is 1. `positions` are node coordinates in m by label; `used_codes` (n_codes,) the
    degrees of freedom of the other elements.
    """
    if pieces > 1:
        return _cut_into_pieces(element, positions, used_codes, pieces, first)
    return element.property_matrices(positions, used_codes)


def _cut_into_pieces(
    element: ElementSet, positions: NodeCoordinates, used_codes: IntArray, pieces: int, first: int
) -> tuple[PropertyMatrices, ...]:
    """Terms of a set whose lines are each cut into `pieces` elements; new nodes are labelled from `first` on.

    They follow line by line. A term is a property with its values and element matrices. `positions` are node
    coordinates in m by label; `used_codes` (6 times the node plus 0 to 5 for X to RZ) are degrees of freedom that other
    elements use.
    """
    scaled = {label: position / pieces for label, position in positions.items()}  # lines as long as one piece
    between = first + np.arange(len(element.nodes) * (pieces - 1)).reshape(-1, pieces - 1)
    terms = element.property_matrices(scaled, used_codes)
    chained = {
        id(matrix_term): _chain_matrices(matrix_term, between) for term in terms for matrix_term in term.matrix_terms
    }
    return tuple(
        replace(term, matrix_terms=[chained[id(matrix_term)] for matrix_term in term.matrix_terms]) for term in terms
    )


def _chain_matrices(matrix_term: ElementMatrixTerm, between: IntArray) -> ElementMatrixTerm:
    """Matrices of chains of equal pieces, (n_pieces + 1) nodes each, from the matrices of one piece.

    `matrix_term` has those of one piece of each element, on its two ends; `between` (n_elements, n_pieces - 1) are the
    labels of the inner nodes. Rows are the first end, the inner nodes in order, and the second end.
    """
    n, width = matrix_term.codes.shape
    half, pieces = width // 2, between.shape[1] + 1
    start, end = matrix_term.codes[:, :half], matrix_term.codes[:, half:]
    middle = 6 * between[:, :, None] + (start % 6)[:, None, :]
    local: FloatArray = np.zeros((n, (pieces + 1) * half, (pieces + 1) * half))
    for piece in range(pieces):
        span = slice(piece * half, piece * half + width)
        local[:, span, span] += matrix_term.local
    return replace(matrix_term, codes=np.concatenate([start, middle.reshape(n, -1), end], axis=1), local=local)


def _free_between(terms: Sequence[PropertyMatrices], pieces: int, active: Sequence[str]) -> IntArray:
    """Codes (n,), sorted, of the degrees of freedom at the nodes between pieces of cut lines that are free to move.

    These are the active directions and all that the stiffness of the pieces couples with them, directly or through
    others. A code is 6 times the label of the node plus 0 to 5 for X, Y, Z, RX, RY, RZ. Empty for lines whose stiffness
    has no rotations, which are bars.

    `terms` are those of the set, cut into `pieces`; `active` are the directions in which nodes move.
    """
    matrix_terms = [matrix_term for term in terms if term.kind == "stiffness" for matrix_term in term.matrix_terms]
    if not any((matrix_term.codes % 6 >= 3).any() for matrix_term in matrix_terms):
        return np.zeros(0, dtype=np.int64)
    coupled = np.zeros((len(matrix_terms[0].codes), 6, 6), dtype=bool)
    for matrix_term in matrix_terms:
        size = np.abs(matrix_term.local)
        e, i, j = np.nonzero(size > _ROUNDING * size.max(initial=0.0))
        coupled[e, matrix_term.codes[e, i] % 6, matrix_term.codes[e, j] % 6] = True
    moves = np.tile(np.isin(DIRECTIONS, active), (len(coupled), 1))
    for _ in DIRECTIONS:
        moves |= (coupled & moves[:, None, :]).any(axis=2)
    codes = []
    for matrix_term in matrix_terms:
        half = matrix_term.codes.shape[1] // (pieces + 1)
        between = matrix_term.codes[:, half:-half]
        codes.append(between[np.take_along_axis(moves, between % 6, axis=1)])
    return np.unique(np.concatenate(codes))


def _replace_code(
    terms: Sequence[PropertyMatrices], rows: int | slice, old: int, new: int
) -> tuple[PropertyMatrices, ...]:
    """Copy of `terms` with the code `old` replaced by `new` in the element rows `rows`.

    A code is 6 times the label of a node plus 0 to 5 for X to RZ. Properties that share matrices go on sharing them.
    """

    def replaced(codes: IntArray) -> IntArray:
        """A copy of `codes` (n_elements, n_local) with `old` replaced by `new` in the chosen rows."""
        table = codes.copy()
        table[rows] = np.where(table[rows] == old, new, table[rows])
        return table

    changed_terms = {
        id(matrix_term): replace(matrix_term, codes=replaced(matrix_term.codes))
        for term in terms
        for matrix_term in term.matrix_terms
    }
    return tuple(
        replace(term, matrix_terms=[changed_terms[id(matrix_term)] for matrix_term in term.matrix_terms])
        for term in terms
    )


def _find_element(joint: str, text: str, elements: Sequence[ElementSet]) -> tuple[ElementSet, int]:
    """The element set and row (from 0) that `text` names: ``girder:2`` (from 1), or ``girder`` of one element.

    Only bars and beams count. Raises `InputError`, which names `joint`, if there is no such element or `text` leaves it
    open.
    """
    sets = {element.name: element for element in elements if element.is_line}
    chosen = None if text in sets else _ELEMENT.match(text)
    name, number = (text, 1) if chosen is None else (chosen["name"], int(chosen["number"]))
    if name not in sets:
        close = difflib.get_close_matches(name, sets, 1, 0.0)
        nearest = f"the nearest is {close[0]}" if close else "there is none"
        raise InputError(f"joint {joint!r}: there is no set of bars or beams called {name}; {nearest}")
    count = len(sets[name].nodes)
    if chosen is None and count > 1:
        raise InputError(f"joint {joint!r}: {name} has {count} elements; say which, as in {name}:{count}")
    if not 1 <= number <= count:
        raise InputError(f"joint {joint!r}: there is no element {text}; {name} has 1 to {count}")
    return sets[name], number - 1


def _stiff_directions(terms: Sequence[PropertyMatrices], row: int, node: int) -> list[str]:
    """Directions, such as "RZ", in which the element in `row` has stiffness on its diagonal at `node`.

    They are in the order X to RZ. `terms` are the properties of its set with their matrices; only stiffnesses with a
    value above 0 count.
    """
    axes = set()
    for term in terms:
        if term.kind == "stiffness" and term.values[row] > 0:
            for matrix_term in term.matrix_terms:
                diagonal = np.diagonal(matrix_term.local[row])
                stiff = diagonal > _ROUNDING * np.abs(matrix_term.local[row]).max()
                codes = matrix_term.codes[row]
                axes |= {int(code) % 6 for code in codes[stiff & (codes // 6 == node)]}
    return [DIRECTIONS[axis] for axis in sorted(axes)]


def _require_stiff_direction(
    joint: str, text: str, dof: Dof, nodes: IntArray, directions: Sequence[str], active: Sequence[str]
) -> None:
    """Raise `InputError` if a joint cannot release `dof`: not a node of the element, not active, or without stiffness.

    `joint` and `text` are the names of the joint and of its element, for messages. `nodes` are the element's two ends,
    `directions` those in which it has stiffness at `dof`, and `active` those in which nodes move.
    """
    name = dof.place
    if dof.node not in nodes:
        raise InputError(
            f"joint {joint!r}: node {dof.node} is none of {text}, which runs from {nodes[0]} to {nodes[1]}"
        )
    if dof.direction not in active:
        raise InputError(
            f"joint {joint!r}: {name} is held, as the structure moves in {' '.join(active)} only; take one of these"
            " directions, or add it to `active`"
        )
    if dof.direction not in directions:
        raise InputError(
            f"joint {joint!r}: {text} has no stiffness in {name}, so that nothing would hold the joint's spring; it has"
            f" some in {' '.join(directions) or 'no direction'}"
        )

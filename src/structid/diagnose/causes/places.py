"""Places of a model where a candidate cause may be: nodes, elements and the parameters that move them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from structid.core.arrays import ComplexArray, IntArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.diagnose.effects import Directions, direction_of
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.fem import Spring
from structid.forward import FrfProblem
from structid.forward.frf.response import driving_bases

T = TypeVar("T")

#: Of larger models so many nodes and elements are tried.
MOST_NODES, MOST_ELEMENTS = 60, 150
#: Degrees of freedom beyond which only a few changes are fitted, and beyond which only changes of records are tried.
MOST_DOFS, MOST_SCREENED_DOFS = 1200, 3000
#: Places of one cause that are named.
_SHOWN = 3


def spread(items: Sequence[T], most: int) -> list[T]:
    """All items, or `most` of them, evenly chosen with the first and the last, where there are more."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int)]


def chosen_nodes(receptances: Receptances) -> set[int]:
    """Labels of the nodes where something may be added: up to 60 evenly chosen ones that move, and those of channels.

    Nodes of sensors and loads come in addition, since what is mounted there is forgotten most easily. Nodes inside
    elements do not count. `receptances` are those of one record.
    """
    known = receptances.structure.nodes
    movable = dict.fromkeys(dof.node for dof in receptances.columns if dof.node in known)
    record = receptances.problem.record
    measured = {dof.node for dof in (*record.outputs, *record.inputs)}.intersection(movable)
    return measured.union(spread(list(movable), MOST_NODES))


def has_places(problem: FrfProblem) -> bool:
    """True of models small enough for changes at nodes and elements: up to 3000 degrees of freedom.

    The limit is 1200 for models with components, measured components or supports that drive them.
    """
    structure = problem.structure
    is_plain = not (structure.components or structure.measured or driving_bases(structure, problem.record))
    return structure.n_dofs <= (MOST_SCREENED_DOFS if is_plain else MOST_DOFS)


def chosen_dofs(receptances: Receptances) -> Iterator[tuple[Dof, Directions]]:
    """Degrees of freedom of the nodes in `chosen_nodes`, in the order of `receptances`, and their unit directions."""
    nodes = chosen_nodes(receptances)
    for dof in receptances.columns:
        if dof.node in nodes:
            yield dof, direction_of((dof, 1.0))


def inertia(receptances: Receptances) -> ComplexArray:
    """The square s^2 of the Laplace variable, by which a mass enters the dynamic stiffness, (n_lines,)."""
    return receptances.laplace**2


def velocity(receptances: Receptances) -> ComplexArray:
    """The Laplace variable s in 1/s, by which a damper enters the dynamic stiffness, (n_lines,)."""
    return receptances.laplace


def constant(receptances: Receptances, loss: float = 0.0) -> ComplexArray:
    """1 + i times a loss factor, by which a stiffness enters the dynamic stiffness, (n_lines,)."""
    return np.full_like(receptances.laplace, 1 + 1j * loss)


def spring_ends(receptances: Receptances) -> Iterator[tuple[tuple[str, str], Directions]]:
    """Springs between two degrees of freedom that can both move, as (names of the ends, direction of moving apart).

    Springs whose ends move apart only with a driven support are left out.
    """
    for element in receptances.structure.elements:
        if isinstance(element, Spring) and element.second is not None:
            for first, second in zip(element.first, element.second, strict=True):
                apart = direction_of((second.unsigned, float(second.sign)), (first.unsigned, -float(first.sign)))
                moves = receptances.reached(apart.codes)
                if moves.any(axis=1).all() and (apart.weights[:, 0] @ moves)[receptances.undriven].any():
                    yield (first.place, second.place), apart


def moved_elements(receptances: Receptances) -> Iterator[tuple[ElementMatrix, tuple[int, ...]]]:
    """Stiffness and mass matrices of elements, each with the positions of the parameters that change it; () if none does."""
    design = receptances.problem.parameters.design.tocsr()
    for one in receptances.elements(("stiffness", "mass")):
        yield one, tuple(design.indices[design.indptr[one.row] : design.indptr[one.row + 1]].tolist())


def summed(items: Sequence[ElementMatrix]) -> ElementMatrix:
    """The sum of several element matrices over all of their degrees of freedom; all else is that of the first.

    Where the matrices are of different properties, `property` of the sum is the kind of the first, such as ``stiffness``.
    `items` must not be empty.
    """
    first, *more = items
    if not more:
        return first
    codes = np.unique(np.concatenate([one.codes[one.codes >= 0] for one in items]))
    matrix = np.zeros((len(codes), len(codes)))
    for one in items:
        there = one.codes >= 0
        place: IntArray = np.searchsorted(codes, one.codes[there])
        matrix[np.ix_(place, place)] += one.matrix[np.ix_(there, there)]
    prop = first.property if len({one.property for one in items}) == 1 else first.kind
    return first._replace(property=prop, codes=codes, matrix=matrix)


class Factored(NamedTuple):
    """An element matrix as D D': its directions, its kind and its loss factor."""

    directions: Directions
    kind: str
    loss: float

    def law(self, receptances: Receptances) -> ComplexArray:
        return inertia(receptances) if self.kind == "mass" else constant(receptances, self.loss)


def factored(
    receptances: Receptances, element_matrix: ElementMatrix, most_directions: float = np.inf
) -> Factored | None:
    """Element matrix as D D' with the directions D in which it acts; None if zero, too wide, or unable to move.

    D has a column for each eigenvalue above 1e-9 of the largest, its eigenvector times the root; it is too wide with
    more than `most_directions` columns, and must move a free degree of freedom. `element_matrix` is of one element, or
    a sum of several; its kind and loss factor are kept.
    """
    size, vectors = np.linalg.eigh(element_matrix.matrix)
    keep = size > 1e-9 * max(size[-1], 0.0)
    directions = Directions(element_matrix.codes, vectors[:, keep] * np.sqrt(size[keep]))
    if not 0 < keep.sum() <= most_directions or not len(directions.rows(receptances)[0]):
        return None
    return Factored(directions, element_matrix.kind, element_matrix.loss)


def record_words(title: str) -> str:
    """`title` with the word "record" in front, unless it begins with that word."""
    return title if title.startswith("record ") else f"record {title}"


def few_words(places: tuple[str, ...]) -> str:
    """The places as a list in words: up to four, otherwise the first three and how many more there are."""
    return join_words(places) if len(places) <= _SHOWN + 1 else f"{join_words(places, _SHOWN)} stretches"

"""A candidate cause of a misfit: one change of the model or of a record, at one place; and where candidates are enumerated.

Places are nodes, elements and the parameters that move them, or the sensors and loads of a record.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.diagnose.effects import Directions, direction_of
from structid.diagnose.model_edits import AddPart, AddUnknown, Edit, Edits, rounded
from structid.diagnose.receptances import ElementMatrix, Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import Spring
from structid.forward import FrfProblem, RecordProblem
from structid.forward.frf.response import driving_bases

#: Bounds of a strength that cannot be negative.
POSITIVE = (0.0, np.inf)


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate(metaclass=ABCMeta):
    """One change that might explain a misfit; each kind is a class of its own.

    Attributes
    ----------
    where : tuple of str
        Degrees of freedom, nodes, elements or channels.
    strengths : (n,) float array
        Those that are tried, in the unit of what changes; 0 is no change.
    bounds : (float, float)
        Least and greatest strength that makes sense.
    record : int, optional
        Position of the only record that is changed; None if all are.
    """

    #: Its kind, and what results call that.
    kind: ClassVar[str]
    result_kind: ClassVar[str] = ""
    #: Whether it only damps, leaves data out, or has a place among those to refit whatever a linear look says of it.
    is_damping: ClassVar[bool] = False
    leaves_data_out: ClassVar[bool] = False
    has_reserved_place: ClassVar[bool] = False
    #: Whether its fit also begins at the initial values: where it drags all values along, their fit is far from the truth.
    begins_at_start: ClassVar[bool] = False
    #: Whether a changed model is screened at the initial values too: no linear step leads there from values that fit without it.
    is_screened_at_start: ClassVar[bool] = False
    #: Parameters that a fit of it determines beside those of the changed model.
    n_hidden: ClassVar[int] = 0
    #: Factors on the strength of kinds whose strength is no parameter, or has far minima.
    other_strengths: ClassVar[tuple[float, ...]] = ()

    where: tuple[str, ...]
    strengths: FloatArray = field(default_factory=lambda: np.ones(1))
    bounds: tuple[float, float] = (-np.inf, np.inf)
    record: int | None = None

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidates for records of one structure whose effects follow from its receptances; empty by default.

        `records` are the receptances of each record, and `record_names` their names.
        """
        yield from ()

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """Candidates whose effect needs the changed model itself, evaluated anew; empty by default.

        `problems` has one problem for each record.
        """
        yield from ()

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        """Changes of the FRF, (n_strengths, n_lines, n_outputs, n_inputs), in its unit, by each of `strengths`.

        Zeros by default, where only a fit shows the change.
        """
        return np.zeros((len(strengths), *receptances.frf.shape), dtype=np.complex128)

    @abstractmethod
    def edits(self, model: TestedModel, strength: float) -> Edits:
        """The edits that make the change.

        Raises
        ------
        InputError
            If the model has no place for it.
        """

    @abstractmethod
    def sentence(self, value: float | None) -> str:
        """Clause that states the change; `value` is the fitted value of its parameter, None where it has none."""

    def named_kind(self, value: float | None) -> str:
        """Name of the kind in results: `self.result_kind`, or `self.kind` if that is empty; `value` is not used."""
        return self.result_kind or self.kind

    @property
    def place(self) -> tuple[str, tuple[str, ...]]:
        """Kind and `where` as a tuple: equal for the same change of different records."""
        return self.kind, self.where

    @property
    def key(self) -> Hashable:
        """Kind, place and record: of candidates with the same key only one is fitted."""
        return self.place, self.record

    @property
    def family(self) -> str:
        """Name of the group of candidates of which a screen keeps the best few, however many others promise more."""
        return self.place[0]

    @property
    def places(self) -> tuple[str, ...]:
        """Places of the change as results list them, `where` by default."""
        return self.where

    @property
    def handicap(self) -> float:
        """Penalty on the criterion in the order of causes, by which the change loses to a simpler one with the same effect."""
        return 0.0

    @property
    def n_own(self) -> int:
        """Number of parameters that a fit of the change determines and that the changed model does not count."""
        return self.n_hidden

    def alike_by(self) -> tuple[Directions, tuple[object, ...]] | None:
        """Directions and values that determine the effect completely; None where these alone do not.

        Candidates with the same motion in their directions and equal values have the same effect.
        """
        return None


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


#: Factors, as logarithms, and parts of the period of the highest line, that are tried.
FACTORS = np.array([0.005, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])
#: By which a channel may be turned, rad.
ANGLES = np.radians([3.0, 8.0, 15.0, 25.0, 40.0, 60.0, 90.0, -3.0, -8.0, -15.0, -25.0, -40.0, -60.0, -90.0])
#: Steps on a number of a study whose fit is bracketed.
NUMBER_STEPS = (1.6, 1.25, 1.1, 1.04, 1.015)


class Channel(NamedTuple):
    """A sensor (`axis` 1 of the FRF) or a load (`axis` 2) of a record.

    `record` and `number` are the indices, from 0, of the record and of the channel among the `n_alike` of its axis.
    """

    record: int
    axis: int
    number: int
    dof: Dof
    n_alike: int


def channels(records: Sequence[Receptances], axis: int) -> Iterator[tuple[Receptances, Channel]]:
    """Pairs (receptances of the record, channel) of every sensor (`axis` 1) or load (`axis` 2) of all records.

    `records` are the receptances of each record. A channel has the index of its record and of itself, from 0, and the
    number of channels of its kind.
    """
    for number, receptances in enumerate(records):
        dofs = receptances.problem.record.outputs if axis == 1 else receptances.problem.record.inputs
        for index, dof in enumerate(dofs):
            yield receptances, Channel(number, axis, index, dof, len(dofs))


def index_of(receptances: Receptances, axis: int, place: str) -> int:
    """Position of the channel at a place such as ``3X`` among the sensors (axis 1) or loads (axis 2) of the record.

    Raises
    ------
    ValueError
        If there is no channel at the place.
    """
    dofs = receptances.problem.record.outputs if axis == 1 else receptances.problem.record.inputs
    return [dof.place for dof in dofs].index(place)


def other_directions(receptances: Receptances, dof: Dof) -> Iterator[tuple[str, FloatArray]]:
    """Pairs (name, weights) of the other directions in which the node of `dof` moves, weights (n_dofs,).

    Of a translation these are the other translations, of a rotation the other rotations.
    """
    for other, column in receptances.columns.items():
        if other.node == dof.node and other.direction != dof.direction and other.is_rotation == dof.is_rotation:
            yield other.place, column


def added_spring(table: str, entry: Mapping[str, Any], loss_factor: float | None) -> list[Edit]:
    """The edits that add a spring or joint of unknown stiffness; `loss_factor` is another unknown, None for none.

    `table` is the type of element set in a study, such as ``spring``, and `entry` its arguments, the name among them.
    """
    loss = {} if loss_factor is None else {"loss_factor": loss_factor}
    return [
        AddPart(table, {**entry, **loss}),
        *(AddUnknown({"property": prop, "elements": entry["name"]}) for prop in ("stiffness", *loss)),
    ]


def unknown_of_either_sign(prop: str, name: str, strength: float) -> AddUnknown:
    """The edit that declares `prop` of the added set `name` an unknown, which may be negative if `strength` is.

    A negative `strength` is the start; otherwise the start is the value of the set.
    """
    signed = {} if strength > 0 else {"positive": False, "start": rounded(strength)}
    return AddUnknown({"property": prop, "elements": name, **signed})

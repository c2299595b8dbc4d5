"""A candidate cause of a misfit: one change of the model or of a record, at one place."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.effects import Directions
from structid.diagnose.model_edits import Edits
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem

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
        """Changes of the FRF, (n_strengths, n_lines, n_outputs, n_inputs); 0 by default, where only a fit shows the change."""
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
        """Kind and place, whatever the record."""
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
        """Places of the change as results list them."""
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

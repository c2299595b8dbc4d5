"""Set-ups of records: a record with the structure that it was measured on, as identification needs them."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeAlias, TypeVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward import ChannelErrors, ChannelUnknown, FrfProblem, RecordProblem
from structid.forward.channel_errors import ChannelsOfRecord
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import FittedUnknowns, RecordFit
from structid.identification.truncation import Truncation, modes_truncation
from structid.inversion import Estimate
from structid.inversion.search.work import StageProgress, TaskExecutor
from structid.records import FrfRecord, TimeRecord
from structid.records.quality.findings import Finding
from structid.unknowns import Parameters

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit
    from structid.modal import ModalRecord

P = TypeVar("P", bound=RecordProblem)


@dataclass(frozen=True, eq=False)
class Prepared(Generic[P]):
    """The least-squares problem of a record, and what is worth a warning about it, and about its structure whatever the record."""

    problem: P
    warnings: tuple[str, ...] = ()
    of_structure: tuple[str, ...] = ()


class RecordSetup(Generic[P], metaclass=ABCMeta):
    """One record of any kind and what it was measured on; what it does not say has a default here.

    Attributes
    ----------
    structure : Structure
        As it was for this record: with its supports and added masses.
    parameters : Parameters
        Those of this structure; names shared with other set-ups are the same unknowns.
    record : FrfRecord, TimeRecord or ModalRecord
    name : str
        What reports call it.
    faults : tuple of Finding
        What its histories show by themselves of single channels.
    calibration : float or None
        Standard deviation of the common gain of its channels, a part; that of the options' tolerances where None.
    channel_unknowns : sequence of ChannelUnknown
        Errors of its sensors and loads that are identified too.
    record_class : type
        Class of its record.
    """

    record_class: ClassVar[type]
    structure: Structure
    parameters: Parameters
    record: FrfRecord | TimeRecord | ModalRecord
    name: str
    faults: tuple[Finding, ...] = ()
    calibration: float | None = None
    channel_unknowns: Sequence[ChannelUnknown] = ()

    @abstractmethod
    def prepared(self, options: IdentifyOptions) -> Prepared[P]:
        """The problem of the lines that `options` choose."""

    def problem_warnings(self, problem: P) -> tuple[str, ...]:
        """Warnings that take work with the model of a problem, made only where they are asked for; `prepared` has none of them."""
        return ()

    def without_modes_beyond_model(self) -> Self:
        """The set-up without measured modes beyond those of its model; itself where the record holds no modes."""
        return self

    @abstractmethod
    def modelled_by(
        self, structure: Structure, parameters: Parameters, channel_unknowns: Sequence[ChannelUnknown] = ()
    ) -> RecordSetup[P]:
        """A copy with another model, and other errors of channels where the record can have some."""

    def channel_errors(
        self, unknowns: Sequence[ChannelUnknown], lines: ChannelsOfRecord | None = None
    ) -> ChannelErrors | None:
        """Unknown errors of its sensors and loads, for all lines or those given; None where none is declared.

        Raises
        ------
        InputError
            If the record has no such channel or error, or two of them claim the same.
        """
        if unknowns:
            raise InputError("the record has no errors of channels; leave them out")
        return None

    @property
    @abstractmethod
    def channels(self) -> tuple[tuple[str, tuple[Dof, ...]], ...]:
        """Sensors as ``output`` and loads as ``input``, where the record has them."""

    @abstractmethod
    def words(self, options: IdentifyOptions) -> str:
        """One line on the record and the part of it that is used."""

    def axes(self, options: IdentifyOptions) -> tuple[FloatArray, FloatArray]:
        """Frequencies that are used and that are judged, Hz; infinite where the model is not evaluated at lines."""
        return np.full(1, np.inf), np.full(1, np.inf)

    def begun(self, problem: P) -> P:
        """The problem from a better start, where the record alone gives one."""
        return problem

    @property
    def own_estimator(self) -> str:
        """Name of an estimator that takes this record alone; "" where it is fitted by a search together with other records."""
        return ""

    def estimated(self, options: IdentifyOptions, progress: StageProgress | None, work: TaskExecutor) -> Estimate:
        """The estimate by an estimator of the set-up's own.

        `TypeError` for a set-up whose problem is to be searched.
        """
        raise TypeError("the record has no estimator of its own; search its problem")

    def truncation(self, problem: P, theta: FloatArray) -> Truncation | None:
        """Truncation by reduced components of the structure, as this record sees it; None where it has none."""
        values = problem.property_values(problem.physical(theta))
        return modes_truncation(problem.structure, values, float(problem.frequency.max()))

    def shown_problem(self, options: IdentifyOptions, channels: ChannelErrors | None) -> FrfProblem | None:
        """The problem of averaged FRFs that shows the fit of histories; None where the record shows it itself."""
        return None

    def response_fit(
        self, title: str, problem: P, fitted: FittedUnknowns, options: IdentifyOptions
    ) -> RecordFit | None:
        """The answer beside its responses, where it has some."""
        return None

    def modal_fit(self, title: str, problem: P, fitted: FittedUnknowns, options: IdentifyOptions) -> ModalFit | None:
        """The answer beside its modes, where it has some."""
        return None


#: A record of any kind; its problem is only handed back to it.
AnySetup: TypeAlias = RecordSetup[Any]


def titles(setups: Sequence[AnySetup]) -> list[str]:
    """Title of each record in reports: its name, or its number."""
    return [setup.name or f"record {number}" for number, setup in enumerate(setups, 1)]


def prefixes(setups: Sequence[AnySetup]) -> list[str]:
    """Prefix of messages about each record: its title where there are several."""
    return [f"{title}: " if len(setups) > 1 else "" for title in titles(setups)]


def prepared_warnings(setups: Sequence[AnySetup], prepared: Sequence[Prepared[Any]]) -> list[str]:
    """Warnings about structures, each once, then about each record, with its title before it if there are several.

    Parts of mesh files that the structure lacks come first; `prepared` are the problems of `setups` with their
    warnings.
    """
    left_aside = [words for setup in setups for words in setup.structure.left_aside]
    of_structures = dict.fromkeys([*left_aside, *(words for ready in prepared for words in ready.of_structure)])
    of_records = [
        prefix + words
        for prefix, setup, ready in zip(prefixes(setups), setups, prepared, strict=True)
        for words in (*ready.warnings, *setup.problem_warnings(ready.problem))
    ]
    return [*of_structures, *of_records]

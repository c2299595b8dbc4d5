"""Set-ups of records: a record with the structure that it was measured on, as identification needs them.

Records (warnings) and models (errors) are checked before anything is estimated.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeAlias, TypeVar

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.core.errors import InputError, SingularModelError
from structid.fem import Structure
from structid.forward import ChannelErrors, ChannelUnknown, FrfProblem, RecordProblem
from structid.forward.channel_errors import ChannelsOfRecord
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import FittedUnknowns, RecordFit, Truncation, modes_truncation
from structid.inversion import Estimate
from structid.inversion.search.work import StageProgress, TaskExecutor
from structid.records import FrfRecord, TimeRecord
from structid.records.quality import Finding
from structid.unknowns import Parameters

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit
    from structid.modal import ModalRecord


_DENSE_UP_TO = 600
_NULL = 1e-12
#: Lines from which on the turning of phases is no chance, and the part of it the wrong way that is none either.
_ENOUGH_LINES, _WRONG_WAY = 100, 0.5


def record_warnings(record: FrfRecord) -> tuple[str, ...]:
    """Warnings about signs and coherence of an FRF record that do not look right.

    A driving point must have a real part of its mobility of at least 0 (it can only take power in); a record whose
    mobility there is negative at most lines has a sensor or load with the wrong sense or another sign convention.
    Phases of responses fall with frequency; where they rise, imaginary parts have the other sign. One warning names the
    sensors with a coherence of less than 0.8 at more than 20 % of their values.
    """
    warnings = []
    for i, load in enumerate(record.inputs):
        for o, sensor in enumerate(record.outputs):
            if sensor.unsigned == load.unsigned and record.frequency[-1] > 0:
                warnings.extend(_driving_point(record, o, i))
    warnings.extend(_phases_that_rise(record))
    if record.coherence is not None:
        low = (record.coherence < 0.8).mean(axis=(0, 2))
        sensors = [sensor for sensor, part in zip(record.outputs, low, strict=True) if part > 0.2]
        if sensors:
            part = f"{'up to ' if len(sensors) > 1 else ''}{100 * low.max():.0f} %"
            warnings.append(f"coherence of {join_words(sensors, 4)} is below 0.8 at {part} of the lines")
    return tuple(warnings)


def _phases_that_rise(record: FrfRecord) -> list[str]:
    """List with a warning if phases rise with frequency over all channels together; empty if not.

    At least 100 lines are needed. Phases rise if the imaginary parts of H(k+1) conj(H(k)) sum to more than half of
    their absolute sum.
    """
    turning = (record.values[1:] * record.values[:-1].conj()).imag
    total = float(np.abs(turning).sum())
    if len(record.frequency) < _ENOUGH_LINES or total == 0 or float(turning.sum()) <= _WRONG_WAY * total:
        return []
    return [
        "phases rise through the resonances, so that responses come before their forces: imaginary parts have the other sign, as of"
        " a time convention exp(-i omega t); conjugate the FRFs in the export"
    ]


def _driving_point(record: FrfRecord, o: int, i: int) -> list[str]:
    """List with a warning if the mobility of output `o` over load `i` has a negative real part at most lines.

    It is empty if not. `o` and `i` are indices of channels at the same degree of freedom, in either sense; 0 Hz is left
    out.
    """
    keep = record.frequency > 0
    mobility = record.lines(np.flatnonzero(keep)).as_kind("mobility").values[:, o, i]
    sense = record.outputs[o].sign * record.inputs[i].sign
    negative = float((sense * mobility.real < 0).mean())
    if negative <= 0.5:
        return []
    return [
        f"driving point {record.outputs[o]} / {record.inputs[i]}: the real part of mobility is negative at"
        f" {100 * negative:.0f} % of the lines; check the sense of the sensor, the load and the sign convention of the FRF"
    ]


def require_sound_model(structure: Structure, values: FloatArray, lowest: float) -> None:
    """Raise `SingularModelError` where the model's matrices are not finite, it has no mass, or it has a mechanism.

    Looked for, with the degrees of freedom that take part, are motion without mass, damping and stiffness; motion
    without mass and stiffness; and, where a line at 0 Hz is used, motion without stiffness (supports are missing).
    Models of more than 600 degrees of freedom are left to the factorization.

    Parameters
    ----------
    structure : Structure
        The model; not checked if it has no matrices.
    values : (n_values,) float array
        Property values.
    lowest : float
        Lowest line used, Hz.
    """
    if structure.n_dofs > _DENSE_UP_TO or not structure.has_matrices:
        return
    mass, stiffness, viscous, structural = (
        structure.matrix(matrix_kind, values).toarray()
        for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    if not all(np.isfinite(matrix).all() for matrix in (mass, stiffness, viscous, structural)):
        raise SingularModelError(
            "the model's matrices are not finite: a property is too large or too small; correct it"
        )
    if not mass.any() and structure.has_modes:
        raise SingularModelError("the structure has no mass; add point masses, or `mass` to its beams or bars")
    elastic = stiffness + structural
    every = _scaled(elastic) + _scaled(mass) + _scaled(viscous)
    loose = _null_words(structure, every)
    if loose:
        raise SingularModelError(
            f"the model is singular: {loose} can move with neither mass nor stiffness; fix it in `fixed`, leave its"
            " direction out of `active`, or give it stiffness or mass"
        )
    massless = np.diag(mass) <= 0
    loose = _null_words(structure, _scaled(elastic)[np.ix_(massless, massless)], np.flatnonzero(massless))
    if loose:
        raise SingularModelError(
            f"the model is singular: {loose} can move with no mass and no stiffness, so modes do not exist; fix it in"
            " `fixed` or give it stiffness"
        )
    if lowest == 0:
        loose = _null_words(structure, elastic)
        if loose:
            raise SingularModelError(
                f"the model is singular at 0 Hz: nothing holds {loose}; add supports in `fixed` or springs to the"
                " ground, or leave 0 Hz out with `band` in [method]"
            )


def _scaled(matrix: FloatArray) -> FloatArray:
    largest = np.abs(matrix).max(initial=0.0)
    return matrix / largest if largest > 0 else matrix


def _null_words(structure: Structure, matrix: FloatArray, members: np.ndarray | None = None) -> str:
    """Names of the degrees of freedom that move most in a null vector of `matrix`, at most six; "" if it is regular.

    `matrix` (n, n) is positive semidefinite; `members` (n,) are the indices of its rows among all degrees of
    freedom, all by default. If diagonal entries are 0, their rows alone are named; else those above a tenth of the
    largest.
    """
    if not len(matrix):
        return ""
    index = np.arange(len(matrix)) if members is None else members
    diagonal = np.sqrt(np.abs(np.diag(matrix)))
    empty = diagonal == 0
    if empty.any():
        return ", ".join(structure.words(structure.dofs[i]).rstrip("+") for i in index[empty][:6])
    values, vectors = linalg.eigh(matrix / np.outer(diagonal, diagonal))
    if values[0] > _NULL * len(matrix):
        return ""
    part = np.abs(vectors[:, 0] / diagonal)
    largest = np.argsort(-part, kind="stable")[:6]
    chosen = sorted(int(i) for i in largest if part[i] > 0.1 * part.max())
    return ", ".join(structure.words(structure.dofs[index[i]]).rstrip("+") for i in chosen)


P = TypeVar("P", bound=RecordProblem)


@dataclass(frozen=True, eq=False)
class Prepared(Generic[P]):
    """The least-squares problem of a record, `warnings` about it, and those `of_structure` that hold for any record."""

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
        """Pairs of "output" and the sensors, and of "input" and the loads; a pair that the record lacks is left out."""

    @abstractmethod
    def words(self, options: IdentifyOptions) -> str:
        """One line on the record and the part of it that is used."""

    def axes(self, options: IdentifyOptions) -> tuple[FloatArray, FloatArray]:
        """Frequencies (Hz) that are used in the fit, (n_fitted,), and those on which it is judged, (n_judged,).

        Both are a single infinity where the model is not evaluated at lines.
        """
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
        """Truncation by reduced components of the structure up to the highest frequency of `problem`; None without any.

        `theta` (n_params,) are the free variables.
        """
        values = problem.property_values(problem.physical(theta))
        return modes_truncation(problem.structure, values, float(problem.frequency.max()))

    def shown_problem(self, options: IdentifyOptions, channels: ChannelErrors | None) -> FrfProblem | None:
        """The problem of averaged FRFs that shows the fit of histories; None where the record shows it itself."""
        return None

    def response_fit(
        self, title: str, problem: P, fitted: FittedUnknowns, options: IdentifyOptions
    ) -> RecordFit | None:
        """The fitted and the initial model beside the measured responses; None where the record has none."""
        return None

    def modal_fit(self, title: str, problem: P, fitted: FittedUnknowns, options: IdentifyOptions) -> ModalFit | None:
        """The fitted and the initial model beside the measured modes; None where the record has none."""
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

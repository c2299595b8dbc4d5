"""Frequency response functions as a record of a study: how they are fitted, and what the fit shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError, NoLinesError
from structid.dynamics.receptance import FEWEST_LINES
from structid.fem import Structure
from structid.forward import ChannelUnknown, FrfProblem, ResponseCache, measures_everything, one_step_values
from structid.forward.channel_errors import ChannelErrors, ChannelsOfRecord, channel_errors
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import FittedUnknowns, RecordFit, Truncation, frf_truncation, record_fit
from structid.identification.setups.setup import Prepared, RecordSetup, record_warnings
from structid.records import FrfRecord
from structid.records.noise_floor import missing_floor, with_noise_floor
from structid.records.quality import Finding
from structid.unknowns import Parameters

_RELATIVE_WEIGHT = 0.1
#: Degrees of freedom from which on lines are found by a sweep by default, and its error.
_LARGE, _USUAL_ERROR = 1000, 1e-5
_NO_NOISE = (
    "the record has no noise level: every line is weighted by its own magnitude{floor}, and standard deviations come from the"
    " scatter of the residual"
)
_NO_FLOOR = (
    "the stated noise is too small between the resonances: neighbouring lines show {floor}, which was added to it"
)
_STATE_FLOOR = "; state `absolute = {absolute:.2g}` beside `relative` in [record.noise]"
#: Floors that the noise of records leaves out, by record, then by band and noise: a search for causes asks for them again.
_FLOORS: WeakKeyDictionary[FrfRecord, dict[tuple[float, ...], FloatArray]] = WeakKeyDictionary()
_AVERAGES = "; its coherence tells the noise once the number of averages is known: give `averages` in [record]"


@dataclass(frozen=True, eq=False)
class Setup(RecordSetup[FrfProblem]):
    """One record of responses and what it was measured on; of time histories see `TimeSetup`, of modes `ModalSetup`.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
    record : FrfRecord
    channel_unknowns : sequence of ChannelUnknown
        Errors of this record's sensors and loads that are identified too.
    name : str
    cache : ResponseCache
        What its problems have in common, and those of other records of the same structure.
    faults : tuple of Finding
        What the histories behind the record show by themselves of single channels.
    calibration : float, optional
        Standard deviation of the common gain of sensors over loads, a part; by default that of the options' tolerances.
    """

    record_class: ClassVar = FrfRecord

    structure: Structure
    parameters: Parameters
    record: FrfRecord
    channel_unknowns: Sequence[ChannelUnknown] = ()
    name: str = ""
    time: InitVar[object] = None
    cache: ResponseCache = field(default_factory=ResponseCache, repr=False)
    faults: tuple[Finding, ...] = ()
    calibration: float | None = None

    def __post_init__(self, time: object) -> None:
        if time is not None:
            raise InputError(
                "`time` of a Setup is a set-up of its own now; give TimeSetup(structure, parameters, record, TimeFit(...))"
                " with the time record"
            )

    def prepared(self, options: IdentifyOptions) -> Prepared[FrfProblem]:
        """The problem of the FRF lines that `options` choose, with warnings about record and structure.

        Without known noise, a model error of 10 % weighs the lines, and a warning says so.
        """
        self.structure.require_masses("FRFs")
        used = used_lines(self.record, options)
        lines = np.union1d(*self.axes(options))
        warnings = [*record_warnings(used)]
        warnings += [words for component in self.structure.measured for words in component.line_warnings(lines)]
        model_error = options.model_error
        is_assumed = used.variance is None and model_error == 0
        if is_assumed:
            model_error = _RELATIVE_WEIGHT
        floor = _missing_floor(self.record, used, options, model_error, is_assumed)
        if is_assumed:
            told = f" and by {_floor_range(floor, used.unit)}" if floor.any() else ""
            warnings.append(_NO_NOISE.format(floor=told) + (_AVERAGES if used.coherence is not None else ""))
        elif floor.any():
            remedy = _STATE_FLOOR.format(absolute=float(floor.max())) if used.noise_source == "declared" else ""
            warnings.append(_NO_FLOOR.format(floor=_floor_range(floor, used.unit)) + remedy)
        problem = FrfProblem(
            self.structure,
            self.parameters,
            with_noise_floor(used, floor),
            options.residual,
            model_error,
            channels=self.channel_errors(self.channel_unknowns, used),
            start_error=options.start_error if options.start == "continuation" else None,
            reduced=_sweep_error(self.structure, used, options),
            cache=self.cache,
        )
        return Prepared(problem, tuple(warnings), tuple(_measured_warnings(self.structure, options)))

    def channel_errors(
        self, unknowns: Sequence[ChannelUnknown], lines: ChannelsOfRecord | None = None
    ) -> ChannelErrors | None:
        return channel_errors(lines or self.record, unknowns) if unknowns else None

    def modelled_by(
        self, structure: Structure, parameters: Parameters, channel_unknowns: Sequence[ChannelUnknown] = ()
    ) -> Setup:
        return Setup(
            structure,
            parameters,
            self.record,
            channel_unknowns,
            self.name,
            faults=self.faults,
            calibration=self.calibration,
        )

    @property
    def channels(self) -> tuple[tuple[str, tuple[Dof, ...]], ...]:
        return ("output", self.record.outputs), ("input", self.record.inputs)

    def words(self, options: IdentifyOptions) -> str:
        """A line on the record: kind, unit, lines that `options` choose (number and range, Hz), source of the noise."""
        used = used_lines(self.record, options)
        unit = "" if used.unit == "1" else f" in {used.unit}"
        sources = {"declared": "declared", "unknown": "of an unknown source"}
        noise = sources.get(used.noise_source, f"from {used.noise_source}")
        return (
            f"{used.kind}{unit}, {len(used.frequency)} of {len(self.record.frequency)} lines from"
            f" {used.frequency[0]:.5g} to {used.frequency[-1]:.5g} Hz, noise: {'not stated' if used.variance is None else noise}"
        )

    def axes(self, options: IdentifyOptions) -> tuple[FloatArray, FloatArray]:
        """Frequencies (Hz) of the lines that are fitted, (n_fitted,), and of those on which the fit is judged, (n_judged,)."""
        used = used_lines(self.record, options)
        judged = self.record.band(*options.evaluation_band) if options.evaluation_band else used
        return used.frequency, judged.frequency

    def truncation(self, problem: FrfProblem, theta: FloatArray) -> Truncation | None:
        return frf_truncation(problem, theta)

    def begun(self, problem: FrfProblem) -> FrfProblem:
        """Problem started at the one-step linear solution if every degree of freedom is measured.

        The same problem is returned if not, or if channels have unknowns. Values at or beyond their bounds keep their
        start.
        """
        if self.channel_unknowns or not measures_everything(self.structure, problem.record):
            return problem
        unknown = problem.parameters
        solved = one_step_values(self.structure, unknown, problem.record)
        inside = (solved > unknown.transforms.lower) & (solved < unknown.transforms.upper)
        return problem.with_parameters(unknown.started_at(np.where(inside, solved, unknown.start)))

    def response_fit(
        self, title: str, problem: FrfProblem, fitted: FittedUnknowns, options: IdentifyOptions
    ) -> RecordFit:
        return record_fit(title, self.record, problem, fitted, options)


def _measured_warnings(structure: Structure, options: IdentifyOptions) -> list[str]:
    """Warnings on measured components of the structure that concern no particular line; empty without such components.

    If `options` state a start by continuation, one says that it is not possible with them.
    """
    words = [text for component in structure.measured for text in component.warnings]
    if structure.measured and options.start == "continuation":
        words.append(
            'start = "continuation" needs the model beside the lines of the record, where measured components are not known;'
            " the search begins without it"
        )
    return words


def _missing_floor(
    record: FrfRecord, used: FrfRecord, options: IdentifyOptions, model_error: float, is_assumed: bool
) -> FloatArray:
    """Noise floor of each FRF that the stated noise omits, (n_outputs, n_inputs), in the record's unit; 0 where none.

    It is that of `missing_floor` for `record` in the band of the lines `used`, computed once for each band. Zeros for
    the residual ``equation`` of the `options`, which reads no variance. `model_error` is the part of each magnitude
    that counts as noise, and `is_assumed` says that nobody stated it.
    """
    if options.residual == "equation":
        return np.zeros(record.values.shape[1:])
    low, high = map(float, used.frequency[[0, -1]])
    known, key = _FLOORS.setdefault(record, {}), (low, high, model_error, float(is_assumed))
    if key not in known:
        known[key] = missing_floor(record.band(low, high), model_error, is_assumed)
    return known[key]


def _floor_range(floor: FloatArray, unit: str) -> str:
    """The range of the noise floors above 0 with their unit, such as "a noise floor of 0.03 to 0.05 (m/s^2)/N"."""
    told = floor[floor > 0]
    numbers = sorted({f"{told.min():.2g}", f"{told.max():.2g}"}, key=float)
    return f"a noise floor of {' to '.join(numbers)}{'' if unit == '1' else f' {unit}'}"


def _sweep_error(structure: Structure, record: FrfRecord, options: IdentifyOptions) -> float | None:
    """Largest error, a part of the largest FRF of a line, of a sweep by few factorizations; None if all are solved.

    The error that the options state holds; 0 there means None. By default it is 1e-5 for 1000 degrees of freedom or
    more and 20 lines or more, None for less. None too with measured components.
    """
    if structure.measured:
        return None
    if options.reduced is not None:
        return options.reduced or None
    is_worth = structure.n_dofs >= _LARGE and len(record.frequency) >= FEWEST_LINES
    return _USUAL_ERROR if is_worth else None


def used_lines(record: FrfRecord, options: IdentifyOptions) -> FrfRecord:
    """Record at the lines inside the band and outside the excluded stretches; of these only every `options.every`-th."""
    keep = inside(record.frequency, options)
    return record if keep.all() and options.every == 1 else record.lines(np.flatnonzero(keep)[:: options.every])


def inside(frequency: FloatArray, options: IdentifyOptions) -> np.ndarray:
    """Mask (n_frequencies,) of the values of `frequency` (Hz) in the band of `options` and outside excluded stretches.

    Ends of the band belong to it, ends of an excluded stretch to the stretch. Without a band all values lie inside. The
    mask is False throughout if no value lies in the band.

    Raises
    ------
    NoLinesError
        If the exclusions leave no line of the band.
    """
    low, high = options.band or (-np.inf, np.inf)
    in_band = (frequency >= low) & (frequency <= high)
    keep = in_band.copy()
    for low, high in options.exclude:
        keep &= (frequency < low) | (frequency > high)
    if in_band.any() and not keep.any():
        first, last = frequency[in_band][[0, -1]]
        raise NoLinesError(
            f"`exclude` leaves out every line of the band ({in_band.sum()} from {first:g} to {last:g} Hz); leave out less",
            "exclude",
        )
    return keep

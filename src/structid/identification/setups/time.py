"""Time histories as a record of a study, which are fitted themselves.

FRFs made of them only show the fit, and are those on which causes of a misfit are looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np

from structid import forward
from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import Positive
from structid.core.display import plural
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.measuring_points import joint_weights, with_joint_forces
from structid.forward import (
    ChannelUnknown,
    FrfProblem,
    RecordProblem,
    ResponseCache,
    SpectraProblem,
    TimeOptions,
    output_error_problem,
)
from structid.forward.channel_errors import ChannelErrors, ChannelsOfRecord, channel_errors
from structid.forward.time.options import Hold, Initial, TimeMethod
from structid.forward.time.spectra import NO_WINDOW, transient_order
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import FittedUnknowns, RecordFit, record_fit
from structid.identification.setups.frf import inside, used_lines
from structid.identification.setups.setup import Prepared, RecordSetup, record_warnings
from structid.inversion import Estimate
from structid.inversion.search.work import StageProgress, TaskExecutor
from structid.records import FrfRecord, TimeRecord, frf_from_time
from structid.records.quality import Finding
from structid.records.record import LOADS, Quantity
from structid.records.spectra import KINDS, finite_spectra
from structid.unknowns import Parameters

TimeWay = Literal["spectra", TimeMethod]
TimeHold = Literal["band_limited", Hold]

#: Error of each value by which these FRFs are weighed.
_SHOWN_ERROR = 0.1
#: Multiple of half the sampling rate up to which modes behind the samples count.
_FOLDED = 2.0
_SUPPORT: Quantity = "support_acceleration"
#: Noise of a channel that is declared exact, in parts of its rms, where its weight must be finite.
_LEAST_NOISE = 1e-6
_FORCE: Quantity = "force"
#: Distance of the label of a joint force's node from those of the structure, which may get some more.
_FAR = 1000
#: A record is cut into so many segments.
_SEGMENTS = 4
#: Power of a force over that of its noise from which it drives a line; noise alone in four segments never has it.
_ABOVE_NOISE = 8.0
_FEWEST = 16
#: A hit: force beyond this part of its peak, and so many deviations of its noise, for less than this part of the record; the
#: structure is at rest before it where it has less than this part of the motion's power.
_PEAK, _DEVIATIONS, _SHORT, _AT_REST = 0.02, 5.0, 0.1, 1e-3
#: Motion at the end of a record of a hit, in parts of its largest: an exponential window takes it off.
_GONE = 0.003
#: Power of a hit, in parts of its largest, below which it drives no line.
_DRIVES = 1e-4


@dataclass(frozen=True)
class TimeFit:
    """Options of the fit of time histories.

    Parameters
    ----------
    fit : {"spectra", "output_error", "instrumental", "weak"}
        ``spectra``: finite Fourier transforms with their transient (see `SpectraProblem`); the others are the methods
        of `identify_time`.
    transient : bool
        Of ``spectra``; off for periodic records and those that start and end at rest.
    initial : {"rest", "unknown"}
        Of ``output_error`` and ``instrumental``: the state at the first sample.
    hold : {"band_limited", "first", "zero"}, optional
        Between samples forces hold nothing above half the sampling rate, as behind an anti-aliasing filter
        (``spectra`` only, and its default), run straight, as in most simulations (the default of the others), or stay (not
        ``spectra``).
    tones : tuple of float
        Hz, of ``spectra``: steady tones such as mains that no measured force made; size and phase at each sensor follow.
    """

    fit: TimeWay = "spectra"
    transient: bool = True
    initial: Initial = "rest"
    hold: TimeHold | None = None
    tones: tuple[Positive, ...] = ()

    def __post_init__(self) -> None:
        """Raise `InputError` for an unknown way of fitting, or a `hold` that does not go with it.

        Spectra take "band_limited" or "first", all other ways "first" or "zero".
        """
        if self.fit not in get_args(TimeWay):
            raise InputError(
                f"`fit` must be one of {', '.join(get_args(TimeWay))}, got {self.fit!r}; the time record itself is given to"
                " TimeSetup"
            )
        refused = "zero" if self.fit == "spectra" else "band_limited"
        if self.hold == refused:
            takes = "'band_limited' or 'first'" if self.fit == "spectra" else "'first' or 'zero'"
            raise InputError(f"`hold` {refused!r} is not for fit {self.fit!r}, which takes {takes}")

    def require_heard(self, record: TimeRecord) -> None:
        """Raise `InputError` if a tone of these settings is at or above half the sampling rate of `record`."""
        top = 0.5 * record.sampling_rate
        beyond = [tone for tone in self.tones if tone >= top]
        if beyond:
            raise InputError(
                f"`tones`: {beyond[0]:g} Hz is not below half the sampling rate, {top:g} Hz; give the frequency at which the"
                " record shows it"
            )

    @property
    def runs_straight(self) -> bool:
        """True where forces of ``spectra`` run straight between samples."""
        return self.hold == "first"


@dataclass(frozen=True, eq=False)
class TimeSetup(RecordSetup[RecordProblem]):
    """Forces and motions and what they were measured on.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
    record : TimeRecord
        With the noise variance of every channel.
    settings : TimeFit
    channel_unknowns : sequence of ChannelUnknown
        Errors of this record's sensors and loads that are identified too, of ``spectra``; no window's decay.
    name : str
    shown : FrfRecord, optional
        FRFs of the same test, beside which the fitted model is drawn and judged; by default those of estimator Hv from
        four segments of the record. They have no part in the fit.
    cache : ResponseCache
        What its problems have in common, and those of other records of the same structure.
    faults : tuple of Finding
        What the record shows by itself of single channels.
    calibration : float, optional
        Standard deviation of the common gain of sensors over loads, a part; by default that of the options' tolerances.
    """

    record_class: ClassVar = TimeRecord

    structure: Structure
    parameters: Parameters
    record: TimeRecord
    settings: TimeFit = TimeFit()
    channel_unknowns: Sequence[ChannelUnknown] = ()
    name: str = ""
    shown: FrfRecord | None = None
    cache: ResponseCache = field(default_factory=ResponseCache, repr=False)
    faults: tuple[Finding, ...] = ()
    calibration: float | None = None

    def prepared(self, options: IdentifyOptions) -> Prepared[RecordProblem]:
        """The problem of the histories: finite spectra on the lines that `options` choose, or samples for output error.

        For the linear methods, which search for no minimum, it only predicts what the record can determine.
        `InputError` if these meet motions of supports, or if errors of channels are declared for any fit but that of
        spectra.
        """
        problem: RecordProblem
        if self.settings.fit in ("instrumental", "weak") and _SUPPORT in self.record.quantities:
            raise InputError(
                f"{self.own_estimator} takes no motion of supports; take fit = 'spectra' or 'output_error' for this record"
            )
        if self.settings.fit == "output_error":
            self.channel_errors(self.channel_unknowns)
            problem = output_error_problem(
                self.structure, self.parameters, self.record, _options(self.settings, options)
            )
        else:
            problem = _spectra(self, options)
        averaged = replace(
            self.shown_problem(options, None).record, coherence=None
        )  # leakage, which the fit has none of
        return Prepared(problem, record_warnings(averaged))

    def problem_warnings(self, problem: RecordProblem) -> tuple[str, ...]:
        """Warning about modes behind the samples, where inputs run straight between these."""
        return _modes_behind_the_samples(problem)

    def channel_errors(
        self, unknowns: Sequence[ChannelUnknown], lines: ChannelsOfRecord | None = None
    ) -> ChannelErrors | None:
        """Unknown errors of sensors and loads that `unknowns` declare; None if none is declared.

        `lines` has the channels they refer to; by default those of the record's finite spectra.

        Raises
        ------
        InputError
            If the fit is not by spectra, or a window's decay is declared.
        """
        if not unknowns:
            return None
        if self.own_estimator:
            raise InputError(f"{self.own_estimator} takes no errors of channels; take fit = 'spectra' for this record")
        if any(unknown.property == "window_decay" for unknown in unknowns):
            raise InputError(NO_WINDOW)
        return channel_errors(lines or finite_spectra(self.record), unknowns)

    def modelled_by(
        self, structure: Structure, parameters: Parameters, channel_unknowns: Sequence[ChannelUnknown] = ()
    ) -> TimeSetup:
        return replace(
            self,
            structure=structure,
            parameters=parameters,
            channel_unknowns=channel_unknowns,
            shown=self._averaged.frfs,
        )

    @property
    def channels(self) -> tuple[tuple[str, tuple[Dof, ...]], ...]:
        """Motions as "output" and loads as "input", each with its degrees of freedom; a place counts once among the motions."""
        pairs = list(zip(self.record.channels, self.record.quantities, strict=True))
        motions = tuple(dict.fromkeys(dof for dof, quantity in pairs if quantity not in LOADS))
        return ("output", motions), ("input", tuple(dof for dof, quantity in pairs if quantity in LOADS))

    def words(self, options: IdentifyOptions) -> str:
        record = self.record
        return (
            f"time histories, {len(record.values)} samples at {record.sampling_rate:g} Hz, {len(record.channels)} channels,"
            f" fitted by {self.settings.fit.replace('_', ' ')}{self._averaged.words}"
        )

    def axes(self, options: IdentifyOptions) -> tuple[FloatArray, FloatArray]:
        """Frequencies (Hz) that are used in the fit, (n_fitted,), and those on which it is judged, (n_judged,).

        It is judged on lines of averaged FRFs, in the evaluation band or as the options choose.
        """
        shown = self._averaged.frfs
        judged = shown.band(*options.evaluation_band) if options.evaluation_band else used_lines(shown, options)
        used = super().axes(options)[0] if self.own_estimator else _spectra(self, options).frequency
        return used, judged.frequency

    @property
    def own_estimator(self) -> str:
        return "" if self.settings.fit == "spectra" else f"fit {self.settings.fit!r}"

    def estimated(self, options: IdentifyOptions, progress: StageProgress | None, work: TaskExecutor) -> Estimate:
        """Estimate by output error, instrumental variables or the weak form, as the set-up's settings say.

        A calibration of the set-up replaces that of the options' tolerances. `progress` is called with the stage's
        name, the iteration and the sum of squares; `work` runs the searches.
        """
        tolerances = options.tolerances
        if self.calibration is not None:
            tolerances = replace(tolerances, calibration=self.calibration)
        chosen = replace(_options(self.settings, options), tolerances=tolerances)
        return forward.identify_time(self.structure, self.parameters, self.record, chosen, work, progress)

    def response_fit(
        self, title: str, problem: RecordProblem, fitted: FittedUnknowns, options: IdentifyOptions
    ) -> RecordFit:
        """The fitted model beside averaged FRFs of the record."""
        return record_fit(title, self._averaged.frfs, self.shown_problem(options, problem.channels), fitted, options)

    @cached_property
    def _averaged(self) -> AveragedHistories:
        return AveragedHistories(self.structure, self.record, self.shown)

    def shown_problem(self, options: IdentifyOptions, channels: ChannelErrors | None) -> FrfProblem:
        """Problem of averaged FRFs that only shows the fit, with the channel errors `channels` that concern these FRFs.

        `options` choose its lines and kind of residual. `channels` is None where the record has no channel errors.
        Without a variance of the FRFs a model error of 10 % weighs them.
        """
        used = used_lines(self._averaged.frfs, options)
        error = _SHOWN_ERROR if used.variance is None else 0.0
        seen = None if channels is None else channels.seen_by(used)
        structure = self._averaged.drawn_on
        return FrfProblem(structure, self.parameters, used, options.residual, error, channels=seen, cache=self.cache)


def _modes_behind_the_samples(problem: RecordProblem) -> tuple[str, ...]:
    """Tuple with a warning if inputs that run straight between samples excite modes above half the sampling rate; else empty.

    Modes up to the sampling rate count. Only for spectra with straight forces.
    """
    if not isinstance(problem, SpectraProblem) or not problem.spectra.straight:
        return ()
    half_rate = 0.5 / problem.spectra.straight
    highest = _FOLDED * half_rate
    beyond, is_all = problem.model.start_frequencies(half_rate, highest)
    if not len(beyond):
        return ()
    driven = problem.spectra.driven
    inputs = "motions of supports" if driven.all() else "forces and motions of supports" if driven.any() else "forces"
    count = plural(len(beyond), "such mode")
    return (
        f"{inputs} that run straight between samples (hold = 'first') excite modes above half the sampling rate, {half_rate:g} Hz:"
        f" the model has {count if is_all else f'at least {count}'} up to {highest:g} Hz, the lowest at {beyond.min():.4g} Hz. The"
        f" samples fold their responses into the band, so that a right model may look wrong; simulate in finer steps, or filter"
        f" {inputs} and the sensors' motions below half the sampling rate, state hold = 'band_limited', and a `band` below the"
        " filter",
    )


def _spectra(setup: TimeSetup, options: IdentifyOptions) -> SpectraProblem:
    """Problem of the finite spectra of `setup` on the lines that `options` choose.

    If `setup` is fitted in another way than by spectra, noise below 1e-6 of a channel's rms (declared exact) is
    raised to that. `InputError` if a tone is not below half the sampling rate, or declared channel errors do not
    fit.
    """
    record, settings = setup.record, setup.settings
    if (
        setup.own_estimator and record.variance is not None
    ):  # channels without noise serve there, and have no weight here
        least = _LEAST_NOISE * np.sqrt((record.values**2).mean(axis=0))
        record = replace(record, variance=np.maximum(record.variance, least**2))
    settings.require_heard(record)
    spectra = finite_spectra(record, band=options.band, straight=settings.runs_straight)
    spectra = spectra.lines(inside(spectra.frequency, options))
    channels = setup.channel_errors(setup.channel_unknowns, spectra)
    return SpectraProblem(
        setup.structure,
        setup.parameters,
        spectra,
        settings.transient,
        transient_order(channels),
        record=record,
        channels=channels,
        cache=setup.cache,
        tones=settings.tones,
    )


def _options(settings: TimeFit, options: IdentifyOptions) -> TimeOptions:
    """Options of `identify_time` from those of the fit and of the identification.

    Raises `InputError` for the fit ``spectra``, which is no method of `identify_time`.
    """
    if settings.fit == "spectra":
        raise InputError("`fit` must be a method of `identify_time`, got 'spectra'; search its problem")
    return TimeOptions(
        method=settings.fit,
        force="zero" if settings.hold == "zero" else "first",
        initial=settings.initial,
        restarts=options.restarts,
        seed=options.seed,
    )


@dataclass(frozen=True, eq=False)
class AveragedHistories:
    """FRFs of a record of histories; forces that are never apart are one there, at a node of its own.

    Parameters
    ----------
    structure : Structure
    record : TimeRecord
    given : FrfRecord, optional
        FRFs of the same test instead.
    """

    structure: Structure
    record: TimeRecord
    given: FrfRecord | None

    @cached_property
    def frfs(self) -> FrfRecord:
        return self.given or frfs_of(self.record if self._parts is None else self._with_joint_forces(self._parts))

    @property
    def drawn_on(self) -> Structure:
        """The structure, with nodes of their own for joint forces."""
        if self._parts is None:
            return self.structure
        return with_joint_forces(self.structure, self.frfs.inputs, self._loads, self._parts)

    @property
    def words(self) -> str:
        """Clause that names the joint forces; "" if all forces are independent."""
        if self._parts is None:
            return ""
        forces, shown = (", ".join(map(str, dofs)) for dofs in (self._loads, self.frfs.inputs))
        return (
            f"; forces at {forces} are linearly dependent: responses are shown under independent joint forces, {shown}"
        )

    @cached_property
    def _parts(self) -> FloatArray | None:
        """Weights that combine forces which always act together, None if none do; see `joint_weights`."""
        return joint_weights(self.record.values[:, self._is_force])

    @property
    def _is_force(self) -> np.ndarray:
        return np.array([quantity == _FORCE for quantity in self.record.quantities])

    @property
    def _loads(self) -> list[Dof]:
        return [dof for dof, is_force in zip(self.record.channels, self._is_force, strict=True) if is_force]

    def _with_joint_forces(self, parts: FloatArray) -> TimeRecord:
        """Record with its forces replaced by joint ones at new nodes, which come first, then the motions as they are.

        `parts` (n_forces, n_joint_forces) are the weights of the forces in each joint one; the noise of the forces is
        taken as independent.
        """
        record, still = self.record, ~self._is_force
        first = max(self.structure.nodes) + _FAR
        made = [Dof(first + k, (self.structure.active or ("X",))[0]) for k in range(parts.shape[1])]
        motions = [
            (dof, kind) for dof, kind, kept in zip(record.channels, record.quantities, still, strict=True) if kept
        ]
        values = np.hstack([record.values[:, ~still] @ parts, record.values[:, still]])
        noise = None
        if record.variance is not None:
            noise = np.concatenate([record.variance[~still] @ parts**2, record.variance[still]])
        return TimeRecord(
            record.sampling_rate,
            values,
            (*made, *(dof for dof, _ in motions)),
            (*(_FORCE for _ in made), *(kind for _, kind in motions)),
            variance=noise,
        )


class _Hit(NamedTuple):
    """One blow on a structure at rest: the number of its channel, and its first and last samples."""

    column: int
    first: int
    last: int


def frfs_of(record: TimeRecord) -> FrfRecord:
    """FRFs of all motions over all forces (or support motions) of time histories, in the kind of most motion channels.

    The record of a single hit, with motions of one kind, is transformed whole, with an exponential window if the motion
    has not died out. Others are averaged by the estimator Hv from segments of a quarter of the record; they go from the
    first to the last line at which a force rises above its noise, and over all lines where none does. Of two sensors at
    one degree of freedom the one of that kind is taken. Over support motions only accelerations count.
    """
    pairs = list(zip(record.channels, record.quantities, strict=True))
    loads = [dof for kind in LOADS for dof, quantity in pairs if quantity == kind]
    motions = [(dof, quantity) for dof, quantity in pairs if quantity not in LOADS]
    if "support_acceleration" in record.quantities:  # per motion of a support
        motions = [motion for motion in motions if motion[1] == "acceleration"]
    kinds = [quantity for _, quantity in motions]
    most: Quantity = max(dict.fromkeys(kinds), key=kinds.count, default="acceleration")
    places = [dof for dof, _ in motions]
    sensors = [dof for dof in dict.fromkeys(places) if (dof, most) in motions or places.count(dof) == 1]
    hit = _hit(record)
    if hit is not None and set(kinds) == {most} and len(sensors) == len(motions):
        of_hit = _frfs_of_hit(record, hit, sensors)
        if of_hit is not None:
            return of_hit
    length = max(len(record.values) // _SEGMENTS, 1)
    made = frf_from_time(record, loads, sensors, estimator="Hv", segment_length=length, quantity=most)
    driven = _driven(record, length)
    return made.lines((made.frequency >= driven[0]) & (made.frequency <= driven[-1])) if driven.size else made


def _hit(record: TimeRecord) -> _Hit | None:
    """Single hit of the record: its channel, first sample and the sample after the last.

    None if there is not just one load, a force; if the force lasts a tenth of the record after its begin or longer; or
    if the motion before it has more than 0.1 % of the energy. Force is what exceeds 2 % of its peak and five deviations
    of its noise.
    """
    columns = [k for k, quantity in enumerate(record.quantities) if quantity in LOADS]
    if len(columns) != 1 or record.quantities[columns[0]] != "force":
        return None
    [column], force = columns, np.abs(record.values[:, columns[0]])
    noise = 0.0 if record.variance is None else float(np.sqrt(record.variance[column]))
    beyond = np.flatnonzero(force > max(_PEAK * force.max(), _DEVIATIONS * noise))
    if not len(beyond):
        return None
    first, last = max(int(beyond[0]) - 2, 0), int(beyond[-1]) + 2
    motion = np.delete(record.values, column, axis=1)
    before = float(np.sum(motion[:first] ** 2))
    is_short = last - first < _SHORT * (len(force) - first)
    return _Hit(column, first, last) if is_short and before <= _AT_REST * float(np.sum(motion**2)) else None


def _frfs_of_hit(record: TimeRecord, hit: _Hit, sensors: list[Dof]) -> FrfRecord | None:
    """FRFs from a single hit: spectra of the motions at `sensors` over that of the force.

    Variances come from declared noise. Where the motion has not died out at the end (rms of the last twentieth above
    0.003 of that of the whole at any sensor), all channels are weighted by exp(-decay t) first, and the FRFs are those
    at s = decay + i omega. They go from the lowest line that the hit excites to the first gap of more than 16 lines. A
    line is excited if the power of the force is above 1e-4 of its largest and 8 times its noise; None if there is none.
    Without declared noise there are no variances.
    """
    values = np.array(record.values[hit.first :])
    count, rate = len(values), record.sampling_rate
    values[hit.last - hit.first :, hit.column] = 0.0
    others = np.delete(np.arange(values.shape[1]), hit.column)
    mean = np.sqrt(np.square(values[:, others]).mean(axis=0))
    end = np.sqrt(np.square(values[-max(count // 20, 1) :, others]).mean(axis=0))
    left = float(np.max(end / np.maximum(mean, np.finfo(float).tiny)))
    decay = np.log(max(left / _GONE, 1.0)) * rate / count
    window = np.exp(-decay * np.arange(count) / rate)
    spectra = np.fft.rfft(values * window[:, None], axis=0)
    of_force = (
        0.0 if record.variance is None else record.variance[hit.column] * np.sum(window[: hit.last - hit.first] ** 2)
    )
    power = np.abs(spectra[:, hit.column]) ** 2
    driven = 1 + np.flatnonzero(power[1:] > max(_DRIVES * power.max(), _ABOVE_NOISE * of_force))
    if not len(driven):
        return None
    lines = _first_run(driven)
    force = spectra[lines, hit.column, None]
    h, variance = spectra[np.ix_(lines, others)] / force, None
    if record.variance is not None:
        noise = record.variance[others] * np.sum(window**2) + np.abs(h) ** 2 * of_force
        variance = (noise / np.abs(force) ** 2)[:, :, None]
    return FrfRecord(
        np.fft.rfftfreq(count, 1 / rate)[lines], h[:, :, None], sensors, [record.channels[hit.column]],
        KINDS[record.quantities[others[0]]], variance=variance,
        noise_source="unknown" if variance is None else "declared", source=record.source,
        decay=np.full(len(lines), decay) if decay else None,
    )  # fmt: skip


def _first_run(lines: IntArray) -> IntArray:
    """All line indices (n,) from the first of the sorted `lines` to the last one before a gap of more than `_FEWEST` lines."""
    gaps = np.flatnonzero(np.diff(lines) > _FEWEST)
    last = lines[gaps[0]] if len(gaps) else lines[-1]
    return np.arange(lines[0], last + 1)


def _driven(record: TimeRecord, length: int) -> FloatArray:
    """Frequencies (n,) in Hz of segments of `length` samples at which a force exceeds eight times its noise in power.

    All frequencies if the noise is unknown or the segments are shorter than 16 samples.
    """
    frequency = np.fft.rfftfreq(length, 1 / record.sampling_rate)
    is_force = [quantity in LOADS for quantity in record.quantities]
    if record.variance is None or length < _FEWEST:
        return frequency
    window = np.hanning(length + 1)[:-1, None]
    count = len(record.values) // length
    parts = record.values[: count * length, is_force].reshape(count, length, -1)
    power = (np.abs(np.fft.rfft(parts * window, axis=1)) ** 2).mean(axis=0)
    return frequency[(power > _ABOVE_NOISE * record.variance[is_force] * (window**2).sum()).any(axis=1)]

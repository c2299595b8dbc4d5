"""Motion where no sensor is, and forces that nobody measured, from a record of other places: a Kalman smoother of modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import linalg, signal, sparse
from scipy.optimize import minimize, minimize_scalar

from structid.core.arrays import FloatArray, IntArray, square_root
from structid.core.display import Overview, Shown, format_number, join_words
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoAnswerError
from structid.dynamics.exact_discretization import stepped
from structid.fem import Structure
from structid.identification.identified import Identification
from structid.prediction.identified_model import IdentifiedModel, model_of
from structid.prediction.innovations import Innovations, InnovationVerdict, judge_innovations
from structid.prediction.loads import band_limited_loads
from structid.prediction.poles import ReducedMatrices, Sides, reduce_structure, reduction_basis
from structid.prediction.recovery import Output, OutputMap, distinct_channels, is_von_mises, output_map, parse_outputs
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES

#: Motions by their derivatives of displacement.
MOTIONS = tuple(sorted(MOTION_DERIVATIVES, key=MOTION_DERIVATIVES.__getitem__))

#: Orders of magnitude below and above a first guess of the unknown forces between which their size is sought, to what part of one;
#: of free structures, whose motion hardly says the size, as many above as below.
_BELOW, _ABOVE, _SURE = 2.0, 0.5, 0.01
#: Part of the variance of a force before the record that remains, above which the record hardly determines it.
_UNSEEN = 0.9
#: Part of a combination of forces below which a force is not named in it.
_NAMED = 0.3
#: Standard deviation of the noise of a sensor over the root mean square that it reads, where the record states no noise.
_NOISE = 0.01
#: Variance, in units of a state's own size, by which every modal state moves at random in a time 1 / reference: so small that it
#: shows nowhere, so that no state is known without error and the equations for the steady gains have a solution.
_STRAY = 1e-10
#: Error of a sensor that was left out, over its stated deviation, from which on the model or the forces are wrong there.
LARGEST_CHECK = 2.0
#: Random records of the model to which the innovations of the record are compared.
_REPLICATES = 20
#: By how much rounding may let an error of a state seem to grow from reading to reading; more is a filter that has lost its digits.
_UNSTABLE = 1e-9
#: Times that a matrix is squared to see that its powers fade.
_SQUARINGS = 12
#: Largest doublings of the number of samples after which the covariance must have settled, and by what part it may still grow.
_DOUBLINGS, _CONVERGED = 40, 1e-12
#: Part of the variance far from the ends, below which what is missing at the end of the record no longer counts.
_SETTLED = 1e-4
#: Samples that are worked on together.
_BLOCK = 256
#: Part of the sum of squares of what forces move, below which a combination of them moves nothing.
_DEPENDENT = 1e-10
#: Size of known forces, and of motion without unknown ones, before a record over that in it.
_BEFORE = 10.0
#: Size of modal speeds, in sqrt(kg) m/s, where no unknown force gives one.
_SPEED = 1e-6
#: Filter against aliasing: elliptic, order, ripple and attenuation in dB, passing up to half the sampling rate. It must be steep:
#: lightly damped modes just above ring in whatever it lets through. Deviations of accelerations are those of the errors behind a
#: filter that halves what is at half the sampling rate, and wider than the errors behind one that ends before.
_FILTER = 9, 0.1, 80.0
#: Rate at which each low-pass of a force forgets its input, over one by the correlation time, for each order that is tried: the
#: correlation time is the integral of the correlation from 0 on (without a frequency), which is exp(-|t| / T) for order 1.
_FADING = {1: 1.0, 2: 2.0, 3: 8 / 3}
#: Shortest correlation time that is sought, in samples, and number of times with which the search begins.
_SHORTEST, _TIMES = 0.1, 12
#: Lines at which what the sensors tell of a motion is looked at, and part of its remaining variance from lines where they tell less
#: than half of it, from which on its band rests on the spectrum of the forces.
_LOOKED_AT, _RESTING = 40, 0.3
#: Segments of which the spectrum of forces is averaged to see their frequency, and evaluations that its search may take.
_SEGMENTS, _MOST_TRIALS = 8, 80
#: Samples of a record, and of each segment, that tell a frequency at all.
_FEWEST = 16
#: Standard deviation that a direction of the sensors is left open by, over that of their noise, from which on forces reach it.
_OPEN = 0.3
#: Longest correlation time of forces about a frequency, in lengths of the record: nearly a sine.
_LONGEST = 10.0
#: Steps towards shorter times, each by this factor, and by how much (log) the record may get less likely: that of chance.
_SHORTER, _STEPS, _LESS_LIKELY = 0.8, 18, 2.0


@dataclass(frozen=True)
class UnknownForces:
    """Forces that act and were not measured: independent, stationary, with the covariance std^2 exp(-|t| / correlation_time).

    Parameters
    ----------
    dofs : sequence of Dof or str
        Where they act.
    correlation_time : float, optional
        s; short for wind or traffic, long for what changes slowly. By default the shortest one under which the record is as
        likely, but for chance, as under any; where that does not fit, and neither it nor `std` is stated, the spectrum of the
        forces may fall more steeply, as behind two or three low-passes of first order, and lie about the likeliest frequency:
        the correlation time is then the integral of the correlation, or of its envelope, from 0 on.
    std : float, optional
        N; the one under which the record is likeliest by default.
    """

    dofs: Sequence[Dof | str]
    correlation_time: float | None = None
    std: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` where no force is named, or for a correlation time or standard deviation that is not positive."""
        if not len(self.dofs):
            raise InputError(
                "`dofs` of unknown forces must name where they act, got none; leave `unknown` out if there are none"
            )
        if self.correlation_time is not None and not (np.isfinite(self.correlation_time) and self.correlation_time > 0):
            raise InputError(f"`correlation_time` must be greater than 0 s, got {self.correlation_time:g}")
        if self.std is not None and not (np.isfinite(self.std) and self.std > 0):
            raise InputError(f"`std` of unknown forces must be greater than 0 N, got {self.std:g}")


@dataclass(frozen=True, eq=False)
class LeftOutSensor:
    """A sensor that was not used, and the motion that is sensed there.

    Attributes
    ----------
    dof : Dof
    motion : {"displacement", "velocity", "acceleration"}
    measured, sensed : (n_times,) float arrays
        SI units.
    std : (n_times,) float array
        Stated deviation of measured less sensed: that of what is sensed, and the noise of the sensor.
    """

    dof: Dof
    motion: str
    measured: FloatArray
    sensed: FloatArray
    std: FloatArray

    @property
    def ratio(self) -> float:
        """Root mean square of measured less sensed over the stated deviation: 1 is right."""
        return float(np.sqrt(np.mean(((self.measured - self.sensed) / self.std) ** 2)))


@dataclass(frozen=True, eq=False, repr=False)
class SensedMotion(Shown):
    """Motion and forces during a record, each with its standard deviation.

    Attributes
    ----------
    time : (n_times,) float array
        s.
    outputs : tuple of Dof or ElementOutput
    motion : {"displacement", "velocity", "acceleration"}
    values, std : (n_times, n_outputs) float arrays
        SI units: of motions, or of what is read from elements.
    force_dofs : tuple of Dof
    forces, force_std : (n_times, n_forces) float arrays
        The unknown forces, N or N m.
    prior_std : float
        Standard deviation of the unknown forces before the record; NaN where there are none.
    correlation_time : float
        Of the unknown forces, s, as stated or as the record makes likeliest; NaN where there are none.
    left_out : tuple of LeftOutSensor
        Sensors that were not used, but compared.
    words : tuple of str
        What the record does not tell.
    contradiction : str
        A sentence on how the record contradicts the model; "" where it does not.
    force_frequency : float
        About which the spectrum of the unknown forces lies, Hz; 0 where it falls from 0 Hz on, NaN where there are none.
    force_order : int
        The spectrum of the unknown forces falls with the frequency to the power -2 `force_order`, 1 to 3.
    """

    time: FloatArray
    outputs: tuple[Output, ...]
    motion: str
    values: FloatArray
    std: FloatArray
    force_dofs: tuple[Dof, ...]
    forces: FloatArray
    force_std: FloatArray
    prior_std: float
    correlation_time: float
    left_out: tuple[LeftOutSensor, ...] = ()
    words: tuple[str, ...] = ()
    contradiction: str = ""
    force_frequency: float = float("nan")
    force_order: int = 1

    @property
    def checks(self) -> tuple[tuple[Dof, float], ...]:
        """Sensors that were left out, and the root mean square of measured less sensed over the stated deviation: 1 is right."""
        return tuple((sensor.dof, sensor.ratio) for sensor in self.left_out)

    @property
    def is_explained(self) -> bool:
        """True where the model explains the record, also at the sensors that were left out."""
        return not self.contradiction and all(z < LARGEST_CHECK for _, z in self.checks)

    def overview(self) -> Overview:
        """A table with the RMS over the record of each output and force and of its deviation, and checks of left-out sensors."""
        rows = [
            (
                name,
                format_number(float(np.sqrt(np.mean(value**2))), 3),
                format_number(float(np.sqrt(np.mean(std**2))), 2),
            )
            for name, value, std in zip(
                (*map(str, self.outputs), *(f"force at {dof}" for dof in self.force_dofs)),
                (*self.values.T, *self.forces.T),
                (*self.std.T, *self.force_std.T),
                strict=True,
            )
        ]
        told = "".join(f"; {dof}, left out: {format_number(z, 3)} times its stated deviation" for dof, z in self.checks)
        return Overview(
            f"{self.motion} at {join_words(self.outputs)} over {len(self.time)} samples{told}",
            ("where", "rms", "± rms"),
            rows,
        )


def sense(
    source: Identification | IdentifiedModel,
    record: TimeRecord,
    outputs: Sequence[Output | str],
    motion: str = "displacement",
    unknown: UnknownForces | None = None,
    leave_out: Sequence[Dof | str] = (),
    n_draws: int = 20,
    seed: int = 0,
    is_filtered: bool = True,
) -> SensedMotion:
    """Motion, forces and stresses anywhere during a record, whose loads may be known, partly known or unknown.

    A Kalman filter with steady gains and a Rauch-Tung-Striebel smoother run over the modes up to the sampling rate, with each
    unknown force as a state of first or second order, and again for models within the uncertainty: the deviation includes both.
    The innovations of the filter give the verdict, see `judge_innovations`.

    Parameters
    ----------
    source : Identification or IdentifiedModel
    record : TimeRecord
        Forces (quantity ``force``) are taken as known, motions as measured, with the record's noise; where it states none, 1 % of
        the size of each sensor is taken.
    outputs : sequence of Dof, ElementOutput or str
        Where motion is wanted, or internal forces and stresses of elements, see `parse_output`.
    motion : {"displacement", "velocity", "acceleration"}
    unknown : UnknownForces, optional
        Forces that were not measured. Where there are more of them than sensors, as under traffic that may stand anywhere,
        modes above the sampling rate are left out, with their flexibility.
    leave_out : sequence of Dof or str
        Sensors that are not used, but compared with what is sensed there.
    n_draws : int
        Models within the uncertainty; 0 takes the identified model as exact.
    seed : int
    is_filtered : bool
        Whether the record went through a filter against aliasing, as measured ones do. All that is sensed is then meant without
        what is above half the sampling rate; a filter acts on responses as if it acted on the unknown forces. Known forces are
        then band-limited between samples, else straight lines.

    Returns
    -------
    SensedMotion

    Raises
    ------
    InputError
        If an output or a force is not part of the structure or named twice, an output is a von Mises stress, `leave_out` names
        no sensor of the record, the record holds strains or other quantities that are neither motions nor forces, or a sensor
        has no noise and reads a constant.
    NoAnswerError
        If the record cannot tell the motion: nothing holds the structure and accelerations alone are measured, or no sensor sees
        one of the modes.
    SingularModelError
        If a model within the uncertainty has no positive mass.

    References
    ----------
    Rauch, Tung and Striebel (1965), AIAA J. 3, 1445-1450; Lourens et al. (2012), Mech. Syst. Signal Process. 27, 446-460 (forces as
    states); Van Loan (1978), IEEE Trans. Automatic Control 23, 395-404 (noise between samples).
    """
    if motion not in MOTION_DERIVATIVES:
        raise InputError(f"`motion` must be one of {', '.join(MOTION_DERIVATIVES)}, got {motion!r}")
    if seed < 0:
        raise InputError(f"`seed` must be at least 0, got {seed}")
    model = model_of(source)
    wanted, left = distinct_channels("outputs", parse_outputs(outputs)), parse_dofs(leave_out)
    curved = next((output for output in wanted if is_von_mises(output)), None)
    if curved is not None:
        raise InputError(
            f"{curved} is not linear in the motion, so that it has no deviation here; ask for its components"
        )
    channels = _Channels.of_record(record, left)
    forces = () if unknown is None else parse_dofs(unknown.dofs)
    if forces:
        distinct_channels("unknown", tuple(dof.unsigned for dof in forces))
    if not forces and not channels.loads:
        raise InputError(
            "the record holds no force and none is named as unknown, so that nothing would move the model; name where forces act"
            " with `unknown`"
        )
    structure = model.structure
    structure.require_modes("motion at other places")
    read = output_map(structure, wanted, MOTION_DERIVATIVES[motion])
    sensors = structure.selection((*channels.sensors, *channels.left))
    loads = structure.selection((*channels.loads, *forces))

    def sides_at(values: FloatArray) -> Sides:
        return Sides(sparse.csc_array(sparse.hstack([sensors, read.rows(values)])), loads)

    rate = record.sampling_rate
    is_distributed = _n_independent(structure, forces) > len(channels.sensors)
    nothing = sparse.csc_array((structure.n_dofs, 0))
    carried = Sides(nothing, nothing) if is_distributed else sides_at(model.values)
    basis = reduction_basis(structure, [model.values], carried, rate / len(record.values), rate / 2)
    if not basis.shape[1]:
        raise NoAnswerError(
            f"all modes lie above {rate:g} Hz, the sampling rate, where more unknown forces than sensors cannot be determined; name"
            f" at most {len(channels.sensors)} of them, or use a record of more samples per second"
        )
    stated_time = 1.0 if unknown is None else unknown.correlation_time
    driving = band_limited_loads(channels.known) if is_filtered else channels.known
    smoother = _Smoother(
        channels, driving, len(forces), stated_time or 1 / rate, is_filtered, rate, read, is_distributed
    )
    reduced = reduce_structure(structure, model.values, basis, sides_at(model.values))
    if reduced.is_rigid.any() and 0 not in channels.derivatives:
        raise NoAnswerError(
            "the structure is unsupported, so that velocities and accelerations do not determine its position; measure a"
            " displacement too"
        )
    stated_std = 0.0 if unknown is None else unknown.std
    if stated_time is None:
        chosen = smoother.with_likeliest_time(reduced, stated_std)
    elif stated_std is None:
        chosen = smoother.with_likeliest_std(reduced)
    else:
        chosen = _ChosenForces(smoother, stated_std)
    drawn = model.draw_parameters(n_draws, np.random.default_rng(seed)) if n_draws else ()
    others = [reduce_structure(structure, v, basis, sides_at(v)) for v in map(model.parameters.values, drawn)]
    nominal, deviation, verdict = _within_uncertainty(chosen, reduced, others, seed)
    is_free = stated_time is None and stated_std is None
    is_doubted = is_free and bool(verdict.words)
    sensed_forces = nominal.mean[:, -len(forces) :]
    steeper = chosen.with_likeliest_order(reduced) if is_doubted else None
    retried = steeper and _if_steady(steeper, reduced, others, seed)
    if steeper and retried:
        # a steeper spectrum neither hides a wrong model nor makes a right one wrong
        both = _joined_verdict(verdict, retried[2], steeper.smoother.order)
        chosen, (nominal, deviation, _), verdict = steeper, retried, both
    # with as many forces as sensors a frequency would explain the resonance of a wrong model
    n_combined = _combined_forces(reduced.inputs[:, len(channels.loads) :])[0].shape[1]
    if is_doubted and not is_distributed and len(channels.sensors) > n_combined:
        likelier = chosen.with_likeliest_frequency(reduced, sensed_forces)
        retried = likelier and _if_steady(likelier, reduced, others, seed)
        if likelier and retried and not retried[2].words:
            chosen, (nominal, deviation, verdict) = likelier, retried
    n_out, n_left = len(wanted), len(channels.left)
    is_estimated = stated_time is None or stated_std is None
    out, seen, force = slice(0, n_out), slice(n_out, n_out + n_left), slice(n_out + n_left, None)
    left_std = np.sqrt(deviation[:, seen] ** 2 + channels.left_variance)
    return SensedMotion(
        np.arange(len(record.values)) / rate,
        wanted,
        motion,
        nominal.mean[:, out],
        deviation[:, out],
        forces,
        nominal.mean[:, force],
        deviation[:, force],
        chosen.std if forces else float("nan"),
        chosen.smoother.correlation_time if forces else float("nan"),
        tuple(
            LeftOutSensor(dof, MOTIONS[order], *columns)
            for dof, order, *columns in zip(
                channels.left,
                channels.left_derivatives,
                channels.left_values.T,
                nominal.mean[:, seen].T,
                left_std.T,
                strict=True,
            )
        ),
        (
            *(() if chosen.is_trusted else (_DOUBTED,)),
            *((verdict.words,) if verdict.words and not verdict.is_contradicted else ()),
            *(_slow_words(chosen, reduced, wanted, motion) if is_estimated else ()),
            *(
                (_distributed_words(len(forces), len(channels.sensors)),)
                if is_distributed
                else _unseen_words(forces, nominal.covariance[force, force], chosen.std)
            ),
        ),
        verdict.words if verdict.is_contradicted else "",
        chosen.smoother.frequency if forces else float("nan"),
        chosen.smoother.order,
    )


def _within_uncertainty(
    chosen: _ChosenForces, reduced: ReducedMatrices, others: Sequence[ReducedMatrices], seed: int
) -> tuple[_Smoothed, FloatArray, InnovationVerdict]:
    """Smoothed outputs of a model, their deviation (n_times, n) with that of `others` within its uncertainty, and the verdict.

    Outputs are, in order, the wanted ones, left-out sensors and unknown forces, whose spectrum is that of `chosen`; `seed` is that
    of the simulated records with which the innovations are compared.
    """
    smoother, std = chosen.smoother, chosen.std
    fit, rng = smoother.fit(reduced, std), np.random.default_rng([seed, 1])
    nominal = smoother.run(fit)
    spread, error, steady = np.zeros_like(nominal.mean), fit.prediction_errors(), fit.steady
    of_models = np.zeros(len(steady.sizes))
    replicates: list[_Smoother] = []
    for other in others:
        of_other = smoother.fit(other, std)
        spread += (smoother.smoothed_mean(of_other)[0] - nominal.mean) ** 2 / len(others)
        apart = (of_other.prediction_errors() - error) @ steady.whiten
        of_models += np.mean(apart**2, axis=0) / len(others)
        if len(replicates) < _REPLICATES:
            replicates.append(smoother.with_replicate(of_other, rng))
    replicates += [smoother.with_replicate(fit, rng) for _ in range(_REPLICATES - len(replicates))]
    usual = [smoother.innovations(item.filtered(steady)) for item in replicates]
    has_stated_noise = smoother.channels.has_stated_noise
    verdict = judge_innovations(
        smoother.innovations(fit), usual, has_stated_noise, smoother.is_distributed, np.sqrt(of_models)
    )
    return nominal, np.sqrt(nominal.variance + spread), verdict


def _if_steady(
    chosen: _ChosenForces, reduced: ReducedMatrices, others: Sequence[ReducedMatrices], seed: int
) -> tuple[_Smoothed, FloatArray, InnovationVerdict] | None:
    """Results of `_within_uncertainty`; None where one of the models has no steady filter, as under forces nearly a sine."""
    try:
        return _within_uncertainty(chosen, reduced, others, seed)
    except NoAnswerError:
        return None


def _joined_verdict(first: InnovationVerdict, steeper: InnovationVerdict, order: int) -> InnovationVerdict:
    """Verdict under forces of a likelier, steeper spectrum of `order`, with what the verdict of order 1 says where they differ.

    Only what contradicts the model under both spectra contradicts it; else the contradiction of one is told as a doubt.
    """
    if first.is_contradicted == steeper.is_contradicted:
        return steeper
    falling = f"unknown forces whose spectrum falls with f^-{2 * order}, as the record makes likelier than f^-2,"
    if first.is_contradicted:
        also = f"; also under the steeper one {steeper.words}" if steeper.words else ""
        return InnovationVerdict(
            False, f"{falling} explain the record; under those that fall with f^-2 {first.words}{also}"
        )
    return InnovationVerdict(
        False, f"{falling} leave a doubt that those that fall with f^-2 do not: under them {steeper.words}"
    )


_DOUBTED = (
    "the size of the unknown forces is estimated from the motion: the likelihood prefers far larger forces, since the model"
    " misses the record by more than the noise of its sensors; state that noise, or the size of the forces"
)


def _slow_words(
    chosen: _ChosenForces, reduced: ReducedMatrices, outputs: Sequence[Output], motion: str
) -> tuple[str, ...]:
    """A sentence on the first outputs, `outputs`, whose bands rest on the spectrum that was estimated for the forces; else ().

    Bands do so where, from the lowest frequency on, more than half of the variance of the motion remains open, and this makes a
    large part of the variance of its error. Accelerometers hardly tell slow motion: their noise hides it. Its band is then that
    of forces whose size at low frequencies follows from a spectrum fitted to high ones. `motion` is the word for what is sensed.
    """
    smoother = chosen.smoother
    frequency = np.geomspace(smoother.rate / len(smoother.driving), smoother.rate / 2, _LOOKED_AT)
    tables = smoother.spectra(reduced, chosen.std, frequency)
    total, left = (table[:, : len(outputs)] * frequency[:, None] for table in tables)
    slow = np.logical_and.accumulate(left > total / 2)  # from the lowest line on, without gaps
    whole = left.sum(axis=0)
    part = np.divide((left * slow).sum(axis=0), whole, out=np.zeros(len(outputs)), where=whole > 0)
    resting = np.flatnonzero(part > _RESTING)
    if not len(resting):
        return ()
    limits = [format_number(float(frequency[n - 1]), 2) for n in sorted(slow[:, resting].sum(axis=0).tolist())]
    parts = [f"{100 * each:.0f}" for each in sorted(part[resting].tolist())]
    below, percent = (" to ".join(dict.fromkeys((words[0], words[-1]))) for words in (limits, parts))
    names = [f"the {motion} at {each}" if isinstance(each, Dof) else str(each) for each in outputs]
    return (
        f"below {below} Hz these sensors tell less than half of {join_words([names[i] for i in resting], 3)}, and {percent} % of"
        " the variance of the error comes from there: such a band rests on the spectrum that is taken for the unknown forces, and"
        " is far too narrow if they have more slow parts, as under vehicles that cross; measure a displacement or an inclination"
        " too",
    )


def _distributed_words(n_forces: int, n_sensors: int) -> str:
    """A sentence on more unknown forces than sensors."""
    return (
        f"{n_forces} unknown forces act and {n_sensors} sensors measure: the record tells what they do to the motion, hardly each"
        " of them; a wrong model and forces of another spectrum look the same"
    )


def _n_independent(structure: Structure, forces: Sequence[Dof]) -> int:
    """Number of the unknown forces that move a structure independently of each other; those of one rigid part may not."""
    if not forces:
        return 0
    columns = structure.selection(forces)
    products = (columns.T @ columns).toarray()
    return int(np.linalg.matrix_rank(products, tol=_DEPENDENT * float(np.trace(products)), hermitian=True))


def _unseen_words(forces: Sequence[Dof], covariance: FloatArray, std: float) -> tuple[str, ...]:
    """Sentences on forces, and combinations of them, that the record hardly determines; () if there are none.

    Hardly means that more than 90 % of the variance remains. `covariance` (n_forces, n_forces) is that of the forces after the
    record, `std` the deviation of each before it, N.
    """
    if not forces:
        return ()
    remaining = covariance / std**2
    blind = [dof for dof, part in zip(forces, np.diag(remaining), strict=True) if part > _UNSEEN]
    words = [f"the record hardly determines the force at {join_words(blind)}: no sensor moves with it"] if blind else []
    parts, directions = np.linalg.eigh(remaining)
    for part, direction in zip(parts, directions.T, strict=True):
        largest = float(direction[np.argmax(np.abs(direction))])
        named = [(weight / largest, dof) for weight, dof in zip(direction.tolist(), forces, strict=True)]
        named = [(weight, dof) for weight, dof in named if abs(weight) > _NAMED]
        if part > _UNSEEN and len(named) > 1 and not all(dof in blind for _, dof in named):
            text = " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.2g} {dof.place}" for weight, dof in named)
            words.append(
                f"the record hardly determines the forces {text.removeprefix('+ ')} together: their sum moves no sensor"
            )
    return tuple(words)


@dataclass(frozen=True, eq=False)
class _Channels:
    """Channels of a record by role: known forces, sensors that are used, sensors that are left out.

    Attributes
    ----------
    loads, sensors, left : tuple of Dof
    known, measured, left_values : (n_times, n) float arrays
    derivatives, left_derivatives : tuple of int
        0 to 2 of displacement to acceleration.
    variance, left_variance : (n,) float arrays
        Of the noise of each sensor.
    has_stated_noise : bool
        False where the record states none, and a part of the size of each sensor is taken.
    """

    loads: tuple[Dof, ...]
    sensors: tuple[Dof, ...]
    left: tuple[Dof, ...]
    known: FloatArray
    measured: FloatArray
    left_values: FloatArray
    derivatives: tuple[int, ...]
    left_derivatives: tuple[int, ...]
    variance: FloatArray
    left_variance: FloatArray
    has_stated_noise: bool

    @classmethod
    def of_record(cls, record: TimeRecord, left_out: tuple[Dof, ...]) -> _Channels:
        """Channels of a record by role; sensors in `left_out` are only compared.

        `InputError` if `left_out` names a force or no channel, the record holds other quantities or no motion, or a sensor has
        no noise.
        """
        quantities = record.quantities
        pushed = [
            str(dof)
            for dof, what in zip(record.channels, quantities, strict=True)
            if what == "force" and dof in left_out
        ]
        if pushed:
            raise InputError(
                f"`leave_out` names {pushed[0]}, a force of the record; name sensors, whose motion is compared"
            )
        other = [str(quantity) for quantity in quantities if quantity not in (*MOTION_DERIVATIVES, "force")]
        if other:
            raise InputError(f"the record holds {other[0]}; motion at other places takes forces and motions alone")
        missing = [str(dof) for dof in left_out if dof not in record.channels]
        if missing:
            raise InputError(f"`leave_out` names {missing[0]}, which the record does not have")
        variance = record.variance
        if variance is None:
            variance = (_NOISE * record.values.std(axis=0)) ** 2
        rows = range(len(record.channels))
        loads = [i for i in rows if quantities[i] == "force"]
        used = [i for i in rows if quantities[i] != "force" and record.channels[i] not in left_out]
        out = [i for i in rows if quantities[i] != "force" and record.channels[i] in left_out]
        if not used:
            raise InputError(
                "the record has no motion to sense from; use one with displacements, velocities or accelerations"
            )
        silent = [i for i in (*used, *out) if not np.asarray(variance)[i] > 0]
        if silent:
            what = "states no noise and reads a constant" if record.variance is None else "has a noise of 0"
            raise InputError(
                f"sensor {record.channels[silent[0]]} {what}; take it out of the record, or state its noise"
            )

        def dofs(index: list[int]) -> tuple[Dof, ...]:
            return tuple(record.channels[i] for i in index)

        def order(index: list[int]) -> tuple[int, ...]:
            return tuple(MOTION_DERIVATIVES[quantities[i]] for i in index)

        return cls(
            dofs(loads), dofs(used), dofs(out),
            record.values[:, loads], record.values[:, used], record.values[:, out],
            order(used), order(out), np.asarray(variance)[used], np.asarray(variance)[out],
            record.variance is not None,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """Mean and variance (n_times, n) of wanted outputs, left-out sensors, unknown forces; covariance (n, n) inside it."""

    mean: FloatArray
    variance: FloatArray
    covariance: FloatArray


@cache
def _aliasing_filter(rate: float | None) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Filter against aliasing for a sampling `rate` in Hz, as (a, b, c, d) of x' = a x + b u and y = c x + d u.

    a is (n, n), b and c are (n,), d is a number; without a rate n is 0 and d is 1.
    """
    if rate is None:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    corner = np.pi * rate
    a, b, c, d = signal.zpk2ss(*signal.ellip(*_FILTER, 1.0, analog=True, output="zpk"))
    return corner * a, corner * b[:, 0], c[0], float(d[0, 0])


@dataclass(frozen=True, eq=False)
class _ForceModel:
    """An unknown force of unit variance: z' = dynamics z + white noise of density `noise`; force = output z.

    Attributes
    ----------
    dynamics : (n, n) float array
        1/s. Low-passes of first order in a row, each of one state, or of two where there is a frequency; the last one is the
        force. A filter against aliasing follows.
    noise : (n,) float array
        Square of each state per second.
    output : (n,) float array
    """

    dynamics: FloatArray
    noise: FloatArray
    output: FloatArray

    @classmethod
    def of(cls, correlation_time: float, frequency: float, order: int, filtered_rate: float | None) -> _ForceModel:
        """Model of a force with a correlation time, s, about a frequency, Hz (0 for none), from low-passes of first order in a row.

        `order` is their number. It is the force as a record filtered for the sampling rate `filtered_rate`, Hz, holds it; None
        means without filter.
        """
        inner, entry, output, direct = _aliasing_filter(filtered_rate)
        n_each = 2 if frequency else 1
        n_own, fade = order * n_each, _FADING[order] / correlation_time
        turning = 2 * np.pi * frequency * np.array([[0.0, -1.0], [1.0, 0.0]])[:n_each, :n_each]
        stage = turning - fade * np.eye(n_each)
        dynamics = np.zeros((n_own + len(inner),) * 2)
        dynamics[:n_own, :n_own] = np.kron(np.eye(order), stage) + fade * np.kron(np.eye(order, k=-1), np.eye(n_each))
        dynamics[n_own:, n_own - n_each], dynamics[n_own:, n_own:] = entry, inner
        white = np.where(np.arange(len(dynamics)) < n_each, 2 * fade, 0.0)
        covariance = linalg.solve_continuous_lyapunov(dynamics, -np.diag(white))
        if not np.diag(covariance).min() > 0:
            raise NoAnswerError(
                "the unknown forces are so near to a sine that their covariance has lost its digits; state a shorter"
                " `correlation_time`"
            )
        size = np.sqrt(np.diag(covariance))
        read = np.concatenate([np.zeros(n_own - n_each), [direct], np.zeros(n_each - 1), output])
        scaled = dynamics * size / size[:, None]  # states of unit variance, for the digits of the filter
        return cls(scaled, white / size**2, read * size / np.sqrt(read @ covariance @ read))


@dataclass(frozen=True, eq=False)
class _StateSpace:
    """z' = transition z + entry (f_k, f_{k+1}) + noise; asked = wanted z + wanted_direct f.

    Sensors read reading z + direct f, in standard deviations of their noise; the last rows of `wanted` are the unknown forces.
    `unmoved` is the covariance of what is asked that moves no mode, so that no reading tells it: (n_asked, n_asked).
    `n_combined` is the number of unknown forces that move the modes independently.
    """

    transition: FloatArray
    entry: FloatArray
    noise: FloatArray
    reading: FloatArray
    direct: FloatArray
    wanted: FloatArray
    wanted_direct: FloatArray
    unmoved: FloatArray
    n_combined: int


@dataclass(frozen=True, eq=False)
class _SteadyFilter:
    """A Kalman filter with steady gains, as far as all readings under the same known forces share it.

    Attributes
    ----------
    system : _StateSpace
    entered : (n_times - 1, n_states) float array
        Effect of the known forces on the states from sample to sample.
    gain : (n_states, n_used) float array
        K, the steady gain.
    predicted, updated : (n_states, n_states) float arrays
        Steady covariances before and after a reading.
    keep, step : (n_states, n_states) float arrays
        I - K C, what a reading leaves of an error before it, and A (I - K C), what is left of it before the next reading; A is
        the transition and C reads the state.
    sizes : (n_used,) float array
        Variances of the innovations in the directions in which they are independent, ascending.
    whiten : (n_used, n_used) float array
        These directions, one a column, over the standard deviations.
    seen : (n_used, n_states) float array
        Reads the state in these directions.
    information : (n_states, n_states) float array
        That of all readings on an error of the first state.
    first : (n_states, n_states) float array
        Covariance of the first state, of what known and unknown forces made before the record.
    free : (n_states, n_states) float array or None
        Covariance of modes that moved by themselves, but for its size, which the readings give; None with unknown forces.
    """

    system: _StateSpace
    entered: FloatArray
    gain: FloatArray
    predicted: FloatArray
    updated: FloatArray
    keep: FloatArray
    step: FloatArray
    sizes: FloatArray
    whiten: FloatArray
    seen: FloatArray
    information: FloatArray
    first: FloatArray
    free: FloatArray | None


@dataclass(frozen=True, eq=False)
class _Filtered:
    """States of a Kalman filter over a record.

    Attributes
    ----------
    steady : _SteadyFilter
    from_rest : (n_times, n_states) float array
        Mean before the reading of each sample if the first one were 0.
    start : (n_states,) float array
        Mean that the whole record gives the first state before its reading.
    read : (n_times, n_used) float array
        Readings without what known forces make in them at once, in standard deviations of their noise.
    start_covariance : (n_states, n_states) float array
        What the record leaves open of the first state, beyond the steady covariance before a reading.
    log_likelihood : float
        Of the record, less a constant.
    """

    steady: _SteadyFilter
    from_rest: FloatArray
    start: FloatArray
    read: FloatArray
    start_covariance: FloatArray
    log_likelihood: float

    def before(self) -> FloatArray:
        """Mean before the reading of each sample, (n_times, n_states)."""
        at_rest = np.zeros_like(self.from_rest[1:])
        return self.from_rest + stepped(self.steady.step, at_rest, self.start)

    def prediction_errors(self) -> FloatArray:
        """Readings less those expected from the samples before, in standard deviations of their noise, (n_times, n_used)."""
        return self.read - self.before() @ self.steady.system.reading.T


@dataclass(frozen=True, eq=False)
class _ChosenForces:
    """The spectrum that unknown forces are taken to have, stated or estimated.

    Attributes
    ----------
    smoother : _Smoother
        With their correlation time and frequency.
    std : float
        Standard deviation of each, N.
    is_trusted : bool
        False where the likeliest size runs into its upper limit, and the size of the motion decides instead.
    greatest : float
        Logarithm of the greatest likelihood of the record that the search met, less a constant; it may exceed that of the
        chosen forces. NaN where nothing was sought.
    """

    smoother: _Smoother
    std: float
    is_trusted: bool = True
    greatest: float = float("nan")

    def with_likeliest_order(self, reduced: ReducedMatrices) -> _ChosenForces | None:
        """Forces whose spectrum falls more steeply, where the record is likelier under them by more than chance; else None.

        They have a correlation time and a size too, so that nothing else is weighed. A higher order is tried while it is likelier.
        """
        best = self
        while best.smoother.order < max(_FADING):
            steeper = replace(best.smoother, order=best.smoother.order + 1)
            steeper_choice = steeper.with_likeliest_time(reduced, None, is_near=True)
            if not (steeper_choice.is_trusted and steeper_choice.greatest > best.greatest + _LESS_LIKELY):
                break
            best = steeper_choice
        return None if best is self else best

    def with_likeliest_frequency(self, reduced: ReducedMatrices, forces: FloatArray) -> _ChosenForces | None:
        """Forces of a spectrum of first order about the likeliest frequency; None where the frequency is not worth a parameter.

        The search starts at the largest line of the `forces` (n_times, n_forces) that were sensed without a frequency, with the
        likeliest of a few correlation times. Searches with and without a frequency have a correlation time and a size; the
        frequency is one parameter more, which must raise the greatest likelihood by enough: Schwarz (1978), Annals of Statistics
        6, 461-464. None also for too few samples, and where the likeliest forces would move the sensors by far more than the
        record: such forces hide any model error.
        """
        count, rate = len(forces), self.smoother.rate
        if count < _FEWEST:
            return None
        lines, power = signal.welch(forces, rate, nperseg=max(count // _SEGMENTS, _FEWEST), axis=0)
        peak = float(lines[1:][np.argmax(power[1:].sum(axis=1))])
        first, above = float(forces.std()), _decades_above(reduced)

        def of_point(point: FloatArray) -> tuple[_Smoother, float]:
            time, frequency, size = np.exp(point).tolist()
            return replace(self.smoother, correlation_time=time, frequency=frequency, order=1), size

        def unlikely(point: FloatArray) -> float:
            is_within = _SHORTEST / rate <= np.exp(point[0]) <= _LONGEST * count / rate and np.exp(point[1]) < rate / 2
            if not is_within:
                return float("inf")
            smoother, size = of_point(point)
            try:
                system = smoother._system(reduced, size)
                if not size < smoother._std_of_motion(system, size) * 10**above:
                    return float("inf")
                return -smoother.filtered(smoother._steady_filter(system)).log_likelihood
            except (NoAnswerError, np.linalg.LinAlgError):
                return float("inf")

        def first_point(time: float) -> FloatArray:
            smoother, size = of_point(np.log([time, peak, first]))
            try:
                return np.log([time, peak, min(size, smoother._first_std(reduced))])
            except (NoAnswerError, np.linalg.LinAlgError):
                return np.log([time, peak, size])

        times = 1 / peak, np.sqrt(count / rate / peak), count / rate / 2
        start = min(map(first_point, times), key=unlikely)
        simplex = start + np.vstack([np.zeros(3), np.diag([-0.7, 0.02, 0.3])])
        options = {"initial_simplex": simplex, "xatol": _SURE, "fatol": 0.1, "maxfev": _MOST_TRIALS}
        search = minimize(unlikely, start, method="Nelder-Mead", options=options)
        likeliest = -float(search.fun)
        is_worth = likeliest > self.greatest + 0.5 * np.log(count)
        smoother, size = of_point(search.x)
        if not is_worth or not size < smoother._first_std(reduced) * 10 ** (above - 3 * _SURE):
            return None
        return _ChosenForces(smoother, size, True, likeliest)


@dataclass(frozen=True, eq=False)
class _Smoother:
    """A filter and smoother of modal states for one record.

    Attributes
    ----------
    channels : _Channels
    driving : (n_times, n_known) float array
        The known forces between samples, see `band_limited_loads`.
    n_forces : int
        Unknown forces, the last inputs.
    correlation_time : float
        Of each of them, s.
    is_filtered : bool
        Whether the record went through a filter against aliasing.
    rate : float
        Samples per second.
    read : OutputMap
        What is asked for, behind used and left-out sensors among the outputs.
    is_distributed : bool
        Whether more unknown forces act than sensors are used.
    frequency : float
        Hz, about which the spectrum of the unknown forces lies; 0 where it falls from 0 Hz on.
    order : int
        Of that spectrum: far from its middle it falls with the frequency to the power -2 order.
    """

    channels: _Channels
    driving: FloatArray
    n_forces: int
    correlation_time: float
    is_filtered: bool
    rate: float
    read: OutputMap
    is_distributed: bool
    frequency: float = 0.0
    order: int = 1

    def fit(self, reduced: ReducedMatrices, std: float) -> _Filtered:
        """The record, filtered under the equations of a model; `std` is the deviation of the unknown forces, N."""
        return self.filtered(self._steady_filter(self._system(reduced, std)))

    def log_likelihood(self, reduced: ReducedMatrices, std: float) -> float:
        """Logarithm of the likelihood of the record, less a constant; -inf where the filter has no steady gains.

        `std` is the deviation of the unknown forces, N.
        """
        try:
            return self.fit(reduced, std).log_likelihood
        except NoAnswerError:
            return -np.inf

    def with_replicate(self, fit: _Filtered, rng: np.random.Generator) -> _Smoother:
        """Copy of this smoother whose measured channels are random: a record that the model of `fit` could have given.

        The known forces stay those of the record; noise of the sensors and unknown forces are drawn from `rng`.
        """
        steady, system, known = fit.steady, fit.steady.system, self.channels.known
        of_start, of_noise = square_root(steady.predicted + fit.start_covariance), square_root(system.noise)
        first = fit.start + of_start @ rng.standard_normal(of_start.shape[1])
        drive = rng.standard_normal((len(known) - 1, of_noise.shape[1])) @ of_noise.T
        states = stepped(system.transition, drive + steady.entered, first)
        read = states @ system.reading.T + known @ system.direct.T + rng.standard_normal(self._measured.shape)
        return replace(self, channels=replace(self.channels, measured=read * np.sqrt(self.channels.variance)))

    def run(self, fit: _Filtered) -> _Smoothed:
        """Smoothed wanted outputs, left-out sensors and unknown forces, in this order, with their variance at each sample."""
        (mean, back), steady = self.smoothed_mean(fit), fit.steady
        predicted, updated, rows = steady.predicted, steady.updated, steady.system.wanted
        covariance = _symmetric(linalg.solve_discrete_lyapunov(back, updated - back @ predicted @ back.T))
        wanted = rows @ covariance @ rows.T
        variance = np.tile(np.maximum(np.diag(wanted), 0.0), (len(mean), 1))
        unmoved = steady.system.unmoved
        at_end = _variance_beside_end(rows, back, updated - covariance, variance)[::-1]
        onwards = _sum_of_powers(back, steady.keep - back @ steady.step, steady.step)
        at_start = _variance_of_start(rows, onwards, back, fit, variance)
        return _Smoothed(mean, variance + at_end + at_start + np.diag(unmoved), wanted + unmoved)

    def smoothed_mean(self, fit: _Filtered) -> tuple[FloatArray, FloatArray]:
        """Smoothed outputs (n_times, n), in the order of `run`, and the smoother gain (n_states, n_states).

        The gain is the factor by which the error of a later state corrects the state one sample before.
        """
        steady, system, before = fit.steady, fit.steady.system, fit.before()
        back = np.linalg.solve(steady.predicted, system.transition @ steady.updated).T
        after = before @ steady.keep.T + fit.read @ steady.gain.T
        drive = (after[:-1] - before[1:] @ back.T)[::-1]
        smoothed = stepped(back, drive, after[-1])[::-1]
        return smoothed @ system.wanted.T + self.channels.known @ system.wanted_direct.T, back

    def spectra(self, reduced: ReducedMatrices, std: float, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Spectral densities of outputs, in the order of `run`, under the unknown forces, and of what remains open of them.

        Both are (n_frequencies, n_outputs), up to one factor; `frequency` is in Hz, `std` the deviation of the forces, N. The
        second is the error of the smoother far from the ends of a record.
        """
        system = self._system(reduced, std)
        root = square_root(system.noise).astype(complex)
        before, after = np.zeros((2, len(frequency), len(system.wanted)))
        for k, point in enumerate(np.exp(2j * np.pi * frequency / self.rate)):
            states = np.linalg.solve(point * np.eye(len(root)) - system.transition, root)
            read, wanted = system.reading @ states, system.wanted @ states
            both = wanted @ read.conj().T
            before[k] = (np.abs(wanted) ** 2).sum(axis=1)
            told = np.linalg.solve(np.eye(len(read)) + read @ read.conj().T, both.conj().T)
            after[k] = np.maximum(before[k] - np.einsum("ij,ji->i", both, told).real, 0.0)
        return before, after

    def with_likeliest_std(self, reduced: ReducedMatrices) -> _ChosenForces:
        """Forces of the correlation time of this smoother and the standard deviation under which the record is likeliest.

        A model whose resonances are off by a part of their width makes far larger forces likelier than those that move the
        sensors as much as they do. Where the search runs into its upper limit, the size of the motion decides instead, and the
        result is not trusted.
        """
        size, above = self._first_std(reduced), _decades_above(reduced)
        search = minimize_scalar(
            lambda decades: -self.log_likelihood(reduced, float(size * 10**decades)),
            bounds=(-_BELOW, above),
            method="bounded",
            options={"xatol": _SURE},
        )
        if search.x > above - 3 * _SURE:
            return _ChosenForces(self, size, False, -float(search.fun))
        return _ChosenForces(self, float(size * 10**search.x), True, -float(search.fun))

    def with_likeliest_time(self, reduced: ReducedMatrices, std: float | None, is_near: bool = False) -> _ChosenForces:
        """Forces of an estimated correlation time and standard deviation.

        From the likeliest time and size on, the shortest time is taken under which the logarithm of the record's likelihood is
        at most 2 below the greatest: accelerations hardly tell slow forces from none. It is bisected, as if the record got less
        and less likely with shorter times; where it does not, a still shorter time may serve as well. The size falls with the
        time to the power `order` - 1/2, so that the spectral density at high frequencies stays; a stated `std`, N, is kept, None
        is estimated. For the trust see `with_likeliest_std`. The search goes through all times first, unless that of this
        smoother `is_near`.
        """
        shortest, longest = np.log(_SHORTEST / self.rate), np.log(len(self.channels.measured) / self.rate / 4)
        above = _decades_above(reduced)

        def of_time(log_time: float) -> _Smoother:
            return replace(self, correlation_time=float(np.exp(log_time)))

        def size(log_time: float, decades: float) -> float:
            return float((of_time(log_time)._first_std(reduced) if std is None else std) * 10**decades)

        def likelihood(log_time: float, decades: float) -> float:
            return of_time(log_time).log_likelihood(reduced, size(log_time, decades))

        def unlikely(point: FloatArray) -> float:
            log_time, decades = float(point[0]), float(point[1])
            is_within = shortest <= log_time <= longest and -_BELOW <= decades <= above
            return -likelihood(log_time, decades) if is_within else float("inf")

        times = np.linspace(shortest, longest, _TIMES).tolist()
        if is_near:
            first = float(np.clip(np.log(self.correlation_time), shortest, longest))
        else:
            by_motion = [likelihood(time, 0.0) for time in times]
            first = times[int(np.argmax(by_motion))]
            if max(by_motion) == -np.inf:
                of_time(first).fit(reduced, size(first, 0.0))  # raises, with the reason
        if std is None:
            simplex = np.array(
                [[first, 0.0], [first + (times[0] - times[1]) * (1 if first > shortest else -1), 0.0], [first, -0.3]]
            )
            options = {"initial_simplex": simplex, "xatol": _SURE, "fatol": 0.1, "maxfev": 60}
            search = minimize(unlikely, simplex[0], method="Nelder-Mead", options=options)
            log_time, decades = search.x.tolist()
            if decades > above - 3 * _SURE:
                return _ChosenForces(of_time(first), size(first, 0.0), False, -float(search.fun))
            largest = size(log_time, decades)
        else:
            beside = max(first + times[0] - times[1], shortest), min(first + times[1] - times[0], longest)
            search = minimize_scalar(
                lambda log_time: -likelihood(log_time, 0.0), bounds=beside, method="bounded", options={"xatol": _SURE}
            )
            log_time, largest = float(search.x), std
        most = -float(search.fun)

        def shortened(step: int) -> tuple[_Smoother, float]:
            # with the same density beyond the correlation time
            smaller = largest * _SHORTER ** (step * (self.order - 0.5)) if std is None else std
            return of_time(log_time + step * np.log(_SHORTER)), float(smaller)

        longest_step = min(_STEPS, max(int(np.ceil((shortest - log_time) / np.log(_SHORTER))) - 1, 0))
        likely, unlikely_from = 0, longest_step + 1
        while unlikely_from - likely > 1:
            step = (likely + unlikely_from) // 2
            smoother, smaller = shortened(step)
            if smoother.log_likelihood(reduced, smaller) >= most - _LESS_LIKELY:
                likely = step
            else:
                unlikely_from = step
        return _ChosenForces(*shortened(likely), True, most)

    def _first_std(self, reduced: ReducedMatrices) -> float:
        """First guess of the standard deviation of the unknown forces, N, from the size of the measured motion.

        Sensors that the forces hardly move hardly count. `NoAnswerError` if no sensor moves with them.
        """
        return self._std_of_motion(self._system(reduced, 1.0), 1.0)

    def _std_of_motion(self, system: _StateSpace, std: float) -> float:
        """Standard deviation of the unknown forces, N, that makes the measured motion; `std` is that of `system`."""
        covariance = self._stationary(system, system.noise)
        made = np.einsum("ij,jk,ik->i", system.reading, covariance, system.reading) / std**2
        if not made.max() > 0:
            raise NoAnswerError(
                "no sensor moves with the unknown forces, so that their size cannot be told; state it, or use other sensors"
            )
        return float(np.sqrt(max(float(self._measured.var(axis=0) @ made), 1.0) / float(made @ made)))

    @property
    def _measured(self) -> FloatArray:
        """Readings of the used sensors in standard deviations of their noise, (n_times, n_used)."""
        return self.channels.measured / np.sqrt(self.channels.variance)

    def _steady_filter(self, system: _StateSpace) -> _SteadyFilter:
        """Prepare the part of a filter under the equations `system` that all readings under the known forces share.

        Before the record known forces count as noise of ten times their size, since nobody knows what they did then.
        """
        predicted = _predicted_covariance(system)
        innovation = system.reading @ predicted @ system.reading.T + np.eye(len(system.reading))
        gain = np.linalg.solve(innovation, system.reading @ predicted).T
        keep = np.eye(len(predicted)) - gain @ system.reading
        step = system.transition @ keep
        sizes, directions = np.linalg.eigh(innovation)
        if not (sizes[0] > 0 and _fades(step)):
            raise NoAnswerError(
                "the forces move the sensors by so much more than the noise that is stated that the filter loses its digits; state"
                " the noise that the sensors really have"
            )
        whiten = directions / np.sqrt(sizes)
        seen = whiten.T @ system.reading
        constant, rising = np.hsplit(system.entry, 2)
        pushed = _BEFORE * (constant + rising) * np.sqrt(np.mean(self.channels.known**2, axis=0))
        return _SteadyFilter(
            system,
            np.asarray(np.hstack([self.driving[:-1], self.driving[1:]]) @ system.entry.T),
            gain,
            predicted,
            predicted - gain @ innovation @ gain.T,
            keep,
            step,
            sizes,
            whiten,
            seen,
            _symmetric(_sum_of_powers(step.T, seen.T @ seen, step, len(self.channels.measured))),
            self._stationary(system, system.noise + pushed @ pushed.T),
            None if self.n_forces else self._stationary(system, np.eye(len(predicted))),
        )

    def filtered(self, steady: _SteadyFilter) -> _Filtered:
        """Kalman filter over the record, with the estimated initial state and the log-likelihood.

        A record begins in motion: its initial state has the stationary covariance. That is the covariance of the steady filter
        and an independent part, on which all innovations depend linearly: de Jong (1991), Annals of Statistics 19, 1073-1083.
        """
        system, step, rest = steady.system, steady.step, np.zeros(len(steady.step))
        read = self._measured - self.channels.known @ system.direct.T
        drive = read[:-1] @ (system.transition @ steady.gain).T + steady.entered
        from_rest = stepped(step, drive, rest)
        error = (read - from_rest @ system.reading.T) @ steady.whiten
        root = square_root(self._first_covariance(steady) - steady.predicted)
        score = root.T @ stepped(step.T, (error @ steady.seen)[::-1], rest)[-1]
        posterior = np.eye(root.shape[1]) + root.T @ steady.information @ root
        start = np.linalg.solve(posterior, np.column_stack([score, root.T]))
        likelihood = 0.5 * (score @ start[:, 0] - (error**2).sum() - np.linalg.slogdet(posterior)[1])
        return _Filtered(
            steady,
            from_rest,
            root @ start[:, 0],
            read,
            _symmetric(root @ start[:, 1:]),
            float(likelihood - 0.5 * len(read) * np.log(steady.sizes).sum()),
        )

    def innovations(self, fit: _Filtered) -> Innovations:
        """Readings less those that the filter expects from the samples before."""
        steady, n = fit.steady, len(fit.steady.sizes)
        return Innovations(
            fit.prediction_errors() @ steady.whiten,
            np.arange(n) >= n - steady.system.n_combined,
            steady.sizes > 1 + _OPEN**2,
        )

    def _first_covariance(self, steady: _SteadyFilter) -> FloatArray:
        """Covariance (n_states, n_states) of the state at the start of the record.

        Without unknown forces modes may also have moved by themselves, so that the sensors read ten times what they read in the
        record.
        """
        free, reading = steady.free, steady.system.reading
        if free is None:
            return steady.first
        made = np.einsum("ij,jk,ik->i", reading, free, reading)
        seen = np.mean(self._measured**2, axis=0)
        return steady.first + _BEFORE**2 * float(seen @ made) / max(float(made @ made), np.finfo(float).tiny) * free

    def _stationary(self, system: _StateSpace, noise: FloatArray) -> FloatArray:
        """Stationary covariance (n_states, n_states) of the state under a `noise` covariance (n_states, n_states) per sample.

        Motions that last longer than the record fade over its length, so that those of a free structure are finite.
        """
        count = len(self.channels.measured)
        lasting = float(np.abs(np.linalg.eigvals(system.transition)).max())
        fade = 1.0 if lasting < 1 - 0.1 / count else 1 - 1 / count
        return np.asarray(linalg.solve_discrete_lyapunov(fade * system.transition, noise))

    def _system(self, reduced: ReducedMatrices, std: float) -> _StateSpace:
        """State equations from sample to sample; states are modal displacements, modal speeds and those of the unknown forces.

        States are in scaled units. `std` is the standard deviation of the unknown forces, N; the inputs of `reduced` are the
        known forces, then the unknown ones.
        """
        n, n_known = len(reduced.omega), reduced.inputs.shape[1] - self.n_forces
        known = reduced.inputs[:, :n_known]
        unknown, parts_of_forces = _combined_forces(reduced.inputs[:, n_known:])
        n_forces = unknown.shape[1]
        force = _ForceModel.of(
            self.correlation_time, self.frequency, self.order, self.rate if self.is_filtered else None
        )
        n_each = len(force.output)
        step, size = 1 / self.rate, 2 * n + n_forces * n_each
        elastic = reduced.omega[~reduced.is_rigid & (reduced.omega > 0)]
        reference = max(float(elastic.min(initial=np.inf)) if len(elastic) else 0.0, float(-force.dynamics[0, 0]))
        speed = max(float(np.abs(unknown).max(initial=0.0)) * std / reference, _SPEED)
        scales = speed / np.maximum(reduced.omega, reference), np.full(n, speed), np.full(n_forces * n_each, std)
        units = np.concatenate(scales)
        pushing = np.kron(np.eye(n_forces), force.output)  # forces from their states
        dynamics = np.zeros((size, size))
        dynamics[:n, n : 2 * n] = np.eye(n)
        dynamics[n : 2 * n, :n], dynamics[n : 2 * n, n : 2 * n] = (
            -np.diag(reduced.omega**2),
            -reduced.viscous_equivalent(),
        )
        dynamics[n : 2 * n, 2 * n :] = unknown @ pushing
        dynamics[2 * n :, 2 * n :] = np.kron(np.eye(n_forces), force.dynamics)
        acceleration = dynamics[n : 2 * n]
        n_sensors, n_left = len(self.channels.sensors), len(self.channels.left)
        orders = np.array([*self.channels.derivatives, *self.channels.left_derivatives])
        rows, direct = _output_matrices(reduced.outputs[: len(orders)], orders, acceleration, known)
        groups = np.split(reduced.outputs[len(orders) :], len(self.read.orders))
        asked, asked_direct = np.zeros((self.read.n_rows, size)), np.zeros((self.read.n_rows, n_known))
        for order, group in zip(self.read.orders, groups, strict=True):
            parts = _output_matrices(group, np.full(len(group), order), acceleration, known)
            asked, asked_direct = asked + parts[0], asked_direct + parts[1]
        left = slice(n_sensors, n_sensors + n_left)
        forces = np.hstack([np.zeros((self.n_forces, 2 * n)), parts_of_forces @ pushing])
        wanted = np.vstack([asked, rows[left], forces]) * units
        wanted_direct = np.vstack([asked_direct, direct[left], np.zeros((self.n_forces, n_known))])
        unmoved = np.zeros((len(wanted), len(wanted)))
        among_forces = slice(len(wanted) - self.n_forces, None)
        unmoved[among_forces, among_forces] = std**2 * (np.eye(self.n_forces) - parts_of_forces @ parts_of_forces.T)
        dynamics = dynamics * units / units[:, None]
        random = np.diag(
            np.full(size, _STRAY * reference) + np.concatenate([np.zeros(2 * n), np.tile(force.noise, n_forces)])
        )
        wide = np.block([[-dynamics, random], [np.zeros_like(dynamics), dynamics.T]]) * step
        held = np.zeros((size + 2 * n_known,) * 2)
        held[:size, :size], held[n : 2 * n, size : size + n_known] = dynamics * step, known * step / speed
        held[size : size + n_known, size + n_known :] = np.eye(n_known)
        transition, constant, rising = np.split(linalg.expm(held)[:size], [size, size + n_known], axis=1)
        noise = transition @ linalg.expm(wide)[:size, size:]
        deviation = np.sqrt(self.channels.variance)[:, None]
        return _StateSpace(
            transition,
            np.hstack([constant - rising, rising]),
            _symmetric(noise),
            rows[:n_sensors] * units / deviation,
            direct[:n_sensors] / deviation,
            wanted,
            wanted_direct,
            unmoved,
            n_forces,
        )


def _combined_forces(inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fewest independent forces of one spectrum that do to the modes what `inputs` (n_modes, n_forces) of that spectrum do.

    Returns the modal forces of each combination, (n_modes, n_combined), and the part of each in the forces,
    (n_forces, n_combined). Combinations that move no mode are left out.
    """
    if not inputs.size:
        return inputs, np.eye(inputs.shape[1])
    modal, sizes, parts = np.linalg.svd(inputs, full_matrices=False)
    n_combined = max(int((sizes > np.sqrt(_DEPENDENT) * sizes[0]).sum()), 1)
    if n_combined == inputs.shape[1]:
        return inputs, np.eye(n_combined)
    return modal[:, :n_combined] * sizes[:n_combined], parts[:n_combined].T


def _decades_above(reduced: ReducedMatrices) -> float:
    """Orders of magnitude above a first guess of the unknown forces up to which their size is sought."""
    return _BELOW if reduced.is_rigid.any() else _ABOVE


def _predicted_covariance(system: _StateSpace) -> FloatArray:
    """Covariance (n_states, n_states) of the state before each reading, once it has settled.

    Chu, Fan, Lin and Wang (2004), Int. J. Control 77, 767-788, Algorithm 3.1: P = A P (I + C' C P)^-1 A' + Q by doubling the
    number of samples. `NoAnswerError` if it does not settle.
    """
    step: FloatArray = system.transition.T
    seen: FloatArray = system.reading.T @ system.reading
    covariance = system.noise
    one = np.eye(len(step))
    for _ in range(_DOUBLINGS):
        after, read = np.hsplit(np.linalg.solve(one + seen @ covariance, np.hstack([step, seen @ step.T])), 2)
        grown = np.asarray(step.T @ covariance @ after)
        seen, step = _symmetric(seen + step @ read), np.asarray(step @ after, dtype=np.float64)
        covariance = _symmetric(covariance + grown)
        if not np.isfinite(covariance).all():
            break
        if np.abs(grown).max() <= _CONVERGED * np.abs(covariance).max():
            return covariance
    raise NoAnswerError("these sensors do not tell the motion: none of them sees one of the modes; measure more places")


def _fades(step: FloatArray) -> bool:
    """True if the powers of a matrix (n, n) fade, or grow by no more than rounding makes them.

    A power of norm below 1 proves it, and a few products are cheaper than the eigenvalues.
    """
    power = step
    for _ in range(_SQUARINGS):
        size = float(np.linalg.norm(power))
        if size < 1:
            return True
        if not size < 1 / np.finfo(float).eps:
            break
        power = power @ power
    return bool(np.abs(np.linalg.eigvals(step)).max() < 1 + _UNSTABLE)


def _symmetric(matrix: FloatArray) -> FloatArray:
    """A matrix that is symmetric but for rounding, made so."""
    return np.asarray((matrix + matrix.T) / 2)


def _sum_of_powers(left: FloatArray, middle: FloatArray, right: FloatArray, count: int = 2**_DOUBLINGS) -> FloatArray:
    """Sum over k from 0 to count - 1 of left^k middle right^k, by doubling, so that no digits cancel.

    All are (n, n). The default `count` is large enough for the infinite sum, if the powers fade.
    """
    total, before, after = np.zeros_like(middle), np.eye(len(left)), np.eye(len(right))
    for digit in f"{count:b}":
        total, before, after = total + before @ total @ after, before @ before, after @ after
        if digit == "1":
            total, before, after = middle + left @ total @ right, before @ left, after @ right
    return total


def _variance_beside_end(wanted: FloatArray, step: FloatArray, excess: FloatArray, steady: FloatArray) -> FloatArray:
    """Excess of the variance of outputs over the `steady` one near an end of the record, (n_times, n), from the end inwards.

    The outputs are `wanted` (n, n_states) times the state, whose covariance at the end exceeds the steady one by `excess`
    (n_states, n_states); each sample inwards multiplies the error of the state by `step` (n_states, n_states).
    """
    beyond, rows = np.zeros_like(steady), wanted
    for k in range(len(beyond)):
        beyond[k] = np.maximum(np.einsum("ij,jk,ik->i", rows, excess, rows, optimize=True), 0.0)
        if (beyond[k] <= _SETTLED * steady[k]).all():
            break
        rows = rows @ step
    return beyond


def _variance_of_start(
    wanted: FloatArray, onwards: FloatArray, back: FloatArray, filtered: _Filtered, steady: FloatArray
) -> FloatArray:
    """Excess of the variance of outputs, (n_times, n), by what the record leaves open of its first state.

    In a record without end an error of the first state leaves `onwards` (n_states, n_states) of itself when all readings from
    it onwards are smoothed. Of N samples the smoothed state k is off by onwards step^k + back^(N-1-k) (keep - onwards)
    step^(N-1) times that error. `wanted` (n, n_states) reads the outputs from the state, `back` is the smoother gain, and
    `steady` (n_times, n) the variance without this excess.
    """
    step, excess, count = filtered.steady.step, filtered.start_covariance, len(steady)
    late = (filtered.steady.keep - onwards) @ np.linalg.matrix_power(step, count - 1)
    beyond, early = np.zeros_like(steady), (wanted @ onwards).T
    has_late = np.abs(late @ excess @ late.T).max() > _CONVERGED * np.abs(onwards @ excess @ onwards.T).max()
    for first in range(0, count, _BLOCK):
        size = min(_BLOCK, count - first)
        nothing = np.zeros((size, *early.shape))
        columns = stepped(step.T, nothing, early)
        columns, early = columns[:-1], columns[-1]
        if has_late:
            from_end = (wanted @ np.linalg.matrix_power(back, count - first - size)).T
            columns = columns + late.T @ stepped(back.T, nothing[1:], from_end)[::-1]
        beyond[first : first + size] = np.maximum(np.einsum("kji,kji->ki", excess @ columns, columns), 0.0)
        if not has_late and (beyond[first + size - 1] <= _SETTLED * steady[0]).all():
            break
    return beyond


def _output_matrices(
    outputs: FloatArray, orders: IntArray, acceleration: FloatArray, forces: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Matrices of outputs over states, (n_outputs, n_states), and over known forces, (n_outputs, n_known).

    `outputs` (n_outputs, n_modes) read modal displacements, or their derivatives of `orders` (0, 1 or 2; (n_outputs,)).
    `acceleration` (n_modes, n_states) gives modal accelerations from states, `forces` (n_modes, n_known) those by known forces.
    """
    n = outputs.shape[1]
    rows, direct = np.zeros((len(orders), acceleration.shape[1])), np.zeros((len(orders), forces.shape[1]))
    for order in (0, 1):
        rows[orders == order, order * n : (order + 1) * n] = outputs[orders == order]
    rows[orders == 2], direct[orders == 2] = outputs[orders == 2] @ acceleration, outputs[orders == 2] @ forces
    return rows, direct

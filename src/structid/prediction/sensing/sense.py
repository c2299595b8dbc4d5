"""Motion where no sensor is, and forces that nobody measured, from a record of other places; with what it hardly determines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.display import Overview, Shown, format_number, join_words, number, unit_text
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoAnswerError
from structid.identification.identified import Identification
from structid.prediction.identified_model import IdentifiedModel, model_of
from structid.prediction.loads import band_limited_loads
from structid.prediction.poles import ReducedMatrices, Sides, reduce_structure, reduction_basis
from structid.prediction.recovery import Output, distinct_channels, is_von_mises, output_map, output_unit, parse_outputs
from structid.prediction.sensing.force_search import (
    ChosenForces,
    likeliest_frequency,
    likeliest_order,
    likeliest_std,
    likeliest_time,
)
from structid.prediction.sensing.innovations import InnovationVerdict, judge_innovations
from structid.prediction.sensing.kalman_filter import (
    Smoothed,
    error_spectra,
    filter_record,
    fit_record,
    innovations_of,
    simulate_record,
    smooth,
    smoothed_outputs,
)
from structid.prediction.sensing.state_equations import (
    Channels,
    ForceProcess,
    SensingSetup,
    UnknownForces,
    combine_forces,
    count_independent_forces,
)
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES, QUANTITY_UNITS

#: Part of the variance of a force before the record that remains, above which the record hardly determines it.
_UNSEEN = 0.9
#: Part of a combination of forces below which a force is not named in it.
_NAMED = 0.3
#: Lines at which what the sensors tell of a motion is looked at, and part of its remaining variance from lines where they tell less
#: than half of it, from which on its band rests on the spectrum of the forces.
_LOOKED_AT, _RESTING = 40, 0.3


def slow_motion_words(
    setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess, outputs: Sequence[Output], motion: str
) -> tuple[str, ...]:
    """Sentence on those of `outputs` whose bands rest on the spectrum that was estimated for the forces; () if none do.

    Bands do so where, from the lowest frequency on, more than half of the variance of the motion remains open, and this
    makes over 30 % of the variance of its error. Accelerometers hardly tell slow motion: their noise hides it. Its band
    is then that of forces whose size at low frequencies follows from a spectrum fitted to high ones. `outputs` are the
    first of the outputs of the filter; `motion` is the word for what is sensed. `reduced` is the structure on its
    modes, `process` that of each unknown force.
    """
    frequency = np.geomspace(setup.rate / len(setup.driving), setup.rate / 2, _LOOKED_AT)
    tables = error_spectra(setup, reduced, process, frequency)
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


def undetermined_force_words(forces: Sequence[Dof], covariance: FloatArray, std: float) -> tuple[str, ...]:
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


def distributed_force_words(n_forces: int, n_sensors: int) -> str:
    """A sentence on more unknown forces than sensors."""
    return (
        f"{n_forces} unknown forces act and {n_sensors} sensors measure: the record tells what they do to the motion, hardly each"
        " of them; a wrong model and forces of another spectrum look the same"
    )


#: Error of a sensor that was left out, over its stated deviation, from which on the model or the forces are wrong there.
LARGEST_CHECK = 2.0


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
        """Root mean square over time of (measured - sensed) / std, dimensionless; about 1 if the deviation is right."""
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
        """Pairs of a sensor that was left out and its `ratio` of error to stated deviation; () if none was."""
        return tuple((sensor.dof, sensor.ratio) for sensor in self.left_out)

    @property
    def is_explained(self) -> bool:
        """True where the model explains the record, also at the sensors that were left out."""
        return not self.contradiction and all(z < LARGEST_CHECK for _, z in self.checks)

    def unit_of(self, output: Output) -> str:
        """SI unit of the values of `output`: that of the motion along or about it, or of what is read from an element."""
        return output_unit(output) or QUANTITY_UNITS[self.motion][isinstance(output, Dof) and output.is_rotation]

    def overview(self) -> Overview:
        """A table with the RMS over the record of each output and force and of its deviation, and checks of left-out sensors."""
        rows = [
            (
                name,
                number(float(np.sqrt(np.mean(value**2))), 3),
                number(float(np.sqrt(np.mean(std**2))), 2),
                unit_text(unit),
            )
            for name, unit, value, std in zip(
                (*map(str, self.outputs), *(f"force at {dof}" for dof in self.force_dofs)),
                (
                    *map(self.unit_of, self.outputs),
                    *(QUANTITY_UNITS["force"][dof.is_rotation] for dof in self.force_dofs),
                ),
                (*self.values.T, *self.forces.T),
                (*self.std.T, *self.force_std.T),
                strict=True,
            )
        ]
        told = "".join(f"; {dof}, left out: {format_number(z, 3)} times its stated deviation" for dof, z in self.checks)
        return Overview(
            f"{self.motion} at {join_words(self.outputs)} over {len(self.time)} samples{told}",
            ("where", "rms", "± rms", "unit"),
            rows,
        )


#: Motions by their derivatives of displacement.
MOTIONS = tuple(sorted(MOTION_DERIVATIVES, key=MOTION_DERIVATIVES.__getitem__))

#: Random records of the model to which the innovations of the record are compared.
_REPLICATES = 20
_DOUBTED = (
    "the size of the unknown forces is estimated from the motion: the likelihood prefers far larger forces, since the model"
    " misses the record by more than the noise of its sensors; state that noise, or the size of the forces"
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

    A Kalman filter with steady gains and a Rauch-Tung-Striebel smoother run over the modes up to the sampling rate, with
    each unknown force as white noise behind low-passes of first to third order, and again for models within the
    uncertainty: the deviation includes both. The innovations of the filter, compared with those of simulated records,
    give the verdict.

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
        Values and standard deviations of outputs (n_times, n_outputs) and unknown forces (n_times, n_forces) in SI units, the
        sensors left out, and words on what contradicts the model or is not determined.

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
    channels = Channels.of_record(record, left)
    forces = () if unknown is None else parse_dofs(unknown.dofs)
    if forces:
        distinct_channels("unknown", tuple(dof.unsigned for dof in forces))
    if not forces and not channels.loads:
        raise InputError(
            "the record holds no force and none is named as unknown, so that nothing would move the model; name where forces act"
            " with `unknown`"
        )
    structure = model.structure
    structure.require_scaled_modes("motion at other places")
    read = output_map(structure, wanted, MOTION_DERIVATIVES[motion])
    sensors = structure.selection((*channels.sensors, *channels.left))
    loads = structure.selection((*channels.loads, *forces))

    def sides_at(values: FloatArray) -> Sides:
        return Sides(sparse.csc_array(sparse.hstack([sensors, read.rows(values)])), loads)

    rate = record.sampling_rate
    is_distributed = count_independent_forces(structure, forces) > len(channels.sensors)
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
    setup = SensingSetup(channels, driving, len(forces), is_filtered, rate, read, is_distributed)
    reduced = reduce_structure(structure, model.values, basis, sides_at(model.values))
    if reduced.is_rigid.any() and 0 not in channels.derivatives:
        raise NoAnswerError(
            "the structure is unsupported, so that velocities and accelerations do not determine its position; measure a"
            " displacement too"
        )
    stated_std = 0.0 if unknown is None else unknown.std
    process = ForceProcess(stated_time or 1 / rate, stated_std or 0.0)
    if stated_time is None:
        chosen = likeliest_time(setup, reduced, process, stated_std)
    elif stated_std is None:
        chosen = likeliest_std(setup, reduced, process)
    else:
        chosen = ChosenForces(process)
    drawn = model.draw_parameters(n_draws, np.random.default_rng(seed)) if n_draws else ()
    others = [reduce_structure(structure, v, basis, sides_at(v)) for v in map(model.parameters.values, drawn)]
    nominal, deviation, verdict = _within_uncertainty(setup, chosen.process, reduced, others, seed)
    is_free = stated_time is None and stated_std is None
    is_doubted = is_free and bool(verdict.words)
    sensed_forces = nominal.mean[:, -len(forces) :]
    steeper = likeliest_order(setup, reduced, chosen) if is_doubted else None
    retried = steeper and _if_steady(setup, steeper.process, reduced, others, seed)
    if steeper and retried:
        # a steeper spectrum neither hides a wrong model nor makes a right one wrong
        both = _joined_verdict(verdict, retried[2], steeper.process.order)
        chosen, (nominal, deviation, _), verdict = steeper, retried, both
    # with as many forces as sensors a frequency would explain the resonance of a wrong model
    n_combined = combine_forces(reduced.inputs[:, len(channels.loads) :])[0].shape[1]
    if is_doubted and not is_distributed and len(channels.sensors) > n_combined:
        likelier = likeliest_frequency(setup, reduced, chosen, sensed_forces)
        retried = likelier and _if_steady(setup, likelier.process, reduced, others, seed)
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
        chosen.process.std if forces else float("nan"),
        chosen.process.correlation_time if forces else float("nan"),
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
            *(slow_motion_words(setup, reduced, chosen.process, wanted, motion) if is_estimated else ()),
            *(
                (distributed_force_words(len(forces), len(channels.sensors)),)
                if is_distributed
                else undetermined_force_words(forces, nominal.covariance[force, force], chosen.process.std)
            ),
        ),
        verdict.words if verdict.is_contradicted else "",
        chosen.process.frequency if forces else float("nan"),
        chosen.process.order,
    )


def _within_uncertainty(
    setup: SensingSetup,
    process: ForceProcess,
    reduced: ReducedMatrices,
    others: Sequence[ReducedMatrices],
    seed: int,
) -> tuple[Smoothed, FloatArray, InnovationVerdict]:
    """Smoothed outputs of a model, their deviation (n_times, n) with that of `others` within its uncertainty, and the verdict.

    Outputs are, in order, the wanted ones, left-out sensors and unknown forces, each of which is `process`; `seed` is that of
    the simulated records with which the innovations are compared. `reduced` is the identified structure on its modes.
    """
    fit, rng = fit_record(setup, reduced, process), np.random.default_rng([seed, 1])
    nominal = smooth(setup, fit)
    spread, error, steady = np.zeros_like(nominal.mean), fit.prediction_errors(), fit.steady
    of_models = np.zeros(len(steady.sizes))
    replicates: list[SensingSetup] = []
    for other in others:
        of_other = fit_record(setup, other, process)
        spread += (smoothed_outputs(setup, of_other)[0] - nominal.mean) ** 2 / len(others)
        apart = (of_other.prediction_errors() - error) @ steady.whiten
        of_models += np.mean(apart**2, axis=0) / len(others)
        if len(replicates) < _REPLICATES:
            replicates.append(simulate_record(setup, of_other, rng))
    replicates += [simulate_record(setup, fit, rng) for _ in range(_REPLICATES - len(replicates))]
    usual = [innovations_of(filter_record(item, steady)) for item in replicates]
    verdict = judge_innovations(
        innovations_of(fit), usual, setup.channels.has_stated_noise, setup.is_distributed, np.sqrt(of_models)
    )
    return nominal, np.sqrt(nominal.variance + spread), verdict


def _if_steady(
    setup: SensingSetup,
    process: ForceProcess,
    reduced: ReducedMatrices,
    others: Sequence[ReducedMatrices],
    seed: int,
) -> tuple[Smoothed, FloatArray, InnovationVerdict] | None:
    """Results of `_within_uncertainty`; None where one of the models has no steady filter, as under forces nearly a sine."""
    try:
        return _within_uncertainty(setup, process, reduced, others, seed)
    except NoAnswerError:
        return None


def _joined_verdict(first: InnovationVerdict, steeper: InnovationVerdict, order: int) -> InnovationVerdict:
    """Verdict under forces of a likelier, steeper spectrum of `order`, with what the verdict of order 1 says where they differ.

    Only what contradicts the model under both spectra contradicts it; else the contradiction under one is a doubt in the words.
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

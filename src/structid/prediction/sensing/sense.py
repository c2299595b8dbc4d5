"""Motion where no sensor is, and forces that nobody measured, from a record of other places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoAnswerError
from structid.identification.identified import Identification
from structid.prediction.identified_model import IdentifiedModel, model_of
from structid.prediction.loads import band_limited_loads
from structid.prediction.poles import ReducedMatrices, Sides, reduce_structure, reduction_basis
from structid.prediction.recovery import Output, distinct_channels, is_von_mises, output_map, parse_outputs
from structid.prediction.sensing.force_search import (
    ChosenForces,
    likeliest_frequency,
    likeliest_order,
    likeliest_std,
    likeliest_time,
)
from structid.prediction.sensing.forces import ForceProcess, UnknownForces, combine_forces, count_independent_forces
from structid.prediction.sensing.innovations import InnovationVerdict, judge_innovations
from structid.prediction.sensing.kalman_filter import filter_record, fit_record, innovations_of, simulate_record
from structid.prediction.sensing.result import LeftOutSensor, SensedMotion
from structid.prediction.sensing.setup import Channels, SensingSetup
from structid.prediction.sensing.smoother import Smoothed, smooth, smoothed_outputs
from structid.prediction.sensing.undetermined import (
    distributed_force_words,
    slow_motion_words,
    undetermined_force_words,
)
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES

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
    structure.require_modes("motion at other places")
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

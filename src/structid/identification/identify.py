"""One identification from structure, unknowns and record to everything that a report shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from structid.arrays import FloatArray
from structid.declared import Count, Limits, NotNegative, Positive
from structid.errors import InputError
from structid.estimation import Estimate
from structid.estimation.estimate import StageProgress
from structid.estimation.intervals.intervals import IntervalKind, intervals
from structid.estimation.search.least_squares import LevenbergMarquardt, Method
from structid.estimation.search.work import ALONE, Work
from structid.identification.answer import answered
from structid.identification.checks import record_warnings
from structid.identification.identified import AnySetup, Identification, RecordFit, Setup
from structid.identification.modal_setup import ModalFit, ModalSetup, modal_fit, modal_fit_warnings
from structid.identification.model_modes import structure_modes
from structid.identification.ratios import ratios
from structid.identification.regularizing import regularization_warnings, shares
from structid.identification.resonances import resonances
from structid.identification.search import RecordProblem, alike, by_name, shared_parts, together
from structid.identification.warning_words import estimate_warnings, record_fit_warnings
from structid.observation import ChannelUnknown, FrfProblem, ModalProblem, measures_everything, one_step_values
from structid.observation.channel_errors import channel_errors
from structid.observation.frf.continuation import START_ERROR
from structid.records import FrfRecord
from structid.structure import Structure
from structid.unknowns import Parameters, Regularization

_RELATIVE_WEIGHT = 0.1


@dataclass(frozen=True)
class IdentifyOptions:
    """How an identification is done.

    Parameters
    ----------
    band : (float, float), optional
        Lowest and highest frequency used, Hz; all lines by default.
    exclude : sequence of (float, float)
        Stretches of the band that are left out, Hz.
    residual : Form
        Residual of the last stage; see `FrfProblem`.
    model_error : float
        Error of the model as a part of each value's magnitude, added to the noise.
    pole_free_start : bool
        Whether a search on easier forms of the residual comes first, for starts far from the answer.
    start : {"near", "continuation"}
        Which way the search comes first: by easier forms of the residual, for initial values that are near, or by
        continuation from the right half-plane, which carries further (see `continuation_plan`). The other ways
        follow in `restarts`.
    start_error : float
        Expected error of the initial values in the logarithm, for the continuation: 0.5 is a factor of 1.65.
    restarts : int
        How many more searches are tried where the fit does not reach the noise: one by another way from the same
        start, then from random starts about 20 % from it. The best fit is kept.
    uniqueness_starts : int
        How many more searches begin at such random starts even where a search fits: a test whether other parameters
        fit the data as well.
    seed : int
        Of those starts.
    method : Method
        Search of the last stage.
    matrix_free : bool, optional
        Whether the parameters are searched for without a Jacobian, see `identify_free`; by default where one is too
        large. `identify` and `identify_together` always have one.
    direction : str, optional
        Translation of the total mass; the first that has mass by default.
    n_modes : int
        How many modes of the identified model are given.
    evaluation_band : (float, float), optional
        Where the fit is judged and drawn, Hz; the lines that were used by default. A wider one shows how the model
        does on lines that had no part in the fit.
    regularization : sequence of Smoothness or Sparsity
        What holds parameters that the data alone do not determine.
    intervals : {"laplace", "profile", "bootstrap", "sampling"}
        How the 95 % interval of each parameter is found, in rising order of cost; see `structid.estimation.intervals.intervals`.
    reduced : float, optional
        Largest error of the model's FRFs, in parts of the largest of their line, with which a large model may find them
        from few factorizations; see `FrfProblem`.
    """

    band: tuple[float, float] | None = None
    exclude: Sequence[tuple[float, float]] = ()
    residual: Literal["output", "log", "pole_free"] = "output"
    model_error: NotNegative = 0.0
    pole_free_start: bool = True
    start: Literal["near", "continuation"] = "near"
    start_error: Positive = START_ERROR
    restarts: int = 2
    uniqueness_starts: int = 0
    seed: int = 0
    method: Method = field(default_factory=LevenbergMarquardt)
    matrix_free: bool | None = None
    direction: Literal["X", "Y", "Z"] | None = None
    n_modes: Count = 12
    evaluation_band: tuple[float, float] | None = None
    regularization: Sequence[Regularization] = ()
    intervals: IntervalKind = "laplace"
    reduced: Annotated[float, Limits(above=0, most=0.01)] | None = None


def prepared_problem(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    options: IdentifyOptions,
    channel_unknowns: Sequence[ChannelUnknown] = (),
) -> tuple[FrfProblem, tuple[str, ...]]:
    """The least-squares problem of the lines that `options` choose, and what is worth a warning about it."""
    used = used_lines(record, options)
    warnings = list(record_warnings(structure, used))
    model_error = options.model_error
    if used.variance is None and model_error == 0:
        model_error = _RELATIVE_WEIGHT
        warnings.append(
            "the record has no noise level: every line is weighted by its own magnitude, and standard deviations come"
            " from the scatter of the residual"
        )
    channels = channel_errors(used, channel_unknowns) if channel_unknowns else None
    problem = FrfProblem(
        structure, unknown, used, options.residual, model_error, channels=channels, reduced=options.reduced
    )
    if options.start == "continuation":
        problem = replace(problem, start_error=options.start_error)
    return problem, tuple(warnings)


def used_lines(record: FrfRecord, options: IdentifyOptions) -> FrfRecord:
    """The lines of `record` inside the band and outside the excluded stretches."""
    keep = np.ones(len(record.frequency), dtype=bool)
    if options.band is not None:
        keep &= (record.frequency >= options.band[0]) & (record.frequency <= options.band[1])
    for low, high in options.exclude:
        keep &= (record.frequency < low) | (record.frequency > high)
    return record if keep.all() else record.lines(np.flatnonzero(keep))


def identify(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    options: IdentifyOptions | None = None,
    progress: StageProgress | None = None,
    channel_unknowns: Sequence[ChannelUnknown] = (),
) -> Identification:
    """Parameters of `structure` from a frequency response record, from any set of sensors.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    record : FrfRecord
    options : IdentifyOptions, optional
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    channel_unknowns : sequence of ChannelUnknown
        Errors of sensors and loads that are identified too.

    Returns
    -------
    Identification
        Also where the search failed or the data do not determine the answer: see ``estimate.status``.

    References
    ----------
    Norris (1986), chapter 4, with the unmeasured degrees of freedom eliminated.
    """
    return identify_together([Setup(structure, unknown, record, channel_unknowns)], options, progress)


def identify_together(
    setups: Sequence[AnySetup],
    options: IdentifyOptions | None = None,
    progress: StageProgress | None = None,
    work: Work = ALONE,
) -> Identification:
    """Parameters from several records in one fit: other sensors, loads, supports or added masses of one structure.

    Records of responses (`Setup`) and of modes (`ModalSetup`) go together as they come.

    Parameters of the same name are one unknown, errors of channels too: give those a `name` where two records have
    different sensors at the same place. Such a parameter begins where the first set-up has it; a prior that any of
    them states counts once.

    Parameters
    ----------
    setups : sequence of Setup or ModalSetup
        Whose noise is independent.
    options : IdentifyOptions, optional
        For all records alike.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : Work
        Where searches and their repeats run, and whether they are kept.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        If a shared parameter is declared differently in two set-ups, or a record cannot be used.
    """
    chosen = options or IdentifyOptions()
    if not setups:
        raise InputError("`setups` must hold at least one set-up, got none; give one for each record")
    pairs = [prepared_setup(setup, chosen) for setup in setups]
    problems = initial = alike([problem for problem, _ in pairs])
    only = problems[0]
    if (
        len(problems) == 1
        and isinstance(only, FrfProblem)
        and setups[0].time is None
        and only.channels is None
        and measures_everything(setups[0].structure, only.record)
    ):
        problems = (_started_by_one_step(only),)

    work.known(shared_parts(problems))
    answer = answered(setups, problems, chosen, progress, work)
    found, problems = (
        replace(answer.estimate, initial=by_name(answer.estimate.names, initial, "start")),
        answer.problems,
    )
    if found.residual_tests is not None and not any(setup.time for setup in setups):
        found = replace(found, residual_tests=found.residual_tests.named(_channel_names(titles(setups), problems)))
    ends = intervals(answer.target or problems[0], found, chosen.intervals, seed=chosen.seed, work=work)
    fits, modal_fits = _fits(setups, problems, found, chosen)
    mass, std = _total_mass(fits[0] if fits else modal_fits[0], found, chosen.direction)
    warnings = record_fit_warnings(
        fits, [own for (_, own), s in zip(pairs, setups, strict=True) if isinstance(s, Setup)]
    )
    several = len(setups) > 1
    warnings += [(f"{fit.name}: " if several else "") + w for fit in modal_fits for w in modal_fit_warnings(fit)]
    prior_mean, prior_std = (by_name(found.names, problems, field) for field in ("prior_mean", "prior_std"))
    share = np.zeros(len(found.names)) if answer.target is None else shares(answer.target, found)
    scale_free = ratios(together(problems), found) if modal_fits else None
    warnings += [] if scale_free is None else [scale_free.words]
    warnings += [*estimate_warnings(found), *regularization_warnings(problems, found, answer.held, share)]
    return Identification(
        found, fits, prior_mean, prior_std, mass, std, tuple(warnings), answer.held, share, ends, modal_fits, scale_free
    )


def _fits(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], found: Estimate, chosen: IdentifyOptions
) -> tuple[tuple[RecordFit, ...], tuple[ModalFit, ...]]:
    """The answer seen from each record of responses, and from each of modes."""
    fits: list[RecordFit] = []
    modal: list[ModalFit] = []
    for title, setup, problem in zip(titles(setups), setups, problems, strict=True):
        if isinstance(setup, Setup) and isinstance(problem, FrfProblem):
            fits.append(record_fit(title, setup, problem, _own(problem, found), chosen))
        elif isinstance(problem, ModalProblem):
            theta, final, start = _own(problem, found)
            modal.append(modal_fit(title, problem, theta, (start, final), chosen.n_modes))
    return tuple(fits), tuple(modal)


def prepared_setup(setup: AnySetup, options: IdentifyOptions) -> tuple[RecordProblem, tuple[str, ...]]:
    """The least-squares problem of a record, and what is worth a warning about it."""
    if isinstance(setup, ModalSetup):
        return setup.problem(), ()
    return prepared_problem(setup.structure, setup.parameters, setup.record, options, setup.channel_unknowns)


def _channel_names(records: Sequence[str], problems: Sequence[RecordProblem]) -> list[str]:
    """Sensor of every channel, with its load and record where there are several: as a residual's series are ordered.

    Beside modes, which have one series each, the two of an FRF (real and imaginary part) are named one by one.
    """
    each = 2 if any(isinstance(problem, ModalProblem) for problem in problems) else 1
    names = []
    for title, problem in zip(records, problems, strict=True):
        first = f"{title}: " if len(problems) > 1 else ""
        if not isinstance(problem, FrfProblem):
            names += [first + name for name in problem.series_names]
            continue
        record = problem.record
        loads = [f"/{load}" if len(record.inputs) > 1 else "" for load in record.inputs]
        names += [f"{first}{output}{load}" for output in record.outputs for load in loads for _ in range(each)]
    return names


def titles(setups: Sequence[AnySetup]) -> list[str]:
    """What reports call each record: its name, or its number."""
    return [setup.name or f"record {number}" for number, setup in enumerate(setups, 1)]


def record_fit(
    title: str,
    setup: Setup,
    problem: FrfProblem,
    own: tuple[FloatArray, FloatArray, FloatArray],
    options: IdentifyOptions,
) -> RecordFit:
    """The whole answer seen from one record.

    Parameters
    ----------
    title : str
        What reports call the record.
    setup : Setup
    problem : FrfProblem
        Its lines that were used.
    own : (theta, final, start)
        Free variables at the end, and physical values after and before, of the problem's own parameters.
    options : IdentifyOptions
    """
    theta, final, start = own
    structure, unknown, n = problem.structure, setup.parameters, setup.parameters.n_params
    judged = setup.record.band(*options.evaluation_band) if options.evaluation_band else problem.record
    judged_prediction = problem.predicted_on(judged, final)
    theta_start = np.concatenate([unknown.transforms.free(start[:n]), problem.theta_start[n:]])
    return RecordFit(
        name=title,
        problem=problem,
        theta=theta,
        measured=setup.record,
        predicted_initial=problem.predicted(theta_start),
        predicted=problem.predicted(theta),
        evaluation=judged,
        evaluation_initial=problem.predicted_on(judged, start),
        evaluation_predicted=judged_prediction,
        modes_initial=structure_modes(structure, unknown.values(start[:n]), options.n_modes),
        modes=structure_modes(structure, unknown.values(final[:n]), options.n_modes),
        resonances=resonances(judged, judged_prediction),
        time=setup.time,
    )


def _own(problem: RecordProblem, found: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Free variables, final and initial values of the problem's own parameters."""
    place = [found.names.index(name) for name in problem.names]
    return found.theta[place], found.values[place], found.initial[place]


def _total_mass(fit: RecordFit | ModalFit, found: Estimate, direction: str | None) -> tuple[float, float]:
    """Total mass of the first set-up's structure and its standard deviation, kg."""
    structure, unknown = fit.problem.structure, fit.problem.parameters
    index = np.array([found.names.index(name) for name in unknown.names])
    values = unknown.values(found.values[index])
    gradient = structure.mass_gradient(direction, values) @ unknown.design
    covariance, used = found.covariance[np.ix_(index, index)], gradient != 0
    mass = structure.mass_of(values, direction)
    if not np.isfinite(covariance[np.ix_(used, used)]).all():
        return mass, float("nan")
    return mass, float(np.sqrt(gradient @ np.nan_to_num(covariance) @ gradient))


def _started_by_one_step(problem: FrfProblem) -> FrfProblem:
    """The same problem from the one-step linear solve, where that gives a value inside a parameter's range."""
    unknown = problem.parameters
    solved = one_step_values(problem.structure, unknown, problem.record)
    inside = (solved > unknown.transforms.lower) & (solved < unknown.transforms.upper)
    return replace(problem, parameters=unknown.started_at(np.where(inside, solved, unknown.start)))

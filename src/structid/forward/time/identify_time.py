"""Identification from time records: one entry, three estimators; output error goes from few samples to all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.forward.fixed_values import tolerances_of, with_fixed_values
from structid.forward.motion.fit import identify_motion
from structid.forward.time.instrumental import identified_by_instruments
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error import OutputErrorProblem, output_error_problem
from structid.forward.time.weak_form import identified_by_weak_form
from structid.inversion import Estimate, LevenbergMarquardt, Linearization, OperatorLinearization
from structid.inversion.diagnostics.identifiability import bound_at
from structid.inversion.estimate import estimate
from structid.inversion.search.least_squares import cost_at
from structid.inversion.search.multistart import named
from structid.inversion.search.posterior_linearization import posterior_linearized
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import SERIAL, StageProgress, TaskContext, TaskExecutor
from structid.records import TimeRecord
from structid.unknowns import Parameters

_NEAR, _FAR = 0.05, 0.2
_HELD = 0.5
_STAGE_TOLERANCE = 1e-4
_LINEAR_SAMPLES = (4, 8, 16)
#: Posterior linearization: standard deviation in parts of each value, of the given start and about a minimum that a few
#: modes keep from the noise, and rows for each unknown.
_SPREAD, _NEAR_SPREAD, _SPREAD_ROWS = 0.5, 0.1, 16
#: At most so many, and none after so many that come back to the same minimum, to a part of its sum of squares.
_MOST_FAR, _AGREE, _SAME = 6, 2, 0.01
#: By how much chi-square is less at a better answer: at the same one it is the same to less.
_BETTER = 1.0


class _Start(NamedTuple):
    """Free variables to begin at, and the first stage of the way from there."""

    theta: FloatArray
    first: int = 0


#: Stages passed, chi-square per degree of freedom of the last with a minus, and free variables where it ended.
_PathEnd = tuple[int, float, FloatArray]


def identified_by_output_error(
    structure: Structure,
    unknown: Parameters,
    record: TimeRecord,
    options: TimeOptions,
    work: TaskExecutor = SERIAL,
    progress: StageProgress | None = None,
) -> Estimate:
    """Maximum-likelihood estimate from time histories, fitted to few samples first and then to more and more.

    Each stage doubles the samples and starts where the one before ended. A stage that misses the noise ends the search
    from its start, and the next start is tried; if all fail, the one that came furthest is followed to its end. Starts
    are linear fits, the initial values, the weak form, then random points and posterior linearization. Workers run
    starts in parallel (`work`) without changing the answer; `progress` follows the stages. Raises `InputError` if the
    record or the model does not suit the method.
    """
    problem = output_error_problem(structure, unknown, record, options)
    sizes = _stages(problem, options)
    path_ends: list[_PathEnd] = []
    iterations = 0
    for path_end, spent in _search_starts(
        _rounds(problem, record, options, sizes, path_ends, work, progress), (problem, sizes, options), work, progress
    ):
        iterations += spent
        path_ends.append(path_end)
        if path_end[0] == len(sizes):
            break
    reached, _, theta = _furthest(path_ends)
    if reached < len(sizes):
        tools = TaskContext(work.minimize, progress)
        _, _, theta, spent = _follow_stages(problem, sizes[reached:], theta, options, False, tools)
        iterations += spent
    elif options.restarts and len(path_ends) > 1:
        theta, spent = _confirmed(problem, options, sizes, theta, work, progress)
        iterations += spent
    final = problem.with_parameters(unknown.started_at(unknown.transforms.physical(theta)))
    method = LevenbergMarquardt(max_iterations=2 * options.max_iterations)
    freed = with_fixed_values(final, options.tolerances)
    tolerances = tolerances_of([freed])
    fitted = estimate(
        final,
        method,
        misfit_probability=options.misfit_probability,
        progress=progress,
        work=work,
        fixed=FixedValues(freed, tolerances) if tolerances else None,
    )
    bound = bound_at(problem, unknown.theta_start, "the initial values").std
    search = replace(fitted.search, n_iterations=fitted.search.n_iterations + iterations, n_starts=len(path_ends))
    spread = replace(fitted.spread, bound_initial=bound)
    return replace(fitted.with_initial(locked(unknown.start)), spread=spread, search=search)


def _search_starts(
    rounds: Iterator[list[_Start]],
    shared: tuple[OutputErrorProblem, list[int], TimeOptions],
    work: TaskExecutor,
    progress: StageProgress | None,
) -> Iterator[tuple[_PathEnd, int]]:
    """Yield the result of the search from each starting point of each of `rounds`, with its number of iterations.

    A result is stages passed, minus chi-square per degree of freedom, and free variables (n_params,). A round is made
    only when its first result is asked for. `shared` is the problem, the numbers of samples of the stages, and the
    options. `work` runs as many starts at a time as it has workers, and `progress` follows them.
    """
    count = 0
    for starts in rounds:
        for first in range(0, len(starts), work.n_workers):
            ahead = starts[first : first + work.n_workers]
            for result in work.map("starts", _search_from_start, shared, ahead, progress, first=count):
                yield (
                    (int(result["reached"]), -float(result["excess"]), np.asarray(result["theta"])),
                    int(result["spent"]),
                )
            count += len(ahead)


def _search_from_start(
    shared: tuple[OutputErrorProblem, list[int], TimeOptions], start: _Start, tools: TaskContext
) -> dict[str, Any]:
    """Result of the search from one start, as a parallel task.

    Keys are ``reached`` (stages passed, earlier ones included if any was), ``excess`` (chi-square per degree of freedom
    at the end), ``theta`` (n_params,), the free variables there, and ``spent`` (iterations). `tools` give the minimizer
    and the report of progress; `shared` is the problem, the numbers of samples of the stages, and the options.
    """
    problem, sizes, options = shared
    reached, excess, theta, spent = _follow_stages(problem, sizes[start.first :], start.theta, options, True, tools)
    reached += start.first if reached else 0
    return {"reached": reached, "excess": excess, "theta": theta, "spent": spent}


def _stages(problem: OutputErrorProblem, options: TimeOptions) -> list[int]:
    """Numbers of samples of the search stages, each twice the one before; the last is the whole record.

    The first is `first_samples` of the options, or as many as one equation for each unknown takes, at least 2.
    """
    size = options.first_samples or max(2, _samples(problem, 1))
    sizes = []
    while size < problem.n_times:
        sizes.append(size)
        size *= 2
    return [*sizes, problem.n_times]


def _samples(problem: OutputErrorProblem, rows: int) -> int:
    """Number of samples that give at least `rows` rows for each unknown, at most those of the record."""
    n_times, n_sensors = problem.measured.shape
    n_initial = 2 * len(problem.model.free) if problem.free_start else 0
    return min(n_times, -(-rows * (problem.parameters.n_params + n_initial) // n_sensors))


def _follow_stages(
    problem: OutputErrorProblem,
    sizes: list[int],
    theta: FloatArray,
    options: TimeOptions,
    strict: bool,
    tools: TaskContext,
) -> tuple[int, float, FloatArray, int]:
    """A search through stages with more and more samples, from the free variables `theta` (n_params,).

    With `strict`, it ends at the first stage whose chi-square is less probable than `options.misfit_probability`. In
    all stages but the last, parameters have a prior at where the stage begins, with half of each value as deviation.
    `sizes` are the numbers of samples of the stages; `tools` give the minimizer and the report of progress.

    Returns
    -------
    (int, float, (n_params,) float array, int)
        Stages passed, chi-square per degree of freedom of the last one, free variables there, and iterations.
    """
    spent, excess = 0, np.inf
    method = LevenbergMarquardt(max_iterations=options.max_iterations, gain_tolerance=_STAGE_TOLERANCE)
    for passed, size in enumerate(sizes):
        stage = problem.first(size)
        if size < problem.n_times:
            begin = problem.parameters.started_at(problem.physical(theta))
            stage = stage.with_parameters(begin.kept_near_start(_HELD))
        minimum = tools.minimize(stage, method, theta, named(tools.progress, f"{size} samples"))
        spent += len(minimum.costs) - 1
        excess, probability = _misfit(stage, minimum.linearization)
        if strict and probability < options.misfit_probability:
            return passed, excess, minimum.theta, spent
        theta = minimum.theta
    return len(sizes), excess, theta, spent


def _misfit(problem: OutputErrorProblem, linearization: Linearization | OperatorLinearization) -> tuple[float, float]:
    """Chi-square per degree of freedom, and the probability of a larger chi-square.

    Both are 1 without degrees of freedom.
    """
    data = linearization.residual[: problem.n_data]
    freedom, chi_square = problem.n_data - linearization.n_params - linearization.n_eliminated, float(data @ data)
    if freedom <= 0:
        return 1.0, 1.0
    return chi_square / freedom, float(special.gammaincc(freedom / 2, chi_square / 2))


def _furthest(path_ends: list[_PathEnd]) -> _PathEnd:
    return max(path_ends, key=lambda path_end: path_end[:2])


def _rounds(
    problem: OutputErrorProblem,
    record: TimeRecord,
    options: TimeOptions,
    sizes: list[int],
    path_ends: list[_PathEnd],
    work: TaskExecutor,
    progress: StageProgress | None,
) -> Iterator[list[_Start]]:
    """Yield starting points of the search in rounds, each made when all before have failed.

    First linear fits, the initial values and the weak form (with driven supports the initial values alone); then
    `options.restarts` random points, two at a time: about 5 % from where the best search ended, and about 20 % from one
    of the first starts. After the first pair come starts by posterior linearization. `path_ends` holds the results of
    all searches so far, `sizes` the numbers of samples of the stages. `work` and `progress` serve the posterior
    linearizations.
    """
    structure, unknown = problem.structure, problem.parameters
    sound: list[FloatArray] = []
    rng = np.random.default_rng(options.seed)
    for makers in (_given_start,) if problem.model.bases else (_linear_starts, _given_start, _weak_start):
        made = list(makers(structure, unknown, record))
        sound += made
        yield [_Start(theta) for theta in made]
    for attempt in range(0, options.restarts, 2):
        centres = [(_NEAR, _furthest(path_ends)[2]), (_FAR, sound[attempt // 2 % len(sound)])]
        points: list[_Start] = []
        for distance, theta in centres[: options.restarts - attempt]:
            size = np.abs(unknown.transforms.physical(theta)) / unknown.transforms.slope(theta)
            points.append(_Start(theta + distance * size * rng.standard_normal(len(theta))))
        yield points
        if attempt == 0:
            yield from _far_rounds(problem, options, sizes, path_ends, work, progress)


def _far_rounds(
    problem: OutputErrorProblem,
    options: TimeOptions,
    sizes: list[int],
    path_ends: list[_PathEnd],
    work: TaskExecutor,
    progress: StageProgress | None,
) -> Iterator[list[_Start]]:
    """Yield starting points by posterior linearization, in turn from the initial values and from the best minimum.

    The best minimum serves twice in a row. From the initial values it may miss high modes by some periods, which it
    finds from the best minimum. Each point is searched from the stage whose samples were linearized, and from the
    first. There are at most six; none follow if two lead back to the same minimum, to 1 % of its misfit. `path_ends`
    holds the results of all searches so far, `sizes` the numbers of samples of the stages. `work` runs the
    linearizations, and `progress` follows them.
    """
    first = _first_far(problem, sizes)
    short, agreed = problem.first(sizes[first]), 0
    for count in range(_MOST_FAR):
        misfit, best = _best(short, path_ends)
        centre = (short.theta_start, _SPREAD) if count % 3 == 0 else (best, _NEAR_SPREAD)
        task = (*centre, options.seed + count)
        [start] = work.map("far starts", _far_start, short, [task], progress, first=count)
        before = len(path_ends)
        yield [_Start(np.asarray(start["theta"]), begin) for begin in dict.fromkeys((first, 0))]
        agreed += abs(_best(short, path_ends[before:])[0] - misfit) < _SAME * misfit
        if agreed == _AGREE:
            return


def _confirmed(
    problem: OutputErrorProblem,
    options: TimeOptions,
    sizes: list[int],
    theta: FloatArray,
    work: TaskExecutor,
    progress: StageProgress | None,
) -> tuple[FloatArray, int]:
    """Free variables of the better of `theta` and an answer near it by posterior linearization, and the iterations.

    The other answer is better if its search passes all stages and its sum of squares is less by more than 1. `sizes`
    are the numbers of samples of the stages. `theta` is (n_params,), and so is the result. `work` runs linearization
    and search, and `progress` follows them.
    """
    first = _first_far(problem, sizes)
    short, task = problem.first(sizes[first]), (theta, _NEAR_SPREAD, options.seed + _MOST_FAR)
    [start] = work.map("confirming starts", _far_start, short, [task], progress)
    starts = [_Start(np.asarray(start["theta"]), first)]
    [outcome] = work.map("confirming ways", _search_from_start, (problem, sizes, options), starts, progress)
    beside = np.asarray(outcome["theta"])
    is_better = int(outcome["reached"]) == len(sizes) and cost_at(problem, beside) < cost_at(problem, theta) - _BETTER
    return beside if is_better else theta, int(outcome["spent"])


def _first_far(problem: OutputErrorProblem, sizes: list[int]) -> int:
    """Index of the first stage with enough samples for posterior linearization; `sizes` are the numbers of samples."""
    return next(number for number, size in enumerate(sizes) if size >= _samples(problem, _SPREAD_ROWS))


def _best(short: OutputErrorProblem, path_ends: Sequence[_PathEnd]) -> tuple[float, FloatArray]:
    """Least sum of squares of the samples of `short` among the ends of searches, and the free variables there."""
    return min(((cost_at(short, theta), theta) for _, _, theta in path_ends), key=lambda end: end[0])


def _far_start(short: OutputErrorProblem, task: tuple[FloatArray, float, int], tools: TaskContext) -> dict[str, Any]:
    """Start point ``theta`` that posterior linearization reaches from a centre with a spread and a seed, as a task."""
    progress = named(tools.progress, f"far start, {short.n_times} samples")
    return {"theta": posterior_linearized(short, *task, progress)}


def _linear_starts(structure: Structure, unknown: Parameters, record: TimeRecord) -> Iterator[FloatArray]:
    """Yield starting points (n_params,), free variables, by linear fits to the first 4, 8 and 16 samples.

    Nothing comes where some motion is not measured, nor for more samples than the record has.
    """
    for n_samples in _LINEAR_SAMPLES:
        if n_samples > len(record.values):
            return
        short = replace(record, values=record.values[:n_samples])
        try:
            values = identify_motion(structure, unknown.without_priors(), short).values
        except InputError:
            return
        yield _free(unknown, values)


def _given_start(structure: Structure, unknown: Parameters, record: TimeRecord) -> Iterator[FloatArray]:
    yield unknown.theta_start


def _weak_start(structure: Structure, unknown: Parameters, record: TimeRecord) -> Iterator[FloatArray]:
    """Yield the starting point (n_params,), free variables, by the weak form; nothing if it is not applicable."""
    try:
        fitted = identified_by_weak_form(structure, unknown.without_priors(), record, TimeOptions(method="weak"))
    except InputError:
        return
    yield _free(unknown, fitted.values)


def _free(unknown: Parameters, values: FloatArray) -> FloatArray:
    """Free variables (n_params,) of `values` (n_params,); of the start where these are out of range or undetermined."""
    inside = (values > unknown.transforms.lower) & (values < unknown.transforms.upper)
    return unknown.transforms.free(np.where(inside, values, unknown.start))


def identify_time(
    structure: Structure,
    unknown: Parameters,
    record: TimeRecord,
    options: TimeOptions | None = None,
    work: TaskExecutor = SERIAL,
    progress: StageProgress | None = None,
) -> Estimate:
    """Masses, viscous dampings and stiffnesses from time histories, consistent under noise in every channel.

    ================  =====================================  ===================  ==================================
    `options.method`  sensors                                start of the motion  what it costs
    ================  =====================================  ===================  ==================================
    ``output_error``  any, of any kind                       rest, or unknown     a search; the smallest errors
    ``instrumental``  acceleration, velocity (with damping)  rest, or measured    linear; a simulation an iteration
                      and displacement of every free dof
    ``weak``          one of the three of every free dof     anything             linear; a covariance an iteration
    ================  =====================================  ===================  ==================================

    Parameters
    ----------
    structure : Structure
        At most 200 free degrees of freedom; larger models must be condensed first.
    unknown : Parameters
        Masses, viscous dampings, stiffnesses; no loss factors, no friction. Priors and bounds are used by
        ``output_error`` and refused or left aside by the linear methods.
    record : TimeRecord
        Motion and force channels, with the noise variance of each (independent from sample to sample). A force with
        variance 0 is known; otherwise its errors are estimated with the parameters (``output_error``), weighed
        (``instrumental``, ``weak``), or, for an `Oscillation`, its amplitude is. Channels with variance 0 can only
        serve ``instrumental``, or to start from.
    options : TimeOptions, optional
    work : TaskExecutor
        Where the searches of ``output_error`` run, and whether they and the iterations of ``instrumental`` are kept.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Returns
    -------
    Estimate
        For ``instrumental`` without declared variance the standard deviations come from the residual, and chi-square
        is NaN. Values that the record does not determine have a standard deviation of NaN or above their size, and the
        status ``NOT_IDENTIFIABLE``.

    Raises
    ------
    InputError
        If channels, forces or noise levels are missing, or the model has matrices that no time-domain equation has.

    Notes
    -----
    Between samples the force is a straight line (or constant, or an oscillation), and for such a force the model is
    exact: modal state space and the matrix exponential. Motion faster than half the sampling rate is no obstacle to
    ``output_error`` and ``instrumental``; ``weak`` needs it sampled well.

    Output error with noisy force samples estimates every one of them, at most 1000. Instruments simulated from noisy
    force samples share their noise, which leaves a bias of the order of the squared relative noise of the force; an
    `Oscillation`, whose amplitude many samples fix, has none to speak of.

    Output error goes from few samples to ever more of them. Where the initial values and two random starts end at
    minima that miss the noise, as where modes turn far between two samples, a start follows that asks only for what the
    errors of the initial values leave predictable: up to 20 times 100 simulations of a few samples (or of four for each
    parameter), with no derivative; up to five more of these follow, mostly about the best minimum so far. See
    `structid.inversion.search.posterior_linearization`.

    References
    ----------
    Ljung (1999), System Identification, 2nd ed., chapter 7: output error. Young and Jakeman (1979), Int. J. Control 29:
    refined instrumental variables. Garcia-Fernandez et al. (2015), IEEE Trans. Signal
    Process. 63, 5561-5573: posterior linearization. Bortz, Messenger and Dukic (2023), Bull. Math. Biol. 85, 110:
    the weak form.

    Examples
    --------
    >>> import numpy as np
    >>> from structid import Dashpot, PointMass, Spring, Structure, TimeRecord, Unknown, parameters
    >>> from structid.forward import simulated_time_record
    >>> parts = [PointMass("m", [1], 2.0), Spring("k", "1X", stiffness=50.0), Dashpot("c", "1X", viscous_damping=1.0)]
    >>> oscillator = Structure({1: 0.0}, parts, active=["X"])
    >>> unknowns = [Unknown("mass", "m"), Unknown("stiffness", "k"), Unknown("viscous_damping", "c")]
    >>> unknown = parameters(oscillator, unknowns)
    >>> rng = np.random.default_rng(0)
    >>> values = np.column_stack([np.zeros(200), rng.standard_normal(200)])
    >>> blank = TimeRecord(10.0, values, ("1X", "1X"), ("acceleration", "force"), variance=[1e-4, 0.0])
    >>> record = simulated_time_record(oscillator, unknown, blank, rng=rng)
    >>> found = identify_time(oscillator, unknown.started_at(np.array([3.0, 40.0, 2.0])), record)
    >>> found.status.value, np.abs(found.values - unknown.start).max() < 0.5
    ('converged', np.True_)
    """
    require_class("structure", structure, Structure, "make it by `Structure(nodes, elements, fixed)`")
    require_class("unknown", unknown, Parameters, "make it by `parameters(structure, unknowns)`")
    require_class("record", record, TimeRecord, "make it by `read_record` or `TimeRecord`")
    chosen = options or TimeOptions()
    if chosen.method == "output_error":
        return identified_by_output_error(structure, unknown, record, chosen, work, progress)
    if "support_acceleration" in record.quantities:
        raise InputError(f"method {chosen.method!r} takes no motion of supports; take 'output_error'")
    if chosen.method == "instrumental":
        return identified_by_instruments(structure, unknown, record, chosen, work)
    return identified_by_weak_form(structure, unknown, record, chosen)

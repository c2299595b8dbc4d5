"""A search whose model comes from a solver: led near, confirmed by runs, and moved about its answer.

Differences of a solver's modes are taken anew about each answer until it stays. A solver computes FRFs on the axis alone,
where each resonance is a minimum of its own. Averages of their logarithm with the kernel of the Poisson integral, as wide as a
part of the frequency, follow stiffness smoothly over that part, also where lines are too coarse for the resonances; for an FRF
without zeros on the right they are log|H| at s = omega (a + i). The same averages of what was measured stand beside them, so
that what the band cuts off is cut off on both sides. From wide to narrow, they are fitted about each answer, with differences
as wide as they are, and each move is one that the solver itself confirms.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.errors import InputError, NoAnswerError, SingularModelError
from structid.core.json_types import Tables
from structid.external.frf_model import SolvedFrfs
from structid.external.runs import RunFailedError, point_words
from structid.external.solved import SolvedModel, SolverCheck
from structid.fem import Structure
from structid.fem.elements.matrix_group import FrfRuns, SolverFrfs
from structid.forward import FrfProblem, RecordProblem
from structid.forward.frf.continuation import level_frequencies, start_deviation
from structid.identification.identified import Identification
from structid.identification.identify import identify_together
from structid.identification.joint_problem import indices_of, joint_problem
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import RecordFit
from structid.inversion import LevenbergMarquardt
from structid.inversion.search.least_squares import minimize, residual_at, squared
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.records import FrfRecord
from structid.records.half_plane import poisson_weights
from structid.records.record import DERIVATIVES
from structid.study.results.result import SolverAnswer, StudyResult
from structid.study.run.start import PreparedStudy, prepare_study, study_problems
from structid.study.run.workers import threads_for
from structid.study.schema.study import Study, edited_study
from structid.unknowns.named_unknowns import begun_at

MOST_ROUNDS = 12
#: The answer stays where it moves by less than this part of its standard deviation, or of its value.
_OF_STD, _OF_VALUE = 1e-2, 1e-6
#: Such parts that are worth a word where the solver confirms no further move.
_OPEN = 50.0


#: Most that a parameter moves in a round, as a part of its value.
_FARTHEST = 0.5
#: Widths of the averages, in parts of the frequency.
LEVELS = (0.35, 0.14, 0.06, 0.025)
#: Steps of differences meanwhile, rounds at one level, and part of it by which a parameter may still move where the next follows.
_STEP_OF_LEVEL, _ROUNDS_OF_LEVEL, _SETTLED = 0.25, 6, 0.5
#: The model is near where the logarithms of computed over measured magnitudes are below this at so many of the lines
#: whose noise is below a part of them.
_NEAR, _OF_LINES, _CLEAR = 0.7, 0.98, 0.3
_START_ERROR, _LINE_ERROR = 0.5, 0.1
#: Lines of an average, and its width in spacings of the measured ones.
_USABLE_LINES, _WIDE = 8, 3.0
_HALVINGS, _TINY = 4, 1e-12


def relinearize_solver(
    ready: PreparedStudy, progress: StageProgress | None = None, work: TaskExecutor = SERIAL
) -> PreparedStudy:
    """The study with the finite differences of its solver taken about the answer, found in at most 12 rounds.

    A round is a search, and runs of the solver at its answer. The study is unchanged without a solver or with exact
    matrices. Rounds end where no deck parameter moves by more than 1 % of its standard deviation or 1e-6 of its
    value; a warning is added if the last one still does. For a solver of FRFs without regularization, a move must
    also lower the sum of squares with the solver's own FRFs; where it does not, the rounds end, with a warning if
    the move is large.

    Raises
    ------
    InputError
        If a run of the solver fails.
    NoAnswerError
        If a search fails.
    """
    solved = ready.study.solved
    if solved is None or solved.is_exact:
        return ready
    quick = replace(ready.study.options, intervals="laplace", restarts=0, uniqueness_starts=0)
    is_led = isinstance(solved, SolvedFrfs) and not ready.study.options.regularization
    if isinstance(solved, SolvedFrfs):
        ready = led_near(ready, work)
    worst = _Move(0.0, "", "")
    for _ in range(MOST_ROUNDS):
        identification = _identify(ready, quick, progress, work)
        solved = ready.study.solved
        assert solved is not None
        values, std = found_values(solved, identification), deck_std(solved, identification)
        goal = {name: limit_to_bounds(solved, name, value) for name, value in values.items()}
        worst = max(_move(name, at, goal[name], std[name]) for name, at in solved.at.items())
        if worst.limits <= 1.0:
            return ready
        values_by_name = dict(zip(identification.estimate.names, identification.estimate.values.tolist(), strict=True))
        if is_led:
            estimate = identification.estimate
            end = estimate.theta[indices_of(estimate.names, joint_problem(ready.problems).names)]
            moved = confirm_move(ready, list, end, work)
            if moved is None:
                return (
                    ready if worst.limits <= _OPEN else replace(ready, warnings=(*ready.warnings, _open_words(worst)))
                )
            ready = moved[1]
            continue
        ready = prepare_study(relinearize_study(ready.study, goal, values_by_name, work))
    words = (
        f"{worst.name} still moves {worst.words} after {MOST_ROUNDS} rounds of differences of the solver; give larger `step`,"
        " priors or bounds"
    )
    return replace(ready, warnings=(*ready.warnings, words))


class _Move(NamedTuple):
    """Move of a deck parameter in a round: its size over what counts as none, the parameter, and how far it moves."""

    limits: float
    name: str
    words: str


def _move(name: str, at: float, goal: float, std: float) -> _Move:
    """Move of the deck parameter `name` with the standard deviation `std` from `at` to `goal`.

    It is told in standard deviations, or by both values where the value sets what counts as none.
    """
    change, by_std, by_value = abs(goal - at), _OF_STD * std, _OF_VALUE * abs(at)
    words = f"by {change / std:.2g} standard deviations" if by_std > by_value else f"from {at:.9g} to {goal:.9g}"
    return _Move(change / max(by_std, by_value, np.finfo(float).tiny), name, words)


def _open_words(worst: _Move) -> str:
    return (
        f"the differences of the solver move {worst.name} {worst.words}, where its own FRFs fit no better: they are not smooth,"
        " or printed with few digits; write more digits, or give larger `step`"
    )


def _identify(
    ready: PreparedStudy, options: IdentifyOptions, progress: StageProgress | None, work: TaskExecutor
) -> Identification:
    """Identification with the finite differences that the study has now; `NoAnswerError` if the search fails."""
    try:
        with threads_for(ready.problems):
            return identify_together(ready.setups, options, progress, work)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        solved = ready.study.solved
        at = "" if solved is None else point_words(solved.at)
        raise NoAnswerError(
            f"{ready.study.path}: the search with differences of the solver about {at} failed: {error}; begin closer to the"
            " truth, or give bounds or priors"
        ) from error


def with_nominal_start(result: StudyResult) -> StudyResult:
    """The result with the initial values that the study states, where the last search started at an earlier answer.

    For a solver of FRFs the initial responses are replaced too. It is unchanged without a solver or with exact
    matrices.
    """
    study, answer = result.study, result.identification
    if study.solved is None or study.solved.is_exact:
        return result
    first = edited_study(
        study, tables(study, {parameter.name: None for parameter in study.solved.solver.deck.parameters})
    )
    values_by_name: dict[str, float] = {}
    for source in first.setups:
        values_by_name |= dict(zip(source.parameters.names, source.parameters.start.tolist(), strict=True))
    pairs = zip(answer.estimate.names, answer.estimate.initial.tolist(), strict=True)
    initial = np.array([values_by_name.get(name, value) for name, value in pairs])
    fits = answer.fits
    if isinstance(study.solved, SolvedFrfs):  # about the answer, its model says nothing of where the search began
        fits = tuple(
            _with_initial_responses(fit, before) for fit, before in zip(fits, study_problems(first), strict=True)
        )
    return replace(
        result,
        identification=replace(answer, estimate=answer.estimate.with_initial(initial), fits=fits),
    )


def _with_initial_responses(fit: RecordFit, before: RecordProblem) -> RecordFit:
    """The fit with its initial responses replaced by those of `before`, the problem at the study's initial values."""
    assert isinstance(before, FrfProblem)
    start = before.physical(before.theta_start)
    used, judged = (
        replace(lines, initial=before.predicted_on(lines.record, start)) for lines in (fit.used, fit.judged)
    )
    return replace(fit, used=used, judged=judged)


def found_values(solved: SolvedModel, identification: Identification) -> dict[str, float]:
    """Value of each parameter of the deck at the answer, by name, from the problem of the first record."""
    return deck_values(
        solved, identification.problems[0], identification.estimate.names, identification.estimate.values
    )


def with_solver(result: StudyResult, work: TaskExecutor = SERIAL) -> StudyResult:
    """The result with the updated deck of its solver, and the outcome of one more run of the solver with that deck.

    It is unchanged without a solver; a run that fails is reported in words.
    """
    solved, identification = result.study.solved, result.identification
    if solved is None:
        return result
    values = solved.solver.deck.shown(found_values(solved, identification))
    try:
        checked = solved.checked(values, work)
    except InputError as error:
        checked = SolverCheck(float("nan"), f"the solver could not be run with the updated deck: {error}")
    answer = SolverAnswer(
        values,
        solved.solver.deck.written(values),
        solved.solver.linked,
        solved.solver.command,
        solved.counts.made,
        solved.counts.kept,
        solved.facts,
        checked.words,
        checked.difference,
    )
    return replace(result, solver=answer)


def deck_values(
    solved: SolvedModel, problem: RecordProblem, names: Sequence[str], values: FloatArray
) -> dict[str, float]:
    """Value of each parameter of the deck, by name, for `values` (n_params,) of the identified parameters `names`."""
    made = _property_values(problem, names, values)
    return {
        item.term.property: float(made[item.values][0])
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }


def deck_std(solved: SolvedModel, identification: Identification) -> dict[str, float]:
    """Standard deviation of each parameter of the deck, by name; unknown covariances count as 0.

    A deck's parameter is d'p + constant in the sought parameters p, so that its variance is d' C d with their covariance C.
    """
    problem, estimate = identification.problems[0], identification.estimate
    order = [estimate.names.index(name) for name in problem.parameters.names]
    std = estimate.std[order]
    covariance = estimate.covariance[np.ix_(order, order)] if estimate.uncertainty.has_matrix else np.diag(std**2)
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    rows = np.arange(len(problem.parameters.offset))
    weights = {
        item.term.property: problem.parameters.design[[rows[item.values][0]]].toarray()[0]
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }
    return {name: float(np.sqrt(max(weight @ covariance @ weight, 0.0))) for name, weight in weights.items()}


def _property_values(problem: RecordProblem, names: Sequence[str], values: FloatArray) -> FloatArray:
    value_of = dict(zip(names, values.tolist(), strict=True))
    return problem.parameters.values(np.array([value_of[name] for name in problem.parameters.names]))


def limit_to_bounds(solved: SolvedModel, name: str, value: float) -> float:
    """`value` of the deck parameter `name`, limited to its bounds and to a change by half of its present value.

    The present value is that in `solved`, about which differences were taken; if it is 0, only the bounds limit.
    """
    present = solved.at[name]
    low, high = next(parameter.limits for parameter in solved.solver.deck.parameters if parameter.name == name)
    far = _FARTHEST * abs(present) or np.inf
    return float(np.clip(value, max(low, present - far), min(high, present + far)))


def tables(study: Study, values: Mapping[str, float | None], step: float | None = None) -> Tables:
    """A copy of the study's tables, in which finite differences are taken about the deck parameters `values`.

    `values` are by name; None stands for the nominal value. `step` is the step of the differences relative to each
    value, by default and at nominal values that of the study file.
    """
    edited: Tables = deepcopy(dict(study.root.table))
    stated = tomllib.loads(study.text)["structure"]["solver"]["parameter"]
    own_steps = {entry["name"]: entry["step"] for entry in stated if "step" in entry}
    for entry in edited["structure"]["solver"]["parameter"]:
        name = entry["name"]
        changes = {"at": values[name], "step": step if step is not None and values[name] else own_steps.get(name)}
        for key, value in changes.items():
            entry.pop(key, None)
            if value is not None:
                entry[key] = value
    return edited


def relinearize_study(
    study: Study,
    values: Mapping[str, float],
    identified: Mapping[str, float],
    work: TaskExecutor,
    step: float | None = None,
) -> Study:
    """The study with finite differences about the deck parameters `values`, and searches that start at `identified`.

    Both are values by parameter name. `step` is the step of the differences relative to each value; None for that of the file.
    """
    edited = edited_study(study, tables(study, values, step), work)
    pairs = zip(study.setups, edited.setups, strict=True)
    setups = (replace(after, parameters=begun_at(before.parameters, identified)) for before, after in pairs)
    return replace(edited, setups=tuple(setups))


def led_near(ready: PreparedStudy, work: TaskExecutor) -> PreparedStudy:
    """The prepared study with start values from which a search on the FRFs converges.

    It is unchanged if 98 % of the clear FRF values agree with the model to a factor of 2 already. Searches on smoothed
    FRFs, from wide to narrow smoothing and up to six at each level, lead there. If none leads near, the last start
    values are kept. `work` runs the solver.
    """
    if _is_near(ready.problems):
        return ready
    for level in (*LEVELS, 0.0):
        step = _STEP_OF_LEVEL * level or None
        if not _smoothed_problems(ready.problems, level):
            continue
        ready = prepare_study(_with_step(ready, step, work))
        for _ in range(_ROUNDS_OF_LEVEL):
            problem = joint_problem(_smoothed_problems(ready.problems, level))
            end = minimize(problem, LevenbergMarquardt()).theta
            moved = confirm_move(ready, partial(_smoothed_problems, level=level), end, work, step)
            if moved is None:
                break
            theta, ready = moved
            if _is_near(ready.problems):
                return prepare_study(_with_step(ready, None, work))
            if float(np.abs(theta - problem.theta_start).max()) < _SETTLED * level:
                break
    return ready


def _with_step(ready: PreparedStudy, step: float | None, work: TaskExecutor) -> Study:
    """The study with its finite differences taken again about the same deck parameters, with another relative `step`.

    Its searches start at the present start values. None takes the step of the study file.
    """
    solved = ready.study.solved
    assert solved is not None
    problem = ready.problems[0]
    values_by_name = dict(zip(problem.names, problem.physical(problem.theta_start).tolist(), strict=True))
    return relinearize_study(ready.study, solved.at, values_by_name, work, step)


def confirm_move(
    ready: PreparedStudy,
    form: Callable[[Sequence[RecordProblem]], Sequence[RecordProblem]],
    end: FloatArray,
    work: TaskExecutor,
    step: float | None = None,
) -> tuple[FloatArray, PreparedStudy] | None:
    """The free variables after a move towards `end` that the solver confirms, (n_params,), and the study there.

    The move is halved until the sum of squares with the solver's FRFs falls; None if it does not in four attempts.

    Parameters
    ----------
    ready : PreparedStudy
        The study at its present values.
    form : callable
        Makes, from the FRF problems of all records, the problems whose sum of squares is to fall.
    end : (n_params,) float array
        Free variables that the model linearized at the present values proposes.
    work : TaskExecutor
        The way in which the solver is run: in this process or on workers.
    step : float, optional
        Step of the finite differences at the new values, relative to each value.

    Raises
    ------
    InputError
        If the last run of the solver that was tried fails.
    """
    solved = ready.study.solved
    assert isinstance(solved, SolvedFrfs)
    here = joint_problem(form(ready.problems))
    failed: RunFailedError | None = None
    begin, cost = here.theta_start, squared(residual_at(here, here.theta_start))
    for _ in range(_HALVINGS):
        values = here.physical(end)
        goal = deck_values(solved, ready.problems[0], here.names, values)
        goal = solved.solver.deck.shown({name: limit_to_bounds(solved, name, value) for name, value in goal.items()})
        try:
            run = solved.run_at(goal, work)
        except RunFailedError as error:  # a solver may have no answer there, and one nearer
            failed, end = error, (begin + end) / 2
            continue
        there = joint_problem(form([_with_runs(problem, run) for problem in ready.problems]))
        if squared(residual_at(there, end)) < cost:
            values_by_name = dict(zip(here.names, values.tolist(), strict=True))
            return end, prepare_study(relinearize_study(ready.study, goal, values_by_name, work, step))
        failed, end = None, (begin + end) / 2
    if failed is not None:
        raise failed
    return None


def _is_near(problems: Sequence[RecordProblem]) -> bool:
    """True if the initial model is close enough to the measured FRFs for a search on the FRFs themselves.

    At 98 % of the values of each record whose noise is below 30 % of them, the magnitudes must agree to a factor of 2
    (0.7 in the natural logarithm).
    """
    for problem in problems:
        assert isinstance(problem, FrfProblem)
        record = problem.record
        size = np.abs(record.values)
        clear = size > 0
        if record.variance is not None:
            clear &= record.variance < (_CLEAR * size) ** 2
        ratio = np.abs(problem.predicted(problem.theta_start)[clear]) / size[clear]
        if ratio.size and np.quantile(np.abs(np.log(np.maximum(ratio, _TINY))), _OF_LINES) > _NEAR:
            return False
    return True


def _smoothed_problems(problems: Sequence[RecordProblem], level: float) -> list[RecordProblem]:
    """The problems of smoothed FRFs at one level (width relative to frequency), with priors near their start values.

    An empty list if the lines of a record are too coarse for the level. Level 0 takes the FRFs themselves, with a residual that
    is bounded near resonances.
    """
    problems_made: list[RecordProblem] = []
    for problem in problems:
        assert isinstance(problem, FrfProblem)
        if not level:
            own_form = replace(problem, form="pole_free", model_error=_LINE_ERROR)
            problems_made.append(
                own_form.with_free_prior(own_form.theta_start, start_deviation(own_form.unknowns, _START_ERROR))
            )
            continue
        record = problem.record.lines(np.flatnonzero(problem.record.frequency > 0))
        omega_level, weights = _level_weights(record.omega, level)
        if len(omega_level) < _USABLE_LINES:
            return []
        smooth = partial(_smooth_magnitudes, weights)
        runs = _runs(problem)
        lines = runs.lines(record.frequency)
        smooth_record = FrfRecord(
            omega_level / (2 * np.pi), smooth(record.values), record.outputs, record.inputs, "receptance"
        )
        power = np.abs(record.laplace) ** DERIVATIVES[record.kind]
        mapped = runs.mapped(smooth_record.frequency, partial(_smoothed_lines, weights, lines, power))
        made = _with_runs(replace(problem, record=smooth_record, form="log", model_error=_LINE_ERROR), mapped)
        problems_made.append(made.with_free_prior(made.theta_start, start_deviation(made.unknowns, _START_ERROR)))
    return problems_made


def _level_weights(omega: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Angular frequencies (n,), rad/s, that a smoothing level can use, and weights of the lines for each, (n, n_lines).

    Used are frequencies at which the smoothing decay exceeds three line spacings. Each row of weights has the sum 1.
    `omega` (n_lines,) are those of the lines, rad/s, and `level` is the smoothing decay over omega.
    """
    centres = level_frequencies(omega, level)
    centres = centres[level * centres > _WIDE * np.interp(centres, omega, np.gradient(omega))]
    forward, backward = poisson_weights(omega, centres * (level + 1j))
    weights = forward + backward
    return centres, weights / weights.sum(axis=1, keepdims=True)


def _smooth_magnitudes(weights: FloatArray, values: ComplexArray) -> ComplexArray:
    """Weighted geometric means of the magnitudes of `values` (n_lines, ...), with `weights` (n, n_lines); (n, ...)."""
    size = np.abs(values)
    log = np.log(np.maximum(size, _TINY * size.max(axis=0) + np.finfo(float).tiny)).reshape(len(size), -1)
    return np.exp(weights @ log).reshape(-1, *values.shape[1:]).astype(np.complex128)


def _smoothed_lines(weights: FloatArray, lines: IntArray, power: FloatArray, values: ComplexArray) -> ComplexArray:
    """Smoothed magnitudes (n, n_outputs, n_inputs) of a solver's FRFs at some of its lines, as receptances.

    `values` (n_solver_lines, n_outputs, n_inputs) are at all lines of the solver, `lines` (n_lines,) the indices of
    those that are used, `power` (n_lines,) the factor on each, and `weights` (n, n_lines) are those of the smoothing.
    """
    return _smooth_magnitudes(weights, values[lines] * power[:, None, None])


def _runs(problem: RecordProblem) -> FrfRuns:
    [element] = problem.structure.elements
    assert isinstance(element, SolverFrfs)
    return element.table


def _with_runs(problem: RecordProblem, runs: FrfRuns) -> FrfProblem:
    """The FRF problem with its solver's responses replaced by those of `runs`."""
    structure = problem.structure
    [element] = structure.elements
    assert isinstance(element, SolverFrfs)
    assert isinstance(problem, FrfProblem)
    return replace(
        problem, structure=Structure(structure.nodes, [replace(element, table=runs)], active=structure.active)
    )

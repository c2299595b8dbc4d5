"""A study moved to other values of its deck, and a solver's FRFs fitted from a poor start: smooth forms first, then the FRFs.

A solver computes FRFs on the axis alone, where each resonance is a minimum of its own. Averages of their logarithm with
the kernel of the Poisson integral, as wide as a part of the frequency, follow stiffness smoothly over that part, also
where lines are too coarse for the resonances; for an FRF without zeros on the right they are log|H| at s = omega (a + i).
The same averages of what was measured stand beside them, so that what the band cuts off is cut off on both sides. From
wide to narrow, they are fitted about each answer, with differences as wide as they are, and each move is one that the
solver itself confirms.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.json_types import Tables
from structid.external.frf_model import SolvedFrfs
from structid.external.runs import RunFailedError
from structid.external.solved import SolvedModel
from structid.fem import Structure
from structid.fem.elements.solver_model import FrfRuns, SolverFrfs
from structid.forward import FrfProblem, RecordProblem
from structid.forward.frf.continuation import level_frequencies, start_deviation
from structid.identification.identified import Identification
from structid.identification.joint_problem import joint_problem
from structid.inversion import LevenbergMarquardt
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.minimum import residual_at, squared
from structid.inversion.search.work import TaskExecutor
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.records.transforms.half_plane import poisson_weights
from structid.study.run.start import PreparedStudy, prepare_study
from structid.study.schema.study import Study, edited_study
from structid.unknowns.named_unknowns import begun_at

#: Most that a parameter moves in a round, as a part of its value.
_FARTHEST = 0.5


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
    """The value `value` of the deck parameter `name`, limited to its bounds and to a change by half of its present value.

    The present value is that in `solved`, about which differences were taken; they say little of what is farther away.
    """
    at = solved.at[name]
    low, high = next(parameter.limits for parameter in solved.solver.deck.parameters if parameter.name == name)
    far = _FARTHEST * abs(at) or np.inf
    return float(np.clip(value, max(low, at - far), min(high, at + far)))


def tables(study: Study, values: Mapping[str, float | None], step: float | None = None) -> Tables:
    """A copy of the study's tables, with the deck parameters set to `values` for finite differences; None for a nominal value.

    `step` is the step of the differences relative to each value; by default that of the study file.
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


def led_near(ready: PreparedStudy, work: TaskExecutor) -> PreparedStudy:
    """The study with start values from which a search on the FRFs themselves converges; unchanged if they are near already.

    Searches on smoothed FRFs, from wide to narrow smoothing, lead there. If none leads near, the last start values are kept.
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
    """The study evaluated again about its present start values, with another relative `step` of the finite differences.

    None takes the step of the study file.
    """
    solved = ready.study.solved
    assert solved is not None
    problem = ready.problems[0]
    known = dict(zip(problem.names, problem.physical(problem.theta_start).tolist(), strict=True))
    return relinearize_study(ready.study, solved.at, known, work, step)


def confirm_move(
    ready: PreparedStudy,
    form: Callable[[Sequence[RecordProblem]], Sequence[RecordProblem]],
    end: FloatArray,
    work: TaskExecutor,
    step: float | None = None,
) -> tuple[FloatArray, PreparedStudy] | None:
    """The free variables after a move towards `end` that the solver confirms, (n_params,), and the study prepared there.

    The move is halved until the sum of squares with the solver's FRFs falls; None if it does not within a few halvings.

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
            known = dict(zip(here.names, values.tolist(), strict=True))
            return end, prepare_study(relinearize_study(ready.study, goal, known, work, step))
        failed, end = None, (begin + end) / 2
    if failed is not None:
        raise failed
    return None


def _is_near(problems: Sequence[RecordProblem]) -> bool:
    """True if the initial model is close enough to the measured FRFs for a search on the FRFs themselves.

    At 98 % of the values above the noise, the magnitudes must agree to a factor of 2 (0.7 in the natural logarithm).
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
    """Angular frequencies (n,), rad/s, that a smoothing level can use, and the weights of the lines for each, (n, n_lines).

    Only frequencies at which the smoothing is wide against the line spacing are used. Each row of weights has the sum
    1. `omega` (n_lines,) are those of the lines, rad/s, and `level` is the smoothing decay over omega.
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
    """Smoothed receptances of a solver at some of its lines, in the kind of a record."""
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

"""The search over the problems of one or several records, with the polarities that no continuous search can decide."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from structid import inversion
from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.forward.record_problem import decide_polarities, polarities, with_polarities
from structid.identification.joint_problem import (
    fixed_values,
    freed_problems,
    indices_of,
    joint_obstacle,
    joint_paths,
    joint_problem,
    joint_sample,
    joint_schedules,
)
from structid.identification.options import IdentifyOptions
from structid.identification.regularizing import AppliedRegularization, regularized, takes_matrix_free
from structid.identification.setups.setup import AnySetup
from structid.identification.varying import Varied, varied, widened_estimate
from structid.inversion import Estimate, Method, Problem, Search, Status
from structid.inversion.estimate import estimate
from structid.inversion.search.least_squares import dense_search_fits
from structid.inversion.search.work import StageProgress, TaskExecutor

_MOST_TRIED = 3
#: More searches where an answer is doubted; of modes, one that moved a parameter by more than this factor. Of a frame with
#: two minima half of the starts 20 % off end in each: four miss one of them in one case of 16.
_DOUBT_STARTS, _DOUBT_BEYOND = 4, 2.0
#: Wide starts at most, degrees of freedom up to which so many are made (their number falls with the cube beyond), fewest that say
#: anything, and values for each parameter below which they are made though shapes are known.
_MOST_WIDE, _SMALL, _FEWEST_WIDE, _FEW_VALUES = 200, 60, 8, 2
#: How often weights are taken of the fitted model at most, up to which misfit, and the change in standard deviations that ends it.
_REWEIGHTED, _REWEIGHTED_BELOW, _SETTLED = 3, 4.0, 0.02
#: Of the last stage of a matrix-free search.
_GAIN_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """Result of the search over the problems of all records.

    Attributes
    ----------
    estimate : Estimate
    problems : tuple of RecordProblem
        Of each record, with the polarities that were found.
    target : Problem or None
        The problem that was solved, if one of many rows.
    regularizations : tuple of AppliedRegularization
        The regularizations as they were used.
    varied : tuple of Varied
        What differs from record to record.
    without_priors : Estimate or None
        From the data alone, where these are too few to test what priors choose.
    """

    estimate: Estimate
    problems: tuple[RecordProblem, ...]
    target: Problem | None
    regularizations: tuple[AppliedRegularization, ...]
    varied: tuple[Varied, ...] = ()
    without_priors: Estimate | None = None


def search_parameters(
    setups: Sequence[AnySetup],
    problems: tuple[RecordProblem, ...],
    options: IdentifyOptions,
    progress: StageProgress | None,
    work: TaskExecutor,
    near: Mapping[str, float] | None = None,
) -> SearchOutcome:
    """Best estimate over the problems of all records, by the method that set-ups and options ask for.

    Regularizations, polarities of channels and weights are settled on the way. A set-up with an estimator of its own
    uses that. `progress` is called with the name of the stage, its iteration and the sum of squares. `near` are free
    variables of a nearby answer by name, from which the first search begins if it has all of them. The problems that
    come with the estimate are those that it fits.

    Raises
    ------
    InputError
        If their ways of fitting do not go together, or the study has what the search cannot do.
    """
    alone = next((setup for setup in setups if setup.own_estimator), None)
    if alone is not None:
        _require_single_record(alone, setups, options)
        return SearchOutcome(alone.estimated(options, progress, work), problems, None, ())
    method = chosen_method(problems, options)
    regular = regularized(problems, options, method, progress, work)
    is_local = not all(problem.structure.has_matrices for problem in problems)  # FRFs alone hold about the start only
    wide = wide_starts(problems) if options.wide_starts is None else options.wide_starts
    if method.is_matrix_free or is_local:
        search = Search(seed=options.seed, start=regular.theta if method.is_matrix_free else None)
    else:
        search = _search_starts(problems, regular.problems, options, wide)
    if near is not None:
        names = joint_problem(regular.problems).names
        if set(names) <= near.keys():
            search = replace(search, near=np.array([near[name] for name in names]))
    is_staged = options.pole_free_start and regular.theta is None and not is_local
    trials = PolarityTrials.begun(regular.problems, {} if near is None else near)
    while trials.pending:
        current = trials.pending[0]
        paths = joint_schedules(current)[:1] if method.is_matrix_free else joint_paths(current)
        fit = estimate(
            joint_problem(current),
            method,
            paths if is_staged else (),
            search,
            progress=progress,
            sample=joint_sample(current),
            work=work,
            fixed=fixed_values(freed_problems(setups, current, options.tolerances)),
        )
        trials.add(fit)

    def search_near(current: tuple[RecordProblem, ...], theta: FloatArray) -> Estimate:
        """Estimate of the joint problem of `current`, searched from `theta` (n_params,) alone."""
        near = Search(seed=options.seed, start=theta)
        fixed = fixed_values(freed_problems(setups, current, options.tolerances))
        return estimate(joint_problem(current), method, (), near, progress=progress, work=work, fixed=fixed)

    best, problems = reweighted(*trials.best, search_near)
    differing = varied(problems, best, regular.scatters)
    best = widened_estimate(best, tuple(regular.scatters.values()))
    is_chosen = wide and best.goodness.test_freedom < 1 and not options.regularization and not regular.scatters
    unforced = _without_priors(problems, best, method, search, work) if is_chosen else None
    return SearchOutcome(best, problems, joint_problem(problems), regular.regularizations, differing, unforced)


def _require_single_record(alone: AnySetup, setups: Sequence[AnySetup], options: IdentifyOptions) -> None:
    """Raise `InputError` if `alone`, which has its own estimator, is not the only set-up, or cannot take `options`."""
    if len(setups) > 1 or options.regularization or options.intervals != "laplace" or options.band or options.exclude:
        raise InputError(
            f"{alone.own_estimator} takes one record, all of it, without regularization and with Laplace intervals;"
            " use fit 'spectra' for more"
        )


def _search_starts(
    problems: Sequence[RecordProblem],
    regular_problems: Sequence[RecordProblem],
    options: IdentifyOptions,
    wide: int,
) -> Search:
    """Numbers and starts of the searches with a Jacobian; `wide` is the number of wide starts, 0 for none.

    `regular_problems` are the regularized `problems`; wide starts are searched with these where all data are modes.
    """
    is_modal = all(np.isnan(problem.facts.line_spacing).all() for problem in problems)  # a wrong minimum may fit modes
    return Search(
        options.restarts,
        options.uniqueness_starts,
        options.seed,
        doubt_starts=_DOUBT_STARTS if not wide else 0,
        doubt_beyond=_DOUBT_BEYOND if is_modal else np.inf,
        wide_starts=wide,
        wide_problem=partial(_keeping_order, regular_problems) if is_modal else None,
    )


def _without_priors(
    problems: Sequence[RecordProblem], best: Estimate, method: Method, search: Search, work: TaskExecutor
) -> Estimate | None:
    """Estimate from the data alone, searched from wide starts about `best`, with fixed values exact.

    None if no parameter of `problems` has a prior. `search` has the numbers of starts and the seed, `method` minimizes.
    """
    if not any(problem.parameters.has_priors for problem in problems):
        return None
    bare = tuple(problem.with_parameters(problem.parameters.without_priors()) for problem in problems)
    wide = replace(search, start=best.theta, wide_problem=partial(_keeping_order, bare))
    return estimate(joint_problem(bare), method, (), wide, work=work)


def wide_starts(problems: Sequence[RecordProblem]) -> int:
    """Default number of wide starts: up to 200 for few modal data of small models, else 0.

    Few are modes without a known shape entry, or with fewer values than twice the parameters. The number falls with the
    cube of the size above 60 degrees of freedom, and with the number of records; below 8 it is 0. It is 0 too unless
    all problems compare modes by output.
    """
    modal = [problem for problem in problems if compares_modes(problem)]
    if len(modal) < len(problems) or any(problem.settings.form != "output" for problem in modal):
        return 0
    n_values = sum(problem.n_data - problem.linearize(problem.theta_start).n_eliminated for problem in modal)
    n_parameters = len({name for problem in modal for name in problem.names})
    if any(problem.data.has_shapes for problem in modal) and n_values >= _FEW_VALUES * n_parameters:
        return 0
    size = max(problem.structure.n_dofs for problem in modal) / _SMALL
    count = int(_MOST_WIDE / max(size, 1.0) ** 3 / len(modal))
    return count if count >= _FEWEST_WIDE else 0


def _keeping_order(problems: Sequence[RecordProblem], theta: FloatArray) -> Problem:
    """Joint problem in which modes without shapes stay paired in order, if they are so at `theta` (n_params,)."""
    names = joint_problem(problems).names
    return joint_problem(
        [
            problem.keeping_order(theta[indices_of(names, problem.names)]) if compares_modes(problem) else problem
            for problem in problems
        ]
    )


def chosen_method(problems: Sequence[RecordProblem], options: IdentifyOptions) -> Method:
    """Search method: matrix-free if asked for or if a dense Jacobian would be too large, else that of the options.

    What rules out a matrix-free search, or ``matrix_free = False``, keeps the dense one, which takes its form for
    reduced problems if one of `problems` is reduced.

    Raises
    ------
    InputError
        If it is asked for and the study has what such a search cannot do.
    """
    dense = options.method
    if any(problem.is_reduced for problem in problems):
        dense = dense.for_reduced()
    if options.matrix_free is False:
        return dense
    obstacle = matrix_free_obstacle(problems, options)
    if obstacle and options.matrix_free:
        raise InputError(f"search 'matrix_free' {obstacle}; leave it out, or choose 'levenberg_marquardt'")
    whole = joint_problem(problems)
    if not options.matrix_free and (obstacle or dense_search_fits(len(whole.names), whole.n_data)[0]):
        return dense
    return inversion.MatrixFree(max_iterations=options.method.max_iterations, gain_tolerance=_GAIN_TOLERANCE)


def matrix_free_obstacle(problems: Sequence[RecordProblem], options: IdentifyOptions) -> str:
    """Reason why these problems and options rule out a matrix-free search; "" if they allow it.

    It goes on a sentence that begins with the search, as in "search 'matrix_free' takes no dry friction".
    """
    obstacle = joint_obstacle(problems)
    if not obstacle and options.intervals != "laplace":
        return f"takes intervals 'laplace', got {options.intervals!r}"
    return obstacle or takes_matrix_free(options.regularization)


@dataclass(eq=False)
class PolarityTrials:
    """The fits with other polarities of channels, and the polarities that are still to be tried.

    Polarities begin as the initial model asks for and are decided again by the fitted model. Where every fit then misses the
    noise, every other choice of up to three polarities is tried too.

    Attributes
    ----------
    pending : list of tuple of RecordProblem
        Copies of the problems with polarities to try, the next one first.
    fits : dict
        The fit with each choice of polarities and its problems.
    """

    pending: list[tuple[RecordProblem, ...]]
    fits: dict[tuple[float, ...], tuple[Estimate, tuple[RecordProblem, ...]]] = field(default_factory=dict)

    @classmethod
    def begun(cls, problems: Sequence[RecordProblem], near: Mapping[str, float]) -> PolarityTrials:
        """Trials that begin with the polarities of the initial model, or of that with the free variables `near`, by name."""
        starts = [
            np.array(
                [near.get(name, initial) for name, initial in zip(problem.names, problem.theta_start, strict=True)]
            )
            for problem in problems
        ]
        return cls([tuple(map(decide_polarities, problems, starts))])

    def add(self, fit: Estimate) -> None:
        """Add the fit of the first pending problems, remove these, and append further polarities to be tried, if any.

        When none is pending, the fit's own choice of polarities is tried if it is new. If it is not, no fit reaches the
        noise and there are at most three polarities, all combinations are tried.
        """
        problems = self.pending.pop(0)
        self.fits[_polarities(problems)] = (fit, problems)
        if self.pending:
            return
        decided = tuple(decide_polarities(p, fit.theta[indices_of(fit.names, p.names)]) for p in problems)
        if (signs := _polarities(decided)) not in self.fits:
            self.pending.append(decided)
        elif len(signs) <= _MOST_TRIED and all(one.covariance_basis == "model_error" for one, _ in self.fits.values()):
            choices = product((1.0, -1.0), repeat=len(signs))
            self.pending += [_with_polarities(decided, choice) for choice in choices if choice not in self.fits]

    @property
    def best(self) -> tuple[Estimate, tuple[RecordProblem, ...]]:
        """Fit with the smallest chi-square and its problems; fits that converged come first."""
        return min(
            self.fits.values(), key=lambda pair: (pair[0].status is Status.NOT_CONVERGED, pair[0].goodness.chi_square)
        )


def reweighted(
    best: Estimate,
    problems: tuple[RecordProblem, ...],
    search: Callable[[tuple[RecordProblem, ...], FloatArray], Estimate],
) -> tuple[Estimate, tuple[RecordProblem, ...]]:
    """Fit and problems after repeated fits with errors in proportion to predicted instead of measured values.

    `best` is the fit of `problems` before. At most three repetitions, until nothing moves by more than 0.02 standard
    deviations; none if the misfit is 4 or more, or the errors of no problem depend on values. `search` repeats the fit
    of problems from free variables (n_params,). Strengths of regularizations stay.
    """
    for _ in range(_REWEIGHTED):
        if not best.goodness.misfit < _REWEIGHTED_BELOW:
            break
        current = tuple(p.reweighted(best.theta[indices_of(best.names, p.names)]) for p in problems)
        if all(problem is other for problem, other in zip(current, problems, strict=True)):
            break
        again = search(current, best.theta)
        moved = np.abs(again.theta - best.theta)
        best, problems = _as_searched(again, best), current
        if (moved <= _SETTLED * best.std_free).all():
            break
    return best, problems


def _as_searched(again: Estimate, first: Estimate) -> Estimate:
    """Second of two fits in sequence, `again`, with the iterations and the history of both.

    The status is that of the first fit if several of its answers fit.
    """
    search = replace(
        first.search,
        n_iterations=first.search.n_iterations + again.search.n_iterations,
        history=np.concatenate([first.search.history, again.search.history[1:]]),
    )
    return replace(again, search=search, status=again.status if first.search.n_fitting < 2 else first.status)


def _polarities(problems: Sequence[RecordProblem]) -> tuple[float, ...]:
    """Polarities of the channels of all records, one record after another, +1 or -1."""
    return tuple(sign for problem in problems for sign in polarities(problem))


def _with_polarities(problems: Sequence[RecordProblem], signs: Sequence[float]) -> tuple[RecordProblem, ...]:
    """Copies of the problems with the polarities `signs`, +1 or -1, of all records one after another."""
    ends = np.cumsum([len(polarities(problem)) for problem in problems])[:-1]
    parts = np.split(np.asarray(signs), ends)
    return tuple(with_polarities(problem, part.tolist()) for problem, part in zip(problems, parts, strict=True))

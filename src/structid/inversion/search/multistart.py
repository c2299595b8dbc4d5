"""Several searches for one minimum: ways to it, starts around the given one, and the distinct answers they found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import cast

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError, SingularModelError
from structid.inversion.linearization import Linearization
from structid.inversion.problem import ContinuationPath, Problem, Schedule
from structid.inversion.search.least_squares import (
    LEFT,
    Method,
    Minimum,
    Progress,
    StageCourse,
    StoredValues,
    cost_at,
    sizes_at,
)
from structid.inversion.search.work import (
    SERIAL,
    Minimizer,
    StageProgress,
    TaskContext,
    TaskExecutor,
    restored_minimum,
    stored_minimum,
)
from structid.inversion.uncertainty import at_bounds

_SPREAD = 0.2
_SAME = 3.0
#: Factor on the start up to which wide starts lie, and how many of the weakest directions of an answer are followed as far.
_WIDE, _WEAKEST = 5.0, 2
#: Difference of two sums of squares that says nothing.
_ROUNDED = 1e-6
#: Part of the largest singular value of a relative Jacobian from where on a direction is seen.
_SEEN = 1e-8
#: Wide starts that are searched before the rule for their end is looked at again.
_BATCH = 8
#: Sum of squares per datum, and beside that, beyond which a search is only gone on with where no other is better; and how close
#: to the best it has to be.
_MISSES, _MISSES_AT_LEAST, _NEAR_BEST = 4.0, 30.0, 1.01


@dataclass(frozen=True, eq=False)
class DistinctMinimum:
    """One minimum of the sum of squares, and how many searches ended there.

    Attributes
    ----------
    values, theta : (n_params,) float arrays
        Physical values and free variables.
    cost : float
        Sum of squares, priors included.
    n_searches : int
    distance : float
        From the best answer, in posterior standard deviations: the larger of abs(J d) at both ends of the difference d.
    fits : bool
        Whether the data allow it: its chi-square is acceptable, and a likelihood ratio does not prefer the best one.
    """

    values: FloatArray
    theta: FloatArray
    cost: float
    n_searches: int
    distance: float
    fits: bool


@dataclass(frozen=True, eq=False)
class Search:
    """Number of searches and their starts.

    Parameters
    ----------
    restarts : int
        How many more searches are tried where the fit misses the noise: by each other way from the given start, then
        from random points about 20 % from it. The lowest minimum is kept.
    uniqueness_starts : int
        How many more searches begin at random points about 20 % from the start even where a search fits: a test
        whether other parameters fit the data as well. See ``SearchRecord.answers``.
    doubt_starts : int
        How many of these there are at least where an answer fits and yet is to be doubted: the data push a parameter beyond its
        bound, or one ended farther from its start than `doubt_beyond`.
    doubt_beyond : float
        Factor on a start (from 1); infinite where none is doubted for its distance.
    seed : int
        Of the random starts, and of draws.
    start : (n_params,) float array, optional
        Free variables about which all searches begin; the problem's own start by default.
    near : (n_params,) float array, optional
        Free variables of a nearby answer, from which the first search begins at once; at `start` by default.
    wide_starts : int
        How many more searches begin at most at factors of up to five about the start, and along the weakest directions from each
        answer, where the best one fits and the data determine every parameter. They end where no more answers are to be
        expected; see `expected_answers`.
    wide_problem : callable, optional
        The problem that wide starts are searched with, from the free variables of the best answer: the same, but for choices
        that the data leave open and that no other answer should make differently.
    """

    restarts: int = 0
    uniqueness_starts: int = 0
    seed: int = 0
    start: FloatArray | None = None
    near: FloatArray | None = None
    doubt_starts: int = 0
    doubt_beyond: float = np.inf
    wide_starts: int = 0
    wide_problem: Callable[[FloatArray], Problem] | None = None


@dataclass(frozen=True, eq=False)
class SearchedMinima:
    """The ends of all searches.

    Attributes
    ----------
    minima : list of (Minimum, int)
        With the iterations that each took.
    is_complete : bool
        Whether wide starts were made until no more answers are to be expected.
    """

    minima: list[tuple[Minimum, int]]
    is_complete: bool = False


def searched_minima(
    problem: Problem,
    method: Method,
    paths: Sequence[ContinuationPath],
    search: Search,
    fits: Callable[[Minimum], bool],
    progress: StageProgress | None = None,
    work: TaskExecutor = SERIAL,
) -> SearchedMinima:
    """Minima found by all searches, with the iterations of each.

    The first search takes the first continuation path from the given start. While no minimum fits, restarts take the
    other paths in turn, then random points. `uniqueness_starts` more take the first path from random points in any
    case, or the larger of these and `doubt_starts` where an answer that fits is doubtful. Where there are restarts, a
    search far above the noise (a sum of squares of 4 n_data + 30) that hardly gains any more is stopped, and completed
    only if its end is nearly the best; an easier form is left where it hardly gains any more, and searched to its end
    where no minimum fits. Where `work` has several workers, restarts run ahead of the verdict on those before them; the
    answer is the same.

    Parameters
    ----------
    problem : Problem
    method : Method
        Search method.
    paths : sequence of ContinuationPath
    search : Search
        Numbers of starts, seed and start.
    fits : callable
        True where the data allow a minimum.
    progress : callable, optional
    work : TaskExecutor
    """
    start = np.array(problem.theta_start if search.start is None else search.start)
    chosen: Sequence[ContinuationPath] = paths or ((),)
    spread = _SPREAD * problem.unknowns.sizes(problem.physical(start)) / problem.slope(start)
    rng = np.random.default_rng(search.seed)
    most = max(search.uniqueness_starts, search.doubt_starts)
    points = [spread * rng.standard_normal(len(start)) for _ in range(search.restarts + most)]
    starts, drawn = [], 0
    for attempt in range(search.restarts + 1):
        if attempt < len(chosen):
            starts.append((attempt, attempt, start))
        else:
            starts.append((attempt, attempt % len(chosen), start + points[drawn]))
            drawn += 1
    way = chosen[0]
    racing = method.raced(_MISSES * problem.n_data + _MISSES_AT_LEAST) if search.restarts else method
    first = way(start) if callable(way) else way
    begun = (first, start) if search.near is None else ((), search.near)
    minima = [staged(problem, racing, *begun, progress, "", work.minimize)]
    shared = (problem, racing, tuple(chosen))
    good = fits(minima[0][0])
    while not good and len(minima) < len(starts):
        ahead = starts[len(minima) : len(minima) + work.n_workers]
        for task in work.map("restarts", _search, shared, ahead, progress, first=len(minima) - 1):
            minima.append(_read_minimum(problem, method, task))
            good = fits(minima[-1][0])
            if good:
                break
    used = max(0, len(minima) - len(chosen))
    if not good:
        minima, good = _search_patiently(problem, racing, chosen, starts, minima, fits, progress, work)
    minima = _complete_searches(problem, method, minima, progress, work)
    best = min((minimum for minimum, _ in minima), key=lambda minimum: float(minimum.costs[-1]))
    doubtful = good and _is_doubtful(problem, method, best, start, search)
    count = most if doubtful else search.uniqueness_starts
    more = [(len(minima) + k, 0, start + point) for k, point in enumerate(points[used:][:count])]
    more_minima = (
        work.map("uniqueness starts", _search, (problem, method, tuple(chosen)), more, progress) if more else []
    )
    minima += [_read_minimum(problem, method, task) for task in more_minima]
    if not search.wide_starts or (good and not _is_determined_somewhere(problem, best, start)):
        return SearchedMinima(minima)
    grouped = _GroupedMinima(fits)
    for minimum, _ in minima:
        grouped.add(minimum)
    problem = problem if search.wide_problem is None else search.wide_problem(best.theta)
    wide, is_complete = _wide_minima(problem, method, chosen[0], start, search, grouped, progress, work)
    return SearchedMinima(minima + wide, is_complete)


def _search_patiently(
    problem: Problem,
    racing: Method,
    paths: Sequence[ContinuationPath],
    starts: Sequence[tuple[int, int, FloatArray]],
    minima: list[tuple[Minimum, int]],
    fits: Callable[[Minimum], bool],
    progress: StageProgress | None,
    work: TaskExecutor,
) -> tuple[list[tuple[Minimum, int]], bool]:
    """`minima`, then those of searches made again with their stages to the end, and True if the last of them fits.

    Only searches that left a stage early are made again, in the order of `minima`, from their items (number, index of
    the path, start) in `starts`: until one fits or does not lower the least sum of squares by 1 %. `minima` are pairs
    of a minimum and its number of iterations, `paths` the continuation paths, `racing` is the method of the searches.
    """
    shared = (problem, racing.patient(), tuple(paths))
    stalled = [any(map(racing.for_stages().has_stalled, [stage.costs for stage in one.stages])) for one, _ in minima]
    for number in map(int, np.flatnonzero(stalled)):
        least = min(float(minimum.costs[-1]) for minimum, _ in minima)
        item = (len(minima), *starts[number][1:])
        (task,) = work.map("patient searches", _search, shared, [item], progress, first=number)
        minima = [*minima, _read_minimum(problem, racing, task)]
        again = minima[-1][0]
        if fits(again):
            return minima, True
        if again.costs[-1] * _NEAR_BEST > least:
            break
    return minima, False


def expected_answers(n_searches: int, n_answers: int) -> float:
    """Expected number of distinct minima, if `n_searches` random searches reached `n_answers` of them.

    It is w (n - 1) / (n - w - 2) for w minima of n searches, with every number of minima and every size of their basins equally
    likely beforehand. Infinite for n <= w + 2.

    References
    ----------
    Boender and Rinnooy Kan (1987), Math. Programming 37, 59-80, Eq. (10).
    """
    spare = n_searches - n_answers - 2
    return n_answers * (n_searches - 1) / spare if spare > 0 else np.inf


@dataclass(eq=False)
class _GroupedMinima:
    """The distinct minima of searches, each with whether the data allow it."""

    fits: Callable[[Minimum], bool]
    distinct: list[tuple[Minimum, bool]] = field(default_factory=list)

    def add(self, minimum: Minimum) -> bool:
        """Add `minimum` if it is new, and return True if the data allow it or the known minimum that it repeats.

        A minimum within three posterior standard deviations of another is not new. A search that did not converge is
        not added, and gives False.
        """
        if not minimum.converged:
            return False
        for other, is_fitting in self.distinct:
            if are_same(other, minimum):
                return is_fitting
        self.distinct.append((minimum, self.fits(minimum)))
        return self.distinct[-1][1]

    @property
    def fitting(self) -> list[Minimum]:
        """Minima that the data allow, in the order in which they were reached."""
        return [minimum for minimum, is_fitting in self.distinct if is_fitting]


def _wide_minima(
    problem: Problem,
    method: Method,
    path: ContinuationPath,
    start: FloatArray,
    search: Search,
    grouped: _GroupedMinima,
    progress: StageProgress | None,
    work: TaskExecutor,
) -> tuple[list[tuple[Minimum, int]], bool]:
    """All minima of searches from distant random starts and along the weakest directions, and True if complete.

    Each minimum comes with its number of iterations. Random starts lie within a factor of five of `start`. The minima
    are complete if no further one is expected before `search.wide_starts` run out. `path` is the continuation path of
    each search and `method` its method, `start` (n_params,) the centre of the starts in free variables; `grouped` takes
    the new minima.
    """
    rng = np.random.default_rng([search.seed, search.wide_starts])
    reach, size = problem.unknowns.reach, np.log(_WIDE) * sizes_at(problem, start)
    minima: list[tuple[Minimum, int]] = []
    n_made, n_ended, n_followed = 0, 0, 0

    def run(points: Sequence[FloatArray]) -> int:
        """Number of searches from `points`, each (n_params,), that end at minima that the data allow.

        Starts are clipped to the reach. Ends go to `minima`, new ones to `grouped`; `n_made` counts the searches.
        """
        nonlocal n_made
        items = [(n_made + k, 0, np.clip(point, *reach.T)) for k, point in enumerate(points)]
        tasks = work.map("wide starts", _search_widely, (problem, method, (path,)), items, progress, first=n_made)
        n_made += len(items)
        ends = [_read_minimum(problem, method, task) for task in tasks if "failed" not in task]
        minima.extend(ends)
        return sum(grouped.add(minimum) for minimum, _ in ends)

    while n_made < search.wide_starts:
        n_fitting = len(grouped.fitting)
        if expected_answers(n_ended, n_fitting) >= n_fitting + 0.5:
            count = min(_BATCH, search.wide_starts - n_made)
            n_ended += run([start + size * rng.uniform(-1.0, 1.0, len(start)) for _ in range(count)])
        elif n_followed < n_fitting:
            along = [p for answer in grouped.fitting[n_followed:] for p in _along_weakest(problem, answer)]
            n_followed = n_fitting
            run(along[: search.wide_starts - n_made])
        else:
            return minima, True
    return minima, False


def _search_widely(
    shared: tuple[Problem, Method, tuple[ContinuationPath, ...]], item: tuple[int, int, FloatArray], tools: TaskContext
) -> StoredValues:
    """Minimum of one search from a wide start, as a parallel task; arguments and result are those of `_search`.

    An `InputError`, raised where the data cannot be held against the model, gives ``failed`` too.
    """
    try:
        return _search(shared, item, tools)
    except InputError as error:
        return {"failed": str(error)}


def _along_weakest(problem: Problem, answer: Minimum) -> list[FloatArray]:
    """Four starting points about `answer`: on both sides along its two worst-determined directions, free variables.

    Each is (n_params,), with the parameter that changes most changed by a factor of five (log 5 times its size); the
    second worst direction comes first. Two points if there is one parameter.
    """
    size = sizes_at(problem, answer.theta)
    rows = np.linalg.svd(cast(Linearization, answer.linearization).jacobian * size)[2][-_WEAKEST:]
    steps = [np.log(_WIDE) * row / np.abs(row).max() * size for row in rows]
    return [answer.theta + sign * step for step in steps for sign in (1.0, -1.0)]


def _is_determined_somewhere(problem: Problem, minimum: Minimum, start: FloatArray) -> bool:
    """True if data and priors determine every direction of the parameters at `minimum` or at `start`.

    A search may end between several answers, where the data do not see the way from one to the next. `start`
    (n_params,) are free variables; False there if the model cannot be evaluated.
    """
    if _is_determined(problem, minimum.theta, cast(Linearization, minimum.linearization)):
        return True
    try:
        at_start = problem.linearize(start)
    except (SingularModelError, np.linalg.LinAlgError):  # searches may begin beside a start that cannot be evaluated
        return False
    return _is_determined(problem, start, at_start)


def _is_determined(problem: Problem, theta: FloatArray, linearization: Linearization) -> bool:
    """True if the Jacobian at free variables `theta` (n_params,), with prior rows, determines every direction.

    Its columns are scaled to relative changes; the smallest singular value must exceed 1e-8 of the largest.
    """
    relative = linearization.jacobian * sizes_at(problem, theta)
    if len(relative) < len(theta) or not np.isfinite(relative).all():
        return False
    singular = np.linalg.svd(relative, compute_uv=False)
    return bool(singular[-1] > _SEEN * singular[0])


def _complete_searches(
    problem: Problem,
    method: Method,
    minima: list[tuple[Minimum, int]],
    progress: StageProgress | None,
    work: TaskExecutor,
) -> list[tuple[Minimum, int]]:
    """Pairs (minimum, number of iterations) of `minima`, after the stopped searches near the best were completed.

    A search that was stopped early is continued by `method` if its sum of squares is at most 1.01 times the smallest.
    If it was stopped within three standard deviations of an end to which an earlier one was continued, it gets that end
    as one more step. All others stay as they are.
    """
    most = _NEAR_BEST * min(float(minimum.costs[-1]) for minimum, _ in minima)
    ended: list[tuple[Minimum, int]] = []
    completed: list[Minimum] = []
    for number, (minimum, iterations) in enumerate(minima):
        if minimum.message == LEFT and minimum.costs[-1] <= most:
            reached = next((other for other in completed if _leads_to(problem, minimum, other)), None)
            if reached is None:
                name = f"search {number + 1}, final" if number else "final"
                end = work.minimize(problem, method, minimum.theta, named(progress, name))
                minimum, iterations = _after(minimum, end), iterations + len(end.inner)
                completed.append(minimum)
            else:
                minimum, iterations = _after(minimum, _one_step_to(reached)), iterations + 1
        ended.append((minimum, iterations))
    return ended


def _one_step_to(end: Minimum) -> Minimum:
    """The end of another search as one step that a search is taken to make."""
    history, costs = (np.array([values[-1], values[-1]]) for values in (end.history, end.costs))
    return replace(end, history=history, costs=costs, inner=np.zeros(1, dtype=int))


def _leads_to(problem: Problem, stopped: Minimum, end: Minimum) -> bool:
    """True if a search was `stopped` within three standard deviations of the end of another, those that its misfit gives.

    It was stopped where its linear steps gain nearly nothing, so that it ends within these too.
    """
    scale = np.sqrt(max(float(end.costs[-1]) / problem.n_data, 1.0))
    return _distance(end, stopped) <= _SAME * scale


def _after(first: Minimum, last: Minimum) -> Minimum:
    """End point `last` of a search that continued the one that ended at `first`, with the histories of both."""
    return replace(
        last,
        history=np.concatenate([first.history, last.history[1:]]),
        costs=np.concatenate([first.costs, last.costs[1:]]),
        inner=np.concatenate([first.inner, last.inner]),
        stages=first.stages,
    )


def _is_doubtful(problem: Problem, method: Method, best: Minimum, start: FloatArray, search: Search) -> bool:
    """True if the best answer is doubtful enough for more searches: far from the start, or pushed beyond a bound.

    Far is a change by more than log(`search.doubt_beyond`) times the size of a parameter; the data must push by more
    than chance. False without `search.doubt_starts` or for a matrix-free method. `start` (n_params,) are free
    variables.
    """
    if not search.doubt_starts or method.is_matrix_free:
        return False
    moved = np.abs(best.theta - start)
    far = np.log(search.doubt_beyond)
    if np.isfinite(far) and (moved > far * sizes_at(problem, start)).any():
        return True
    return any(bound.is_pushed for bound in at_bounds(problem, best.theta, cast(Linearization, best.linearization)))


def _search(
    shared: tuple[Problem, Method, tuple[ContinuationPath, ...]], item: tuple[int, int, FloatArray], tools: TaskContext
) -> StoredValues:
    """Minimum of one search as stored arrays with its iterations, a parallel task; ``failed`` holds an error instead.

    `shared` is the problem, the method and the continuation paths; `item` is the number of the search (from 0), the
    index of its path and its start (n_params,); `tools` has the callback for progress and runs each stage.
    """
    (problem, method, ways), (number, which, theta) = shared, item
    way = ways[which]
    stages = way(theta) if callable(way) else way
    prefix = f"search {number + 1}, "
    try:
        minimum, iterations = staged(problem, method, stages, theta, tools.progress, prefix, tools.minimize)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        return {"failed": str(error)}
    return {**stored_minimum(minimum), "iterations": iterations}


def _read_minimum(problem: Problem, method: Method, task: StoredValues) -> tuple[Minimum, int]:
    """Minimum of a stored task and its number of iterations; `SingularModelError` if the task failed."""
    if "failed" in task:
        raise SingularModelError(task["failed"])
    return restored_minimum(problem, method, task), int(task["iterations"])


def staged(
    problem: Problem,
    method: Method,
    stages: Schedule,
    theta: FloatArray,
    progress: StageProgress | None,
    prefix: str = "",
    minimize: Minimizer = SERIAL.minimize,
) -> tuple[Minimum, int]:
    """Minimum of `problem` after the searches of its easier `stages`, and the number of iterations of all searches.

    If the problem has a larger sum of squares at the end of the stages than at `theta`, its search starts from `theta`.
    `stages` are names and problems, searched one after another, and `prefix` begins their names in progress messages.
    `theta` (n_params,) are free variables; `progress` is called with the name of a stage, its iteration and the sum of
    squares. `method` is the search method (its `for_stages` in stages), and `minimize` runs each search.
    """
    start, iterations = theta, 0
    courses: list[StageCourse] = []
    for name, stage in stages:
        minimum = minimize(stage, method.for_stages(), theta, named(progress, prefix + name))
        theta, iterations = minimum.theta, iterations + len(minimum.costs) - 1
        courses.append(StageCourse(name, minimum.history, minimum.costs, stage.n_data))
    if stages and cost_at(problem, start) < cost_at(problem, theta):
        theta = start
    minimum = minimize(problem, method, theta, named(progress, prefix + "final"))
    return replace(minimum, stages=tuple(courses)), iterations + len(minimum.costs) - 1


def named(progress: StageProgress | None, name: str) -> Progress | None:
    """Progress function of the stage `name`, called with iteration and sum of squares; None if `progress` is None."""
    return None if progress is None else partial(progress, name)


def distinct_answers(
    problem: Problem,
    minima: Sequence[Minimum],
    fits: Callable[[Minimum], bool],
    least_cost: Callable[[Minimum], float],
    probability: float,
) -> tuple[DistinctMinimum, ...]:
    """Distinct converged minima, best first, and for each if it fits the data within noise.

    Minima at most three posterior standard deviations apart are one answer. An answer fits if `fits` accepts it and its
    least sum of squares is not so much larger than that of the best that a difference like this has less than
    `probability`, were it the truth.

    Parameters
    ----------
    problem : Problem
    minima : sequence of Minimum
        Ends of searches; those that did not converge are left out.
    fits : callable
        True if the data allow a minimum.
    least_cost : callable
        The smallest sum of squares that noise and tolerances leave at a minimum.
    probability : float
        Of a larger difference of two sums of squares, by chi-square with the number of parameters as degrees of
        freedom.
    """
    groups: list[list[Minimum]] = []
    for minimum in sorted((m for m in minima if m.converged), key=cost_rank):
        group_of = next((g for g in groups if are_same(g[0], minimum)), None)
        if group_of is None:
            groups.append([minimum])
        else:
            group_of.append(minimum)
    answers = []
    for group in groups:
        first, best = group[0], groups[0][0]
        most = float(special.chdtri(max(len(first.theta), 1), probability))
        fit = fits(first) and (first is best or least_cost(first) - least_cost(best) <= most)
        values, theta = locked(problem.physical(first.theta)), locked(first.theta)
        answers.append(DistinctMinimum(values, theta, float(first.costs[-1]), len(group), _distance(best, first), fit))
    return tuple(answers)


def cost_rank(minimum: Minimum) -> float:
    """Sum of squares of a minimum rounded down to a multiple of 1e-6, in that unit: rounding does not change the rank."""
    return float(np.floor(minimum.costs[-1] / _ROUNDED))


def ends_at_other(problem: Problem, minimum: Minimum, end: FloatArray, other: Minimum, other_end: FloatArray) -> bool:
    """True if the refit of `minimum` ends nearer to the refit of `other` than to `minimum` itself.

    False if both minima are the same within three posterior standard deviations.

    Parameters
    ----------
    problem : Problem
    minimum, other : Minimum
        Ends of searches.
    end, other_end : (n_params,) float arrays
        Free variables of the refits of `minimum` and of `other`. Distances are in sizes of the parameters at `minimum`.
    """
    if are_same(other, minimum):
        return False
    size = sizes_at(problem, minimum.theta)
    begun, apart = ((end - point) / np.where(size > 0, size, 1.0) for point in (minimum.theta, other_end))
    return bool(np.linalg.norm(apart) < np.linalg.norm(begun))


def are_same(first: Minimum, second: Minimum) -> bool:
    """True if two minima are one answer: within three posterior standard deviations of each other."""
    return _distance(first, second) <= _SAME


def _distance(first: Minimum, second: Minimum) -> float:
    """Distance of two minima in posterior standard deviations; infinite if it is not finite.

    It is the larger of the values by their two linearizations.
    """
    step = second.theta - first.theta
    distance = max(float(np.linalg.norm(m.linearization.product(step))) for m in (first, second))
    return distance if np.isfinite(distance) else np.inf

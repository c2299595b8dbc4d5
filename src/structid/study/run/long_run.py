"""A run that may take hours: its tasks on the workers that are asked for, its state in a checkpoint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, NotRequired, TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.json_types import StoredEntry
from structid.forward import FrfProblem
from structid.inversion import JointProblem, Linearization, Minimum, Problem, minimize
from structid.inversion.search.least_squares import Method, Progress, SearchStateStore, State
from structid.inversion.search.work import (
    Item,
    Shared,
    StageProgress,
    Task,
    TaskContext,
    TaskResult,
    restored_minimum,
    stored_minimum,
)
from structid.inversion.wrapped_problem import Wrapped
from structid.study.run.checkpoint import Checkpoint
from structid.study.run.workers import InProcess, Workers

#: Called with what the tasks are, how many are done, and how many there are.
TaskProgress = Callable[[str, int, int], None]
#: Degrees of freedom times lines from which a sweep takes so long (about half a second) that it is worth sending.
WORTH_SENDING = 500_000
_MOST_BYTES = 256_000_000
_SEGMENTS_A_WORKER = 2


@dataclass
class Reached:
    """State of the running search, for the report of an interruption."""

    search: str = ""
    iteration: int = 0
    cost: float = float("nan")
    problem: Problem | None = None
    theta: FloatArray | None = None
    tasks: str = ""

    @property
    def words(self) -> str:
        """Words on the state of the run: the tasks in work, or the search."""
        if self.tasks:
            return self.tasks
        return f"{self.search}, iteration {self.iteration}, sum of squares {self.cost:.5g}"

    def take(self, name: str, problem: Problem, minimum: Minimum) -> None:
        """Take over the end of the search `name` of `problem`, which has just finished or was stored before an interruption."""
        self.search, self.iteration, self.cost = name, len(minimum.costs) - 1, float(minimum.costs[-1])
        self.problem, self.theta = problem, minimum.theta

    def summary(self) -> dict[str, StoredEntry]:
        """The values reached so far, without uncertainty, as plain values for JSON.

        The keys are ``status``, ``search``, ``iteration``, ``sum_of_squares``, ``tasks`` while tasks run, and
        ``parameters`` (name, unit, value of each) from the first iteration on.
        """
        summary: dict[str, StoredEntry] = {"status": "interrupted", "search": self.search, "iteration": self.iteration}
        summary["sum_of_squares"] = self.cost
        if self.tasks:
            summary["tasks"] = self.tasks
        if self.problem is None or self.theta is None:
            return summary
        values = self.problem.physical(self.theta)
        rows = zip(self.problem.names, self.problem.unknowns.units, values.tolist(), strict=True)
        summary["parameters"] = [{"name": name, "unit": unit, "value": value} for name, unit, value in rows]
        return summary


class LongRun:
    """The `TaskExecutor` of a study: numbered searches and tasks, those done before an interruption taken from the checkpoint.

    Searches and tasks follow from the study alone, so that the n-th of a resumed run is the n-th of the one before.

    Parameters
    ----------
    workers : Workers, optional
        Where tasks run; in this process by default.
    checkpoint : Checkpoint, optional
        Keeps what is done.
    progress : callable, optional
        Called with the name of the tasks, how many are done, and how many there are.
    """

    def __init__(
        self,
        workers: Workers | None = None,
        checkpoint: Checkpoint | None = None,
        progress: TaskProgress | None = None,
    ) -> None:
        """A run on `workers` (by default in this process), with an optional checkpoint and a callback for finished tasks."""
        self.workers: Workers = workers or InProcess()
        self.checkpoint, self.progress = checkpoint, progress
        self.reached = Reached()
        self._searches: Counter[str] = Counter()
        self._keeper: _Keeper | None = None
        self._calls: Counter[str] = Counter()

    @property
    def n_workers(self) -> int:
        return self.workers.n_workers

    def minimize(
        self,
        problem: Problem,
        method: Method,
        theta: FloatArray | None = None,
        progress: Progress | None = None,
        scope: str = "",
    ) -> Minimum:
        """Minimum of a problem by the search `method`, continued from the checkpoint if it holds this search.

        A search that the checkpoint holds as finished is not repeated. Workers evaluate the lines of a large problem;
        within a task, whose name is `scope`, this process does. `theta` (n_params,) are the free variables at the
        start, by default the problem's.
        """
        self._searches[scope] += 1
        name = f"{scope}search {self._searches[scope]}"
        spread_problem = problem if scope else spread(problem, self.workers)
        checkpoint = self.checkpoint
        if checkpoint is None:
            return minimize(spread_problem, method, theta, progress, _Keeper(name, problem, self.reached, None))
        if name in checkpoint.entries:
            minimum = restored_minimum(problem, method, checkpoint.entries[name])
            self.reached.take(name, problem, minimum)
            return minimum
        minimum = minimize(spread_problem, method, theta, progress, _Keeper(name, problem, self.reached, checkpoint))
        self.reached.take(name, problem, minimum)
        checkpoint.finished(name, stored_minimum(minimum))
        return minimum

    def keeper(self, problem: Problem) -> SearchStateStore:
        """The store for the state of a new search of `problem` in this process.

        Searches are numbered in the order of calls. The search of the previous call counts as finished in the
        checkpoint.
        """
        checkpoint = self.checkpoint
        if self._keeper is not None and self._keeper.latest is not None and checkpoint is not None:
            checkpoint.finished(self._keeper.name, dict(self._keeper.latest()))
        self._searches[""] += 1
        self._keeper = _Keeper(f"search {self._searches['']}", problem, self.reached, checkpoint)
        return self._keeper

    def map(
        self,
        name: str,
        task: Task[Shared, Item, TaskResult],
        shared: Shared,
        items: Sequence[Item],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[TaskResult]:
        """Results of `task` for every item, in the order of `items`.

        Results that the checkpoint holds are not computed again. `task` is called with `shared`, an item, and a context
        for searches and progress. `name` says what the tasks are, and `first` is the index of `items[0]` if the items
        continue an earlier call.
        """
        self._calls[name] += first == 0
        call = f"{name} {self._calls[name]}"
        names = [f"{call}, {first + number + 1}" for number in range(len(items))]
        done = {} if self.checkpoint is None else self.checkpoint.entries
        results: dict[int, TaskResult] = {number: done[own] for number, own in enumerate(names) if own in done}
        missing = {number: item for number, item in enumerate(items) if number not in results}

        def tools(number: int) -> TaskContext:
            return TaskContext(partial(self.minimize, scope=f"{names[number]}, "), progress)

        self._tell(name, len(results), len(items))
        if missing:
            for number, result in self.workers.completed(task, shared, missing, tools):
                results[number] = result
                if self.checkpoint is not None:
                    self.checkpoint.finished(names[number], result)
                self._tell(name, len(results), len(items))
        self.reached.tasks = ""
        return [results[number] for number in range(len(items))]

    def _tell(self, name: str, done: int, total: int) -> None:
        self.reached.tasks = f"{name}, {done} of {total} done"
        if self.progress is not None and total > 1:
            self.progress(name, done, total)

    def so_far(self) -> dict[str, StoredEntry]:
        """Content of ``so_far.json``: the keys of `Reached.summary`, and ``finished_searches_and_tasks``, their number."""
        done = 0 if self.checkpoint is None else self.checkpoint.n_found
        return {**self.reached.summary(), "finished_searches_and_tasks": done}

    def close(self) -> None:
        """End the processes or the connection of the workers of this run."""
        self.workers.close()


@dataclass(eq=False)
class _Keeper:
    """The `SearchStateStore` of one search."""

    name: str
    problem: Problem
    reached: Reached
    checkpoint: Checkpoint | None
    latest: Callable[[], State] | None = None

    @property
    def state(self) -> State | None:
        """State from which the search of this store continues; None to start anew.

        It is the last state if the search has finished, else the one stored while it was under way.
        """
        if self.checkpoint is None:
            return None
        ended: State | None = self.checkpoint.entries.get(self.name)
        return ended if ended is not None else self.checkpoint.state_of(self.name)

    def keep(self, iteration: int, cost: float, state: Callable[[], State]) -> None:
        """Record the iteration, sum of squares `cost` and state that the search has reached, for reports and the checkpoint.

        `state` makes the state when called; its entry ``theta`` holds the free variables.
        """
        self.latest = state
        reached = self.reached
        reached.search, reached.iteration, reached.cost, reached.problem = self.name, iteration, cost, self.problem
        reached.theta = state()["theta"]
        if self.checkpoint is not None:
            self.checkpoint.running(self.name, state)


@dataclass(frozen=True, eq=False)
class LineSegments:
    """Problems on segments of the lines of `problem`, each made when it is first asked for and kept in `made`."""

    problem: FrfProblem
    made: dict[tuple[int, int], FrfProblem] = field(default_factory=dict)

    def at(self, first: int, last: int) -> FrfProblem:
        if (first, last) not in self.made:
            self.made[first, last] = self.problem.with_lines(np.arange(first, last))
        return self.made[first, last]


@dataclass(frozen=True, eq=False)
class SpreadLines(Wrapped):
    """Problem with the residual and Jacobian of `problem`, computed by workers.

    Parameters
    ----------
    problem : FrfProblem
    workers : Workers
    """

    problem: FrfProblem
    workers: Workers

    @cached_property
    def segments(self) -> LineSegments:
        return LineSegments(self.problem)

    def residual(self, theta: FloatArray) -> FloatArray:
        return _join_parts("residual", self._evaluate_parts(theta, False))

    def linearize(self, theta: FloatArray) -> Linearization:
        parts = self._evaluate_parts(theta, True)
        return Linearization(_join_parts("residual", parts), _join_parts("jacobian", parts))

    def _evaluate_parts(self, theta: FloatArray, with_jacobian: bool) -> list[_Lines]:
        """Residual, and Jacobian if `with_jacobian`, of each segment of adjacent lines, evaluated on workers.

        The list is in the order of frequency. `theta` (n_params,) are the free variables. A residual is (n,), a
        Jacobian (n, n_params).
        """
        n_lines = len(self.problem.record.frequency)
        count = min(n_lines, _SEGMENTS_A_WORKER * self.workers.n_workers)
        ends = np.linspace(0, n_lines, count + 1).astype(int).tolist()
        items = {k: (ends[k], ends[k + 1], theta, with_jacobian) for k in range(count)}
        part_of = dict(self.workers.completed(evaluate_segment, self.segments, items))
        return [part_of[k] for k in range(count)]


class _Lines(TypedDict):
    """Residual, and Jacobian where it is wanted, of some lines, and how many rows are of their data."""

    residual: FloatArray
    jacobian: NotRequired[FloatArray]
    n_data: int


def _join_parts(name: Literal["residual", "jacobian"], segment_results: list[_Lines]) -> FloatArray:
    """Residual (n_data,) or Jacobian (n_data, n_params) of all lines, joined from those of segments in frequency order.

    The rows are real parts of all segments, imaginary parts of all segments, then the rows of the priors, taken from
    the last one.
    """
    real, imaginary = [], []
    for segment_result in segment_results:
        rows, half = segment_result[name], segment_result["n_data"] // 2
        real.append(rows[:half])
        imaginary.append(rows[half : 2 * half])
    return np.concatenate([*real, *imaginary, segment_results[-1][name][2 * half :]])


def evaluate_segment(segments: LineSegments, item: tuple[int, int, FloatArray, bool], _: TaskContext) -> _Lines:
    """Residual, and Jacobian if asked for, of one segment of lines, as a task for workers.

    `item` is (first line, line after the last, free variables, with_jacobian). The result has ``residual``, ``n_data`` (the
    rows that are data and not priors) and perhaps ``jacobian``.
    """
    first, last, theta, with_jacobian = item
    part = segments.at(first, last)
    if not with_jacobian:
        return {"residual": part.residual(theta), "n_data": part.n_data}
    linearization = part.linearize(theta)
    return {"residual": linearization.residual, "jacobian": linearization.jacobian, "n_data": part.n_data}


def spread(problem: Problem, workers: Workers) -> Problem:
    """The problem with the lines of its large FRF problems evaluated on workers; unchanged if that does not pay.

    It does not with one worker, a small model, degrees of freedom times lines below 500 000, or a Jacobian above 256
    MB.
    """
    if workers.n_workers < 2:
        return problem
    if isinstance(problem, JointProblem):
        members = tuple(spread(member, workers) for member in problem.problems)
        changed = any(new is not old for new, old in zip(members, problem.problems, strict=True))
        return replace(problem, problems=members) if changed else problem
    if not isinstance(problem, FrfProblem) or problem.structure.n_dofs * len(problem.record.frequency) < WORTH_SENDING:
        return problem
    if 8 * problem.n_data * len(problem.names) > _MOST_BYTES or not problem.model.is_large:
        return problem
    return SpreadLines(problem, workers)

"""Executors of searches and repeated tasks, which may keep what is done in a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import (
    Method,
    Minimum,
    Progress,
    SearchStateStore,
    StageCourse,
    StoredValues,
    minimize,
)

StageProgress = Callable[[str, int, float], None]


class Minimizer(Protocol):
    """A search: `minimize`, or a variant that keeps its iterations."""

    def __call__(
        self, problem: Problem, method: Method, theta: FloatArray | None = None, progress: Progress | None = None
    ) -> Minimum: ...


class TaskContext(NamedTuple):
    """Context of a task beside its own data; `progress` is None in another process."""

    minimize: Minimizer
    progress: StageProgress | None


#: Of tasks in another process, and of those that make no search.
PLAIN_CONTEXT = TaskContext(minimize, None)

Shared = TypeVar("Shared")
Item = TypeVar("Item")
TaskResult = TypeVar("TaskResult")
#: A function of a module (not a closure) of what all tasks share, the item, and the tools; gives numbers, texts,
#: arrays, or lists and mappings of them.
Task: TypeAlias = Callable[[Shared, Item, TaskContext], TaskResult]


class TaskExecutor(Protocol):
    """Executor of searches and repeated tasks; the answer does not depend on it."""

    @property
    def n_workers(self) -> int:
        """Number of tasks that run at once."""
        ...

    def minimize(
        self, problem: Problem, method: Method, theta: FloatArray | None = None, progress: Progress | None = None
    ) -> Minimum:
        """Minimum of `problem` by `method` from free variables `theta` (n_params,), by default its start."""
        ...

    def keeper(self, problem: Problem) -> SearchStateStore | None:
        """Store for the state of a search after each iteration; None where nothing is kept."""
        ...

    def map(
        self,
        name: str,
        task: Task[Shared, Item, TaskResult],
        shared: Shared,
        items: Sequence[Item],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[TaskResult]:
        """`task` of every item, in their order.

        Parameters
        ----------
        name : str
            What they are, in the plural, as progress and checkpoints call them.
        task : Task
        shared : object
            What all tasks need.
        items : sequence
            What each one needs of its own, small.
        progress : callable, optional
            Of the searches inside, where they run in this process.
        first : int
            Number of the first item, where the tasks of one name come in several calls: 0 in the first of them.
        """
        ...


@dataclass(frozen=True)
class SerialExecutor:
    """Everything in this process, one after another, nothing kept."""

    n_workers: int = 1

    def minimize(
        self, problem: Problem, method: Method, theta: FloatArray | None = None, progress: Progress | None = None
    ) -> Minimum:
        return minimize(problem, method, theta, progress)

    def keeper(self, problem: Problem) -> SearchStateStore | None:
        return None

    def map(
        self,
        name: str,
        task: Task[Shared, Item, TaskResult],
        shared: Shared,
        items: Sequence[Item],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[TaskResult]:
        return [task(shared, item, TaskContext(minimize, progress)) for item in items]


SERIAL = SerialExecutor()


def stored_minimum(minimum: Minimum) -> StoredValues:
    """A minimum without its linearization, in plain arrays."""
    return {
        "theta": minimum.theta,
        "history": minimum.history,
        "costs": minimum.costs,
        "inner": minimum.inner,
        "converged": minimum.converged,
        "message": minimum.message,
        "stages": [stage._asdict() for stage in minimum.stages],
    }


def restored_minimum(problem: Problem, method: Method, stored: StoredValues) -> Minimum:
    """Minimum restored from the arrays `stored` by `stored_minimum`, with the linearization made anew by `method`.

    It has the keys theta, history, costs, inner, converged, message and stages.
    """
    theta = np.asarray(stored["theta"], dtype=np.float64)
    history, costs, inner = (np.asarray(stored[name]) for name in ("history", "costs", "inner"))
    linearization = method.at(problem, theta).at
    stages = tuple(
        StageCourse(str(stage["name"]), np.asarray(stage["history"]), np.asarray(stage["costs"]), int(stage["n_data"]))
        for stage in stored["stages"]
    )
    return Minimum(
        theta, linearization, history, costs, inner, bool(stored["converged"]), str(stored["message"]), stages
    )

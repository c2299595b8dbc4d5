"""The effort that a search for causes may take: counted from the sizes of what is evaluated, so that no machine matters.

Effort is in seconds, those that the processor of the measurements behind `thresholds` would take. Equal searches take equal
effort on every machine and with any number of workers; how long they last is another matter.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np
import psutil

from structid.core.errors import StructidError
from structid.diagnose.thresholds import (
    ENTRY_EFFORT,
    FULL_DOFS,
    ITERATION_EFFORT,
    LEAST_FIT,
    MODE_EFFORT,
    PART_OF_ONE_FIT,
    SCREENED_EFFORT,
    SUMMED_TERMS,
    VALUE_EFFORT,
)
from structid.forward import FrfProblem, RecordProblem
from structid.forward.modal import compares_modes
from structid.forward.time import compares_spectra
from structid.inversion import JointProblem, Problem
from structid.inversion.search.least_squares import Progress
from structid.inversion.search.work import Item, Shared, Task, TaskExecutor

Result = TypeVar("Result")


class SearchEndedError(StructidError):
    """A fit has used up the effort or the processor time that one fit may take."""


def iteration_effort(problem: Problem) -> float:
    """Effort in s of one iteration of a search on a problem, a linearization and a trial step, from sizes alone.

    Sizes are those of data, parameters, lines and degrees of freedom. A joint problem has the sum of its problems.
    """
    if isinstance(problem, JointProblem):
        return sum(iteration_effort(one) for one in problem.problems)
    jacobian = ENTRY_EFFORT * problem.n_data * len(problem.names)
    if not isinstance(problem, RecordProblem):
        return jacobian
    n_dofs = problem.structure.n_dofs
    if compares_modes(problem):
        return ITERATION_EFFORT + jacobian + MODE_EFFORT * n_dofs**2 * min(n_dofs, FULL_DOFS)
    if isinstance(problem, FrfProblem):
        return ITERATION_EFFORT + jacobian + ENTRY_EFFORT * len(problem.frequency) * n_dofs * min(n_dofs, FULL_DOFS)
    fields = 0.0
    if compares_spectra(problem):  # responses of every degree of freedom at every line
        fields = ENTRY_EFFORT * len(problem.frequency) * n_dofs * min(n_dofs, SUMMED_TERMS)
    return ITERATION_EFFORT + jacobian + VALUE_EFFORT * problem.n_data + fields


def screening_effort(n_rows: int, n_strengths: int) -> float:
    """Effort, s, of screening a candidate: residuals (n_rows, n_strengths) without what the parameters can follow."""
    return SCREENED_EFFORT * n_rows * n_strengths


class EffortMeter:
    """The sum of all effort that this process has taken.

    Tasks in other processes, and those that a checkpoint keeps, bring their effort with their results.
    """

    def __init__(self) -> None:
        """A meter begins at 0."""
        self.reading = 0.0

    def add(self, effort: float) -> None:
        """Count an effort, s."""
        self.reading += effort


#: The meter of this process.
METER = EffortMeter()

#: Processor seconds of every child process so far, by its number; one that has ended keeps the last that were seen.
_CHILD_SECONDS: dict[int, float] = {}


def processor_seconds() -> float:
    """Processor time in seconds of this process and of all processes that it started, ended ones included.

    It never falls. Of an ended process the time of the last call counts.
    """
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it has ended meanwhile
            times = child.cpu_times()
            _CHILD_SECONDS[child.pid] = max(_CHILD_SECONDS.get(child.pid, 0.0), float(times.user + times.system))
    return time.process_time() + sum(_CHILD_SECONDS.values())


class Expense(NamedTuple):
    """Effort and processor time of a piece of work, both in s.

    Effort is the time that the work should take by its sizes alone (`iteration_effort`, `screening_effort`), so that it is
    equal on all machines.
    """

    effort: float = 0.0
    seconds: float = 0.0


class FitLimits(NamedTuple):
    """Effort, s as by `iteration_effort`, and processor time, s, that the fit of one changed study may take."""

    effort: float = np.inf
    seconds: float = np.inf


#: What nothing took.
NOTHING = Expense()
#: A fit may take whatever it takes.
NO_LIMITS = FitLimits()


@dataclass(frozen=True)
class SearchBudget:
    """Effort that may be spent from now on; processor time ends a search only where a user limits it.

    Attributes
    ----------
    effort : float
        Limit of the effort, s, see `Expense`; infinite where all is to be tried, however long it takes.
    seconds : float
        Limit of processor time, s, infinite by default; where it ends a search, what was tried depends on the machine.
    effort_begun, seconds_begun : float
        Readings of `METER` and of `processor_seconds` when the budget began; by default now.
    """

    effort: float = np.inf
    seconds: float = np.inf
    effort_begun: float = field(default_factory=lambda: METER.reading)
    seconds_begun: float = field(default_factory=processor_seconds)

    @property
    def is_limited(self) -> bool:
        """True if a search may end before all is tried."""
        return bool(np.isfinite(self.effort) or np.isfinite(self.seconds))

    @property
    def spent(self) -> Expense:
        """Effort and processor time, s, that were spent since the budget began."""
        return Expense(METER.reading - self.effort_begun, processor_seconds() - self.seconds_begun)

    def allows(self, needed: Expense, fraction: float = 1.0) -> bool:
        """True if more effort and processor time are left than `fraction` times `needed`, where they are limited.

        True too if neither is limited.
        """
        if np.isfinite(self.effort):
            effort_left = self.effort - (METER.reading - self.effort_begun)
            if not effort_left > fraction * needed.effort:
                return False
        if np.isfinite(self.seconds):  # all processes of the run are asked, so only where a user limits them
            seconds_left = self.seconds - (processor_seconds() - self.seconds_begun)
            return seconds_left > fraction * needed.seconds
        return True

    @property
    def is_left(self) -> bool:
        """True if anything is left."""
        return self.allows(NOTHING)

    def portion(self, fraction: float, kept: float = 0.0) -> SearchBudget:
        """A budget that begins now: `fraction` of what is left once the part `kept` of this whole budget is set aside.

        Infinite limits stay infinite.
        """
        left = [
            limit - spent - kept * limit if np.isfinite(limit) else np.inf
            for limit, spent in zip((self.effort, self.seconds), self.spent, strict=True)
        ]
        return SearchBudget(fraction * left[0], fraction * left[1])

    @property
    def fit_limits(self) -> FitLimits:
        """Limits of the fit of one changed study: 20 % of the whole budget each, but at least 0.5 s."""
        return FitLimits(max(PART_OF_ONE_FIT * self.effort, LEAST_FIT), max(PART_OF_ONE_FIT * self.seconds, LEAST_FIT))


#: All is tried, however long it takes.
UNLIMITED = SearchBudget(np.inf, np.inf, 0.0, 0.0)


def map_within_budget(
    budget: SearchBudget,
    work: TaskExecutor,
    name: str,
    task: Task[Shared, Item, Result],
    shared: Shared,
    items: Sequence[Item],
    least: int = 0,
) -> list[Result | None]:
    """Results of `task` for the items, in their order, until the budget is used up; None for items not reached.

    The first `least` items run in any case. `task` takes `shared`, an item and tools; `name` is the stage in progress messages.
    Results that arrive after the budget is used up are dropped, so that what is tried does not depend on the number of workers.
    """
    measured = TaskWithEffort(task)
    results: list[Result | None] = []
    step = len(items)
    if budget.is_limited:
        step = 2 * work.n_workers if work.n_workers > 1 else 1
    while len(results) < len(items) and (len(results) < least or budget.is_left):
        first = len(results)
        batch = work.map(name, measured, shared, items[first : first + step], first=first)
        for answer in batch:
            if len(results) >= least and not budget.is_left:
                break
            results.append(answer["result"])
            METER.add(answer["effort"])
    return [*results, *[None] * (len(items) - len(results))]


@dataclass(frozen=True)
class TaskWithEffort:
    """A task whose answer is its result with its effort."""

    task: Callable

    def __call__(self, shared: object, item: object, tools: object) -> dict:
        """Dict with the ``result`` of the task and its ``effort`` in s; the meter `METER` is as before, also on error.

        `shared`, `item` and `tools` are passed on to the task.
        """
        before, METER.reading = METER.reading, 0.0  # the digits of a sum do not depend on what came before
        try:
            return {"result": self.task(shared, item, tools), "effort": METER.reading}
        finally:
            METER.reading = before


def count_effort(problem: Problem, limits: FitLimits = NO_LIMITS) -> Progress:
    """Callback (iteration, cost) for the progress of a search on `problem`, which adds the effort of each to `METER`.

    It raises `SearchEndedError` once more effort, or processor time of this process, than `limits` allow is spent from
    now on.
    """
    effort = iteration_effort(problem)
    most = METER.reading + limits.effort
    end = time.process_time() + limits.seconds

    def count(iteration: int, cost: float) -> None:
        METER.add(effort)
        if METER.reading > most or time.process_time() > end:
            raise SearchEndedError(f"the fit was ended after {iteration} iterations")

    return count

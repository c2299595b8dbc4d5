"""The effort that a search for causes may take: counted from the sizes of what is evaluated, so that no machine matters."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np
import psutil

from structid.core.errors import StructidError
from structid.diagnose.thresholds import LEAST_FIT, PART_OF_ONE_FIT
from structid.forward import FrfProblem, ModalProblem, RecordProblem
from structid.inversion import JointProblem, Problem
from structid.inversion.search.minimum import Progress
from structid.inversion.search.work import Item, Shared, Task, Work

Result = TypeVar("Result")

#: Effort of one iteration, in seconds of the processor that it was measured on: for each, for each entry of the Jacobian and of
#: the dynamic stiffness at all lines, for each cubed degree of freedom of modes, and for each value of a history. Examples of
#: 3 to 171 degrees of freedom take 0.5 to 2 times this; it only says what is large beside what.
_EACH, _ENTRY, _MODE, _VALUE = 1e-3, 3e-8, 1.4e-8, 2e-6
#: The same of one entry of a residual that a candidate changes, parameters following linearly.
_LOOK = 2.5e-8
#: The same of a changed model, assembled anew.
CHANGE_EFFORT = 0.005
#: Degrees of freedom up to which a dynamic stiffness is full.
_BAND = 500


class SearchEndedError(StructidError):
    """A fit took more effort, or longer, than it may."""


def iteration_effort(problem: Problem) -> float:
    """Effort of one iteration of a search on a problem: a linearization and a trial step, from sizes alone."""
    if isinstance(problem, JointProblem):
        return sum(iteration_effort(one) for one in problem.problems)
    jacobian = _ENTRY * problem.n_data * len(problem.names)
    if not isinstance(problem, RecordProblem):
        return jacobian
    n_dofs = problem.structure.n_dofs
    if isinstance(problem, ModalProblem):
        return _EACH + jacobian + _MODE * n_dofs**2 * min(n_dofs, _BAND)
    if isinstance(problem, FrfProblem):
        return _EACH + jacobian + _ENTRY * len(problem.frequency) * n_dofs * min(n_dofs, _BAND)
    return _EACH + jacobian + _VALUE * problem.n_data


def look_effort(n_rows: int, n_strengths: int) -> float:
    """Effort of the residuals of a linear look, (n_rows, n_strengths)."""
    return _LOOK * n_rows * n_strengths


class EffortClock:
    """A clock that goes by what is evaluated in this process.

    Tasks in other processes, and those that a checkpoint keeps, bring their effort with them.
    """

    def __init__(self) -> None:
        """A clock begins at 0."""
        self.reading = 0.0

    def spend(self, effort: float) -> None:
        """Let the clock go on by an effort."""
        self.reading += effort


#: The clock of this process.
CLOCK = EffortClock()

#: Processor seconds of every child process so far, by its number; one that has ended keeps the last that were seen.
_CHILD_SECONDS: dict[int, float] = {}


def processor_seconds() -> float:
    """Processor time of this process and of all workers that it started, in seconds; it never falls."""
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it has ended meanwhile
            times = child.cpu_times()
            _CHILD_SECONDS[child.pid] = max(_CHILD_SECONDS.get(child.pid, 0.0), float(times.user + times.system))
    return time.process_time() + sum(_CHILD_SECONDS.values())


class Limits(NamedTuple):
    """Effort and processor seconds that something took, or that it may take at most."""

    effort: float = np.inf
    seconds: float = np.inf


#: Whatever it takes.
NO_LIMITS = Limits()
#: What nothing took.
NOTHING = Limits(0.0, 0.0)


@dataclass(frozen=True)
class SearchBudget:
    """Effort that may be spent from now on; processor time ends a search only where a user limits it.

    Attributes
    ----------
    effort : float
        Infinite where all is to be tried, however long it takes.
    seconds : float
        Processor time, infinite by default; where it ends a search, what was tried depends on the machine.
    effort_begun, seconds_begun : float
        Readings of `CLOCK` and of `processor_seconds` at its beginning.
    """

    effort: float = np.inf
    seconds: float = np.inf
    effort_begun: float = field(default_factory=lambda: CLOCK.reading)
    seconds_begun: float = field(default_factory=processor_seconds)

    @property
    def is_limited(self) -> bool:
        """True if a search may end before all is tried."""
        return bool(np.isfinite(self.effort) or np.isfinite(self.seconds))

    @property
    def spent(self) -> Limits:
        """Effort and processor seconds so far."""
        return Limits(CLOCK.reading - self.effort_begun, processor_seconds() - self.seconds_begun)

    def allows(self, needed: Limits, fraction: float = 1.0) -> bool:
        """True if more is left than `fraction` of what something took; of what is not limited there is always enough."""
        if np.isfinite(self.effort):
            effort_left = self.effort - (CLOCK.reading - self.effort_begun)
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

    def part(self, fraction: float, reserve: float = 0.0) -> SearchBudget:
        """A new budget that begins now: `fraction` of what is left when `reserve`, a part of this whole budget, is kept."""
        left = [
            limit - spent - reserve * limit if np.isfinite(limit) else np.inf
            for limit, spent in zip((self.effort, self.seconds), self.spent, strict=True)
        ]
        return SearchBudget(fraction * left[0], fraction * left[1])

    @property
    def fit_limits(self) -> Limits:
        """Limits of the fit of one changed study: a part of the whole budget, but a least in any case."""
        return Limits(max(PART_OF_ONE_FIT * self.effort, LEAST_FIT), max(PART_OF_ONE_FIT * self.seconds, LEAST_FIT))


#: All is tried, however long it takes.
UNLIMITED = SearchBudget(np.inf, np.inf, 0.0, 0.0)


def map_within_budget(
    budget: SearchBudget,
    work: Work,
    name: str,
    task: Task[Shared, Item, Result],
    shared: Shared,
    items: Sequence[Item],
    least: int = 0,
) -> list[Result | None]:
    """Results of `task` for the items in order, until the budget is used up; None for items not reached.

    The first `least` items run in any case. Results are taken in the order of the items, each with its effort, and those of a
    batch that come after the budget is used up are dropped: what is tried does not depend on the number of workers.
    """
    measured = Measured(task)
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
            CLOCK.spend(answer["effort"])
    return [*results, *[None] * (len(items) - len(results))]


@dataclass(frozen=True)
class Measured:
    """A task whose answer is its result with its effort."""

    task: Callable

    def __call__(self, shared: object, item: object, tools: object) -> dict:
        """The `result` of the task and its `effort`."""
        before, CLOCK.reading = CLOCK.reading, 0.0  # the digits of a sum do not depend on what came before
        try:
            return {"result": self.task(shared, item, tools), "effort": CLOCK.reading}
        finally:
            CLOCK.reading = before


def counted(problem: Problem, limits: Limits = NO_LIMITS) -> Progress:
    """A `progress` callback of a search that counts its effort, and raises `SearchEndedError` beyond the limits."""
    effort = iteration_effort(problem)
    most = CLOCK.reading + limits.effort
    end = time.process_time() + limits.seconds

    def count(iteration: int, cost: float) -> None:
        CLOCK.spend(effort)
        if CLOCK.reading > most or time.process_time() > end:
            raise SearchEndedError(f"the fit was ended after {iteration} iterations")

    return count

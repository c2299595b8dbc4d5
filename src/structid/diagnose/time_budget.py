"""The processor time that a search for causes may take, and tasks that stop when it is used up."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import psutil

from structid.core.errors import StructidError
from structid.inversion.search.minimum import Progress
from structid.inversion.search.work import Item, Shared, Task, Work

Result = TypeVar("Result")

#: Part of the time that the fit of one changed study may take, and seconds that it may take in any case.
_OF_ONE_FIT, _LEAST_FIT = 0.2, 0.5


class TimeUpError(StructidError):
    """A fit took longer than it may."""


#: Processor seconds of every child process so far, by its number; one that has ended keeps the last that were seen.
_CHILD_SECONDS: dict[int, float] = {}


def processor_seconds() -> float:
    """Processor time of this process and of all workers that it started, in seconds; it never falls."""
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it has ended meanwhile
            times = child.cpu_times()
            _CHILD_SECONDS[child.pid] = max(_CHILD_SECONDS.get(child.pid, 0.0), float(times.user + times.system))
    return time.process_time() + sum(_CHILD_SECONDS.values())


@dataclass(frozen=True)
class TimeBudget:
    """Processor time that may be used from now on.

    Attributes
    ----------
    seconds : float
        Infinite where all is to be tried, however long it takes.
    begun : float
        `processor_seconds` at its beginning.
    """

    seconds: float = np.inf
    begun: float = field(default_factory=lambda: processor_seconds())

    @property
    def spent(self) -> float:
        """Seconds used so far."""
        return processor_seconds() - self.begun

    @property
    def left(self) -> float:
        """Seconds that remain, negative where more was used."""
        return self.seconds - self.spent

    def part(self, fraction: float) -> TimeBudget:
        """A new budget of a fraction of the seconds that are left; it begins now."""
        return TimeBudget(fraction * self.left)

    @property
    def fit_limit(self) -> float:
        """Seconds that the fit of one changed study may take: a fifth of the whole budget, half a second at least."""
        return max(_OF_ONE_FIT * self.seconds, _LEAST_FIT)


#: All is tried, however long it takes.
UNLIMITED = TimeBudget(np.inf, 0.0)


def map_within_budget(
    budget: TimeBudget,
    work: Work,
    name: str,
    task: Task[Shared, Item, Result],
    shared: Shared,
    items: Sequence[Item],
    least: int = 0,
) -> list[Result | None]:
    """Results of `task` for the items in order, until the budget is used up; None for items not reached.

    The first `least` items run in any case. The time is looked at after every batch, of one item in this process and of
    two a worker elsewhere, so that it is exceeded by one batch at most.
    """
    if np.isinf(budget.seconds):
        return list(work.map(name, task, shared, items))
    results: list[Result | None] = []
    step = max(2 * work.n_workers, 1) if work.n_workers > 1 else 1
    while len(results) < len(items) and (len(results) < least or budget.left > 0):
        first = len(results)
        results += work.map(name, task, shared, items[first : first + step], first=first)
    return [*results, *[None] * (len(items) - len(results))]


def time_limit_callback(seconds: float) -> Progress | None:
    """A `progress` callback that raises `TimeUpError` after so many processor seconds; None if infinite."""
    if np.isinf(seconds):
        return None
    end = time.process_time() + seconds

    def stop_when_late(iteration: int, cost: float) -> None:
        if time.process_time() > end:
            raise TimeUpError(f"the fit was ended after {seconds:.3g} s of the processor and {iteration} iterations")

    return stop_when_late

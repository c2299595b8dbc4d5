"""The processor time that a search for causes may take, and tasks that stop when it is used up."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
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


def processor_seconds() -> float:
    """Processor time of this process and of the workers that it started, in seconds."""
    children = psutil.Process().children(recursive=True)
    return time.process_time() + sum(map(_child_seconds, children))


def _child_seconds(child: psutil.Process) -> float:
    try:
        times = child.cpu_times()
    except psutil.Error:  # it has ended meanwhile
        return 0.0
    return float(times.user + times.system)


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
        """A fraction of what is left, from now on."""
        return TimeBudget(fraction * self.left)

    @property
    def of_one_fit(self) -> float:
        """Seconds that the fit of one changed study may take."""
        return max(_OF_ONE_FIT * self.seconds, _LEAST_FIT)


UNLIMITED = TimeBudget()


def map_in_time(
    budget: TimeBudget,
    work: Work,
    name: str,
    task: Task[Shared, Item, Result],
    shared: Shared,
    items: Sequence[Item],
    least: int = 0,
) -> list[Result | None]:
    """`task` of the items in their order, `least` of them in any case; None for those that no time was left for."""
    if np.isinf(budget.seconds):
        return list(work.map(name, task, shared, items))
    results: list[Result | None] = []
    step = max(2 * work.n_workers, 1) if work.n_workers > 1 else 1
    while len(results) < len(items) and (len(results) < least or budget.left > 0):
        first = len(results)
        results += work.map(name, task, shared, items[first : first + step], first=first)
    return [*results, *[None] * (len(items) - len(results))]


def limit_fit(seconds: float) -> Progress | None:
    """The `progress` of a search that ends it with `TimeUpError` after so many seconds of this process."""
    if np.isinf(seconds):
        return None
    end = time.process_time() + seconds

    def stop_when_late(iteration: int, cost: float) -> None:
        if time.process_time() > end:
            raise TimeUpError(f"the fit was ended after {seconds:.3g} s of the processor and {iteration} iterations")

    return stop_when_late


def stopwatch() -> Callable[[], float]:
    """The processor time since now, in seconds, whenever it is asked for."""
    begun = processor_seconds()
    return lambda: processor_seconds() - begun

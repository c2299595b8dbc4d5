"""Progress of a run on stderr: a bar with the time left on a terminal, a line now and then where there is none."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

_LINE_SECONDS = 60.0


class RunProgress:
    """What is called by searches (`search`) and by repeated tasks (`tasks`), with words for both.

    Of a search only the most that is left is known, its limit of iterations; most end long before.

    Parameters
    ----------
    most_iterations : int
        Limit of the last stage.
    """

    def __init__(self, most_iterations: int) -> None:
        self.most_iterations = most_iterations
        self._begun: dict[str, tuple[float, int]] = {}

    def search(self, stage: str, iteration: int, cost: float) -> None:
        """After an iteration."""
        each = self._each(stage, iteration)
        most = (self.most_iterations - iteration) * each if iteration <= self.most_iterations else math.inf
        left = f", {clock(each)} each, at most {clock(most)} left" if each >= 0.1 and math.isfinite(most) else ""
        total = self.most_iterations if iteration <= self.most_iterations else None
        self.show(stage, iteration, total, f"{stage} search, sum of squares {cost:.5g}, iteration {iteration}{left}")

    def tasks(self, name: str, done: int, total: int) -> None:
        """After some tasks."""
        each = self._each(name, done)
        left = f", {clock((total - done) * each)} left" if each > 0 and done < total else ""
        self.show(name, done, total, f"{name}: {done} of {total}{left}")

    def _each(self, name: str, done: int) -> float:
        """Mean time of one since the first call, s; 0 while it is not known."""
        now = time.monotonic()
        if name not in self._begun or done < self._begun[name][1]:
            self._begun[name] = now, done
        begun, first = self._begun[name]
        return (now - begun) / (done - first) if done > first else 0.0

    def show(self, name: str, done: int, total: int | None, words: str) -> None:
        """Bring the words to the reader."""
        raise TypeError("`show` belongs to a terminal or to lines; use `run_progress`")


class _Bars(RunProgress):
    def __init__(self, most_iterations: int, bar: Progress) -> None:
        super().__init__(most_iterations)
        self._bar = bar
        self._tasks: dict[str, TaskID] = {"": bar.add_task("reading and checking", total=None)}

    def show(self, name: str, done: int, total: int | None, words: str) -> None:
        if name not in self._tasks:
            for task in self._tasks.values():
                self._bar.update(task, visible=False)
            self._tasks[name] = self._bar.add_task(name, total=total)
        self._bar.update(self._tasks[name], completed=done, total=total, description=words)


class _Lines(RunProgress):
    def __init__(self, most_iterations: int) -> None:
        super().__init__(most_iterations)
        self._shown = time.monotonic()

    def show(self, name: str, done: int, total: int | None, words: str) -> None:
        if time.monotonic() - self._shown >= _LINE_SECONDS:
            typer.echo(words, err=True)
            self._shown = time.monotonic()


@contextmanager
def run_progress(most_iterations: int) -> Iterator[RunProgress]:
    """The progress of a run: bars where stderr is a terminal, else one line a minute."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(most_iterations)
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        yield _Bars(most_iterations, bar)


def clock(seconds: float) -> str:
    """A duration in its own unit: 0.35 s, 12 s, 3:05 min, 2:10 h."""
    if seconds < 60:
        return f"{seconds:.2g} s"
    if seconds < 3600:
        return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"
    return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"

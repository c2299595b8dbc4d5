"""Output of the command line: text and tables on standard output, and the progress of a run on stderr.

Progress is a bar with the time left on a terminal, and a line now and then where there is none.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from structid.core.display import MOST_WARNINGS, first_warnings
from structid.core.json_types import StoredEntry

if TYPE_CHECKING:
    from structid.inversion import Identifiability

_WIDTH_OF_FILES = 1000
_MOST_GROUPS = 3


def show(parts: Iterable[RenderableType]) -> None:
    """Print `parts` on standard output, as wide as the terminal; 1000 characters wide if it is not a terminal."""
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, emoji=False, width=_WIDTH_OF_FILES)
    for part in parts:
        console.print(part)


def heading(title: str, warnings: Iterable[str], most: int = MOST_WARNINGS) -> list[RenderableType]:
    """Title and the first `most` warnings as styled texts."""
    return [Text(title, style="bold"), *(Text(words, style="yellow") for words in first_warnings(warnings, most))]


def new_table(*columns: str) -> Table:
    """Table without lines, with these column headings; text in its first column is wrapped, in others it may be cut."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for i, column in enumerate(columns):
        table.add_column(column, overflow="fold" if i == 0 else "ellipsis")
    return table


def groups(identifiability: Identifiability) -> list[RenderableType]:
    """Texts on the worst determined groups of parameters that the data see together; [] if there are none."""
    return [Text(group.words) for group in identifiability.groups[:_MOST_GROUPS]]


_LINE_SECONDS = 60.0
#: Part of the time left, and seconds of it at least, by which an estimate of the end may be off before it is set anew.
_MOVES, _MOVES_SECONDS = 0.25, 10.0
#: Of a file of progress: parameters whose values it holds at most, lines until it leaves some out, and the time between them
#: then, s.
_MOST_VALUES, _ALL_LINES, _FILE_SECONDS = 400, 200, 0.2

#: Brings to the reader what is done: name of the task, done, total (None where it is not known), and the words.
ShowProgress = Callable[[str, int, int | None, str], None]


class ProgressFile:
    """Progress for programs that watch: a JSON object a line, with the values of the parameters where they are not many.

    Parameters
    ----------
    path : Path
        Lines are added to it.
    reached : callable
        Gives ``parameters``, see `Reached.summary`.
    """

    def __init__(self, path: Path, reached: Callable[[], Mapping[str, StoredEntry]]) -> None:
        self.path, self.reached = path, reached
        self._written, self._lines = 0.0, 0
        path.touch()

    def write(self, name: str, done: int, total: int | None, words: str, cost: float | None = None) -> None:
        """Append a JSON line on the task `name`; with a finite `cost` it also holds sum of squares and parameters.

        `done` of `total` steps are finished (`total` None if unknown), `words` describe the state. After 200 lines,
        lines less than 0.2 s apart are left out, except at the first and the last step. Above 400 parameters the list
        is empty. An error of the system is ignored.
        """
        now = time.time()
        if self._lines >= _ALL_LINES and now - self._written < _FILE_SECONDS and done not in (1, total):
            return
        self._written = now
        self._lines += 1
        line: dict[str, StoredEntry] = {"time": now, "name": name, "done": done, "total": total, "words": words}
        if cost is not None and math.isfinite(cost):
            parameters = self.reached().get("parameters")
            are_few = isinstance(parameters, list) and len(parameters) <= _MOST_VALUES
            line |= {"sum_of_squares": cost, "parameters": parameters if are_few else []}
        with suppress(OSError), self.path.open("a", encoding="utf-8") as stream:  # a full disk does not end the search
            stream.write(json.dumps(line) + "\n")


class RunProgress:
    """Progress of a run: callbacks of searches (`search`) and of repeated tasks (`tasks`), with words for both.

    Nobody knows how many iterations a search takes, so that no end is told of it. That of tasks counts down: it is set
    anew only where the pace of the tasks moves it by a quarter of what is left.
    """

    def __init__(self, most_iterations: int, show: ShowProgress) -> None:
        """Progress of a run whose searches have at most `most_iterations` iterations.

        `show` is called with name, steps done, steps in all (None if unknown) and words, to bring them to the reader.
        `file` can be set to keep them in a file too.
        """
        self.most_iterations = most_iterations
        self.show = show
        self.file: ProgressFile | None = None
        self._begun: dict[str, tuple[float, int]] = {}
        self._ends: dict[str, float] = {}

    def search(self, stage: str, iteration: int, cost: float) -> None:
        """Report iteration number `iteration` of the search stage `stage`, and its sum of squares `cost`.

        The words have the mean time of an iteration if that is 1 s or more.
        """
        each = self._seconds_each(stage, iteration)
        pace = f", {clock(each)} each" if each >= 1 else ""
        total = self.most_iterations if iteration <= self.most_iterations else None
        self._tell(stage, iteration, total, f"{stage}: iteration {iteration}{pace}, misfit {cost:.4g}", cost)

    def tasks(self, name: str, done: int, total: int) -> None:
        """Report that `done` of `total` tasks called `name` are finished, with an estimate of the time left."""
        left = self._remaining_seconds(name, done, total)
        words = f", about {clock(left)} left" if left >= 1 and done < total else ""
        self._tell(name, done, total, f"{name}: {done} of {total}{words}")

    def _remaining_seconds(self, name: str, done: int, total: int) -> float:
        """Estimated time (s) until all `total` tasks called `name` are finished, `done` of which are; 0 if unknown.

        The estimated end is kept until the pace moves it by more than a quarter of the time left, or 2.5 s if that is more.
        """
        each, now = self._seconds_each(name, done), time.monotonic()
        if each == 0:
            return 0.0
        end = now + (total - done) * each
        before = self._ends.get(name)
        if before is None or abs(end - before) > _MOVES * max(before - now, _MOVES_SECONDS):
            self._ends[name] = end
        return max(self._ends[name] - now, 0.0)

    def _tell(self, name: str, done: int, total: int | None, words: str, cost: float | None = None) -> None:
        self.show(name, done, total, words)
        if self.file is not None:
            self.file.write(name, done, total, words, cost)

    def _seconds_each(self, name: str, done: int) -> float:
        """Mean time (s) of a task or iteration called `name` since its first report; 0 if unknown.

        `done` is the number of finished ones.
        """
        now = time.monotonic()
        if name not in self._begun or done < self._begun[name][1]:
            self._begun[name] = now, done
        begun, first = self._begun[name]
        return (now - begun) / (done - first) if done > first else 0.0


@contextmanager
def run_progress(most_iterations: int) -> Iterator[RunProgress]:
    """Context manager that yields the progress of a run: a bar if stderr is a terminal, else at most one line a minute.

    `most_iterations` is the limit of iterations of a search.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield RunProgress(most_iterations, _lines())
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=20), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        yield RunProgress(most_iterations, _bars(bar))


def _bars(bar: Progress) -> ShowProgress:
    """Function that shows progress as one bar of `bar` on a terminal, that of the task that was named last.

    Until its first call the bar says that the study is read and checked.
    """
    tasks: dict[str, TaskID] = {"": bar.add_task("reading and checking", total=None)}
    steps: dict[str, int] = {}
    shown = ""

    def show(name: str, done: int, total: int | None, words: str) -> None:
        """Show and update the bar of the task `name`, and hide that of another task.

        `done` of `total` steps are finished (`total` None if unknown); `words` are the text of the bar. The clock of a
        task starts anew where fewer steps are finished than before.
        """
        nonlocal shown
        if name not in tasks:
            tasks[name] = bar.add_task(name, total=total)
        elif done < steps[name]:
            bar.reset(tasks[name])
        if name != shown:
            bar.update(tasks[shown], visible=False)
        shown, steps[name] = name, done
        bar.update(tasks[name], completed=done, total=total, description=words, visible=True)

    return show


def _lines() -> ShowProgress:
    """Function that prints the words of a progress report on stderr, if the last line is at least 60 s old.

    The first line comes 60 s after this call at the earliest.
    """
    shown = time.monotonic()

    def show(_name: str, _done: int, _total: int | None, words: str) -> None:
        """Print `words` on stderr if the last line is at least 60 s old; the other arguments are not used."""
        nonlocal shown
        if time.monotonic() - shown >= _LINE_SECONDS:
            typer.echo(words, err=True)
            shown = time.monotonic()

    return show


def clock(seconds: float) -> str:
    """Duration `seconds` as text in a suitable unit: 0.35 s, 12 s, 3:05 min, 2:10 h."""
    if seconds < 60:
        return f"{seconds:.2g} s"
    if seconds < 3600:
        return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"
    return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d} h"

"""The command `structid reproduce`: the dissertation's tables and figures beside computed ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

from structid.cli.tables import new_table, number, show
from structid.report.reproduce.page import write_reproduction
from structid.reproduce import run
from structid.reproduce.item import Item


def reproduce(
    chapter: Annotated[int | None, typer.Option("--chapter", metavar="N", help="3, 4 or 5 [default: all].")] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Results folder.")] = Path("reproduction"),
) -> None:
    """Compute the tables and figures of the dissertation beside the printed numbers, with a verdict for each.

    Writes reproduction.html, reproduction.json and the figures as PNG files. It takes a few minutes.

    \b
    Examples:
      structid reproduce
      structid reproduce --chapter 4 --out chapter_4
    """
    with _progress() as progress:
        items = run.reproduce(run.CHAPTERS if chapter is None else (chapter,), progress)
    page = write_reproduction(items, out)
    show(_summary(items))
    typer.echo(str(page))


def _summary(items: Iterable[Item]) -> list[RenderableType]:
    """Verdict and largest difference of every table and figure."""
    table = new_table("item", "verdict", "largest difference", "title")
    for item in items:
        largest = item.max_abs_difference
        table.add_row(item.name, item.verdict.value, "-" if largest is None else number(largest, 2), item.title)
    return [table]


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None] | None]:
    """A bar on stderr that names the table or figure in work, where stderr is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda name, done: bar.update(task, completed=done, description=name)

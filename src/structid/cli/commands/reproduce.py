"""The command `structid reproduce`: the dissertation's tables and figures beside computed ones."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.base import Png, say

if TYPE_CHECKING:
    from rich.console import RenderableType

    from structid.reproduce.reproduction import ReproducedItem


def reproduce(
    chapter: Annotated[int | None, typer.Option("--chapter", metavar="N", help="3, 4 or 5 [default: all].")] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Results folder.")] = Path("reproduction"),
    png: Png = False,
) -> None:
    """Compute the tables and figures of the dissertation beside the printed numbers, with a verdict for each.

    Writes reproduction.html and reproduction.json. It takes a few minutes.

    \b
    Examples:
      structid reproduce
      structid reproduce --chapter 4 --out chapter_4
    """
    from structid.cli.console import run_progress, show  # the help needs none of these
    from structid.report.reproduce import write_reproduction
    from structid.reproduce import reproduction

    with run_progress(0) as progress:
        chapters = reproduction.CHAPTERS if chapter is None else (chapter,)
        items = reproduction.reproduce(chapters, lambda name, done: progress.tasks(name, round(100 * done), 100))
    page = write_reproduction(items, out, png)
    show(_summary(items))
    say(page)


def _summary(items: Iterable[ReproducedItem]) -> list[RenderableType]:
    """Table of all items with verdict and largest difference between computed and printed numbers, in a list."""
    from structid.cli.console import new_table
    from structid.core.display import format_number

    table = new_table("item", "verdict", "largest difference", "title")
    for item in items:
        largest = item.max_abs_difference
        table.add_row(item.name, item.verdict.value, "-" if largest is None else format_number(largest, 2), item.title)
    return [table]

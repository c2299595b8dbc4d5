"""Printing on the command line: rich text and tables on standard output."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from structid.core.display import MOST_WARNINGS, first_warnings
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
    """The groups of parameters that the data see together, the worst determined ones, in words."""
    return [Text(group.words) for group in identifiability.groups[:_MOST_GROUPS]]

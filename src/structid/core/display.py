"""Display of objects in Python and notebooks: a line and a short table instead of all arrays."""

from __future__ import annotations

import difflib
import html
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from structid.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from numpy.typing import ArrayLike

#: Rows that are shown; the table says how many more there are.
_MOST_ROWS = 30
#: Warnings that a terminal shows at once.
MOST_WARNINGS = 5


@dataclass(frozen=True)
class Overview:
    """A line, and a table below it.

    Attributes
    ----------
    words : str
    header : sequence of str
    rows : sequence of sequences of str
    """

    words: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


class Shown(ABC):
    """An object with an `overview`: its ``repr``, its table in notebooks, and `summary` as text."""

    @abstractmethod
    def overview(self) -> Overview:
        """The line and the table that describe the object."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.overview().words}>"

    def __str__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """The overview as plain text: the line, then the whole table in aligned columns."""
        shown = self.overview()
        lines = [list(shown.header), *map(list, shown.rows)] if shown.rows else []
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) for line in lines]
        return "\n".join([shown.words, *(line.rstrip() for line in table)])

    def _repr_html_(self) -> str:
        """The overview as HTML for notebooks: class and line, then the first rows of the table.

        A last line says how many rows are left out, if any.
        """
        shown = self.overview()
        first, more = shown.rows[:_MOST_ROWS], len(shown.rows) - _MOST_ROWS
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in shown.header)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in first)
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if first else ""
        rest = f"<p>and {more} more</p>" if more > 0 else ""
        return f"<p><b>{type(self).__name__}</b>: {html.escape(shown.words)}</p>{table}{rest}"


def format_number(value: float, digits: int = 5) -> str:
    """`value` as text with `digits` significant digits; "-" for NaN."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "-" if math.isnan(value) else str(value)


def plural(count: int, noun: str) -> str:
    """`count` and `noun` as text, such as ``1 mode``, ``3 modes`` or ``3 frequencies``."""
    if count == 1:
        return f"{count} {noun}"
    return f"{count} {noun[:-1]}ies" if noun.endswith("y") and noun[-2:-1] not in "aeou" else f"{count} {noun}s"


def join_words(items: Sequence[object], most: int = 6) -> str:
    """The first `most` items joined by commas, and how many more there are."""
    more = len(items) - most
    return ", ".join(map(str, items[:most])) + (f" and {more} more" if more > 0 else "")


def names_like(text: str, names: Sequence[str]) -> list[str]:
    """At most three of `names` that `text` may stand for: those that begin with it in any case, then those spelled alike.

    The list is empty where no name is like it.
    """
    begin = [name for name in names if text and name.lower().startswith(text.lower())]
    return list(dict.fromkeys([*begin, *difflib.get_close_matches(text, names)]))[:3]


def as_sentence(words: str) -> str:
    """The clause `words` as a sentence: a capital if the first word has letters only, and a full stop at its end."""
    first = words.split(" ", 1)[0]
    start = words[0].upper() + words[1:] if first.isalpha() else words
    return start if start.endswith((".", "?", "!")) else f"{start}."


def file_names(paths: Sequence[str | Path]) -> list[str]:
    """A name for each file: its last path component, or its path where two files share one."""
    names = [Path(path).name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def first_warnings(warnings: Iterable[str], most: int = MOST_WARNINGS) -> list[str]:
    """The first `most` warnings as plain lines ``warning: ...``, then a line with the number of the others, if any."""
    texts = list(warnings)
    more = len(texts) - most
    note = [f"{plural(more, 'more warning')}: in the results"] if more > 0 else []
    return [*(f"warning: {words}" for words in texts[:most]), *note]


def data_array(
    values: ArrayLike, axes: Mapping[str, Iterable[object]], name: str, about: Mapping[str, object]
) -> xr.DataArray:
    """`values` as an ``xarray.DataArray`` with labelled axes, a `name` and attributes.

    `axes` maps the name of each axis, in order, to its labels; `about` maps the names of attributes to their values.

    Raises
    ------
    InputError
        If xarray is missing.
    """
    try:
        import xarray
    except ImportError as error:
        raise InputError("`xarray` must be installed for labelled arrays; `pip install 'structid[tables]'`") from error
    labels = {axis: list(entries) for axis, entries in axes.items()}
    return xarray.DataArray(values, labels, tuple(axes), name, dict(about))


def data_frame(columns: Mapping[str, Iterable[object]], index: str) -> pd.DataFrame:
    """A ``pandas.DataFrame`` of `columns`, sequences of equal length by name; that called `index` becomes its index.

    Raises
    ------
    InputError
        If pandas is missing.
    """
    try:
        import pandas
    except ImportError as error:
        raise InputError("`pandas` must be installed for data frames; `pip install 'structid[tables]'`") from error
    return pandas.DataFrame(dict(columns)).set_index(index)

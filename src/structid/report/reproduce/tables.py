"""Tables of a reproduced item as text: printed, computed and difference side by side, with the printed digits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.report.text import MINUS, NOTHING, number, unit_text
from structid.reproduce.item import Table

_MORE_DECIMALS = 2


@dataclass(frozen=True)
class TableText:
    """A table ready for a page.

    Attributes
    ----------
    groups : tuple of (str, int)
        Heading of each column of the source, and how many columns of text it has: 3 where something is printed.
    subheadings : tuple of str
        Of each column of text; empty where a group has one.
    rows : tuple of (str, tuple of str)
        Label and cells.
    """

    groups: tuple[tuple[str, int], ...]
    subheadings: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


def table_text(table: Table) -> TableText:
    """`table` as text; a single row of many whole numbers is turned upright."""
    whole = bool(np.isfinite(table.printed).all()) and _is_whole(table.printed)
    if whole and len(table.rows) == 1 and len(table.columns) > 3:
        table = Table(table.columns, table.rows, table.printed.T, table.computed.T)
    groups, subheadings, columns = [], [], []
    for j, heading in enumerate(table.columns):
        printed, computed = table.printed[:, j], table.computed[:, j]
        if not np.isfinite(printed).any():
            groups.append((unit_text(heading), 1))
            subheadings.append("")
            columns.append([_whole(value) for value in computed.tolist()])
            continue
        groups.append((unit_text(heading), 3))
        subheadings += ["printed", "computed", "difference"]
        digits = _Digits.of(printed)
        columns.append([digits.text(value) for value in printed.tolist()])
        more = 0 if digits.decimals == 0 and _is_whole(computed) else _MORE_DECIMALS
        columns.append([digits.text(value, more) for value in computed.tolist()])
        columns.append([_signed(value) for value in table.difference[:, j].tolist()])
    cells = zip(*columns, strict=True) if columns else [()] * len(table.rows)
    rows = zip(map(unit_text, table.rows), cells, strict=True)
    return TableText(tuple(groups), tuple(subheadings), tuple(rows))


def _is_whole(values: FloatArray) -> bool:
    finite = values[np.isfinite(values)]
    return bool((np.abs(finite - np.round(finite)) < 1e-9).all())


@dataclass(frozen=True)
class _Digits:
    """How a column is printed: with so many decimals, or so many significant digits where they are too many."""

    decimals: int
    significant: int
    fixed: bool

    @classmethod
    def of(cls, printed: FloatArray) -> _Digits:
        given = [float(value) for value in printed[np.isfinite(printed)]]
        digits = [np.format_float_positional(value, unique=True, trim="-") for value in given]
        decimals = max(len(text.partition(".")[2]) for text in digits)
        significant = max(len(np.format_float_scientific(v, trim="-").partition("e")[0].strip("-")) for v in given)
        return cls(decimals, max(significant - 1, 1), decimals <= 7 and max(map(abs, given)) < 1e7)

    def text(self, value: float, more: int = 0) -> str:
        """`value` with the digits of the column, and `more` after them."""
        if not np.isfinite(value) or not self.fixed or abs(value) >= 1e9:
            return number(value, self.significant + more)
        decimals = self.decimals + more
        return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)


def _whole(value: float) -> str:
    """A number of its own: an integer as it is, another one with four digits."""
    if np.isfinite(value) and value == round(value) and abs(value) < 1e5:
        return f"{value:.0f}".replace("-", MINUS)
    return number(value)


def _signed(value: float) -> str:
    """A difference with its sign, to two digits."""
    if not np.isfinite(value):
        return NOTHING
    if value == 0:
        return "0"
    sign = "+" if value > 0 else MINUS
    return sign + number(abs(value), 2)

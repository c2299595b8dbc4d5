"""Tables of text, on pages and on a terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import rich.table

_MANY = 24


@dataclass(frozen=True)
class Table:
    """Header and rows of text; `numeric` columns are set flush right, `marks` are CSS classes of rows."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()
    marks: tuple[str, ...] = ()

    @property
    def is_long(self) -> bool:
        """True if it is long enough to be folded away."""
        return len(self.rows) > _MANY

    def first(self, count: int) -> Table:
        """Copy of the table with its first `count` rows."""
        return replace(self, rows=self.rows[:count], marks=self.marks[:count])

    def after(self, count: int) -> Table:
        """Copy of the table without its first `count` rows."""
        return replace(self, rows=self.rows[count:], marks=self.marks[count:])


def printed(table: Table) -> rich.table.Table:
    """Rich table for the terminal with the header and rows of `table`."""
    drawn = rich.table.Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for column in table.header:
        drawn.add_column(column, overflow="fold")
    for row in table.rows:
        drawn.add_row(*row)
    return drawn


def provenance_table(provenance: Mapping[str, object] | None) -> Table:
    """Table of provenance: a row for each version, input file and setting, one for all settings that were not given.

    `provenance` maps headings to a value, or to a mapping of names to values in which None stands for a setting that was not
    given. Without provenance the table has no rows.
    """
    rows: list[tuple[str, str]] = []
    for name, value in (provenance or {}).items():
        label = str(name).replace("_", " ")
        if isinstance(value, Mapping):
            rows.extend((f"{label}: {key}", _text(inner)) for key, inner in value.items() if inner is not None)
            if absent := [str(key).replace("_", " ") for key, inner in value.items() if inner is None]:
                rows.append((f"{label}: not given", ", ".join(absent)))
        else:
            rows.append((label, _text(value)))
    return Table(("Origin", "Value"), tuple(rows))


def _text(value: object) -> str:
    """Text of a setting: "none" for None and "", a text as it is, JSON for all else."""
    if value is None or value == "":
        return "none"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, sort_keys=True, default=str)

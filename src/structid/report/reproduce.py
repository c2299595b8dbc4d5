"""The reproduction: one page with every table and figure, printed beside computed, and its numbers as JSON."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from structid._version import __version__
from structid.core.arrays import FloatArray
from structid.core.display import MINUS, NOTHING, number, unit_text
from structid.core.json_types import JsonValue, json_text, plain
from structid.files import atomic_write, make_folder
from structid.report.drawing import palette, symbols
from structid.report.page import Page
from structid.report.rendering import plot
from structid.reproduce.reproduction import Curve, Panel, ReproducedItem, Table, Verdict

_CLASSES = {
    Verdict.AGREES: "agrees",
    Verdict.MISPRINT: "misprint",
    Verdict.READING: "reading",
    Verdict.REFUTED: "refuted",
}
#: Digits of the numbers in the JSON file; later ones depend on the machine.
_JSON_DIGITS = 10
_MORE_DECIMALS = 2
_SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x", "star")
_DASHES: tuple[Literal["solid", "dash", "dot"], ...] = ("solid", "dash", "dot")
#: Curves with more points than this have no markers.
_MOST_MARKED = 40


def write_reproduction(items: Sequence[ReproducedItem], folder: Path, png: bool = False) -> Path:
    """Write ``reproduction.html`` and ``reproduction.json`` into `folder`, and return the path of the page.

    Parameters
    ----------
    items : sequence of ReproducedItem
        Published results with the values computed here.
    folder : Path
        Created if missing. Files of the same names are replaced, each whole or not at all; other files stay.
    png : bool
        True to write the figures as PNG files too, into ``figures``.

    Returns
    -------
    Path
        The page. The same items give the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    folder = make_folder(Path(folder))
    with atomic_write(folder / "reproduction.json") as temporary:
        temporary.write_text(json_text(reproduction_summary(items)), encoding="utf-8")
    return reproduction_page(items).write(folder, png)


def reproduction_summary(items: Sequence[ReproducedItem]) -> dict[str, JsonValue]:
    """The content of reproduction.json: ``structid``, the version, and ``items``; see `_item_summary`."""
    return {"structid": __version__, "items": [_item_summary(item) for item in items]}


def _item_summary(item: ReproducedItem) -> dict[str, JsonValue]:
    """Content of reproduction.json for one item.

    Keys: ``item``, ``title``, ``verdict``, ``note``, ``max_abs_difference``, ``supporting_tables``, ``panels``, and those
    of the fields of the first `Table`, such as ``printed`` and ``computed``, row by row.
    """
    blank: dict[str, JsonValue] = {"rows": [], "columns": [], "printed": [], "computed": []}
    return {
        "item": item.name,
        "title": item.title,
        "verdict": item.verdict.value,
        "note": item.note,
        "max_abs_difference": _rounded(item.max_abs_difference),
        **(_rounded_fields(item.tables[0]) if item.tables else blank),
        "supporting_tables": [_rounded_fields(table) for table in item.tables[1:]],
        "panels": [
            {
                "title": panel.title,
                "x_label": panel.x_label,
                "y_label": panel.y_label,
                "curves": [_rounded_fields(curve) for curve in panel.curves],
            }
            for panel in item.panels
        ],
    }


def _rounded_fields(part: Table | Curve) -> dict[str, JsonValue]:
    """Fields of a table or a curve that are not None, rounded."""
    return {name: _rounded(plain(value)) for name, value in asdict(part).items() if value is not None}


def _rounded(value: JsonValue) -> JsonValue:
    """A number, or the numbers in nested lists, rounded to the digits of the JSON file; other values are unchanged."""
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_JSON_DIGITS}g}") if isinstance(value, float) else value


def reproduction_page(items: Sequence[ReproducedItem]) -> Page:
    """Report page of reproduced published results, with its figures."""
    counts = [(verdict, sum(item.verdict is verdict for item in items)) for verdict in Verdict]
    words = {
        "counts": [(verdict.value, _CLASSES[verdict], count) for verdict, count in counts if count],
        "items": [_item_view(item) for item in items],
    }
    figures = {_slug(item): panels_figure(item.panels) for item in items if item.panels}
    return Page("reproduction.html", "reproduction.html.j2", figures, words)


def _item_view(item: ReproducedItem) -> dict[str, object]:
    """Template values for one reproduced result: title, verdict, largest difference, paragraphs and tables."""
    largest = item.max_abs_difference
    return {
        "slug": _slug(item),
        "name": item.name,
        "title": item.title,
        "verdict": item.verdict.value,
        "badge": _CLASSES[item.verdict],
        "difference": NOTHING if largest is None else number(largest, 2),
        "paragraphs": [unit_text(part) for part in item.note.split("\n") if part.strip()],
        "tables": [table_text(table) for table in item.tables],
    }


def _slug(item: ReproducedItem) -> str:
    """Name of `item` in files and links: lower case, and one underscore for what is no letter or digit."""
    return re.sub(r"\W+", "_", item.name.lower()).strip("_")


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
    """Table of printed and computed values as text.

    Each column becomes three, printed, computed and difference, or one if nothing is printed for it. Computed values
    have two more decimals than printed ones, unless all of the column are integers. A single row of more than three
    integers is transposed.
    """
    whole = bool(np.isfinite(table.printed).all()) and _is_whole(table.printed)
    if whole and len(table.rows) == 1 and len(table.columns) > 3:
        table = Table(table.columns, table.rows, table.printed.T, table.computed.T)
    groups, subheadings, columns = [], [], []
    for j, heading in enumerate(table.columns):
        printed, computed = table.printed[:, j], table.computed[:, j]
        if not np.isfinite(printed).any():
            groups.append((unit_text(heading), 1))
            subheadings.append("")
            columns.append([_unpaired_text(value) for value in computed.tolist()])
            continue
        groups.append((unit_text(heading), 3))
        subheadings += ["printed", "computed", "difference"]
        digits = _Digits.of(printed)
        columns.append([digits.text(value) for value in printed.tolist()])
        more = 0 if digits.decimals == 0 and _is_whole(computed) else _MORE_DECIMALS
        columns.append([digits.text(value, more) for value in computed.tolist()])
        columns.append([_difference_text(value) for value in table.difference[:, j].tolist()])
    cells = zip(*columns, strict=True) if columns else [()] * len(table.rows)
    rows = zip(map(unit_text, table.rows), cells, strict=True)
    return TableText(tuple(groups), tuple(subheadings), tuple(rows))


def _is_whole(values: FloatArray) -> bool:
    finite = values[np.isfinite(values)]
    return bool((np.abs(finite - np.round(finite)) < 1e-9).all())


@dataclass(frozen=True)
class _Digits:
    """Number format of a column: decimals, or significant digits where the decimals would be too many."""

    decimals: int
    significant: int
    fixed: bool

    @classmethod
    def of(cls, printed: FloatArray) -> _Digits:
        """Number format of a table column: the most decimals and significant digits among its `printed` values, (n,).

        Decimals are fixed if there are at most 7 of them and all values are below 1e7. Values that are not finite are
        ignored; at least one must be finite.
        """
        given = [float(value) for value in printed[np.isfinite(printed)]]
        digits = [np.format_float_positional(value, unique=True, trim="-") for value in given]
        decimals = max(len(text.partition(".")[2]) for text in digits)
        significant = max(len(np.format_float_scientific(v, trim="-").partition("e")[0].strip("-")) for v in given)
        return cls(decimals, max(significant - 1, 1), decimals <= 7 and max(map(abs, given)) < 1e7)

    def text(self, value: float, more: int = 0) -> str:
        """Text of `value` in the format of the column, with `more` further digits.

        It has the decimals of the column, or its significant digits if these are used instead (`self.fixed` is False),
        and for values of 1e9 or more; a dash if the value is not finite.
        """
        if not np.isfinite(value) or not self.fixed or abs(value) >= 1e9:
            return number(value, self.significant + more)
        decimals = self.decimals + more
        return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)


def _unpaired_text(value: float) -> str:
    """Text of `value` without a printed partner: whole numbers below 1e5 with all digits, others with four digits."""
    if np.isfinite(value) and value == round(value) and abs(value) < 1e5:
        return f"{value:.0f}".replace("-", MINUS)
    return number(value)


def _difference_text(value: float) -> str:
    """Text of the difference `value` with its sign and two significant digits; "0" for 0, a dash if not finite."""
    if not np.isfinite(value):
        return NOTHING
    if value == 0:
        return "0"
    sign = "+" if value > 0 else MINUS
    return sign + number(abs(value), 2)


def panels_figure(panels: tuple[Panel, ...]) -> plot.Figure:
    """Figure of reproduced panels, at most two in a row; curves of one label have the same colour in all panels.

    Labels are those of the legend, with the words on a band if the curve has one.
    """
    columns = min(2, len(panels))
    labels = list(dict.fromkeys(_label(curve) for panel in panels for curve in panel.curves))
    shown = tuple(_panel(panel, labels) for panel in panels)
    return plot.Figure(shown, (525.0 if columns == 2 else 750.0, 340.0), columns)


def _panel(panel: Panel, labels: list[str]) -> plot.Panel:
    """Plot panel of the curves of `panel`, with bands and axes; `labels` sets the order of colours."""
    log = panel.log_y and any((_finite(curve.y) > 0).any() for curve in panel.curves)
    ends = [values for curve in panel.curves for values in (curve.y, curve.low, curve.high) if values is not None]
    drawn = np.abs(np.concatenate([_drawable(values, log) for values in ends]))
    highest = float(np.nanmax(drawn, initial=0.0)) or 1.0
    bands = [_band(c, labels.index(_label(c)), log, highest) for c in panel.curves if c.low is not None]
    curves = [_curve(c, labels.index(_label(c)), below, log) for below, c in enumerate(panel.curves)]
    y = plot.Axis(panel.y_label, limits=plot.decade_limits(drawn) if log else None, log=log)
    is_plan = panel.x_label.startswith("x (") and panel.y_label.startswith("y (")
    return replace(plot.panel(_x_axis(panel), y, *bands, *curves, title=panel.title), equal=is_plan)


def _x_axis(panel: Panel) -> plot.Axis:
    """Horizontal axis of a panel: logarithmic for 3 to 12 points over more than two decades, integer ticks for integers."""
    points = np.unique(np.concatenate([np.asarray(curve.x, dtype=np.float64) for curve in panel.curves]))
    first, last = float(points[0]), float(points[-1])
    if 3 <= len(points) <= 12 and first > 0 and last > 100 * first:
        return plot.Axis(panel.x_label, log=True, ticks=tuple((x, f"{x:g}") for x in points.tolist()))
    is_whole = np.array_equal(points, np.round(points)) and last > first
    return plot.Axis(panel.x_label, ticks=plot.whole_ticks(int(first), int(last), 10) if is_whole else ())


def _curve(curve: Curve, index: int, below: int, log: bool) -> plot.Curve:
    """Plot curve with colour, dash and symbol number `index`, drawn thinner the more curves lie `below` it.

    Symbols are drawn for up to 40 points. `log` is True for a logarithmic axis, where values of 0 and less are gaps.
    """
    colour = palette.CYCLE[index % len(palette.CYCLE)]
    pen = plot.Pen(colour, max(1.7, 4.4 - 1.4 * below), _DASHES[index // len(palette.CYCLE) % len(_DASHES)])
    sign = plot.Marker(_SYMBOLS[index % len(_SYMBOLS)], max(4.9, 9.7 - 2.1 * below), colour)
    marker = sign if len(curve.x) <= _MOST_MARKED else None
    return plot.Curve(
        np.asarray(curve.x, dtype=float), _drawable(curve.y, log), pen, marker, _label(curve), plot.NUMBERS
    )


def _band(curve: Curve, index: int, log: bool, highest: float) -> plot.Area:
    """Filled area between the low and the high end of a curve, in the colour number `index`; a missing end is the curve.

    `log` is True for a logarithmic axis. Infinite ends are drawn at the value `highest`.
    """
    ends = (curve.y if end is None else end for end in (curve.low, curve.high))
    low, high = (_drawable(np.where(np.isposinf(end), highest, end), log) for end in ends)
    x, gaps = np.asarray(curve.x, dtype=float), np.isnan(low + high)
    outlines = []
    for stretch in np.split(np.arange(len(x)), np.flatnonzero(gaps)):
        run = stretch[~gaps[stretch]]
        there_and_back = np.concatenate([run, run[::-1], run[:1]])
        outlines.append(np.column_stack([x[there_and_back], np.concatenate([low[run], high[run[::-1]], low[run[:1]]])]))
    shown = symbols.joined(outline for outline in outlines if len(outline))
    return plot.Area(shown[:, 0], shown[:, 1], palette.CYCLE[index % len(palette.CYCLE)], 0.18)


def _label(curve: Curve) -> str:
    """Legend text of a curve, with the words "5-95 % band" if it has both ends of a band.

    "median" is added before these words if the label does not have it.
    """
    if curve.low is None or curve.high is None:
        return curve.label
    middle = "" if "median" in curve.label else "median, "
    return f"{curve.label} ({middle}5\N{EN DASH}95 % band)"


def _drawable(values: FloatArray, log: bool) -> FloatArray:
    """Copy of `values`, in their shape, with NaN for what cannot be drawn: not finite, or not positive if `log`."""
    finite = _finite(values)
    return np.where(finite > 0, finite, np.nan) if log else finite


def _finite(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(values), values, np.nan)

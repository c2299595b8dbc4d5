"""The reproduction: one page with every table and figure, and its numbers as JSON."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from structid._version import __version__
from structid.files import atomic_write, made_folder
from structid.plain import Plain, json_text, plain
from structid.report.figures.reproduction import panels_figure
from structid.report.page import Page
from structid.report.reproduce.tables import table_text
from structid.report.text import NOTHING, number, unit_text
from structid.reproduce.item import Curve, Item, Table, Verdict

_CLASSES = {
    Verdict.AGREES: "agrees",
    Verdict.MISPRINT: "misprint",
    Verdict.READING: "reading",
    Verdict.REFUTED: "refuted",
}
#: Digits of the numbers in the JSON file; later ones depend on the machine.
_JSON_DIGITS = 10


def write_reproduction(items: Sequence[Item], folder: Path, png: bool = False) -> Path:
    """Path of ``reproduction.html`` in `folder`, written with ``reproduction.json``.

    Parameters
    ----------
    items : sequence of Item
    folder : Path
        Made where it does not exist. Files of the same names are replaced, each whole or not at all; other files stay.
    png : bool
        Whether the figures are written as PNG files too, in ``figures``.

    Returns
    -------
    Path
        The page. The same items give the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    folder = made_folder(Path(folder))
    with atomic_write(folder / "reproduction.json") as temporary:
        temporary.write_text(json_text(reproduction_summary(items)), encoding="utf-8")
    return reproduction_page(items).write(folder, png)


def reproduction_summary(items: Sequence[Item]) -> dict[str, Plain]:
    """The content of reproduction.json: `printed` and `computed` are those of the first table, row by row."""
    return {"structid": __version__, "items": [_item_summary(item) for item in items]}


def _item_summary(item: Item) -> dict[str, Plain]:
    blank: dict[str, Plain] = {"rows": [], "columns": [], "printed": [], "computed": []}
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


def _rounded_fields(part: Table | Curve) -> dict[str, Plain]:
    """What is known of a table or a curve."""
    return {name: _rounded(plain(value)) for name, value in asdict(part).items() if value is not None}


def _rounded(value: Plain) -> Plain:
    """Numbers, also in lists, to the digits of the JSON file."""
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_JSON_DIGITS}g}") if isinstance(value, float) else value


def reproduction_page(items: Sequence[Item]) -> Page:
    """The page and its figures."""
    counts = [(verdict, sum(item.verdict is verdict for item in items)) for verdict in Verdict]
    words = {
        "counts": [(verdict.value, _CLASSES[verdict], count) for verdict, count in counts if count],
        "items": [_item_view(item) for item in items],
    }
    figures = {_slug(item): panels_figure(item.panels) for item in items if item.panels}
    return Page("reproduction.html", "reproduction.html.j2", figures, words)


def _item_view(item: Item) -> dict[str, object]:
    """What the template shows of an item."""
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


def _slug(item: Item) -> str:
    """Name of `item` in files and links: lower case, and one underscore for what is no letter or digit."""
    return re.sub(r"\W+", "_", item.name.lower()).strip("_")

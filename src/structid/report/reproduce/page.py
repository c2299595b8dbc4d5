"""The reproduction: one page with every table and figure, its numbers as JSON, its figures as PNG files."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from structid._version import __version__
from structid.files import atomic_write, made_folder
from structid.report.page_template import page_template
from structid.report.reproduce.figures import panels_png
from structid.report.reproduce.tables import table_text
from structid.report.text import NOTHING, number, unit_text
from structid.reproduce.item import Curve, Item, Table, Verdict
from structid.study.results.folder import json_text

_CLASSES = {
    Verdict.AGREES: "agrees",
    Verdict.MISPRINT: "misprint",
    Verdict.READING: "reading",
    Verdict.REFUTED: "refuted",
}
#: Digits of the numbers in the JSON file; later ones depend on the machine.
_JSON_DIGITS = 10


def write_reproduction(items: Sequence[Item], folder: Path) -> Path:
    """Path of ``reproduction.html`` in `folder`, written with ``reproduction.json`` and the PNG files in ``figures``.

    Parameters
    ----------
    items : sequence of Item
    folder : Path
        Made where it does not exist. Files of the same names are replaced, each whole or not at all, once all of
        them are drawn; other files stay.

    Returns
    -------
    Path
        The page. The same items give the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    folder = Path(folder)
    pictures = {figure_name(item): panels_png(item) for item in items if item.panels}
    contents = {f"figures/{name}": png for name, png in pictures.items()}
    contents["reproduction.json"] = json_text(reproduction_summary(items)).encode("utf-8")
    contents["reproduction.html"] = page(items, pictures).encode("utf-8")
    made_folder(made_folder(folder) / "figures")
    for name, content in contents.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_bytes(content)
    return folder / "reproduction.html"


def figure_name(item: Item) -> str:
    """Name of the PNG file of `item`, such as ``figure_4_2.png``."""
    return f"{_slug(item)}.png"


def reproduction_summary(items: Sequence[Item]) -> dict[str, Any]:
    """The content of reproduction.json: `printed` and `computed` are those of the first table, row by row."""
    return {"structid": __version__, "items": [_item_summary(item) for item in items]}


def _item_summary(item: Item) -> dict[str, Any]:
    first = (
        _table_summary(item.tables[0]) if item.tables else {"rows": [], "columns": [], "printed": [], "computed": []}
    )
    return {
        "item": item.name,
        "title": item.title,
        "verdict": item.verdict.value,
        "note": item.note,
        "max_abs_difference": _rounded(item.max_abs_difference),
        **first,
        "supporting_tables": [_table_summary(table) for table in item.tables[1:]],
        "panels": [
            {
                "title": panel.title,
                "x_label": panel.x_label,
                "y_label": panel.y_label,
                "curves": [_curve_summary(curve) for curve in panel.curves],
            }
            for panel in item.panels
        ],
    }


def _table_summary(table: Table) -> dict[str, Any]:
    return {
        "rows": table.rows,
        "columns": table.columns,
        "printed": _rounded(table.printed.tolist()),
        "computed": _rounded(table.computed.tolist()),
    }


def _curve_summary(curve: Curve) -> dict[str, Any]:
    bands = {"low": curve.low, "high": curve.high}
    given = {name: values for name, values in bands.items() if values is not None}
    numbers = {"x": curve.x, "y": curve.y, **given}
    return {"label": curve.label} | {name: _rounded(values.tolist()) for name, values in numbers.items()}


def _rounded(value: Any) -> Any:
    """Numbers, also in lists, to the digits of the JSON file."""
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_JSON_DIGITS}g}") if isinstance(value, float) else value


def page(items: Sequence[Item], pictures: dict[str, bytes]) -> str:
    """The page as text, with the pictures in it."""
    counts = [(verdict, sum(item.verdict is verdict for item in items)) for verdict in Verdict]
    return page_template("reproduction.html.j2").render(
        version=__version__,
        counts=[(verdict.value, _CLASSES[verdict], count) for verdict, count in counts if count],
        items=[_item_view(item, pictures) for item in items],
    )


def _item_view(item: Item, pictures: dict[str, bytes]) -> dict[str, Any]:
    """What the template shows of an item."""
    picture = pictures.get(figure_name(item))
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
        "picture": None if picture is None else f"data:image/png;base64,{b64encode(picture).decode('ascii')}",
        "is_wide": len(item.panels) > 1,
        "described": "; ".join(panel.title for panel in item.panels),
    }


def _slug(item: Item) -> str:
    """Name of `item` in files and links: lower case, and one underscore for what is no letter or digit."""
    return re.sub(r"\W+", "_", item.name.lower()).strip("_")

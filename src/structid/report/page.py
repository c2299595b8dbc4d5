"""A page: one HTML file that needs no network, from a template, words, tables and figures; and tables on a terminal."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import rich.table
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from structid._version import __version__
from structid.files import atomic_write, make_folder
from structid.report.rendering.browser import clean, embedded, legend
from structid.report.rendering.plot import Figure

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


#: Parts of Plotly (4.1.1, MIT licence): name, file, and whether it draws space. All of it would be twice as large.
PLOTLY_PARTS = (("plane", "plotly-cartesian.min.js", False), ("space", "plotly-gl3d.min.js", True))

_CODE = re.compile(r"`([^`]+)`")


@dataclass(frozen=True, eq=False)
class Page:
    """Contents of a report page.

    Attributes
    ----------
    file : str
        Its name in the folder of results.
    template : str
        File among the templates.
    figures : mapping of str to Figure
        By the names under which the template places them.
    words : mapping of str to object
        All else that the template needs; a value that it needs and is not given is an error.
    """

    file: str
    template: str
    figures: Mapping[str, Figure]
    words: Mapping[str, object]

    @property
    def text(self) -> str:
        """The page as HTML text; the same words and figures give the same text."""
        drawn = {"libraries": self._libraries(), "described": packed(embedded(self.figures))} if self.figures else {}
        return _environment().get_template(self.template).render(
            **self.words, figures=self.figures, drawn=drawn, version=__version__
        )  # fmt: skip

    def _libraries(self) -> dict[str, str]:
        """Script text of the parts of Plotly that the figures need, by name: ``plane``, ``space`` or both."""
        spatial = {panel.z is not None for figure in self.figures.values() for panel in figure.panels}
        return {name: _library(file) for name, file, is_spatial in PLOTLY_PARTS if is_spatial in spatial}

    def write(self, folder: Path, png: bool = False) -> Path:
        """Write the page into `folder`, created if missing, and return the path of the page.

        A page that is there is replaced, whole or not at all. With `png` the figures are also written as PNG files,
        into the folder ``figures`` beside it.

        Raises
        ------
        FileError
            If a file cannot be written.
        """
        path = make_folder(Path(folder)) / self.file
        if png:
            from structid.report.rendering.png import write_pngs  # imported here, so that pages do not wait for it

            write_pngs(self.figures, path.parent / "figures")
        text = self.text
        with atomic_write(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return path


def packed(text: str) -> str:
    """`text` compressed (zlib) and in letters (base64), as `figures.js` unpacks it."""
    return base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii")


def plotly_part(file: str) -> str:
    """One of `PLOTLY_PARTS`, a script that sets ``Plotly``."""
    return (files("structid.report") / "plotly_parts" / file).read_text(encoding="utf-8")


def with_code(text: str) -> Markup:
    """`text` escaped, what stands between back quotes as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


@cache
def _library(file: str) -> str:
    return packed(plotly_part(file))


@cache
def _environment() -> Environment:
    """Jinja environment of the report templates, with the filters ``code`` and ``unindented`` and the functions for legends."""
    environment = Environment(
        loader=PackageLoader("structid.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.globals |= {"legend": legend, "clean": clean}
    environment.filters |= {"code": with_code, "unindented": unindented}
    return environment


def unindented(script: str) -> Markup:
    """`script` without the blanks that begin its lines, which a page need not carry; no text of it goes over lines."""
    return Markup("\n".join(line.lstrip() for line in str(script).splitlines() if line.strip()))

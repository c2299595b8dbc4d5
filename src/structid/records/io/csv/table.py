"""The cells of a CSV file as numbers under names, with every complaint at its line and column."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.arrays import FloatArray
from structid.errors import FileError
from structid.files import require_readable

#: Header of the first column, in small letters, and what it is.
AXES = {
    "time_s": "time", "time [s]": "time", "time (s)": "time",
    "frequency_hz": "frequency", "frequency [hz]": "frequency", "frequency (hz)": "frequency",
}  # fmt: skip


class Table(NamedTuple):
    """A table of numbers: column names and values (n_rows, n_columns)."""

    path: Path
    names: tuple[str, ...]
    values: FloatArray


def read_table(path: Path) -> Table:
    """The table in the CSV file at `path`.

    Raises
    ------
    FileError
        If the file is not text, has no header or no lines, or a cell is not a finite number. Samples of time
        histories may be NaN, infinite or empty: gaps are judged by `structid.records.io.gaps`.
    """
    path = require_readable(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is not UTF-8 text (byte {error.start}); save it as CSV UTF-8") from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error}); check the disk") from error
    if "\0" in text:
        raise FileError(f"{path}: holds null characters, so it is not a CSV text; save it as CSV UTF-8")
    if not text.endswith(("\n", "\r")):
        raise FileError(f"{path}: its last line has no end, so it may be truncated; copy it again or end the line")
    separator = _separator(text)
    try:
        rows = list(csv.reader(text.splitlines(), delimiter=separator, strict=True))
    except csv.Error as error:
        raise FileError(f"{path}: is not a CSV table ({error}); check quotes and separators") from error
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    names = _names(path, rows)
    if len(rows) < 2:
        raise FileError(f"{path}: has a header but no line of numbers; write it again")
    gaps = AXES[names[0].lower()] == "time"
    return Table(path, names, _numbers(path, rows[1:], names, separator != ",", gaps))


def _separator(text: str) -> str:
    """The separator of the first line, counted outside of quotes."""
    outside = "".join(text.partition("\n")[0].split('"')[::2])
    return max((";", "\t", ","), key=outside.count)


def _names(path: Path, rows: list[list[str]]) -> tuple[str, ...]:
    names = [cell.strip() for cell in rows[0]] if rows else []
    while names and not names[-1]:
        names.pop()
    if not names or names[0].lower() not in AXES:
        raise FileError(
            f"{path}: line 1, column 1 must be headed time_s or frequency_hz, got {names[0] if names else ''!r:.60}"
        )
    if len(names) < 2:
        raise FileError(f"{path}: line 1 names no channel; head each column as in 12Z+ [m/s^2]")
    return tuple(names)


def _numbers(path: Path, rows: list[list[str]], names: tuple[str, ...], decimal_comma: bool, gaps: bool) -> FloatArray:
    """Cells as numbers; where `gaps` are allowed, empty ones beyond the first column as NaN."""
    values = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
            raise FileError(
                f"{path}: line {i + 2} has {len(row)} cells, but the header has {len(names)}; complete or "
                "remove the line"
            )
        cells = [cell.replace(",", ".") for cell in row] if decimal_comma else row
        if gaps and not all(cells[: len(names)]):
            cells = [cells[0], *(cell.strip() or "nan" for cell in cells[1:])]
        try:
            values[i] = [float(cell) for cell in cells[: len(names)]]
        except ValueError as error:
            raise _bad_cell(path, i + 2, row, cells, names) from error
    bad = np.argwhere(~np.isfinite(values[:, :1] if gaps else values))
    if bad.size:
        i, j = bad[0]
        raise FileError(
            f"{path}: line {i + 2}, column {j + 1} ({names[j]}) is NaN or infinite; repair or remove the line"
        )
    return values


def _bad_cell(path: Path, line: int, row: list[str], cells: list[str], names: tuple[str, ...]) -> FileError:
    for j, name in enumerate(names):
        try:
            float(cells[j])
        except ValueError:
            return FileError(f"{path}: line {line}, column {j + 1} ({name}) must be a number, got {row[j]!r:.60}")
    return FileError(f"{path}: line {line} cannot be read as numbers")

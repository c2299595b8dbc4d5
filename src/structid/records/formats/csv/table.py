"""The cells of a CSV file as numbers under names, with every complaint at its line and column."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit
from structid.files import require_readable
from structid.records.formats.csv.recognition import (
    Grid,
    Rows,
    as_date,
    complex_parts,
    counts_up,
    is_axis,
    is_number,
    recognise_layout,
)
from structid.records.formats.headers import bare_unit, frequency_factor, require_axis_unit
from structid.records.formats.options import CsvLayout, layout_words

_FEW = 20
#: Part of every second byte of UTF-16 text that is null at least, where the text is Latin.
_MOSTLY = 0.9

#: An exponent as Fortran writes it in double precision.
_FORTRAN = re.compile(r"(\d[.,]?)[dD]([+-]?\d)")
#: Decimals of the last number of a line: after a point, or after the comma of a cell that is one number between semicolons or tabs.
_DECIMALS = re.compile(r"(?:\.|[;\t] *[+-]?\d*,)(\d+(?:[eE][+-]?\d+)?)[\s;,]*$")


class Table(NamedTuple):
    """A table of numbers.

    Attributes
    ----------
    path : Path
    names : tuple of str
        Header of every column; its number where the table has none; "" for a first column that counts the rows.
    units : tuple of str
        What stands below each name in a second line; "" else.
    values : (n_rows, n_columns) float array
        NaN where a cell of a time table is empty, and where a date stands.
    header_line, first_line : int
        Lines of the file, from 1.
    words : str
        What the layout is.
    texts : sequence of list of str
        The cells.
    to_hertz : float, optional
        Factor from the first column, which `values` hold as it is in the file, to Hz; None where that column holds no
        frequencies, NaN where nothing says their unit.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    header_line: int
    first_line: int
    words: str
    texts: Sequence[list[str]]
    to_hertz: float | None = None

    @property
    def is_frequency(self) -> bool:
        """True if the first column is an axis of frequencies."""
        return self.to_hertz is not None

    def cell(self, i: int, j: int) -> str:
        """The cell in row `i` of the numbers and column `j` as it is written."""
        return self.texts[i][j].strip()

    def column(self, j: int) -> list[str]:
        """The cells of column `j` as they are written."""
        cells = self.texts.column(j) if isinstance(self.texts, Rows) else [row[j] for row in self.texts]
        return [cell.strip() for cell in cells]


def read_table(path: Path, layout: CsvLayout | None = None, axis_unit: str = "") -> Table:
    """The table in the CSV file at `path`, with names, units and cells parsed to numbers in the units of the file.

    In a table with frequencies in its first column, each column of complex cells becomes two, of real and imaginary parts.

    Parameters
    ----------
    path : Path
    layout : CsvLayout, optional
        Separator, decimal sign, header lines and encoding; recognised by default.
    axis_unit : str
        Unit of the frequencies in the first column, such as ``Hz`` or ``rad/s``, where its header does not state it; "" if not
        known. A unit of times is passed over here.

    Raises
    ------
    FileError
        If the file is not text, has no lines of numbers, a column without a name or two units of frequencies, or a cell is not
        a finite number. Samples of time histories may be NaN, infinite or empty: gaps are judged by
        `structid.records.formats.gaps`.
    InputError
        If `axis_unit` contradicts the header.
    """
    path, layout = require_readable(path), layout or CsvLayout()
    text = _read_text(path, layout)
    grid = recognise_layout(path, text, layout)
    names = _column_names(path, grid)
    units = [bare_unit(cell) for cell in grid.header[1]] if len(grid.header) > 1 else []
    below = (*units, *("" for _ in names))[: len(names)]
    to_hertz = _to_hertz(path, names[0], below[0], axis_unit)
    if to_hertz is not None and not names[0]:
        raise FileError(
            f"{path}: line {grid.header_line}, column 1 has no name and counts the rows, where frequencies must stand; export"
            " without it"
        )
    if to_hertz is not None:
        grid, names, below = _split_complex(path, grid, names, below)
    values = _cells_as_numbers(path, grid, names, to_hertz is None)
    return Table(path, names, below, values, grid.header_line, grid.first_line, grid.words, grid.rows, to_hertz)


def _to_hertz(path: Path, name: str, unit: str, axis_unit: str) -> float | None:
    """Factor from the first column to Hz; None if it holds no frequencies, NaN if their unit is not stated.

    `name` and `unit` are the column's header, `axis_unit` the option that states the unit otherwise ("" if not set).
    `FileError` if the header states two units, `InputError` if option and header differ.
    """
    try:
        by_table = frequency_factor(name, unit)
    except InputError as error:
        raise FileError(f"{path}: column 1: {error}") from error
    try:
        by_user = parse_frequency_unit(axis_unit) if axis_unit else None
    except InputError:
        by_user = None  # it is one of times, which is judged with them
    if by_user is None:
        return by_table
    described = f"{path}: column 1 ({name}) says the unit of its frequencies"
    require_axis_unit(described, name, unit, by_table, axis_unit, by_user, parse_frequency_unit)
    return by_user


def _split_complex(
    path: Path, grid: Grid, names: tuple[str, ...], units: tuple[str, ...]
) -> tuple[Grid, tuple[str, ...], tuple[str, ...]]:
    """Grid, names and units of the table with each column of complex cells replaced by two, headed ``re`` and ``im``.

    The first row decides which columns are complex; `FileError` if a later cell in such a column is not. `grid` has the
    cells, `names` and `units` are those of the columns.
    """
    split = [complex_parts(cell) is not None for cell in grid.rows[0][: len(names)]]
    if not any(split):
        return grid, names, units
    rows = []
    for i, row in enumerate(grid.rows):
        cells: list[str] = []
        for j, cell in enumerate(row):
            parts = complex_parts(cell) if j < len(split) and split[j] else (cell,)
            if parts is None:
                raise FileError(
                    f"{path}: line {grid.first_line + i}, column {j + 1} ({names[j]}) must be a complex number like those above, as"
                    f" in 1.5-0.2i, got {cell!r:.60}"
                )
            cells += parts
        rows.append(cells)
    double = [
        part
        for name, two in zip(names, split, strict=True)
        for part in ((f"{name} re", f"{name} im") if two else (name,))
    ]
    below = [unit for unit, two in zip(units, split, strict=True) for unit in ((unit, unit) if two else (unit,))]
    return grid._replace(rows=rows), tuple(double), tuple(below)


def _read_text(path: Path, layout: CsvLayout) -> str:
    """Text of the file at `path` in `layout.encoding`, by its byte-order mark where that is UTF-8.

    `FileError` if it cannot be decoded or holds null bytes, or may be truncated: its last line has no end, its last
    number not as many decimals as those of ten lines above, and no footer is stated.
    """
    try:
        text = path.read_text(encoding=_encoding_by_mark(path) if layout.encoding == "utf-8" else layout.encoding)
    except UnicodeError as error:
        byte = error.start if isinstance(error, UnicodeDecodeError) else 0
        if b"\0" in path.read_bytes():
            raise _null_bytes_error(path) from error
        raise FileError(
            f"{path}: is not {layout.encoding.upper()} text (byte {byte}); save it as CSV UTF-8, or give"
            f" {layout_words(encoding='cp1252')} (or utf-16)"
        ) from error
    except (OSError, LookupError) as error:
        raise FileError(f"{path}: cannot be read ({error}); check the disk") from error
    if "\0" in text:
        raise _null_bytes_error(path)
    if not text.endswith(("\n", "\r")) and not layout.footer_rows and not _is_last_line_whole(text):
        raise FileError(
            f"{path}: its last line has no end, so it may be truncated; copy it again, end the line, or leave it out with"
            f" {layout_words(footer_rows=1)}"
        )
    return text


def _null_bytes_error(path: Path) -> FileError:
    """The error for a file with null bytes, with the remedy.

    It tells UTF-16 text without a byte-order mark if over 0.9 of the bytes at either the even or the odd places are
    null, and under 0.1 at the others; else that the file is no text.
    """
    content = path.read_bytes()
    first, second = (content[begin::2].count(0) / (len(content) / 2) for begin in (0, 1))
    if max(first, second) > _MOSTLY and min(first, second) < 1 - _MOSTLY:
        encoding = "utf-16-le" if second > first else "utf-16-be"
        return FileError(
            f"{path}: is UTF-16 text without a byte-order mark; give {layout_words(encoding=encoding)}, or save it as CSV UTF-8"
        )
    return FileError(f"{path}: holds null bytes, so it is no text; export it as CSV UTF-8")


def _is_last_line_whole(text: str) -> bool:
    """True if the last number has as many decimals as the last numbers of ten lines above; False if that cannot be told."""
    *above, last = (_DECIMALS.search(line) for line in text.splitlines()[-11:])
    return last is not None and len(above) == 10 and all(one and len(one[1]) == len(last[1]) for one in above)


def _encoding_by_mark(path: Path) -> str:
    """Encoding of a file by its byte-order mark: "utf-16", or "utf-8-sig" without a mark of UTF-16."""
    with path.open("rb") as stream:
        begin = stream.read(2)
    return "utf-16" if begin in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"


def _column_names(path: Path, grid: Grid) -> tuple[str, ...]:
    """Names of the columns from the first header line, or "1", "2", ... if the table has no header.

    The first is "" if that column has no name and counts the rows. Raises `FileError` if another name is missing, there
    are fewer names than numbers in the first row, or the only name is that of times or frequencies.
    """
    if not grid.header:
        return tuple(str(j) for j in range(1, len(_strip_empty_end(grid.rows[0])) + 1))
    names = _strip_empty_end([cell.strip() for cell in grid.header[0]])
    if not names:
        raise FileError(f"{path}: line {grid.header_line} names no column; head each column as in 12Z+ [m/s^2]")
    count = len(_strip_empty_end(grid.rows[0]))
    if count > len(names) and _is_whole(grid.rows[0]):
        raise FileError(
            f"{path}: line {grid.header_line} names {len(names)} columns, but line {grid.first_line} has {count} cells: other"
            " separators in the header, decimal commas between commas, or merged cells; export all lines alike, name every"
            f" column, or give {layout_words(separator=None)}, {layout_words(decimal=None)} or {layout_words(skip_rows=None)}"
        )
    first = 1 if _counts_rows(grid) else 0
    if "" in names[first:]:
        raise FileError(
            f"{path}: line {grid.header_line}, column {names.index('', first) + 1} has no name, as where cells were merged; name"
            f" every column, or leave the line out with {layout_words(skip_rows=None, header_rows=0)}"
        )
    if len(names) < 2 and is_axis(names[0]):
        raise FileError(
            f"{path}: line {grid.header_line} names no channel; head each column as in 12Z+ [m/s^2], or give the `separator`"
        )
    return tuple(names)


def _counts_rows(grid: Grid) -> bool:
    """True if the first column counts the rows from 0 or 1, as the index of a data frame does."""
    return counts_up([row[0].strip().strip('"') for row in grid.rows[:_FEW] if row])


def _strip_empty_end(row: Sequence[str]) -> list[str]:
    """A row without its trailing empty cells."""
    cells = list(row)
    while cells and not cells[-1].strip():
        cells.pop()
    return cells


def _is_whole(row: Sequence[str]) -> bool:
    return all(is_number(cell) or as_date(cell) is not None for cell in row if cell.strip())


def _cells_as_numbers(path: Path, grid: Grid, names: tuple[str, ...], gaps: bool) -> FloatArray:
    """Cells as numbers, (n_rows, n_columns); with `gaps`, empty cells after the first column and dates become NaN.

    Raises `FileError` for any other cell that is no number. `names` are those of the columns.
    """
    rows, count = grid.rows, len(names)
    dated = {j for j, cell in enumerate(rows[0][:count]) if as_date(cell) is not None} if gaps else set()
    values = _parse_fast(rows, count, grid.decimal_comma, dated, gaps) if isinstance(rows, Rows) else None
    return _parse_cells(path, grid, names, dated, gaps) if values is None else values


def _parse_fast(rows: Rows, count: int, comma: bool, dated: set[int], gaps: bool) -> FloatArray | None:
    """Cells parsed by a single `numpy.loadtxt` call, (n_rows, n_columns); None if a line cannot be parsed so.

    `count` is the number of columns, `comma` says that numbers have decimal commas, `dated` are the indices of columns
    of dates, which become NaN, and `gaps` allows empty cells after the first column, which become NaN, and infinite
    ones. `rows` are the lines and their separator.
    """
    lines, sign = rows.lines, rows.separator
    if _FORTRAN.search(lines[0]):
        lines = [_FORTRAN.sub(r"\1E\2", line) for line in lines]
    if comma:
        if any("." in cell for line in lines for cell in _undated(line, sign, dated)):
            return None
        lines = [line.replace(",", ".") for line in lines]
    if sign != " ":
        if _ends_empty(lines[0], sign, count):
            lines = [line.rstrip().removesuffix(sign) for line in lines]
        if {line.count(sign) for line in lines} != {count - 1}:
            return None
        if gaps and count > 1:
            lines = [_with_nan(line, sign) for line in lines]
    values = np.full((len(lines), count), np.nan)
    columns = [j for j in range(count) if j not in dated]
    try:
        parsed = np.loadtxt(
            lines, delimiter=None if sign == " " else sign, comments=None, ndmin=2, usecols=columns if dated else None
        )
    except ValueError:
        return None
    if parsed.shape != (len(lines), len(columns)) or not (gaps or np.isfinite(parsed).all()):
        return None
    values[:, columns] = parsed
    return values


def _undated(line: str, separator: str, dated: set[int]) -> list[str]:
    """Cells of `line`, divided by `separator` (" " for any blanks), without those at the indices `dated` (from 0).

    If `dated` is empty, the whole line is returned as the only entry.
    """
    if not dated:
        return [line]
    cells = line.split() if separator == " " else line.split(separator)
    return [cell for j, cell in enumerate(cells) if j not in dated]


def _ends_empty(line: str, separator: str, count: int) -> bool:
    """True if a line has `count` separators, one for each column, and ends with one."""
    return line.rstrip().endswith(separator) and line.rstrip().count(separator) == count


def _with_nan(line: str, separator: str) -> str:
    """The line with ``nan`` written into its empty cells, except the first.

    Cells are divided by `separator`.
    """
    empty = separator + separator
    if empty in line:
        line = line.replace(empty, f"{separator}nan{separator}").replace(empty, f"{separator}nan{separator}")
    return f"{line}nan" if line.endswith(separator) else line


def _parse_cells(path: Path, grid: Grid, names: tuple[str, ...], dated: set[int], gaps: bool) -> FloatArray:
    """Cells parsed row by row, (n_rows, n_columns); `FileError` with line and column for the first that is no number.

    A row with too few or too many cells is a `FileError` too. `names` are those of the columns, `dated` the indices of columns of
    dates. `gaps` allows NaN and infinite cells, and cells that become NaN: dates, and empty ones after the first column.
    """
    rows, count = grid.rows, len(names)
    values = np.empty((len(rows), count))
    for i, row in enumerate(rows):
        if len(row) < count or any(cell.strip() for cell in row[count:]):
            raise _footer_error(path, grid, i, count) or FileError(
                f"{path}: line {grid.first_line + i} has {len(row)} cells, but {_where(grid)} {count}; complete or remove the"
                " line"
            )
        if grid.decimal_comma:
            _require_no_points(path, grid.first_line + i, row[:count], names, dated)
        cells = [cell.replace(",", ".") for cell in row[:count]] if grid.decimal_comma else row[:count]
        if any(_FORTRAN.search(cell) for cell in cells):
            cells = [_FORTRAN.sub(r"\1E\2", cell) for cell in cells]
        if gaps and (dated or not all(cells)):
            first = 0 if count > 1 else count
            cells = [
                "nan" if (j > first or j in dated) and (j in dated or not cell.strip()) else cell
                for j, cell in enumerate(cells)
            ]
        try:
            values[i] = [float(cell) for cell in cells]
        except ValueError as error:
            raise _footer_error(path, grid, i, count) or _bad_cell_error(
                path, grid.first_line + i, row, cells, names
            ) from error
    if not gaps and not np.isfinite(values).all():
        i, j = np.argwhere(~np.isfinite(values))[0]
        raise FileError(
            f"{path}: line {grid.first_line + i}, column {j + 1} ({names[j]}) is NaN or infinite; repair or remove the line"
        )
    return values


def _require_no_points(path: Path, line: int, row: Sequence[str], names: tuple[str, ...], dated: set[int]) -> None:
    """Raise `FileError` for a number with a point in a row of a table with decimal commas.

    `line` is that of the row, from 1, and `dated` are the indices of columns of dates.
    """
    for j, cell in enumerate(row):
        if j not in dated and "." in cell and is_number(cell):
            raise FileError(
                f"{path}: line {line}, column {j + 1} ({names[j]}) is {cell.strip()}, where other numbers have decimal commas: its"
                " point may be that of thousands or of decimals; export all numbers alike, without thousands apart"
            )


def _where(grid: Grid) -> str:
    return "the header has" if grid.header else f"line {grid.first_line} has"


def _footer_error(path: Path, grid: Grid, i: int, count: int) -> FileError | None:
    """The error to raise if row `i` of `grid` begins a footer, a few last lines with text; None if it does not.

    `count` is the number of columns. A footer has at most a few rows, none of them complete with numbers, and begins
    with words; a last row of numbers with one bad cell, or the first row of the table, is none.
    """
    tail, n_left = grid.rows[i:], len(grid.rows) - i
    while len(tail) and not any(cell.strip() for cell in tail[0]):
        tail = tail[1:]
    if (
        i == 0
        or not tail
        or len(tail) > _FEW
        or any(len(_strip_empty_end(row)) == count and _is_whole(row) for row in tail)
    ):
        return None
    if not any(re.search(r"[A-Za-z]", cell) and not is_number(cell) for cell in tail[0]):
        return None
    if len(tail) == 1 and len(tail[0]) == count and is_number(tail[0][0]):
        return None  # a line of numbers with one bad cell
    shown = ", ".join(cell.strip() for cell in tail[0][:4])
    return FileError(
        f"{path}: line {grid.first_line + len(grid.rows) - len(tail)} ({shown:.60}) ends the numbers: a footer? Leave it out with"
        f" {layout_words(footer_rows=n_left)}"
    )


def _bad_cell_error(path: Path, line: int, row: list[str], cells: list[str], names: tuple[str, ...]) -> FileError:
    """The error to raise for the first cell of a row that is no number, with a hint at the cause.

    `row` are the cells as written, `cells` those with decimal points, `names` the columns; `line` counts from 1.
    """
    for j, name in enumerate(names):
        try:
            float(cells[j])
        except ValueError:
            hint = ""
            if re.fullmatch(r"[+-]?\d{1,3}([.,' \u00a0\u2009\u202f]\d{3})*[.,]\d+", row[j].strip()):
                hint = f"; export without thousands separators, or give {layout_words(decimal=None)}"
            elif re.fullmatch(
                r"#.*|-?1[.,]#(inf|ind|[qs]nan)\d*|n/?a|-+|null|none|error|over(flow|load|range)?|ol|ov[lr]d?|sat|clip",
                row[j].strip(),
                re.IGNORECASE,
            ):
                hint = "; clear the cell where a sample is missing: gaps are told, cut or filled"
            elif sum(cell.strip() == other for cell, other in zip(row, names, strict=False)) >= min(2, len(names)):
                hint = "; the header stands here again: put what follows into a file of its own"
            return FileError(f"{path}: line {line}, column {j + 1} ({name}) must be a number, got {row[j]!r:.60}{hint}")
    return FileError(f"{path}: line {line} cannot be read as numbers")

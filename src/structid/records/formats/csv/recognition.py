"""Layout of a table from its lines: separator, decimal sign, header; refused with a remedy where in doubt."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple, overload

from structid.core.display import plural
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit, parse_frf_unit, parse_time_unit, parse_unit
from structid.records.formats.headers import bare_unit, ending_statistic, frequency_factor, marked_statistic
from structid.records.formats.options import SEPARATORS, CsvLayout, layout_words

#: Headers of times, in small letters, as structid writes them and the like.
_TIMES = ("time_s", "time [s]", "time (s)")
_REAL = r"(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?"
_NUMBER = re.compile(rf"[+-]?{_REAL}|[+-]?(nan|inf|infinity)", re.IGNORECASE)
#: Hours, minutes and seconds of a clock, or of a time that has gone by, which may be longer than a day.
_CLOCK = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)(?:\.(\d+))?")
#: Dates of Europe (with points, the day first) and of America (with slashes, the month first), alone or before a clock.
_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[T ]\s*(.+))?")
_SLASHES = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})(?:[T ]\s*(.+))?")
_HALF_DAY = re.compile(r"\s*([AP])M$", re.IGNORECASE)
_COMPLEX = re.compile(
    rf"\(?\s*(?P<re>[+-]?{_REAL})\s*(?P<sign>[+-])\s*[ij]?\s*\*?\s*(?P<im>{_REAL})\s*\*?\s*[ij]?\s*\)?"
)
_POINT, _COMMA = re.compile(r"\.\d"), re.compile(r",\d")
#: First line of a table of Campbell loggers; names, units and statistics of its columns follow in three lines.
_TOA5 = re.compile(r'\s*"?TOA5"?\s*[,;\t]')
#: Sign of a comment before the names of columns or their units, as arrays are saved with; and one before a later cell.
_COMMENT_SIGN, _LATER_SIGN = re.compile(r'^\s*[#%]+\s*(?=[\w"])'), re.compile(r'[,;\s]\s*"?[#%]')
#: Units that say nothing without a sensor, but stand in lines of units.
_VOLTAGES = ("V", "mV")
#: First line by which spreadsheets are told the separator.
_SEPARATOR_LINE = re.compile(r'"?sep=([,;\t|])"?\s*', re.IGNORECASE)
_BETWEEN_CELLS = re.compile(r"[,;\s]+")
#: With thousands apart.
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:(?:\.\d{3})+,\d+|(?:,\d{3})+\.\d+|(?:[' ]\d{3})+[.,]\d+)")
#: What may be a whole number with its thousands apart, or one with three decimals.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_SAMPLE, _HEAD, _LONGEST_UNIT = 40, 200, 16
#: Letters of a number at most: the patterns take time with the square of them.
_LONGEST_NUMBER = 100


@dataclass(frozen=True)
class Rows(Sequence[list[str]]):
    """Lines without quotes, taken apart into cells where these are asked for."""

    lines: list[str]
    separator: str

    def __len__(self) -> int:
        return len(self.lines)

    @overload
    def __getitem__(self, index: int) -> list[str]: ...
    @overload
    def __getitem__(self, index: slice) -> Rows: ...
    def __getitem__(self, index: int | slice) -> list[str] | Rows:
        return (
            Rows(self.lines[index], self.separator)
            if isinstance(index, slice)
            else _split(self.lines[index], self.separator)
        )

    def column(self, j: int) -> list[str]:
        """Cell `j` of every line."""
        if self.separator == " ":
            return [line.split(None, j + 1)[j] for line in self.lines]
        return [line.split(self.separator, j + 1)[j] for line in self.lines]


class Grid(NamedTuple):
    """Cells of a table, (n_lines, any) each.

    Attributes
    ----------
    header : sequence of list of str
        None, one or two lines: names, and units below them.
    rows : sequence of list of str
    header_line, first_line : int
        Lines of the file, counted from 1, of the names and of the first of `rows`.
    decimal_comma : bool
    words : str
        What the layout is.
    """

    header: Sequence[list[str]]
    rows: Sequence[list[str]]
    header_line: int
    first_line: int
    decimal_comma: bool
    words: str


def is_number(cell: str) -> bool:
    """True if a cell is a number, with a decimal point or comma, complex or not."""
    text = cell.strip()
    return len(text) <= _LONGEST_NUMBER and (_NUMBER.fullmatch(text) is not None or complex_parts(text) is not None)


def complex_parts(cell: str) -> tuple[str, str] | None:
    """Real and imaginary part of a cell such as ``1.5-2e-3i`` or ``(1,5 + 2j)``, as written; None where it is none."""
    text = cell.strip()
    match = _COMPLEX.fullmatch(text) if len(text) <= _LONGEST_NUMBER and {"i", "j"} & set(text.lower()) else None
    return match and (match["re"], match["sign"] + match["im"])


def is_axis(name: str) -> bool:
    """True if a first column headed so holds times as structid writes them, or frequencies."""
    return name.lower() in _TIMES or frequency_factor(name) is not None


def as_date(cell: str) -> datetime | None:
    """The date and time in a cell, cut to microseconds; clock times without a date get day 1 of year 1; None for other cells.

    Dates are ISO 8601, ``27.11.2026`` or ``11/27/2026``, alone or followed by a clock time. Between slashes the month comes
    first, unless the first number is above 12.
    """
    text = cell.strip().replace(",", ".")
    clock = _as_clock(text)
    if clock is not None:
        return datetime(1, 1, 1) + clock
    try:
        if dated := _DAY_FIRST.fullmatch(text):
            day, month = int(dated[1]), int(dated[2])
        elif dated := _SLASHES.fullmatch(text):
            month, day = int(dated[1]), int(dated[2])
            month, day = (day, month) if month > 12 else (month, day)
        else:
            return datetime.fromisoformat(text) if re.match(r"\d{4}-\d\d-\d\d([T ]\d|$)", text) else None
        clock = _as_clock(dated[4] or "0:00:00")
        return None if clock is None else datetime(int(dated[3]), month, day) + clock
    except ValueError:
        return None


def _as_clock(text: str) -> timedelta | None:
    """The time since midnight in `text`, a clock such as ``12:00:01.25`` or ``2:59:58 PM``, cut to microseconds; else None."""
    half = _HALF_DAY.search(text)
    parts = _CLOCK.fullmatch(text if half is None else text[: half.start()])
    if parts is None:
        return None
    hours, minutes, seconds = (int(part) for part in parts.groups()[:3])
    if half is not None:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + 12 * (half[1] in "pP")
    microseconds = int((parts[4] or "")[:6].ljust(6, "0"))
    return timedelta(hours=hours, minutes=minutes, seconds=seconds, microseconds=microseconds)


def is_unit(cell: str) -> bool:
    """True if a cell is a unit of a channel, a time, a frequency or an FRF, with or without brackets."""
    text = bare_unit(cell)
    for parse in (parse_unit, parse_frf_unit, parse_time_unit, parse_frequency_unit):
        try:
            parse(text)
        except InputError:
            continue
        return True
    return False


def _are_units(row: Sequence[str]) -> bool:
    """True if more than half of the non-empty cells of a row are units, and all are as short as units."""
    cells = [cell.strip() for cell in row if cell.strip()]
    known = sum(is_unit(cell) or bare_unit(cell) in _VOLTAGES for cell in cells)
    return 2 * known > len(cells) and all(len(cell) <= _LONGEST_UNIT for cell in cells)


def recognise_layout(path: Path, text: str, layout: CsvLayout) -> Grid:
    """Header and cells of a table, with its separator, decimal sign and header lines recognised from the text.

    Parameters
    ----------
    path : Path
        File, named in errors.
    text : str
        All of the file's text.
    layout : CsvLayout
        Settings that replace the recognition where they are not "auto" or None.

    Returns
    -------
    Grid
        Header of none, one or two lines (names, units), cells of the lines below, the numbers (from 1) of the first line of
        each, whether numbers have decimal commas, and words on all this.

    Raises
    ------
    FileError
        If the separator is unclear, no line holds numbers, or the lines above the first numbers are neither names nor
        names and units; the message names lines and the keys of ``[record.csv]`` that help.
    """
    lines = text.splitlines()
    while lines and not lines[-1].strip(" \t,;"):
        lines.pop()
    end = len(lines) - layout.footer_rows
    said = _SEPARATOR_LINE.fullmatch(lines[0]) if lines else None
    is_toa5 = end > 4 and layout.skip_rows == 0 and layout.header_rows is None and _TOA5.match(lines[0]) is not None
    skip = max(layout.skip_rows, 1) if is_toa5 or said else layout.skip_rows
    if end <= skip:
        raise FileError(
            f"{path}: has {len(lines)} lines, of which `skip_rows` and `footer_rows` leave none; lower them"
            if lines and layout.skip_rows + layout.footer_rows
            else f"{path}: holds no header and no line of numbers; write it again"
        )
    lines = lines[skip:end]
    lines[:2] = [_without_comment_sign(line) for line in lines[:2]]
    separator = _guess_separator(lines) if layout.separator == "auto" else SEPARATORS[layout.separator]
    if said and layout.separator == "auto" and said[1] in SEPARATORS.values():
        separator = said[1]
    cells = _split_cells(path, lines, separator)
    blank = _blank_rows_above_numbers(cells, layout.header_rows)
    if blank:
        cells = _split_cells(path, lines[: blank.start] + lines[blank.stop :], separator)
    n_header = 3 if is_toa5 else _count_header_rows(path, cells, layout, skip)
    rows = cells[n_header:]
    if not rows:
        raise FileError(f"{path}: has a header but no line of numbers; write it again")
    first = skip + n_header + len(blank) + 1
    comma = _has_decimal_commas(path, rows, separator, layout, first)
    name = next(word for word, sign in SEPARATORS.items() if sign == separator)
    head = ("no header", f"names in line {skip + 1}", f"names in line {skip + 1}, units in line {skip + 2}")[
        min(n_header, 2)
    ]
    footer_words = f", {plural(layout.footer_rows, 'footer line')} left out" if layout.footer_rows else ""
    words = f"separated by {name}s, decimal {'commas' if comma else 'points'}, {head}{footer_words}"
    header = _named_with_statistics(cells[:n_header]) if is_toa5 else cells[:n_header]
    return Grid(header, rows, skip + 1, first, comma, words)


def _blank_rows_above_numbers(cells: Sequence[list[str]], header_rows: int | None) -> range:
    """Indices of the rows without a cell between the header and the first row of numbers; empty if there are none.

    `cells` are those of every row. Blank rows among the first `header_rows` belong to the header; None for any number.
    """
    first = next((i for i, row in enumerate(cells[:_HEAD]) if _is_data(row)), 0)
    begin = first
    while begin and not any(cell.strip() for cell in cells[begin - 1]):
        begin -= 1
    if header_rows is not None:
        begin = header_rows if begin <= header_rows <= first else first  # else a line of the header is no blank one
    return range(begin, first)


def _without_comment_sign(line: str) -> str:
    """The line without a sign of a comment before it, unless numbers follow, or later cells begin with such a sign too."""
    bare = _COMMENT_SIGN.sub("", line)
    is_kept = _LATER_SIGN.search(bare.strip()) is not None or all(map(is_number, _BETWEEN_CELLS.split(bare.strip())))
    return line if is_kept else bare


def _named_with_statistics(header: Sequence[list[str]]) -> list[list[str]]:
    """Lines of names and units of a TOA5 table, from its `header`: names, units, statistics (``Smp``, ``Avg`` ...).

    The name of a column that is no sample, by its statistic or else by the end of its name, is marked with the
    statistic.
    """
    names, units, statistics = header
    named = []
    for name, statistic in zip_longest(names, statistics[: len(names)], fillvalue=""):
        word = statistic.strip() if statistic.strip().lower() not in ("", "smp") else ending_statistic(name)
        named.append(marked_statistic(name, word) if word else name)
    return [named, units]


def _split(line: str, separator: str) -> list[str]:
    """Cells of `line` at the `separator`; at runs of white space if it is a blank. No cells for an empty line."""
    if separator == " ":
        return line.split()
    return line.split(separator) if line else []


def _split_cells(path: Path, lines: list[str], separator: str) -> Sequence[list[str]]:
    """Cells of each line, split at `separator` (" " for any blanks); quoted cells may hold separators.

    `lines` are those of the table, without their line ends. Raises `FileError` if quotes are unbalanced.
    """
    if separator == " " or not any('"' in line for line in lines):
        return Rows(lines, separator)
    try:
        return list(csv.reader(lines, delimiter=separator, strict=True))
    except csv.Error as error:
        raise FileError(f"{path}: is not a CSV table ({error}); check quotes and separators") from error


def _guess_separator(lines: Sequence[str]) -> str:
    """The separator at which most sampled lines split into rows of numbers; " " stands for any blanks.

    If no sampled line does, the most frequent of semicolon, tab and comma in the first of `lines`, outside of quotes.
    """
    step = max(1, len(lines) // _SAMPLE)
    sample = lines[-1::-step][:_SAMPLE]
    n_rows = {sign: _count_number_rows(sample, sign) for sign in SEPARATORS.values()}
    best = max(n_rows, key=lambda sign: n_rows[sign])
    if n_rows[best]:
        return best
    unquoted = "".join(lines[0].split('"')[::2])
    return max((";", "\t", ","), key=unquoted.count)


def _count_number_rows(sample: Sequence[str], sign: str) -> int:
    """Number of lines in `sample` that split at `sign` into two or more cells: numbers, or a date and then numbers.

    Empty cells do not count.
    """
    count = 0
    for line in sample:
        cells = line.split() if sign == " " else line.split(sign)
        numbers = [is_number(cell.strip().strip('"')) for cell in cells if cell.strip()]
        whole = sum(numbers) == len(numbers) or (as_date(cells[0]) is not None and sum(numbers) == len(numbers) - 1)
        count += len(numbers) > 1 and whole
    return count


def _is_data(row: Sequence[str]) -> bool:
    """True if each cell of `row` is a number, a date or empty, and one at least is a number."""
    numbers = [is_number(cell) for cell in row if cell.strip()]
    dates = sum(as_date(cell) is not None for cell in row)
    return any(numbers) and sum(numbers) + dates == len(numbers)


def _begins_with_time(row: Sequence[str]) -> bool:
    """True if the first cell of a row has digits and colons, as a date or clock time, and all others are numbers."""
    return re.search(r"\d:\d", row[0]) is not None and _is_data(row[1:]) if row else False


def _count_header_rows(path: Path, cells: Sequence[list[str]], layout: CsvLayout, skip: int) -> int:
    """Number of header lines: 0, 1 (names) or 2 (names and units), from `layout.header_rows` or by the first line of numbers.

    `cells` are those of all lines after the first `skip`. A first cell that names times or frequencies makes one header line.
    Otherwise `FileError` is raised if no line of numbers is found near the top, or the lines above it are no such header.
    """
    if layout.header_rows is not None:
        return layout.header_rows
    first = next((i for i, row in enumerate(cells[:_HEAD]) if _is_data(row)), None)
    if first == 0:
        _require_samples_first(path, cells, skip)
    if first in (0, 1):
        return first or 0
    named = [cell.strip() for cell in cells[0]] if cells else []
    if first == 2 and _are_units(cells[1]):
        return 2
    if named and is_axis(named[0]):
        return 1  # and a line below cannot be read, which is told with its cell
    if first is None:
        date = next((row[0].strip() for row in cells[:_HEAD] if _begins_with_time(row)), "")
        if date:
            raise FileError(
                f"{path}: times such as {date!r:.40} are not understood; write them in s, as 2026-11-27T12:00:01.25, as"
                " 27.11.2026 12:00:01.25, or as 12:00:01.25"
            )
        grouped = next((cell.strip() for row in cells[:_HEAD] for cell in row if _GROUPED.fullmatch(cell.strip())), "")
        raise FileError(
            f"{path}: has no line that holds only numbers in its first {min(len(cells), _HEAD)} lines; give what stands"
            f" above the numbers in {layout_words(skip_rows=None)}, or {layout_words(separator=None, decimal=None)}"
            + (f"; {grouped!r} looks like thousands separators: export without them" if grouped else "")
        )
    units = _are_units(cells[first - 1])
    head = first - (2 if units else 1)
    shown = ", ".join(cell.strip() for cell in cells[head][:6])
    raise FileError(
        f"{path}: lines {skip + 1} to {skip + first} stand above the numbers; where line {skip + head + 1} ({shown:.60}) names"
        f" the columns, give {layout_words(skip_rows=skip + head)}"
        + ("" if units else f", and {layout_words(header_rows=None)} where units follow in one more line")
    )


def counts_up(texts: Sequence[str]) -> bool:
    """True if the texts are the whole numbers from 0 or 1 on, as indices are."""
    return any(list(texts) == [str(first + i) for i in range(len(texts))] for first in (0, 1))


def _require_samples_first(path: Path, cells: Sequence[list[str]], skip: int) -> None:
    """Raise `FileError` if the first line counts its columns, as names of data frames do, above numbers with decimals.

    `cells` are those of the lines behind the first `skip`.
    """
    line = [cell.strip() for cell in cells[0]]
    if counts_up(line) and len(line) > 1 and any(re.search(r"[.,]\d", cell) for row in cells[1:3] for cell in row):
        shown = ", ".join(line[:4]) + (", ..." if len(line) > 4 else "")
        raise FileError(
            f"{path}: line {skip + 1} counts {shown}, as numbers of columns do, and may hold samples too: give"
            f" {layout_words(header_rows=1)} if it names the columns, or {layout_words(header_rows=0)}"
        )


def _has_decimal_commas(
    path: Path, rows: Sequence[Sequence[str]], separator: str, layout: CsvLayout, first_line: int
) -> bool:
    """True if the numbers have decimal commas, from `layout.decimal` or by a sample of `rows`, the cells below the header.

    `first_line` is the line of the first row, from 1; `separator` is the one between cells. Raises `FileError` if both signs
    occur, or all numbers could also have thousands separators.
    """
    if layout.decimal != "auto":
        return layout.decimal == "comma"
    if separator == ",":
        return False
    seen: dict[bool, tuple[int, str]] = {}
    surely_decimals = False
    for row in range(0, len(rows), max(1, len(rows) // _HEAD)):
        for cell in rows[row]:
            if is_number(cell) and (_COMMA.search(cell) or _POINT.search(cell)):
                seen.setdefault("," in cell, (first_line + row, cell.strip()))
                surely_decimals = surely_decimals or _THOUSANDS.fullmatch(cell.strip()) is None
    if len(seen) == 2:
        raise FileError(
            f"{path}: line {seen[True][0]} has decimal commas and line {seen[False][0]} decimal points; export all numbers"
            f' alike, or give {layout_words(decimal="comma")} or "point" and leave the other lines out'
        )
    if seen and not surely_decimals:
        line, grouped = next(iter(seen.values()))
        raise FileError(
            f"{path}: line {line}: numbers such as {grouped!r} may have decimals or thousands"
            f' apart, and no other number tells; give {layout_words(decimal="point")} or "comma"'
        )
    return seen.popitem()[0] if seen else False

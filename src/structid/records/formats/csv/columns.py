"""Columns of a CSV table by their headers, as records; and records as headed columns."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.dof import Dof, as_dof, parse_dof
from structid.core.errors import FileError, InputError
from structid.core.units import FrfUnit, parse_frequency_unit, parse_frf_unit
from structid.records.formats.bare import require_same_rotation
from structid.records.formats.clocks import SURE, Rate, even_rate, resample, resampling_remedy
from structid.records.formats.csv.recognition import as_date, is_axis
from structid.records.formats.csv.table import Table
from structid.records.formats.gaps import source_with_note
from structid.records.formats.headers import (
    LONGEST_NAME,
    bare_unit,
    factors_in_header,
    is_read_by,
    is_time,
    level_word,
    name_and_unit,
    other_unit_in_name,
)
from structid.records.formats.named_channels import (
    NamedChannels,
    choose_columns,
    record_of,
    scale_of_times,
)
from structid.records.formats.options import CsvLayout, ReadOptions, layout_words, option_words
from structid.records.formats.selection import select_channels
from structid.records.record import COHERENCE_MOST, FrfKind, FrfRecord, TimeRecord

#: Words that headers have for parts of a response, and what structid calls them.
_PART_WORDS = {
    "re": "re", "real": "re", "real part": "re", "im": "im", "imag": "im", "imaginary": "im", "imaginary part": "im",
    "magnitude": "magnitude", "mag": "magnitude", "abs": "magnitude", "amplitude": "magnitude", "ampl": "magnitude",
    "phase": "phase", "angle": "phase", "coherence": "coherence", "coh": "coherence", "std": "std",
    "modulus": "magnitude", "module": "magnitude", "betrag": "magnitude", "realteil": "re", "imaginärteil": "im",
    "partie réelle": "re", "partie imaginaire": "im", "winkel": "phase", "phasenwinkel": "phase", "kohärenz": "coherence",
    "cohérence": "coherence",
}  # fmt: skip
_PAIR = re.compile(
    r"(?P<output>[^\[\]/]+?)\s*/\s*(?P<input>[^\[\]/]+?)"
    r"(\s*\[(?P<unit>[^\[\]]*)\]|\s*\((?P<round>[^()]*(?:\([^()]*\)[^()]*)*)\))?"
    rf"((?<=[\])])|[\s_])\s*\(?(?P<part>{'|'.join(sorted(_PART_WORDS, key=len, reverse=True))})\)?\.?"
    r"(\s*[\[(](?P<own>[^\[\]]*)[\])])?",
    re.IGNORECASE,
)
#: Part by which two clocks in one table may differ: times of writing and of sampling differ by less.
_SAME_CLOCK = 0.02
#: Part of a step by which the starts of two clocks of one name may differ.
_SAME_START = 0.1
_NO_LETTERS = re.compile(r"[\W\d_]+")
#: A day in s, and the latest time that is believed: a clock that counts from 1970 in ms is 1.8e12.
_DAY, _LATEST = 86400.0, 1e11
#: What may stand before a pair of degrees of freedom: the estimator of an FRF.
_ESTIMATOR = re.compile(r"(?:H[12v]?|FRF|TF)[\s:_]+", re.IGNORECASE)
#: An estimator with the pair in brackets, as in ``H1(2:+Z/1:+X)`` and ``H1(2Z,1X)``.
_ESTIMATOR_OF = re.compile(
    r"^\s*(?:H[12v]?|FRF|TF)\s*[(\[]\s*(?P<output>[^()\[\]/,]+?)\s*[/,]\s*(?P<input>[^()\[\]/,]+?)\s*[)\]]",
    re.IGNORECASE,
)
#: The unit of a magnitude in decibels: the size of the reference, 1 by default, and its unit.
_DECIBEL = re.compile(
    r"dB\s*(?:re(?:f|l)?\b\.?:?)?\s*(?:10\^(?P<power>[+-]?\d{1,2})|(?P<size>\d+(?:\.\d*)?(?:e[+-]?\d{1,2})?))?"
    r"\s*(?P<unit>\S.*)?",
    re.IGNORECASE,
)
_PART_WORD = re.compile(
    rf"(?<![^\W\d_])(?:{'|'.join(sorted(_PART_WORDS, key=len, reverse=True))})(?![^\W\d_])", re.IGNORECASE
)
_PHASE_UNITS = {"deg": math.pi / 180, "°": math.pi / 180, "degree": math.pi / 180, "degrees": math.pi / 180, "rad": 1.0}
#: Seconds at the end of a date or time, before its zone; and what of their fraction is less than a microsecond.
_SECONDS = re.compile(r"(\d\d(?:[.,]\d+)?)\s*(?:Z|[+-][\d:]+|[AaPp][Mm])?\s*$")
_BELOW_MICROSECOND = re.compile(r"[.,]\d{6}(\d+)")
#: Rounding of phases in rad that is let pass.
_PHASE_ROUNDING = 0.01
_MOST_LISTED = 8  # names in a message
#: Units of a number that has none.
_RATIOS = ("1", "-")


def _column(table: Table, j: int, error: InputError | None = None, text: str = "") -> FileError:
    reason = str(error) if error else text
    return FileError(f"{table.path}: line {table.header_line}, column {j + 1} ({table.names[j]!r}): {reason}")


def time_record(table: Table, options: ReadOptions | None = None) -> FrfRecord | TimeRecord:
    """The time record of the channels in a CSV table, with gaps filled or refused as `options.longest_gap` allows.

    The column of times gives rate and start; `options.sampling_rate` must agree with it and then replaces its rate, or
    stands for a missing column, with the start 0 s. Columns of dates and columns without a name are left out. Uneven
    times are resampled if `options.resample` is set. None for `options` takes the defaults.

    Raises
    ------
    FileError
        If a header is not a degree of freedom with its unit and `options` do not state them, times are uneven, or a gap
        is too long to be filled.
    InputError
        If `options` contradict the table.
    """
    options = options or ReadOptions()
    count = len(table.names)
    numbers = tuple(range(1, count + 1))
    axis = _time_column(table, options)
    left_out = [j for j in range(count) if j != axis and (not table.names[j] or _first_date(table, j) is not None)]
    keep = [j for j in range(count) if j != axis and j not in left_out]
    omitted = [f"{table.names[j] or 'row numbers'} left out" for j in left_out]
    clock = _read_clock(table, axis, options)
    if axis is not None and not options.time_column:
        _require_one_clock(table, axis, options)
    values, clock_used = table.values[:, keep], clock
    if clock.uneven is not None:
        resampled = resample(table.path, clock.uneven, values, options.sampling_rate)
        values, clock_used = resampled.values, _Clock(resampled.rate, clock.start + resampled.start, resampled.words)
    plain = axis == 0 and is_axis(table.names[0]) and "commas, decimal points, names in line 1" in table.words
    channels = NamedChannels(
        path=table.path,
        names=tuple(table.names[j] for j in keep),
        units=tuple(table.units[j] for j in keep),
        values=values,
        rate=clock_used.rate,
        start=clock_used.start,
        numbers=tuple(numbers[j] for j in keep),
        lines=(table.header_line, table.first_line),
        words=", ".join(filter(None, (table.words, clock_used.words, *omitted))),
        tells_all=plain and not clock_used.words,
    )
    return record_of(channels, options)


def _time_column(table: Table, options: ReadOptions) -> int | None:
    """Index of the column of times, from 0; None if the table has none and the option `sampling_rate` replaces it.

    `options.time_column` decides if set; else the first column headed as time that is no mere date, a column of dates
    with clock times, a mere date headed as time, or dates in column 0, in this order. A column X beside Y and Z is no
    time, nor, with `sampling_rate`, is one that `columns` name. Raises `FileError` if there is none and `sampling_rate`
    is not set.
    """
    if options.time_column:
        numbers = range(1, len(table.names) + 1)
        return choose_columns(table.path, [options.time_column], table.names, list(numbers))[0]
    directions = {"x", "y", "z"} & {name_and_unit(name)[0].lower() for name in table.names}
    timed = [
        j
        for j, name in enumerate(table.names)
        if is_time(name)
        and not _is_chosen(table, j, options)
        and not (len(directions) == 3 and name_and_unit(name)[0].lower() == "x")
    ]
    clocks = [j for j in timed if not _is_day(table, j)]
    if not clocks and (timed or options.sampling_rate is None):
        dated = (j for j in range(len(table.names)) if _first_date(table, j) is not None)
        clocks = [j for j in dated if not _is_day(table, j)]
    if clocks or timed:
        return (clocks or timed)[0]
    if options.sampling_rate is None and _first_date(table, 0) is not None:
        return 0
    if options.sampling_rate is None:
        shown = ", ".join(table.names[:8])
        bare = "rad/s" if table.names[0].strip().lower() in ("w", "omega", "\u03c9") else "Hz"
        stated = next(iter(factors_in_header(table.names[0], table.units[0], parse_frequency_unit)), bare)
        raise FileError(
            f"{table.path}: line {table.header_line}: no column is headed as time, as in time_s, nor the first as frequency, as in"
            f" Frequency [Hz]; the columns are {shown:.200}: give `time_column` (a name or number) or `sampling_rate` (Hz) of time"
            f" histories, and of frequency responses {option_words(axis_unit=stated)}"
        )
    return None


def _first_date(table: Table, j: int) -> datetime | None:
    """Date or clock time in the first cell of column `j`; None if the cell is a number or no date."""
    return as_date(table.cell(0, j)) if np.isnan(table.values[0, j]) else None


def _is_day(table: Table, j: int) -> bool:
    """True if column `j` (from 0) holds dates without a time of day, as beside a column of clock times.

    Only its first, middle and last cells are read.
    """
    if _first_date(table, j) is None:
        return False
    dates = [as_date(table.cell(i, j)) for i in (0, len(table.texts) // 2, -1)]
    return all(date is not None and date.year > 1 and date.time() == datetime.min.time() for date in dates)


def _is_chosen(table: Table, j: int, options: ReadOptions) -> bool:
    return options.sampling_rate is not None and table.names[j] in options.columns


def _require_one_clock(table: Table, axis: int, options: ReadOptions) -> None:
    """Raise `InputError` if a further column headed as time is another clock than the column with index `axis`.

    Such tables hold pairs of times and samples for several channels. Another clock runs faster or slower over the rows
    that hold both times, or has the same name and starts at another time. A column that does not rise is no clock, nor
    is one whose unit neither `table` nor `options` state.
    """
    clocks = [
        j for j, name in enumerate(table.names) if name_and_unit(name)[0].lower() not in ("x", "t") and is_time(name)
    ]
    if axis not in clocks or len(clocks) < 2:
        return
    times = {}
    for j in clocks:
        column = table.values[:, j]
        written = column[np.isfinite(column)]
        if written.size < 2:
            continue
        try:
            times[j] = scale_of_times("", table.names[j], table.units[j], written, options) * column
        except InputError:
            continue  # a unit of something else, or none that is known
    for j, later in times.items():
        if axis not in times or j == axis:
            continue
        both = np.isfinite(times[axis]) & np.isfinite(later)
        first, second = times[axis][both], later[both]
        if len(first) < 2 or second[-1] <= second[0]:
            continue
        spans = float(first[-1] - first[0]), float(second[-1] - second[0])
        behind = float(np.median(second - first))
        words = f"{spans[0]:.6g} s and {spans[1]:.6g} s in all"
        if abs(spans[1] - spans[0]) <= _SAME_CLOCK * abs(spans[0]):
            step = spans[0] / (len(first) - 1)
            if not _are_namesakes(table.names[axis], table.names[j]) or abs(behind) <= _SAME_START * step:
                continue
            words = f"the second is {abs(behind):.6g} s {'ahead' if behind > 0 else 'behind'}"
        raise InputError(
            f"{table.path}: line {table.header_line}: columns {axis + 1} and {j + 1} hold times that differ: {words}; say by"
            f" {option_words(time_column=None)} which of them counts, and choose its channels by `columns`",
            "time_column",
        )


def _are_namesakes(first: str, second: str) -> bool:
    """True if two headers are alike but for numbers and marks, as ``Time (s)`` and ``Time (s).1``."""
    bare = [" ".join(_NO_LETTERS.split(name.lower())).strip() for name in (first, second)]
    return bare[0] == bare[1]


class _Clock(NamedTuple):
    """Sampling rate in Hz, time of the first sample in s, words on both, and times after the first, in s, to be resampled."""

    rate: float
    start: float
    words: str
    uneven: FloatArray | None = None


def _read_clock(table: Table, axis: int | None, options: ReadOptions) -> _Clock:
    """Sampling rate in Hz, time of the first sample in s, words on both, and uneven times, from the column of times.

    `axis` is the index of that column; if None, the rate is `options.sampling_rate` and the start 0 s. A stated rate
    replaces that of the column, with which it must agree. Uneven times that are to be resampled are returned in
    `uneven`, (n_times,) in s after the start, with rate 0. Raises `FileError` or `InputError` if times and options
    disagree.
    """
    stated = options.sampling_rate
    if axis is None:
        return _Clock(stated or 1.0, 0.0, "sampling rate as given")
    texts = table.column(axis)
    if as_date(texts[0]) is not None:
        time, scale = _seconds(table, axis, texts), 1.0
        texts = [match[1] if (match := _SECONDS.search(text)) else "00" for text in texts]
    else:
        where = f"{table.path}: line {table.header_line}, column {axis + 1} ({table.names[axis]!r})"
        time = table.values[:, axis]
        scale = scale_of_times(where, table.names[axis], table.units[axis], time, options)
        if not np.isfinite(time).all():
            i = int(np.argmin(np.isfinite(time)))
            raise FileError(
                f"{table.path}: line {table.first_line + i}, column {axis + 1} ({table.names[axis]}) is NaN, infinite or empty;"
                " repair or remove the line"
            )
    start = float(time[0] * scale)
    time = (time - time[0]) * scale  # differences first: a clock that counts from 1970 has no digits to lose
    if abs(start) > _LATEST:
        raise FileError(
            f"{table.path}: line {table.first_line}, column {axis + 1} ({table.names[axis]}) is {texts[0]}, which would be"
            f" {abs(start) / _DAY / 365.25:,.0f} years; correct the unit of the times"
        )
    even = sampling_rate(table.path, time, texts, scale, table.first_line, axis + 1, options.resample != "")
    if even is None:
        return _Clock(0.0, start, "", time)
    rate, error, step = even
    words = f"times rounded to {step:g} s" if error else ""
    if stated is None and error > SURE:
        raise FileError(
            f"{table.path}: column {axis + 1} ({table.names[axis]}) is rounded to {step:g} s, so that it tells the sampling rate"
            f" {rate:.6g} Hz to {100 * error:.2g} % only; give `sampling_rate`, or write more digits"
        )
    if stated is None:
        return _Clock(rate, start, words)
    if abs(stated / rate - 1) > max(error, 1e-9):
        raise InputError(
            f"{table.path}: column {axis + 1} ({table.names[axis]}) says sampling_rate {rate:.9g}, but `sampling_rate`"
            f" {stated:g} was given; leave it out, or correct it"
        )
    return _Clock(stated, start, words)


def last_digits(texts: Sequence[str]) -> FloatArray:
    """Size of the last digit of each written number, (n,), in the unit of the number: 0.01 for ``3.25``.

    Numbers of the same power of ten are taken to be written to the longest of them, since trailing zeros may be omitted: 10.5
    stands for 10.5000 beside 10.4375. `texts` are the numbers as written.
    """
    parts = [text.lower().replace("d", "e").replace(",", ".").partition("e") for text in texts]
    shift = np.array([int(power) if power else 0 for _, _, power in parts])
    digits = np.array([len(mantissa.partition(".")[2]) for mantissa, _, _ in parts]) - shift
    number = np.abs([float(mantissa) for mantissa, _, _ in parts])
    sized = number > 0
    powers = shift[sized] + np.floor(np.log10(number[sized])).astype(int)
    least = int(powers.min(initial=0))
    longest = np.full(int(powers.max(initial=0)) - least + 1, digits.min(initial=0))
    np.maximum.at(longest, powers - least, digits[sized])
    n_digits = np.full(len(texts), digits.max(initial=0))  # 0 is as exact as any
    n_digits[sized] = longest[powers - least]
    return 10.0 ** -n_digits.astype(float)


def _seconds(table: Table, axis: int, texts: Sequence[str]) -> FloatArray:
    """Dates or clock times as seconds after the first of them, (n_rows,); clock times that fall back count as past midnight.

    `texts` are the cells of the column with index `axis`. Raises `FileError` for a cell that is no date like the first.
    """
    first = as_date(texts[0])
    seconds = np.empty(len(texts))
    for i, text in enumerate(texts):
        date = as_date(text)
        if date is None or first is None or (date.tzinfo is None) != (first.tzinfo is None):
            raise FileError(
                f"{table.path}: line {table.first_line + i}, column {axis + 1} ({table.names[axis]}) must be a date like those"
                " above; repair or remove the line"
            )
        rest = _BELOW_MICROSECOND.search(text)
        seconds[i] = (date - first).total_seconds() + (1e-6 * float(f"0.{rest[1]}") if rest else 0.0)
    seconds -= seconds[0]
    if first is not None and first.year == 1:
        midnights = np.diff(seconds, prepend=0.0) < -_DAY / 2
        seconds += _DAY * np.cumsum(midnights)
    return seconds


def sampling_rate(
    path: Path,
    time: FloatArray,
    texts: Sequence[str],
    scale: float,
    first_line: int,
    column: int,
    to_resample: bool = False,
) -> Rate | None:
    """Sampling rate of a column of times, with its error and the last digit; None if uneven and `to_resample`.

    Steps count as even if they are equal to rounding, or differ by the last written digits only.

    Parameters
    ----------
    path : Path
        File, named in errors.
    time : (n_times,) float array
        Times in s.
    texts : (n_times,) sequence of str
        The times as written.
    scale : float
        Factor from the written times to s.
    first_line, column : int
        Line of the first time and column of the times, from 1, for messages.
    to_resample : bool
        True if uneven times are to be resampled later, so that they are no error.

    Returns
    -------
    Rate or None
        Rate in Hz, its relative uncertainty, and the largest rounding step in s; the last two are 0 without rounding.

    Raises
    ------
    FileError
        If there are fewer than two samples, times do not increase, or steps are uneven beyond rounding and not to be
        resampled.
    """
    if time.size < 2:
        raise FileError(f"{path}: one line does not tell a sampling rate; give at least two samples")
    step = float(time[-1] - time[0]) / (time.size - 1)
    if step <= 0:
        raise FileError(f"{path}: column {column}: time must increase, got {time[0]:g} first and {time[-1]:g} last")
    exact = np.zeros(time.size)
    even = even_rate(time, exact) or even_rate(time, last_digits(texts) * scale)
    if even is not None or to_resample:
        return even
    steps = np.diff(time)
    back = steps <= 0
    i = int(np.argmax(back if back.any() else np.abs(steps - step)))
    raise FileError(
        f"{path}: line {i + first_line + 1}, column {column}: time must be even, got a step of {time[i + 1] - time[i]:.9g} s"
        f" where the mean is {step:.9g} s; {_uneven_remedy(time, i)}"
    )


def _uneven_remedy(time: FloatArray, i: int) -> str:
    """Advice for an uneven step between samples `i` and `i` + 1 of `time` (n_times,) in s, as text that ends an error.

    It names repeated lines if the time stands still or goes back, missing lines if the step is a multiple of the median
    step, else more digits or resampling.
    """
    usual = float(np.median(np.diff(time)))
    step = time[i + 1] - time[i]
    if step <= 0:
        backward = int((np.diff(time) <= 0).sum())
        return (
            f"{backward} times are not later than the one before: remove repeated lines and sort the others, or write more"
            " digits where rounding made them alike"
        )
    missing = step / usual - 1 if usual > 0 else 0.0
    if missing > 0.5 and abs(missing - round(missing)) < 0.01 * (missing + 1):
        return (
            f"{round(missing)} lines are missing at the usual step of {usual:.9g} s: cut the file there, or add these lines "
            f"with empty cells and interpolate with {option_words(longest_gap=round(missing))}"
        )
    return f"write more digits, or {resampling_remedy()}"


def time_header(record: TimeRecord) -> tuple[list[str], list[FloatArray]]:
    """Headers and columns (n_times,) for the CSV table of a time record, times in s first."""
    names = [f"{dof} [{unit}]" for dof, unit in zip(record.channels, record.units, strict=True)]
    return ["time_s", *names], [record.time, *record.values.T]


class _ColumnHeader(NamedTuple):
    """Content of a column's header, or the user's words in its place.

    `decibel_reference` is the size in `unit` to which 0 dB stands, None for a column that is not in decibels.
    """

    output: str
    input: str
    unit: str
    part: str
    decibel_reference: float | None = None


class _Column(NamedTuple):
    output: Dof
    input: Dof
    unit: FrfUnit | None
    part: str
    factor: float
    is_decibel: bool = False

    def to_si(self, values: FloatArray) -> FloatArray:
        """The values of the column in SI units, rad or 1, (n_lines,), from those of the file."""
        return self.factor * (10.0 ** (values / 20.0) if self.is_decibel else values)


def _read_headers(table: Table, options: ReadOptions) -> list[_ColumnHeader]:
    """Output, input, unit and part (``re``, ``im``, ``magnitude``, ...) of each column after the frequencies, in order.

    They come from the headers, or from the options `outputs`, `inputs` and `parts`, with parts varying fastest. Raises
    `FileError` for a header that cannot be read, and `InputError` if the options do not fit the table.
    """
    layout = options.csv or CsvLayout()
    units = [unit or name_and_unit(name)[1] for name, unit in zip(table.names, table.units, strict=True)]
    if layout.parts:
        count = len(options.outputs) * len(options.inputs) * len(layout.parts)
        if count != len(table.names) - 1:
            raise InputError(
                f"{table.path}: {len(table.names) - 1} columns follow the frequencies, but {len(options.outputs)} `outputs` x"
                f" {len(options.inputs)} `inputs` x {len(layout.parts)} `parts` are {count}; give what each column is by these",
                "outputs",
            )
        combinations = product(options.outputs, options.inputs, layout.parts)
        assumed = [
            _resolve_decibels(table, j, _ColumnHeader(a, b, units[j], part), options)
            for j, (a, b, part) in enumerate(combinations, start=1)
        ]
        _require_headers_agree(table, assumed)
        return assumed
    heads = []
    for j, name in enumerate(table.names[1:], start=1):
        match = _match_pair(name)
        if match is None:
            _resolve_decibels(table, j, _ColumnHeader(name, "", units[j], ""), options)  # a level is refused as one
            raise _column(table, j, text=(
                "head a pair with output/input, unit and part, as in 12Z+/3Z+ [(m/s^2)/N] re (or im, magnitude, phase, std,"
                f" coherence); or say what the columns are by {option_words(outputs=None, inputs=None, unit=None)} and"
                f" {layout_words(parts='re,im')}, for every output and input in this order"
            ))  # fmt: skip
        unit = match["unit"] or match["round"] or match["own"] or table.units[j]
        part = _PART_WORDS[match["part"].lower()]
        if part == "phase":
            near = [text for text in (match["unit"], match["round"]) if text and text.strip().lower() in _PHASE_UNITS]
            unit = _phase_unit(table, j, match["own"] or next(iter(near), None))
        output = _without_estimator(match["output"], match["input"])
        heads.append(_resolve_decibels(table, j, _ColumnHeader(output, match["input"], unit, part), options))
    return _output_first(heads, options)


def _resolve_decibels(table: Table, j: int, head: _ColumnHeader, options: ReadOptions) -> _ColumnHeader:
    """Header `head` of column `j` of `table`; for decibels, with the unit of their reference and the size of 0 dB.

    Other headers are returned as they are. Raises `FileError` for a level, mean or density other than a magnitude in
    decibels, and for one whose reference neither the header nor `options.unit` says.
    """
    word = level_word(f"{table.names[j]} {table.units[j]}")
    if not word:
        return head
    decibel = _DECIBEL.fullmatch(head.unit.strip())
    if decibel is None or head.part != "magnitude":
        raise _column(
            table,
            j,
            text=f"{word!r} stands for a level, a mean or a density, which has no phase or another one; export"
            " the response itself, or give the column another name or unit",
        )
    reference = bare_unit(decibel["unit"] or options.unit)
    size = float(decibel["size"] or 1.0) * 10.0 ** int(decibel["power"] or 0)
    if not reference or not size > 0:
        raise _column(
            table,
            j,
            text="does not say what 0 dB is; head it as in 12Z+/3Z+ magnitude (dB re 1 (m/s^2)/N), or say the unit whose 1 is"
            f" 0 dB by {option_words(unit='(m/s^2)/N')}",
        )
    return head._replace(unit=reference, decibel_reference=size)


def _match_pair(name: str) -> re.Match[str] | None:
    """Match of a header as a pair output/input with unit and part (`re`, `phase`, ...); None if it is no such pair.

    The part follows the pair in `name`, or precedes it if both names are degrees of freedom; it is put last then.
    Groups of the match: `output`, `input`, `unit` (in square brackets) or `round` (in round ones), `part`, and `own`, a
    unit in brackets behind the part.
    """
    if len(name) > LONGEST_NAME:
        return None
    name = _ESTIMATOR_OF.sub(r"\g<output>/\g<input>", name, count=1)
    match, part = _PAIR.fullmatch(name), _PART_WORD.match(name)
    if match and is_read_by(bare_unit(f"{match['output']}/{match['input']}"), parse_frf_unit):
        match = None  # its unit alone, as in (m/s^2)/N Real
    if match or part is None:
        return match
    turned = _PAIR.fullmatch(f"{name[part.end() :].strip(' :_')} {part[0]}")
    is_pair = turned and as_dof(_without_estimator(turned["output"], turned["input"])) and as_dof(turned["input"])
    return turned if is_pair else None


def _without_estimator(output: str, load: str) -> str:
    """The sensor `output` of a header, without ``H1`` and the like before it if a degree of freedom follows there.

    It stays as it is if `load` is no degree of freedom.
    """
    bare = _ESTIMATOR.sub("", output, count=1)
    return bare if as_dof(bare) and as_dof(load) else output


def _phase_unit(table: Table, j: int, in_name: str | None) -> str:
    """Unit text of the phases in column `j` of `table`, from its header or the line of units below; "" without either.

    `in_name` is the unit in the header, None if there is none. Raises `FileError` if both are stated and differ.
    """
    units = [text for text in (in_name, table.units[j]) if text]
    if len({_PHASE_UNITS.get(text.strip().lower()) for text in units}) > 1:
        raise _column(table, j, text=f"says {units[0]} and {units[1]} of its phases; correct one of them")
    return units[0] if units else ""


def _output_first(heads: list[_ColumnHeader], options: ReadOptions) -> list[_ColumnHeader]:
    """Column heads with output and input exchanged where the table names the load first; else `heads` as they are.

    They are exchanged only if the options `outputs` and `inputs`, or their numbers, fit the exchanged order alone.
    """
    names = [list(dict.fromkeys(pair)) for pair in zip(*((head.output, head.input) for head in heads), strict=True)]
    counts = [len(labels) for labels in names]
    if all(map(as_dof, names[0] + names[1])):
        inputs = {as_dof(name) for name in options.inputs}
        is_turned = (
            bool(inputs) and inputs >= {as_dof(name) for name in names[0]} and not inputs >= set(map(as_dof, names[1]))
        )
    else:
        wanted = [len(options.outputs), len(options.inputs)]
        is_turned = 0 not in wanted and counts != wanted and counts[::-1] == wanted
    return [head._replace(output=head.input, input=head.output) for head in heads] if is_turned else heads


def _require_headers_agree(table: Table, assumed: Sequence[_ColumnHeader]) -> None:
    """Raise `FileError` if a header states another part, sensor or load than the position of its column implies.

    `assumed` are the headers by position, one for each column of `table` after the frequencies. A name in a header that
    is no degree of freedom may stand for any one, but for the same one throughout.
    """
    meant: dict[tuple[str, str], str] = {}
    for j, head in enumerate(assumed, start=1):
        name = table.names[j]
        match = _match_pair(name)
        words = [match["part"]] if match is not None else _PART_WORD.findall(name)
        said = {_PART_WORDS[word.lower()] for word in words} or {head.part}
        pairs = (
            []
            if match is None
            else [
                ("output", _without_estimator(match["output"], match["input"]), head.output),
                ("input", match["input"], head.input),
            ]
        )
        is_other = any(
            _is_other_dof(word, name) or meant.setdefault((role, word), name) != name for role, word, name in pairs
        )
        if head.part not in said or is_other:
            raise _column(
                table,
                j,
                text=f"the header contradicts `parts`, `outputs` and `inputs`, by which it is {head.part} of"
                f" {head.output}/{head.input}; leave `parts` out where headers say what columns are, or correct its order",
            )


def _is_other_dof(header: str, name: str) -> bool:
    """True if both texts name degrees of freedom, and not the same one but for its sense."""
    stated, meant = as_dof(header), as_dof(name)
    return stated is not None and meant is not None and stated.unsigned != meant.unsigned


def _names_by_user(table: Table, option: str, names: list[str], by_user: tuple[str, ...]) -> dict[str, str]:
    """Mapping from the table's names of sensors or loads to those in `by_user`, which follow the order of first occurrence.

    Empty if `by_user` is empty or all `names` are degrees of freedom already. Raises `InputError`, naming the option
    `option`, if the number of distinct names differs from that of `by_user`.
    """
    distinct = list(dict.fromkeys(names))
    if not by_user or all(map(as_dof, distinct)):
        return {}
    if len(by_user) != len(distinct):
        shown = ", ".join(distinct[:8]) + (", ..." if len(distinct) > 8 else "")
        raise InputError(
            f"{table.path}: `{option}` must have {len(distinct)} entries, one for each of {shown}, in the order of the table,"
            f" got {len(by_user)}",
            option,
        )
    return dict(zip(distinct, by_user, strict=True))


def _parse_column(
    table: Table, j: int, head: _ColumnHeader, outputs: dict[str, str], inputs: dict[str, str], options: ReadOptions
) -> _Column:
    """Degrees of freedom, unit, part, factor to SI and whether it is in decibels, of column `j` of `table`.

    The factor of decibels is that of 0 dB; the unit is None for phases and coherences. `head` is what the header says,
    whose unit, if missing, is `options.unit`. `outputs` and `inputs` map the table's names to degrees of freedom where
    these differ. Raises `FileError`, with line and column, if the header cannot be read.
    """
    try:
        output = parse_dof(outputs.get(head.output, head.output))
        load = parse_dof(inputs.get(head.input, head.input))
        if head.part == "phase":
            return _Column(
                output, load, None, head.part, _phase_factor(table, j, head.unit, options.csv or CsvLayout())
            )
        if head.part == "coherence":
            return _Column(output, load, None, head.part, 1.0)
        if not (head.unit or options.unit):
            raise InputError("has no unit; head it as in 12Z+/3Z+ [(m/s^2)/N] re, or give `unit` in [record]")
        unit = _unit_of(head.unit or options.unit, output, load)
        _require_name_agrees(table.names[j], unit)
        require_same_rotation(table.path, f"output {output}", output.is_rotation, unit.output_rotation)
        require_same_rotation(table.path, f"input {load}", load.is_rotation, unit.input_rotation)
    except InputError as error:
        raise _column(table, j, error) from error
    reference = head.decibel_reference
    factor = unit.factor * (1.0 if reference is None else reference)
    return _Column(output, load, unit, head.part, factor, reference is not None)


def _require_meanings(
    table: Table, heads: Sequence[_ColumnHeader], outputs: dict[str, str], inputs: dict[str, str]
) -> None:
    """Raise `FileError` if a sensor or load name is neither a degree of freedom nor explained by the user.

    `outputs` and `inputs` map names in `heads`, the headers of the table's columns, to the user's degrees of freedom.
    """
    names = {
        "outputs": dict.fromkeys(head.output for head in heads if head.output not in outputs),
        "inputs": dict.fromkeys(head.input for head in heads if head.input not in inputs),
    }
    unclear = {role: [name for name in of_role if not as_dof(name)] for role, of_role in names.items()}
    unclear = {role: of_role for role, of_role in unclear.items() if of_role}
    if not unclear:
        return
    role, name = next((role, of_role[0]) for role, of_role in unclear.items())
    first = next(j for j, head in enumerate(heads, 1) if name == (head.output if role == "outputs" else head.input))
    listed = "; ".join(f"{role}: {join_words(tuple(names[role]), _MOST_LISTED)}" for role in unclear)
    text = (
        f"cannot read {name!r} as a degree of freedom; write node, direction and sense, as in 12Z+ or 3RX-; or say what"
        f" the names of the table are ({listed}), in this order, by {option_words(**dict.fromkeys(unclear))}"
    )
    raise _column(table, first, text=text)


def _require_name_agrees(name: str, unit: FrfUnit) -> None:
    """Raise `InputError` if the name of a column states another unit than `unit`, in which the column is read."""
    text = other_unit_in_name(name, parse_frf_unit, unit.kind, unit.factor)
    if text:
        raise InputError(f"the name says {text!r}, and the column is read in another unit; correct one of them")


def _phase_factor(table: Table, j: int, unit: str, layout: CsvLayout) -> float:
    """Factor from the phases in column `j` to rad, by `unit`, by `layout.phase_unit`, or because values can only be degrees.

    `unit` is the unit in the header, "" if absent. Raises `InputError` if units contradict, or nothing tells the unit.
    """
    factor = _PHASE_UNITS.get((unit or layout.phase_unit).strip().lower())
    if unit and layout.phase_unit and factor not in (None, _PHASE_UNITS[layout.phase_unit]):
        raise InputError(
            f"says that its phases are {unit}, but `phase_unit` {layout.phase_unit} was given; leave it out"
        )
    if factor is None and _is_surely_degrees(table.values[:, j]):
        factor = _PHASE_UNITS["deg"]
    if factor is None:
        raise InputError(
            f"does not say whether its phases are deg or rad; give {layout_words(phase_unit='deg')}, or rad"
        )
    return factor


def _is_surely_degrees(phase: FloatArray) -> bool:
    """True if phases (n_lines,) cannot be in rad: they exceed a turn, and step by more than half a turn, if taken as rad."""
    return bool(
        np.abs(phase).max() > 2 * np.pi + _PHASE_ROUNDING
        and np.abs(np.diff(phase)).max(initial=0.0) > np.pi + _PHASE_ROUNDING
    )


def _unit_of(text: str, output: Dof, load: Dof) -> FrfUnit:
    """The FRF unit parsed from a header's text; ``1``, ``-`` and the like mean a transmissibility of motion.

    Raises `InputError` if the text is no FRF unit, or a dimensionless ratio combines a translation and a rotation.
    `output` and `load` are the degrees of freedom of the FRF.
    """
    if text.strip() not in _RATIOS:
        return parse_frf_unit(text)
    if output.is_rotation != load.is_rotation:
        raise InputError(
            f"{text!r} is a ratio of one motion at two places, but one of {output} and {load} is a rotation; give the unit, as in"
            " (rad/s^2)/(m/s^2)"
        )
    return FrfUnit("transmissibility", 1.0, output.is_rotation, load.is_rotation)


def frf_record(table: Table, options: ReadOptions) -> FrfRecord | TimeRecord:
    """FRF record in a CSV table, reduced to outputs and inputs of `options`; each output needs a column for each input.

    If the table's names are not degrees of freedom, `options.outputs` and `options.inputs` state them, in the order of
    the table; otherwise these options choose among the table's channels, all if not set. Magnitudes and phases become
    complex values; columns of standard deviations give the variance.

    Raises
    ------
    FileError
        If a header cannot be read, a pair is missing or doubled, kinds are mixed, or frequencies do not increase.
    InputError
        If `options` do not fit the table.
    """
    to_hertz = table.to_hertz
    if to_hertz is None or np.isnan(to_hertz):
        raise _column(
            table,
            0,
            text=f"does not say the unit of its frequencies, of Hz, kHz, rad/s or rpm; give {option_words(axis_unit='Hz')}",
        )
    heads = _read_headers(table, options)
    of_outputs = _names_by_user(table, "outputs", [head.output for head in heads], options.outputs)
    of_inputs = _names_by_user(table, "inputs", [head.input for head in heads], options.inputs)
    _require_meanings(table, heads, of_outputs, of_inputs)
    columns = [_parse_column(table, j, head, of_outputs, of_inputs, options) for j, head in enumerate(heads, start=1)]
    _require_unit(table, columns, options.unit)
    kind = _kind(table, columns)
    _require_same_unit_of_both_parts(table, columns)
    outputs = tuple(dict.fromkeys(column.output for column in columns))
    inputs = tuple(dict.fromkeys(column.input for column in columns))
    parts: dict[str, FloatArray] = {}
    for j, column in enumerate(columns, start=1):
        shape = (table.values.shape[0], len(outputs), len(inputs))
        part = parts.setdefault(column.part, np.full(shape, np.nan))
        position = (slice(None), outputs.index(column.output), inputs.index(column.input))
        if not np.isnan(part[position]).all():
            raise _column(table, j, text="this pair and part is there twice; remove one")
        part[position] = column.to_si(table.values[:, j])
    is_polar = "magnitude" in parts or "phase" in parts
    _require_complete(table, parts, ("magnitude", "phase") if is_polar else ("re", "im"), outputs, inputs)
    frequency = table.values[:, 0] * to_hertz
    _require_sound(table, columns, frequency)
    record = FrfRecord(
        frequency=frequency,
        values=parts["magnitude"] * np.exp(1j * parts["phase"]) if is_polar else parts["re"] + 1j * parts["im"],
        outputs=outputs,
        inputs=inputs,
        kind=kind,
        variance=parts["std"] ** 2 if "std" in parts else None,
        coherence=parts.get("coherence"),
        noise_source="declared" if "std" in parts else "unknown",
        source=source_with_note(
            table.path, ", ".join(f"{name} is {dof}" for name, dof in {**of_outputs, **of_inputs}.items())
        ),
    )
    remaining = replace(
        options,
        outputs=() if of_outputs else options.outputs,
        inputs=() if of_inputs else options.inputs,
        axis_unit="",
    )
    return select_channels(table.path, record, remaining)


def _require_unit(table: Table, columns: list[_Column], unit: str) -> None:
    """Raise `FileError` if the option `unit` is set ("" if not) and differs from a unit in a header."""
    if unit and {column.unit for column in columns} - {None, parse_frf_unit(unit)}:
        raise FileError(
            f"{table.path}: line {table.header_line} says the unit of each column, but `unit` {unit!r} was given; leave the"
            " option out",
            "unit",
        )


def _require_same_unit_of_both_parts(table: Table, columns: list[_Column]) -> None:
    """Raise `FileError` if real and imaginary parts of a pair among `columns` are in different units."""
    units: dict[tuple[Dof, Dof], FrfUnit | None] = {}
    for j, column in enumerate(columns, start=1):
        if column.part not in ("re", "im"):
            continue
        other = units.setdefault((column.output, column.input), column.unit)
        if column.unit != other:
            raise _column(
                table, j, text="its real and imaginary parts are in different units; write the unit that both are in"
            )


def _kind(table: Table, columns: list[_Column]) -> FrfKind:
    """The kind of FRF, such as "mobility", that all `columns` share; `FileError` if they differ or none has a unit."""
    kinds = {column.unit.kind for column in columns if column.unit is not None}
    if len(kinds) != 1:
        raise FileError(
            f"{table.path}: line {table.header_line}: one table holds one kind, got {', '.join(sorted(kinds))}; split the table"
        )
    return kinds.pop()


def _require_complete(
    table: Table,
    parts: dict[str, FloatArray],
    needed: tuple[str, ...],
    outputs: tuple[Dof, ...],
    inputs: tuple[Dof, ...],
) -> None:
    """Raise `FileError` unless each part has a value on each line for each pair of output and input.

    `parts` maps ``re``, ``std``, ... to (n_frequencies, n_outputs, n_inputs) arrays, NaN where no column was read;
    `needed` are the parts that must be there. `outputs` and `inputs` are the channels of the axes.
    """
    for part in (*needed, *(name for name in parts if name not in needed)):
        for a, output in enumerate(outputs):
            for b, load in enumerate(inputs):
                if part not in parts or np.isnan(parts[part][:, a, b]).any():
                    raise FileError(
                        f"{table.path}: line {table.header_line}: no column {output}/{load} {part}; every output needs one "
                        "for every input"
                    )


def _require_sound(table: Table, columns: list[_Column], frequency: FloatArray) -> None:
    """Raise `FileError` for frequencies that do not increase, or coherences, magnitudes or deviations out of range.

    Coherences must be from 0 to 1, magnitudes that are not in decibels and standard deviations at least 0. `columns` are
    those after the frequencies, `frequency` (n_lines,) holds these in Hz.
    """
    falls = np.diff(frequency) <= 0
    if falls.any():
        i = int(np.argmax(falls))
        pair, line = frequency[i : i + 2], table.first_line + i
        raise FileError(
            f"{table.path}: lines {line} and {line + 1}, column 1 ({table.names[0]}): frequencies must increase, got"
            f" {pair[0]:.9g} Hz followed by {pair[1]:.9g} Hz; sort the lines and remove repeated ones"
        )
    for j, column in enumerate(columns, start=1):
        most = {"coherence": COHERENCE_MOST, "std": np.inf, "magnitude": np.inf}.get(column.part)
        wrong = (
            np.zeros(0) if most is None or column.is_decibel else (table.values[:, j] < 0) | (table.values[:, j] > most)
        )
        if wrong.any():
            i, words = int(np.argmax(wrong)), "from 0 to 1" if column.part == "coherence" else "at least 0"
            is_level = column.part == "magnitude"
            remedy = (
                "head magnitudes in decibels as in (dB re 1 (m/s^2)/N)" if is_level else "repair or remove the line"
            )
            raise FileError(
                f"{table.path}: line {table.first_line + i}, column {j + 1} ({table.names[j]}) must be {words}, got"
                f" {table.values[i, j]:.9g} at {frequency[i]:.9g} Hz; {remedy}"
            )


def _frf_unit(record: FrfRecord, output: Dof, load: Dof) -> str:
    """Unit in SI, such as ``(m/s^2)/N``, of the FRF of `record` between `output` and `load`, as text."""
    motion = {"receptance": "", "mobility": "/s"}.get(record.kind, "/s^2")
    above = ("rad" if output.is_rotation else "m") + motion
    if record.is_per_motion:
        return f"({above})/({'rad' if load.is_rotation else 'm'}{motion})"
    return f"({above})/{'(N m)' if load.is_rotation else 'N'}"


def frf_header(record: FrfRecord) -> tuple[list[str], list[FloatArray]]:
    """Headers and columns (n_frequencies,) for the CSV table of an FRF record, frequencies in Hz first.

    For each output, then each input: real and imaginary parts, and coherence and standard deviation where the record has them.
    """
    header, columns = ["frequency_hz"], [record.frequency]
    for a, output in enumerate(record.outputs):
        for b, load in enumerate(record.inputs):
            name = f"{output}/{load} [{_frf_unit(record, output, load)}]"
            header += [f"{name} re", f"{name} im"]
            columns += [record.values[:, a, b].real, record.values[:, a, b].imag]
            if record.coherence is not None:
                header.append(f"{output}/{load} coherence")
                columns.append(record.coherence[:, a, b])
            if record.variance is not None:
                header.append(f"{name} std")
                columns.append(np.sqrt(record.variance[:, a, b]))
    return header, columns

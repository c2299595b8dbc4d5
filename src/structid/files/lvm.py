"""Text files of LabVIEW (LVM): one segment, with one column of times, with one for each channel, or with none.

References
----------
National Instruments: Specification for the LabVIEW Measurement File (.lvm).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.units import parse_time_unit

_END = "***End_of_Header***"
#: Relative distance of the steps of the printed times, which are rounded, from that of the head.
_STEPS = 0.02
#: Distance of a printed time from an even one, in parts of its last digit, that rounding explains.
_ROUNDED = 0.75
#: Relative distance of a rate from a whole number of Hz that counts as one.
_WHOLE = 1e-9


def start_unsaid_words(channel: str) -> str:
    """Note on a channel of LabVIEW that does not say when it starts, beside others that do."""
    return f"{channel} does not say when it starts, taken as the first that does"


class LvmClock(NamedTuple):
    """Sampling times of a channel.

    Attributes
    ----------
    rate : float
        Hz; 0 where the file does not say it.
    error : float
        Relative error of `rate` that the digits of the file leave open.
    off : float
        Largest distance of a printed time from an even one, in steps; 0 where rounding explains it.
    times : (n_samples,) float array
        s; empty where they are even.
    """

    rate: float
    error: float = 0.0
    off: float = 0.0
    times: FloatArray = np.zeros(0)


class OtherContentError(ValueError):
    """Exception for a sound file that holds what is not read; the message says what, and the remedy."""


class LvmChannel(NamedTuple):
    """A channel of an LVM file.

    Attributes
    ----------
    name, unit : str
    values : (n_samples,) float array
        As printed; NaN where a cell is empty.
    clock : LvmClock
    start : float
        s, relative to the channel that starts first.
    note : str, optional
        What is doubtful about the start; "" for nothing.
    """

    name: str
    unit: str
    values: FloatArray
    clock: LvmClock
    start: float
    note: str = ""


class _Segment(NamedTuple):
    """A file taken apart: entries of its head and of its segment by key, names of its columns, and its rows of cells."""

    head: Mapping[str, Sequence[str]]
    entries: Mapping[str, Sequence[str]]
    names: list[str]
    rows: list[list[str]]
    comma: bool

    def decimal(self, text: str) -> float:
        """The number in the cell `text`, NaN if empty; `ValueError` if it is none, or has a point but the head says commas."""
        if not text.strip():
            return np.nan
        if self.comma and "." in text:
            raise ValueError(f"its head says decimal commas, and it holds {text.strip()}")
        return float(text.replace(",", ".") if self.comma else text)

    def of_channels(self, key: str, count: int, step: int) -> list[str]:
        """The entry `key` of each channel, "" where it is missing; `step` is the number of columns that a channel has."""
        words = [*self.entries.get(key, []), *[""] * (count * step)]
        return [words[j * step].strip() for j in range(count)]


def read_lvm(path: Path) -> list[LvmChannel]:
    """The channels of the LVM file at `path` that hold samples, with units, clocks (s) and starts (s).

    Starts are relative to the channel that starts first, unless one column of times serves all channels.

    Raises
    ------
    OtherContentError
        If it holds several segments, or its channels are not over time.
    ValueError
        If the file is no LVM file, or its head and its rows differ.
    """
    segment = _take_apart(path)
    count = int(segment.entries["Channels"][0])
    layout = (segment.head.get("X_Columns") or ["One"])[0].strip()
    own_times, step = layout == "Multi", 2 if layout == "Multi" else 1
    other = set(segment.of_channels("X_Dimension", count, step)) - {"", "Time"}
    if other:
        raise OtherContentError(
            f"its channels are over {join_words(sorted(other))}, not over time; write time histories"
        )
    columns = [1 + step * j for j in range(count)]
    names = [segment.names[column] for column in columns if column < len(segment.names)]
    width = max(columns) + 1
    if len(names) != count or any(len(row) < width for row in segment.rows):
        fewest = min((len(row) for row in segment.rows), default=0)
        raise ValueError(
            f"its head says {count} channels, and it has {len(names)} names and a line of {fewest} cells, times included"
        )
    samples = [int(text) for text in segment.of_channels("Samples", count, step)]
    units, of_x, of_start, steps, dates, hours = (
        segment.of_channels(key, count, step)
        for key in ("Y_Unit_Label", "X_Unit_Label", "X0", "Delta_X", "Date", "Time")
    )
    sampled = [j for j in range(count) if samples[j]]
    moments = [(dates[j], hours[j]) for j in sampled] if layout != "One" else [("", "")] * len(sampled)
    starts = dict(zip(sampled, _starts(moments), strict=True))
    channels, clocks = [], dict[tuple[int, int, str, float], LvmClock]()
    for j in sampled:
        column = columns[j]
        n_rows = _count_rows(segment, column, samples[j], layout)
        scale = parse_time_unit(of_x[j]) if of_x[j] else 1.0
        timed = column - 1 if own_times else 0, n_rows, steps[j], scale
        if timed not in clocks:  # most files have one column of times
            printed = [row[timed[0]] for row in segment.rows[:n_rows]] if layout != "No" else []
            clocks[timed] = _clock(segment, printed, steps[j], scale)
        values = np.array([segment.decimal(row[column]) for row in segment.rows[:n_rows]])
        later = starts[j]
        start = (later or 0.0) + scale * segment.decimal(of_start[j] or "0")
        note = start_unsaid_words(names[j]) if later is None else ""
        channels.append(LvmChannel(names[j], units[j], values, clocks[timed], start, note))
    return channels


def _take_apart(path: Path) -> _Segment:
    """Head of the file at `path`, head of its only segment, names of columns, rows of cells, and decimal sign.

    The last is True for commas. A column of comments is left out. Raises `ValueError` if it is no LVM file, and
    `OtherContentError` if it holds several segments.
    """
    text = path.read_text(encoding="cp1252")
    lines = text.splitlines()
    if not text.endswith("\n"):
        raise ValueError("its last line has no end")
    if not lines[0].startswith("LabVIEW Measurement"):
        raise ValueError("it does not begin with LabVIEW Measurement")
    ends = [i for i, line in enumerate(lines) if line.startswith(_END)]
    if len(ends) > 2:
        raise OtherContentError(
            f"it holds {len(ends) - 1} segments, each a measurement with a head of its own, and one is read; save each in a file of"
            " its own, or write with one header only"
        )
    if len(ends) < 2:
        raise ValueError("it holds no segment")
    separator = "," if any(line.startswith("Separator,Comma") for line in lines[: ends[0]]) else "\t"
    head, entries = (
        {words[0].strip(): words[1:] for line in part if (words := line.split(separator))}
        for part in (lines[: ends[0]], lines[ends[0] + 1 : ends[1]])
    )
    rows = [line.split(separator) for line in lines[ends[1] + 2 :] if line.strip()]
    names = [name.strip() for name in lines[ends[1] + 1].split(separator)]
    if "Comment" in names:
        rows = [row[: names.index("Comment")] for row in rows]
    return _Segment(head, entries, names, rows, (head.get("Decimal_Separator") or ["."])[0].strip() == ",")


def _count_rows(segment: _Segment, column: int, n_samples: int, layout: str) -> int:
    """Number of rows of `segment` that belong to a channel, also those that were appended and continue its times.

    It ends with the last filled cell. `column` is the channel's column (from 0), `n_samples` the number in its head,
    and `layout` says which columns have times ("No" for none).

    Raises
    ------
    ValueError
        If there are fewer rows than the head says, or more without times that tell whether they continue it.
    """
    last = next((n for n in range(len(segment.rows), 0, -1) if segment.rows[n - 1][column].strip()), 0)
    if last < n_samples or (last > n_samples and layout == "No"):
        joined = (
            "; several writings without times do not say whether one continues the other" if last > n_samples else ""
        )
        raise ValueError(f"its head says {n_samples} samples of {segment.names[column]!r}, and it holds {last}{joined}")
    return last


def _starts(moments: Sequence[tuple[str, str]]) -> list[float | None]:
    """Times in s after the first of `moments`, each a date and a time of day in words; all 0 where the words are the same.

    None for one without words beside others that have some.

    Raises
    ------
    ValueError
        If they differ and one cannot be read, so that it is open which channel starts first.
    """
    said = [moment for moment in dict.fromkeys(moments) if any(moment)]
    if len(said) <= 1:
        return [0.0 if moment in said or not said else None for moment in moments]
    wholes, parts = [], []
    for date, hour in said:
        whole, _, part = hour.replace(",", ".").partition(".")
        try:
            wholes.append(datetime.strptime(f"{date} {whole}", "%Y/%m/%d %H:%M:%S"))
            parts.append(float(f"0.{part or 0}"))
        except ValueError:
            raise ValueError(
                f"its channels start at different times, and {date} {hour} is none as LabVIEW writes it (2026/01/31 12:00:00,5)"
            ) from None
    seconds = [(whole - min(wholes)).total_seconds() + part for whole, part in zip(wholes, parts, strict=True)]
    later = {moment: second - min(seconds) for moment, second in zip(said, seconds, strict=True)}
    return [later.get(moment) for moment in moments]


def _last_digit(text: str) -> float:
    """Size of the last digit of a number as it is written."""
    mantissa, _, power = text.strip().lower().replace(",", ".").partition("e")
    return float(10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])))


def _clock(segment: _Segment, printed: Sequence[str], step_text: str, scale: float) -> LvmClock:
    """The clock of a channel by the step in the head and by its printed times; `scale` turns both into s.

    `step_text` is that step in words, "" if missing. `printed` are the times in words; with fewer than two, or an empty
    one, the step alone counts, and the rate is 0 Hz without it. Times that are uneven beyond the rounding of their
    digits are kept; else the more exact of step and times gives the rate.

    Raises
    ------
    ValueError
        If the printed times do not increase, or run in steps more than 2 % off the head's.
    """
    step = scale * segment.decimal(step_text or "0")
    by_head = _rounded_clock(1 / step, scale * _last_digit(step_text) / 2 / step) if step > 0 else LvmClock(0.0)
    if len(printed) < 2 or not all(text.strip() for text in printed):
        return by_head
    times = scale * np.array([segment.decimal(text) for text in printed])
    digits = scale * np.array([_last_digit(text) for text in printed])
    mean = float(times[-1] - times[0]) / (len(times) - 1)
    if not mean > 0:
        raise ValueError("its X_Value column does not increase")
    off = np.abs(times - times[0] - mean * np.arange(len(times)))
    if (off > _ROUNDED * (digits + digits[0] + digits[-1])).any():
        return LvmClock(1 / mean, 0.0, float(off.max()) / mean, times)
    if step > 0 and abs(mean / step - 1) > _STEPS:
        raise ValueError(f"its X_Value column runs in steps of {mean:g} s, and its head says {step:g} s")
    error = float(digits.max()) / float(times[-1] - times[0])
    agrees = by_head.error == 0 and by_head.rate > 0 and abs(mean * by_head.rate - 1) <= error
    return by_head if agrees or 0 < by_head.error <= error else _rounded_clock(1 / mean, error)


def _rounded_clock(rate: float, error: float) -> LvmClock:
    """A clock of `rate` (Hz), or of the nearest whole number of Hz, without error, where that is meant.

    It is if the rate is such a number, or the relative `error` reaches it and is less than 0.1 Hz; else the clock has
    `rate` and `error`.
    """
    near = round(rate)
    if near and (abs(rate - near) <= _WHOLE * rate or abs(rate - near) <= rate * error < 0.1):
        return LvmClock(float(near))
    return LvmClock(rate, error)

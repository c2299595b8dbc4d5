"""Channels under the names that another program gave them, made a record: chosen, called by degrees of freedom, in SI units.

Tables of laboratories and files of loggers go this way. A channel called ``12Z+`` says itself what it is; others are
called by `ReadOptions.channels`, in the order of `ReadOptions.columns`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, as_dof, is_whole_number, parse_dof, parse_dofs
from structid.core.errors import FileError, InputError, about
from structid.core.units import Unit, parse_time_unit, parse_unit
from structid.records.formats.bare import channel_units, even_ramp, require_same_rotation
from structid.records.formats.gaps import Lines, source_with_note, whole
from structid.records.formats.headers import (
    is_read_by,
    level_word,
    name_and_unit,
    other_unit_in_name,
    require_axis_unit,
    statistic_word,
    time_factor,
)
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import select_channels
from structid.records.record import FrfRecord, TimeRecord

_SHOWN = 8
#: Between which dates of a spreadsheet lie, in days; the step, s, below which seconds of a day are not meant; and the part by which
#: a stated sampling rate may differ from that of the times.
_DATES, _SHORTEST, _NEAR_RATE = (20_000, 80_000), 2e-5, 0.01
_NAMED_BY = '`channels`, in the order of the columns, as in channels = ["1X", "2X"]'


@dataclass(frozen=True, eq=False)
class NamedChannels:
    """Channels of a file under the file's own names.

    Attributes
    ----------
    path : Path
    names : tuple of str
        Name of every channel, which may end with a unit in brackets.
    units : tuple of str
        Text of each channel's unit beside the name; "" where the file says none there.
    values : (n_times, n_channels) float array
        As the file has them; NaN where a sample is missing.
    rate, start : float
        Hz, and time of the first sample in s.
    numbers : tuple of int
        Number, from 1, by which the option `columns` may ask for each channel: that of its column in a table.
    lines : (int, int), optional
        Numbers, from 1, of the lines of a table that hold the names and the first samples.
    words : str
        How the file was understood.
    tells_all : bool
        Whether the file is laid out as structid writes it, so that nothing needs to be said of it.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    rate: float
    start: float = 0.0
    numbers: tuple[int, ...] = ()
    lines: tuple[int, int] | None = None
    words: str = ""
    tells_all: bool = False

    def locate(self, j: int) -> str:
        """Words on the position of channel `j` in the file."""
        if self.lines is None:
            return f"channel {self.number(j)} ({self.names[j]!r})"
        return f"line {self.lines[0]}, column {self.number(j)} ({self.names[j]!r})"

    @property
    def told_units(self) -> list[str]:
        """Unit text of each channel, from the line of units or from its name; "" for a channel without a unit."""
        return [unit or name_and_unit(name)[1] for name, unit in zip(self.names, self.units, strict=True)]

    def number(self, j: int) -> int:
        return self.numbers[j] if self.numbers else j + 1


def scale_of_times(described: str, name: str, unit: str, times: FloatArray, options: ReadOptions) -> float:
    """Factor from the times of a column to s, by its name and unit or by the option `axis_unit`.

    `times` (n_times,) are as written; `described` begins error messages.

    Raises
    ------
    InputError
        If nothing states the unit, it is no unit of time, the option contradicts the file, or times in s look like dates of a
        spreadsheet.
    """
    scale = _stated_scale_of_times(described, name, unit, options)
    _require_no_dates(described, times, scale, options)
    return scale


def _stated_scale_of_times(described: str, name: str, unit: str, options: ReadOptions) -> float:
    """Factor from the times of a column to s, as its header or the option `axis_unit` states.

    `name` and `unit` are the header and the unit below it; `described` begins error messages. Raises `InputError` if nothing
    states the unit, or header and option differ.
    """
    try:
        by_file = time_factor(name, unit)
    except InputError as error:
        raise InputError(
            f"{described} holds times: {error}; or leave the column out and give `sampling_rate` and `columns`"
        ) from error
    if not options.axis_unit:
        if by_file is None:
            raise InputError(
                f"{described} does not say the unit of its times; give {option_words(axis_unit=None)}: s, ms, us, min or day",
                "axis_unit",
            )
        return by_file
    with about("axis_unit"):
        by_user = parse_time_unit(options.axis_unit)
    require_axis_unit(
        f"{described} says the unit of its times", name, unit, by_file, options.axis_unit, by_user, parse_time_unit
    )
    return by_user


def _require_no_dates(described: str, times: FloatArray, scale: float, options: ReadOptions) -> None:
    """Raise `InputError` for times that are taken as s but look like the dates of a spreadsheet, days since 1900.

    `times` (n_times,) are in s, `scale` is the factor from the written times to s, and `described` begins the message. Times
    that agree with `options.sampling_rate` pass.
    """
    step = float(times[-1] - times[0]) / max(len(times) - 1, 1)
    if scale != 1.0 or not _DATES[0] < times[0] < _DATES[1] or not 0 < step < _SHORTEST:
        return
    stated = options.sampling_rate
    if stated is None or abs(stated * step - 1) > _NEAR_RATE:
        raise InputError(
            f"{described} holds times from {times[0]:.6g} in steps of {step:.2g}, which look like dates of a spreadsheet in days:"
            f" give {option_words(axis_unit='day')}, or write [day] where its head says s; if they are seconds, begin them at 0",
            "axis_unit",
        )


def choose_columns(path: Path, wanted: Sequence[str | int], names: Sequence[str], numbers: Sequence[int]) -> list[int]:
    """Indices (from 0) of the columns named in `wanted`, in its order; an entry that is no name of a column is its number.

    Parameters
    ----------
    path : Path
        File, named in errors.
    wanted : sequence of str or int
        Names, with or without the unit in brackets, or numbers.
    names : sequence of str
        Headers of all columns.
    numbers : sequence of int
        Number of each of these columns in the file.

    Raises
    ------
    InputError
        If there is no such column, or several have the name.
    """
    indices = []
    for text in map(str, wanted):
        matches = [j for j, name in enumerate(names) if text in (name, name_and_unit(name)[0])]
        if len(matches) > 1:
            those = ", ".join(str(numbers[j]) for j in matches)
            raise InputError(f"{path}: {len(matches)} columns are called {text!r}; choose by their numbers {those}")
        if not matches and is_whole_number(text):
            matches = [j for j, number in enumerate(numbers) if number == int(text)]
        if not matches:
            known = ", ".join(f"{number} {name!r}" for number, name in zip(numbers, names, strict=True))
            raise InputError(f"{path}: there is no column {text!r}; the file has {known:.400}")
        indices.append(matches[0])
    return indices


def record_of(source: NamedChannels, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The time record of the channels that `options` choose, with units, names and gaps as they state.

    `source` has the file's names, units, samples (n_times, n_channels) and clock.

    Raises
    ------
    FileError
        If a name is no degree of freedom, a unit cannot be read, or a gap stays; the message names channel or line and column.
    InputError
        If `channels` or `units` do not fit the file.
    """
    numbers = [source.number(j) for j in range(len(source.names))]
    keep = (
        choose_columns(source.path, options.columns, source.names, numbers)
        if options.columns
        else list(range(len(numbers)))
    )
    if not keep:
        raise FileError(f"{source.path}: holds no channel besides its times; export the channels too")
    part = replace(
        source,
        names=tuple(source.names[j] for j in keep),
        units=tuple(source.units[j] for j in keep),
        values=source.values[:, keep],
        numbers=tuple(numbers[j] for j in keep),
    )
    dofs = [as_dof(name_and_unit(part.names[j])[0]) for j in range(len(keep))]
    by_user = bool(options.channels) and (bool(options.columns) or any(dof is None for dof in dofs))
    if by_user:
        _require_no_times(part)
    channels = _channels_by_option(part, options) if by_user else _channels_by_header(part, dofs)
    quantities, factors = _units_of(part, channels, options, source.names)
    chosen_here = replace(options, channels=()) if by_user else options
    lines = None if source.lines is None else Lines(source.lines[1], part.numbers)
    samples = whole(
        source.path,
        part.values,
        channels,
        source.rate,
        source.start,
        chosen_here,
        lines=lines,
    )
    words = "" if part.tells_all and not by_user else _describe_reading(part, channels, options)
    record = TimeRecord(
        sampling_rate=source.rate,
        values=samples.values * factors,
        channels=channels,
        quantities=quantities,
        start=samples.start,
        source=source_with_note(source.path, "; ".join(filter(None, (words, samples.note)))),
    )
    remaining = replace(chosen_here, columns=(), units=(), quantities=(), sampling_rate=None, axis_unit="")
    return select_channels(
        source.path, record, replace(remaining, quantities=options.quantities if part.tells_all else ())
    )


def _require_no_times(part: NamedChannels) -> None:
    """Raise `InputError` if a channel of `part`, but not every one, rises in even steps, as times and counts do.

    One whose header states a unit of motion or force is a load or a sensor that was moved evenly.
    """
    ramp = even_ramp(part.values)
    stated = [is_read_by(text, parse_unit) for text in part.told_units]
    if ramp is not None and any(stated):
        ramp = even_ramp(np.where(stated, 0.0, part.values))
    if ramp is not None:
        j, step = ramp
        raise InputError(
            f"{part.path}: {part.locate(j)} rises in even steps of {step:.4g}, as times and counts do: choose the"
            f" channels without it by `columns`; if it holds times, name it in {option_words(time_column=part.number(j))}, in place"
            " of `sampling_rate`",
            "columns",
        )


def _channels_by_header(part: NamedChannels, dofs: Sequence[Dof | None]) -> tuple[Dof, ...]:
    """Degrees of freedom of the channels of `part`, in their order, as the channels' names state them.

    `dofs` are those read from the names, None where a name is no degree of freedom: the first of these raises
    `FileError`.
    """
    for j, dof in enumerate(dofs):
        if dof is None:
            try:
                parse_dof(name_and_unit(part.names[j])[0])
            except InputError as error:
                raise FileError(
                    f"{part.path}: {part.locate(j)}: {error}; or head a channel with degree of freedom and unit, as in"
                    f" 12Z+ [m/s^2]; or say what each of the {len(part.names)} columns is by {_NAMED_BY} (choose with `columns`)"
                ) from error
    return tuple(dof for dof in dofs if dof is not None)


def _channels_by_option(part: NamedChannels, options: ReadOptions) -> tuple[Dof, ...]:
    """Degrees of freedom from the option `channels`, one for each column of `part`; `FileError` if their numbers differ."""
    with about("channels"):
        channels = parse_dofs(options.channels)
    if len(channels) != len(part.names):
        shown = ", ".join(name_and_unit(name)[0] for name in part.names[:_SHOWN])
        more = ", ..." if len(part.names) > _SHOWN else ""
        raise FileError(
            f"{part.path}: `channels` must have {len(part.names)} entries, one for each of the columns {shown}{more}, got"
            f" {len(channels)}; choose columns with `columns`",
            "channels",
        )
    return channels


def _units_of(
    part: NamedChannels, channels: tuple[Dof, ...], options: ReadOptions, names: Sequence[str]
) -> tuple[tuple, FloatArray]:
    """Quantities of the channels and their factors to SI, (n_channels,), from the file or `units` and `quantities`.

    `part` has the file's units of the channels, `channels` their degrees of freedom; `names` are those of all channels
    of the file. Raises `FileError` if a unit is missing, unknown or does not fit the channel, `InputError` if file and
    `options` differ.
    """
    unit_texts = part.told_units
    by_file: list[Unit | None] = []
    for j, text in enumerate(unit_texts):
        try:
            _require_samples(part, j, names)
            unit = _unit(text, bool(options.units))
            if unit is not None:
                require_same_rotation(part.path, str(channels[j]), channels[j].is_rotation, unit.rotation)
        except InputError as error:
            raise FileError(f"{part.path}: {part.locate(j)}: {error}") from error
        by_file.append(unit)
    if not options.units and not (options.quantities and not any(unit_texts)):
        for j, unit in enumerate(by_file):
            if unit is None:
                raise FileError(
                    f"{part.path}: {part.locate(j)}: has no unit; head a channel with degree of freedom and unit, as in"
                    ' 12Z+ [m/s^2], or give `units`, as in "g" for all or one a column'
                )
        units = [unit for unit in by_file if unit is not None]
        _require_names_agree(part, [unit.quantity for unit in units], [unit.factor for unit in units], options)
        return tuple(unit.quantity for unit in units), np.array([unit.factor for unit in units])
    quantities, factors = channel_units(part.path, channels, options)
    _require_names_agree(part, quantities, factors.tolist(), options)
    for j, unit in enumerate(by_file):
        if unit is not None and (unit.quantity != quantities[j] or abs(unit.factor / factors[j] - 1) > 1e-9):
            raise InputError(
                f"{part.path}: {part.locate(j)}: is in {unit_texts[j]}, but `units` says another; leave `units` out, or correct it",
                "units",
            )
    return quantities, factors


def _require_samples(part: NamedChannels, j: int, names: Sequence[str]) -> None:
    """Raise `InputError` if name or unit of channel `j` say that it holds levels, statistics or densities.

    `names` are those of all channels of the file, chosen or not.
    """
    word = level_word(f"{part.names[j]} {part.units[j]}") or statistic_word(part.names[j], names)
    if word:
        raise InputError(
            f"{word!r} stands for a level, a statistic or a density, and a record holds samples; export these, or give the column"
            " another name or unit"
        )


def _require_names_agree(
    part: NamedChannels, quantities: Sequence[str], factors: Sequence[float], options: ReadOptions
) -> None:
    """Raise `FileError` if the name of a channel states another unit than the channel is read in.

    `quantities` and `factors` to SI are those of the channels of `part` as they are read, by `options` or the file.
    """
    for j, (name, quantity, factor) in enumerate(zip(part.names, quantities, factors, strict=True)):
        text = other_unit_in_name(name, parse_unit, quantity.removeprefix("support_"), factor)
        if text:
            other = "`units`" if options.units else part.told_units[j] or "SI"
            raise FileError(
                f"{part.path}: {part.locate(j)}: the name says {text!r}, and the channel is read in another unit ({other});"
                " correct one of them",
                "units",
            )


def _unit(text: str, is_given: bool) -> Unit | None:
    """The unit parsed from a file's text; None for an empty text, or for an unknown unit if `is_given`.

    `is_given` says that the user states units. Otherwise an unknown unit raises `InputError`.
    """
    try:
        return parse_unit(text) if text else None
    except InputError:
        if is_given:
            return None
        raise


def _describe_reading(part: NamedChannels, channels: Sequence[Dof], options: ReadOptions) -> str:
    """A sentence on what was read: number of columns, samples, rate, units, and columns whose names were replaced.

    `part` are the channels as the file has them, `channels` the degrees of freedom that they are read as;
    `options.units` are named, where set, in place of the file's.
    """
    units = part.told_units
    if options.units:
        units = list(options.units) * (len(units) if len(options.units) == 1 else 1)
    kinds = [unit or "SI" for unit in dict.fromkeys(units)]
    names = [name_and_unit(name)[0] for name in part.names]
    pairs = [f"{name} is {dof}" for name, dof in zip(names, channels, strict=True) if as_dof(name) != dof]
    shown = ", ".join(pairs[:_SHOWN]) + (f", and {len(pairs) - _SHOWN} more" if len(pairs) > _SHOWN else "")
    what = "channel" if part.lines is None else "column"
    words = (
        f"{len(channels)} {what}s, {len(part.values)} samples at {part.rate:.9g} Hz,"
        f" unit{'s' if len(kinds) > 1 else ''} {', '.join(kinds)}"
    )
    return ", ".join(filter(None, (words, part.words))) + (f"; {shown}" if shown else "")

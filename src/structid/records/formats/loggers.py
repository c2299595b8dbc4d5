"""Files of loggers and recorders: TDMS, MDF, miniSEED, LVM, WAV and Parquet, read through libraries of their own.

They hold time histories under names of the program that wrote them; `ReadOptions.columns` chooses by these, and `channels` and
`units` say what they are where names and units do not. The libraries are extras of the installation.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError, InputError
from structid.files.contained import ReaderError, read_in_child
from structid.files.loggers import PACKAGES, Channel
from structid.files.lvm import OtherContentError
from structid.records.formats import LoggerFormat
from structid.records.formats.clocks import SURE, resample, resampling_remedy
from structid.records.formats.headers import is_time
from structid.records.formats.named_channels import (
    NamedChannels,
    choose_columns,
    record_of,
    scale_of_times,
)
from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord

#: A library of these may take its time to start.
_SECONDS = 60.0
_EVEN, _SAME_CLOCK, _SAME_RATE = 1e-3, 0.01, 1e-6


def read(path: Path, options: ReadOptions, logger: LoggerFormat) -> FrfRecord | TimeRecord:
    """The time record in the file at `path`; all of its channels share a clock. Errors are those of `LoggerFormat.read`."""
    return record_of(_join_channels(path, _read_channels(path, logger), options, logger.words), options)


def _read_channels(path: Path, logger: LoggerFormat) -> list[Channel]:
    """Channels of the file at `path`, read in a child process; `FileError` if the library is missing or fails.

    `logger` says which library reads it.
    """
    if find_spec(PACKAGES[logger.kind].partition(".")[0]) is None:
        raise FileError(
            f"{path}: {logger.words} files need the package {PACKAGES[logger.kind]}; pip install structid[{logger.extra}], or"
            " export the record as CSV or HDF5"
        )
    try:
        entries = read_in_child(path, "logger", seconds=_SECONDS, kind=logger.kind)
    except ReaderError as error:
        if error.kind == OtherContentError.__name__:
            raise FileError(f"{path}: {error}") from error
        raise FileError(
            f"{path}: cannot be read as {logger.words} ({error}); it is damaged or of another kind, copy or export it again"
        ) from error
    channels = [Channel(*entry) for entry in entries]
    if not channels:
        raise FileError(f"{path}: holds no time histories of numbers; export the channels again")
    return channels


def _join_channels(path: Path, channels: Sequence[Channel], options: ReadOptions, words: str) -> NamedChannels:
    """The channels chosen by `options.columns` on a common clock, cut to the time span that they share.

    Without `columns`, all but the channel of times are taken; uneven times are resampled where `options.resample` asks
    for it. `words` begin the note on what was read. Raises `FileError` if no channel but times is there, `InputError`
    if rates differ or channels share no time.
    """
    names = [channel.name for channel in channels]
    numbers = list(range(1, len(channels) + 1))
    time = _time_channel(path, channels, options)
    wanted = (
        choose_columns(path, options.columns, names, numbers)
        if options.columns
        else [j for j in range(len(names)) if j != time]
    )
    if not wanted:
        raise FileError(f"{path}: holds no channel besides its times; export the channels too")
    uneven = _uneven_times(path, channels, time, wanted, options)
    if uneven is not None:
        return _resample_channels(path, channels, wanted, uneven, options.sampling_rate, words)
    clock = None if time is None else _clock_of(path, channels[time], options)
    clocks = {j: clock or _own_clock(path, channels[j], options) for j in wanted}
    rate = _common_rate(path, [channels[j] for j in wanted], [clocks[j][0] for j in wanted])
    parts, start, note = _cut_to_common_span(path, [channels[j] for j in wanted], [clocks[j][1] for j in wanted], rate)
    return NamedChannels(
        path=path,
        names=tuple(names[j] for j in wanted),
        units=tuple(channels[j].unit for j in wanted),
        values=np.stack(parts, axis=1),
        rate=rate,
        start=start,
        numbers=tuple(numbers[j] for j in wanted),
        words=words + note + "".join(f", {text}" for text in dict.fromkeys(channels[j].note for j in wanted) if text),
    )


def _uneven_times(
    path: Path, channels: Sequence[Channel], time: int | None, wanted: Sequence[int], options: ReadOptions
) -> FloatArray | None:
    """Sample times in s, (n_times,), of channels to be resampled; None if times are even or `options.resample` is not set.

    `time` is the index of the channel of times, None if each channel has its clock; `wanted` are the indices of the chosen
    channels. Raises `InputError` if these are sampled at different times.
    """
    if not options.resample:
        return None
    if time is not None:
        channel = channels[time]
        times = channel.values * _scale_of_times(path, channel, options)
        step = (times[-1] - times[0]) / max(len(times) - 1, 1)
        is_even = np.isfinite(times).all() and step > 0 and np.abs(np.diff(times) - step).max() <= _EVEN * step
        return None if is_even else times
    off = [j for j in wanted if channels[j].off > _EVEN]
    if not off:
        return None
    times = channels[off[0]].times
    for j in wanted:
        if channels[j].times.shape != times.shape or not np.array_equal(channels[j].times, times):
            raise InputError(
                f"{path}: channels {channels[off[0]].name!r} and {channels[j].name!r} are sampled at different times; choose"
                " channels of one clock with `columns`"
            )
    return times


def _resample_channels(
    path: Path, channels: Sequence[Channel], wanted: Sequence[int], times: FloatArray, stated: float | None, words: str
) -> NamedChannels:
    """The channels with indices `wanted`, resampled from `times` (n_times,) in s to even times; see `resample`.

    `stated` is the sampling rate of the options, Hz, and `words` begin the note on what was read.
    """
    made = resample(path, times, np.stack([channels[j].values for j in wanted], axis=1), stated)
    return NamedChannels(
        path=path,
        names=tuple(channels[j].name for j in wanted),
        units=tuple(channels[j].unit for j in wanted),
        values=made.values,
        rate=made.rate,
        start=made.start,
        numbers=tuple(j + 1 for j in wanted),
        words=f"{words}, {made.words}",
    )


def _time_channel(path: Path, channels: Sequence[Channel], options: ReadOptions) -> int | None:
    """Index in `channels` of the one with the times: `options.time_column` if set, else the first named as a time.

    None if there is none, or if `time_column` is not set and any channel states its sampling rate.
    """
    names = [channel.name for channel in channels]
    if options.time_column:
        return choose_columns(path, [options.time_column], names, list(range(1, len(names) + 1)))[0]
    if any(channel.rate for channel in channels):
        return None
    return next((j for j, name in enumerate(names) if is_time(name)), None)


def _scale_of_times(path: Path, channel: Channel, options: ReadOptions) -> float:
    """Factor from the values of a channel of times to s."""
    return scale_of_times(f"{path}: channel {channel.name!r}", channel.name, channel.unit, channel.values, options)


def _clock_of(path: Path, channel: Channel, options: ReadOptions) -> tuple[float, float]:
    """Sampling rate in Hz and first time in s from a channel of times.

    `FileError` unless these times are even and increase; `InputError` if `options.sampling_rate` differs from their
    rate; where it agrees, it is returned, since it has more digits.
    """
    time = channel.values * _scale_of_times(path, channel, options)
    step = (time[-1] - time[0]) / max(len(time) - 1, 1)
    if not np.isfinite(time).all() or not step > 0 or np.abs(np.diff(time) - step).max() > _EVEN * step:
        raise FileError(f"{path}: channel {channel.name!r} must hold even, increasing times; {resampling_remedy()}")
    rate, stated = float(1 / step), options.sampling_rate
    if stated is not None and abs(stated / rate - 1) > max(_SAME_RATE, 2 * _EVEN / (len(time) - 1)):
        raise InputError(
            f"{path}: channel {channel.name!r} holds {rate:.9g} times a second, but `sampling_rate` {stated:g} was given; leave it"
            " out, or correct it",
            "sampling_rate",
        )
    return stated or rate, float(time[0])


def _own_clock(path: Path, channel: Channel, options: ReadOptions) -> tuple[float, float]:
    """Sampling rate in Hz and first time in s of a channel, from the file or the option `sampling_rate`.

    Raises `FileError` if the channel is sampled unevenly, `InputError` if neither states the rate, the file states it too
    roughly, or both differ.
    """
    stated = options.sampling_rate
    if not channel.rate:
        if stated is None:
            raise InputError(
                f"{path}: channel {channel.name!r} does not say its sampling rate; give `sampling_rate` (Hz), or `time_column`,"
                " the channel that holds the times"
            )
        return stated, channel.start
    if channel.off > _EVEN:
        raise FileError(
            f"{path}: channel {channel.name!r} is not sampled evenly: a sample is {channel.off:.2g} steps off;"
            f" {resampling_remedy()}"
        )
    if stated is None and channel.rate_error > SURE:
        raise InputError(
            f"{path}: channel {channel.name!r} tells its sampling rate {channel.rate:.6g} Hz to {100 * channel.rate_error:.2g} %"
            " only, by the digits of its step; give `sampling_rate` (Hz)",
            "sampling_rate",
        )
    if stated is not None and abs(stated / channel.rate - 1) > max(_SAME_RATE, channel.rate_error):
        raise InputError(
            f"{path}: channel {channel.name!r} is sampled at {channel.rate:.9g} Hz, but `sampling_rate` {stated:g} was given; leave"
            " it out"
        )
    return channel.rate if stated is None else stated, channel.start


def _common_rate(path: Path, channels: Sequence[Channel], rates: Sequence[float]) -> float:
    """The sampling rate in Hz that all channels share; `InputError` if they differ. `rates` are those of `channels`."""
    for channel, rate in zip(channels, rates, strict=True):
        if abs(rate / rates[0] - 1) > _SAME_RATE:
            raise InputError(
                f"{path}: channel {channel.name!r} is sampled at {rate:g} Hz and {channels[0].name!r} at {rates[0]:g} Hz; choose"
                " channels of one rate with `columns`"
            )
    return rates[0]


def _cut_to_common_span(
    path: Path, channels: Sequence[Channel], starts: Sequence[float], rate: float
) -> tuple[list[FloatArray], float, str]:
    """Samples (n_times,) of each channel in the time span that all share, the first time in s, and a note on the cut.

    `starts` are the first times of the channels in s, `rate` is in Hz; the note is "" if nothing was cut. Raises `InputError`
    if the channels share no time, or their samples do not fall together.
    """
    offsets = (np.asarray(starts) - max(starts)) * rate
    skip = np.round(-offsets).astype(int)
    if np.abs(offsets + skip).max() > _SAME_CLOCK:
        worst = int(np.argmax(np.abs(offsets + skip)))
        raise InputError(
            f"{path}: channel {channels[worst].name!r} is sampled {abs(offsets + skip)[worst]:.2g} of a step beside the others;"
            " resample them to one clock before the export, or choose with `columns`"
        )
    length = min(len(channel.values) - n_skipped for channel, n_skipped in zip(channels, skip.tolist(), strict=True))
    if length < 1:
        raise InputError(f"{path}: the channels have no time in common; choose those that do with `columns`")
    parts = [
        channel.values[n_skipped : n_skipped + length]
        for channel, n_skipped in zip(channels, skip.tolist(), strict=True)
    ]
    is_cut = any(len(channel.values) != length for channel in channels)
    return parts, float(max(starts)), ", cut to the span that all channels have" if is_cut else ""

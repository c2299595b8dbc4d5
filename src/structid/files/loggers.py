"""Files of loggers as their own libraries read them, for the child of `structid.files.contained`.

Each reader gives one entry a channel: name, unit or "", values, and its clock: start in s, samples per second, and the
largest distance of a sample from that clock in parts of a step; a rate of 0 where the file does not say. A note tells what is
doubtful about the file. Times are there where they are uneven. A rate that was printed with few digits has a relative error.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray
from structid.core.units import parse_time_unit
from structid.files.lvm import read_lvm, start_unsaid_words


class Channel(NamedTuple):
    """A channel with its clock."""

    name: str
    unit: str
    values: FloatArray
    rate: float
    start: float
    off: float
    note: str = ""
    times: FloatArray = np.zeros(0)
    rate_error: float = 0.0


def logger(path: str, kind: str) -> list[Channel]:
    """Every numeric channel of the logger's file at `path`, with its clock; `kind` is a key of `PACKAGES`.

    A warning of the library while it reads (`UserWarning`, `RuntimeWarning`) is raised as an error, since it tells of
    damage; in miniSEED files, which have checks of their own, all warnings become the note of the first channel.
    """
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # the others reserve more address space than the child may take
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        __import__(PACKAGES[kind])  # of which some warn of their own
        if kind in _ONLY_WARNED:
            return _with_warnings(lambda: list(_READERS[kind](path)))
        warnings.simplefilter("error", UserWarning)
        warnings.simplefilter("error", RuntimeWarning)
        return list(_READERS[kind](path))


def _with_warnings(read: Callable[[], list[Channel]]) -> list[Channel]:
    """The channels that `read` returns, with the library's warnings, each once, as the note of the first."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        channels = read()
    note_text = "; ".join(dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught))
    return [channel._replace(note=note_text) if note_text and i == 0 else channel for i, channel in enumerate(channels)]


def _make_channel(
    name: str,
    unit: str | None,
    values: ArrayLike,
    rate: float = 0.0,
    start: float = 0.0,
    off: float = 0.0,
    note: str = "",
    times: FloatArray | None = None,
) -> Channel:
    """A `Channel` with values as float64, (n_samples,), where masked samples are NaN; see `Channel` for the arguments."""
    samples = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
    return Channel(str(name), str(unit or ""), samples, rate, start, off, note, np.zeros(0) if times is None else times)


#: Distance of a sample from an even clock, in parts of a step, above which the times are kept.
_EVEN = 1e-3


def _is_series(values: np.ndarray) -> bool:
    return values.ndim == 1 and values.dtype.kind in "fiub" and values.size > 0


def _clock_of_times(time: np.ndarray) -> tuple[float, float, float]:
    """Sampling rate in Hz, first time in s, and largest deviation from even steps (in steps) of the times (n,), s.

    0, 0, 0 if there are fewer than two, one is not finite, or the last is not after the first.
    """
    if time.size < 2 or not np.isfinite(time).all() or time[-1] <= time[0]:
        return 0.0, 0.0, 0.0
    step = float(time[-1] - time[0]) / (time.size - 1)
    off = np.abs(time - time[0] - step * np.arange(time.size)).max() / step
    return 1 / step, float(time[0]), float(off)


def _read_tdms(path: str) -> Iterator[Channel]:
    """Numeric channels of a TDMS file of LabVIEW, named group/channel if several groups have channels.

    Starts are in s after the channel that starts first. The rate is 0 Hz for a channel without a step. Notes tell of a
    file that was cut short, and of a channel with a step but no start beside others that have one.
    """
    from nptdms import TdmsFile

    with TdmsFile.open(path) as file:
        groups = file.groups()
        cut = file.file_status.incomplete_final_segment
        several = sum(bool(group.channels()) for group in groups) > 1
        starts = [_tdms_start(channel) for group in groups for channel in group.channels()]
        first = min((start for start in starts if start is not None), default=np.datetime64(0, "us"))
        for group in groups:
            for channel in group.channels():
                properties = channel.properties
                values = np.asarray(channel[:])
                if not _is_series(values):
                    continue
                to_seconds = parse_time_unit(properties.get("wf_xunit_string") or "s")
                step = to_seconds * float(properties.get("wf_increment") or 0.0)
                start = _tdms_start(channel)
                later = 0.0 if start is None else float((start - first) / np.timedelta64(1, "us")) * 1e-6
                notes = ["the file ends within its last segment: the copy, or the logger, broke off"] if cut else []
                if step > 0 and start is None and any(other is not None for other in starts):
                    notes.append(start_unsaid_words(channel.name))
                yield _make_channel(
                    f"{group.name}/{channel.name}" if several else channel.name,
                    properties.get("unit_string") or properties.get("NI_UnitDescription"),
                    values,
                    1 / step if step > 0 else 0.0,
                    later + to_seconds * float(properties.get("wf_start_offset") or 0.0),
                    note=", ".join(notes),
                )


def _tdms_start(channel: Any) -> np.datetime64 | None:
    """The time of day at which a channel with a clock starts; None if it has no clock or does not say."""
    start = channel.properties.get("wf_start_time")
    has_clock = float(channel.properties.get("wf_increment") or 0.0) > 0
    return start.astype("datetime64[us]") if has_clock and isinstance(start, np.datetime64) else None


def _read_mdf(path: str) -> Iterator[Channel]:
    """Numeric channels of an MDF (ASAM) file, each with the clock of its group's time channel.

    The times themselves are added where they deviate from even steps by more than 0.1 % of a step.
    """
    from asammdf import MDF

    with MDF(path) as file:
        for group_index, group in enumerate(file.groups):
            for index in range(len(group.channels)):
                if index == file.masters_db.get(group_index):
                    continue
                signal = file.get(group=group_index, index=index)
                values = np.asarray(signal.samples)
                if _is_series(values):
                    time = np.asarray(signal.timestamps, float)
                    rate, start, off = _clock_of_times(time)
                    yield _make_channel(
                        signal.name, signal.unit, values, rate, start, off, times=time if off > _EVEN else None
                    )


def _read_miniseed(path: str) -> Iterator[Channel]:
    """Channels of a miniSEED file, in its order; starts are in s after the earliest trace.

    Traces of one channel are merged. `ValueError` if the file has no samples.
    """
    from obspy import read

    stream = read(path, format="MSEED")
    if sum(trace.stats.npts * trace.data.itemsize for trace in stream) == 0:
        raise ValueError("it holds no samples")
    order = list(dict.fromkeys(trace.id for trace in stream))
    stream.merge(method=0)
    first = min(trace.stats.starttime for trace in stream)
    for trace in sorted(stream, key=lambda trace: order.index(trace.id)):
        yield _make_channel(
            trace.id, "", trace.data, float(trace.stats.sampling_rate), float(trace.stats.starttime - first)
        )


def _read_wav(path: str) -> Iterator[Channel]:
    """Channels of a WAV file, numbered from 1.

    Integer samples become parts of full scale, -1 to 1, which a note says.
    """
    from scipy.io import wavfile

    warnings.filterwarnings("ignore", "Chunk .non-data. not understood")  # notes of recorders
    rate, values = wavfile.read(path)
    note = "in parts of full scale" if values.dtype.kind in "ui" else ""
    if values.dtype.kind == "u":
        values = (values - 128.0) / 128
    elif values.dtype.kind == "i":
        values = values / 2.0 ** (8 * values.dtype.itemsize - 1)
    values = values.reshape(len(values), -1)
    for j in range(values.shape[1]):
        yield _make_channel(str(j + 1), "", values[:, j], float(rate), note=note)


def _read_parquet(path: str) -> Iterator[Channel]:
    """Numeric columns of a Parquet file as channels without clock.

    A column of timestamps becomes seconds from its first. Columns of other types are left out.
    """
    import pyarrow as pa
    from pyarrow import parquet

    table = parquet.read_table(path, use_threads=False)
    table.validate(full=True)
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_timestamp(column.type):
            ticks = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
            yield _make_channel(name, "s", (ticks - ticks[0]) / 1e9)
        elif any(is_kind(column.type) for is_kind in (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal)):
            yield _make_channel(name, "", column.cast(pa.float64()).to_numpy())


def _read_lvm(path: str) -> Iterator[Channel]:
    """Channels of a LabVIEW measurement file (LVM)."""
    for channel in read_lvm(Path(path)):
        clock = channel.clock
        yield _make_channel(
            channel.name, channel.unit, channel.values, clock.rate, channel.start, clock.off, channel.note,
            times=clock.times if clock.off > _EVEN else None,
        )._replace(rate_error=clock.error)  # fmt: skip


#: Kinds whose library's warnings are told and not taken for damage.
_ONLY_WARNED = ("miniseed",)
#: The package that reads each kind of file.
PACKAGES = {
    "lvm": "csv",
    "tdms": "nptdms",
    "mdf": "asammdf",
    "miniseed": "obspy",
    "wav": "scipy.io.wavfile",
    "parquet": "pyarrow",
}
_READERS: dict[str, Callable[[str], Iterator[Channel]]] = {
    "tdms": _read_tdms, "mdf": _read_mdf, "miniseed": _read_miniseed, "lvm": _read_lvm, "wav": _read_wav, "parquet": _read_parquet,
}  # fmt: skip

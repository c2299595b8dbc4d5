"""Files of loggers as their own libraries read them, for the child of `structid.files.contained`.

Each reader gives one entry a channel: name, unit or "", values, and its clock: start in s, samples per second, and the
largest distance of a sample from that clock in parts of a step; a rate of 0 where the file does not say. A note tells what is
doubtful about the file.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray


class Channel(NamedTuple):
    """A channel with its clock."""

    name: str
    unit: str
    values: FloatArray
    rate: float
    start: float
    off: float
    note: str = ""


def logger(path: str, kind: str) -> list[Channel]:
    """The channels of numbers in a file of this kind; what a library only warns of counts as damage."""
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # the others reserve more address space than the child may take
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        __import__(PACKAGES[kind])  # of which some warn of their own
        warnings.simplefilter("error", UserWarning)
        warnings.simplefilter("error", RuntimeWarning)
        return list(_READERS[kind](path))


def _entry(
    name: str,
    unit: str | None,
    values: ArrayLike,
    rate: float = 0.0,
    start: float = 0.0,
    off: float = 0.0,
    note: str = "",
) -> Channel:
    kept = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
    return Channel(str(name), str(unit or ""), kept, rate, start, off, note)


def _is_series(values: np.ndarray) -> bool:
    return values.ndim == 1 and values.dtype.kind in "fiub" and values.size > 0


def _clock(time: np.ndarray) -> tuple[float, float, float]:
    """Rate, start and unevenness of sample times."""
    if time.size < 2 or not np.isfinite(time).all() or time[-1] <= time[0]:
        return 0.0, 0.0, 0.0
    step = float(time[-1] - time[0]) / (time.size - 1)
    off = np.abs(time - time[0] - step * np.arange(time.size)).max() / step
    return 1 / step, float(time[0]), float(off)


def _tdms(path: str) -> Iterator[Channel]:
    from nptdms import TdmsFile

    with TdmsFile.open(path) as file:
        groups = file.groups()
        cut = file.file_status.incomplete_final_segment
        several = sum(bool(group.channels()) for group in groups) > 1
        for group in groups:
            for channel in group.channels():
                own = channel.properties
                values = np.asarray(channel[:])
                if not _is_series(values):
                    continue
                step = float(own.get("wf_increment") or 0.0)
                yield _entry(
                    f"{group.name}/{channel.name}" if several else channel.name,
                    own.get("unit_string") or own.get("NI_UnitDescription"),
                    values,
                    1 / step if step > 0 else 0.0,
                    float(own.get("wf_start_offset") or 0.0),
                    note="the file ends within its last segment: the copy, or the logger, broke off" if cut else "",
                )


def _mdf(path: str) -> Iterator[Channel]:
    from asammdf import MDF

    with MDF(path) as file:
        for at, group in enumerate(file.groups):
            for index in range(len(group.channels)):
                if index == file.masters_db.get(at):
                    continue
                signal = file.get(group=at, index=index)
                values = np.asarray(signal.samples)
                if _is_series(values):
                    yield _entry(signal.name, signal.unit, values, *_clock(np.asarray(signal.timestamps, float)))


def _miniseed(path: str) -> Iterator[Channel]:
    from obspy import read

    stream = read(path, format="MSEED")
    if sum(trace.stats.npts * trace.data.itemsize for trace in stream) == 0:
        raise ValueError("it holds no samples")
    order = list(dict.fromkeys(trace.id for trace in stream))
    stream.merge(method=0)
    first = min(trace.stats.starttime for trace in stream)
    for trace in sorted(stream, key=lambda trace: order.index(trace.id)):
        yield _entry(trace.id, "", trace.data, float(trace.stats.sampling_rate), float(trace.stats.starttime - first))


def _wav(path: str) -> Iterator[Channel]:
    from scipy.io import wavfile

    warnings.filterwarnings("ignore", "Chunk .non-data. not understood")  # notes of recorders
    rate, values = wavfile.read(path)
    if values.dtype.kind == "u":
        values = (values - 128.0) / 128
    elif values.dtype.kind == "i":
        values = values / 2.0 ** (8 * values.dtype.itemsize - 1)
    values = values.reshape(len(values), -1)
    for j in range(values.shape[1]):
        yield _entry(str(j + 1), "", values[:, j], float(rate))


def _parquet(path: str) -> Iterator[Channel]:
    import pyarrow as pa
    from pyarrow import parquet

    table = parquet.read_table(path, use_threads=False)
    table.validate(full=True)
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_timestamp(column.type):
            ticks = column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
            yield _entry(name, "s", (ticks - ticks[0]) / 1e9)
        elif pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            yield _entry(name, "", column.cast(pa.float64()).to_numpy())


#: The package that reads each kind of file.
PACKAGES = {"tdms": "nptdms", "mdf": "asammdf", "miniseed": "obspy", "wav": "scipy.io.wavfile", "parquet": "pyarrow"}
_READERS: dict[str, Callable[[str], Iterator[Channel]]] = {
    "tdms": _tdms, "mdf": _mdf, "miniseed": _miniseed, "wav": _wav, "parquet": _parquet,
}  # fmt: skip

"""Files of loggers as their own libraries read them, for the child of `structid.files.contained`.

Each reader gives one entry a channel: name, unit or "", values, and its clock: start in s, samples per second, and the
largest distance of a sample from that clock in parts of a step; a rate of 0 where the file does not say. A note tells what is
doubtful about the file. Times are there where they are uneven.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray
from structid.core.units import parse_time_unit


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


def logger(path: str, kind: str) -> list[Channel]:
    """The channels of numbers in a file of this kind; what a library only warns of counts as damage, but of miniSEED.

    Those files are of records with checks of their own, and their library warns of harmless ones.
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
    """The channels that `read` gives, with what the library warns of beside the first."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        channels = read()
    told = "; ".join(dict.fromkeys(" ".join(str(one.message).split()) for one in caught))
    return [channel._replace(note=told) if told and i == 0 else channel for i, channel in enumerate(channels)]


def _entry(
    name: str,
    unit: str | None,
    values: ArrayLike,
    rate: float = 0.0,
    start: float = 0.0,
    off: float = 0.0,
    note: str = "",
    times: FloatArray | None = None,
) -> Channel:
    kept = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
    return Channel(str(name), str(unit or ""), kept, rate, start, off, note, np.zeros(0) if times is None else times)


#: Distance of a sample from an even clock, in parts of a step, above which the times are kept.
_EVEN = 1e-3


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
                to_seconds = parse_time_unit(own.get("wf_xunit_string") or "s")
                step = to_seconds * float(own.get("wf_increment") or 0.0)
                yield _entry(
                    f"{group.name}/{channel.name}" if several else channel.name,
                    own.get("unit_string") or own.get("NI_UnitDescription"),
                    values,
                    1 / step if step > 0 else 0.0,
                    to_seconds * float(own.get("wf_start_offset") or 0.0),
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
                    time = np.asarray(signal.timestamps, float)
                    rate, start, off = _clock(time)
                    yield _entry(
                        signal.name, signal.unit, values, rate, start, off, times=time if off > _EVEN else None
                    )


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
    note = "in parts of full scale" if values.dtype.kind in "ui" else ""
    if values.dtype.kind == "u":
        values = (values - 128.0) / 128
    elif values.dtype.kind == "i":
        values = values / 2.0 ** (8 * values.dtype.itemsize - 1)
    values = values.reshape(len(values), -1)
    for j in range(values.shape[1]):
        yield _entry(str(j + 1), "", values[:, j], float(rate), note=note)


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


def _lvm(path: str) -> Iterator[Channel]:
    """LabVIEW measurement files: a head, and one segment with a head of its own and columns of numbers."""
    text = Path(path).read_text(encoding="cp1252")
    lines = text.splitlines()
    if not text.endswith("\n"):
        raise ValueError("its last line has no end")
    if not lines[0].startswith("LabVIEW Measurement"):
        raise ValueError("it does not begin with LabVIEW Measurement")
    ends = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if len(ends) != 2:
        raise ValueError(f"it must hold one segment, got {max(len(ends) - 1, 0)}; write one a file")
    separator = "," if any(line.startswith("Separator,Comma") for line in lines[: ends[0]]) else "\t"
    file, segment = ({words[0].strip(): words[1:] for line in part if (words := line.split(separator))} for part in
                     (lines[: ends[0]], lines[ends[0] + 1 : ends[1]]))  # fmt: skip
    comma = file.get("Decimal_Separator", ["."])[0].strip() == ","
    if file.get("X_Columns", ["One"])[0].strip() == "Multi":
        raise ValueError("every channel has times of its own; write them with one column of times, or none")
    count = int(segment["Channels"][0])
    dimensions = {text.strip() for text in segment.get("X_Dimension", [])[:count]} - {""}
    if dimensions - {"Time"}:
        other = ", ".join(sorted(dimensions - {"Time"}))
        raise ValueError(f"its channels are over {other}, not over time; write time histories")
    rows = [line.split(separator)[: count + 1] for line in lines[ends[1] + 2 :] if line.strip()]
    names = [name.strip() for name in lines[ends[1] + 1].split(separator)][1 : count + 1]
    values = np.array([[_decimal(text, comma) for text in row[1:]] for row in rows])
    samples = [int(text) for text in segment["Samples"][:count]]
    if len(names) != count or samples != [len(rows)] * count or values.shape != (len(rows), count):
        raise ValueError(
            f"its head says {count} channels of {samples} samples, and it holds {len(rows)} lines of {values.shape[-1]}"
        )
    units = [*segment.get("Y_Unit_Label", []), *[""] * count]
    steps, starts = ([_decimal(text, comma) for text in segment[key][:count]] for key in ("Delta_X", "X0"))
    for j in range(count):
        rate = 1 / steps[j] if steps[j] > 0 else 0.0
        yield _entry(names[j], units[j].strip(), values[:, j], rate, starts[j])


def _decimal(text: str, comma: bool) -> float:
    return float(text.replace(",", ".") if comma else text)


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
    "tdms": _tdms, "mdf": _mdf, "miniseed": _miniseed, "lvm": _lvm, "wav": _wav, "parquet": _parquet,
}  # fmt: skip

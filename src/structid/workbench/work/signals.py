"""Views of records: facts, long time histories as minimum and maximum of chunks, and responses over lines."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.arrays import FloatArray, IntArray, bin_extremes
from structid.core.dof import Dof
from structid.core.errors import FileError, InputError, StructidError
from structid.core.json_types import StoredEntry
from structid.files import atomic_write
from structid.modal.formats.files import read_modes
from structid.records import FrfRecord, TimeRecord
from structid.records.formats import CsvLayout, ReadOptions, how_read, read_record
from structid.records.on_disk import ChunkedRecord, MemoryRecord, open_record
from structid.records.quality import signal_checks
from structid.records.record import QUANTITY_UNITS
from structid.workbench.folder import holds_modes
from structid.workbench.work.scene import packed

#: Samples of a bin of the overview that is kept.
BIN = 256
#: Samples at most that are read for a look into a record; beyond, its overview serves.
_READ = 400_000
#: Bytes from which on a file is opened and not read.
_LARGE = 100_000_000
_SAMPLED, _SAMPLE = 1000, 32
#: Values of responses at most that are sent at once.
_MOST_VALUES = 1_500_000
_CHECKED_BYTES = 200_000_000


def facts(path: Path, options: ReadOptions) -> dict[str, Any]:
    """Kind, channels, units and quality findings of the data file at `path`, as read with `options`.

    ``kind`` is "modes", "time histories", or a kind of FRF; the other keys depend on it. Modes are not read with
    `options`. Signals are checked only if they are in memory and smaller than 200 MB; else ``findings`` is empty.

    Raises
    ------
    InputError
        If it cannot be read as it is; the message says what is missing.
    """
    if holds_modes(path):
        modes = read_modes(path)
        pairs = [[float(f), float(d)] for f, d in zip(modes.frequency, modes.damping_ratio, strict=True)]
        return {"kind": "modes", "channels": _channels(modes.channels), "modes": pairs, "findings": []}
    record = _open_record(path, options)
    if isinstance(record, FrfRecord):
        return {
            "kind": record.kind,
            "unit": record.unit,
            "lines": len(record.frequency),
            "band": [float(record.frequency[0]), float(record.frequency[-1])],
            "channels": _channels(record.outputs) + _channels(record.inputs, "load"),
            "coherence": record.coherence is not None,
            "averages": record.averages,
            "read": how_read(record.source, path),
            "findings": [],
        }
    findings: list[dict[str, str]] = []
    if isinstance(record, MemoryRecord) and record.record.values.nbytes < _CHECKED_BYTES:
        findings = [{"words": one.words, "severity": one.severity} for one in signal_checks(record.record)]
    rows = [
        {
            "name": str(dof),
            "role": "load" if quantity == "force" else "sensor",
            "quantity": quantity,
            "unit": unit,
        }
        for dof, quantity, unit in zip(record.channels, record.quantities, _units(record), strict=True)
    ]
    return {
        "kind": "time histories",
        "rate": record.sampling_rate,
        "samples": record.n_times,
        "seconds": record.n_times / record.sampling_rate,
        "channels": rows,
        "read": how_read(record.record.source, path) if isinstance(record, MemoryRecord) else "",
        "findings": findings,
        "segment": _segment(record.n_times),
    }


def channels(path: Path, options: ReadOptions) -> list[tuple[str, str]]:
    """Name and role ("sensor" or "load") of every channel of the data file at `path`."""
    return [(one["name"], one["role"]) for one in facts(path, options)["channels"]]


def _channels(dofs: tuple[Dof, ...], role: str = "sensor") -> list[dict[str, StoredEntry]]:
    return [{"name": str(dof), "role": role} for dof in dofs]


def _units(record: ChunkedRecord) -> list[str]:
    """SI unit of each channel of `record`, in order."""
    return [QUANTITY_UNITS[kind][dof.is_rotation] for dof, kind in zip(record.channels, record.quantities, strict=True)]


def _segment(n_times: int) -> int:
    """Segment length for spectra, in samples: a power of two from 256 to 16384, about n_times / 8 or less."""
    return int(2 ** np.clip(np.floor(np.log2(max(n_times, 256) / 8)), 8, 14))


def _open_record(path: Path, options: ReadOptions) -> ChunkedRecord | FrfRecord:
    """Record in the file at `path`; time records in NPY or HDF5 files above 100 MB are opened, not read into memory.

    A large file that holds no time histories is read. Raises `FileError` if the file is missing. `options` say how the
    file is read.
    """
    try:
        size = path.stat().st_size
    except FileNotFoundError:
        raise FileError(f"{path.name}: is not there any more; it was moved or removed while it was open") from None
    if size > _LARGE and path.suffix.lower() in (".npy", ".h5", ".hdf5"):
        try:
            return open_record(path, options)
        except InputError as error:
            if "time histories" not in str(error):
                raise
    record = read_record(path, options)
    return MemoryRecord(record) if isinstance(record, TimeRecord) else record


def histories(
    path: Path, options: ReadOptions, first: float, last: float | None, points: int, overviews: Path
) -> dict[str, StoredEntry]:
    """Minimum and maximum of every channel in at most `points` bins of equal length between the times `first` and `last` (s).

    ``time`` (s) holds the packed starts of the bins, ``low`` and ``high`` a packed row for each channel, ``names`` and ``units``
    those of the channels, ``seconds`` the length of the record. Long ranges of a file too large for memory are taken from its
    overview; as long as there is none, short pieces spread over the range stand in for the bins, as many whatever `points` is,
    and ``sampled`` is True.

    Parameters
    ----------
    last : float or None
        None is the end of the record.
    points : int
        Limited to 50 to 4000.
    overviews : Path
        Folder in which `write_overview` stores the minimum and maximum of long records.

    Raises
    ------
    InputError
        If the file holds FRFs.
    """
    record = _open_record(path, options)
    if isinstance(record, FrfRecord):
        raise InputError(f"{path.name}: holds responses over frequency and no time histories")
    rate, n = record.sampling_rate, record.n_times
    begin = int(np.clip(np.floor(first * rate), 0, n - 1))
    end = n if last is None else int(np.clip(np.ceil(last * rate) + 1, begin + 1, n))
    points, sampled = int(np.clip(points, 50, 4000)), False
    overview = overview_path(path, options, overviews)
    if end - begin <= _READ or isinstance(record, MemoryRecord):
        low, high, at = _read_bins(record, begin, end, points)
    elif overview.exists():
        low, high, at = _overview_bins(np.load(overview, mmap_mode="r"), begin, end, points)
    else:
        low, high, at, sampled = *_sampled_bins(record, begin, end), True
    names = [f"{dof} {quantity}" for dof, quantity in zip(record.channels, record.quantities, strict=True)]
    return {
        "names": names,
        "units": _units(record),
        "seconds": n / rate,
        "time": packed(at / rate, np.float64),
        "low": [packed(row, np.float32) for row in low],
        "high": [packed(row, np.float32) for row in high],
        "sampled": sampled,
    }


def _read_bins(record: ChunkedRecord, begin: int, end: int, n_most: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Minimum and maximum (n_channels, n_bins) of samples `begin` to `end`, and the first sample of each bin.

    `end` is exclusive; there are at most `n_most` bins of equal length, of which the last may be shorter.
    """
    parts = [np.asarray(part) for part in record.chunks(begin, end)]
    values = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
    low, high, starts = bin_extremes(values, n_most)
    return low, high, begin + starts


def _overview_bins(overview: FloatArray, begin: int, end: int, n_most: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Minimum and maximum (n_channels, n_bins) from a stored overview, and the first sample of each bin.

    `overview` (2, n_channels, n) holds minimum and maximum of every 256 samples. Samples `begin` to `end` (exclusive)
    are covered by at most `n_most` bins, each a whole number of these, so that the first may start before `begin`.
    """
    first, last = begin // BIN, -(-end // BIN)
    part = overview[:, :, first:last]
    step = max(1, -(-part.shape[2] // n_most))
    starts = np.arange(0, part.shape[2], step)
    low, high = np.minimum.reduceat(part[0], starts, axis=1), np.maximum.reduceat(part[1], starts, axis=1)
    return low, high, (first + starts) * BIN


def _sampled_bins(record: ChunkedRecord, begin: int, end: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Minimum and maximum (n_channels, 1000) of short pieces of a record, and the first sample of each piece.

    The pieces of 32 samples are evenly spread from sample `begin` to `end` (exclusive), so that a long record need not
    be read whole.
    """
    starts = np.linspace(begin, end - _SAMPLE, _SAMPLED).astype(int)
    parts = [next(record.chunks(at, at + _SAMPLE)) for at in starts.tolist()]
    low, high = (np.column_stack([turn(part, axis=1) for part in parts]) for turn in (np.min, np.max))
    return low, high, starts


def overview_path(path: Path, options: ReadOptions, overviews: Path) -> Path:
    """Path of a record's overview file in the folder `overviews`.

    Its name is a hash of the record's path, size and modification time and of `options`, so that a changed file gets a new one.
    """
    stamp = path.stat()
    identity = f"{path}|{stamp.st_size}|{stamp.st_mtime_ns}|{options}"
    return overviews / f"{hashlib.sha256(identity.encode()).hexdigest()[:32]}.npy"


def write_overview(path: Path, options: ReadOptions, overviews: Path) -> None:
    """Write minimum and maximum of every 256 samples of a time record to an NPY file in the folder `overviews`.

    The array is (2, n_channels, n_bins), float32, at `overview_path`; the last bin may be shorter. `options` say how
    the record is read. Nothing is written for FRFs or if the file exists.
    """
    record, target = _open_record(path, options), overview_path(path, options, overviews)
    if isinstance(record, FrfRecord) or target.exists():
        return
    n = -(-record.n_times // BIN)
    found, at = np.empty((2, len(record.channels), n), dtype=np.float32), 0
    for chunk in record.chunks(longest=BIN * 4096):
        whole = chunk.shape[1] // BIN
        if whole * BIN == chunk.shape[1]:  # quicker than `reduceat`
            cut = chunk.reshape(len(chunk), whole, BIN)
            low, high = cut.min(axis=2), cut.max(axis=2)
        else:
            starts = np.arange(0, chunk.shape[1], BIN)
            low, high = np.minimum.reduceat(chunk, starts, axis=1), np.maximum.reduceat(chunk, starts, axis=1)
        found[0, :, at : at + low.shape[1]], found[1, :, at : at + low.shape[1]] = low, high
        at += low.shape[1]
    with atomic_write(target) as temporary, temporary.open("wb") as stream:
        np.save(stream, found)


def responses(record: FrfRecord, outputs: list[str]) -> dict[str, StoredEntry]:
    """FRFs at `outputs` (names; all if empty) and every input: magnitude, phase (degrees), coherence, relative error.

    ``pairs`` hold packed arrays over ``frequency`` (Hz), one for each output and then each input. The error is the
    random one, the standard deviation of the magnitude over the magnitude; coherence and error are None if unknown.
    Every ``thinned``-th line is kept, so that at most about 1.5 million values are sent.
    """
    wanted = [k for k, dof in enumerate(record.outputs) if not outputs or str(dof) in outputs]
    step = max(1, -(-len(record.frequency) * len(wanted) * len(record.inputs) // _MOST_VALUES))
    few = record.lines(np.arange(0, len(record.frequency), step))
    pairs = []
    for o in wanted:
        for i, load in enumerate(record.inputs):
            values = few.values[:, o, i]
            size = np.maximum(np.abs(values), 1e-300)
            pairs.append(
                {
                    "output": str(record.outputs[o]),
                    "input": str(load),
                    "magnitude": packed(np.abs(values), np.float32),
                    "phase": packed(np.degrees(np.angle(values)), np.float32),
                    "coherence": None if few.coherence is None else packed(few.coherence[:, o, i], np.float32),
                    "error": None
                    if few.variance is None
                    else packed(np.sqrt(few.variance[:, o, i] / 2) / size, np.float32),
                }
            )
    return {
        "kind": record.kind,
        "unit": record.unit,
        "outputs": [str(dof) for dof in record.outputs],
        "inputs": [str(dof) for dof in record.inputs],
        "frequency": packed(few.frequency, np.float64),
        "pairs": pairs,
        "noise": record.noise_source,
        "thinned": step,
    }


def options_of(posted: dict[str, Any]) -> ReadOptions:
    """Options for reading a record file, from a mapping of the page or a ``[record]`` section.

    `posted` maps names of options to values: unknown keys and empty values ("" or None) are ignored; ``csv`` may be a
    mapping, see `CsvLayout`.

    Raises
    ------
    InputError
        If a value cannot be used.
    """
    option_names = set(ReadOptions.__dataclass_fields__)
    chosen = {name: value for name, value in posted.items() if name in option_names and value not in ("", None)}
    try:
        if isinstance(chosen.get("csv"), dict):
            chosen["csv"] = CsvLayout(**chosen["csv"])
        return ReadOptions(**chosen)
    except StructidError:
        raise
    except TypeError as error:
        raise InputError(str(error)) from error

"""Time histories that stay on disk: opened without being read, and given out a stretch of samples at a time.

NPY files and HDF5 datasets, samples by channels or channels by samples, single or double precision. What is read is
checked: a gap is named by its sample, and so is the place where a file ends too early.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol, cast

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dof
from structid.core.errors import FileError, InputError
from structid.files import DAMAGE, require_readable
from structid.files.contained import hdf5_datasets, hdf5_fields, hdf5_part, texts_of
from structid.files.npy import npy_header
from structid.records.formats.bare import channel_units, require_option
from structid.records.formats.layout import MARK
from structid.records.formats.options import ReadOptions, option_words
from structid.records.record import QUANTITY_UNITS, Quantity, TimeRecord

_NPY, _HDF5 = (".npy",), (".h5", ".hdf5")
_CHUNK_BYTES, _AT_ONCE = 32_000_000, 1_000_000
_LINE = 8  # doubles of a cache line: fewer samples at a time would touch each line again and again
_SHORTEST, _PARTS = 24, 64  # samples of a chunk at least, and chunks of a record about
_UNUSED = (
    "frequency_array", "outputs", "inputs", "kind", "unit", "coherence_array", "averages", "start", "stop",
    "longest_gap", "axis_unit", "axes", "resample",
)  # fmt: skip
_REPAIR = "repair the record first (`structid convert` with a longest gap fills short gaps), or leave these samples out"


class ChunkedRecord(Protocol):
    """A time record of any length that gives its samples by stretches."""

    @property
    def channels(self) -> tuple[Dof, ...]: ...

    @property
    def quantities(self) -> tuple[Quantity, ...]: ...

    @property
    def sampling_rate(self) -> float: ...

    @property
    def n_times(self) -> int: ...

    def chunks(self, first: int = 0, last: int | None = None, longest: int | None = None) -> Iterator[FloatArray]:
        """Samples `first` to `last` in order, (n_channels, at most `longest`) each, in SI units.

        `last` is exclusive, None for the end; without `longest` the size of the record decides.
        """
        ...


@dataclass(frozen=True, eq=False)
class MemoryRecord:
    """A `TimeRecord` as a `ChunkedRecord`."""

    record: TimeRecord

    @property
    def channels(self) -> tuple[Dof, ...]:
        return self.record.channels

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        return self.record.quantities

    @property
    def sampling_rate(self) -> float:
        return self.record.sampling_rate

    @property
    def n_times(self) -> int:
        return len(self.record.values)

    def chunks(self, first: int = 0, last: int | None = None, longest: int | None = None) -> Iterator[FloatArray]:
        """Samples `first` to `last` in order, (n_channels, at most `longest`) each, in SI units.

        `last` is exclusive, None for the end; without `longest` the size of the record decides.
        """
        for begin, stop in _sample_chunks(self.n_times, len(self.channels), first, last, longest):
            yield np.ascontiguousarray(self.record.values[begin:stop].T)


@dataclass(frozen=True, eq=False)
class OnDiskRecord:
    """A time record in an NPY file or an HDF5 dataset, of which only the names have been read; see `open_record`.

    Attributes
    ----------
    path : Path
    array : str
        Name of the HDF5 dataset; empty for NPY.
    channels, quantities, sampling_rate
        As in `TimeRecord`.
    n_times : int
        When the file was opened.
    samples_first : bool
        Whether the array is (n_times, n_channels); else (n_channels, n_times).
    factors : (n_channels,) float array, optional
        To SI units; None where they are all 1.
    """

    path: Path
    array: str
    channels: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    sampling_rate: float
    n_times: int
    samples_first: bool
    factors: FloatArray | None = None

    def chunks(self, first: int = 0, last: int | None = None, longest: int | None = None) -> Iterator[FloatArray]:
        """Samples `first` to `last` in order, (n_channels, at most `longest`) each, in SI units.

        `last` is exclusive, None for the end; without `longest` the size of the record decides.

        Raises
        ------
        FileError
            If the file has shrunk or cannot be read on; the message names the sample.
        InputError
            If a sample is missing (NaN or infinite).
        """
        for begin, stop in _sample_chunks(self.n_times, len(self.channels), first, last, longest):
            yield self._read_chunk(begin, stop)

    def _read_chunk(self, begin: int, stop: int) -> FloatArray:
        """Samples `begin` to `stop` (exclusive) in SI units, (n_channels, n_samples) floats.

        The file is transposed in small parts to save memory. `InputError` if a sample is NaN or infinite.
        """
        if self.samples_first:
            chunk = np.empty((len(self.channels), stop - begin))
            step = max(_LINE, _AT_ONCE // (8 * len(self.channels)))
            for first in range(begin, stop, step):
                end = min(first + step, stop)
                rows = self._read(first, end)
                for row in range(0, len(chunk), 512):
                    chunk[row : row + 512, first - begin : end - begin] = rows[:, row : row + 512].T
        else:
            chunk = np.ascontiguousarray(self._read(begin, stop), dtype=np.float64)
        if self.factors is not None:
            chunk *= self.factors[:, None]
        self._require_finite_samples(chunk, begin)
        return chunk

    def _read(self, begin: int, stop: int) -> np.ndarray:
        """Samples `begin` to `stop` (exclusive) in the file's type and units, before any scaling.

        The result is (n_samples, n_channels), or (n_channels, n_samples) where the file has channels first. The file is
        opened anew at each call; `FileError` if the shape of its array has changed since the record was opened.
        """
        shape = (self.n_times, len(self.channels)) if self.samples_first else (len(self.channels), self.n_times)
        stored = _locate_array(self.path, self.array, f"at sample {begin}")
        if stored.shape != shape:
            axis = 0 if self.samples_first else 1
            now = stored.shape[axis] if len(stored.shape) == 2 else 0
            raise FileError(
                f"{self.path}: changed while it was read: it had {self.n_times} samples, and has {now} at sample"
                f" {begin}; read a copy that nothing writes to, and resume from sample {begin}"
            )
        if stored.offset is None:
            return hdf5_part(self.path, self.array, begin, stop, 0 if self.samples_first else 1)
        if self.samples_first and not stored.fortran:
            return self._read_rows(stored.offset, stored.dtype, begin, stop)
        with _reading_errors(self.path, f"at sample {begin}"):
            order: Literal["C", "F"] = "F" if stored.fortran else "C"
            mapped = np.memmap(self.path, stored.dtype, "r", stored.offset, shape, order)
            return np.array(mapped[begin:stop] if self.samples_first else mapped[:, begin:stop])

    def _read_rows(self, offset: int, dtype: np.dtype, begin: int, stop: int) -> np.ndarray:
        """Samples `begin` to `stop` (exclusive), (n_samples, n_channels), of an array that is stored row by row.

        `offset` is the byte at which the array begins, `dtype` its stored type. `FileError` if the file ends before `stop`.
        """
        count = len(self.channels)
        with _reading_errors(self.path, f"at sample {begin}"):
            values = np.fromfile(
                self.path, dtype, (stop - begin) * count, offset=offset + begin * count * dtype.itemsize
            )
        if len(values) < (stop - begin) * count:
            end_of_file = begin + len(values) // count
            raise FileError(
                f"{self.path}: ends at sample {end_of_file} of {self.n_times}; copy it again, and resume from there"
            )
        return values.reshape(-1, count)

    def _require_finite_samples(self, chunk: FloatArray, begin: int) -> None:
        """Raise `InputError` with channel, sample and time if a value of `chunk` (n_channels, n_samples) is NaN or infinite.

        `begin` is the number of the chunk's first sample in the record.
        """
        if np.isfinite(np.add.reduce(chunk, axis=None)):  # NaN and infinity survive a sum
            return
        bad = ~np.isfinite(chunk)
        if not bad.any():  # a sum of finite numbers beyond the largest
            return
        sample = int(np.argmax(bad.any(axis=0)))
        channel = int(np.argmax(bad[:, sample]))
        raise InputError(
            f"{self.path}: {self.quantities[channel]} {self.channels[channel]} is missing (NaN or infinite) at sample"
            f" {begin + sample}, {(begin + sample) / self.sampling_rate:g} s; {_REPAIR}"
        )


def open_record(path: str | Path, options: ReadOptions | None = None) -> OnDiskRecord:
    """The record at `path`, opened but not read.

    Parameters
    ----------
    path : str or Path
        NPY array, or HDF5 in structid's layout or with a bare dataset; (n_times, n_channels), or with channels first.
    options : ReadOptions, optional
        `sampling_rate`, `channels`, `quantities` or `units`, and `array`, of an array that does not describe itself.

    Raises
    ------
    FileError
        If the file is of another format, damaged or cut short.
    InputError
        If an option is missing, is of no use here, or does not fit the array.
    """
    path, chosen = require_readable(path), options or ReadOptions()
    unused = [name for name in _UNUSED if name in chosen.given()]
    if unused:
        raise InputError(f"{path}: a record read by chunks does not use {', '.join(unused)}; leave them out")
    if path.suffix.lower() not in _NPY + _HDF5:
        raise FileError(
            f"{path}: a record is read by chunks from .npy, .h5 or .hdf5; convert it first with `structid convert`"
        )
    if path.suffix.lower() in _HDF5:
        described = _own_layout(path)
        if described is not None:
            return described
    array = _choose_array(path, chosen.array) if path.suffix.lower() in _HDF5 else ""
    for name, purpose in (("sampling_rate", "its sampling rate"), ("channels", "what its channels are")):
        require_option(path, chosen, name, purpose)
    if not chosen.units:
        require_option(path, chosen, "quantities", "what its channels measure")
    channels = _dofs(chosen.channels)
    quantities, factors = channel_units(path, channels, chosen)
    shape = _shape(path, array)
    return _make_record(path, array, channels, quantities, float(chosen.sampling_rate or 0.0), shape, factors)


def _make_record(
    path: Path,
    array: str,
    channels: tuple[Dof, ...],
    quantities: tuple[Quantity, ...],
    rate: float,
    shape: tuple[int, ...],
    factors: FloatArray | None,
) -> OnDiskRecord:
    """The record on disk of a stored array of samples by channels, in either order.

    `array` is the dataset's name in HDF5 ("" for NPY), `rate` the sampling rate in Hz, `shape` that of the stored array
    (samples are rows if both axes fit), and `factors` (n_channels,) scale to SI; None if already in SI. `channels` and
    `quantities` are in the order of the array. Raises `InputError` if the shape does not fit, the array is empty, or a
    channel is there twice.
    """
    count = len(channels)
    if len(shape) != 2 or count not in shape:
        raise InputError(f"{path}: must hold an array of samples by {count} channels, got shape {shape}; name them all")
    if 0 in shape:
        raise InputError(f"{path}: holds no sample; the record is empty")
    seen: set[tuple[str, int, str]] = set()
    for quantity, dof in zip(quantities, channels, strict=True):
        key = (quantity, dof.node, dof.direction)
        if key in seen:
            raise InputError(f"{path}: {quantity} {dof.unsigned} is there twice; leave one of the channels out")
        seen.add(key)
    first = shape[1] == count
    plain = None if factors is None or (factors == 1).all() else factors
    return OnDiskRecord(path, array, channels, quantities, rate, shape[0] if first else shape[1], first, plain)


def _own_layout(path: Path) -> OnDiskRecord | None:
    """The record in an HDF5 file that structid wrote; None if the file lacks the mark of structid's layout.

    Raises `FileError` if fields are missing or disagree, and `InputError` if the file holds no time histories.
    """
    datasets = hdf5_datasets(path)
    if MARK not in datasets:
        return None
    names = {MARK, "channels", "quantities", "sampling_rate", "values"}
    if not names <= set(datasets):
        raise FileError(f"{path}: lacks {', '.join(sorted(names - set(datasets)))}; write it again with structid")
    fields = hdf5_fields(path, names - {"values"})
    if fields[MARK] != "time 1":
        raise InputError(f"{path}: holds no time histories; only they are read by chunks")
    channels, quantities = _dofs(texts_of(fields["channels"])), texts_of(fields["quantities"])
    with _reading_errors(path, "as it was opened"):
        rate, shape = float(np.ravel(fields["sampling_rate"])[0]), datasets["values"].shape
    for quantity in dict.fromkeys(quantities):
        if quantity not in QUANTITY_UNITS:
            raise FileError(f"{path}: has channels of {quantity!r}, which this version does not know")
    if len(quantities) != len(channels):
        raise FileError(f"{path}: names {len(channels)} channels and {len(quantities)} quantities; write it again")
    return _make_record(path, "values", channels, cast(tuple[Quantity, ...], quantities), rate, shape, None)


def _dofs(texts: Sequence[str]) -> tuple[Dof, ...]:
    """Degrees of freedom parsed from `texts`, in their order; repeated texts are allowed and parsed once.

    `InputError` if a text is no degree of freedom.
    """
    by_text: dict[str, Dof] = {}
    for text in texts:
        if text not in by_text:
            by_text[text] = parse_dof(text)
    return tuple(by_text[text] for text in texts)


def _choose_array(path: Path, wanted: str) -> str:
    """Name of the HDF5 dataset to read: `wanted`, or the only real array with two axes if `wanted` is "".

    Raises `InputError` if `wanted` is not such an array, or if there is not exactly one to choose.
    """
    datasets = hdf5_datasets(path)
    numeric = [name for name, dataset in datasets.items() if dataset.dtype.kind in "fiu" and len(dataset.shape) == 2]
    if wanted and wanted in numeric:
        return wanted
    if wanted or len(numeric) != 1:
        raise InputError(
            f"{path}: holds the arrays {', '.join(numeric) or 'none'}; say which to read with {option_words(array=None)}"
        )
    return numeric[0]


def _shape(path: Path, array: str) -> tuple[int, ...]:
    """Shape of the stored array; `FileError` unless it holds real numbers.

    `array` is the dataset's name in HDF5, "" for an NPY file.
    """
    stored = _locate_array(path, array, "as it was opened")
    if stored.dtype.kind not in "fiu":
        raise FileError(f"{path}: must hold real numbers, got type {stored.dtype}")
    return stored.shape


class _Stored(NamedTuple):
    """Shape, type and order of the array, and the byte where it begins; None where it lies in pieces (HDF5)."""

    shape: tuple[int, ...]
    dtype: np.dtype
    offset: int | None
    fortran: bool


def _locate_array(path: Path, array: str, when: str) -> _Stored:
    """Shape, type, position in bytes and Fortran order of the array of an NPY file, or of the dataset `array` of HDF5.

    `array` is "" for NPY. The position is None where a dataset is stored in pieces. `when` says in errors at which
    point reading failed, as in "at sample 100".
    """
    with _reading_errors(path, when):
        if array:
            return _Stored(*hdf5_datasets(path)[array], False)
        header = npy_header(path)
        return _Stored(header.shape, header.dtype, header.offset, header.fortran)


@contextmanager
def _reading_errors(path: Path, when: str) -> Iterator[None]:
    """Context manager: exceptions due to damaged content become `FileError` with the path; `when` says at which point."""
    try:
        yield
    except DAMAGE as error:
        what = str(error).removeprefix(f"{path}: ")
        raise FileError(
            f"{path}: cannot be read {when} ({what}); it is damaged or cut short: copy or write it again, and resume"
        ) from error


def _sample_chunks(
    n_times: int, n_channels: int, first: int, last: int | None, longest: int | None
) -> Iterator[tuple[int, int]]:
    """Yield consecutive ranges (begin, stop) of sample numbers that cover `first` to `last`, stop exclusive.

    `last` None is the end. A range has at most `longest` samples; for None, the length depends on the size of the
    record, `n_times` by `n_channels`. Raises `InputError` if the bounds lie outside of the record or `longest` is below
    1.
    """
    end = n_times if last is None else last
    if not 0 <= first <= end <= n_times:
        raise InputError(f"`first` and `last` must lie from 0 to {n_times} in this order, got {first} and {end}")
    if longest is not None and longest < 1:
        raise InputError(f"`longest` must be 1 or more, got {longest}")
    step = longest or max(_SHORTEST, min(n_times // _PARTS, _CHUNK_BYTES // (8 * max(1, n_channels))))
    for begin in range(first, end, step):
        yield begin, min(begin + step, end)

"""Records read from and written to files: one format a module, chosen by the suffix of the file; those of loggers are read only.

Records that were read can be kept in memory, where a process looks at the same files again and again; none are by default.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.errors import FileError, InputError, require_class
from structid.files import damage_told, require_readable
from structid.lazy import FormatModule
from structid.records.formats.options import CsvLayout, ReadOptions
from structid.records.record import FrfRecord, Record, TimeRecord

FileVersion = tuple[Path, int, int, ReadOptions]


@dataclass(frozen=True)
class LoggerFormat:
    """A format that is read only.

    Attributes
    ----------
    kind : str
        Name of the format in `structid.files.loggers`.
    SUFFIXES : tuple of str
    extra : str
        Extra of the installation of structid that brings the library of the format; "" where none is needed.
    words : str
        Name of such a file in messages.
    """

    kind: str
    SUFFIXES: tuple[str, ...]
    extra: str
    words: str

    def read(self, path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
        """The time record in the file at `path`; all of its channels share a clock.

        Raises
        ------
        FileError
            If the library is missing, or the file is damaged or holds no time histories.
        InputError
            If `options` do not fit, or the chosen channels have different clocks.
        """
        record: TimeRecord = _READER.read(path, options, self)
        return record

    def write(self, path: Path, record: FrfRecord | TimeRecord) -> None:
        """Refuse: files of loggers are only read.

        Raises
        ------
        FileError
            Always.
        """
        raise FileError(f"{path}: {self.words} files are read only; write .npz, .h5, .mat, .csv or .uff")


LOGGERS: tuple[LoggerFormat, ...] = (
    LoggerFormat("tdms", (".tdms",), "tdms", "TDMS"),
    LoggerFormat("mdf", (".mf4", ".mdf"), "mdf", "MDF"),
    LoggerFormat("miniseed", (".mseed", ".miniseed"), "miniseed", "miniSEED"),
    LoggerFormat("lvm", (".lvm",), "", "LVM"),
    LoggerFormat("wav", (".wav",), "", "WAV"),
    LoggerFormat("parquet", (".parquet",), "parquet", "Parquet"),
)
_READER = FormatModule(
    "structid.records.formats.loggers", tuple(suffix for logger in LOGGERS for suffix in logger.SUFFIXES)
)

NPZ = FormatModule("structid.records.formats.npz", (".npz",))
HDF5 = FormatModule("structid.records.formats.hdf5", (".h5", ".hdf5"))
MAT = FormatModule("structid.records.formats.mat", (".mat",))
CSV = FormatModule("structid.records.formats.csv.csv", (".csv", ".txt", ".tsv"))
UFF = FormatModule("structid.records.formats.uff.uff", (".uff", ".unv", ".uf", ".ufb"))
NPY = FormatModule("structid.records.formats.npy", (".npy",))
#: Each module has read(path, options) and write(path, record).
FORMATS: tuple[FormatModule, ...] = (NPZ, HDF5, MAT, CSV, UFF, NPY)

#: Those whose channels have names of their own, which `columns` and `time_column` of `ReadOptions` use.
_NAMED: tuple[FormatModule | LoggerFormat, ...] = (CSV, *LOGGERS)

_DEWESOFT = "only the vendor's own library reads Dewesoft files; export as UFF, TDMS, MAT or CSV from DewesoftX"
#: What to do about files that are often at hand.
_ELSEWHERE = {
    **dict.fromkeys((".dxd", ".dxz", ".d7d", ".d7z"), _DEWESOFT),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "is a workbook; save the sheet as CSV UTF-8, without merged cells"),
}

__all__ = [
    "FORMATS",
    "LOGGERS",
    "CsvLayout",
    "ReadOptions",
    "keep_records",
    "read_record",
    "write_record",
]


def _format_of(path: Path) -> FormatModule | LoggerFormat:
    """The module, or the logger's format, that reads files with the suffix of `path`; the file is not opened.

    Raises `FileError` if no format has this suffix, or it is a folder.
    """
    suffix = path.suffix.lower()
    formats: tuple[FormatModule | LoggerFormat, ...] = (*FORMATS, *LOGGERS)
    for module in formats:
        if suffix in module.SUFFIXES:
            return module
    if suffix in _ELSEWHERE:
        raise FileError(f"{path}: {_ELSEWHERE[suffix]}")
    if path.is_dir():
        raise FileError(f"{path}: is a folder; give a file in it")
    known = " ".join(suffix for module in formats for suffix in module.SUFFIXES)
    raise FileError(f"{path}: the suffix {suffix!r} is of no known format; rename or convert it to one of {known}")


def how_read(source: str, path: str | os.PathLike[str]) -> str:
    """Note of the reader on the file `path`, the part of the record's `source` after the path; "" without a note."""
    return source.removeprefix(str(path)).partition("; ")[2] if source.startswith(str(path)) else ""


def read_record(path: str | os.PathLike[str], options: ReadOptions | None = None) -> FrfRecord | TimeRecord:
    """The record in the file at `path`, its format by the suffix, in SI units.

    Parameters
    ----------
    path : str or path-like
        CSV, universal, HDF5, MAT or NPZ file, an NPY array, or a file of a logger, by its suffix.
    options : ReadOptions, optional
        Facts that the file does not state, and the channels to read.

    Raises
    ------
    FileError
        If the file is missing, damaged, or holds no record; the message begins with its path.
    InputError
        If an option is missing or contradicts the file, or the data are not usable (NaN, a frequency
        axis that does not increase, a doubled channel); the message begins with the path.

    Examples
    --------
    >>> options = ReadOptions(sampling_rate=100, channels="1Z+,2Z+", units="g")
    >>> record = read_record("impact.npy", options)  # doctest: +SKIP
    """
    is_array = isinstance(path, np.ndarray)
    remedy = "of arrays make a record by `FrfRecord` or `TimeRecord`" if is_array else "give the path of a file"
    require_class("path", path, (str, os.PathLike), remedy)
    path, options = Path(path), ReadOptions() if options is None else options
    require_class("options", options, ReadOptions, "make it by `ReadOptions(...)`")
    module = _format_of(path)
    _require_applicable(path, module, options)
    require_readable(path)

    def read() -> FrfRecord | TimeRecord:
        """The record by the module of its format; damage is raised as `FileError`."""
        with damage_told(path, "a record that can be read"):
            record: FrfRecord | TimeRecord = module.read(path, options)
        return record

    return kept_or_read(path, options, read)


def _require_applicable(path: Path, module: FormatModule | LoggerFormat, options: ReadOptions) -> None:
    """Raise `InputError` if an option was set that the format `module` of the file at `path` cannot use.

    Such `options` are `csv`, `columns`, `time_column`, `axes` and `resample`; others are judged by the formats
    themselves.
    """
    options_given = options.given()
    if "csv" in options_given and module is not CSV:
        raise InputError(f"{path}: is no table, which `csv` is about; leave it out", "csv")
    for name, formats in (("columns", (*_NAMED, UFF)), ("time_column", _NAMED)):
        if name in options_given and module not in formats:
            raise InputError(
                f"{path}: has no named columns, which `{name}` is about; choose with `channels` or `array`", name
            )
    if "axes" in options_given and module is not UFF:
        raise InputError(f"{path}: has no coordinate systems, which `axes` is about; leave it out", "axes")
    if "resample" in options_given and module not in (CSV, UFF, *LOGGERS):
        raise InputError(
            f"{path}: has no times of its samples, of which `resample` makes even ones; leave it out", "resample"
        )


def write_record(path: str | os.PathLike[str], record: FrfRecord | TimeRecord) -> None:
    """Write `record` to `path`, whole or not at all, in the format of the suffix; an existing file is replaced.

    NPZ, HDF5 and MAT keep everything. CSV keeps values, coherence and standard deviations of FRFs; UFF keeps values,
    coherence and averages.

    Raises
    ------
    FileError
        If the suffix is not known or the file cannot be written; a file already there stays as it was.
    InputError
        If FRFs have a `decay` or a `segment`, which say what the values are, and the format keeps none; or a text
        holds control characters.
    """
    require_class("path", path, (str, os.PathLike), "the path comes first, then the record")
    require_class("record", record, (FrfRecord, TimeRecord), "modes go to a file by `structid modes`")
    path = Path(path)
    module = _format_of(path)
    for name in ("decay", "segment") if isinstance(record, FrfRecord) and module in (CSV, UFF) else ():
        if getattr(record, name) is not None:
            raise InputError(
                f"{path}: this format cannot keep `{name}`, without which the FRFs say something else; write .npz, .h5 or"
                " .mat instead"
            )
    module.write(path, record)


class _Kept:
    """Cache of the records read last, at most `most` bytes."""

    def __init__(self) -> None:
        self.most = 0
        self.records = OrderedDict[FileVersion, Record]()


_kept = _Kept()


def keep_records(most_bytes: int) -> None:
    """Cache records in memory from now on, those read last up to `most_bytes` in all; 0 empties and ends the cache."""
    _kept.most = most_bytes
    _forget()


def kept_or_read(path: Path, options: ReadOptions, read: Callable[[], Record]) -> Record:
    """The cached record of the file at `path` if file and `options` are unchanged; else the result of `read()`.

    That result is cached, unless it is too large or the file changed while it was read.
    """
    key = _mark(path, options)
    record = _kept.records.get(key)
    if record is None:
        record = read()
        if record_bytes(record) > _kept.most or _mark(path, options) != key:
            return record
        _kept.records[key] = record
        _forget()
    _kept.records.move_to_end(key)
    return record


def _mark(path: Path, options: ReadOptions) -> FileVersion:
    """Key of a file's content and of the way it is read: absolute path, time of change, size and options."""
    stamp = path.stat()
    return path.absolute(), stamp.st_mtime_ns, stamp.st_size, options


def _forget() -> None:
    while sum(map(record_bytes, _kept.records.values())) > _kept.most:
        _kept.records.popitem(last=False)


def record_bytes(record: object) -> int:
    """Total size of the arrays in a record, in bytes."""
    return sum(value.nbytes for value in vars(record).values() if isinstance(value, np.ndarray))

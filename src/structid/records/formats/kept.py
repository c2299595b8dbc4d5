"""Records that were read, kept where a process looks at the same files again and again; none by default."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord

Record = FrfRecord | TimeRecord
FileVersion = tuple[Path, int, int, ReadOptions]


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

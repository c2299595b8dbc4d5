"""Bare NPY arrays of time histories: read with `ReadOptions`; not written, for they cannot name channels."""

from __future__ import annotations

import tokenize
from pathlib import Path

import numpy as np

from structid.errors import FileError
from structid.files import require_readable
from structid.records.io.bare import time_from_array
from structid.records.io.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord

SUFFIXES: tuple[str, ...] = (".npy",)

#: What NumPy raises on damaged arrays.
_DAMAGE = (
    EOFError, OSError, ValueError, KeyError, OverflowError, MemoryError, TypeError, SyntaxError, IndexError,
    tokenize.TokenError,
)  # fmt: skip


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The time record in the NPY file at `path`, shape (n_times, n_channels), as `options` describe it.

    Raises
    ------
    FileError
        If the file is not an NPY array, is damaged, or holds Python objects.
    InputError
        If `sampling_rate`, `channels` or `units` are missing or do not fit.
    """
    path = require_readable(path)
    try:
        with path.open("rb") as stream:
            array = np.lib.format.read_array(stream, allow_pickle=False)
            junk = stream.read(1)
    except _DAMAGE as error:
        if "allow_pickle" in str(error):
            raise FileError(
                f"{path}: holds Python objects, which can run code when read; save an array of numbers"
            ) from error
        raise FileError(f"{path}: is not a whole NPY array ({error}); copy or write it again") from error
    if junk:
        raise FileError(f"{path}: goes on after the end of its array; copy or write it again")
    return time_from_array(path, array, options)


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Refuse: an NPY file cannot say channels, quantities and sampling rate.

    Raises
    ------
    FileError
        Always.
    """
    raise FileError(f"{path}: an NPY file cannot name channels, units and rate; write .npz, .h5, .mat, .csv or .uff")

"""Bare NPY arrays of time histories: read with `ReadOptions`; not written, for they cannot name channels."""

from __future__ import annotations

from pathlib import Path

from structid.core.errors import FileError
from structid.files.npy import npy_array
from structid.records.formats.bare import time_from_array
from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The time record in the NPY file at `path`, shape (n_times, n_channels), as `options` describe it.

    Raises
    ------
    FileError
        If the file is not an NPY array, is damaged, or holds Python objects.
    InputError
        If `sampling_rate`, `channels` or `units` are missing or do not fit.
    """
    return time_from_array(path, npy_array(path), options)


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Refuse: an NPY file cannot say channels, quantities and sampling rate.

    Raises
    ------
    FileError
        Always.
    """
    raise FileError(f"{path}: an NPY file cannot name channels, units and rate; write .npz, .h5, .mat, .csv or .uff")

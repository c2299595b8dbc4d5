"""NPZ archives of NumPy: structid's own layout, or bare arrays with `ReadOptions`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structid.files import atomic_write
from structid.files.npy import npz_arrays
from structid.records.formats.layout import MARK, fields_of, record_from
from structid.records.formats.options import ReadOptions
from structid.records.formats.selection import select_channels
from structid.records.record import FrfRecord, TimeRecord

if TYPE_CHECKING:
    from structid.files.contained import Field


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the NPZ archive at `path`: structid's own layout, or bare arrays that `options` describe.

    In structid's layout `options` choose among channels.

    Raises
    ------
    FileError
        If the file is not an archive, is damaged, or holds Python objects.
    InputError
        If it holds bare arrays and an option is missing, or an option contradicts the file.
    """
    arrays = npz_arrays(path)
    if MARK in arrays:
        return select_channels(path, record_from(path, {name: _as_field(a) for name, a in arrays.items()}), options)
    from structid.records.formats.bare import Shapes, read_bare  # structid's own layout needs none of it
    from structid.records.formats.stated import statements_of

    shapes: Shapes = {name: (array.shape, array.dtype) for name, array in arrays.items()}
    statements = statements_of({name: _as_field(array) for name, array in arrays.items()})
    return read_bare(path, shapes, arrays.__getitem__, options, statements)


def _as_field(array: np.ndarray) -> Field:
    """A text array as a text or a tuple of texts; other arrays as they are."""
    if array.dtype.kind != "U":
        return array
    return str(array) if array.ndim == 0 else tuple(str(text) for text in array.ravel())


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` as an NPZ archive in structid's layout, complete.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    arrays = {name: np.asarray(field) for name, field in fields_of(record).items()}
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]  # numpy's stub reads ** as its own options

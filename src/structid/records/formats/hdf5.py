"""HDF5 files: structid's own layout, or bare arrays (at any depth, such as ``test/frf``) with `ReadOptions`."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structid.files import atomic_write
from structid.files.hdf5 import hdf5_datasets, hdf5_fields
from structid.records.formats.bare import Shapes, read_bare
from structid.records.formats.layout import MARK, Field, fields_of, record_from
from structid.records.formats.options import ReadOptions
from structid.records.formats.selection import selected
from structid.records.record import FrfRecord, TimeRecord

if TYPE_CHECKING:
    import h5py

SUFFIXES: tuple[str, ...] = (".h5", ".hdf5")


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the HDF5 file at `path`: structid's own layout, or bare arrays that `options` describe.

    Raises
    ------
    FileError
        If the file is not HDF5, is damaged, or has its values in other files.
    InputError
        If it holds bare arrays and an option is missing.
    """
    shapes: Shapes = {name: (dataset.shape, dataset.dtype) for name, dataset in hdf5_datasets(path).items()}
    if MARK in shapes:
        fields = hdf5_fields(path, [name for name in shapes if "/" not in name])
        return selected(path, record_from(path, fields), options)
    loaded = hdf5_fields(path, _needed(shapes, {options.array, options.frequency_array, options.coherence_array}))
    return read_bare(path, shapes, lambda name: np.asarray(loaded[name]), options)


def _needed(shapes: Shapes, wanted: set[str]) -> set[str]:
    """Datasets to load: those wanted by name; all of numbers unless the array was named."""
    named = {name for name in shapes if name in wanted}
    numeric = {name for name, (_, dtype) in shapes.items() if dtype.kind in "fciu"}
    return named if any(wanted) and len(numeric) > len(named) + 1 else named | numeric


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` to `path` as an HDF5 file in structid's layout, complete.

    It is made in memory, so that a full disk shows as an ordinary error when the bytes are written.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, field in fields_of(record).items():
            _store(file, name, field)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def _store(file: h5py.File, name: str, field: Field) -> None:
    """Store one field of a record, an array or texts, in an open HDF5 file."""
    import h5py

    if isinstance(field, np.ndarray):
        file.create_dataset(name, data=field)
    else:
        file.create_dataset(name, data=field, dtype=h5py.string_dtype("utf-8"))

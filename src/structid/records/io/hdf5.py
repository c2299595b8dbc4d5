"""HDF5 files: structid's own layout, or bare arrays (at any depth, such as ``test/frf``) with `ReadOptions`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structid.errors import FileError
from structid.files import atomic_write, require_readable
from structid.records.io.bare import Shapes, read_bare
from structid.records.io.layout import MARK, Field, fields_of, record_from
from structid.records.io.options import ReadOptions
from structid.records.io.selection import selected
from structid.records.record import FrfRecord, TimeRecord

SUFFIXES: tuple[str, ...] = (".h5", ".hdf5")

#: What h5py raises on damaged files.
DAMAGE = (OSError, KeyError, RuntimeError, ValueError, TypeError, OverflowError, MemoryError, AttributeError)


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the HDF5 file at `path`.

    Raises
    ------
    FileError
        If the file is not HDF5 or is damaged.
    InputError
        If it holds bare arrays and an option is missing.
    """
    import h5py

    path = require_readable(path)
    try:
        with h5py.File(path, "r") as file:
            own = MARK in file
            wanted = {options.array, options.frequency_array, options.coherence_array}
            shapes = dataset_shapes(file)
            names = set(file) if own else _needed(shapes, wanted)
            loaded = {name: _field(file[name]) for name in names}
    except DAMAGE as error:
        raise FileError(f"{path}: is not a whole HDF5 file ({error}); copy or write it again") from error
    if own:
        return selected(path, record_from(path, loaded), options)
    return read_bare(path, shapes, lambda name: np.asarray(loaded[name]), options)


def dataset_shapes(file: Any) -> Shapes:
    """Shape and type of every dataset in an open HDF5 file, by its path without the leading slash."""
    import h5py

    found: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            found[name] = (item.shape, complex_type(item.dtype))

    file.visititems(note)
    return found


def complex_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """complex128 for a compound of real and imaginary parts, as other programs write; else `dtype`."""
    names = tuple(name.lower() for name in dtype.names or ())
    return np.dtype(np.complex128) if names in (("real", "imag"), ("r", "i"), ("re", "im")) else dtype


def as_complex(array: NDArray[Any]) -> NDArray[Any]:
    """`array` with compounds of real and imaginary parts made complex numbers."""
    if array.dtype.names and complex_type(array.dtype) != array.dtype:
        real, imaginary = array.dtype.names
        return np.asarray(array[real] + 1j * array[imaginary])
    return array


def _needed(shapes: Shapes, wanted: set[str]) -> set[str]:
    """Datasets to load: those wanted by name; all of numbers unless the array was named."""
    named = {name for name in shapes if name in wanted}
    numeric = {name for name, (_, dtype) in shapes.items() if dtype.kind in "fciu"}
    return named if any(wanted) and len(numeric) > len(named) + 1 else named | numeric


def _field(dataset: Any) -> Field:
    import h5py

    if h5py.check_string_dtype(dataset.dtype) is None:
        return as_complex(np.asarray(dataset[()]))
    texts = dataset.asstr()[()]
    return texts if isinstance(texts, str) else tuple(str(text) for text in texts.ravel())


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` as an HDF5 file in structid's layout, complete.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    import h5py

    fields = fields_of(record)
    with atomic_write(path) as temporary:
        try:
            with h5py.File(temporary, "w") as file:
                for name, field in fields.items():
                    _store(file, name, field)
        except RuntimeError as error:
            raise OSError(f"HDF5 could not write the file: {error}") from error


def _store(file: Any, name: str, field: Field) -> None:
    import h5py

    if isinstance(field, np.ndarray):
        file.create_dataset(name, data=field)
    else:
        file.create_dataset(name, data=field, dtype=h5py.string_dtype("utf-8"))

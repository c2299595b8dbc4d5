"""HDF5 files and MAT files of version 7.3, read in the child of `structid.files.contained`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.errors import FileError
from structid.files.contained import ReaderError, read_in_child
from structid.files.reading import require_readable

#: A dataset as read: numbers, a text, or a list of texts.
Field = np.ndarray | str | tuple[str, ...]


class Dataset(NamedTuple):
    """Shape and type of a dataset, and the byte of the file where its values begin: None where they lie in pieces."""

    shape: tuple[int, ...]
    dtype: np.dtype
    offset: int | None


def hdf5_datasets(path: Path) -> dict[str, Dataset]:
    """Shape, type and position of every dataset of the file at `path`, by its path without the leading slash.

    The position is the byte at which its values begin, or None where they do not lie in one piece as they are. Texts have the
    type of objects, references and lists that of void.

    Raises
    ------
    FileError
        If the file is not HDF5, is damaged, or has links to other files.
    """
    with _hdf5_errors(path):
        declared = read_in_child(path, "hdf5_shapes")
    return {
        name: Dataset(tuple(shape), np.dtype(object) if form == "text" else np.dtype(form), offset)
        for name, (shape, form, offset) in declared.items()
    }


def hdf5_attributes(path: Path) -> dict[str, np.ndarray | tuple[str, ...]]:
    """Attributes that are texts or up to 4096 numbers, by ``path@name``; the path of the file itself is empty.

    They belong to datasets, groups and the file. Values are tuples of texts or one-dimensional arrays.
    """
    with _hdf5_errors(path):
        entries = read_in_child(path, "hdf5_attributes")
    return {name: value if isinstance(value, np.ndarray) else tuple(map(str, value)) for name, value in entries.items()}


def hdf5_fields(path: Path, names: Iterable[str]) -> dict[str, Field]:
    """Values of those datasets called `names` that the file has, by name: an array, a text, or a tuple of texts.

    Raises
    ------
    FileError
        If the file is damaged, or the values of a dataset lie in other files or were never written.
    """
    with _hdf5_errors(path):
        return _fields(read_in_child(path, "hdf5_fields", names=list(names)))


def hdf5_part(path: Path, name: str, begin: int, stop: int, axis: int) -> np.ndarray:
    """Entries `begin` to `stop` (exclusive) along `axis` 0 or 1 of the two-dimensional dataset `name`."""
    with _hdf5_errors(path):
        part: np.ndarray = read_in_child(path, "hdf5_part", name=name, begin=begin, stop=stop, axis=axis)
    return part


def matlab_73_fields(path: Path) -> dict[str, Field]:
    """Every variable of numbers or texts of a MAT file of version 7.3, by name."""
    with _hdf5_errors(path):
        return _fields(read_in_child(path, "matlab_73"))


def texts_of(field: Field) -> tuple[str, ...]:
    """The texts of a field as a tuple: one text, or a list of them."""
    return (field,) if isinstance(field, str) else tuple(map(str, field))


def _fields(fields: Mapping[str, Field | list[str]]) -> dict[str, Field]:
    return {name: tuple(field) if isinstance(field, list) else field for name, field in fields.items()}


@contextmanager
def _hdf5_errors(path: Path) -> Iterator[None]:
    """Context manager that turns a `ReaderError` of its block into `FileError` with `path`, the cause and the remedy.

    `FileError` also before the block, if `path` is no readable file.
    """
    require_readable(path)
    try:
        yield
    except ReaderError as error:
        if error.kind == "UnusableError":
            raise FileError(f"{path}: {error}") from error
        if error.kind == "MemoryError":
            raise FileError(
                f"{path}: does not fit in memory; read a part of it, or write it again if it is damaged"
            ) from error
        raise FileError(f"{path}: is damaged, cut short or not HDF5 ({error}); copy or write it again") from error

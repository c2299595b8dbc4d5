"""MAT files of MATLAB: structid's own layout, or bare arrays with `ReadOptions`; version 5 and 7.3 read, 5 written."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structid.errors import FileError
from structid.files import atomic_write, require_readable
from structid.records.io.bare import Shapes, read_bare
from structid.records.io.hdf5 import DAMAGE as HDF5_DAMAGE
from structid.records.io.hdf5 import as_complex
from structid.records.io.layout import MARK, Field, fields_of, record_from
from structid.records.io.options import ReadOptions
from structid.records.io.selection import selected
from structid.records.record import FrfRecord, TimeRecord

SUFFIXES: tuple[str, ...] = (".mat",)
_LARGEST = 2**31 - 1
_COMPRESSED = 15
_TOP_TYPES = (14, _COMPRESSED)
_HDF5_START = b"\x89HDF\r\n\x1a\n"


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the MAT file at `path`; a field of a struct is named with a dot, as in ``test.frf``.

    Raises
    ------
    FileError
        If the file is not a MAT file or is damaged.
    InputError
        If it holds bare arrays and an option is missing.
    """
    path = require_readable(path)
    fields = _read_73(path) if _is_73(path) else _read_5(path)
    if MARK in fields:
        return selected(path, record_from(path, fields), options)
    arrays = {name: field for name, field in fields.items() if isinstance(field, np.ndarray)}
    shapes: Shapes = {name: (array.shape, array.dtype) for name, array in arrays.items()}
    return read_bare(path, shapes, arrays.__getitem__, options)


def _is_73(path: Path) -> bool:
    with path.open("rb") as stream:
        head = stream.read(520)
    return head.startswith((b"MATLAB 7.3", _HDF5_START)) or head[512:] == _HDF5_START


def _require_whole_5(path: Path) -> None:
    """Raise unless every variable of a version 5 file ends within it and its checksum fits.

    scipy checks neither, and can end the whole process on a damaged file.
    """
    data = path.read_bytes()
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI") or data[124:126] not in (b"\x00\x01", b"\x01\x00"):
        return  # version 4, or no MAT file: scipy tells
    order = "<" if data[126:128] == b"IM" else ">"
    at = 128
    while at < len(data):
        if at + 8 > len(data):
            raise FileError(f"{path}: ends within a variable; the file is truncated, copy or save it again")
        kind, size = struct.unpack(f"{order}II", data[at : at + 8])
        at += 8 + size
        if at > len(data) or kind not in _TOP_TYPES:
            raise FileError(f"{path}: ends within a variable; the file is truncated or damaged, copy or save it again")
        if kind == _COMPRESSED:
            try:
                zlib.decompress(data[at - size : at])
            except zlib.error as error:
                raise FileError(f"{path}: a variable is damaged ({error}); copy or save it again") from error


def _read_5(path: Path) -> dict[str, Field]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, MatReadWarning

    damage = (
        MatReadError, MatReadWarning, UserWarning, ValueError, TypeError, KeyError, IndexError, OSError, EOFError, struct.error,
        zlib.error, NotImplementedError, OverflowError, MemoryError, AttributeError, UnboundLocalError,
    )  # fmt: skip
    try:
        _require_whole_5(path)
        with path.open("rb") as stream:
            loaded = loadmat(stream)
    except FileError:
        raise
    except damage as error:
        raise FileError(f"{path}: is not a whole MAT file ({error}); copy or save it again") from error
    found: dict[str, Field] = {}
    for name, value in loaded.items():
        if not name.startswith("__"):
            _collect(found, name, value)
    return found


def _collect(found: dict[str, Field], name: str, value: Any) -> None:
    """Add `value` under `name`; the fields of a struct under ``name.field``."""
    array = np.asarray(value)
    if array.dtype.names:
        if array.size == 1:
            for field in array.dtype.names:
                _collect(found, f"{name}.{field}", array.ravel()[0][field])
        return
    if array.dtype.kind == "U":
        found[name] = _joined(array)
    elif array.dtype.kind == "O":
        cells = [np.asarray(cell) for cell in array.ravel()]
        if all(cell.dtype.kind == "U" for cell in cells):
            found[name] = tuple(_joined(cell) for cell in cells)
    else:
        found[name] = array


def _joined(texts: NDArray[Any]) -> str:
    return "".join(str(text) for text in texts.ravel())


def _read_73(path: Path) -> dict[str, Field]:
    import h5py

    found: dict[str, Field] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            field = _field_73(item.file, item)
            if field is not None:
                found[name.replace("/", ".")] = field

    try:
        with h5py.File(path, "r") as file:
            file.visititems(note)
    except HDF5_DAMAGE as error:
        raise FileError(f"{path}: is not a whole MAT file of version 7.3 ({error}); copy or save it again") from error
    return found


def _field_73(file: Any, dataset: Any) -> Field | None:
    """A dataset in MATLAB's conventions: axes reversed, characters as codes, cells as references."""
    matlab_class = dataset.attrs.get("MATLAB_class", b"")
    if matlab_class == b"char":
        if dataset.attrs.get("MATLAB_empty", 0):
            return ""
        return np.asarray(dataset[()]).T.astype("<u2").tobytes().decode("utf-16-le")
    if matlab_class == b"cell":
        cells = [_field_73(file, file[reference]) for reference in np.asarray(dataset[()]).T.ravel()]
        return tuple(str(cell) for cell in cells) if all(isinstance(cell, str) for cell in cells) else None
    if dataset.dtype.kind in "fciuV":
        return as_complex(np.asarray(dataset[()])).T
    return None


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` as a MAT file of version 5 in structid's layout, complete.

    Raises
    ------
    FileError
        If the file cannot be written, or an array is larger than the 2 GB of version 5.
    """
    from scipy.io import savemat

    fields = fields_of(record)
    if record.values.nbytes > _LARGEST:
        raise FileError(f"{path}: a MAT file of version 5 holds 2 GB an array at most; write .h5 instead")
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        savemat(
            stream, {name: _as_matlab(field) for name, field in fields.items()}, oned_as="column", do_compression=True
        )


def _as_matlab(field: Field) -> Any:
    return np.array(field, dtype=object) if isinstance(field, tuple) else field

"""Arrays of NumPy in NPY files and NPZ archives; the sizes they declare are compared with the file before memory is taken."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from structid.core.errors import FileError
from structid.files import damage_told, require_readable

_MAGIC = 8
_DENSEST = 1032  # bytes that deflate can make of one
#: Bytes of an array that is packed denser than any measurement (nothing but zeros) at most, and that density.
_MOST_PACKED, _PACKED = 100_000_000, 500


class Header(NamedTuple):
    """Header of an NPY file: type and shape of the array, and the byte where its values begin."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype
    offset: int

    @property
    def order(self) -> str:
        return "F" if self.fortran else "C"


def npy_header(path: Path) -> Header:
    """The header of the NPY file at `path`, after a check that its values fill the rest of the file.

    Raises
    ------
    FileError
        If it is no whole NPY array, or holds Python objects.
    """
    path = require_readable(path)
    with damage_told(path, "a whole NPY array"), path.open("rb") as stream:
        return _read_header(stream, path.stat().st_size)


def npy_array(path: Path) -> np.ndarray:
    """The array in the NPY file at `path`, in the shape and order that its header states.

    `FileError` if the file is no whole NPY array of numbers or texts.
    """
    header = npy_header(path)
    with damage_told(path, "a whole NPY array"):
        values = np.fromfile(path, header.dtype, math.prod(header.shape), offset=header.offset)
        return values.reshape(header.shape, order=header.order)  # type: ignore[call-overload]


def npz_arrays(
    path: Path, kind: str = "a whole NPZ archive", remedy: str = "copy or write it again"
) -> dict[str, np.ndarray]:
    """Every array in the NPZ archive at `path` by its name.

    `kind`, what the file should be, and `remedy` are words of the error.

    Raises
    ------
    FileError
        If it is no whole archive of arrays, or holds Python objects.
    """
    path = require_readable(path)
    with damage_told(path, kind, remedy), zipfile.ZipFile(path) as archive:
        return {_array_name(path, member): _read_member(archive, member) for member in archive.infolist()}


def _array_name(path: Path, member: zipfile.ZipInfo) -> str:
    """Name of the array in `member` of the NPZ archive at `path`; `FileError` if the member is no NPY file."""
    if not member.filename.endswith(".npy"):
        raise FileError(f"{path}: holds {member.filename!r}, which is no array; write it with numpy.savez")
    return member.filename[: -len(".npy")]


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """The array in one member of an NPZ archive.

    `ValueError` if it is packed in another way than NumPy does, says more bytes than its packed ones can hold, would
    take more than 100 MB and 500 times its packed size, or is no whole array of numbers or texts.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{member.filename} is packed in a way that NumPy does not use")
    if member.file_size > _DENSEST * member.compress_size + _MAGIC:
        raise ValueError(
            f"{member.filename} says {member.file_size} bytes, its {member.compress_size} cannot hold them"
        )
    if member.file_size > max(_MOST_PACKED, _PACKED * member.compress_size):
        raise ValueError(
            f"{member.filename} would take {member.file_size / 1e6:.0f} MB, packed into {member.compress_size / 1e6:.1f} MB as only"
            " zeros are; write it with numpy.savez, which does not pack"
        )
    with archive.open(member) as stream:
        header = _read_header(stream, member.file_size)
        values = np.frombuffer(stream.read(), header.dtype)
        return values.reshape(header.shape, order=header.order)  # type: ignore[call-overload]


def _read_header(stream: IO[bytes], size: int) -> Header:
    """Header of the NPY array that `stream` begins with.

    Raises `ValueError` if it holds Python objects, or unless header and values fill all `size` bytes of the file.
    """
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"version {version} of the format is not for numbers and texts")
    try:
        shape, fortran, dtype = readers[version](stream)
    except (TypeError, MemoryError) as error:  # a nested literal, or a type of nonsense
        raise ValueError(f"its header cannot be read: {error}") from error
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which can run code when read; save arrays of numbers only")
    if min(shape, default=0) < 0 or dtype.itemsize == 0:
        raise ValueError(f"it declares shape {shape} of type {dtype}")
    declared, there = math.prod(shape) * dtype.itemsize, size - stream.tell()
    if declared != there:
        raise ValueError(f"it declares {declared} bytes of values, {there} follow its header")
    return Header(shape, fortran, dtype, stream.tell())

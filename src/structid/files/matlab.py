"""MAT files of MATLAB before 7.3 (versions 4 and 5): numbers, texts, cells of texts, structs and sparse matrices.

Every size in the file is checked against the bytes that hold it. Of version 7.3, which is HDF5, see `structid.files.hdf5`.

References
----------
The MathWorks, MAT-File Format (versions 4 and 5).
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy import sparse

from structid.files.reading import damage_told, require_readable
from structid.files.sparse import compressed, coordinates

#: A variable: numbers, a text, or a list of texts.
Variable: TypeAlias = np.ndarray | sparse.csc_array | str | tuple[str, ...]

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _SPARSE = 1, 2, 4, 5
_NUMERIC = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_OTHERS = (3, 16, 17, 18)  # objects and functions are passed over
_COMPLEX, _DEEPEST, _DENSEST = 0x0800, 32, 1032
_TYPES_4 = ("f8", "f4", "i4", "i2", "u2", "u1")


class _Bytes(NamedTuple):
    """Bytes of the file or of a compressed part of it, and their order."""

    data: bytes
    order: str


class _Element(NamedTuple):
    """Type, first and last byte of an element, and where the next begins."""

    kind: int
    start: int
    stop: int
    behind: int


def matlab_variables(path: Path) -> dict[str, Variable]:
    """Every variable of the file at `path` that is of numbers or texts; the field of a struct under ``name.field``.

    Raises
    ------
    FileError
        If the file is no MAT file of version 4 or 5, or damaged.
    """
    path = require_readable(path)
    with damage_told(path, "a whole MAT file", "copy or save it again"):
        data = path.read_bytes()
        if len(data) >= 128 and data[126:128] in (b"IM", b"MI"):
            return _version_5(_Bytes(data, "<" if data[126:128] == b"IM" else ">"))
        return _version_4(data)


def _version_5(whole: _Bytes) -> dict[str, Variable]:
    (version,) = struct.unpack_from(f"{whole.order}H", whole.data, 124)
    if version != 0x0100:
        raise ValueError(f"its header says version {version:#06x}")
    found: dict[str, Variable] = {}
    at = 128
    while at < len(whole.data):
        element = _element(whole, at, len(whole.data))
        at = element.stop  # variables are not padded to eight bytes where they are compressed
        if element.kind == _COMPRESSED:
            inner = _Bytes(_unpacked(whole.data[element.start : element.stop]), whole.order)
            element = _element(inner, 0, len(inner.data))
            if element.kind != _MATRIX:
                raise ValueError("a compressed variable is none")
            _variable(inner, element, found, "", 0)
        elif element.kind == _MATRIX:
            _variable(whole, element, found, "", 0)
        else:
            raise ValueError(f"byte {element.start - 8} is not where a variable begins")
    return found


def _unpacked(packed: bytes) -> bytes:
    stream = zlib.decompressobj()
    content = stream.decompress(packed, _DENSEST * len(packed) + 64)
    if not stream.eof:
        raise ValueError("a variable is cut short")
    return content


def _element(whole: _Bytes, at: int, end: int) -> _Element:
    """The element whose tag is at `at`; a short one has its bytes in the tag."""
    if at + 8 > end:
        raise ValueError("it ends within a variable")
    kind, size = struct.unpack_from(f"{whole.order}II", whole.data, at)
    if kind >> 16:
        kind, size, start, behind = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if size > 4:
            raise ValueError("a short element holds more than four bytes")
    else:
        start = at + 8
        behind = start + size + (-size % 8 if kind != _COMPRESSED else 0)
    if start + size > end:
        raise ValueError("it ends within a variable")
    return _Element(kind, start, start + size, min(behind, end))


def _numbers(whole: _Bytes, element: _Element) -> np.ndarray:
    if element.kind not in _TYPES:
        raise ValueError(f"numbers cannot be of type {element.kind}")
    dtype = np.dtype(whole.order + _TYPES[element.kind])
    size = element.stop - element.start
    if size % dtype.itemsize:
        raise ValueError("a number is cut short")
    return np.frombuffer(whole.data, dtype, size // dtype.itemsize, element.start)


def _variable(whole: _Bytes, element: _Element, found: dict[str, Variable], prefix: str, depth: int) -> None:
    """Add the matrix in `element` to `found`, under its own name behind `prefix`."""
    if depth > _DEEPEST:
        raise ValueError("its cells and structs are nested too deeply")
    if element.start == element.stop:
        return
    end = element.stop
    flags_at = _element(whole, element.start, end)
    flags = _numbers(whole, flags_at)
    if len(flags) != 2:
        raise ValueError("a variable has no flags")
    kind, is_complex = int(flags[0]) & 0xFF, bool(int(flags[0]) & _COMPLEX)
    if kind in _OTHERS:
        return
    dims_at = _element(whole, flags_at.behind, end)
    dims = tuple(int(n) for n in _numbers(whole, dims_at))
    name_at = _element(whole, dims_at.behind, end)
    name = prefix or _numbers(whole, name_at).tobytes().decode("latin-1")
    if len(dims) < 2 or min(dims) < 0:
        raise ValueError(f"{name!r} has dimensions {dims}")
    rest = name_at.behind
    if kind in _NUMERIC:
        found[name] = _full(whole, rest, end, dims, np.dtype(_NUMERIC[kind]), is_complex)
    elif kind == _SPARSE:
        found[name] = _sparse(whole, rest, end, dims, is_complex)
    elif kind == _CHAR:
        found[name] = _text(whole, rest, end, dims)
    elif kind == _CELL:
        _cell(whole, rest, end, math.prod(dims), found, name, depth)
    elif kind == _STRUCT:
        _struct(whole, rest, end, math.prod(dims), found, name, depth)
    else:
        raise ValueError(f"{name!r} is of class {kind}")


def _parts(whole: _Bytes, at: int, end: int, count: int, is_complex: bool) -> tuple[np.ndarray, int]:
    """`count` or more values, complex where the element is followed by imaginary parts, and the byte behind."""
    element = _element(whole, at, end)
    values, at = _numbers(whole, element), element.behind
    if is_complex:
        element = _element(whole, at, end)
        values, at = values + 1j * _numbers(whole, element), element.behind
    if len(values) < count:
        raise ValueError(f"{count} values are declared, {len(values)} are there")
    return values, at


def _full(whole: _Bytes, at: int, end: int, dims: tuple[int, ...], dtype: np.dtype, is_complex: bool) -> np.ndarray:
    count = math.prod(dims)
    values, _ = _parts(whole, at, end, count, is_complex) if count else (np.zeros(0), at)
    if len(values) != count:
        raise ValueError(f"{count} values are declared, {len(values)} are there")
    if is_complex:
        dtype = np.dtype(np.complex128)
    return values.astype(dtype, copy=False).reshape(dims, order="F")


def _sparse(whole: _Bytes, at: int, end: int, dims: tuple[int, ...], is_complex: bool) -> sparse.csc_array:
    if len(dims) != 2:
        raise ValueError(f"a sparse matrix has dimensions {dims}")
    rows_at = _element(whole, at, end)
    starts_at = _element(whole, rows_at.behind, end)
    starts = _numbers(whole, starts_at)
    values, _ = _parts(whole, starts_at.behind, end, int(starts[-1]) if len(starts) else 0, is_complex)
    values = values.astype(np.complex128 if is_complex else np.float64)
    return compressed((dims[0], dims[1]), starts, _numbers(whole, rows_at), values)


def _text(whole: _Bytes, at: int, end: int, dims: tuple[int, ...]) -> str:
    """Characters row by row, as they stand on the screen."""
    count = math.prod(dims)
    if not count:
        return ""
    element = _element(whole, at, end)
    if element.kind not in _TEXTS:
        raise ValueError(f"a text cannot be of type {element.kind}")
    endian = {"<": "-le", ">": "-be"}[whole.order] if _TEXTS[element.kind].startswith("utf-") else ""
    encoding = _TEXTS[element.kind] + (endian if element.kind != 16 else "")
    letters = whole.data[element.start : element.stop].decode(encoding)
    if len(letters) != count or dims[0] == 1:
        return letters
    return "".join(np.array(list(letters)).reshape(dims, order="F").ravel().tolist())


def _cell(whole: _Bytes, at: int, end: int, count: int, found: dict[str, Variable], name: str, depth: int) -> None:
    """Texts in a cell array as a list; a cell of other things is passed over."""
    texts: list[str] = []
    for _ in range(count):
        element = _element(whole, at, end)
        inner: dict[str, Variable] = {}
        if element.kind != _MATRIX:
            raise ValueError(f"a cell of {name!r} is none")
        _variable(whole, element, inner, "cell", depth + 1)
        texts += [value for value in inner.values() if isinstance(value, str)]
        at = element.behind
    if len(texts) == count:
        found[name] = tuple(texts)


def _struct(whole: _Bytes, at: int, end: int, count: int, found: dict[str, Variable], name: str, depth: int) -> None:
    """The fields of a struct under ``name.field``; an array of structs is passed over."""
    length_at = _element(whole, at, end)
    names_at = _element(whole, length_at.behind, end)
    (length,) = _numbers(whole, length_at).tolist()
    joined = _numbers(whole, names_at).tobytes()
    if length < 1 or len(joined) % length:
        raise ValueError(f"the fields of {name!r} have no names")
    if count != 1:
        return
    at = names_at.behind
    for k in range(0, len(joined), length):
        element = _element(whole, at, end)
        if element.kind != _MATRIX:
            raise ValueError(f"a field of {name!r} is none")
        field = joined[k : k + length].split(b"\0")[0].decode("latin-1")
        _variable(whole, element, found, f"{name}.{field}", depth + 1)
        at = element.behind


def _version_4(data: bytes) -> dict[str, Variable]:
    found: dict[str, Variable] = {}
    at = 0
    while at < len(data):
        if at + 20 > len(data):
            raise ValueError("it ends within a variable")
        (form,) = struct.unpack_from("<i", data, at)
        order = "<" if 0 <= form < 5000 else ">"
        form, n_rows, n_columns, imaginary, n_name = struct.unpack_from(f"{order}5i", data, at)
        machine, kind, content = form // 1000, form // 10 % 10, form % 10
        known = machine == (order == ">") and form // 100 % 10 == 0 and kind < len(_TYPES_4) and content < 3
        if not known or min(n_rows, n_columns) < 0 or imaginary not in (0, 1) or n_name < 1:
            raise ValueError(f"byte {at} is not where a variable begins")
        dtype = np.dtype(order + _TYPES_4[kind])
        count = n_rows * n_columns * (1 + imaginary)
        start = at + 20 + n_name
        at = start + count * dtype.itemsize
        if at > len(data):
            raise ValueError("it ends within a variable")
        name = data[start - n_name : start].split(b"\0")[0].decode("latin-1")
        values = np.frombuffer(data, dtype, count, start)
        if imaginary:
            values = values[: count // 2] + 1j * values[count // 2 :]
        found[name] = _variable_4(values.reshape((n_rows, n_columns), order="F"), content)
    return found


def _variable_4(table: np.ndarray, content: int) -> Variable:
    if content == 0:
        return table
    if content == 1:
        return "".join(chr(int(code)) for code in table.real.ravel())
    if len(table) < 1 or table.shape[1] not in (3, 4):
        raise ValueError("a sparse matrix has no table of rows, columns and values")
    entries, (n_rows, n_columns) = table[:-1], table[-1, :2].real.astype(np.float64)
    values = entries[:, 2] + 1j * entries[:, 3] if table.shape[1] == 4 else entries[:, 2]
    if not (0 <= n_rows < 2**40 and 0 <= n_columns < 2**40):
        raise ValueError(f"a sparse matrix has shape {n_rows} x {n_columns}")
    return coordinates((int(n_rows), int(n_columns)), entries[:, 0] - 1, entries[:, 1] - 1, values)

"""The strings of an OUTPUT4 matrix: runs of entries without a gap in one column; what ASCII and binary files share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.core.arrays import AnyArray, IntArray
from structid.core.errors import FileError, InputError
from structid.fem.importers.imported import ImportedMatrix, complete_triangles
from structid.files.sparse import coordinates

Layout = Literal["bigmat", "sparse", "dense"]


@dataclass(frozen=True)
class Op4Options:
    """Format of an OUTPUT4 file.

    Attributes
    ----------
    binary : bool
        Binary (default) or ASCII.
    layout : {"bigmat", "sparse", "dense"}
        Strings with 32-bit rows (any size), strings with 16-bit rows (up to 65535 rows), or whole columns from the
        first to the last entry that is not zero.
    byte_order : {"little", "big"}
        Of binary files.
    words : {32, 64}
        Bits of an integer in binary files.
    single : bool
        Single precision: seven digits.
    """

    binary: bool = True
    layout: Layout = "bigmat"
    byte_order: Literal["little", "big"] = "little"
    words: Literal[32, 64] = 32
    single: bool = False

    def __post_init__(self) -> None:
        """Check the layout, the byte order and the word size."""
        if self.layout not in ("bigmat", "sparse", "dense"):
            raise InputError(f"`layout` must be 'bigmat', 'sparse' or 'dense', got {self.layout!r}")
        if self.byte_order not in ("little", "big") or self.words not in (32, 64):
            raise InputError(
                "`byte_order` must be 'little' or 'big' and `words` 32 or 64, got "
                f"{self.byte_order!r} and {self.words!r}"
            )


@dataclass(frozen=True, eq=False)
class Strings:
    """A matrix as strings.

    Attributes
    ----------
    name : str
    shape : (int, int)
    form : int
        1 square, 2 rectangular, 6 symmetric.
    kind : int
        1 and 2 real, 3 and 4 complex; 1 and 3 single, 2 and 4 double precision.
    layout : {"bigmat", "sparse", "dense"}
    row, column, length, first : (n_strings,) int arrays
        Row and column (from 0) where each string begins, its number of entries, and where its first entry stands in
        `values`.
    values : (n_entries,) float or complex array
    """

    name: str
    shape: tuple[int, int]
    form: int
    kind: int
    layout: Layout
    row: IntArray
    column: IntArray
    length: IntArray
    first: IntArray
    values: AnyArray

    @property
    def numbers(self) -> AnyArray:
        """The values as real numbers, real and imaginary parts in turn where complex."""
        return self.values.view(np.float64) if np.iscomplexobj(self.values) else self.values


def strings_of(name: str, matrix: sparse.csc_array, form: int, layout: Layout, single: bool) -> Strings:
    """The entries of `matrix` as strings: runs without a gap in one column; a single string a column in the dense layout.

    `name` is that of the matrix, `form` the number of OUTPUT4 for its form (1, 2 or 6), `layout` that of the file. `single`
    sets the type to single precision; values are not rounded here. Sorts `matrix` and removes its zeros in place.
    """
    matrix.sort_indices()
    matrix.eliminate_zeros()
    kind = (3 if np.iscomplexobj(matrix.data) else 1) + (0 if single else 1)
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    row, values = matrix.indices.astype(np.int64), matrix.data
    if layout == "dense":
        row, column, values = _fill_columns(matrix)
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (np.diff(row) != 1) | (np.diff(column) != 0)
    if layout == "sparse":  # the length of a string has 15 bits, counted in words
        begins |= _cut(begins, 4096)
    first = np.flatnonzero(begins)
    length = np.diff(np.append(first, len(row)))
    shape = (int(matrix.shape[0]), int(matrix.shape[1]))
    return Strings(name, shape, form, kind, layout, row[first], column[first], length, first, np.array(values))


def _cut(begins: NDArray[np.bool_], longest: int) -> NDArray[np.bool_]:
    at = np.arange(len(begins))
    start = np.maximum.accumulate(np.where(begins, at, 0))
    return (at - start) % longest == 0


def _fill_columns(matrix: sparse.csc_array) -> tuple[IntArray, IntArray, AnyArray]:
    """Row, column and value, (n,) each, of every entry between the first and the last stored one of each column, zeros included."""
    used = np.flatnonzero(np.diff(matrix.indptr))
    top = matrix.indices[matrix.indptr[used]].astype(np.int64)
    count = matrix.indices[matrix.indptr[used + 1] - 1] - top + 1
    before = np.cumsum(count) - count
    column = np.repeat(used, count)
    row = np.arange(int(count.sum())) - np.repeat(before, count) + np.repeat(top, count)
    values = np.zeros(len(row), dtype=matrix.dtype)
    offset = np.zeros(matrix.shape[1], dtype=np.int64)
    offset[used] = before - top
    column_of_entry = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    values[matrix.indices + offset[column_of_entry]] = matrix.data
    return row, column, values


def entries(row: IntArray, column: IntArray, length: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Row, column and place within its string of every entry, (n_entries,) each.

    `row`, `column` and `length` (n_strings,) are first row, column and number of entries of each string.
    """
    before = np.cumsum(length) - length
    within = np.arange(int(length.sum())) - np.repeat(before, length)
    return np.repeat(row, length) + within, np.repeat(column, length), within


def assemble_strings(
    shape: tuple[int, int], row: IntArray, column: IntArray, length: IntArray, numbers: AnyArray, is_complex: bool
) -> sparse.csc_array:
    """The sparse matrix of `shape` from strings: first `row` and `column` (from 0) and `length` of each, (n_strings,).

    `numbers` are the values of all entries in order; real and imaginary parts alternate if `is_complex`.
    """
    values = np.ascontiguousarray(numbers, dtype=np.float64)
    rows, columns, _ = entries(row, column, length)
    compact = coordinates(shape, rows, columns, values.view(np.complex128) if is_complex else values)
    compact.eliminate_zeros()
    return compact


def finish_matrix(path: Path, name: str, matrix: sparse.csc_array, form: int) -> ImportedMatrix:
    """The matrix called `name`, with both triangles if its OUTPUT4 form is 6 (symmetric); `FileError` if pairs disagree."""
    try:
        return ImportedMatrix(name, complete_triangles(matrix, name, form == 6))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error

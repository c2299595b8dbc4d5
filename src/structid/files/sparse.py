"""Sparse matrices from the parts that a file holds, checked before compiled code follows their indices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

_LARGEST = 2**40
#: Rows without an entry that a matrix may have: so many, and so many for each entry.
_EMPTY_ROWS, _ROWS_AN_ENTRY = 1_000_000, 64


def checked_sparse_matrix(
    shape: tuple[int, int], starts: np.ndarray, indices: np.ndarray, values: np.ndarray
) -> sparse.csc_array:
    """Sparse matrix (compressed columns) of `shape` from the parts of a file, after checks of all of them.

    `starts` (n_columns + 1,) is where each column begins among the row `indices` (from 0) and `values`; entries
    after the last start are left out.

    Raises
    ------
    ValueError
        If starts or rows are not whole numbers, there are not n_columns + 1 starts, they do not rise from 0 to at
        most the number of entries, or a row lies outside the matrix.
    """
    starts, indices = _as_whole_numbers("column starts", starts), _as_whole_numbers("rows", indices)
    n_rows, n_columns = _checked_shape(shape)
    if len(starts) != n_columns + 1:
        raise ValueError(f"{n_columns} columns need {n_columns + 1} starts, got {len(starts)}")
    n = int(starts[-1])
    if starts[0] != 0 or (np.diff(starts) < 0).any() or n > min(len(indices), len(values)):
        raise ValueError("the starts of the columns do not rise from 0 to the number of entries")
    indices, values = indices[:n], np.array(values[:n], values.dtype.newbyteorder("="))
    _require_inside("row", indices, n_rows)
    return sparse.csc_array((values, indices, starts), (n_rows, n_columns))


def coordinates(shape: tuple[int, int], rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> sparse.csc_array:
    """Sparse matrix of `shape` from row, column (from 0) and value of each entry; repeated entries are added.

    `rows`, `columns` and `values` are (n_entries,).

    Raises
    ------
    ValueError
        If a row or column is no whole number or lies outside the matrix, lengths differ, or a side of `shape` is above
        a million and 64 for each entry.
    """
    rows, columns = _as_whole_numbers("rows", rows), _as_whole_numbers("columns", columns)
    sides = _checked_shape(shape)
    if not len(rows) == len(columns) == len(values):
        raise ValueError(f"there are {len(rows)} rows, {len(columns)} columns and {len(values)} values")
    if max(sides) > _EMPTY_ROWS + _ROWS_AN_ENTRY * len(values):
        raise ValueError(f"it declares shape {sides} for {len(values)} entries")
    _require_inside("row", rows, sides[0])
    _require_inside("column", columns, sides[1])
    native = np.asarray(values, values.dtype.newbyteorder("="))
    return sparse.coo_array((native, (rows, columns)), sides).tocsc()


def _checked_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """`shape` as two ints; `ValueError` if one is negative or above 2^40."""
    n_rows, n_columns = (int(n) for n in shape)
    if not (0 <= n_rows <= _LARGEST and 0 <= n_columns <= _LARGEST):
        raise ValueError(f"it declares shape {(n_rows, n_columns)}")
    return n_rows, n_columns


def _as_whole_numbers(name: str, numbers: np.ndarray) -> NDArray[np.int64]:
    """Copy of `numbers` as int64, flattened, (n,); `ValueError`, which calls them `name`, unless all are whole."""
    array = np.asarray(numbers).ravel()
    if array.dtype.kind not in "iu" and not (abs(array) < 2**53).all():
        raise ValueError(f"its {name} must be whole numbers")
    whole = array.astype(np.int64)
    if (whole != array).any():
        raise ValueError(f"its {name} must be whole numbers")
    return whole


def _require_inside(name: str, indices: NDArray[np.int64], count: int) -> None:
    """Raise `ValueError` unless all `indices` lie in 0 to `count` - 1; `name` says in the message what they count."""
    outside = (indices < 0) | (indices >= count)
    if outside.any():
        first = int(np.argmax(outside))
        raise ValueError(f"entry {first + 1} is in {name} {indices[first]} of {count}, counted from 0")

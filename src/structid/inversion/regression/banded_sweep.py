"""Triangles of blocks swept into one banded triangle: O(number of blocks) where the blocks form a chain.

Columns are ordered by reverse Cuthill-McKee, blocks by their first column. A block then touches only a short window
of the triangle, and everything stays orthogonal: the products B'B are never made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.linalg import lapack, solve_triangular
from scipy.sparse.csgraph import reverse_cuthill_mckee

from structid.core.arrays import FloatArray, IntArray

_KEPT_UP_TO = 100_000
_WINDOW = 48  # columns beyond the band that one step of the NumPy sweep takes at once


@dataclass(frozen=True, eq=False)
class BandLayout:
    """Where the columns of blocks go in a banded triangle.

    Attributes
    ----------
    place : (n_params,) int array
        Place of each parameter in the order of the band.
    order : (n_blocks,) int array
        Blocks by their first column; blocks without columns last.
    low, high : (n_blocks,) int arrays
        First and last place that each of them can touch, in that order.
    width : int
        Entries of a row of the band.
    """

    place: IntArray
    order: IntArray
    low: IntArray
    high: IntArray
    width: int


def band_layout(columns: IntArray, n_params: int) -> BandLayout:
    """The layout of blocks with these columns, (n_blocks, n_columns), -1 where a block has fewer; small ones are kept."""
    if columns.size > _KEPT_UP_TO:
        return _layout(columns, n_params)
    return _kept_layout(columns.astype(np.int64).tobytes(), columns.shape[1], n_params)


@lru_cache(maxsize=16)
def _kept_layout(columns: bytes, width: int, n_params: int) -> BandLayout:
    return _layout(np.frombuffer(columns, dtype=np.int64).reshape(-1, width), n_params)


def _layout(columns: IntArray, n_params: int) -> BandLayout:
    """Order of parameters and blocks with a narrow band, by reverse Cuthill-McKee on `columns` (n_blocks, k)."""
    place = np.empty(n_params, dtype=np.int64)
    place[reverse_cuthill_mckee(_neighbours(columns, n_params), symmetric_mode=True)] = np.arange(n_params)
    used = columns >= 0
    places = np.where(used, place[columns], n_params)
    low = places.min(axis=1, initial=n_params)
    high = np.where(used, places, -1).max(axis=1, initial=-1)
    order = np.argsort(low, kind="stable")
    low = low[order]
    reach = np.maximum.accumulate(high[order])
    empty = low == n_params
    reach = np.where(empty, n_params - 1, reach)  # no columns at all
    width = int((reach - low).max(initial=0)) + 1
    return BandLayout(place, order, low, reach, width)


def _neighbours(columns: IntArray, n_params: int) -> sparse.csr_array:
    """Pattern of B'B."""
    block, slot = np.nonzero(columns >= 0)
    incidence = sparse.csr_array(
        (np.ones(len(block), dtype=np.int32), (block, columns[block, slot])), (len(columns), n_params)
    )
    return sparse.csr_array(incidence.T @ incidence)


def swept(
    triangles: FloatArray, columns: IntArray, layout: BandLayout, scale: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """QR factorization with a band: triangle (n, width), right-hand side (n,), and residual sum of squares.

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
    columns : (n_blocks, k) int array
    layout : BandLayout
    scale : (n_params,) float array
        Factor on each column, in the order of the parameters; 0 leaves it out.
    """
    n_params, side = len(layout.place), triangles.shape[1]
    band, right, factor = np.zeros((n_params, layout.width)), np.zeros(n_params), np.zeros(n_params + 1)
    factor[layout.place] = scale
    places = np.where(columns >= 0, layout.place[columns], n_params)
    total = float((triangles[:, -1, -1] ** 2).sum())
    begin = 0
    while begin < len(layout.order):  # a window of columns and all blocks that begin in it at a time
        low = int(layout.low[begin])
        stop = max(begin + 1, int(np.searchsorted(layout.low, low + _WINDOW)))
        n = int(layout.high[begin:stop].max()) - low + 1
        blocks = layout.order[begin:stop]
        begin = stop
        if n <= 0:
            total += float((triangles[blocks, :-1, -1] ** 2).sum())
            continue
        tall = np.zeros((len(blocks), side - 1, n + 2))  # one column more for what is in no place
        at = np.where(places[blocks] < n_params, places[blocks] - low, n + 1)
        rows = triangles[blocks, :-1, :-1] * factor[places[blocks]][:, None, :]
        tall[np.arange(len(blocks))[:, None, None], np.arange(side - 1)[:, None], at[:, None, :]] = rows
        tall[..., n] = triangles[blocks, :-1, -1]
        window = np.column_stack([_dense(band[low : low + n])[:, :n], right[low : low + n]])
        found = np.asarray(np.linalg.qr(np.concatenate([window, tall.reshape(-1, n + 2)[:, : n + 1]]), mode="r"))
        band[low : low + n] = _diagonals(np.pad(found[:n, :n], ((0, 0), (0, layout.width - 1))), layout.width)
        right[low : low + n] = found[:n, n]
        total += float(found[n, n] ** 2)
    return band, right, total


def _diagonals(dense: FloatArray, width: int) -> FloatArray:
    """View of (n, n + width - 1) as a band: of row i the columns i to i + width."""
    along, across = dense.strides
    return np.lib.stride_tricks.as_strided(dense, (len(dense), width), (along + across, across))


def _dense(band: FloatArray) -> FloatArray:
    """Dense rows (n, n + width - 1) of a matrix stored as a band (n, width)."""
    n, width = band.shape
    dense = np.zeros((n, n + width - 1))
    _diagonals(dense, width)[:] = band
    return dense


def solved(band: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """R^-1 b, or R'^-1 b, for a banded triangle with no zero on its diagonal and (n,) or (n, k) right-hand sides."""
    stored = np.zeros((band.shape[1], len(band)))  # LAPACK's upper band: row width - 1 - j holds superdiagonal j
    for j in range(band.shape[1]):
        stored[band.shape[1] - 1 - j, j:] = band[: len(band) - j, j]
    wide = right[:, None] if right.ndim == 1 else right
    found, _ = lapack.dtbtrs(stored, wide, uplo="U", trans="T" if transposed else "N")
    return np.asarray(found[:, 0] if right.ndim == 1 else found)


def inverse_diagonal(band: FloatArray) -> FloatArray:
    """Diagonal (n,) of (R'R)^-1 for a banded triangle `band` (n, width), by Takahashi's method."""
    n, width = band.shape
    size = max(width, _WINDOW)
    out, corner = np.empty(n), np.zeros((size, size))  # of the inverse: what follows the rows at hand
    for first in range((n - 1) // size * size, -1, -size):
        rows = _dense(band[first : first + size])
        k = len(rows)
        beside = np.zeros((k, size))
        beside[:, : width - 1] = rows[:, k:]
        over = solve_triangular(rows[:, :k], np.column_stack([np.eye(k), beside]), check_finite=False)
        inverse = over[:, :k] @ over[:, :k].T + over[:, k:] @ corner @ over[:, k:].T
        out[first : first + k] = np.diag(inverse)
        corner = np.zeros((size, size))
        corner[:k, :k] = inverse
    return out

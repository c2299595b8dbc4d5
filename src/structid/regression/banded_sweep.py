"""Triangles of blocks swept into one banded triangle: O(number of blocks) where the blocks form a chain.

Columns are ordered by reverse Cuthill-McKee, blocks by their first column. A block then touches only a short window
of the triangle, and everything stays orthogonal: the products B'B are never made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse.csgraph import reverse_cuthill_mckee

from structid.arrays import FloatArray, IntArray
from structid.regression.local_reduction import banded_kernels, block_widths

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
    triangles: FloatArray, columns: IntArray, layout: BandLayout, scale: FloatArray, compiled: bool
) -> tuple[FloatArray, FloatArray, float]:
    """Banded triangle (row i: columns i, i + 1, ...), right-hand side and sum of squared residuals.

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
    columns : (n_blocks, k) int array
    layout : BandLayout
    scale : (n_params,) float array
        Factor on each column, in the order of the parameters; 0 leaves it out.
    compiled : bool
    """
    n_params = len(layout.place)
    band, right = np.zeros((n_params, layout.width)), np.zeros(n_params)
    factor = np.empty(n_params)
    factor[layout.place] = scale
    places = np.where(columns >= 0, layout.place[columns], -1)
    if compiled:
        widths = block_widths(columns)
        low, high = layout.low, layout.high
        rest = banded_kernels().band_of_blocks(triangles, places, factor, layout.order, low, high, widths, band, right)
        return band, right, float(rest)
    return band, right, _swept_by_numpy(triangles, places, factor, layout, band, right)


def _swept_by_numpy(
    triangles: FloatArray, places: IntArray, factor: FloatArray, layout: BandLayout, band: FloatArray, right: FloatArray
) -> float:
    """The same sweep by LAPACK, a window of columns and all blocks that begin in it at a time; the residual sum."""
    total, side = float((triangles[:, -1, -1] ** 2).sum()), triangles.shape[1]
    begin = 0
    while begin < len(layout.order):
        stop = begin + int(np.searchsorted(layout.low[begin:], layout.low[begin] + _WINDOW))
        stop = max(stop, begin + 1)
        low, high = int(layout.low[begin]), int(layout.high[begin:stop].max())
        n = high - low + 1
        blocks = layout.order[begin:stop]
        begin = stop
        if n <= 0:
            total += float((triangles[blocks, :-1, -1] ** 2).sum())
            continue
        tall = np.zeros((len(blocks), side - 1, n + 2))
        at = np.where(places[blocks] >= 0, places[blocks] - low, n + 1)
        rows = triangles[blocks, :-1, :-1] * np.where(places[blocks] >= 0, factor[places[blocks]], 0.0)[:, None, :]
        tall[np.arange(len(blocks))[:, None, None], np.arange(side - 1)[:, None], at[:, None, :]] = rows
        tall[..., n] = triangles[blocks, :-1, -1]
        folded = np.asarray(
            np.linalg.qr(np.concatenate([_window(band, right, low, n), tall.reshape(-1, n + 2)[:, : n + 1]]), mode="r")
        )
        _put(band, right, low, n, folded)
        total += float(folded[n, n] ** 2) if len(folded) > n else 0.0
    return total


def _window(band: FloatArray, right: FloatArray, low: int, n: int) -> FloatArray:
    """Rows `low` to `low + n` of [band, right] as a dense triangle, (n, n + 1)."""
    dense = np.zeros((n, n + 1))
    for offset in range(min(n, band.shape[1])):
        np.fill_diagonal(dense[:, offset:n], band[low : low + n - offset, offset])
    dense[:, n] = right[low : low + n]
    return dense


def _put(band: FloatArray, right: FloatArray, low: int, n: int, folded: FloatArray) -> None:
    for offset in range(min(n, band.shape[1])):
        band[low : low + n - offset, offset] = np.diagonal(folded[:n, :n], offset)
    right[low : low + n] = folded[:n, n]


def solved(band: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """R^-1 b, or R'^-1 b, for a banded triangle with no zero on its diagonal and (n,) or (n, k) right-hand sides."""
    stored = np.zeros((band.shape[1], len(band)))  # LAPACK's upper band: row width - 1 - j holds superdiagonal j
    for j in range(band.shape[1]):
        stored[band.shape[1] - 1 - j, j:] = band[: len(band) - j, j]
    wide = right[:, None] if right.ndim == 1 else right
    found, _ = lapack.dtbtrs(stored, wide, uplo="U", trans="T" if transposed else "N")
    return np.asarray(found[:, 0] if right.ndim == 1 else found)


def inverse_diagonal(band: FloatArray, compiled: bool) -> FloatArray:
    """Diagonal of (R'R)^-1, from the entries of the inverse within the band (Takahashi, Fagan and Chin 1973)."""
    if compiled:
        return np.asarray(banded_kernels().inverse_diagonal(np.ascontiguousarray(band)))
    n, width = band.shape
    inverse, out = np.zeros((width, width)), np.empty(n)  # the corner of the inverse below and right of row i
    for i in range(n - 1, -1, -1):
        reach = min(width, n - i)
        row = band[i, 1:reach] / band[i, 0]
        corner = inverse[: reach - 1, : reach - 1]
        beside = -(corner @ row)
        out[i] = 1.0 / band[i, 0] ** 2 - row @ beside
        inverse = np.zeros((width, width))
        inverse[1:reach, 1:reach] = corner
        inverse[0, 0], inverse[0, 1:reach], inverse[1:reach, 0] = out[i], beside, beside
    return out

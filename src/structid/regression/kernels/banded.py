"""Compiled kernels of the banded sweep and of many small problems; imported only where numba is wanted."""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

from structid.regression.kernels.householder import APART, MATHS, reflect, reflector
from structid.regression.kernels.vector import fill_one

#: Digest of the files compiled into these functions: numba recompiles them only when their own file changes.
PARTS = "babfcf99aa66bc24"
_part = njit(nogil=True, fastmath=MATHS, error_model="numpy")
_compiled = njit(cache=True, nogil=True, fastmath=MATHS, error_model="numpy")


@_part
def _swept(band, right, v, rows, low, high):
    """QR of the band's rows `low` to `high` over the dense rows v (columns - low, row); the residual's square sum.

    The right-hand side is the last line of `v`.
    """
    width = high - low + 1
    for i in range(width):
        at = low + i
        square = 0.0
        for r in range(rows):
            square += v[i, r] * v[i, r]
        if square == 0.0:
            continue
        band[at, 0], head, factor = reflector(band[at, 0], square)
        for j in range(i + 1, width):
            d = head * band[at, j - i]
            for r in range(rows):
                d += v[i, r] * v[j, r]
            w = factor * d
            band[at, j - i] -= w * head
            for r in range(rows):
                v[j, r] -= w * v[i, r]
        d = head * right[at]
        for r in range(rows):
            d += v[i, r] * v[width, r]
        w = factor * d
        right[at] -= w * head
        for r in range(rows):
            v[width, r] -= w * v[i, r]
    total = 0.0
    for r in range(rows):
        total += v[width, r] * v[width, r]
    return total


@_compiled
def band_of_blocks(triangles, places, scale, order, low, high, widths, band, right):
    """Sweep blocks in `order` into the triangle `band` (row i: columns i, i + 1, ...) and `right`; the residual sum.

    `places` is the column of each slot in the order of the band, `scale` its factor, `low` and `high` the first and
    the last column that block can touch.
    """
    side = triangles.shape[1]
    v = np.zeros((band.shape[1] + 1, side))
    total = 0.0
    for step in range(order.shape[0]):
        d = order[step]
        q = widths[d]
        first, last = low[step], high[step]
        width = last - first + 1
        for i in range(width + 1):
            for r in range(q):
                v[i, r] = 0.0
        for k in range(q):
            at, factor = places[d, k] - first, scale[places[d, k]]
            for r in range(k + 1):
                v[at, r] = triangles[d, r, k] * factor
        for r in range(q):
            v[width, r] = triangles[d, r, side - 1]
        total += _swept(band, right, v, q, first, last)
        total += triangles[d, side - 1, side - 1] ** 2
    return total


@_compiled
def many_solved(
    fields, starts, which, data, widths, side, places, order, low, high, n_band, values, inner, first, last
):
    """Fold and solve problems `first` to `last` of one layout; `values` (n, n_params) in the order of the band.

    NaN where a column is zero or depends on those before it.
    """
    n_times, n_params = fields.shape[2], values.shape[1]
    flat, size = fields.reshape(-1), fields.shape[1] * n_times
    pace, width, none = uint64(n_times), uint64(inner + APART), uint64(0)
    b = np.empty(side * (inner + APART))
    triangles = np.empty((widths.shape[0], side, side))
    norm, right = np.empty(n_params), np.empty(n_params)
    band = np.empty((n_params, n_band))
    for p in range(first, last):
        triangles[:] = 0.0
        norm[:] = 0.0
        for d in range(widths.shape[0]):
            q = widths[d]
            for at in range(0, n_times, inner):
                count = uint64(min(inner, n_times - at))
                for k in range(q + 1):
                    row = d * side + (k if k < q else side - 1)
                    i, end = uint64(starts[row]), uint64(starts[row + 1])
                    fill_one(
                        b, uint64(k) * width, width, count, flat, uint64(p * size + at), pace, which, data, i, i, i,
                        end - i, which, none, none,
                    )  # fmt: skip
                reflect(triangles[d], b, q, width, count)
            for k in range(q):
                for r in range(k + 1):
                    norm[places[d, k]] += triangles[d, r, k] ** 2
        for i in range(n_params):
            norm[i] = 1.0 / np.sqrt(norm[i]) if norm[i] > 0 else 0.0
        band[:] = 0.0
        right[:] = 0.0
        band_of_blocks(triangles, places, norm, order, low, high, widths, band, right)
        for i in range(n_params - 1, -1, -1):
            value = right[i]
            for j in range(1, min(n_band, n_params - i)):
                value -= band[i, j] * values[p, i + j]
            values[p, i] = value / band[i, 0] if abs(band[i, 0]) > 1e-10 else np.nan
        for i in range(n_params):
            values[p, i] *= norm[i]


@_compiled
def inverse_diagonal(band):
    """Diagonal of (R'R)^-1 of a banded triangle, by the entries of the inverse within the band (Takahashi 1973)."""
    n, width = band.shape
    inverse = np.zeros((n, width))
    for i in range(n - 1, -1, -1):
        reach = min(width, n - i)
        for j in range(reach - 1, 0, -1):
            total = 0.0
            for k in range(1, reach):
                a, c = min(j, k), max(j, k)
                total += band[i, k] * inverse[i + a, c - a]
            inverse[i, j] = -total / band[i, 0]
        total = 1.0 / band[i, 0]
        for k in range(1, reach):
            total -= band[i, k] * inverse[i, k]
        inverse[i, 0] = total / band[i, 0]
    return inverse[:, 0].copy()

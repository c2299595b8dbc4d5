"""Compiled kernels of the local reduction and of the banded sweep; imported only where numba is wanted.

Rows of regressors are made and folded in the same breath: for one block of equations and one stretch of samples the
regressors (a few times a few hundred numbers) live in the first-level cache and never reach memory. Two Householder
reflections are applied at a time, so that each number is loaded half as often. Sums may be reordered for vector units
(`reassoc`), nothing else of IEEE arithmetic is given up: NaN and infinity arrive.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

_APART = 24
_MATHS = {"reassoc", "contract", "nsz"}
_inline = njit(nogil=True, fastmath=_MATHS, inline="always")
_compiled = njit(cache=True, nogil=True, fastmath=_MATHS)


@_inline
def _filled(b, at, count, fields, first, pace, which, data, i, end):
    """b[at:at + count] = the sum of data[k] fields[which[k] pace + first ...] for k from `i` to `end`, by eights."""
    one, two, three, four = uint64(1), uint64(2), uint64(3), uint64(4)
    if end - i >= four:
        a0, a1 = uint64(which[i]) * pace + first, uint64(which[i + one]) * pace + first
        a2, a3 = uint64(which[i + two]) * pace + first, uint64(which[i + three]) * pace + first
        v0, v1, v2, v3 = data[i], data[i + one], data[i + two], data[i + three]
        for t in range(count):
            b[at + t] = v0 * fields[a0 + t] + v1 * fields[a1 + t] + v2 * fields[a2 + t] + v3 * fields[a3 + t]
        i += four
    else:
        for t in range(count):
            b[at + t] = 0.0
    while end - i >= four + four:
        j = i + four
        a0, a1 = uint64(which[i]) * pace + first, uint64(which[i + one]) * pace + first
        a2, a3 = uint64(which[i + two]) * pace + first, uint64(which[i + three]) * pace + first
        a4, a5 = uint64(which[j]) * pace + first, uint64(which[j + one]) * pace + first
        a6, a7 = uint64(which[j + two]) * pace + first, uint64(which[j + three]) * pace + first
        v0, v1, v2, v3 = data[i], data[i + one], data[i + two], data[i + three]
        v4, v5, v6, v7 = data[j], data[j + one], data[j + two], data[j + three]
        for t in range(count):
            low = v0 * fields[a0 + t] + v1 * fields[a1 + t] + v2 * fields[a2 + t] + v3 * fields[a3 + t]
            high = v4 * fields[a4 + t] + v5 * fields[a5 + t] + v6 * fields[a6 + t] + v7 * fields[a7 + t]
            b[at + t] += low + high
        i = j + four
    while end - i >= four:
        a0, a1 = uint64(which[i]) * pace + first, uint64(which[i + one]) * pace + first
        a2, a3 = uint64(which[i + two]) * pace + first, uint64(which[i + three]) * pace + first
        v0, v1, v2, v3 = data[i], data[i + one], data[i + two], data[i + three]
        for t in range(count):
            b[at + t] += v0 * fields[a0 + t] + v1 * fields[a1 + t] + v2 * fields[a2 + t] + v3 * fields[a3 + t]
        i += four
    while i < end:
        a0, v0 = uint64(which[i]) * pace + first, data[i]
        for t in range(count):
            b[at + t] += v0 * fields[a0 + t]
        i += one


@_inline
def _reflector(diagonal, square):
    """New diagonal, first entry of the reflector and 2 over its square, for [diagonal; column] of this square sum."""
    if square == 0.0:
        return diagonal, 0.0, 0.0
    size = np.sqrt(diagonal * diagonal + square)
    head = diagonal + size if diagonal >= 0 else diagonal - size
    return (-size if diagonal >= 0 else size), head, 1.0 / (size * (size + abs(diagonal)))


@_inline
def _triple_on_four(r, k, j, m, b, o, x, width, count, u, f, g):
    """Reflections k to k + 2 on columns j, j + 1, j + 2 and m of [r; b]; their rows of `b` start at `o` and `x`."""
    o2, o3, x2 = o + width, o + width + width, x + width
    x3, x4 = x2 + width, x2 + width + width
    a1 = a2 = a3 = b1 = b2 = b3 = c1 = c2 = c3 = d1 = d2 = d3 = 0.0
    for t in range(count):
        p1, p2, p3 = b[o + t], b[o2 + t], b[o3 + t]
        a, c = b[x + t], b[x2 + t]
        a1 += p1 * a
        a2 += p2 * a
        a3 += p3 * a
        b1 += p1 * c
        b2 += p2 * c
        b3 += p3 * c
        a, c = b[x3 + t], b[x4 + t]
        c1 += p1 * a
        c2 += p2 * a
        c3 += p3 * a
        d1 += p1 * c
        d2 += p2 * c
        d3 += p3 * c
    a1, a2, a3 = _weights(r, k, j, a1, a2, a3, u, f, g)
    b1, b2, b3 = _weights(r, k, j + 1, b1, b2, b3, u, f, g)
    c1, c2, c3 = _weights(r, k, j + 2, c1, c2, c3, u, f, g)
    d1, d2, d3 = _weights(r, k, m, d1, d2, d3, u, f, g)
    for t in range(count):
        p1, p2, p3 = b[o + t], b[o2 + t], b[o3 + t]
        b[x + t] -= a1 * p1 + a2 * p2 + a3 * p3
        b[x2 + t] -= b1 * p1 + b2 * p2 + b3 * p3
        b[x3 + t] -= c1 * p1 + c2 * p2 + c3 * p3
        b[x4 + t] -= d1 * p1 + d2 * p2 + d3 * p3


@_inline
def _weights(r, k, j, d1, d2, d3, u, f, g):
    """What three reflections take of column j, from its products with them; their rows of `r` are updated."""
    w1 = f[0] * (u[0] * r[k, j] + d1)
    w2 = f[1] * (u[1] * r[k + 1, j] + d2 - w1 * g[0])
    w3 = f[2] * (u[2] * r[k + 2, j] + d3 - w1 * g[1] - w2 * g[2])
    r[k, j] -= w1 * u[0]
    r[k + 1, j] -= w2 * u[1]
    r[k + 2, j] -= w3 * u[2]
    return w1, w2, w3


@_inline
def _triple_on_one(r, k, j, b, o, x, width, count, u, f, g):
    o2, o3 = o + width, o + width + width
    d1 = d2 = d3 = 0.0
    for t in range(count):
        a = b[x + t]
        d1 += b[o + t] * a
        d2 += b[o2 + t] * a
        d3 += b[o3 + t] * a
    d1, d2, d3 = _weights(r, k, j, d1, d2, d3, u, f, g)
    for t in range(count):
        b[x + t] -= d1 * b[o + t] + d2 * b[o2 + t] + d3 * b[o3 + t]


@_inline
def _panel(r, k, b, o, width, count):
    """Reflections that clear columns k to k + 2: their heads, factors and products with one another."""
    o2, o3 = o + width, o + width + width
    square = d1 = d2 = 0.0
    for t in range(count):
        p = b[o + t]
        square += p * p
        d1 += p * b[o2 + t]
        d2 += p * b[o3 + t]
    r[k, k], u1, f1 = _reflector(r[k, k], square)
    w1 = f1 * (u1 * r[k, k + 1] + d1)
    w2 = f1 * (u1 * r[k, k + 2] + d2)
    r[k, k + 1] -= w1 * u1
    r[k, k + 2] -= w2 * u1
    square = g12 = d3 = 0.0
    for t in range(count):
        p = b[o + t]
        y = b[o2 + t] - w1 * p
        z = b[o3 + t] - w2 * p
        b[o2 + t] = y
        b[o3 + t] = z
        square += y * y
        g12 += y * p
        d3 += y * z
    r[k + 1, k + 1], u2, f2 = _reflector(r[k + 1, k + 1], square)
    w3 = f2 * (u2 * r[k + 1, k + 2] + d3)
    r[k + 1, k + 2] -= w3 * u2
    square = g13 = g23 = 0.0
    for t in range(count):
        y = b[o2 + t]
        z = b[o3 + t] - w3 * y
        b[o3 + t] = z
        square += z * z
        g13 += z * b[o + t]
        g23 += z * y
    r[k + 2, k + 2], u3, f3 = _reflector(r[k + 2, k + 2], square)
    return (u1, u2, u3), (f1, f2, f3), (g12, g13, g23)


@_inline
def _single(r, k, b, q, width, count):
    """One reflection, of column k, on all columns after it."""
    last = r.shape[0] - 1
    o = uint64(k) * width
    square = 0.0
    for t in range(count):
        square += b[o + t] * b[o + t]
    r[k, k], u, f = _reflector(r[k, k], square)
    for j in range(k + 1, q + 1):
        x, m = uint64(j) * width, (j if j < q else last)
        d = 0.0
        for t in range(count):
            d += b[o + t] * b[x + t]
        w = f * (u * r[k, m] + d)
        r[k, m] -= w * u
        for t in range(count):
            b[x + t] -= w * b[o + t]


@_inline
def _folded(r, b, q, width, count):
    """QR of [r; b'] into r; `b` holds q columns and the right-hand side, each `count` long and `width` apart."""
    last = r.shape[0] - 1
    k = 0
    while k + 2 < q:
        o = uint64(k) * width
        u, f, g = _panel(r, k, b, o, width, count)
        j = k + 3
        while j + 3 <= q:
            m = j + 3 if j + 3 < q else last
            _triple_on_four(r, k, j, m, b, o, uint64(j) * width, width, count, u, f, g)
            j += 4
        while j <= q:
            m = j if j < q else last
            _triple_on_one(r, k, m, b, o, uint64(j) * width, width, count, u, f, g)
            j += 1
        k += 3
    while k < q:
        _single(r, k, b, q, width, count)
        k += 1
    o = uint64(q) * width
    square = 0.0
    for t in range(count):
        square += b[o + t] * b[o + t]
    r[last, last] = np.sqrt(r[last, last] * r[last, last] + square)


@_inline
def _touched(fields, begin, stop):
    """Bring a stretch of fields into the cache, one number a cache line, and return their sum so that it is done."""
    total = 0.0
    at, end = uint64(begin), uint64(stop)
    while at < end:
        total += fields[at]
        at += uint64(8)
    return total


@_compiled
def fold_fields(triangles, fields, n_times, indptr, which, data, widths, new, news, first, last, outer, inner):
    """Fold the rows of blocks `first` to `last` over all samples into `triangles`, in place.

    `fields` is flat, `which` the field of each entry of the operator. Samples go by
    stretches of `outer`, so that the fields of neighbouring blocks stay in the second-level cache, and within them by
    `inner`, so that the rows stay in the first. Block d is the first to use the fields new[news[d]:news[d + 1]].
    """
    side = triangles.shape[1]
    width = uint64(inner + _APART)  # so that rows do not fall into the same sets of the cache
    b = np.empty(side * (inner + _APART))
    pace = uint64(n_times)
    total = 0.0
    for begin in range(0, n_times, outer):
        stop = min(begin + outer, n_times)
        for d in range(first, last):
            q = widths[d]
            r = triangles[d]
            for i in range(news[d], news[d + 1]):
                total += _touched(fields, uint64(new[i]) * pace + uint64(begin), uint64(new[i]) * pace + uint64(stop))
            at = begin
            while at < stop:
                count = uint64(min(inner, stop - at))
                for k in range(q + 1):
                    row = d * side + (k if k < q else side - 1)
                    i, end = uint64(indptr[row]), uint64(indptr[row + 1])
                    _filled(b, uint64(k) * width, count, fields, uint64(at), pace, which, data, i, end)
                _folded(r, b, q, width, count)
                at += inner
    return total


@_inline
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
        band[at, 0], head, factor = _reflector(band[at, 0], square)
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
    pace, width = uint64(n_times), uint64(inner + _APART)
    b = np.empty(side * (inner + _APART))
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
                    _filled(b, uint64(k) * width, count, flat, uint64(p * size + at), pace, which, data, i, end)
                _folded(triangles[d], b, q, width, count)
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

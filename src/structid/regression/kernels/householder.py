"""Rows folded into the triangle of their block by Householder reflections, three at a time.

Each number is then loaded a third as often, and the rows stay in the first-level cache. Sums may be reordered for
vector units (`reassoc`), nothing else of IEEE arithmetic is given up: NaN and infinity arrive.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

#: Numbers between two rows, so that they do not fall into the same sets of the cache.
APART = 24
MATHS = {"reassoc", "contract", "nsz"}
_compiled = njit(nogil=True, fastmath=MATHS, error_model="numpy")


@_compiled
def reflector(diagonal, square):
    """New diagonal, first entry of the reflector and 2 over its square, for [diagonal; column] of this square sum."""
    if square == 0.0:
        return diagonal, 0.0, 0.0
    size = np.sqrt(diagonal * diagonal + square)
    head = diagonal + size if diagonal >= 0 else diagonal - size
    return (-size if diagonal >= 0 else size), head, 1.0 / (size * (size + abs(diagonal)))


@_compiled
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


@_compiled
def _weights(r, k, j, d1, d2, d3, u, f, g):
    """What three reflections take of column j, from its products with them; their rows of `r` are updated."""
    w1 = f[0] * (u[0] * r[k, j] + d1)
    w2 = f[1] * (u[1] * r[k + 1, j] + d2 - w1 * g[0])
    w3 = f[2] * (u[2] * r[k + 2, j] + d3 - w1 * g[1] - w2 * g[2])
    r[k, j] -= w1 * u[0]
    r[k + 1, j] -= w2 * u[1]
    r[k + 2, j] -= w3 * u[2]
    return w1, w2, w3


@_compiled
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


@_compiled
def _panel(r, k, b, o, width, count):
    """Reflections that clear columns k to k + 2: their heads, factors and products with one another."""
    o2, o3 = o + width, o + width + width
    square = d1 = d2 = 0.0
    for t in range(count):
        p = b[o + t]
        square += p * p
        d1 += p * b[o2 + t]
        d2 += p * b[o3 + t]
    r[k, k], u1, f1 = reflector(r[k, k], square)
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
    r[k + 1, k + 1], u2, f2 = reflector(r[k + 1, k + 1], square)
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
    r[k + 2, k + 2], u3, f3 = reflector(r[k + 2, k + 2], square)
    return (u1, u2, u3), (f1, f2, f3), (g12, g13, g23)


@_compiled
def _last_panel(r, k, b, o, width, count):
    """The last three reflections, and what they leave of the right-hand side, which follows: its sum of squares."""
    last = r.shape[0] - 1
    o2, o3 = o + width, o + width + width
    o4 = o3 + width
    square = d1 = d2 = d3 = 0.0
    for t in range(count):
        p = b[o + t]
        square += p * p
        d1 += p * b[o2 + t]
        d2 += p * b[o3 + t]
        d3 += p * b[o4 + t]
    r[k, k], u, f = reflector(r[k, k], square)
    w1, w2, w3 = f * (u * r[k, k + 1] + d1), f * (u * r[k, k + 2] + d2), f * (u * r[k, last] + d3)
    r[k, k + 1] -= w1 * u
    r[k, k + 2] -= w2 * u
    r[k, last] -= w3 * u
    square = d1 = d2 = 0.0
    for t in range(count):
        p = b[o + t]
        y = b[o2 + t] - w1 * p
        z = b[o3 + t] - w2 * p
        c = b[o4 + t] - w3 * p
        b[o2 + t] = y
        b[o3 + t] = z
        b[o4 + t] = c
        square += y * y
        d1 += y * z
        d2 += y * c
    r[k + 1, k + 1], u, f = reflector(r[k + 1, k + 1], square)
    w1, w2 = f * (u * r[k + 1, k + 2] + d1), f * (u * r[k + 1, last] + d2)
    r[k + 1, k + 2] -= w1 * u
    r[k + 1, last] -= w2 * u
    square = d1 = 0.0
    for t in range(count):
        y = b[o2 + t]
        z = b[o3 + t] - w1 * y
        c = b[o4 + t] - w2 * y
        b[o3 + t] = z
        b[o4 + t] = c
        square += z * z
        d1 += z * c
    r[k + 2, k + 2], u, f = reflector(r[k + 2, k + 2], square)
    w1 = f * (u * r[k + 2, last] + d1)
    r[k + 2, last] -= w1 * u
    square = 0.0
    for t in range(count):
        c = b[o4 + t] - w1 * b[o3 + t]
        square += c * c
    return square


@_compiled
def _single(r, k, b, q, width, count):
    """One reflection, of column k, on all columns after it."""
    last = r.shape[0] - 1
    o = uint64(k) * width
    square = 0.0
    for t in range(count):
        square += b[o + t] * b[o + t]
    r[k, k], u, f = reflector(r[k, k], square)
    for j in range(k + 1, q + 1):
        x, m = uint64(j) * width, (j if j < q else last)
        d = 0.0
        for t in range(count):
            d += b[o + t] * b[x + t]
        w = f * (u * r[k, m] + d)
        r[k, m] -= w * u
        for t in range(count):
            b[x + t] -= w * b[o + t]


@_compiled
def reflect(r, b, q, width, count):
    """QR of [r; b'] into r; `b` holds q columns and the right-hand side, each `count` long and `width` apart."""
    last = r.shape[0] - 1
    k = 0
    while k + 3 < q:
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
    if k + 3 == q:
        square = _last_panel(r, k, b, uint64(k) * width, width, count)
    else:
        while k < q:
            _single(r, k, b, q, width, count)
            k += 1
        o = uint64(q) * width
        square = 0.0
        for t in range(count):
            square += b[o + t] * b[o + t]
    r[last, last] = np.sqrt(r[last, last] * r[last, last] + square)

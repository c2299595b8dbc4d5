"""Products of the rows of a block, and the triangle that they hold where they hold it as well as a QR does.

Products cost half the reflections, and no sum waits for another, but they square the condition. Two things keep the
digits. The right-hand side goes in less what the parameters found so far make of it, so that the residual is summed
itself and not found as a difference. And the triangle counts only if the inverse of its matrix with unit columns stays
below `MOST`: a relative error of `MOST` roundings, 1e-13, in the weakest direction. All others go by reflections.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

#: Largest sum of squares of the inverse of a triangle with unit columns that comes from products.
MOST = 512.0
_compiled = njit(nogil=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")


@_compiled
def own_of_four(b, o, width, count, g, k):
    o1, o2, o3 = o + width, o + width + width, o + width + width + width
    a00 = a01 = a02 = a03 = a11 = a12 = a13 = a22 = a23 = a33 = 0.0
    for t in range(count):
        y0, y1, y2, y3 = b[o + t], b[o1 + t], b[o2 + t], b[o3 + t]
        a00 += y0 * y0
        a01 += y0 * y1
        a02 += y0 * y2
        a03 += y0 * y3
        a11 += y1 * y1
        a12 += y1 * y2
        a13 += y1 * y3
        a22 += y2 * y2
        a23 += y2 * y3
        a33 += y3 * y3
    g[k, k] += a00
    g[k, k + 1] += a01
    g[k, k + 2] += a02
    g[k, k + 3] += a03
    g[k + 1, k + 1] += a11
    g[k + 1, k + 2] += a12
    g[k + 1, k + 3] += a13
    g[k + 2, k + 2] += a22
    g[k + 2, k + 3] += a23
    g[k + 3, k + 3] += a33


@_compiled
def own_of_three(b, o, width, count, g, k):
    o1, o2 = o + width, o + width + width
    a00 = a01 = a02 = a11 = a12 = a22 = 0.0
    for t in range(count):
        y0, y1, y2 = b[o + t], b[o1 + t], b[o2 + t]
        a00 += y0 * y0
        a01 += y0 * y1
        a02 += y0 * y2
        a11 += y1 * y1
        a12 += y1 * y2
        a22 += y2 * y2
    g[k, k] += a00
    g[k, k + 1] += a01
    g[k, k + 2] += a02
    g[k + 1, k + 1] += a11
    g[k + 1, k + 2] += a12
    g[k + 2, k + 2] += a22


@_compiled
def four_with_three(b, o, x, width, count, g, k, j):
    """Products of rows k to k + 3, which start at `o`, with rows j to j + 2, at `x`."""
    o1, o2, o3 = o + width, o + width + width, o + width + width + width
    x1, x2 = x + width, x + width + width
    a00 = a01 = a02 = a10 = a11 = a12 = a20 = a21 = a22 = a30 = a31 = a32 = 0.0
    for t in range(count):
        y0, y1, y2, y3 = b[o + t], b[o1 + t], b[o2 + t], b[o3 + t]
        z0, z1, z2 = b[x + t], b[x1 + t], b[x2 + t]
        a00 += y0 * z0
        a01 += y0 * z1
        a02 += y0 * z2
        a10 += y1 * z0
        a11 += y1 * z1
        a12 += y1 * z2
        a20 += y2 * z0
        a21 += y2 * z1
        a22 += y2 * z2
        a30 += y3 * z0
        a31 += y3 * z1
        a32 += y3 * z2
    g[k, j] += a00
    g[k, j + 1] += a01
    g[k, j + 2] += a02
    g[k + 1, j] += a10
    g[k + 1, j + 1] += a11
    g[k + 1, j + 2] += a12
    g[k + 2, j] += a20
    g[k + 2, j + 1] += a21
    g[k + 2, j + 2] += a22
    g[k + 3, j] += a30
    g[k + 3, j + 1] += a31
    g[k + 3, j + 2] += a32


@_compiled
def four_with_four(b, o, x, width, count, g, k, j):
    o1, o2, o3 = o + width, o + width + width, o + width + width + width
    x1, x2, x3 = x + width, x + width + width, x + width + width + width
    a00 = a01 = a02 = a03 = a10 = a11 = a12 = a13 = a20 = a21 = a22 = a23 = a30 = a31 = a32 = a33 = 0.0
    for t in range(count):
        y0, y1, y2, y3 = b[o + t], b[o1 + t], b[o2 + t], b[o3 + t]
        z0, z1, z2, z3 = b[x + t], b[x1 + t], b[x2 + t], b[x3 + t]
        a00 += y0 * z0
        a01 += y0 * z1
        a02 += y0 * z2
        a03 += y0 * z3
        a10 += y1 * z0
        a11 += y1 * z1
        a12 += y1 * z2
        a13 += y1 * z3
        a20 += y2 * z0
        a21 += y2 * z1
        a22 += y2 * z2
        a23 += y2 * z3
        a30 += y3 * z0
        a31 += y3 * z1
        a32 += y3 * z2
        a33 += y3 * z3
    g[k, j] += a00
    g[k, j + 1] += a01
    g[k, j + 2] += a02
    g[k, j + 3] += a03
    g[k + 1, j] += a10
    g[k + 1, j + 1] += a11
    g[k + 1, j + 2] += a12
    g[k + 1, j + 3] += a13
    g[k + 2, j] += a20
    g[k + 2, j + 1] += a21
    g[k + 2, j + 2] += a22
    g[k + 2, j + 3] += a23
    g[k + 3, j] += a30
    g[k + 3, j + 1] += a31
    g[k + 3, j + 2] += a32
    g[k + 3, j + 3] += a33


@_compiled
def three_with_three(b, o, x, width, count, g, k, j):
    o1, o2 = o + width, o + width + width
    x1, x2 = x + width, x + width + width
    a00 = a01 = a02 = a10 = a11 = a12 = a20 = a21 = a22 = 0.0
    for t in range(count):
        y0, y1, y2 = b[o + t], b[o1 + t], b[o2 + t]
        z0, z1, z2 = b[x + t], b[x1 + t], b[x2 + t]
        a00 += y0 * z0
        a01 += y0 * z1
        a02 += y0 * z2
        a10 += y1 * z0
        a11 += y1 * z1
        a12 += y1 * z2
        a20 += y2 * z0
        a21 += y2 * z1
        a22 += y2 * z2
    g[k, j] += a00
    g[k, j + 1] += a01
    g[k, j + 2] += a02
    g[k + 1, j] += a10
    g[k + 1, j + 1] += a11
    g[k + 1, j + 2] += a12
    g[k + 2, j] += a20
    g[k + 2, j + 1] += a21
    g[k + 2, j + 2] += a22


@_compiled
def multiply(b, base, width, count, g, n):
    """Add the products of the n rows of `b` from `base` to the upper half of `g`: rows by fours, the last by threes."""
    threes = (4 - n % 4) % 4
    fours = (n - 3 * threes) // 4
    j = 0
    for later in range(fours + threes):
        x = base + uint64(j) * width
        if later < fours:
            own_of_four(b, x, width, count, g, j)
        else:
            own_of_three(b, x, width, count, g, j)
        k = 0
        for earlier in range(later):
            o = base + uint64(k) * width
            if later < fours:
                four_with_four(b, o, x, width, count, g, k, j)
            elif earlier < fours:
                four_with_three(b, o, x, width, count, g, k, j)
            else:
                three_with_three(b, o, x, width, count, g, k, j)
            k += 4 if earlier < fours else 3
        j += 4 if later < fours else 3


@_compiled
def take_away(b, base, width, count, q, p):
    """The right-hand side, row q of `b`, less p times the rows before it."""
    x = base + uint64(q) * width
    k = 0
    while k + 6 <= q:
        o = base + uint64(k) * width
        o1, o2 = o + width, o + width + width
        o3 = o2 + width
        o4, o5 = o3 + width, o3 + width + width
        p0, p1, p2, p3, p4, p5 = p[k], p[k + 1], p[k + 2], p[k + 3], p[k + 4], p[k + 5]
        for t in range(count):
            low = p0 * b[o + t] + p1 * b[o1 + t] + p2 * b[o2 + t]
            b[x + t] -= low + (p3 * b[o3 + t] + p4 * b[o4 + t] + p5 * b[o5 + t])
        k += 6
    while k < q:
        o, p0 = base + uint64(k) * width, p[k]
        for t in range(count):
            b[x + t] -= p0 * b[o + t]
        k += 1


@_compiled
def weakness(r, q, v):
    """Sum of squares of the inverse of the triangle r[:q, :q] with unit columns; infinite where it is singular.

    `v` is (3, q) numbers to work in.
    """
    total = 0.0
    for j in range(q):
        if not abs(r[j, j]) > 0.0:
            return np.inf
        v[0, j], v[2, j] = 0.0, 1.0 / r[j, j]
        for i in range(j + 1):
            v[0, j] += r[i, j] * r[i, j]
    for j in range(q):
        for k in range(j, q):
            v[1, k] = 0.0
        v[1, j] = 1.0
        for k in range(j, q):
            x = v[1, k] * v[2, k]
            total += x * x * v[0, j]
            for i in range(k + 1, q):
                v[1, i] -= x * r[k, i]
    return total


@_compiled
def solve(r, q, right, p):
    """p = r[:q, :q]^-1 r[:q, right]."""
    for k in range(q - 1, -1, -1):
        x = r[k, right]
        for i in range(k + 1, q):
            x -= r[k, i] * p[i]
        p[k] = x / r[k, k]


@_compiled
def cholesky(g, q):
    """The triangle of [B c] in the place of its products, (q + 1, q + 1); False where B is singular."""
    for k in range(q + 1):
        if not g[k, k] > 0.0:
            g[k, k] = 0.0
            return k == q
        one = 1.0 / np.sqrt(g[k, k])
        for j in range(k, q + 1):
            g[k, j] *= one
        for i in range(k + 1, q + 1):
            w = g[k, i]
            for j in range(i, q + 1):
                g[i, j] -= w * g[k, j]
    return True


@_compiled
def begin_products(r, q, p, g, b, base, width):
    """Set `p` to the parameters of the triangle `r`, and `g` to the products of its rows less p times them."""
    last, count = r.shape[0] - 1, uint64(q + 1)
    solve(r, q, last, p)
    for k in range(q + 1):
        o = base + uint64(k) * width
        for t in range(q + 1):
            b[o + uint64(t)] = r[t if t < q else last, k if k < q else last]
    take_away(b, base, width, count, q, p)
    g[:] = 0.0
    multiply(b, base, width, count, g, q + 1)


@_compiled
def end_products(r, q, p, g, v):
    """`r` from the products; False, and r as it was, where they do not hold it well enough."""
    last = r.shape[0] - 1
    if not (cholesky(g, q) and weakness(g, q, v) <= MOST):
        return False
    for i in range(q):
        x = g[i, q]
        for k in range(i, q):
            x += g[i, k] * p[k]
            r[i, k] = g[i, k]
        r[i, last] = x
    r[last, last] = g[q, q]
    return True

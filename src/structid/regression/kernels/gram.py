"""Products of the rows of a block, and the triangle that they hold where they hold it as well as a QR does.

Products cost half the reflections, and no sum waits for another, but they square the condition. Two things keep the
digits. The right-hand side goes in less what the parameters found so far make of it, so that the residual is summed
itself and not found as a difference; the first goes in whole, which is enough where much of it is left. And the triangle
counts only if the inverse of its matrix with unit columns stays below `MOST`: a relative error of `MOST` roundings,
1e-13, in the weakest direction. All others go by reflections.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

from structid.regression.kernels.householder import MATHS
from structid.regression.kernels.product import (
    EIGHT,
    four_by_four,
    four_by_three,
    inverse_columns,
    own_four,
    own_three,
    three_by_three,
)

#: Numbers that the products of a few rows need room for.
ROOM = 48
#: Largest sum of squares of the inverse of a triangle with unit columns that comes from products.
MOST = 512.0
#: Part of the square of a whole right-hand side that must be left when its columns have taken theirs.
LEFT = 1e-4
HELD, WEAK, FAINT = 0, 1, 2
_compiled = njit(nogil=True, fastmath=MATHS, error_model="numpy")


@_compiled
def _put(g, k, j, n, m, s):
    """Add the n by m products `s` at (k, j)."""
    for row in range(n):
        for column in range(m):
            g[k + row, j + column] += s[row * m + column]


@_compiled
def _put_own(g, k, n, s):
    """Add the products of n rows with one another, `s`, upper half column after column, at (k, k)."""
    at = 0
    for column in range(n):
        for row in range(column + 1):
            g[k + row, k + column] += s[at]
            at += 1


@_compiled
def multiply(b, base, width, count, g, n, s):
    """Add the products of the n rows of `b` from `base` to the upper half of `g`: rows by fours, the last by threes.

    `s` is `ROOM` numbers to work in.
    """
    threes = (4 - n % 4) % 4
    fours = (n - 3 * threes) // 4
    j = 0
    for later in range(fours + threes):
        x = base + uint64(j) * width
        if later < fours:
            own_four(b, x, width, count, s)
            _put_own(g, j, 4, s)
        else:
            own_three(b, x, width, count, s)
            _put_own(g, j, 3, s)
        k = 0
        for earlier in range(later):
            o = base + uint64(k) * width
            if later < fours:
                four_by_four(b, o, x, width, count, s)
                _put(g, k, j, 4, 4, s)
            elif earlier < fours:
                four_by_three(b, o, x, width, count, s)
                _put(g, k, j, 4, 3, s)
            else:
                three_by_three(b, o, x, width, count, s)
                _put(g, k, j, 3, 3, s)
            k += 4 if earlier < fours else 3
        j += 4 if later < fours else 3


@_compiled
def take_away(b, base, width, count, q, p):
    """The right-hand side, row q of `b`, less p times the rows before it; `p` of nothing but zeros takes nothing."""
    if not p[:q].any():
        return
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
def sizes_of(r, q, sizes):
    """Sums of squares of the columns of the triangle r[:q, :q]."""
    sizes[:q] = 0.0
    for i in range(q):
        for j in range(i, q):
            sizes[j] += r[i, j] * r[i, j]


@_compiled
def weakness(r, q, sizes, v):
    """Sum of squares of the inverse of the triangle r[:q, :q] with unit columns; infinite where it is singular.

    `sizes` are the sums of squares of its columns. Columns of the inverse go by eights, their numbers side by side in
    `v`, 8 q or more of them to work in.
    """
    n, side, eight = uint64(q), uint64(r.shape[1]), uint64(EIGHT)
    for k in range(q):
        if not abs(r[k, k]) > 0.0:
            return np.inf
    total, first = 0.0, uint64(0)
    while first < n:
        for t in range(eight * first, eight * n):
            v[t] = 0.0
        for column in range(first, min(first + eight, n)):
            v[eight * column + column - first] = np.sqrt(sizes[column])
        total += inverse_columns(r, side, n, first, v)
        first += eight
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
def _pivot(g, side, n, k, stop):
    """Row k of the triangle, and rows k + 1 to stop less its products; False where it is singular."""
    o = k * side
    if not g[o + k] > 0.0:
        g[o + k] = 0.0
        return k + uint64(1) == n
    one = 1.0 / np.sqrt(g[o + k])
    for t in range(o + k, o + n):
        g[t] *= one
    for i in range(k + uint64(1), stop):
        share = g[o + i]
        for j in range(i, n):
            g[i * side + j] -= share * g[o + j]
    return True


@_compiled
def cholesky(products, q):
    """The triangle of [B c] in the place of its products, (q + 1, q + 1); False where B is singular.

    Four rows are made at a time before the rows below give up their products with them.
    """
    g, n, side, four = products.ravel(), uint64(q + 1), uint64(products.shape[1]), uint64(4)
    k = uint64(0)
    while k + four < n:
        for row in range(k, k + four):
            if not _pivot(g, side, n, row, k + four):
                return False
        o0, o1 = k * side, k * side + side
        o2, o3 = o1 + side, o1 + side + side
        for i in range(k + four, n):
            w0, w1, w2, w3 = g[o0 + i], g[o1 + i], g[o2 + i], g[o3 + i]
            for j in range(i, n):
                g[i * side + j] -= w0 * g[o0 + j] + w1 * g[o1 + j] + (w2 * g[o2 + j] + w3 * g[o3 + j])
        k += four
    while k < n:
        if not _pivot(g, side, n, k, n):
            return False
        k += uint64(1)
    return True


@_compiled
def begin_products(r, q, p, g, b, base, width, s):
    """Set `g` to the products of the rows of the triangle `r`, less p times them."""
    last, count = r.shape[0] - 1, uint64(q + 1)
    for k in range(q + 1):
        o = base + uint64(k) * width
        for t in range(q + 1):
            b[o + uint64(t)] = r[t if t < q else last, k if k < q else last]
    take_away(b, base, width, count, q, p)
    g[:] = 0.0
    multiply(b, base, width, count, g, q + 1, s)


@_compiled
def end_products(r, q, p, g, sizes, v):
    """`r` from the products; whether they hold it well enough (`HELD`), or what they lack, with r as it was.

    `FAINT`: nearly all of a right-hand side that went in whole was explained; `p` becomes what explains it.
    """
    last = r.shape[0] - 1
    for j in range(q + 1):
        sizes[j] = g[j, j]
    if not (cholesky(g, q) and weakness(g, q, sizes, v) <= MOST):
        return WEAK
    if g[q, q] * g[q, q] < LEFT * sizes[q] and not p[:q].any():
        solve(g, q, q, p)
        return FAINT
    for i in range(q):
        x = g[i, q]
        for k in range(i, q):
            x += g[i, k] * p[k]
            r[i, k] = g[i, k]
        r[i, last] = x
    r[last, last] = g[q, q]
    return HELD

"""Rows of narrow blocks folded into their triangle by products, at the digits of a QR.

Divided by a triangle R that is near theirs, rows are nearly orthogonal, and their products then lose nothing: with
Y = B R^-1 the triangle of [R; B] is L R, where L'L = I + Y'Y. R is what all samples before have left; the first samples
take the triangle of their first few. The answer counts only if the columns turn out nearly orthogonal: the smallest
eigenvalue of their correlations C is at least det(C) / e. All others go by reflections. This is a Cholesky QR with the
preconditioning of Fukaya, Nakatsukasa, Yanagisawa and Yamamoto (2014); the residual is summed itself.
"""

from __future__ import annotations

from numba import njit, uint64

from structid.regression.kernels.householder import MATHS
from structid.regression.kernels.product import (
    fold_eight,
    fold_five,
    fold_four,
    fold_nine,
    fold_seven,
    fold_six,
    fold_three,
)

#: Samples below which a guess for the first ones costs what it saves.
_FEWEST = 500
_compiled = njit(nogil=True, fastmath=MATHS, error_model="numpy")


@_compiled
def _fold(n, b, base, width, count, r, own, to):
    side = uint64(r.shape[0])
    if n == 3:
        return fold_three(b, base, width, count, r, side, own, to)
    if n == 4:
        return fold_four(b, base, width, count, r, side, own, to)
    if n == 5:
        return fold_five(b, base, width, count, r, side, own, to)
    if n == 6:
        return fold_six(b, base, width, count, r, side, own, to)
    if n == 7:
        return fold_seven(b, base, width, count, r, side, own, to)
    if n == 8:
        return fold_eight(b, base, width, count, r, side, own, to)
    return fold_nine(b, base, width, count, r, side, own, to)


@_compiled
def is_empty(r):
    """Whether a triangle holds no rows: nothing but zeros, below its diagonal too."""
    for i in range(r.shape[0]):
        for j in range(r.shape[1]):
            if r[i, j] != 0.0:
                return False
    return True


@_compiled
def fold_whitened(r, q, b, base, width, count, g, one):
    """The triangle of [r; rows] into `r`; False, and r as it was, where products do not hold it.

    The q columns and the right-hand side, three rows to nine, are rows of `b`, `width` apart from `base`, and stay as
    they are. `g`, as large as r, is there to work in; `one` is a unit matrix of that size.
    """
    n = q + 1
    if r[0, 0] != 0.0:
        return _fold(n, b, base, width, count, r, 1.0, r)
    if count < _FEWEST or not is_empty(r):
        return False
    few = min(count, uint64(8 * n))
    return _fold(n, b, base, width, few, one, 0.0, g) and _fold(n, b, base, width, count, g, 0.0, r)

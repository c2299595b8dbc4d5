"""Compiled kernels of the local reduction; imported only where numba is wanted.

Rows of regressors are made and folded in the same breath: for one stretch of samples the rows of a few blocks (a few
times a few hundred numbers) live in the cache and never reach memory.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

from structid.regression.kernels.gram import (
    FAINT,
    HELD,
    MOST,
    ROOM,
    begin_products,
    end_products,
    multiply,
    sizes_of,
    solve,
    take_away,
    weakness,
)
from structid.regression.kernels.householder import APART, MATHS, reflect
from structid.regression.kernels.product import WIDEST
from structid.regression.kernels.vector import fill_one, fill_three, fill_two
from structid.regression.kernels.whitened import fold_whitened, is_empty

_FEWEST = 96  # samples of a stretch that are tried by products
#: Digest of the files compiled into these functions: numba recompiles them only when their own file changes.
PARTS = "babfcf99aa66bc24"
_part = njit(nogil=True, fastmath=MATHS, error_model="numpy")
_compiled = njit(cache=True, nogil=True, fastmath=MATHS, error_model="numpy")


@_part
def _rows(b, block, width, begin, count, d, size, q, side, starts, which, data, alike, fields, pace, new, at, end):
    """Rows of `size` blocks from block `d`, each `block` numbers after the other; asks for the fields new[at:end]."""
    calls = 0
    for k in range(q + 1):
        calls += 1 if alike[d * side + (k if k < q else side - 1)] else size
    each = (end - at + calls - 1) // calls
    for k in range(q + 1):
        row, x = d * side + (k if k < q else side - 1), uint64(k) * width
        j = 0
        while j < size:
            i = uint64(starts[row])
            n, then = uint64(starts[row + 1]) - i, min(at + each, end)
            if alike[row] == 2:
                i1, i2 = uint64(starts[row + side]), uint64(starts[row + 2 * side])
                fill_three(
                    b, x, block, count, fields, begin, pace, which, data, i, i1, i2, n, new, uint64(at), uint64(then)
                )
            elif alike[row] == 1:
                i1 = uint64(starts[row + side])
                fill_two(
                    b, x, block, count, fields, begin, pace, which, data, i, i1, i1, n, new, uint64(at), uint64(then)
                )
            else:
                fill_one(
                    b, x, block, count, fields, begin, pace, which, data, i, i, i, n, new, uint64(at), uint64(then)
                )
            taken = alike[row] + 1
            at = then
            j += taken
            row += taken * side
            x += uint64(taken) * block


@_part
def _started(r, q, stretch, held, p, g, v, sizes, b, base, width, s):
    """Whether products are tried on this stretch, with what the triangle holds in them already.

    `held` is whether products made this triangle, so that its condition is known to be good.
    """
    if stretch < _FEWEST or stretch < 4 * q or q < WIDEST:
        return False
    if is_empty(r):
        g[:] = 0.0
        p[:] = 0.0
        return True
    if not held:
        sizes_of(r, q, sizes)
        if not weakness(r, q, sizes, v) <= MOST:
            return False
    solve(r, q, r.shape[0] - 1, p)
    begin_products(r, q, p, g, b, base, width, s)
    return True


@_part
def _ended(r, q, p, g, v, sizes, b, base, width, s):
    """Whether products hold the triangle, and whether they are to be tried again, for want of parameters to begin with."""
    found = end_products(r, q, p, g, sizes, v)
    if found == FAINT:
        begin_products(r, q, p, g, b, base, width, s)
    return found == HELD, found == FAINT


@_compiled
def fold_fields(
    triangles, fields, n_times, starts, which, data, widths, alike, heads, new, news, first, last, outer, inner
):
    """Fold the rows of groups `first` to `last` over all samples into `triangles`, in place.

    `fields` is flat, `which` the field of each entry of the operator, `starts` its rows. Group h is the blocks
    heads[h] to heads[h + 1]; alike[row] more of its rows after this one read the same fields. Samples go by stretches
    of `outer`, so that the fields of neighbouring blocks stay in the cache, and within them by `inner`, so that the
    rows do. The fields new[news[h]:news[h + 1]] are those of group h that the group before does not use.

    A block is tried by products of its rows, and taken again by reflections where those do not hold it.
    """
    side = triangles.shape[1]
    most = 1
    for h in range(first, last):
        most = max(most, heads[h + 1] - heads[h])
    room = max(inner, side)
    width = uint64(room + APART)
    block, pace = uint64(side) * width, uint64(n_times)
    b = np.empty(most * side * (room + APART))
    p, g, v, sizes = np.zeros((most, side)), np.zeros((most, side, side)), np.zeros(8 * side), np.zeros(side)
    s, one = np.zeros(ROOM), np.eye(side)
    products, todo = np.zeros(most, dtype=np.bool_), np.zeros(most, dtype=np.bool_)
    held = np.zeros(heads[last], dtype=np.bool_)
    for begin in range(0, n_times, outer):
        stop = min(begin + outer, n_times)
        for h in range(first, last):
            d, size = heads[h], heads[h + 1] - heads[h]
            q = widths[d]
            next_new, end_new = (news[h + 1], news[h + 2]) if h + 1 < last else (0, 0)
            for j in range(size):
                base = uint64(j) * block
                products[j] = _started(
                    triangles[d + j], q, stop - begin, held[d + j], p[j], g[j], v, sizes, b, base, width, s
                )
                todo[j] = True
            again = True
            while again:
                again = False
                for at in range(begin, stop, inner):
                    count = uint64(min(inner, stop - at))
                    _rows(
                        b, block, width, uint64(at), count, d, size, q, side, starts, which, data, alike, fields, pace,
                        new, next_new, end_new,
                    )  # fmt: skip
                    for j in range(size):
                        base = uint64(j) * block
                        if not todo[j]:
                            continue
                        if products[j]:
                            take_away(b, base, width, count, q, p[j])
                            multiply(b, base, width, count, g[j], q + 1, s)
                        elif not (
                            2 <= q < WIDEST
                            and count >= 8 * (q + 1)
                            and fold_whitened(triangles[d + j], q, b, base, width, count, g[j], one)
                        ):
                            reflect(triangles[d + j], b[j * int(block) :], q, width, count)
                for j in range(size):
                    if todo[j] and products[j]:
                        base = uint64(j) * block
                        held[d + j], products[j] = _ended(triangles[d + j], q, p[j], g[j], v, sizes, b, base, width, s)
                        todo[j] = not held[d + j]
                        again |= todo[j]
                    else:
                        todo[j] = False
                end_new = next_new

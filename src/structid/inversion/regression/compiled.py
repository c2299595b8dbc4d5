"""Compiled loops: rows made from fields and folded into the triangles of their blocks; loaded only where numba is wanted.

Nearly all time goes into two loops over samples, `_products` of rows and `_combine`, which adds rows to rows. They take
rows as tuples of where these begin: numba compiles them for every number of rows, all but the loop over samples is
unrolled, and that one becomes vector instructions whose sums stay in registers. Three by three rows are nine products
for six numbers read. Whatever else is here has the size of a triangle.

Rows follow one another in one array, `apart` numbers from one to the next: q columns, filled up with zeros to a multiple
of three, and the right-hand side. What the triangle holds already stands in front of the new samples. All functions are
in this one file because numba looks at the file of a cached function only to see whether it must be compiled anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, uint64
from numba.cpython.unsafe.tuple import tuple_setitem

#: Largest sum of squares of the inverse of a triangle with unit columns that comes from products, over its columns.
WEAKEST = 20.0
#: Part of the square of the right-hand side below which what is left of it is summed itself.
SMALL = 1e-4
_FEWEST = 4  # samples a column that are tried by products
_EVEN = 32  # samples go by multiples of it
_APART = 24  # more numbers between rows, so that they do not fall into the same sets of the cache
_ONE, _THREE, _NINE = (0.0,), (0.0,) * 3, (0.0,) * 9

# Sums may be reordered and fused for vector units, nothing else of IEEE arithmetic is given up: NaN and infinity arrive.
_MATHS = {"reassoc", "contract", "nsz"}
_part = njit(nogil=True, fastmath=_MATHS, error_model="numpy")
_whole = njit(cache=True, nogil=True, fastmath=_MATHS, error_model="numpy")


class Samples(NamedTuple):
    """Some samples of all fields: of field k they begin at fields[k pace + first]."""

    fields: np.ndarray
    pace: int
    first: int
    length: int


class Rows(NamedTuple):
    """Rows of one block: row k begins at b[first + k apart]."""

    b: np.ndarray
    first: int
    apart: int
    length: int


@_part
def _products(b, left, right, count, sums):
    """`sums` plus the inner products of the rows of `b` that begin at `left` with those that begin at `right`.

    `b` is a flat array, `left` and `right` are tuples of indices in it, the rows are `count` samples long, and `sums`
    is a flat tuple with a number for each pair of rows, in the order of `left` and then `right`.
    """
    for t in range(uint64(count)):
        for i in range(len(left)):
            x = b[uint64(left[i]) + t]
            for j in range(len(right)):
                k = i * len(right) + j
                sums = tuple_setitem(sums, k, sums[k] + x * b[uint64(right[j]) + t])
    return sums


@_part
def _combine(b, rows, fields, sources, factors, count, fresh):
    """Add to rows of the flat array `b` the weighted sums of rows of the flat array `fields`; with `fresh`, replace them.

    Rows begin at the indices `rows` in `b` and `sources` in `fields` and are `count` samples long; `factors` holds
    len(rows) times len(sources) weights, those of the first of `rows` first.
    """
    x = factors[: len(sources)]
    for t in range(uint64(count)):
        for k in range(len(sources)):
            x = tuple_setitem(x, k, fields[uint64(sources[k]) + t])
        for i in range(len(rows)):
            total = 0.0 if fresh else b[uint64(rows[i]) + t]
            for k in range(len(sources)):
                total += factors[i * len(sources) + k] * x[k]
            b[uint64(rows[i]) + t] = total


@_part
def _padded(q):
    return (q + 2) // 3 * 3


@_part
def _three(rows, k):
    at = rows.first + k * rows.apart
    return (at, at + rows.apart, at + 2 * rows.apart)


@_part
def _alike(blocks, row, other):
    """True if rows `row` and `other` of the sparse operator `blocks` use the same fields in the same order."""
    a, b, k = blocks.starts[row], blocks.starts[other], 0
    n = blocks.starts[row + 1] - a
    while k < n and blocks.which[a + k] == blocks.which[b + k]:
        k += 1
    return k == n == blocks.starts[other + 1] - b


@_part
def _make_alike(b, at, samples, blocks, row, side, factors):
    """Write the samples of up to three operator rows that use the same fields into `b`, four fields at a time.

    Parameters
    ----------
    b : (n,) float array
    at : tuple of int
        Index in `b` at which each row begins; one entry for each row that is made.
    samples : Samples
        The fields and the range of samples.
    blocks : Blocks
        The sparse operator.
    row : int
        First operator row; zeros are written if it uses no field.
    side : int
        Distance of the rows in the operator.
    factors : tuple of float
        Working space of four numbers for each row; what it holds before does not matter.
    """
    start, end = blocks.starts[row], blocks.starts[row + 1]
    if start == end:
        for i in range(len(at)):
            b[at[i] : at[i] + samples.length] = 0.0
    for k in range(start, end, 4):
        sources = (
            blocks.which[k] * samples.pace + samples.first,
            blocks.which[min(k + 1, end - 1)] * samples.pace + samples.first,
            blocks.which[min(k + 2, end - 1)] * samples.pace + samples.first,
            blocks.which[min(k + 3, end - 1)] * samples.pace + samples.first,
        )
        for i in range(len(at)):
            shift = blocks.starts[row + i * side] - start
            for j in range(4):
                factors = tuple_setitem(factors, 4 * i + j, blocks.data[shift + k + j] if k + j < end else 0.0)
        _combine(b, at, samples.fields, sources, factors, samples.length, k == start)


@_part
def _make(b, at, block, samples, blocks, row, side, n):
    """Write the samples of the same equation row of `n` neighbouring blocks into `b`, up to three blocks at a time.

    Blocks are made together if their rows use the same fields.

    Parameters
    ----------
    b : (n,) float array
    at : int
        Index in `b` at which the first row begins.
    block : int
        Distance of the blocks in `b`.
    samples : Samples
        The fields and the range of samples.
    blocks : Blocks
        The sparse operator.
    row : int
        First operator row.
    side : int
        Distance of the rows in the operator.
    n : int
        Number of blocks.
    """
    while n > 0:
        alike = 1
        while alike < min(n, 3) and _alike(blocks, row, row + alike * side):
            alike += 1
        if alike == 3:
            _make_alike(b, (at, at + block, at + 2 * block), samples, blocks, row, side, (0.0,) * 12)
        elif alike == 2:
            _make_alike(b, (at, at + block), samples, blocks, row, side, (0.0,) * 8)
        else:
            _make_alike(b, (at,), samples, blocks, row, side, (0.0,) * 4)
        at, row, n = at + alike * block, row + alike * side, n - alike


@_part
def _put_triangle_first(r, q, rows, new):
    """Write the triangle `r` of `q` columns before the last `new` samples of the columns `rows`, padded with zeros.

    Columns are padded to a multiple of three, with columns of zeros; the right-hand side, last in `r`, follows these in
    `rows`.
    """
    n, last = _padded(q), r.shape[0] - 1
    for k in range(n + 1):
        at = rows.first + k * rows.apart
        rows.b[at : at + rows.length - (0 if q <= k < n else new)] = 0.0
        if k < q:
            for t in range(k + 1):
                rows.b[at + t] = r[t, k]
    for t in range(q):
        rows.b[at + t] = r[t, last]
    rows.b[at + n] = r[last, last]


@_part
def _take(r, q, rows, i, j):
    """Move entry `i` of column `j` of `rows` to row i of the triangle `r` of `q` columns, and put zero in its place.

    Column numbers of `rows` are padded to a multiple of three; entries of padding are dropped. The column after these
    is the right-hand side, and goes to the last column of `r`.
    """
    at = rows.first + j * rows.apart + i
    if i < q and (j < q or j == _padded(q)):
        r[i, j if j < q else r.shape[0] - 1] = rows.b[at]
    rows.b[at] = 0.0


@_part
def _reflect_panel(r, q, rows, k):
    """Reflect columns k to k + 2 of `rows` and the right-hand side by Householder vectors, and update the triangle `r`.

    `q` is the number of columns. The vectors replace the columns. Returns the three factors of the reflections, and the
    inner products of the vectors, as a 3 x 3 matrix by rows of which only the part below the diagonal is filled.
    """
    b, n, factors, overlap = rows.b, _padded(q), _THREE, _NINE
    v = _three(rows, k)
    x = (*v, rows.first + n * rows.apart)
    for i in range(3):
        products = _products(b, (v[i],), x, rows.length, (0.0,) * 4)
        at, size = k + i, np.sqrt(products[i])
        head = b[v[i] + at]
        more = size if head >= 0.0 else -size
        b[v[i] + at] = head + more
        if at < q:
            r[at, at] = -more
        factors = tuple_setitem(factors, i, 1.0 / (size * (size + abs(head))) if size > 0.0 else 0.0)
        for j in range(4):
            product = products[j] + more * b[x[j] + at]
            if j < i:
                overlap = tuple_setitem(overlap, 3 * i + j, product)
            elif j > i:
                _combine(b, (x[j],), b, (v[i],), (-factors[i] * product,), rows.length, False)
                _take(r, q, rows, at, k + j if j < 3 else n)
    return factors, overlap


@_part
def _update_by_reflections(r, q, rows):
    """Update the triangle `r` of `q` columns in place by the samples in `rows`, by Householder reflections.

    The samples in `rows` are overwritten.
    """
    n, last = _padded(q), r.shape[0] - 1
    for k in range(0, n, 3):
        factors, overlap = _reflect_panel(r, q, rows, k)
        v = _three(rows, k)
        for j in range(k + 3, n, 3):
            x, shares = _three(rows, j), _NINE
            products = _products(rows.b, v, x, rows.length, _NINE)
            for i in range(3):
                first = factors[0] * products[i]
                second = factors[1] * (products[3 + i] - overlap[3] * first)
                third = factors[2] * (products[6 + i] - overlap[6] * first - overlap[7] * second)
                shares = tuple_setitem(tuple_setitem(shares, 3 * i, -first), 3 * i + 1, -second)
                shares = tuple_setitem(shares, 3 * i + 2, -third)
            _combine(rows.b, x, rows.b, v, shares, rows.length, False)
            for i in range(9):
                _take(r, q, rows, k + i // 3, j + i % 3)
    right = rows.first + n * rows.apart
    r[last, last] = np.sqrt(_products(rows.b, (right,), (right,), rows.length, _ONE)[0])


@_part
def _cholesky(g, q):
    """Replace the matrix of products `g` in place by its Cholesky factor and the inverse of it; returns a squared norm.

    The upper part becomes the factor of the first `q` columns, the part below the diagonal its transposed inverse, and
    the last column the right-hand sides divided by the transposed triangle. The norm is that of the inverse with unit
    columns, infinite where g is singular, and `g` then half changed.
    """
    sizes, weakness = np.zeros(q), 0.0
    for k in range(q):
        sizes[k] = g[k, k]
    for k in range(q):
        if not g[k, k] > 0.0:
            return np.inf
        over = 1.0 / np.sqrt(g[k, k])
        for j in range(g.shape[1]):
            g[k, j] *= over
            if j < k:
                weakness += g[k, j] * g[k, j] * sizes[j]
        weakness += over * over * sizes[k]
        for i in range(k + 1, q):
            share = g[k, i]
            for j in range(k):
                g[i, j] -= share * g[k, j]
            g[i, k] = -share * over
            for j in range(i, g.shape[1]):
                g[i, j] -= share * g[k, j]
    return weakness


@_part
def _with_right(g, rows, n):
    """Put the products of all columns of `rows` with the right-hand side into the last column of `g`, in place.

    `g` is (n + 1, n + 1) for `n` columns of `rows` with padding; the right-hand side follows them. Entry [n, n] is its
    square.
    """
    right = (rows.first + n * rows.apart,)
    for i in range(0, n, 3):
        products = _products(rows.b, _three(rows, i), right, rows.length, _THREE)
        for k in range(3):
            g[i + k, n] = products[k]
    g[n, n] = _products(rows.b, right, right, rows.length, _ONE)[0]


@_part
def _refine_right_side(g, q, rows, n):
    """Refine the right-hand side in the last column of the factor `g` once; returns the residual's sum of squares.

    `g` (n + 1, n + 1) is from `_cholesky`. `q` columns of `rows` are used, `n` with padding; the right-hand side in
    `rows` is replaced by its residual.
    """
    p = np.zeros(n)
    for i in range(q - 1, -1, -1):
        p[i] = g[i, n]
        for k in range(i + 1, q):
            p[i] -= g[i, k] * p[k]
        p[i] /= g[i, i]
    for i in range(0, n, 3):
        right = (rows.first + n * rows.apart,)
        _combine(rows.b, right, rows.b, _three(rows, i), (-p[i], -p[i + 1], -p[i + 2]), rows.length, False)
    _with_right(g, rows, n)
    left = g[n, n]
    for i in range(q):
        for k in range(i):
            g[i, n] -= g[k, i] * g[k, n]
        g[i, n] /= g[i, i]
        left -= g[i, n] * g[i, n]
    for i in range(q):
        for k in range(i, q):
            g[i, n] += g[i, k] * p[k]
    return left


@_part
def _factor_by_products(r, q, rows):
    """Replace the triangle `r` of `q` columns by the Cholesky factor of the products of `rows`; False if inaccurate.

    In that case `r` is unchanged. `rows` include the old triangle. Products cost half as much as reflections but square
    the condition: they count only if the sum of squares of the inverse triangle with unit columns is at most `WEAKEST`,
    20, per column. Where less than `SMALL`, 1e-4, of the square of the right-hand side is left, its residual is formed
    and summed, which overwrites it in `rows`.
    """
    n, last = _padded(q), r.shape[0] - 1
    g = np.zeros((n + 1, n + 1))
    for i in range(0, n, 3):
        for j in range(i, n, 3):
            products = _products(rows.b, _three(rows, i), _three(rows, j), rows.length, _NINE)
            for k in range(9):
                g[i + k // 3, j + k % 3] = products[k]
    _with_right(g, rows, n)
    if not _cholesky(g, q) <= WEAKEST * q:
        return False
    left = g[n, n]
    for i in range(q):
        left -= g[i, n] * g[i, n]
    if left < SMALL * g[n, n]:
        left = _refine_right_side(g, q, rows, n)
    for i in range(q):
        for j in range(i, q):
            r[i, j] = g[i, j]
        r[i, last] = g[i, n]
    r[last, last] = np.sqrt(max(left, 0.0))
    return True


@_whole
def fold_fields(triangles, fields, blocks, first, last, longest):
    """Update the triangles of block groups `first` to `last` by the equation rows formed from `fields`, in place.

    Group h is the blocks from `blocks.heads[h]` to before `blocks.heads[h + 1]`, three at most; group `last` is not
    included.

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
    fields : (n_fields, n_times) float array
    blocks : Blocks
        Sparse operator from the fields to the rows of all blocks.
    first, last : int
        Range of groups.
    longest : int
        Largest number of samples taken at a time.
    """
    side, n_times = triangles.shape[1], fields.shape[1]
    most = _padded(side - 1)
    step = -(-n_times // max(1, -(-n_times // longest)))
    apart = (step + most + _EVEN) // _EVEN * _EVEN + _APART
    block = (most + 1) * apart
    room = np.zeros(3 * block + 8)
    b = room[-room.ctypes.data // 8 % 8 :]  # from the beginning of a cache line
    for at in range(0, n_times, max(step, 1)):
        samples = Samples(fields.ravel(), n_times, at, min(step, n_times - at))
        for h in range(first, last):
            d, size = blocks.heads[h], blocks.heads[h + 1] - blocks.heads[h]
            q = blocks.widths[d]
            n = _padded(q)
            count = (samples.length + n + _EVEN) // _EVEN * _EVEN
            for k in range(q + 1):
                row, to = d * side + (k if k < q else side - 1), (k if k < q else n) * apart + count - samples.length
                _make(b, to, block, samples, blocks, row, side, size)
            for j in range(size):
                rows, r = Rows(b, j * block, apart, count), triangles[d + j]
                _put_triangle_first(r, q, rows, samples.length)
                if samples.length < _FEWEST * q or not _factor_by_products(r, q, rows):
                    _update_by_reflections(r, q, rows)

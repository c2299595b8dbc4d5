"""Vector instructions for products of rows: every sum stays in a register until all samples have passed."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from structid.regression.kernels.vector_code import (
    BOOL,
    F64,
    FLAGS,
    I32,
    I64,
    LANES,
    WIDE,
    Loop,
    called,
    lane_sums,
    lanes,
    minus_product,
    place,
    plus_product,
    read,
    row_starts,
    spread,
    zero,
)

#: Rows of the widest block that is whitened, its right-hand side among them.
WIDEST = 9
#: Least determinant of the correlations of columns that are nearly orthogonal; their least eigenvalue is a third of it.
DETERMINANT = 0.125
#: Columns of an inverse that are found at once.
EIGHT = 8
#: Part of the last row's square, over r, that must be left when the others have taken theirs.
RESIDUAL = 1e-3


def _summed(builder, count, size, to, products):
    """Store the sums over `count` samples of the `size` values that `products` makes of totals, place and kind."""
    at = I64(0)
    for kind in (WIDE, F64):
        loop = Loop(builder, at, count, lanes(kind), [zero(kind)] * size)
        loop.close(products(loop.carried, loop.index, kind))
        at = loop.index
        if kind == WIDE:
            for k, sums in enumerate(lane_sums(builder, loop.carried)):
                builder.store(sums, place(builder, to, I64(k * LANES), WIDE), align=8)
        else:
            for k, total in enumerate(loop.carried):
                one = builder.gep(to, [I64(k)])
                builder.store(builder.fadd(builder.load(one), total), one)


def _tile(n, m):
    """The intrinsic for s[i m + j] = the sum over t < count of b[o + i width + t] b[x + j width + t], i < n, j < m.

    `s` has room for a multiple of eight numbers. Integers are unsigned.
    """

    def typed(context, b, o, x, width, count, s):
        signature = types.void(b, o, x, width, count, s)

        def code(context, builder, signature, args):
            b, s = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 5))
            left, right = row_starts(builder, args[1], args[3], n), row_starts(builder, args[2], args[3], m)

            def products(totals, at, kind):
                first = [read(builder, b, builder.add(start, at), kind) for start in left]
                second = [read(builder, b, builder.add(start, at), kind) for start in right]
                return [
                    plus_product(builder, totals[i * m + j], first[i], second[j]) for i in range(n) for j in range(m)
                ]

            _summed(builder, args[4], n * m, s, products)
            return context.get_dummy_value()

        return signature, code

    return intrinsic(typed)


def _own(n):
    """The intrinsic for the products of n rows with one another, upper half, column after column.

    s[j (j + 1) / 2 + i] is the sum over t < count of the products of rows i <= j of `b`, which begin at base + j width.
    """

    def typed(context, b, base, width, count, s):
        signature = types.void(b, base, width, count, s)

        def code(context, builder, signature, args):
            b, s = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 4))
            starts = row_starts(builder, args[1], args[2], n)

            def products(totals, at, kind):
                rows = [read(builder, b, builder.add(start, at), kind) for start in starts]
                return _upper(builder, totals, rows)

            _summed(builder, args[3], n * (n + 1) // 2, s, products)
            return context.get_dummy_value()

        return signature, code

    return intrinsic(typed)


def _upper(builder, totals, rows):
    pairs = [(rows[i], row) for j, row in enumerate(rows) for i in range(j + 1)]
    return [plus_product(builder, total, a, b) for total, (a, b) in zip(totals, pairs, strict=True)]


def _folding(n):
    """The intrinsic for the triangle of [own r; rows] into `to`, by products of the rows over r; whether they hold it.

    The n rows begin at base + j width of `b`, which keeps them. Row i of `r` and of `to` begins at i side, the column of
    the last row is side - 1. `own` is 1, or 0 where r is a guess and no part of the triangle. Nothing is stored unless
    the determinant of the correlations of the first n - 1 rows over r is at least `DETERMINANT`, and a part `RESIDUAL`
    of the last is left.
    """

    def typed(context, b, base, width, count, r, side, own, to):
        signature = types.boolean(b, base, width, count, r, side, own, to)

        def code(context, builder, signature, args):
            arrays = [context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 4, 7)]
            arguments = (*arrays, *args[1:4], *args[5:7])
            return called(builder, f"fold_{n}", BOOL, arguments, lambda inner, given: _folded(inner, n, *given))

        return signature, code

    return intrinsic(typed)


def _folded(builder, n, b, r, to, base, width, count, side, own):
    starts, ends = row_starts(builder, base, width, n), [I64(j) for j in range(n - 1)]
    ends.append(builder.sub(side, I64(1)))
    places = {(i, j): builder.add(builder.mul(ends[i], side), ends[j]) for j in range(n) for i in range(j + 1)}
    old = {at: builder.load(builder.gep(r, [place])) for at, place in places.items()}
    share = {}
    for i in range(n - 1):
        over = builder.fdiv(F64(1.0), old[i, i])
        for j in range(i + 1, n):
            share[i, j] = builder.fmul(old[i, j], over)

    def products(totals, at, kind):
        rows = []
        for j, start in enumerate(starts):
            row = read(builder, b, builder.add(start, at), kind)
            for i in range(j):
                row = minus_product(builder, row, spread(builder, share[i, j], kind), rows[i])
            rows.append(row)
        return _upper(builder, totals, rows)

    room = cgutils.alloca_once(builder, ir.ArrayType(F64, WIDEST * (WIDEST + 1) // 2 + LANES))
    sums = builder.gep(room, [I64(0), I64(0)])
    _summed(builder, count, n * (n + 1) // 2, sums, products)
    g = {at: builder.load(builder.gep(sums, [I64(k)])) for k, at in enumerate(places)}
    for k in range(n):
        g[k, k] = plus_product(builder, g[k, k], builder.fmul(own, old[k, k]), old[k, k])
    root, held = _root(builder, g, n)
    with builder.if_then(held):
        for (i, j), place in places.items():
            total = root[i, j]
            for k in range(i, j):
                total = plus_product(builder, total, root[i, k], share[k, j])
            builder.store(total, builder.gep(to, [place]))
    return held


def _root(builder, g, n):
    """The triangle whose products are `g`, and whether its columns are near enough to orthogonal."""
    root, g, spoiled, held = {}, dict(g), F64(1.0), BOOL(1)
    sizes = [g[k, k] for k in range(n)]
    for k in range(n):
        pivot = g[k, k]
        over = builder.fdiv(F64(1.0), pivot)
        root[k, k] = builder.call(builder.module.declare_intrinsic("llvm.sqrt", [F64]), [pivot])
        scale = builder.fmul(root[k, k], over)
        for i in range(k + 1, n):
            root[k, i] = builder.fmul(g[k, i], scale)
            part = builder.fmul(g[k, i], over)
            for j in range(i, n):
                g[i, j] = minus_product(builder, g[i, j], part, g[k, j])
        if k < n - 1:
            spoiled = builder.fmul(spoiled, builder.fmul(sizes[k], over))
            held = builder.and_(held, builder.fcmp_ordered(">", pivot, F64(0.0)))
        else:
            held = builder.and_(held, builder.fcmp_ordered(">=", pivot, builder.fmul(sizes[k], F64(RESIDUAL))))
    return root, builder.and_(held, builder.fcmp_ordered("<=", spoiled, F64(1.0 / DETERMINANT)))


def _inverse_columns():
    """The intrinsic for the sum of squares of eight columns of an inverse of a triangle, numbers in columns of their own.

    `v` holds eight numbers for each row from row `first` on, the right-hand sides, and becomes the solution for the
    triangle r[:n, :n] of rows `side` long, forward.
    """
    kind = ir.VectorType(F64, EIGHT)

    def typed(context, r, side, n, first, v):
        signature = types.float64(r, side, n, first, v)

        def code(context, builder, signature, args):
            r, v = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 4))
            return called(
                builder, "inverse_columns", F64, (r, *args[1:4], v), lambda inner, given: solved(inner, *given)
            )

        return signature, code

    def solved(builder, r, side, n, first, v):
        rows = Loop(builder, first, n, 1, [zero(kind)])
        start, at = builder.mul(rows.index, side), builder.mul(rows.index, I64(EIGHT))
        over = builder.fdiv(F64(1.0), builder.load(builder.gep(r, [builder.add(start, rows.index)])))
        row = builder.fmul(read(builder, v, at, kind), spread(builder, over, kind), flags=FLAGS)
        below = Loop(builder, builder.add(rows.index, I64(1)), n, 1)
        share = spread(builder, builder.load(builder.gep(r, [builder.add(start, below.index)])), kind)
        to = builder.mul(below.index, I64(EIGHT))
        left = minus_product(builder, read(builder, v, to, kind), share, row)
        builder.store(left, place(builder, v, to, kind), align=8)
        below.close()
        rows.close([plus_product(builder, rows.carried[0], row, row)])
        total = F64(0.0)
        for lane in range(EIGHT):
            total = builder.fadd(total, builder.extract_element(rows.carried[0], I32(lane)))
        return total

    return intrinsic(typed)


four_by_four, four_by_three, three_by_three = _tile(4, 4), _tile(4, 3), _tile(3, 3)
own_three, own_four = _own(3), _own(4)
fold_three, fold_four, fold_five = _folding(3), _folding(4), _folding(5)
fold_six, fold_seven, fold_eight, fold_nine = _folding(6), _folding(7), _folding(8), _folding(9)
inverse_columns = _inverse_columns()

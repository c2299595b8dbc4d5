"""Vector instructions for the compiled kernels: rows made from fields, with the next fields already on their way.

What a compiler makes of plain loops spends half its time on loading and checking. Here the sums of a row over a few
vectors of samples stay in registers while all fields of the row pass by, up to three rows that read the same fields go
together, and meanwhile the cache is asked for the fields that the next rows will need.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from structid.regression.kernels.vector_code import (
    F64,
    I32,
    I64,
    WIDE,
    Loop,
    lanes,
    place,
    plus_product,
    read,
    row_starts,
    spread,
    zero,
)

_VECTORS = 4
_LINE = 8  # doubles of a cache line


def _offset(builder, which, index, pace, first):
    """Where the samples of field which[index] begin."""
    field = builder.zext(builder.load(builder.gep(which, [index])), I64)
    return builder.add(builder.mul(field, pace), first)


def _ask(builder, fields, at):
    """Have the cache line of fields[at] brought into the second-level cache."""
    line = place(builder, fields, at, ir.IntType(8))
    kind = ir.FunctionType(ir.VoidType(), [line.type, I32, I32, I32])
    prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
    builder.call(prefetch, [line, I32(0), I32(2), I32(1)])


def _sums(builder, kind, vectors, outs, at, arrays, entries, pace, first):
    """Rows at `outs` of b, `vectors` of samples from `at`: data times fields, summed in registers."""
    b, fields, which, data = arrays
    starts, count = entries
    loop = Loop(builder, I64(0), count, 1, [zero(kind)] * (len(outs) * vectors))
    source = builder.add(_offset(builder, which, builder.add(starts[0], loop.index), pace, first), at)
    steps = [I64(v * lanes(kind)) for v in range(vectors)]
    samples = [read(builder, fields, builder.add(source, step), kind) for step in steps]
    sums = []
    for row, start in enumerate(starts):
        factor = spread(builder, builder.load(builder.gep(data, [builder.add(start, loop.index)])), kind)
        for v in range(vectors):
            sums.append(plus_product(builder, loop.carried[row * vectors + v], factor, samples[v]))
    loop.close(sums)
    for row, out in enumerate(outs):
        for v, step in enumerate(steps):
            to = place(builder, b, builder.add(builder.add(out, at), step), kind)
            builder.store(loop.carried[row * vectors + v], to, align=8)


def _filling(rows):
    """The intrinsic that fills so many rows.

    b[x + r block + t] = the sum over k < n of data[i_r + k] fields[which[i_0 + k] pace + first + t], for t < count and
    every row r; meanwhile the same samples of the fields new[begin] to new[end] are asked for. Integers are unsigned.
    """

    def typed(context, b, x, block, count, fields, first, pace, which, data, i0, i1, i2, n, new, begin, end):
        signature = types.void(b, x, block, count, fields, first, pace, which, data, i0, i1, i2, n, new, begin, end)

        def code(context, builder, signature, args):
            b, fields, which, data, new = (
                context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 4, 7, 8, 13)
            )
            x, block, count, first, pace, n, begin, end = (args[k] for k in (1, 2, 3, 5, 6, 12, 14, 15))
            outs, at = row_starts(builder, x, block, rows), I64(0)
            for vectors, kind in ((_VECTORS, WIDE), (1, WIDE), (1, F64)):
                step = vectors * lanes(kind)
                samples = Loop(builder, at, count, step)
                if vectors > 1:
                    asked = Loop(builder, begin, end, 1)
                    source = builder.add(_offset(builder, new, asked.index, pace, first), samples.index)
                    for line in range(0, step, _LINE):
                        _ask(builder, fields, builder.add(source, I64(line)))
                    asked.close()
                arrays, entries = (b, fields, which, data), (args[9 : 9 + rows], n)
                _sums(builder, kind, vectors, outs, samples.index, arrays, entries, pace, first)
                samples.close()
                at = samples.index
            return context.get_dummy_value()

        return signature, code

    return intrinsic(typed)


fill_one, fill_two, fill_three = _filling(1), _filling(2), _filling(3)

"""Vector instructions for the compiled kernels: rows made from fields, with the next fields already on their way.

What a compiler makes of plain loops spends half its time on loading and checking. Here the sums of a row over a few
vectors of samples stay in registers while all fields of the row pass by, up to three rows that read the same fields go
together, and meanwhile the cache is asked for the fields that the next rows will need.
"""

from __future__ import annotations

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_F64, _I64, _I32 = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_FLAGS = ("contract", "reassoc", "nsz")
_LANES = 8 if binding.get_host_cpu_features().get("avx512f") else 4
_VECTORS = 4
_LINE = 8  # doubles of a cache line


class _Loop:
    """for i from `start`, by `step`, while i + step <= stop, with values carried from one turn to the next."""

    def __init__(self, builder, start, stop, step, carried=()):
        self.builder, before = builder, builder.block
        self.head, self.body, self.end = (builder.append_basic_block(name) for name in ("head", "body", "end"))
        builder.branch(self.head)
        builder.position_at_end(self.head)
        self.index = builder.phi(_I64)
        self.index.add_incoming(start, before)
        self.carried = [builder.phi(value.type) for value in carried]
        for phi, value in zip(self.carried, carried, strict=True):
            phi.add_incoming(value, before)
        self.following = builder.add(self.index, _I64(step))
        builder.cbranch(builder.icmp_unsigned("<=", self.following, stop), self.body, self.end)
        builder.position_at_end(self.body)

    def close(self, carried=()):
        here = self.builder.block
        self.builder.branch(self.head)
        self.index.add_incoming(self.following, here)
        for phi, value in zip(self.carried, carried, strict=True):
            phi.add_incoming(value, here)
        self.builder.position_at_end(self.end)


def _spread(builder, value, kind):
    """One number in all lanes."""
    if kind == _F64:
        return value
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, _I32(0))
    zeros = ir.Constant(ir.VectorType(_I32, kind.count), None)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), zeros)


def _place(builder, base, at, kind):
    return builder.bitcast(builder.gep(base, [at]), kind.as_pointer())


def _offset(builder, which, index, pace, first):
    """Where the samples of field which[index] begin."""
    field = builder.zext(builder.load(builder.gep(which, [index])), _I64)
    return builder.add(builder.mul(field, pace), first)


def _ask(builder, fields, at):
    """Have the cache line of fields[at] brought into the second-level cache."""
    place = builder.bitcast(builder.gep(fields, [at]), ir.IntType(8).as_pointer())
    kind = ir.FunctionType(ir.VoidType(), [place.type, _I32, _I32, _I32])
    prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
    builder.call(prefetch, [place, _I32(0), _I32(2), _I32(1)])


def _sums(builder, kind, vectors, outs, at, arrays, entries, pace, first):
    """Rows at `outs` of b, `vectors` of samples from `at`: data times fields, summed in registers."""
    b, fields, which, data = arrays
    starts, count = entries
    step = 1 if kind == _F64 else kind.count
    zero = ir.Constant(kind, 0.0 if kind == _F64 else None)
    loop = _Loop(builder, _I64(0), count, 1, [zero] * (len(outs) * vectors))
    source = builder.add(_offset(builder, which, builder.add(starts[0], loop.index), pace, first), at)
    read = [
        builder.load(_place(builder, fields, builder.add(source, _I64(v * step)), kind), align=8)
        for v in range(vectors)
    ]
    sums = []
    for row, start in enumerate(starts):
        factor = _spread(builder, builder.load(builder.gep(data, [builder.add(start, loop.index)])), kind)
        for v in range(vectors):
            product = builder.fmul(factor, read[v], flags=_FLAGS)
            sums.append(builder.fadd(loop.carried[row * vectors + v], product, flags=_FLAGS))
    loop.close(sums)
    for row, out in enumerate(outs):
        for v in range(vectors):
            place = _place(builder, b, builder.add(builder.add(out, at), _I64(v * step)), kind)
            builder.store(loop.carried[row * vectors + v], place, align=8)


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
            outs = [x]
            while len(outs) < rows:
                outs.append(builder.add(outs[-1], block))
            wide, at = ir.VectorType(_F64, _LANES), _I64(0)
            for vectors, kind in ((_VECTORS, wide), (1, wide), (1, _F64)):
                step = vectors * (1 if kind == _F64 else _LANES)
                samples = _Loop(builder, at, count, step)
                if vectors > 1:
                    asked = _Loop(builder, begin, end, 1)
                    source = builder.add(_offset(builder, new, asked.index, pace, first), samples.index)
                    for line in range(0, step, _LINE):
                        _ask(builder, fields, builder.add(source, _I64(line)))
                    asked.close()
                arrays, entries = (b, fields, which, data), (args[9 : 9 + rows], n)
                _sums(builder, kind, vectors, outs, samples.index, arrays, entries, pace, first)
                samples.close()
                at = samples.index
            return context.get_dummy_value()

        return signature, code

    return intrinsic(typed)


fill_one, fill_two, fill_three = _filling(1), _filling(2), _filling(3)

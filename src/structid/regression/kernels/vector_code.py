"""What the compiled kernels' vector instructions are built from: loops, numbers in all lanes, sums over lanes."""

from __future__ import annotations

from collections.abc import Sequence

from llvmlite import binding, ir
from numba.core import cgutils

F64, I64, I32, BOOL = ir.DoubleType(), ir.IntType(64), ir.IntType(32), ir.IntType(1)
#: What sums and products may do: fuse and reorder, nothing else.
FLAGS = ("contract", "reassoc", "nsz")
#: Doubles of a vector register.
LANES = 8 if binding.get_host_cpu_features().get("avx512f") else 4
WIDE = ir.VectorType(F64, LANES)


class Loop:
    """for i from `start`, by `step`, while i + step <= stop, with values carried from one turn to the next."""

    def __init__(self, builder, start, stop, step, carried=()):
        self.builder, before = builder, builder.block
        self.head, self.body, self.end = (builder.append_basic_block(name) for name in ("head", "body", "end"))
        builder.branch(self.head)
        builder.position_at_end(self.head)
        self.index = builder.phi(I64)
        self.index.add_incoming(start, before)
        self.carried = [builder.phi(value.type) for value in carried]
        for phi, value in zip(self.carried, carried, strict=True):
            phi.add_incoming(value, before)
        self.following = builder.add(self.index, I64(step))
        builder.cbranch(builder.icmp_unsigned("<=", self.following, stop), self.body, self.end)
        builder.position_at_end(self.body)

    def close(self, carried=()):
        """End the body; `carried` are the values that the next turn begins with."""
        here = self.builder.block
        self.builder.branch(self.head)
        self.index.add_incoming(self.following, here)
        for phi, value in zip(self.carried, carried, strict=True):
            phi.add_incoming(value, here)
        self.builder.position_at_end(self.end)


def called(builder, name, result, arguments, body):
    """Call a function of its own, which `body` of its builder and arguments makes: once in the code, never inlined.

    Large pieces in many places of one function spoil the compiler's choice of registers everywhere.
    """
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    function = cgutils.get_or_insert_function(builder.module, kind, f"structid_{name}")
    if function.is_declaration:
        function.linkage = "linkonce_odr"
        function.attributes.add("noinline")
        inner = ir.IRBuilder(function.append_basic_block("entry"))
        inner.ret(body(inner, function.args))
    return builder.call(function, arguments)


def lanes(kind) -> int:
    """How many numbers a value of this kind holds."""
    return 1 if kind == F64 else kind.count


def zero(kind):
    """Zero in all lanes."""
    return ir.Constant(kind, 0.0 if kind == F64 else None)


def spread(builder, value, kind):
    """One number in all lanes."""
    if kind == F64:
        return value
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, I32(0))
    places = ir.Constant(ir.VectorType(I32, kind.count), None)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), places)


def row_starts(builder, first, width, count) -> list:
    """Where `count` rows begin, each `width` after the one before."""
    starts = [first]
    while len(starts) < count:
        starts.append(builder.add(starts[-1], width))
    return starts


def place(builder, base, at, kind):
    """Where the value of this kind that begins with number `at` lies."""
    return builder.bitcast(builder.gep(base, [at]), kind.as_pointer())


def read(builder, base, at, kind):
    """The value of this kind that begins with number `at`."""
    return builder.load(place(builder, base, at, kind), align=8)


def plus_product(builder, total, a, b):
    """Total + a b, fused."""
    return builder.fadd(total, builder.fmul(a, b, flags=FLAGS), flags=FLAGS)


def minus_product(builder, total, a, b):
    """Total - a b, fused."""
    return builder.fsub(total, builder.fmul(a, b, flags=FLAGS), flags=FLAGS)


def lane_sums(builder, vectors: Sequence) -> list:
    """Vectors that hold the sum over the lanes of each of `vectors`, one after the other, filled up with zeros.

    Neighbours are added crosswise, halves, then quarters, so that all sums together take as many steps as a few alone.
    """
    padded = [*vectors, *[zero(WIDE)] * (-len(vectors) % LANES)]
    sums = []
    for first in range(0, len(padded), LANES):
        part, run = padded[first : first + LANES], 1
        while len(part) > 1:
            part = [_crosswise(builder, a, b, run) for a, b in zip(part[::2], part[1::2], strict=True)]
            run *= 2
        sums += part
    return sums


def _crosswise(builder, a, b, run):
    """Neighbouring runs of lanes added, those of `a` and of `b` taking turns."""
    starts = [lane // (2 * run) * 2 * run + lane % run + (lane // run % 2) * LANES for lane in range(LANES)]
    kind = ir.VectorType(I32, LANES)
    low = builder.shuffle_vector(a, b, ir.Constant(kind, starts))
    high = builder.shuffle_vector(a, b, ir.Constant(kind, [start + run for start in starts]))
    return builder.fadd(low, high, flags=FLAGS)

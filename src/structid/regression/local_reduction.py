"""Rows of every block made from fields and folded into its triangle, compiled where numba is installed.

The compiled way never writes the rows to memory: it reads each field once and costs a few times the sum of the same
numbers. Where the rows of a block are well conditioned it takes the triangle from their products, to 1e-13 of a QR;
everywhere else, as NumPy does, by Householder's reflections. Blocks are independent, so threads share them out,
and the answer does not depend on how many there are.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.arrays import FloatArray, IntArray, require_shape
from structid.errors import InputError

Engine = Literal["auto", "numba", "numpy"]

#: Below so many samples times blocks, loading the compiled kernels takes longer than NumPy does in all.
COMPILED_FROM = 200_000
_ROW_ENTRIES = 125_000
_TOGETHER = 3  # blocks whose rows are made at once
_LONGEST = 640  # samples at a time
_NARROW_ROWS, _ROWS = 4_800, 8_000  # numbers of the rows of narrow and of wide blocks at a time
_NARROW = 9  # rows of a block that may go by reflections, which want it near the first-level cache
_NARROW_FIELDS, _FIELDS = 60_000, 300_000  # numbers of the fields that their rows are made from between two triangles


@dataclass(frozen=True, eq=False)
class Kernels:
    """How rows are folded.

    Parameters
    ----------
    engine : {"auto", "numba", "numpy"}
        ``auto`` takes numba where it is installed and the work is large enough to load it.
    threads : int
        Of the compiled kernels.
    """

    engine: Engine = "auto"
    threads: int = 1

    def __post_init__(self) -> None:
        if self.engine not in ("auto", "numba", "numpy"):
            raise InputError(f"`engine` must be 'auto', 'numba' or 'numpy', got {self.engine!r}")
        if self.threads < 1:
            raise InputError(f"`threads` must be 1 or more, got {self.threads}")
        if self.engine == "numba" and not has_numba():
            raise InputError("`engine` is 'numba', which is not installed; pip install structid[fast], or use 'auto'")

    def compiled(self, size: int) -> bool:
        """Whether work on so many samples times blocks is done by the compiled kernels."""
        return self.engine == "numba" or (self.engine == "auto" and size >= COMPILED_FROM and has_numba())

    def words(self, size: int) -> str:
        """The choice for work of this size, as a reader should know it."""
        if not self.compiled(size):
            return "NumPy" if has_numba() or self.engine == "numpy" else "NumPy (structid[fast] would compile it)"
        import numba

        return f"numba {numba.__version__}, {self.threads} thread{'s' if self.threads > 1 else ''}"


def has_numba() -> bool:
    """Whether numba is installed; it is not imported."""
    return importlib.util.find_spec("numba") is not None


def kernels() -> Any:
    """The module of compiled kernels of the reduction."""
    from structid.regression.kernels import local as local_kernels

    return local_kernels


def banded_kernels() -> Any:
    """The module of compiled kernels of the sweep and of many small problems."""
    from structid.regression.kernels import banded as banded_kernels

    return banded_kernels


def shared_out(n: int, threads: int, work: Callable[[int, int], Any]) -> None:
    """`work(first, last)` on `threads` equal parts of range(n) at once."""
    edges = [n * k // threads for k in range(threads + 1)]
    parts = [(a, b) for a, b in pairwise(edges) if b > a]
    if len(parts) <= 1:
        for part in parts:
            work(*part)
        return
    with ThreadPoolExecutor(len(parts)) as pool:
        for done in [pool.submit(work, *part) for part in parts]:
            done.result()


def block_widths(columns: IntArray) -> IntArray:
    """Number of columns in use of each block, (n_blocks,); unused ones, -1, must come last."""
    widths = (columns >= 0).sum(axis=1)
    if (columns[np.arange(columns.shape[1]) < widths[:, None]] < 0).any():
        raise InputError("unused columns (-1) must come last in every block")
    return np.asarray(widths)


@dataclass(frozen=True, eq=False)
class RowMaker:
    """What makes the rows of every block from fields; made once for all chunks of a record.

    Attributes
    ----------
    operator : (n_blocks (k + 1), n_fields) sparse array
        Regressors of every block and its right-hand side from the fields of one sample.
    widths : (n_blocks,) int array
        Columns in use of each block.
    starts : (n_blocks (k + 1) + 1,) int array
        Where the entries of each row begin.
    which : (n_entries,) unsigned int array
        Field of each entry.
    alike : (n_blocks (k + 1),) int array
        How many rows after each, a block further every time and made with it, are of the same fields.
    heads : (n_groups + 1,) int array
        Where each group of neighbouring blocks with the same columns begins.
    new : unsigned int array
        The fields of each group that the group before it does not use, one group after another.
    news : (n_groups + 1,) int array
        Where those of each group begin.
    reach : float
        Fields that a group uses, on average.
    """

    operator: sparse.csr_array
    widths: IntArray
    starts: IntArray
    which: NDArray[np.uint32]
    alike: NDArray[np.int8]
    heads: IntArray
    new: NDArray[np.uint32]
    news: IntArray
    reach: float


def row_maker(operator: sparse.csr_array, columns: IntArray) -> RowMaker:
    """The `RowMaker` of blocks with these columns, -1, last in its row, where a block has fewer."""
    side = columns.shape[1] + 1
    require_shape("operator", operator, (columns.shape[0] * side, None))
    starts, which = operator.indptr.astype(np.int64, copy=False), operator.indices.astype(np.int32, copy=False)
    which = which.view(np.uint32)
    heads = _groups(columns)
    alike = _alike(starts, which, heads, side)
    n_groups = len(heads) - 1
    group = np.repeat(np.arange(n_groups), np.diff(starts[heads * side]))
    uses = np.unique(which * np.int64(n_groups + 1) + group)
    first = np.ones(len(uses), dtype=bool)
    first[1:] = np.diff(uses) != 1  # not used by the group before
    new, group = np.divmod(uses[first], n_groups + 1)
    order = np.argsort(group, kind="stable")
    news = np.searchsorted(group[order], np.arange(n_groups + 1))
    reach = len(uses) / max(1, n_groups)
    return RowMaker(
        operator, block_widths(columns), starts, which, alike, heads, new[order].astype(np.uint32), news, reach
    )


def only_operator(operator: sparse.csr_array) -> RowMaker:
    """A `RowMaker` for what does not go block by block: its operator, and nothing else."""
    none, unsigned = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint32)
    return RowMaker(operator, none, none, unsigned, none.astype(np.int8), none, unsigned, none, 0.0)


def _groups(columns: IntArray) -> IntArray:
    """Where groups of at most `_TOGETHER` neighbouring blocks with the same columns begin, and the end."""
    fresh = np.ones(len(columns), dtype=bool)
    fresh[1:] = (columns[1:] != columns[:-1]).any(axis=1)
    begin = np.flatnonzero(fresh)
    since = np.arange(len(columns)) - begin[np.cumsum(fresh) - 1]
    return np.append(np.flatnonzero(since % _TOGETHER == 0), len(columns))


def _alike(starts: IntArray, which: NDArray[np.uint32], heads: IntArray, side: int) -> NDArray[np.int8]:
    """How many rows, each `side` after the other and within one group, use the fields of each row; 2 at most."""
    count = np.diff(starts)
    n_rows = len(count)
    block = np.arange(n_rows) // side
    again = np.zeros(n_rows, dtype=bool)
    if n_rows > side:
        again[:-side] = count[:-side] == count[side:]
    again[np.isin(block, heads[1:] - 1)] = False  # the last of a group
    row = np.repeat(np.arange(n_rows), count)
    entry = np.flatnonzero(again[row])
    other = entry + starts[row[entry] + side] - starts[row[entry]]
    again[row[entry[which[entry] != which[other]]]] = False
    alike = again.astype(np.int8)
    if n_rows > side:
        alike[:-side] += again[:-side] & again[side:]
    return alike


def folded_fields(triangles: FloatArray, maker: RowMaker, fields: FloatArray, work: Kernels) -> FloatArray:
    """Triangles of [triangle; rows of all samples], (n_blocks, k + 1, k + 1).

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
    maker : RowMaker
    fields : (n_fields, n_times) float array
    work : Kernels
    """
    n_blocks, side = triangles.shape[:2]
    require_shape("fields", fields, (maker.operator.shape[1], None))
    if not work.compiled(n_blocks * fields.shape[1]):
        return _folded_by_numpy(triangles, maker.operator, fields)
    found = np.array(triangles)
    flat = np.ascontiguousarray(fields, dtype=np.float64).reshape(-1)
    n_times = fields.shape[1]
    inner, outer = stretches(n_times, side, maker.reach)
    kernel, data = kernels().fold_fields, maker.operator.data

    def part(first: int, last: int) -> None:
        kernel(
            found, flat, n_times, maker.starts, maker.which, data, maker.widths, maker.alike, maker.heads, maker.new,
            maker.news, first, last, outer, inner,
        )  # fmt: skip

    shared_out(len(maker.heads) - 1, work.threads, part)
    return found


def stretches(n_times: int, side: int, reach: float) -> tuple[int, int]:
    """Samples at a time whose rows stay in the cache, and a multiple of them whose `reach` fields do."""
    rows, fields = (_NARROW_ROWS, _NARROW_FIELDS) if side <= _NARROW else (_ROWS, _FIELDS)
    most = min(_LONGEST, max(64, rows // side // 32 * 32))
    parts = max(1, -(-n_times // most))
    inner = min(n_times, -(-n_times // parts // 32) * 32) if n_times else 1
    outer = max(inner, int(fields / max(reach, 1.0)) // inner * inner)
    return inner, outer


def _folded_by_numpy(triangles: FloatArray, operator: sparse.csr_array, fields: FloatArray) -> FloatArray:
    n_blocks, side = triangles.shape[:2]
    found = np.array(triangles)
    samples = max(1, min(fields.shape[1], _ROW_ENTRIES // (8 * side)))
    blocks = max(1, _ROW_ENTRIES // (side * samples))
    for first in range(0, n_blocks, blocks):
        last = min(first + blocks, n_blocks)
        part = operator[first * side : last * side] if blocks < n_blocks else operator
        for at in range(0, fields.shape[1], samples):
            rows = (part @ fields[:, at : at + samples]).reshape(last - first, side, -1)
            stacked = np.concatenate([found[first:last], np.swapaxes(rows, 1, 2)], axis=1)
            found[first:last] = np.linalg.qr(stacked, mode="r")
    return found

"""Rows of every block made from fields and folded into its triangle, compiled where numba is installed.

Both ways do the same Householder QR and agree to rounding. The compiled one never writes the rows to memory: it reads
each field once and costs a few times the sum of the same numbers. Blocks are independent, so threads share them out,
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
from scipy import sparse

from structid.arrays import FloatArray, IntArray, require_shape
from structid.errors import InputError

Engine = Literal["auto", "numba", "numpy"]

#: Below so many samples times blocks, loading the compiled kernels takes longer than NumPy does in all.
COMPILED_FROM = 200_000
_ROW_ENTRIES = 125_000
_FIRST_CACHE, _SECOND_CACHE = 3_200, 60_000  # numbers of the rows of a block, and of the fields they are made from


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
    """The module of compiled kernels."""
    from structid.estimation import local_kernels

    return local_kernels


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
    new : unsigned int array
        The fields that each block is the first to use, one block after another.
    news : (n_blocks + 1,) int array
        Where those of each block begin.
    """

    operator: sparse.csr_array
    widths: IntArray
    starts: IntArray
    which: IntArray
    new: IntArray
    news: IntArray


def row_maker(operator: sparse.csr_array, columns: IntArray) -> RowMaker:
    """The `RowMaker` of blocks with these columns, -1, last in its row, where a block has fewer."""
    require_shape("operator", operator, (columns.shape[0] * (columns.shape[1] + 1), None))
    starts = operator.indptr.astype(np.int64)
    edges = starts[:: columns.shape[1] + 1]
    first = np.full(operator.shape[1], -1, dtype=np.int64)
    first[operator.indices[::-1]] = np.arange(operator.nnz - 1, -1, -1)  # the last one written is the first use
    new = np.flatnonzero(first >= 0)
    new = new[np.argsort(first[new])]
    news = np.searchsorted(first[new], edges)
    return RowMaker(operator, block_widths(columns), starts, operator.indices.astype(np.uint32), new, news)


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
    inner, outer = stretches(n_times, side, len(maker.which) / max(1, n_blocks))
    kernel, data = kernels().fold_fields, maker.operator.data

    def part(first: int, last: int) -> None:
        kernel(
            found, flat, n_times, maker.starts, maker.which, data, maker.widths, maker.new, maker.news,
            first, last, outer, inner,
        )  # fmt: skip

    shared_out(n_blocks, work.threads, part)
    return found


def stretches(n_times: int, side: int, entries: float) -> tuple[int, int]:
    """Samples at a time whose rows stay in the first-level cache, and whose fields stay in the second."""
    most = max(64, _FIRST_CACHE // side // 32 * 32)
    parts = max(1, -(-n_times // most))
    inner = min(n_times, -(-n_times // parts // 8) * 8) if n_times else 1
    outer = max(inner, int(_SECOND_CACHE / max(entries, 1.0)) // inner * inner)
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

"""Rows of every block made from fields and folded into its triangle, compiled where numba is installed.

The compiled way never writes the rows to memory: it costs a few times the sum of the fields. Where the rows of a block
are well conditioned it takes the triangle from their products, to 1e-13 of a QR; everywhere else, as NumPy does, by
Householder's reflections. Blocks are independent, so threads share them out, and the answer does not depend on how many
there are.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, require_shape
from structid.core.errors import InputError

Engine = Literal["auto", "numba", "numpy"]

#: Below so many samples times blocks, loading the compiled kernels takes longer than NumPy does in all.
COMPILED_FROM = 200_000
_ROW_ENTRIES = 125_000
_TOGETHER = 3  # blocks whose rows are made at once
_SHORTEST, _LONGEST, _ENTRIES = 64, 2048, 60_000  # samples, and numbers of a block's rows, folded at once


@dataclass(frozen=True, eq=False)
class FoldingKernels:
    """Folding of rows.

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
        """Raise `InputError` on an unknown engine, fewer than one thread, or numba not installed."""
        if self.engine not in ("auto", "numba", "numpy"):
            raise InputError(f"`engine` must be 'auto', 'numba' or 'numpy', got {self.engine!r}")
        if self.threads < 1:
            raise InputError(f"`threads` must be 1 or more, got {self.threads}")
        if self.engine == "numba" and not has_numba():
            raise InputError("`engine` is 'numba', which is not installed; pip install structid[fast], or use 'auto'")

    def compiled(self, size: int) -> bool:
        """True where work of this `size` (samples times blocks) is done by the compiled kernels."""
        return self.engine == "numba" or (self.engine == "auto" and size >= COMPILED_FROM and has_numba())

    def words(self, size: int) -> str:
        """Name of the engine used for work of this `size` (samples times blocks).

        For numba with version and number of threads; for NumPy with a hint if numba is not installed but would be used.
        """
        if not self.compiled(size):
            return "NumPy" if has_numba() or self.engine == "numpy" else "NumPy (structid[fast] would compile it)"
        import numba

        return f"numba {numba.__version__}, {self.threads} thread{'s' if self.threads > 1 else ''}"


def has_numba() -> bool:
    """True where numba is installed; it is not imported."""
    return importlib.util.find_spec("numba") is not None


def shared_out(n: int, threads: int, work: Callable[[int, int], object]) -> None:
    """Call `work(first, last)` in parallel on at most `threads` nearly equal parts of range(n); exceptions are passed on."""
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
    """Number of used columns of each block, (n_blocks,).

    `columns` (n_blocks, k) are parameter indices, -1 for unused columns. Raises `InputError` if an unused column is not last.
    """
    widths = (columns >= 0).sum(axis=1)
    if (columns[np.arange(columns.shape[1]) < widths[:, None]] < 0).any():
        raise InputError("unused columns (-1) must come last in every block")
    return np.asarray(widths)


class Blocks(NamedTuple):
    """The rows of an operator block by block, as compiled code takes them.

    Attributes
    ----------
    starts : (n_blocks (k + 1) + 1,) int array
        Where the entries of each row begin.
    which, data : (n_entries,) int and float arrays
        Field and factor of each entry.
    widths : (n_blocks,) int array
        Columns in use of each block.
    heads : (n_groups + 1,) int array
        Where each group of neighbouring blocks with the same columns begins; three blocks at most.
    """

    starts: IntArray
    which: NDArray[np.int32]
    data: FloatArray
    widths: IntArray
    heads: IntArray


@dataclass(frozen=True, eq=False)
class RowMaker:
    """Operator from fields to the rows of every block; made once for all chunks of a record.

    Attributes
    ----------
    operator : (n_blocks (k + 1), n_fields) sparse array
        Regressors of every block and its right-hand side from the fields of one sample.
    blocks : Blocks, optional
        None where the operator does not go block by block.
    """

    operator: sparse.csr_array
    blocks: Blocks | None


def row_maker(operator: sparse.csr_array, columns: IntArray) -> RowMaker:
    """`RowMaker` of an operator from the fields of one sample to the rows of blocks.

    `operator` is sparse (n_blocks (k + 1), n_fields), right-hand side last in each block; `columns` (n_blocks, k) are parameter
    indices, -1 last where a block has fewer. Raises `InputError` if the shapes differ.
    """
    require_shape("operator", operator, (columns.shape[0] * (columns.shape[1] + 1), None))
    starts, which = operator.indptr.astype(np.int64, copy=False), operator.indices.astype(np.int32, copy=False)
    return RowMaker(operator, Blocks(starts, which, operator.data, block_widths(columns), _groups(columns)))


def only_operator(operator: sparse.csr_array) -> RowMaker:
    """A `RowMaker` for what does not go block by block."""
    return RowMaker(operator, None)


def _groups(columns: IntArray) -> IntArray:
    """Index of the first block of each group of neighbours with equal columns, and the number of blocks as last entry.

    A group has three blocks at most. `columns` is (n_blocks, k), the result (n_groups + 1,).
    """
    fresh = np.ones(len(columns), dtype=bool)
    fresh[1:] = (columns[1:] != columns[:-1]).any(axis=1)
    begin = np.flatnonzero(fresh)
    since = np.arange(len(columns)) - begin[np.cumsum(fresh) - 1]
    return np.append(np.flatnonzero(since % _TOGETHER == 0), len(columns))


def folded_fields(triangles: FloatArray, maker: RowMaker, fields: FloatArray, work: FoldingKernels) -> FloatArray:
    """New block triangles (n_blocks, k + 1, k + 1): the old ones updated by the rows that `maker` forms of `fields`.

    Every sample of the fields gives one row for each block. Compiled if `work` says so for this size and the operator
    goes block by block, else by NumPy.

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
        Triangle of each block, right-hand side last; it is not changed.
    maker : RowMaker
        Operator from the fields of one sample to the rows of all blocks.
    fields : (n_fields, n_times) float array
        Samples from which the rows are formed.
    work : FoldingKernels
        Engine and number of threads.

    Raises
    ------
    InputError
        If the number of fields is not that of the operator.
    """
    n_blocks, side = triangles.shape[:2]
    require_shape("fields", fields, (maker.operator.shape[1], None))
    blocks = maker.blocks
    if blocks is None or not work.compiled(n_blocks * fields.shape[1]):
        return _folded_by_numpy(triangles, maker.operator, fields)
    from structid.inversion.regression.compiled import fold_fields

    folded, values = np.array(triangles), np.ascontiguousarray(fields, dtype=np.float64)
    longest = min(_LONGEST, max(_SHORTEST, _ENTRIES // side))
    groups = len(blocks.heads) - 1
    shared_out(groups, work.threads, lambda first, last: fold_fields(folded, values, blocks, first, last, longest))
    return folded


def _folded_by_numpy(triangles: FloatArray, operator: sparse.csr_array, fields: FloatArray) -> FloatArray:
    """New block triangles (n_blocks, k + 1, k + 1): the old ones updated by QR with rows `operator` @ `fields`, in NumPy.

    `operator` is sparse (n_blocks (k + 1), n_fields), `fields` are (n_fields, n_times).
    """
    n_blocks, side = triangles.shape[:2]
    folded = np.array(triangles)
    samples = max(1, min(fields.shape[1], _ROW_ENTRIES // (8 * side)))
    blocks = max(1, _ROW_ENTRIES // (side * samples))
    for first in range(0, n_blocks, blocks):
        last = min(first + blocks, n_blocks)
        part = operator[first * side : last * side] if blocks < n_blocks else operator
        for at in range(0, fields.shape[1], samples):
            rows = (part @ fields[:, at : at + samples]).reshape(last - first, side, -1)
            stacked = np.concatenate([folded[first:last], np.swapaxes(rows, 1, 2)], axis=1)
            folded[first:last] = np.linalg.qr(stacked, mode="r")
    return folded

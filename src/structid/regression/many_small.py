"""Many small least-squares problems of one layout at once, as the repeats of a simulation make them."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray, require_finite, require_shape
from structid.regression.banded_sweep import band_layout
from structid.regression.block_least_squares import block_solution
from structid.regression.local_reduction import Kernels, RowMaker, banded_kernels, row_maker, shared_out, stretches
from structid.regression.streaming_qr import no_rows


def solutions_of_many(
    rows: RowMaker | sparse.csr_array, columns: IntArray, n_params: int, fields: FloatArray, work: Kernels | None = None
) -> FloatArray:
    """Least-squares values of every problem, (n_problems, n_params); NaN where one does not determine a parameter.

    Each problem's rows are folded and solved while they are in the cache, so that a 15-element beam costs some tens of
    microseconds instead of the call of a dense solver.

    Parameters
    ----------
    rows : RowMaker or (n_blocks (n_columns + 1), n_fields) sparse array
        Regressors of every block, its right-hand side last, from the fields of one sample; the same for all problems.
    columns : (n_blocks, n_columns) int array
        Parameter of each column, -1, last in its row, where a block has fewer.
    n_params : int
    fields : (n_problems, n_fields, n_times) float array
    work : Kernels, optional
    """
    chosen = work or Kernels()
    maker, n_blocks = rows if isinstance(rows, RowMaker) else row_maker(rows, columns), len(columns)
    require_shape("fields", fields, (None, maker.operator.shape[1], None))
    if not np.isfinite(fields.sum()):  # much faster than a look at each, and true of nearly all
        require_finite("fields", fields)
    values = np.empty((len(fields), n_params))
    start = no_rows(columns, n_params)
    if not chosen.compiled(len(fields) * n_blocks * fields.shape[2]):
        for k, own in enumerate(fields):
            values[k] = block_solution(start.reduced(maker, own, Kernels("numpy")), work=Kernels("numpy")).values
        return values
    layout, given = band_layout(columns, n_params), np.ascontiguousarray(fields, dtype=np.float64)
    places = np.where(columns >= 0, layout.place[columns], -1)
    inner, _ = stretches(fields.shape[2], columns.shape[1] + 1, maker.reach)
    compiled = banded_kernels()

    def part(first: int, last: int) -> None:
        compiled.many_solved(
            given, maker.starts, maker.which, maker.operator.data, maker.widths, columns.shape[1] + 1,
            places, layout.order, layout.low, layout.high, layout.width, values, inner, first, last,
        )  # fmt: skip

    shared_out(len(fields), chosen.threads, part)
    found = values[:, layout.place]
    weak = ~np.isfinite(found).all(axis=1)
    for k in np.flatnonzero(weak).tolist():  # the careful way says which parameters are lost
        found[k] = block_solution(start.reduced(maker, given[k], Kernels("numpy")), work=Kernels("numpy")).values
    return found

"""Linear least squares over a record of any length: one pass, a small triangle a block of equations, no dense matrix.

A regression matrix of structural dynamics is sparse in a simple way: the equations of one degree of freedom hold only
the few parameters of the elements around it. Each such block of rows keeps the triangle [R_d | z_d] of a QR
factorization over its own columns; new rows enter by one more QR, and so do the triangles of another part of the
record. Products B'B, which square the condition, are made of single blocks only, and count only where they prove to be
well conditioned (see `compiled`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_finite, require_shape
from structid.core.errors import InputError
from structid.inversion.regression.local_reduction import FoldingKernels, RowMaker, folded_fields, row_maker

#: A column, or a direction of unit columns, below this part of what it could be is lost in rounding.
RANK_TOLERANCE = 1e-10
_FOLD_ENTRIES = 8_000_000


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Solution of min ||B p - c||^2 from its triangle.

    Attributes
    ----------
    values : (n_params,) float array
        NaN where a parameter takes part in a direction that the rows do not determine.
    covariance : (n_params, n_params) float array
        residual_variance (B'B)^-1; NaN in the same places, and everywhere without degrees of freedom.
    seen : (n_params,) bool array
        Whether the parameter's column stands above rounding.
    rank : int
        Of B with unit columns.
    condition : float
        Largest over smallest singular value of B with unit columns; infinite below full rank.
    residual_sum : float
        ||B p - c||^2.
    degrees_of_freedom : int
        Rows less rank.
    residual_variance : float
        Their ratio; NaN without degrees of freedom.
    triangle : (n_params, n_params) float array
        R with R'R = B'B, columns not seen set to zero.
    """

    values: FloatArray
    covariance: FloatArray
    seen: np.ndarray
    rank: int
    condition: float
    residual_sum: float
    degrees_of_freedom: int
    residual_variance: float
    triangle: FloatArray


@dataclass(frozen=True, eq=False)
class StreamingQr:
    """The state of a linear least-squares problem after some of its rows; a value, never changed in place.

    Attributes
    ----------
    columns : (n_blocks, n_columns) int array
        Parameter that each column of each block stands for; -1 where a block has fewer.
    n_params : int
    triangles : (n_blocks, n_columns + 1, n_columns + 1) float array
        [R_d | z_d] of each block, right-hand side last.
    n_rows : int
        Rows seen so far, all blocks together.
    """

    columns: IntArray
    n_params: int
    triangles: FloatArray
    n_rows: int

    def updated(self, rows: FloatArray) -> StreamingQr:
        """New QR state after further rows of regressors and right-hand side.

        Parameters
        ----------
        rows : (n_blocks, n_new, n_columns + 1) float array
            Regressors of each block in the order of `columns`, right-hand side last.

        Raises
        ------
        InputError
            If the shape is wrong or an entry is not finite.
        """
        require_shape("rows", rows, (len(self.columns), None, self.columns.shape[1] + 1))
        require_finite("rows", rows)
        triangles = stacked_triangles(self.triangles, rows)
        return replace(self, triangles=locked(triangles), n_rows=self.n_rows + rows.shape[0] * rows.shape[1])

    def reduced(
        self, rows: RowMaker | sparse.csr_array, fields: FloatArray, work: FoldingKernels | None = None
    ) -> StreamingQr:
        """New QR state after the equations that `rows` forms of the samples in `fields`, made in pieces to save memory.

        Every sample gives one equation for each block.

        Parameters
        ----------
        rows : RowMaker or (n_blocks (n_columns + 1), n_fields) sparse array
            Regressors of every block, its right-hand side last, from the fields of one sample.
        fields : (n_fields, n_times) float array
            Samples.
        work : FoldingKernels, optional
            Compiled or not, and on how many threads; compiled where that pays and numba is installed by default.

        Raises
        ------
        InputError
            If the number of fields is not that of `rows`.
        """
        maker = rows if isinstance(rows, RowMaker) else row_maker(rows, self.columns)
        triangles = folded_fields(self.triangles, maker, fields, work or FoldingKernels())
        triangles.setflags(write=False)
        return replace(self, triangles=triangles, n_rows=self.n_rows + len(self.columns) * fields.shape[1])

    def merged(self, other: StreamingQr) -> StreamingQr:
        """QR state of the rows of this and the `other` state together, in either order.

        Raises
        ------
        InputError
            If the two do not have the same columns.
        """
        if other.n_params != self.n_params or not np.array_equal(other.columns, self.columns):
            raise InputError("states of different problems cannot be merged; make both from the same equations")
        triangles = stacked_triangles(self.triangles, other.triangles)
        return replace(self, triangles=locked(triangles), n_rows=self.n_rows + other.n_rows)

    def triangle(self) -> FloatArray:
        """[R | z] of all blocks together, (n_params + 1, n_params + 1)."""
        return folded_triangle(self.triangles, self.columns, self.n_params)

    def solution(self, size: FloatArray | None = None) -> LinearFit:
        """The least-squares solution of all rows seen.

        Parameters
        ----------
        size : (n_params,) float array, optional
            What the norm of each column would be if nothing cancelled in it. A column below 1e-10 of it is rounding
            and counts as zero, which column scaling alone would not notice.
        """
        return triangle_solution(self.triangle(), self.n_rows, size)


def no_rows(columns: IntArray, n_params: int) -> StreamingQr:
    """QR state before any row, for blocks with the parameter indices `columns` (n_blocks, k), -1 where a block has fewer.

    Raises
    ------
    InputError
        If an index is below -1 or not below `n_params`.
    """
    table = locked(columns, np.int64)
    require_shape("columns", table, (None, None))
    if table.size and (table.max() >= n_params or table.min() < -1):
        raise InputError(f"`columns` must lie from -1 to {n_params - 1}, got up to {table.max()}")
    side = table.shape[1] + 1
    triangles = np.zeros((table.shape[0], side, side))  # not copied: untouched zeros take no memory
    triangles.setflags(write=False)
    return StreamingQr(table, n_params, triangles, 0)


def stacked_triangles(triangles: FloatArray, rows: FloatArray) -> FloatArray:
    """QR triangles (..., k, k) of the stacks [triangle; rows] of all blocks.

    `triangles` are (..., k, k), `rows` (..., n_rows, k).
    """
    return np.asarray(np.linalg.qr(np.concatenate([triangles, rows], axis=-2), mode="r"))


def folded_triangle(triangles: FloatArray, columns: IntArray, n_params: int) -> FloatArray:
    """Upper triangle [R | z] over all parameters, from the triangles of blocks of few parameters each.

    The last row holds the residual norm of all blocks.

    Parameters
    ----------
    triangles : (..., n_blocks, k + 1, k + 1) float array
        Triangle of each block, right-hand side in the last column. Leading axes are independent problems, such as the
        repeats of a simulation.
    columns : (n_blocks, k) int array
        Parameters of each block, -1 where it has fewer.
    n_params : int
        Number of all parameters.

    Returns
    -------
    (..., n_params + 1, n_params + 1) float array
    """
    batch, side = triangles.shape[:-3], triangles.shape[-1]
    columns_at = np.concatenate([columns, np.full((len(columns), 1), n_params)], axis=1)
    # columns without a parameter go to one more, dropped below
    columns_at = np.where(columns_at < 0, n_params + 1, columns_at)
    total = np.zeros((*batch, n_params + 1, n_params + 1))
    step = max(1, (n_params + 1) // side, _FOLD_ENTRIES // (side * (n_params + 2) * max(1, int(np.prod(batch)))))
    for first in range(0, len(columns), step):
        part = columns_at[first : first + step]
        wide = np.zeros((*batch, len(part), side, n_params + 2))
        block = np.arange(len(part))[:, None, None]
        wide[..., block, np.arange(side)[:, None], part[:, None, :]] = triangles[..., first : first + step, :, :]
        rows = wide.reshape(*batch, len(part) * side, n_params + 2)[..., : n_params + 1]
        total = stacked_triangles(total, rows)
    return total


def triangle_solution(triangle: FloatArray, n_rows: int, size: FloatArray | None = None) -> LinearFit:
    """Least-squares solution from the triangle [R | z], (n_params + 1, n_params + 1), of `n_rows` rows.

    `size` (n_params,) is the norm that each column would have without cancellation; a column below 1e-10 of it counts
    as zero, and without `size` a column of zeros alone. Directions with a singular value below 1e-10 of the largest,
    with unit columns, are undetermined. Values of parameters in them are NaN.
    """
    n_params = len(triangle) - 1
    factor, right = np.array(triangle[:n_params, :n_params]), triangle[:n_params, n_params]
    norm = np.linalg.norm(factor, axis=0)
    seen = norm > (0.0 if size is None else RANK_TOLERANCE * size)
    factor[:, ~seen] = 0.0
    scale = np.where(seen, norm, 1.0)
    left, singular, rows = np.linalg.svd(factor / scale)
    sound = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    rank = int(sound.sum())
    if rank == n_params:
        values = linalg.solve_triangular(factor, right) if n_params else np.zeros(0)
    else:
        values = ((left[:, sound].T @ right) / singular[sound]) @ rows[sound] / scale
    unexplained = right - left[:, sound] @ (left[:, sound].T @ right) if rank < n_params else np.zeros(0)
    residual_sum = float(triangle[n_params, n_params] ** 2 + unexplained @ unexplained)
    freedom = n_rows - rank
    variance = residual_sum / freedom if freedom > 0 else np.nan
    covariance = variance * ((rows[sound].T / singular[sound] ** 2) @ rows[sound]) / np.outer(scale, scale)
    lost = ~seen | (np.abs(rows[~sound]) > 1e-6).any(axis=0)
    values = np.where(lost, np.nan, values)
    covariance[lost, :] = covariance[:, lost] = np.nan
    condition = float(singular[0] / singular[-1]) if n_params and rank == n_params else np.inf
    return LinearFit(
        locked(values),
        locked(covariance),
        locked(seen),
        rank,
        condition,
        residual_sum,
        max(freedom, 0),
        variance,
        locked(factor),
    )

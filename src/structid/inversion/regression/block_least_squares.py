"""The least-squares solution that the triangles of many small blocks hold, for any number of parameters.

Nothing dense of the size of the parameters is made. Columns are always scaled to unit norm. Where the blocks form a
chain, or anything narrow, their triangles are swept into one banded triangle; on wider meshes the compressed rows go
through sparse normal equations with one step of refinement on the rows themselves (Bjorck 1996, section 6.6.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse
from scipy.linalg import lapack, solve_triangular
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import SuperLU, splu

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.inversion.regression.streaming_qr import RANK_TOLERANCE, StreamingQr

#: Widest band that is swept; wider problems go through sparse normal equations.
WIDEST_BAND = 128
_LARGEST_BAND = 100_000_000  # numbers, for problems that only an orthogonal sweep resolves
_NORMAL_CONDITION = 1e7  # beyond it B'B holds nothing of the weakest direction
_STEPS = 12
_TOUCHED = 1e-6
_TOGETHER = 64
_KEPT_UP_TO = 100_000
_WINDOW = 48  # columns beyond the band that one step of the NumPy sweep takes at once


@dataclass(frozen=True, eq=False)
class BlockFit:
    """Solution of a least-squares problem of many parameters, with its factor.

    Attributes
    ----------
    values : (n_params,) float array
        NaN where a parameter takes part in a direction that the rows do not determine.
    seen : (n_params,) bool array
        Whether the parameter's column stands above rounding.
    rank : int
        Of B with unit columns, as far as the factor tells it.
    residual_sum : float
        ||B p - c||^2.
    degrees_of_freedom : int
    residual_variance : float
        Their ratio; NaN without degrees of freedom.
    method : str
        How it was solved, for the report.
    """

    values: FloatArray
    seen: np.ndarray
    rank: int
    residual_sum: float
    degrees_of_freedom: int
    residual_variance: float
    method: str
    _factor: _Band | _Normal
    _scale: FloatArray
    _state: StreamingQr

    @cached_property
    def condition(self) -> float:
        """Largest over smallest singular value of B with unit columns, estimated from inside; infinite below full rank."""
        full = self.rank == len(self.values)
        return _condition(self._factor, _rows(self._state, self._scale)[0]) if full else np.inf

    def covariance(self, indices: IntArray) -> FloatArray:
        """Covariance (k, k) of the parameters at `indices`, physical units; NaN for undetermined ones.

        NaN everywhere without degrees of freedom. `indices` is (k,).

        Raises
        ------
        InputError
            If an index is out of range.
        """
        chosen = np.asarray(indices, dtype=np.int64).ravel()
        if chosen.size and (chosen.min() < 0 or chosen.max() >= len(self.values)):
            raise InputError(
                f"`indices` must lie from 0 to {len(self.values) - 1}, got {chosen.min()} to {chosen.max()}"
            )
        units = np.zeros((len(self.values), len(chosen)))
        units[chosen, np.arange(len(chosen))] = 1.0
        inverse = self._factor.inverse(units)[chosen] * np.outer(self._scale[chosen], self._scale[chosen])
        lost = np.isnan(self.values[chosen])
        inverse[lost, :] = inverse[:, lost] = np.nan
        return np.asarray(self.residual_variance * inverse)

    def standard_deviations(self) -> FloatArray:
        """Standard deviation (n_params,) of every parameter in physical units; NaN for undetermined ones.

        NaN everywhere without degrees of freedom. It takes O(n_params) operations in a band, a solve each on a wider
        mesh.
        """
        variances = self._factor.diagonal() * self._scale**2 * self.residual_variance
        return np.where(np.isnan(self.values), np.nan, np.sqrt(variances))


@dataclass(frozen=True, eq=False)
class _Band:
    """A banded triangle of unit columns; columns left out have 1 on the diagonal and nothing else."""

    layout: BandLayout
    band: FloatArray

    def inverse(self, right: FloatArray) -> FloatArray:
        """(R'R)^-1 times the right-hand sides `right` (n_params, ...), in the order of the parameters; of the shape of `right`."""
        ordered = np.empty_like(right)
        ordered[self.layout.place] = right
        return solved(self.band, solved(self.band, ordered, transposed=True))[self.layout.place]

    def diagonal(self) -> FloatArray:
        return inverse_diagonal(self.band)[self.layout.place]


@dataclass(frozen=True, eq=False)
class _Normal:
    """A sparse factor of B'B with unit columns."""

    factor: SuperLU | None
    n_params: int

    def inverse(self, right: FloatArray) -> FloatArray:
        return np.full_like(right, np.nan) if self.factor is None else np.asarray(self.factor.solve(right))

    def diagonal(self) -> FloatArray:
        """Diagonal (n_params,) of the inverse of the normal matrix of columns scaled to unit norm."""
        diagonal = np.empty(self.n_params)
        for first in range(0, self.n_params, _TOGETHER):
            last = min(first + _TOGETHER, self.n_params)
            units = np.zeros((self.n_params, last - first))
            units[np.arange(first, last), np.arange(last - first)] = 1.0
            diagonal[first:last] = self.inverse(units)[np.arange(first, last), np.arange(last - first)]
        return diagonal


def block_solution(state: StreamingQr, size: FloatArray | None = None) -> BlockFit:
    """Least-squares solution of all rows reduced into the triangles of `state`, with NaN for undetermined parameters.

    A banded sweep if the band is at most 128 wide, else sparse normal equations; a wider band if these are too
    inaccurate. If that band would hold more than 1e8 numbers, all values are NaN.

    Parameters
    ----------
    state : StreamingQr
        Parameters of each block of rows, and its triangle.
    size : (n_params,) float array, optional
        Norm that each column would have if nothing cancelled in it: a column below 1e-10 of that counts as zero. By
        default only a column of zeros does.
    """
    norm = _column_norms(state)
    seen = norm > (0.0 if size is None else RANK_TOLERANCE * size)
    scale = np.where(seen, 1.0 / np.where(seen, norm, 1.0), 0.0)
    layout = band_layout(state.columns, state.n_params)
    if layout.width <= WIDEST_BAND:
        return _by_band(state, scale, layout)
    solution = _by_normal_equations(state, scale)
    if solution is not None:
        return solution
    if layout.width * state.n_params <= _LARGEST_BAND:
        return _by_band(state, scale, layout)
    return _unresolved(state, scale)


def _column_norms(state: StreamingQr) -> FloatArray:
    """Euclidean norm of the regressor of each parameter over all rows so far, (n_params,)."""
    used = state.columns >= 0
    squares = (state.triangles[:, :, :-1] ** 2).sum(axis=1)
    return np.sqrt(np.bincount(state.columns[used], squares[used], state.n_params))


def _by_band(state: StreamingQr, scale: FloatArray, layout: BandLayout) -> BlockFit:
    """Least-squares fit of all blocks by a banded orthogonal sweep, without undetermined columns.

    `scale` (n_params,) is the factor on each column, 0 for a column that is left out. Parameters without a column, with
    a diagonal entry of at most 1e-10, or in an undetermined direction with such a one are NaN. `state` has the triangle
    of each block, `layout` the order of parameters and blocks in the band.
    """
    band, right, rest = swept(state.triangles, state.columns, layout, scale)
    kept = scale > 0
    weak = (np.abs(band[layout.place, 0]) <= RANK_TOLERANCE) & kept
    lost = ~kept
    if weak.any():  # once more without these columns, so that nothing of the others is left in their rows
        rows, _ = _rows(state, scale)
        without = np.where(weak, 0.0, scale)
        band, right, rest = swept(state.triangles, state.columns, layout, without)
        kept = without > 0
    empty = np.empty(len(kept), dtype=bool)
    empty[layout.place] = ~kept
    rest += float((right[empty] ** 2).sum())
    band[empty], right[empty] = 0.0, 0.0
    band[empty, 0] = 1.0
    factor = _Band(layout, band)
    values = solved(band, right)[layout.place] * scale
    if weak.any():
        lost = lost | weak | _partners(rows, weak, factor)
    values[lost] = np.nan
    return _fit(state, values, scale, kept, rest, factor, f"banded orthogonal sweep, {layout.width} wide")


def _partners(rows: sparse.csr_array, weak: np.ndarray, factor: _Band) -> np.ndarray:
    """Mask (n_params,) of parameters that share an undetermined direction with the `weak` ones, which are False in it.

    `rows` (n_rows, n_params) have scaled columns; `factor` is the triangle without the `weak` (n_params,) columns. Two
    random mixtures of these are fitted by the others; those with a coefficient above 1e-6 in either count.
    """
    mixture = np.zeros((rows.shape[1], 2))
    mixture[weak] = np.random.default_rng(0).uniform(0.5, 1.5, (int(weak.sum()), 2))
    share = factor.inverse(np.where(weak[:, None], 0.0, rows.T @ (rows @ mixture)))
    return np.asarray((np.abs(share) > _TOUCHED).any(axis=1))


def _rows(state: StreamingQr, scale: FloatArray) -> tuple[sparse.csr_array, FloatArray]:
    """Sparse rows (n_rows, n_params) of the triangles of all blocks with scaled columns, and their right-hand sides.

    There are k rows for each block of k columns; the last of its triangle, the residual alone, is left out. `scale`
    (n_params,) is the factor on each column; the right-hand sides are (n_rows,). `state` has the triangles and the
    parameters of each block.
    """
    n_blocks, side = state.triangles.shape[:2]
    used = np.broadcast_to((state.columns >= 0)[:, None, :], (n_blocks, side - 1, side - 1))
    used = used & np.triu(np.ones((side - 1, side - 1), dtype=bool))
    column = np.broadcast_to(state.columns[:, None, :], used.shape)[used]
    row = np.broadcast_to(np.arange(n_blocks * (side - 1)).reshape(n_blocks, side - 1, 1), used.shape)[used]
    data = state.triangles[:, :-1, :-1][used] * scale[column]
    shape = (n_blocks * (side - 1), state.n_params)
    return sparse.csr_array((data, (row, column)), shape), state.triangles[:, :-1, -1].ravel()


def _by_normal_equations(state: StreamingQr, scale: FloatArray) -> BlockFit | None:
    """Least-squares fit of all blocks by sparse normal equations; None if they are singular, or the rows nearly so.

    The condition number of the scaled rows may be 1e7 at most. `state` has the triangles and the parameters of each
    block; `scale` (n_params,) is the factor on each column, 0 for a column that is left out.
    """
    rows, right = _rows(state, scale)
    kept = scale > 0
    normal = sparse.csc_array(rows.T @ rows + sparse.diags_array(np.where(kept, 0.0, 1.0)))
    try:
        factor = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return None
    scaled = factor.solve(rows.T @ right)
    scaled = scaled + factor.solve(rows.T @ (right - rows @ scaled))
    if not np.isfinite(scaled).all() or (factor.U.diagonal() <= 0).any():
        return None
    unexplained = right - rows @ scaled
    rest = float(unexplained @ unexplained + (state.triangles[:, -1, -1] ** 2).sum())
    values = np.where(kept, scaled * scale, np.nan)
    normal_factor = _Normal(factor, state.n_params)
    if not _condition(normal_factor, rows) <= _NORMAL_CONDITION:
        return None
    return _fit(state, values, scale, kept, rest, normal_factor, "sparse normal equations, one refinement")


def _unresolved(state: StreamingQr, scale: FloatArray) -> BlockFit:
    """Fit with all values NaN, where neither normal equations nor the band can solve the system.

    `scale` (n_params,) is the factor on each column, 0 where it has no effect. `state` has the blocks, which the fit
    keeps.
    """
    empty = locked(np.full(state.n_params, np.nan))
    seen = locked(scale > 0)
    nothing = _Normal(None, state.n_params)
    words = "not solved: some directions are below what sparse normal equations hold, and the band is too wide"
    return BlockFit(empty, seen, 0, np.nan, state.n_rows, np.nan, words, nothing, empty, state)


def _fit(
    state: StreamingQr,
    values: FloatArray,
    scale: FloatArray,
    kept: np.ndarray,
    rest: float,
    factor: _Band | _Normal,
    words: str,
) -> BlockFit:
    """`BlockFit` of given `values` (n_params,), with the residual variance, NaN without degrees of freedom.

    Parameters
    ----------
    state : StreamingQr
        Blocks that were solved.
    values : (n_params,) float array
        Solution, NaN for undetermined parameters.
    scale : (n_params,) float array
        Factor on each column, 0 for one without effect.
    kept : (n_params,) bool array
        Columns that are determined.
    rest : float
        Residual sum of squares.
    factor : _Band or _Normal
        Factor of the normal matrix with scaled columns.
    words : str
        Name of the method.
    """
    rank = int(kept.sum())
    freedom = state.n_rows - rank
    variance = rest / freedom if freedom > 0 else np.nan
    return BlockFit(
        locked(values),
        locked(scale > 0),
        rank,
        rest,
        max(freedom, 0),
        variance,
        words,
        factor,
        locked(scale),
        state,
    )


def _condition(factor: _Band | _Normal, rows: sparse.csr_array) -> float:
    """Estimate of the condition number of `rows`, largest over smallest singular value, by twelve steps of the power method.

    `factor` solves with the normal matrix of these rows; 1 without columns.
    """
    start = np.random.default_rng(0).standard_normal((rows.shape[1], 2))
    large = small = start / np.linalg.norm(start, axis=0)
    top = bottom = np.ones(2)
    for _ in range(_STEPS):
        large, small = rows.T @ (rows @ large), factor.inverse(small)
        top, bottom = np.linalg.norm(large, axis=0), np.linalg.norm(small, axis=0)
        large, small = large / top, small / bottom
    return float(np.sqrt(top.max() * bottom.max())) if rows.shape[1] else 1.0


@dataclass(frozen=True, eq=False)
class BandLayout:
    """Layout of the columns of blocks in a banded triangle.

    Attributes
    ----------
    place : (n_params,) int array
        Place of each parameter in the order of the band.
    order : (n_blocks,) int array
        Blocks by their first column; blocks without columns last.
    low, high : (n_blocks,) int arrays
        First and last place that each of them can touch, in that order.
    width : int
        Entries of a row of the band.
    """

    place: IntArray
    order: IntArray
    low: IntArray
    high: IntArray
    width: int


def band_layout(columns: IntArray, n_params: int) -> BandLayout:
    """Layout of the blocks with these `columns` in a narrow band; cached for small problems.

    `columns` (n_blocks, n_columns) are the parameters of each block, -1 where it has fewer. `n_params` is the number of
    all parameters.
    """
    if columns.size > _KEPT_UP_TO:
        return _layout(columns, n_params)
    return _kept_layout(columns.astype(np.int64).tobytes(), columns.shape[1], n_params)


@lru_cache(maxsize=16)
def _kept_layout(columns: bytes, width: int, n_params: int) -> BandLayout:
    return _layout(np.frombuffer(columns, dtype=np.int64).reshape(-1, width), n_params)


def _layout(columns: IntArray, n_params: int) -> BandLayout:
    """Layout with a narrow band, by reverse Cuthill-McKee on the parameters of the blocks.

    `columns` (n_blocks, k) are the parameters of each block, -1 where it has fewer. `n_params` is the number of all
    parameters. Blocks are ordered by the first position that they use, those without columns last.
    """
    positions = np.empty(n_params, dtype=np.int64)
    positions[reverse_cuthill_mckee(_neighbours(columns, n_params), symmetric_mode=True)] = np.arange(n_params)
    used = columns >= 0
    places = np.where(used, positions[columns], n_params)
    low = places.min(axis=1, initial=n_params)
    high = np.where(used, places, -1).max(axis=1, initial=-1)
    order = np.argsort(low, kind="stable")
    low = low[order]
    reach = np.maximum.accumulate(high[order])
    empty = low == n_params
    reach = np.where(empty, n_params - 1, reach)  # no columns at all
    width = int((reach - low).max(initial=0)) + 1
    return BandLayout(positions, order, low, reach, width)


def _neighbours(columns: IntArray, n_params: int) -> sparse.csr_array:
    """Sparsity pattern of B'B, (n_params, n_params): positive where two parameters are in one block.

    `columns` (n_blocks, k) are the parameters of each block, -1 where it has fewer.
    """
    block, slot = np.nonzero(columns >= 0)
    incidence = sparse.csr_array(
        (np.ones(len(block), dtype=np.int32), (block, columns[block, slot])), (len(columns), n_params)
    )
    return sparse.csr_array(incidence.T @ incidence)


def swept(
    triangles: FloatArray, columns: IntArray, layout: BandLayout, scale: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Banded triangle (n_params, width) of all blocks, right-hand side (n_params,), and residual sum of squares.

    Rows follow the order of `layout`; entry j of row i of the triangle is in column i + j.

    Parameters
    ----------
    triangles : (n_blocks, k + 1, k + 1) float array
        Triangle of each block, right-hand side in the last column.
    columns : (n_blocks, k) int array
        Parameters of each block, -1 where it has fewer.
    layout : BandLayout
        Order of parameters and blocks in the band.
    scale : (n_params,) float array
        Factor on each column, in the order of the parameters; 0 leaves it out.
    """
    n_params, side = len(layout.place), triangles.shape[1]
    band, right, factor = np.zeros((n_params, layout.width)), np.zeros(n_params), np.zeros(n_params + 1)
    factor[layout.place] = scale
    places = np.where(columns >= 0, layout.place[columns], n_params)
    total = float((triangles[:, -1, -1] ** 2).sum())
    begin = 0
    while begin < len(layout.order):  # a window of columns and all blocks that begin in it at a time
        low = int(layout.low[begin])
        stop = max(begin + 1, int(np.searchsorted(layout.low, low + _WINDOW)))
        n = int(layout.high[begin:stop].max()) - low + 1
        blocks = layout.order[begin:stop]
        begin = stop
        if n <= 0:
            total += float((triangles[blocks, :-1, -1] ** 2).sum())
            continue
        tall = np.zeros((len(blocks), side - 1, n + 2))  # one column more for what is in no place
        columns_at = np.where(places[blocks] < n_params, places[blocks] - low, n + 1)
        rows = triangles[blocks, :-1, :-1] * factor[places[blocks]][:, None, :]
        tall[np.arange(len(blocks))[:, None, None], np.arange(side - 1)[:, None], columns_at[:, None, :]] = rows
        tall[..., n] = triangles[blocks, :-1, -1]
        window = np.column_stack([_dense(band[low : low + n])[:, :n], right[low : low + n]])
        found = np.asarray(np.linalg.qr(np.concatenate([window, tall.reshape(-1, n + 2)[:, : n + 1]]), mode="r"))
        band[low : low + n] = _diagonals(np.pad(found[:n, :n], ((0, 0), (0, layout.width - 1))), layout.width)
        right[low : low + n] = found[:n, n]
        total += float(found[n, n] ** 2)
    return band, right, total


def _diagonals(dense: FloatArray, width: int) -> FloatArray:
    """View of dense rows (n, n + width - 1) as a band (n, width), with columns i to i + width - 1 of row i."""
    along, across = dense.strides
    return np.lib.stride_tricks.as_strided(dense, (len(dense), width), (along + across, across))


def _dense(band: FloatArray) -> FloatArray:
    """Dense rows (n, n + width - 1) of `band` (n, width): entry j of row i goes to column i + j."""
    n, width = band.shape
    dense = np.zeros((n, n + width - 1))
    _diagonals(dense, width)[:] = band
    return dense


def solved(band: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """Solution R^-1 b, or R'^-1 b with `transposed`, for a banded triangle R without zeros on its diagonal.

    `band` is (n, width) with the diagonal first; `right` is (n,) or (n, k), and so is the result.
    """
    stored = np.zeros((band.shape[1], len(band)))  # LAPACK's upper band: row width - 1 - j holds superdiagonal j
    for j in range(band.shape[1]):
        stored[band.shape[1] - 1 - j, j:] = band[: len(band) - j, j]
    wide = right[:, None] if right.ndim == 1 else right
    solution, _ = lapack.dtbtrs(stored, wide, uplo="U", trans="T" if transposed else "N")
    return np.asarray(solution[:, 0] if right.ndim == 1 else solution)


def inverse_diagonal(band: FloatArray) -> FloatArray:
    """Diagonal (n,) of (R'R)^-1 for a banded triangle R, stored as `band` (n, width) with the diagonal first.

    Takahashi's method, by blocks of rows from the last.
    """
    n, width = band.shape
    size = max(width, _WINDOW)
    out, corner = np.empty(n), np.zeros((size, size))  # of the inverse: what follows the rows at hand
    for first in range((n - 1) // size * size, -1, -size):
        rows = _dense(band[first : first + size])
        k = len(rows)
        beside = np.zeros((k, size))
        beside[:, : width - 1] = rows[:, k:]
        over = solve_triangular(rows[:, :k], np.column_stack([np.eye(k), beside]), check_finite=False)
        inverse = over[:, :k] @ over[:, :k].T + over[:, k:] @ corner @ over[:, k:].T
        out[first : first + k] = np.diag(inverse)
        corner = np.zeros((size, size))
        corner[:k, :k] = inverse
    return out

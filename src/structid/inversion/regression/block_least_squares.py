"""The least-squares solution that the triangles of many small blocks hold, for any number of parameters.

Nothing dense of the size of the parameters is made. Columns are always scaled to unit norm. Where the blocks form a
chain, or anything narrow, their triangles are swept into one banded triangle; on wider meshes the compressed rows go
through sparse normal equations with one step of refinement on the rows themselves (Bjorck 1996, section 6.6.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.inversion.regression.banded_sweep import BandLayout, band_layout, inverse_diagonal, solved, swept
from structid.inversion.regression.streaming_qr import RANK_TOLERANCE, StreamingQr

#: Widest band that is swept; wider problems go through sparse normal equations.
WIDEST_BAND = 128
_LARGEST_BAND = 100_000_000  # numbers, for problems that only an orthogonal sweep resolves
_NORMAL_CONDITION = 1e7  # beyond it B'B holds nothing of the weakest direction
_STEPS = 12
_TOUCHED = 1e-6
_TOGETHER = 64


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
        """Covariance (k, k) of the parameters `indices`, in physical units; NaN for undetermined ones."""
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
        """Standard deviation of every parameter, (n_params,): O(n_params) in a band, a solve each on a wider mesh."""
        variances = self._factor.diagonal() * self._scale**2 * self.residual_variance
        return np.where(np.isnan(self.values), np.nan, np.sqrt(variances))


@dataclass(frozen=True, eq=False)
class _Band:
    """A banded triangle of unit columns; columns left out have 1 on the diagonal and nothing else."""

    layout: BandLayout
    band: FloatArray

    def inverse(self, right: FloatArray) -> FloatArray:
        """(R'R)^-1 times right-hand sides in the order of the parameters."""
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
        """Diagonal (n_params,) of the inverse of the normal matrix, solved for by groups of unit vectors."""
        found = np.empty(self.n_params)
        for first in range(0, self.n_params, _TOGETHER):
            last = min(first + _TOGETHER, self.n_params)
            units = np.zeros((self.n_params, last - first))
            units[np.arange(first, last), np.arange(last - first)] = 1.0
            found[first:last] = self.inverse(units)[np.arange(first, last), np.arange(last - first)]
        return found


def block_solution(state: StreamingQr, size: FloatArray | None = None) -> BlockFit:
    """Least-squares solution of all rows reduced into the QR `state`.

    Parameters
    ----------
    state : StreamingQr
    size : (n_params,) float array, optional
        What the norm of each column would be if nothing cancelled in it; see `StreamingQr.solution`.
    """
    norm = _column_norms(state)
    seen = norm > (0.0 if size is None else RANK_TOLERANCE * size)
    scale = np.where(seen, 1.0 / np.where(seen, norm, 1.0), 0.0)
    layout = band_layout(state.columns, state.n_params)
    if layout.width <= WIDEST_BAND:
        return _by_band(state, scale, layout)
    found = _by_normal_equations(state, scale)
    if found is not None:
        return found
    if layout.width * state.n_params <= _LARGEST_BAND:
        return _by_band(state, scale, layout)
    return _unresolved(state, scale)


def _column_norms(state: StreamingQr) -> FloatArray:
    used = state.columns >= 0
    squares = (state.triangles[:, :, :-1] ** 2).sum(axis=1)
    return np.sqrt(np.bincount(state.columns[used], squares[used], state.n_params))


def _by_band(state: StreamingQr, scale: FloatArray, layout: BandLayout) -> BlockFit:
    """Least-squares fit of all blocks by a banded orthogonal sweep, without columns that are undetermined."""
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
    """Mask (n_params,) of further parameters in undetermined combinations with the `weak` columns."""
    mixture = np.zeros((rows.shape[1], 2))
    mixture[weak] = np.random.default_rng(0).uniform(0.5, 1.5, (int(weak.sum()), 2))
    share = factor.inverse(np.where(weak[:, None], 0.0, rows.T @ (rows @ mixture)))
    return np.asarray((np.abs(share) > _TOUCHED).any(axis=1))


def _rows(state: StreamingQr, scale: FloatArray) -> tuple[sparse.csr_array, FloatArray]:
    """Compressed rows of all blocks with scaled columns, as a sparse matrix, and their right-hand sides."""
    n_blocks, side = state.triangles.shape[:2]
    used = np.broadcast_to((state.columns >= 0)[:, None, :], (n_blocks, side - 1, side - 1))
    used = used & np.triu(np.ones((side - 1, side - 1), dtype=bool))
    column = np.broadcast_to(state.columns[:, None, :], used.shape)[used]
    row = np.broadcast_to(np.arange(n_blocks * (side - 1)).reshape(n_blocks, side - 1, 1), used.shape)[used]
    data = state.triangles[:, :-1, :-1][used] * scale[column]
    shape = (n_blocks * (side - 1), state.n_params)
    return sparse.csr_array((data, (row, column)), shape), state.triangles[:, :-1, -1].ravel()


def _by_normal_equations(state: StreamingQr, scale: FloatArray) -> BlockFit | None:
    """Least-squares fit of all blocks by sparse normal equations; None if these would lose its weakest direction."""
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
    """Fit without values (NaN), where neither normal equations nor the band can solve the system."""
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
    """`BlockFit` of `values` (n_params,) with residual sum of squares `rest` and the factor of the normal matrix."""
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
    """Estimate of the condition number, largest over smallest singular value, by the power method."""
    start = np.random.default_rng(0).standard_normal((rows.shape[1], 2))
    large = small = start / np.linalg.norm(start, axis=0)
    top = bottom = np.ones(2)
    for _ in range(_STEPS):
        large, small = rows.T @ (rows @ large), factor.inverse(small)
        top, bottom = np.linalg.norm(large, axis=0), np.linalg.norm(small, axis=0)
        large, small = large / top, small / bottom
    return float(np.sqrt(top.max() * bottom.max())) if rows.shape[1] else 1.0

"""Covariance of an estimate: from the noise alone, and from residuals that the model leaves correlated."""

from __future__ import annotations

import numpy as np
from scipy import special

from structid.arrays import FloatArray, IntArray
from structid.estimation.problem import Linearization, Problem

_FEWEST_BLOCKS = 10
_FEWEST_CHANNELS = 4


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """(J'J)^-1 by a scaled singular value decomposition; NaN for every parameter that takes part in a null direction.

    A direction is null where its singular value, with unit columns, is below 1e-10 of the largest.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    n_params = len(scale)
    if not np.isfinite(jacobian).all():
        return np.full((n_params, n_params), np.nan)
    safe = np.where(scale > 0, scale, 1.0)
    _, singular, rows = np.linalg.svd(np.linalg.qr(jacobian / safe, mode="r"))
    singular = np.concatenate([singular, np.zeros(n_params - len(singular))])
    sound = singular > 1e-10 * singular.max(initial=0.0)
    covariance = (rows[sound].T / singular[sound] ** 2) @ rows[sound] / np.outer(safe, safe)
    lost = (np.abs(rows[~sound]) > 1e-6).any(axis=0) | (scale == 0)
    covariance[lost, :] = covariance[:, lost] = np.nan
    return covariance


def correlation_length(residual: FloatArray, lines: IntArray, series: IntArray) -> float:
    """How many neighbouring lines a residual stays correlated over: 1 + 2 sum of its autocorrelations.

    The sum runs over lags up to the first autocorrelation below 0.05, on the mean over all channels.
    """
    n_lines = int(lines.max(initial=0)) + 1
    numerator = np.zeros(n_lines)
    for channel in np.unique(series):
        rows = series == channel
        values = np.zeros(n_lines)
        np.add.at(values, lines[rows], residual[rows])
        spectrum = np.abs(np.fft.rfft(values, 2 * n_lines)) ** 2
        numerator += np.fft.irfft(spectrum)[:n_lines]
    if numerator[0] <= 0:
        return 1.0
    correlation = numerator / numerator[0]
    below = np.flatnonzero(correlation < 0.05)
    last = int(below[0]) if below.size else n_lines
    return float(1 + 2 * correlation[1:last].sum())


def model_error_covariance(problem: Problem, at: Linearization) -> FloatArray:
    """Covariance that counts each stretch of lines, and each channel, as one observation of the model's error.

    With A = J'J and g_b = J_b' r_b summed over a block b of rows, it is A^-1 (sum of g_b g_b') A^-1, with blocks
    along the frequency or time axis (four correlation lengths long, at least ten of them) and, where there are
    four channels or more, a second sum with channels as blocks. Priors add their own information unchanged.
    Few blocks make a rough variance: each sum is scaled so that 1.96 standard deviations are the 95 % interval of
    Student's t with one degree of freedom less than there are blocks. It needs no noise level, but no error that is
    the same in all blocks can show in it.

    References
    ----------
    Liang and Zeger (1986), Biometrika 73, Eq. (5); Cameron, Gelbach and Miller (2011), J. Bus. Econ. Stat. 29.
    """
    rows = problem.n_data
    residual, jacobian = at.residual[:rows], at.jacobian[:rows]
    n_lines = int(problem.lines.max(initial=0)) + 1
    length = 4 * correlation_length(residual, problem.lines, problem.series)
    n_blocks = int(np.clip(n_lines / length, min(_FEWEST_BLOCKS, n_lines), n_lines))
    meat = _block_scores(jacobian, residual, problem.lines * n_blocks // n_lines)
    channels = problem.series // 2
    if len(np.unique(channels)) >= _FEWEST_CHANNELS:
        meat = meat + _block_scores(jacobian, residual, channels)
    prior = at.jacobian[rows:]
    bread = inverse_information(at.jacobian)
    seen = np.isfinite(np.diag(bread))
    inner = np.ix_(seen, seen)
    covariance = np.full_like(bread, np.nan)
    covariance[inner] = bread[inner] @ (meat + prior.T @ prior)[inner] @ bread[inner]
    return covariance


def _block_scores(jacobian: FloatArray, residual: FloatArray, block: IntArray) -> FloatArray:
    """Sum over blocks of g g' with g = J_b' r_b, times B / (B - 1) and the squared ratio of t to normal quantiles."""
    _, block = np.unique(block, return_inverse=True)
    n_blocks = int(block.max(initial=0)) + 1
    scores = np.zeros((n_blocks, jacobian.shape[1]))
    np.add.at(scores, block, jacobian * residual[:, None])
    if n_blocks < 2:
        return np.full((jacobian.shape[1],) * 2, np.nan)
    wider = special.stdtrit(n_blocks - 1, 0.975) / special.ndtri(0.975)
    return scores.T @ scores * (n_blocks / (n_blocks - 1)) * wider**2

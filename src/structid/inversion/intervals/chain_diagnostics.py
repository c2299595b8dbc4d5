"""Diagnostics of chains of samples: R-hat and effective sample sizes."""

from __future__ import annotations

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray


def split_r_hat(draws: FloatArray) -> float:
    """Rank-normalized split R-hat of one quantity, about 1 for chains that agree.

    Parameters
    ----------
    draws : (n_chains, n_draws) float array

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter and Buerkner (2021), Bayesian Analysis 16, Eqs. (4), (14) and section 3.
    """
    if not np.isfinite(draws).all() or np.ptp(draws) == 0:
        return float("nan")
    folded = np.abs(draws - np.median(draws))
    return max(_r_hat(_rank_normal(_split(draws))), _r_hat(_rank_normal(_split(folded))))


def bulk_sample_size(draws: FloatArray) -> float:
    """Effective sample size of the rank-normalized draws (n_chains, n_draws): what holds for means and medians."""
    return _sample_size(_rank_normal(_split(draws))) if np.isfinite(draws).all() else float("nan")


def tail_sample_size(draws: FloatArray) -> float:
    """The smaller effective sample size of the 5 % and the 95 % quantile of draws (n_chains, n_draws)."""
    if not np.isfinite(draws).all():
        return float("nan")
    ends = np.quantile(draws, [0.05, 0.95])
    return min(_sample_size(_split((draws <= end).astype(np.float64))) for end in ends)


def _split(draws: FloatArray) -> FloatArray:
    """Each chain as two halves."""
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def _rank_normal(draws: FloatArray) -> FloatArray:
    """Normal quantiles of (rank - 3/8) / (S + 1/4), equal draws with their mean rank."""
    _, place, counts = np.unique(draws, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1)
    return special.ndtri((ranks - 0.375) / (draws.size + 0.25))[place].reshape(draws.shape)


def _r_hat(chains: FloatArray) -> float:
    """R-hat of `chains` (n_chains, n_draws): root of total over within-chain variance; NaN if they do not vary."""
    n = chains.shape[1]
    within = float(chains.var(axis=1, ddof=1).mean())
    between = float(chains.mean(axis=1).var(ddof=1))
    return float(np.sqrt((n - 1) / n + between / within)) if within > 0 else float("nan")


def _sample_size(chains: FloatArray) -> float:
    """Effective number of independent draws of `chains` (n_chains, n_draws), by Geyer's monotone autocorrelations."""
    m, n = chains.shape
    centred = chains - chains.mean(axis=1, keepdims=True)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1)
    total = covariance[0] + (float(chains.mean(axis=1).var(ddof=1)) if m > 1 else 0.0)
    if within <= 0 or total <= 0:
        return float("nan")
    rho = 1 - (within - covariance) / total
    rho[0] = 1.0
    pairs = rho[0 : n - n % 2 : 2] + rho[1:n:2]
    negative = np.flatnonzero(pairs <= 0)
    count = int(negative[0]) if negative.size else len(pairs)
    next_even = max(float(rho[2 * count]), 0.0) if 2 * count < n else 0.0
    time = -1 + 2 * float(np.minimum.accumulate(pairs[:count]).sum()) + next_even
    return m * n / max(time, 1 / np.log10(m * n))

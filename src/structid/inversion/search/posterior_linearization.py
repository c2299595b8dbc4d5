"""Posterior linearization: near a minimum from afar, where the sum of squares is full of wrong ones."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import Progress, residual_at, sizes_at, squared

_ROUNDS = 20
#: Draws of a round, at least, and for each parameter.
_FEWEST_DRAWS, _DRAWS_EACH = 100, 4
#: Data count for so much less, since what a straight line leaves of them is not independent from row to row.
_TEMPER = 3.0
#: No direction narrows by more than this factor in a round, and the middle moves by no more than so many deviations.
_NARROWEST, _FARTHEST = 0.7, 2.0
#: What a straight line leaves, in variances of the noise, below which the residual is as good as linear.
_LINEAR = 0.3
#: Of a parameter that begins at 0.
_LEAST_DEVIATION = 1e-12


def posterior_linearized(
    problem: Problem, theta: FloatArray, spread: float, seed: int = 0, progress: Progress | None = None
) -> FloatArray:
    """Free variables near the global minimum (n_params,), by linear regression on draws, without derivatives.

    Parameters are drawn about the start, and a straight line is laid through the residual over the draws. What it
    leaves is what the data cannot say yet, such as a phase that no draw has right: it counts as noise of its row.
    The Gaussian posterior of this linear problem is where the next round draws from. So rows that the spread leaves
    predictable speak first, and others as the spread narrows: no order of modes or of samples has to be known. A search
    by derivatives has to follow from here.

    A round costs 100 residuals, or four for each parameter if that is more, and no derivative. There are at most 20
    rounds; they end where the residual is nearly linear over the draws, or where the model can be evaluated at too few
    of them.

    Parameters
    ----------
    problem : Problem
    theta : (n_params,) float array
        Free variables to begin at.
    spread : float
        Standard deviation of the start, in parts of each parameter.
    seed : int
        Of the draws.
    progress : callable, optional
        Called with the round and the sum of squares of the mean residual.

    Notes
    -----
    The lines are fitted row by row. A row whose slopes are no larger than chance makes them is left out, which the
    James-Stein factor does; many such rows would narrow the posterior about nothing. Rows are weighed as if they were
    independent, tempered by a factor, so that the data should be few for the parameters: some ten or twenty rows each.

    References
    ----------
    Garcia-Fernandez, Svensson, Morelande and Sarkka (2015), Posterior linearization filter, IEEE Transactions on
    Signal Processing 63, 5561-5573: linear regression over the posterior, again and again. Stein (1956), Proc. Third
    Berkeley Symposium 1, 197-206: the factor.
    """
    rng = np.random.default_rng(seed)
    deviation = np.maximum(spread * sizes_at(problem, theta), _LEAST_DEVIATION)
    middle, factor = theta, np.diag(deviation)
    for count in range(_ROUNDS):
        draws, residuals = _draw_residuals(problem, middle, factor, rng)
        if len(draws) < 2 * (len(theta) + 1):
            break
        mean, slopes, left = _line(draws, residuals)
        if progress is not None:
            progress(count, squared(mean))
        weight = 1 / (_TEMPER * (1 + left))
        prior = factor / deviation[:, None]
        precision = slopes.T @ (weight[:, None] * slopes) + prior.T @ prior
        downhill = -slopes.T @ (weight * mean) + prior.T @ ((theta - middle) / deviation)
        values, directions = np.linalg.eigh(precision)
        step = np.clip((directions.T @ downhill) / values, -_FARTHEST, _FARTHEST)
        middle = np.clip(middle + factor @ (directions @ step), *problem.unknowns.reach.T)
        if left.mean() < _LINEAR:
            break
        factor = factor @ (directions * np.maximum(1 / np.sqrt(values), _NARROWEST))
    return middle


def _draw_residuals(
    problem: Problem, middle: FloatArray, factor: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Antithetic standard normal draws, (n_draws, n_params), and the residuals there, (n_draws, n_rows).

    The free variables are `middle` (n_params,) plus `factor` (n_params, n_params) times a draw, clipped to their reach.
    Draws where the model cannot be evaluated are left out. `rng` gives the draws.
    """
    n_params = len(middle)
    half = rng.standard_normal((max(_FEWEST_DRAWS, _DRAWS_EACH * n_params) // 2, n_params))
    draws, low_high = np.concatenate([half, -half]), problem.unknowns.reach.T
    residuals = [residual_at(problem, np.clip(middle + factor @ draw, *low_high)) for draw in draws]
    had = [(draw, residual) for draw, residual in zip(draws, residuals, strict=True) if residual is not None]
    return np.array([draw for draw, _ in had]).reshape(-1, n_params), np.array([residual for _, residual in had])


def _line(draws: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Linear regression of every residual row on the draws: values at the centre, slopes, and remaining variances.

    `draws` are (n_draws, n_params), `residuals` (n_draws, n_rows); values and variances are (n_rows,). Slopes (n_rows,
    n_params) are shrunk by the James-Stein factor, to 0 where they are no larger than chance.
    """
    n_draws, n_params = draws.shape
    design = np.column_stack([np.ones(n_draws), draws])
    fitted = np.linalg.lstsq(design, residuals, rcond=None)[0]
    left = ((residuals - design @ fitted) ** 2).sum(axis=0) / (n_draws - n_params - 1)
    slopes = fitted[1:].T
    power, chance = (slopes**2).sum(axis=1), n_params * left / n_draws
    real = np.maximum(1 - chance / np.maximum(power, np.finfo(float).tiny), 0.0)
    return fitted[0], slopes * real[:, None], left

"""Nonlinear least squares: a settings object says which search, one function runs it."""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray
from structid.estimation.problem import Problem
from structid.estimation.search.gauss_newton import GaussNewton, gauss_newton
from structid.estimation.search.levenberg_marquardt import LevenbergMarquardt, levenberg_marquardt
from structid.estimation.search.minimum import Keeper, Minimum, Progress

__all__ = ["GaussNewton", "LevenbergMarquardt", "Method", "Minimum", "Progress", "minimize"]

Method = GaussNewton | LevenbergMarquardt


def minimize(
    problem: Problem,
    method: Method,
    theta: FloatArray | None = None,
    progress: Progress | None = None,
    keeper: Keeper | None = None,
) -> Minimum:
    """The nearest minimum of the sum of squared residuals that `method` reaches from `theta`.

    Parameters
    ----------
    problem : Problem
    method : GaussNewton or LevenbergMarquardt
    theta : (n_params,) float array, optional
        Start; the problem's own by default.
    progress : callable, optional
        Called with the iteration and the sum of squares.
    keeper : Keeper, optional
        Takes the state of the search after each iteration; where it has one already, the search goes on from there.
    """
    start = np.array(problem.theta_start if theta is None else theta, dtype=np.float64)
    if isinstance(method, GaussNewton):
        return gauss_newton(problem, method, start, progress, keeper)
    return levenberg_marquardt(problem, method, start, progress, keeper)

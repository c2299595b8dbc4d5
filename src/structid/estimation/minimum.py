"""What a search for a minimum gives back, and what every search needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.errors import SingularModelError
from structid.estimation.problem import Linearization, Problem

Progress = Callable[[int, float], None]


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended, and how.

    Attributes
    ----------
    theta : (n_params,) float array
    linearization : Linearization
        At `theta`.
    history : (n_iterations + 1, n_params) float array
        Free variables from the start to the end.
    costs : (n_iterations + 1,) float array
        Sum of squared residuals along the history.
    converged : bool
    message : str
        What ended the search.
    """

    theta: FloatArray
    linearization: Linearization
    history: FloatArray
    costs: FloatArray
    converged: bool
    message: str


def residual_at(problem: Problem, theta: FloatArray) -> FloatArray | None:
    """The residual, None where the model cannot be evaluated."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            residual = problem.residual(theta)
        except SingularModelError:
            return None
    return residual if np.isfinite(residual).all() else None


def cost_at(problem: Problem, theta: FloatArray) -> float:
    """Sum of squares, infinite where the model cannot be evaluated."""
    residual = residual_at(problem, theta)
    if residual is None:
        return np.inf
    with np.errstate(over="ignore"):
        return float(residual @ residual)

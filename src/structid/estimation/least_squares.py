"""Gauss-Newton and Levenberg-Marquardt: one loop, two ways to bound a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.errors import SingularModelError
from structid.estimation.problem import Linearization, Problem

Progress = Callable[[int, float], None]


@dataclass(frozen=True)
class GaussNewton:
    """Full Gauss-Newton steps, halved while the residual grows if `step_control` is on.

    Parameters
    ----------
    max_iterations : int
    step_control : bool
        Off: the classical iteration, which takes every step as it comes (Norris 1986, Eq. 4.17).
    step_tolerance : float
        Converged when no free variable moves by more.
    """

    max_iterations: int = 50
    step_control: bool = True
    step_tolerance: float = 1e-11


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Steps damped by a multiple of diag(J'J), with the gain ratio ruling the damping.

    Parameters
    ----------
    max_iterations : int
    step_tolerance : float
        Converged when no free variable moves by more.
    gain_tolerance : float
        Converged when the next step promises to lower the sum of squares by less than this part of it.
    initial_damping : float
        First multiple.
    largest_step : float
        No free variable moves by more in one step (0.7 in a log parameter is a factor of two).

    References
    ----------
    Madsen, Nielsen and Tingleff (2004), Methods for Non-Linear Least Squares Problems, algorithm 3.16.
    """

    max_iterations: int = 100
    step_tolerance: float = 1e-10
    gain_tolerance: float = 1e-13
    initial_damping: float = 1e-2
    largest_step: float = 0.7


Method = GaussNewton | LevenbergMarquardt


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


def minimize(
    problem: Problem, method: Method, theta: FloatArray | None = None, progress: Progress | None = None
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
    """
    start = np.array(problem.theta_start if theta is None else theta, dtype=np.float64)
    if isinstance(method, GaussNewton):
        return _gauss_newton(problem, method, start, progress)
    return _levenberg_marquardt(problem, method, start, progress)


def _cost(problem: Problem, theta: FloatArray) -> float:
    """Sum of squares, infinite where the model cannot be evaluated."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            residual = problem.residual(theta)
        except SingularModelError:
            return np.inf
        cost = float(residual @ residual)
    return cost if np.isfinite(cost) else np.inf


def _gauss_newton(problem: Problem, method: GaussNewton, theta: FloatArray, progress: Progress | None) -> Minimum:
    at = problem.linearize(theta)
    cost = float(at.residual @ at.residual)
    history, costs = [theta], [cost]
    message, converged = f"stopped after {method.max_iterations} iterations", False
    for iteration in range(method.max_iterations):
        step = -np.linalg.lstsq(at.jacobian, at.residual, rcond=None)[0]
        size = 1.0
        new_cost = _cost(problem, theta + step)
        while method.step_control and not new_cost <= cost and size > 1e-6:
            size /= 2
            new_cost = _cost(problem, theta + size * step)
        if not np.isfinite(new_cost):
            message = "the step leads where the model cannot be evaluated"
            break
        if method.step_control and new_cost > cost:
            converged = bool(np.abs(step).max(initial=0.0) < 1e3 * method.step_tolerance)
            message = "no shorter step lowers the residual"
            break
        theta, cost = theta + size * step, new_cost
        at = problem.linearize(theta)
        history.append(theta)
        costs.append(cost)
        if progress is not None:
            progress(iteration + 1, cost)
        if np.abs(size * step).max(initial=0.0) < method.step_tolerance:
            message, converged = "the step fell below its tolerance", True
            break
    return Minimum(theta, at, np.array(history), np.array(costs), converged, message)


def _levenberg_marquardt(
    problem: Problem, method: LevenbergMarquardt, theta: FloatArray, progress: Progress | None
) -> Minimum:
    at = problem.linearize(theta)
    cost = float(at.residual @ at.residual)
    history, costs = [theta], [cost]
    damping, growth = method.initial_damping, 2.0
    scale = np.zeros(len(theta))
    message, converged = f"stopped after {method.max_iterations} iterations", False
    triangle, projected = _reduced(at)
    for iteration in range(method.max_iterations):
        scale = np.maximum(np.linalg.norm(triangle, axis=0), 0.1 * scale)
        step = _damped_step(triangle, projected, damping, scale, method.largest_step)
        linear = triangle @ step
        promised = -float(linear @ linear + 2 * linear @ projected)
        if np.abs(step).max(initial=0.0) < method.step_tolerance:
            message, converged = "the step fell below its tolerance", True
            break
        if promised <= method.gain_tolerance * cost and damping < 1e3:
            message, converged = "no further decrease is promised", True
            break
        new_cost = _cost(problem, theta + step)
        gain = (cost - new_cost) / promised if promised > 0 else -1.0
        if gain > 1e-4:
            theta, cost = theta + step, new_cost
            at = problem.linearize(theta)
            triangle, projected = _reduced(at)
            damping *= max(1 / 10, 1 - (2 * min(gain, 1.0) - 1) ** 3)
            damping, growth = max(damping, 1e-14), 2.0
        else:
            damping, growth = damping * growth, growth * 2
        history.append(theta)
        costs.append(cost)
        if progress is not None:
            progress(iteration + 1, cost)
    return Minimum(theta, at, np.array(history), np.array(costs), converged, message)


def _reduced(at: Linearization) -> tuple[FloatArray, FloatArray]:
    """R and Q'r of the Jacobian's QR factorization: all that a step needs."""
    orthogonal, triangle = np.linalg.qr(at.jacobian)
    return triangle, orthogonal.T @ at.residual


def _damped_step(
    triangle: FloatArray, projected: FloatArray, damping: float, scale: FloatArray, largest: float
) -> FloatArray:
    """Minimizer of |R s + q|^2 + damping |D s|^2, shortened to `largest` in every variable."""
    safe = np.where(scale > 0, scale, 1.0)
    augmented = np.vstack([triangle, np.diag(np.sqrt(damping) * safe)])
    right = np.concatenate([-projected, np.zeros(len(scale))])
    step = np.linalg.lstsq(augmented, right, rcond=None)[0]
    biggest = np.abs(step).max(initial=0.0)
    return step * (largest / biggest) if biggest > largest else step

"""Levenberg-Marquardt with geodesic acceleration: damped steps that bend with the valley they follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from structid.arrays import FloatArray
from structid.declared import Count, NotNegative, Positive
from structid.estimation.problem import Linearization, Problem, parameter_sizes
from structid.estimation.search.minimum import Keeper, Minimum, Progress, State, residual_at

_LEAST_DAMPING, _MOST_DAMPING = 1e-20, 1e40
_ROUNDING = 1e-14
#: A step that lowers the sum of squares by more than this part of what the linear model promises goes as it is.
_KEPT = 0.7
#: A parameter whose largest step changes the residual by less than this part of what the whole step promises is held.
_NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Steps damped by a multiple of diag(J'J), with the gain ratio ruling the damping.

    A damped step v is the velocity of a path that goes downhill; its acceleration a solves the same equations with
    the second derivative of the residual along v, 2 (r(theta + v) - r(theta) - J v) by a finite difference. Where v
    alone keeps too little of its promise, v + a / 2 is tried: along the narrow curved valley of a badly determined
    problem it may be much longer. It costs one more residual, there only.

    Parameters
    ----------
    max_iterations : int
        After which a search that has not converged ends.
    step_tolerance : float
        Converged when no parameter changes by more than this part of itself.
    gain_tolerance : float
        Converged when the next step promises to lower the sum of squares by less than this part of it.
    initial_damping : float
        First multiple.
    largest_step : float
        No parameter changes in one step by more than this part of its largest magnitude so far, measured by the
        derivative of its free variable (0.7 is a factor of two where that is the logarithm).
    acceleration : float
        Largest |a| as a multiple of |v|, both scaled by the columns of J; 0 goes without acceleration.

    References
    ----------
    Madsen, Nielsen and Tingleff (2004), Methods for Non-Linear Least Squares Problems, algorithm 3.16.
    Transtrum and Sethna (2012), Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares
    minimization, arXiv:1201.5885, section 2.
    """

    max_iterations: Count = 100
    step_tolerance: Positive = 1e-10
    gain_tolerance: Positive = 1e-13
    initial_damping: Positive = 1e-2
    largest_step: Positive = 0.7
    acceleration: NotNegative = 0.75


@dataclass(frozen=True, eq=False)
class _Point:
    """One point of the path: its linearization and the QR factorization J = Q R, all that steps from it need."""

    theta: FloatArray
    at: Linearization
    cost: float
    orthogonal: FloatArray
    triangle: FloatArray
    projected: FloatArray
    size: FloatArray

    @property
    def rounding(self) -> float:
        """What a relative rounding of all parameters does to the residual."""
        return _ROUNDING * float(np.linalg.norm(self.triangle * self.size))


def _point(problem: Problem, theta: FloatArray) -> _Point:
    at = problem.linearize(theta)
    orthogonal, triangle = np.linalg.qr(at.jacobian)
    slope = np.maximum(np.abs(problem.slope(theta)), 1e-100)  # 0 where a bounded parameter is at its bound
    size = parameter_sizes(problem, problem.physical(theta)) / slope
    return _Point(theta, at, float(at.residual @ at.residual), orthogonal, triangle, orthogonal.T @ at.residual, size)


@dataclass(frozen=True, eq=False)
class _Damped:
    """QR factorization of [R; sqrt(damping) D], which turns a right-hand side into a damped step."""

    orthogonal: FloatArray
    triangle: FloatArray
    scale: FloatArray

    def step(self, projected: FloatArray) -> FloatArray:
        """Minimizer of |R s + projected|^2 + damping |D s|^2."""
        right = self.orthogonal[: len(projected)].T @ projected
        return np.asarray(-linalg.solve_triangular(self.triangle, right, check_finite=False))

    def step_holding(self, projected: FloatArray, held: NDArray[np.bool_], values: FloatArray) -> FloatArray:
        """The same minimizer with the entries `held` at their `values`."""
        right = self.orthogonal[: len(projected)].T @ projected + self.triangle[:, held] @ values[held]
        orthogonal, factor = np.linalg.qr(self.triangle[:, ~held])
        step = np.array(values)
        step[~held] = -linalg.solve_triangular(factor, orthogonal.T @ right, check_finite=False)
        return step

    def length(self, step: FloatArray) -> float:
        return float(np.linalg.norm(self.scale * step))


def _damped(triangle: FloatArray, damping: float, scale: FloatArray) -> _Damped:
    safe = np.where(scale > 0, scale, 1.0)
    orthogonal, factor = np.linalg.qr(np.vstack([triangle, np.diag(np.sqrt(damping) * safe)]))
    return _Damped(orthogonal, factor, safe)


def levenberg_marquardt(
    problem: Problem,
    method: LevenbergMarquardt,
    theta: FloatArray,
    progress: Progress | None,
    keeper: Keeper | None = None,
) -> Minimum:
    """The minimum that `LevenbergMarquardt` reaches from `theta`, or from the state that `keeper` has."""
    begun = None if keeper is None else keeper.state
    here = _point(problem, theta if begun is None else np.array(begun["theta"]))
    history, costs = [here.theta], [here.cost]
    damping, growth = method.initial_damping, 2.0
    scale, limit = np.zeros(len(theta)), np.zeros(len(theta))
    if begun is not None:
        history, costs = list(np.array(begun["history"])), np.asarray(begun["costs"]).tolist()
        damping, growth = float(begun["damping"]), float(begun["growth"])
        scale, limit = np.array(begun["scale"]), np.array(begun["limit"])
    message, converged = f"stopped after {method.max_iterations} iterations", False
    for iteration in range(len(costs) - 1, method.max_iterations):
        scale = np.maximum(np.linalg.norm(here.triangle, axis=0), 0.1 * scale)
        limit = np.maximum(limit, np.where(here.size > 0, method.largest_step * here.size, np.inf))
        damped = _damped(here.triangle, damping, scale)
        velocity = _velocity(here, damped, limit)
        linear = here.triangle @ velocity
        promised = -float(linear @ linear + 2 * linear @ here.projected)
        if (np.abs(velocity) <= method.step_tolerance * here.size).all() or damping > _MOST_DAMPING:
            message, converged = "the step fell below its tolerance", True
            break
        if promised <= method.gain_tolerance * here.cost and damping < 1e3:
            message, converged = "no further decrease is promised", True
            break
        step, cost = _trial(problem, method, here, damped, velocity, promised, limit)
        gain = (here.cost - cost) / promised if promised > 0 else -1.0
        if gain > 1e-4:
            here = _point(problem, here.theta + step)
            damping = max(damping * max(1 / 10, 1 - (2 * min(gain, 1.0) - 1) ** 3), _LEAST_DAMPING)
            growth = 2.0
        else:
            damping, growth = damping * growth, growth * 2
        history.append(here.theta)
        costs.append(here.cost)
        if keeper is not None:
            state = partial(_state, here.theta, damping, growth, scale, limit, tuple(history), tuple(costs))
            keeper.keep(iteration + 1, here.cost, state)
        if progress is not None:
            progress(iteration + 1, here.cost)
    return Minimum(here.theta, here.at, np.array(history), np.array(costs), converged, message)


def _state(
    theta: FloatArray,
    damping: float,
    growth: float,
    scale: FloatArray,
    limit: FloatArray,
    history: Sequence[FloatArray],
    costs: Sequence[float],
) -> State:
    """All that the next iteration depends on, but what the problem gives at `theta`."""
    return {
        "theta": theta,
        "damping": damping,
        "growth": growth,
        "scale": scale,
        "limit": limit,
        "history": np.array(history),
        "costs": np.array(costs),
    }


def _velocity(here: _Point, damped: _Damped, limit: FloatArray) -> FloatArray:
    """The damped step, with parameters that run away held at their limits.

    One runs away where its step is beyond its limit though moving it that far would hardly change the residual, as
    for a loss factor on its way to 0: the step would be cut for its sake, and all others would stand still.
    """
    velocity = damped.step(here.projected)
    linear = here.triangle @ velocity
    promised = -float(linear @ linear + 2 * linear @ here.projected)
    effect = np.linalg.norm(here.triangle, axis=0) * limit
    runs = (np.abs(velocity) > limit) & (effect**2 < _NEGLIGIBLE * promised)
    if not runs.any() or runs.all():
        return velocity
    return damped.step_holding(here.projected, runs, np.clip(velocity, -limit, limit))


def _trial(
    problem: Problem,
    method: LevenbergMarquardt,
    here: _Point,
    damped: _Damped,
    velocity: FloatArray,
    promised: float,
    limit: FloatArray,
) -> tuple[FloatArray, float]:
    """The step to try and the sum of squares there: the velocity, bent where it alone keeps too little of its promise.

    A step cut to its limit is held to the promise of the whole: damping then grows until it turns downhill instead.
    """
    step = _shortened(velocity, limit)
    residual = residual_at(problem, here.theta + step)
    if residual is None:
        return step, np.inf
    cost = float(residual @ residual)
    if method.acceleration <= 0 or here.cost - cost > _KEPT * promised:
        return step, cost
    bend = residual - here.at.residual - here.at.jacobian @ step
    if np.linalg.norm(bend) <= here.rounding:
        return step, cost
    acceleration = 2 * damped.step(here.orthogonal.T @ bend)
    if not damped.length(acceleration) <= method.acceleration * damped.length(step):
        return step, cost
    bent = _shortened(step + 0.5 * acceleration, limit)
    residual = residual_at(problem, here.theta + bent)
    bent_cost = np.inf if residual is None else float(residual @ residual)
    return (bent, bent_cost) if bent_cost < cost else (step, cost)


def _shortened(step: FloatArray, limit: FloatArray) -> FloatArray:
    """The step, as a whole, so short that no entry exceeds its limit."""
    return step / max(1.0, (np.abs(step) / limit).max(initial=0.0))

"""Levenberg-Marquardt for parameters too many for a Jacobian: steps by conjugate gradients, the priors as preconditioner."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from structid.arrays import FloatArray
from structid.estimation.problem import Problem, parameter_sizes
from structid.estimation.search.free_linearization import FreeLinearization, FreeProblem, solved_by
from structid.estimation.search.minimum import Keeper, Progress, State, residual_at

#: A dense search takes some arrays of the Jacobian's size, and three of n_params squared.
DENSE_BYTES = 2_000_000_000
_DENSE_COPIES = 4
_MOST_DAMPING = 1e40
#: What the data add to the preconditioner, as a part of their own diagonal.
_DATA_PART = 1e-3
#: The same where the Jacobian is stored: as little as rounding allows.
_STORED_PART = 1e-5
#: Keeps the small system of a preconditioner regular, as a part of its mean eigenvalue.
_REGULAR = 1e-14
#: Most rows of a stored Jacobian that enter the preconditioner, and how many are solved for at once.
_MOST_ROWS, _RIGHT_SIDES = 6000, 256


@dataclass(frozen=True)
class FreeLevenbergMarquardt:
    """Damped steps whose equations are solved by preconditioned conjugate gradients.

    Parameters
    ----------
    max_iterations : int
    step_tolerance : float
        Converged when no parameter changes by more than this part of itself.
    gain_tolerance : float
        Converged when the next step promises to lower the sum of squares by less than this part of it.
    initial_damping : float
        First multiple of diag(J'J).
    largest_step : float
        No parameter changes in one step by more than this part of its magnitude.
    inner_tolerance : float
        Conjugate gradients end when the residual of the equations is this part of their right-hand side, in the norm
        of the preconditioner.
    max_inner : int
        Conjugate gradient iterations a step.

    References
    ----------
    Madsen, Nielsen and Tingleff (2004), Methods for Non-Linear Least Squares Problems, algorithm 3.16.
    Nocedal and Wright (2006), Numerical Optimization, section 7.1, for steps that are not exact.
    """

    max_iterations: int = 50
    step_tolerance: float = 1e-6
    gain_tolerance: float = 1e-6
    initial_damping: float = 1e-3
    largest_step: float = 0.7
    inner_tolerance: float = 1e-6
    max_inner: int = 500


@dataclass(frozen=True, eq=False)
class FreeMinimum:
    """Where a search without a Jacobian ended.

    Attributes
    ----------
    theta : (n_params,) float array
    linearization : FreeLinearization
        At `theta`.
    costs : (n_iterations + 1,) float array
        Sum of squared residuals.
    inner : (n_iterations,) int array
        Conjugate gradient iterations of every step.
    converged : bool
    message : str
    """

    theta: FloatArray
    linearization: FreeLinearization
    costs: FloatArray
    inner: FloatArray
    converged: bool
    message: str


def needs_free_search(problem: Problem, dense_bytes: float = DENSE_BYTES) -> tuple[bool, str]:
    """Whether a problem is too large for a search with its Jacobian, and the reason in words.

    Parameters
    ----------
    problem : Problem
    dense_bytes : float
        Memory that a dense search may take.
    """
    n_params = len(problem.names)
    size = 8.0 * _DENSE_COPIES * n_params * (problem.n_data + n_params)
    figures = f"{n_params} parameters and {problem.n_data} data: a dense search would take {size / 1e9:.2g} GB"
    if size <= dense_bytes:
        return False, f"{figures}, which is within {dense_bytes / 1e9:.2g} GB"
    return True, f"{figures}, more than {dense_bytes / 1e9:.2g} GB; steps are solved without forming J'J"


def preconditioner(at: FreeLinearization, damping: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Solver of (S + U C^-1 U') x = b with S = P'P + damping + a small part of diag(J'J), P the rows of the priors.

    U C^-1 U' is J'J itself where J is stored and has not too many rows (U = J', C = 1), else its sketch:
    S^-1 - S^-1 U (C + U'S^-1 U)^-1 U'S^-1. Only the small part of the diagonal, or what the sketch leaves out, is then
    left for conjugate gradients to correct.
    """
    from scipy.linalg import cho_factor, cho_solve

    is_whole = at.jacobian is not None and len(at.jacobian) <= _MOST_ROWS
    part = _STORED_PART if is_whole else _DATA_PART
    solve = solved_by(at.prior, damping + part * at.data_squares)
    wide: FloatArray
    inner: FloatArray
    if is_whole and at.jacobian is not None:
        wide, inner = at.jacobian.T, np.eye(len(at.jacobian))
    else:
        wide, inner = at.sketch
    across = np.empty(wide.shape, order="F")
    for first in range(0, wide.shape[1], _RIGHT_SIDES):
        across[:, first : first + _RIGHT_SIDES] = solve(np.asfortranarray(wide[:, first : first + _RIGHT_SIDES]))
    rows = wide.T @ across + inner
    rows[np.diag_indices_from(rows)] += _REGULAR * np.trace(rows) / max(len(rows), 1)
    factor = cho_factor(0.5 * (rows + rows.T), lower=True, overwrite_a=True, check_finite=False)

    def solved(right: FloatArray) -> FloatArray:
        first = solve(right)
        return np.asarray(first - across @ cho_solve(factor, wide.T @ first, check_finite=False))

    return solved


def conjugate_gradients(
    apply: Callable[[FloatArray], FloatArray],
    right: FloatArray,
    precondition: Callable[[FloatArray], FloatArray],
    tolerance: float,
    most: int,
) -> tuple[FloatArray, int, float]:
    """The solution of A x = `right` for positive definite A, iterations, and the residual in parts of `right`.

    References
    ----------
    Nocedal and Wright (2006), Numerical Optimization, algorithm 5.3.
    """
    x = np.zeros_like(right)
    residual = np.array(right)
    direction = better = precondition(residual)
    size = first = float(residual @ better)
    if not first > 0:
        return x, 0, 0.0 if first == 0 else float("inf")
    for count in range(1, most + 1):
        product = apply(direction)
        curvature = float(direction @ product)
        if not curvature > 0:  # 0 where nothing sees the direction; NaN where the model broke down
            return x, count, float("inf")
        length = size / curvature
        x = x + length * direction
        residual = residual - length * product
        better = precondition(residual)
        size, before = max(float(residual @ better), 0.0), size
        if size <= tolerance**2 * first:
            return x, count, float(np.sqrt(size / first))
        direction = better + (size / before) * direction
    return x, most, float(np.sqrt(size / first))


def free_levenberg_marquardt(
    problem: FreeProblem,
    method: FreeLevenbergMarquardt | None = None,
    theta: FloatArray | None = None,
    progress: Progress | None = None,
    keeper: Keeper | None = None,
) -> FreeMinimum:
    """The minimum that `FreeLevenbergMarquardt` reaches from `theta`, or from the state that `keeper` has.

    The problem's own start where neither is given.
    """
    method = method or FreeLevenbergMarquardt()
    begun = None if keeper is None else keeper.state
    if begun is None:
        theta = np.array(problem.theta_start if theta is None else theta, dtype=np.float64)
        costs, inner, damping, growth = [], [], method.initial_damping, 2.0
    else:
        theta, costs, inner = np.array(begun["theta"]), [*begun["costs"]], [*begun["inner"]]
        damping, growth = float(begun["damping"]), float(begun["growth"])
    at = problem.linearize_free(theta)
    cost = float(at.residual @ at.residual)
    costs = costs or [cost]
    message, converged = f"stopped after {method.max_iterations} iterations", False
    for iteration in range(len(inner), method.max_iterations):
        step, count, promised = _step(at, damping, method)
        slope = np.maximum(np.abs(problem.slope(theta)), 1e-100)
        size = parameter_sizes(problem, problem.physical(theta)) / slope
        if (np.abs(step) <= method.step_tolerance * size).all() or damping > _MOST_DAMPING:
            message, converged = "the step fell below its tolerance", True
            break
        if promised <= method.gain_tolerance * cost and damping < 1e3:
            message, converged = "no further decrease is promised", True
            break
        step = step / max(1.0, float((np.abs(step) / (method.largest_step * size)).max(initial=0.0)))
        residual = residual_at(problem, theta + step)
        new = np.inf if residual is None else float(residual @ residual)
        gain = (cost - new) / promised if promised > 0 else -1.0
        if gain > 1e-4:
            theta = theta + step
            at = problem.linearize_free(theta)
            cost = new
            damping = max(damping * max(1 / 10, 1 - (2 * min(gain, 1.0) - 1) ** 3), 1e-20)
            growth = 2.0
        else:
            damping, growth = damping * growth, growth * 2
        costs.append(cost)
        inner.append(count)
        if keeper is not None:
            keeper.keep(iteration + 1, cost, partial(_state, theta, damping, growth, tuple(costs), tuple(inner)))
        if progress is not None:
            progress(iteration + 1, cost)
    return FreeMinimum(theta, at, np.array(costs), np.array(inner, dtype=int), converged, message)


def _state(theta: FloatArray, damping: float, growth: float, costs: Sequence[float], inner: Sequence[int]) -> State:
    return {
        "theta": theta,
        "damping": damping,
        "growth": growth,
        "costs": np.array(costs),
        "inner": np.array(inner, dtype=int),
    }


def _step(at: FreeLinearization, damping: float, method: FreeLevenbergMarquardt) -> tuple[FloatArray, int, float]:
    """The damped step, its conjugate gradient iterations, and the decrease that the linear model promises."""
    weight = damping * at.squares
    gradient = at.transposed(at.residual)
    step, count, _ = conjugate_gradients(
        lambda v: at.information(v) + weight * v,
        -gradient,
        preconditioner(at, weight),
        method.inner_tolerance,
        method.max_inner,
    )
    linear = at.product(step)
    return step, count, -float(linear @ linear + 2 * step @ gradient)

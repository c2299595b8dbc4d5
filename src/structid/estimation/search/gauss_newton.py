"""Gauss-Newton: full steps on the linearized residual, halved where asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from structid.arrays import FloatArray
from structid.declared import Count, Positive
from structid.estimation.problem import Problem
from structid.estimation.search.minimum import Keeper, Minimum, Progress, State, cost_at


@dataclass(frozen=True)
class GaussNewton:
    """Full Gauss-Newton steps, halved while the residual grows if `step_control` is on.

    Parameters
    ----------
    max_iterations : int
        After which a search that has not converged ends.
    step_control : bool
        Off: the classical iteration, which takes every step as it comes (Norris 1986, Eq. 4.17).
    step_tolerance : float
        Converged when no free variable moves by more.
    """

    max_iterations: Count = 50
    step_control: bool = True
    step_tolerance: Positive = 1e-11


def gauss_newton(
    problem: Problem,
    method: GaussNewton,
    theta: FloatArray,
    progress: Progress | None,
    keeper: Keeper | None = None,
) -> Minimum:
    """The minimum that `GaussNewton` reaches from `theta`, or from the state that `keeper` has."""
    begun = None if keeper is None else keeper.state
    if begun is not None:
        theta = np.array(begun["theta"])
    at = problem.linearize(theta)
    cost = float(at.residual @ at.residual)
    history, costs = [theta], [cost]
    if begun is not None:
        history, costs = list(np.array(begun["history"])), np.asarray(begun["costs"]).tolist()
        cost = costs[-1]
    message, converged = f"stopped after {method.max_iterations} iterations", False
    for iteration in range(len(costs) - 1, method.max_iterations):
        step = -np.linalg.lstsq(at.jacobian, at.residual, rcond=None)[0]
        size = 1.0
        new_cost = cost_at(problem, theta + step)
        while method.step_control and not new_cost <= cost and size > 1e-6:
            size /= 2
            new_cost = cost_at(problem, theta + size * step)
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
        if keeper is not None:
            keeper.keep(iteration + 1, cost, partial(_state, theta, tuple(history), tuple(costs)))
    return Minimum(theta, at, np.array(history), np.array(costs), converged, message)


def _state(theta: FloatArray, history: Sequence[FloatArray], costs: Sequence[float]) -> State:
    """All that the next iteration depends on, but what the problem gives at `theta`."""
    return {"theta": theta, "history": np.array(history), "costs": np.array(costs)}

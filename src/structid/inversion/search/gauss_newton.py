"""Gauss-Newton: full steps on the linearized residual, halved where asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.constraints import Count, Positive
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import Damping, End, IterationResult, Point, cost_at
from structid.inversion.search.levenberg_marquardt import WithJacobian

_SHORTEST = 1e-6


@dataclass(frozen=True)
class GaussNewton(WithJacobian):
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

    initial_damping: ClassVar[float] = 0.0
    largest_step: ClassVar[float] = np.inf

    def for_polishing(self) -> GaussNewton:
        return self

    def at(self, problem: Problem, theta: FloatArray) -> Point[Linearization]:
        none = np.zeros(len(theta))
        return Point(theta, problem.linearize(theta), none, none + np.inf)

    def tried(self, problem: Problem, point: Point[Linearization], damping: Damping) -> IterationResult:
        """Trial with the Gauss-Newton step from `point`, or without a step and with the reason to end the search.

        With `step_control` the step is halved until the sum of squares does not grow, down to 1e-6 of it. The search
        ends without a step if none is found (converged if the whole step is below a thousand step tolerances) or the
        model cannot be evaluated at its end, and with this step if every entry is below the step tolerance. `damping`
        is not used.
        """
        step = -np.linalg.lstsq(point.at.jacobian, point.at.residual, rcond=None)[0]
        size, cost = 1.0, cost_at(problem, point.theta + step)
        while self.step_control and not cost <= point.cost and size > _SHORTEST:
            size /= 2
            cost = cost_at(problem, point.theta + size * step)
        if not np.isfinite(cost):
            return IterationResult(None, end=End(False, "the step leads where the model cannot be evaluated"))
        if self.step_control and cost > point.cost:
            is_small = bool(np.abs(step).max(initial=0.0) < 1e3 * self.step_tolerance)
            return IterationResult(None, end=End(is_small, "no shorter step lowers the residual"))
        arrived = np.abs(size * step).max(initial=0.0) < self.step_tolerance
        return IterationResult(size * step, end=End(True, "the step fell below its tolerance") if arrived else None)

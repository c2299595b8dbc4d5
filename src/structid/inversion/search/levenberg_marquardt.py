"""Levenberg-Marquardt with geodesic acceleration: damped steps that bend with the valley they follow; and Gauss-Newton.

Gauss-Newton takes full steps on the linearized residual, halved where asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray
from structid.core.constraints import Count, NotNegative, Positive
from structid.inversion.fixed_values import FixedColumns
from structid.inversion.linearization import Linearization, solve_upper
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import (
    LEFT,
    Damping,
    End,
    IterationResult,
    Minimum,
    Point,
    cost_at,
    damped_end,
    residual_at,
    shortened,
    sizes_at,
    squared,
)
from structid.inversion.uncertainty import Uncertainty, dense_uncertainty, misfits

_ROUNDING = 1e-14
#: A step that lowers the sum of squares by more than this part of what the linear model promises goes as it is.
_KEPT = 0.7
#: A parameter whose largest step changes the residual by less than this part of what the whole step promises is held.
_NEGLIGIBLE = 0.01
#: Rounds of holding those that leave the reach of the search and solving for the others again.
_MOST_HOLDS = 4
#: Gain below which a reduced basis promises nothing: of thousands of values, some hundredths of a standard deviation.
_OF_REDUCED = 1e-8
#: Part of the sum of squares that linear steps promise at most where one of several searches is left, and a search is not taken
#: to gain more than so many times what they promise.
_LEFT_AT, _MOST_GAINED = 1e-5, 4.0
#: Most iterations of a stage, and the part of its sum of squares that its last step promises to gain.
_STAGE_ITERATIONS, _STAGE_GAIN = 600, 1e-6
#: Iterations of a stage that together must lower its sum of squares by more than this part.
_PATIENCE, _STALLED = 15, 0.03


class WithJacobian:
    """Base of the methods that form a Jacobian."""

    is_matrix_free: ClassVar[bool] = False

    def for_stages(self) -> LevenbergMarquardt:
        return LevenbergMarquardt(max_iterations=_STAGE_ITERATIONS, gain_tolerance=_STAGE_GAIN)

    def patient(self) -> Self:
        return self

    def has_stalled(self, costs: Sequence[float] | FloatArray) -> bool:
        return False

    def for_reduced(self) -> Self:
        return self

    def raced(self, above: float) -> WithJacobian:
        return self

    def misfits(self, problem: Problem, minimum: Minimum, probability: float) -> bool:
        """True if noise alone would give a larger sum of squares than `minimum` with less than this probability."""
        return misfits(problem, minimum.theta, cast(Linearization, minimum.linearization), probability)

    def uncertainty(
        self,
        problem: Problem,
        minimum: Minimum,
        misfit_probability: float,
        seed: int,
        fixed: FixedColumns | None = None,
    ) -> Uncertainty:
        """Covariance and rank at `minimum` from the information matrix of its Jacobian; `seed` is not used.

        The fit holds model error if its chi-square is less probable than `misfit_probability`. Values that the model
        fixes, `fixed`, are exact if None.
        """
        linearization = cast(Linearization, minimum.linearization)
        return dense_uncertainty(problem, minimum.theta, linearization, minimum.converged, misfit_probability, fixed)


@dataclass(frozen=True, eq=False)
class FactoredPoint(Point[Linearization]):
    """A point with the triangle of the QR factorization J = Q R, all that steps from it need, and Q'r."""

    triangle: FloatArray
    projected: FloatArray

    @property
    def rounding(self) -> float:
        """Norm of the change of the residual by a rounding of all parameters relative to their sizes."""
        return _ROUNDING * float(np.linalg.norm(self.triangle * self.size))

    def promised(self, step: FloatArray) -> float:
        """Decrease of the sum of squares after `step` (n_params,) that the linear model predicts."""
        linear = self.triangle @ step
        return -float(linear @ linear + 2 * linear @ self.projected)


@dataclass(frozen=True, eq=False)
class _Damped:
    """QR factorization of [R; sqrt(damping) D], which turns a right-hand side into a damped step."""

    orthogonal: FloatArray
    triangle: FloatArray
    scale: FloatArray

    def step(self, projected: FloatArray) -> FloatArray:
        """Step s (n_params,) that minimizes |R s + projected|^2 + damping |D s|^2, with `projected` (n_params,)."""
        right = self.orthogonal[: len(projected)].T @ projected
        return -solve_upper(self.triangle, right)

    def downhill(self, gradient: FloatArray) -> FloatArray:
        """Damped step s (n_params,) from the gradient J'r (n_params,): minimizes |J s|^2 + 2 s'J'r + damping |D s|^2."""
        down = solve_upper(self.triangle, gradient, transposed=True)
        return -solve_upper(self.triangle, down)

    def step_holding(self, projected: FloatArray, held: NDArray[np.bool_], values: FloatArray) -> FloatArray:
        """Damped step (n_params,) with the entries in the mask `held` fixed at those of `values`, both (n_params,).

        `projected` (n_params,) is Q'r, the residual in the coordinates of the triangle. Entries of `values` outside the
        mask do not count.
        """
        right = self.orthogonal[: len(projected)].T @ projected + self.triangle[:, held] @ values[held]
        orthogonal, factor = np.linalg.qr(self.triangle[:, ~held])
        step = np.array(values)
        step[~held] = -solve_upper(factor, orthogonal.T @ right)
        return step

    def length(self, step: FloatArray) -> float:
        return float(np.linalg.norm(self.scale * step))


def _damped(triangle: FloatArray, damping: float, scale: FloatArray) -> _Damped:
    """QR factors of the Jacobian's `triangle` above the damping rows sqrt(damping) diag(scale); zeros in `scale` count as 1."""
    safe = np.where(scale > 0, scale, 1.0)
    orthogonal, factor = np.linalg.qr(np.vstack([triangle, np.diag(np.sqrt(damping) * safe)]))
    return _Damped(orthogonal, factor, safe)


def _velocity(point: FactoredPoint, damped: _Damped, damping: Damping) -> FloatArray:
    """Damped step (n_params,) from `point`, with runaway parameters and those at the end of their reach kept there.

    `damped` has the factors of the damped Jacobian, `damping` the largest step of each parameter and the reach of the
    search. A parameter runs away if its step exceeds the largest but moving it so far changes the residual by less than
    1 % of the predicted decrease, such as a loss factor on its way to 0: it is kept at the largest step. The step of
    the others is solved anew, at most four times; these may still exceed their largest step.
    """
    limit, velocity = damping.limit, damped.step(point.projected)
    effect = point.scale * limit
    held = (np.abs(velocity) > limit) & (effect**2 < _NEGLIGIBLE * point.promised(velocity))
    if held.all():
        held = np.zeros(len(held), dtype=bool)
    low, high = damping.reach.T - point.theta
    for _ in range(_MOST_HOLDS):
        short = np.clip(np.clip(velocity, -limit, limit), low, high)
        leaves = np.clip(velocity, -limit, limit) != short
        if not ((held | leaves) & (velocity != short)).any():
            break
        held = held | leaves
        if held.all():
            return short
        velocity = damped.step_holding(point.projected, held, short)
    return velocity


@dataclass(frozen=True)
class LevenbergMarquardt(WithJacobian):
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

    def for_reduced(self) -> LevenbergMarquardt:
        return replace(self, gain_tolerance=max(self.gain_tolerance, _OF_REDUCED))

    def raced(self, above: float, left_at: float = _LEFT_AT) -> Raced:
        return Raced(**vars(self), above=above, left_at=left_at)

    def for_polishing(self) -> LevenbergMarquardt:
        """Steps are hardly damped."""
        return replace(self, initial_damping=1e-9, acceleration=0.0, gain_tolerance=max(self.gain_tolerance, 1e-10))

    def at(self, problem: Problem, theta: FloatArray) -> FactoredPoint:
        """Linearization at free variables `theta` (n_params,) with its QR triangle, column norms and sizes."""
        linearization = problem.linearize(theta)
        both, n = linearization.triangle(), linearization.n_params
        triangle, projected = both[:n, :n], both[:n, n]
        return FactoredPoint(
            theta=theta,
            at=linearization,
            scale=np.linalg.norm(triangle, axis=0),
            size=sizes_at(problem, theta),
            triangle=triangle,
            projected=projected,
        )

    def tried(self, problem: Problem, point: FactoredPoint, damping: Damping) -> IterationResult:
        """Trial with the damped step from `point` and its gain ratio, or without a step and with the reason to end.

        The step is cut to the largest one of each parameter and to the reach of the search. If it keeps at most 0.7 of
        the predicted decrease, it is also tried with acceleration and the better one taken. The gain ratio is the
        decrease of the sum of squares over that predicted for the uncut step. The step may raise the sum of squares.
        `damping` has the factor of the damping, its scale, the largest steps and the reach.
        """
        damped = _damped(point.triangle, damping.factor, damping.scale)
        velocity = _velocity(point, damped, damping)
        promised = point.promised(velocity)
        end = damped_end(point, damping, velocity, promised, self.step_tolerance, self.gain_tolerance)
        if end is not None:
            return IterationResult(None, end=end)
        low, high = damping.reach.T - point.theta
        step = np.clip(shortened(velocity, damping.limit), low, high)
        residual = residual_at(problem, point.theta + step)
        cost = squared(residual)
        # a step cut to its limit is held to the promise of the whole: damping then grows until it turns downhill instead
        if residual is not None and point.cost - cost <= _KEPT * promised:
            bent = self._bent_step(point, damped, step, residual)
            if bent is not None:
                bent = np.clip(shortened(bent, damping.limit), low, high)
                bent_cost = cost_at(problem, point.theta + bent)
                step, cost = (bent, bent_cost) if bent_cost < cost else (step, cost)
        return IterationResult(step, (point.cost - cost) / promised if promised > 0 else -1.0)

    def _bent_step(
        self, point: FactoredPoint, damped: _Damped, step: FloatArray, residual: FloatArray
    ) -> FloatArray | None:
        """Step with half of its geodesic acceleration, (n_params,), from the `residual` after `step`.

        None if `self.acceleration` is 0, if the curvature is below rounding, or if the acceleration is longer than
        `self.acceleration` times the step, both weighted by the damping's scale of each parameter. `point` is where the
        step begins, `damped` its damped Jacobian; `step` is (n_params,), `residual` (n_residuals,).
        """
        if self.acceleration <= 0:
            return None
        bend = residual - point.at.residual - point.at.jacobian @ step
        if np.linalg.norm(bend) <= point.rounding:
            return None
        acceleration = 2 * damped.downhill(point.at.jacobian.T @ bend)
        if not damped.length(acceleration) <= self.acceleration * damped.length(step):
            return None
        return np.asarray(step + 0.5 * acceleration)


@dataclass(frozen=True)
class _ForStages(LevenbergMarquardt):
    """Searches that lead near a minimum: they end where many iterations gain little, as along a valley that leads nowhere."""

    def has_stalled(self, costs: Sequence[float] | FloatArray) -> bool:
        """True where the last 15 iterations lowered the sum of squares by less than 3 %."""
        return len(costs) > _PATIENCE and costs[-1] > (1 - _STALLED) * costs[-1 - _PATIENCE]


@dataclass(frozen=True)
class Raced(LevenbergMarquardt):
    """Searches that end early where they would end above a sum of squares.

    Parameters
    ----------
    above : float
        Sum of squares from which on an end is of no use, or of use only where no other search ends below it.
    left_at : float
        Part of the sum of squares that linear steps promise at most before a search is ended.
    is_patient : bool
        Whether easier forms of the problem are searched to their end; else they are left where they hardly gain any more.
    """

    above: float = np.inf
    left_at: Positive = _LEFT_AT
    is_patient: bool = False

    def for_stages(self) -> LevenbergMarquardt:
        if self.is_patient:
            return super().for_stages()
        return _ForStages(max_iterations=_STAGE_ITERATIONS, gain_tolerance=_STAGE_GAIN)

    def patient(self) -> Raced:
        return replace(self, is_patient=True)

    def tried(self, problem: Problem, point: FactoredPoint, damping: Damping) -> IterationResult:
        """Levenberg-Marquardt trial from `point`, or the end of a search that will probably stay above `self.above`.

        It ends, not converged, if the decrease of the undamped step is below `self.left_at` of the sum of squares, and
        four times that decrease would not bring the sum of squares down to `self.above`. `damping` is that of the
        trial.
        """
        promised = float(point.projected @ point.projected)
        if promised < self.left_at * point.cost and point.cost - _MOST_GAINED * promised > self.above:
            return IterationResult(None, end=End(False, LEFT))
        return super().tried(problem, point, damping)


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

"""A search with parameters too many for a Jacobian: damped steps by conjugate gradients, the priors as preconditioner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, cast

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.inversion.covariance import row_law
from structid.inversion.diagnostics.residual_tests import misses_noise
from structid.inversion.fixed_values import FixedColumns
from structid.inversion.linearization import OperatorLinearization, conjugate_gradients, preconditioner
from structid.inversion.posterior_draws import drawn_uncertainty
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import (
    Damping,
    IterationResult,
    Minimum,
    Point,
    cost_at,
    damped_end,
    shortened,
    sizes_at,
)
from structid.inversion.uncertainty import Uncertainty


@dataclass(frozen=True)
class MatrixFree:
    """Damped steps whose equations are solved by preconditioned conjugate gradients; uncertainty by posterior draws.

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
        No parameter changes in one step by more than this part of its largest magnitude so far.
    inner_tolerance : float
        Conjugate gradients end when the residual of the equations is this part of their right-hand side, in the norm
        of the preconditioner.
    max_inner : int
        Conjugate gradient iterations a step.
    draws : int
        Posterior draws for the standard deviations; 0 gives NaN.
    solved : tuple of str
        Parameters whose standard deviation is solved for, one system of equations each.

    Raises
    ------
    InputError
        If `draws` is 1 or negative.

    References
    ----------
    Madsen, Nielsen and Tingleff (2004), Methods for Non-Linear Least Squares Problems, algorithm 3.16.
    Nocedal and Wright (2006), Numerical Optimization, section 7.1, for steps that are not exact.
    """

    is_matrix_free: ClassVar[bool] = True

    max_iterations: int = 50
    step_tolerance: float = 1e-6
    gain_tolerance: float = 1e-6
    initial_damping: float = 1e-3
    largest_step: float = 0.7
    inner_tolerance: float = 1e-6
    max_inner: int = 500
    draws: int = 32
    solved: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.draws < 0 or self.draws == 1:
            raise InputError(f"`draws` must be 0 or at least 2, got {self.draws}; 32 gives standard deviations to 12 %")

    def at(self, problem: Problem, theta: FloatArray) -> Point[OperatorLinearization]:
        linearization = problem.linearize_operator(theta)
        return Point(theta, linearization, np.sqrt(linearization.squares), sizes_at(problem, theta))

    def tried(self, problem: Problem, point: Point[OperatorLinearization], damping: Damping) -> IterationResult:
        """Trial with the damped step from `point` by conjugate gradients and its gain ratio, or with the reason to end.

        The gain ratio is the decrease of the sum of squares over that predicted for the step before it is shortened to
        its limit; -1 if none is predicted. `damping` has the factor of the damping, its scale and the largest steps.
        """
        linearization, weight = point.at, damping.factor * damping.scale**2
        gradient = linearization.transposed(linearization.residual)
        step, count, _ = conjugate_gradients(
            lambda v: linearization.information(v) + weight * v,
            -gradient,
            preconditioner(linearization, weight),
            self.inner_tolerance,
            self.max_inner,
        )
        linear = linearization.product(step)
        promised = -float(linear @ linear + 2 * step @ gradient)
        end = damped_end(point, damping, step, promised, self.step_tolerance, self.gain_tolerance)
        if end is not None:
            return IterationResult(None, end=end)
        step = shortened(step, damping.limit)
        cost = cost_at(problem, point.theta + step)
        return IterationResult(step, (point.cost - cost) / promised if promised > 0 else -1.0, count)

    def for_stages(self) -> MatrixFree:
        return replace(self, max_iterations=20, gain_tolerance=1e-3, inner_tolerance=1e-3)

    def for_polishing(self) -> MatrixFree:
        return replace(self, initial_damping=1e-9)

    def patient(self) -> MatrixFree:
        return self

    def has_stalled(self, costs: Sequence[float] | FloatArray) -> bool:
        return False

    def raced(self, above: float) -> MatrixFree:
        return self

    def for_reduced(self) -> MatrixFree:
        return self

    def misfits(self, problem: Problem, minimum: Minimum, probability: float) -> bool:
        """True if noise alone would give a larger sum of squares than `minimum` with less than this probability.

        Degrees of freedom are the rows, priors included, less the parameters.
        """
        linearization = minimum.linearization
        freedom, (scale, share) = len(linearization.residual) - linearization.n_params, row_law(problem.rows.averages)
        return misses_noise(problem, linearization.residual, scale, share * freedom, probability)

    def uncertainty(
        self,
        problem: Problem,
        minimum: Minimum,
        misfit_probability: float,
        seed: int,
        fixed: FixedColumns | None = None,
    ) -> Uncertainty:
        """Covariance and rank at `minimum` from `self.draws` draws of the posterior, by `seed`.

        The fit holds model error if its chi-square is less probable than `misfit_probability`. Values that the model
        fixes, `fixed`, are exact if None.
        """
        linearization = cast(OperatorLinearization, minimum.linearization)
        return drawn_uncertainty(
            problem, minimum.theta, linearization, self.draws, self.solved, misfit_probability, seed, fixed
        )

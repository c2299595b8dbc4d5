"""Separable least squares: linear unknowns eliminated at each point, the others searched for as every problem's are.

The Jacobian of all rows is not kept. Its normal equations give n + 1 rows with the same steps and sums of squares, which is
all that a search needs.

References
----------
Golub and Pereyra (2003), Separable nonlinear least squares, Inverse Problems 19, R1-R26.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.linearization import LastEvaluation, Linearization
from structid.inversion.problem import DataRows, FreeUnknowns, Problem
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt

_ROUNDING = float(np.finfo(np.float64).eps)


class NormalEquations(NamedTuple):
    """Sums J'J, J'r and r'r over all rows of a residual r with Jacobian J."""

    matrix: FloatArray
    """J'J, (n_params, n_params)."""
    gradient: FloatArray
    """J'r, (n_params,)."""
    cost: float
    """r'r."""

    @property
    def columns(self) -> FloatArray:
        """Lengths of the columns of J, (n_params,)."""
        return np.asarray(np.sqrt(np.diag(self.matrix)))

    def compressed(self) -> Linearization:
        """Linearization with n_params + 1 rows that has these normal equations: the same J'J, J'r and r'r, to rounding."""
        n = len(self.gradient)
        scale = np.where(self.columns > 0, self.columns, 1.0)
        values, vectors = np.linalg.eigh(self.matrix / np.outer(scale, scale))
        root = np.sqrt(np.maximum(values, _ROUNDING * max(values[-1], _ROUNDING)))
        along = vectors.T @ (self.gradient / scale) / root
        across = np.sqrt(max(self.cost - float(along @ along), 0.0))
        jacobian = np.zeros((n + 1, n))
        jacobian[:n] = root[:, None] * vectors.T * scale
        return Linearization(np.append(along, across), jacobian)


@dataclass(frozen=True, eq=False)
class EliminatedProblem(Problem):
    """The nonlinear unknowns of separable least squares, as they change from where a search begins.

    The residual is one row and a linearization has n_params + 1 compressed rows: a search must go without acceleration, which
    needs the rows of both to be the same.

    Attributes
    ----------
    sizes : (n_params,) float array
        Magnitude of each unknown; a free variable is 1 plus the change of its unknown in this unit.
    cost : callable
        Sum of squares after changes (n_params,) of the unknowns; infinite where there is no model.
    normal : callable
        Normal equations after changes, by the unknowns.
    """

    sizes: FloatArray
    cost: Callable[[FloatArray], float]
    normal: Callable[[FloatArray], NormalEquations]

    @cached_property
    def unknowns(self) -> FreeUnknowns:
        return FreeUnknowns(tuple(f"unknown {k + 1}" for k in range(len(self.sizes))), np.ones(len(self.sizes)))

    @property
    def rows(self) -> DataRows:
        """Numbers of the compressed rows, which belong to no line or channel."""
        numbers = np.arange(len(self.sizes) + 1)
        return DataRows(numbers, np.zeros_like(numbers))

    def changes(self, theta: FloatArray) -> FloatArray:
        """Changes (n_params,) of the unknowns from their starts, in their own units, at free variables `theta`."""
        return np.asarray((theta - 1) * self.sizes)

    def residual(self, theta: FloatArray) -> FloatArray:
        """Residual (1,) at free variables `theta`: the root of the sum of squares, infinite without a model."""
        return np.array([np.sqrt(self.cost(self.changes(theta)))])

    def linearize(self, theta: FloatArray) -> Linearization:
        rows = self.normal_at(self.changes(theta)).compressed()
        return Linearization(rows.residual, rows.jacobian * self.sizes)

    def normal_at(self, changes: FloatArray) -> NormalEquations:
        """`normal` after changes (n_params,) of the unknowns; asked again for the same ones, it is not made again."""
        return self._last.at(changes, self.normal)

    @cached_property
    def _last(self) -> LastEvaluation[NormalEquations]:
        return LastEvaluation()


def minimize_eliminated(problem: EliminatedProblem, method: LevenbergMarquardt) -> tuple[FloatArray, bool] | None:
    """Changes of the unknowns (n_params,) from zero to the nearest minimum, and True if the search converged.

    None if an unknown has no effect at zero, or one that is not finite. `method` must have no acceleration (asserted).
    """
    assert method.acceleration == 0, "residual and linearization have other rows"
    effects = problem.normal_at(np.zeros(len(problem.sizes))).columns
    if not (np.isfinite(effects) & (effects > 0)).all():
        return None
    end = minimize(problem, method)
    return problem.changes(end.theta), end.converged

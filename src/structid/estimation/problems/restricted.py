"""A problem with one variable held, or with other errors in its rows: what profiles and bootstraps fit again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.estimation.covariance import score_covariance
from structid.estimation.problem import Linearization, Problem
from structid.estimation.problems.wrapped import Wrapped


@dataclass(frozen=True, eq=False)
class Shifted(Wrapped):
    """`problem` with `shift` added to its residual: other data of the same noise, in units of that noise.

    Parameters
    ----------
    problem : Problem
    shift : (n_residuals,) float array
    """

    problem: Problem
    shift: FloatArray

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta) + self.shift

    def linearize(self, theta: FloatArray) -> Linearization:
        at = self.problem.linearize(theta)
        return Linearization(at.residual + self.shift, at.jacobian, at.n_eliminated)


@dataclass(frozen=True, eq=False)
class Held(Wrapped):
    """`problem` with one free variable held at a value; the others are free.

    Parameters
    ----------
    problem : Problem
    index : int
        Of the variable that is held.
    value : float
        Where.
    """

    problem: Problem
    index: int
    value: float

    @property
    def names(self) -> tuple[str, ...]:
        return self._without(self.problem.names)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._without(self.problem.kinds)

    @property
    def units(self) -> tuple[str, ...]:
        return self._without(self.problem.units)

    @property
    def theta_start(self) -> FloatArray:
        return np.delete(self.problem.theta_start, self.index)

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,)."""
        return np.insert(others, self.index, self.value)

    def residual(self, others: FloatArray) -> FloatArray:
        return self.problem.residual(self.whole(others))

    def linearize(self, others: FloatArray) -> Linearization:
        at = self.problem.linearize(self.whole(others))
        return Linearization(at.residual, np.delete(at.jacobian, self.index, axis=1), at.n_eliminated)

    def score_covariance(self, others: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        whole = np.insert(jacobian, self.index, 0.0, axis=1)
        found = score_covariance(self.problem, self.whole(others), whole)
        return None if found is None else np.delete(np.delete(found, self.index, axis=0), self.index, axis=1)

    def physical(self, others: FloatArray) -> FloatArray:
        return np.delete(self.problem.physical(self.whole(others)), self.index)

    def slope(self, others: FloatArray) -> FloatArray:
        return np.delete(self.problem.slope(self.whole(others)), self.index)

    def _without(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return entries[: self.index] + entries[self.index + 1 :]

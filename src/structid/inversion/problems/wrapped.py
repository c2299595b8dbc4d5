"""A problem around another one: as it is, with other errors in its rows, or with a variable held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import Data, OfData, OfUnknowns, Problem, Stages, Unknowns


@dataclass(frozen=True, eq=False)
class Wrapped(OfUnknowns, OfData):
    """Everything as the inner `problem` has it; subclasses change some of it."""

    problem: Problem

    def around(self, problem: Problem) -> Problem:
        """The same around another problem with these parameters, such as an easier form."""
        return replace(self, problem=problem)

    @property
    def unknowns(self) -> Unknowns:
        return self.problem

    @property
    def data(self) -> Data:
        return self.problem

    @property
    def matrix_free_obstacle(self) -> str:
        return self.problem.matrix_free_obstacle

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        return self.problem.linearize_operator(theta)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return self.problem.prior_rows(theta)

    def stage_plans(self) -> Sequence[Stages]:
        plans = self.problem.stage_plans()
        return tuple(tuple((name, self.around(stage)) for name, stage in plan) for plan in plans)

    def ways(self) -> Sequence[Stages]:
        return self.stage_plans()

    def thinned(self) -> Problem | None:
        part = self.problem.thinned()
        return None if part is None else self.around(part)


@dataclass(frozen=True, eq=False)
class Shifted(Wrapped):
    """`problem` with `shift` added to its residual: other data of the same noise, in units of that noise.

    Parameters
    ----------
    problem : Problem
    shift : (n_residuals,) float array
    """

    shift: FloatArray

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta) + self.shift

    def linearize(self, theta: FloatArray) -> Linearization:
        at = self.problem.linearize(theta)
        return replace(at, residual=at.residual + self.shift)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        at = self.problem.linearize_operator(theta)
        return replace(at, residual=at.residual + self.shift)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(theta)
        return residual + self.shift[self.n_data :], rows

    def stage_plans(self) -> Sequence[Stages]:
        """None: their rows are others than those that are shifted."""
        return ()

    def thinned(self) -> Problem | None:
        return None


@dataclass(frozen=True, eq=False)
class _AllButOne:
    """`every` unknown but the one at `index`, whose free variable is `value`."""

    every: Unknowns
    index: int
    value: float

    @property
    def names(self) -> tuple[str, ...]:
        return self._rest(self.every.names)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._rest(self.every.kinds)

    @property
    def units(self) -> tuple[str, ...]:
        return self._rest(self.every.units)

    @property
    def theta_start(self) -> FloatArray:
        return np.delete(self.every.theta_start, self.index)

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,)."""
        return np.insert(others, self.index, self.value)

    def physical(self, others: FloatArray) -> FloatArray:
        return np.delete(self.every.physical(self.whole(others)), self.index)

    def slope(self, others: FloatArray) -> FloatArray:
        return np.delete(self.every.slope(self.whole(others)), self.index)

    def sizes(self, physical: FloatArray) -> FloatArray:
        own = self.every.physical(self.whole(self.theta_start))[self.index]
        return np.delete(self.every.sizes(np.insert(physical, self.index, own)), self.index)

    @property
    def bounds(self) -> FloatArray:
        return np.delete(self.every.bounds, self.index, axis=0)

    @property
    def reach(self) -> FloatArray:
        return np.delete(self.every.reach, self.index, axis=0)

    def _rest(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return entries[: self.index] + entries[self.index + 1 :]


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

    index: int
    value: float

    @property
    def unknowns(self) -> _AllButOne:
        return _AllButOne(self.problem, self.index, self.value)

    @property
    def matrix_free_obstacle(self) -> str:
        return "takes no variable that is held"

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,)."""
        return self.unknowns.whole(others)

    def residual(self, others: FloatArray) -> FloatArray:
        return self.problem.residual(self.whole(others))

    def linearize(self, others: FloatArray) -> Linearization:
        at = self.problem.linearize(self.whole(others))
        return replace(at, jacobian=np.delete(at.jacobian, self.index, axis=1))

    def data_changes(self, others: FloatArray) -> FloatArray | None:
        return self.problem.data_changes(self.whole(others))

    def score_covariance(self, others: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        found = self.problem.score_covariance(self.whole(others), np.insert(jacobian, self.index, 0.0, axis=1))
        return None if found is None else np.delete(np.delete(found, self.index, axis=0), self.index, axis=1)

    def prior_rows(self, others: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(self.whole(others))
        return residual, sparse.csr_array(rows[:, np.delete(np.arange(rows.shape[1]), self.index)])

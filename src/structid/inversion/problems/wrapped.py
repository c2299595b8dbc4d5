"""Problems made of another one: with other data of the same noise, or with one free variable fixed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import DataRows, NoiseLaw, Problem, Unknowns


@dataclass(frozen=True, eq=False)
class Wrapped(Problem):
    """A problem that answers as the inner `problem` does; subclasses change a part of it."""

    problem: Problem

    @property
    def unknowns(self) -> Unknowns:
        return self.problem.unknowns

    @property
    def rows(self) -> DataRows:
        return self.problem.rows

    def noise_law(self, theta: FloatArray) -> NoiseLaw:
        return self.problem.noise_law(theta)

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        return self.problem.linearize_operator(theta)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return self.problem.prior_rows(theta)


@dataclass(frozen=True, eq=False)
class ShiftedResidual(Wrapped):
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
        linearization = self.problem.linearize(theta)
        return replace(linearization, residual=linearization.residual + self.shift)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        linearization = self.problem.linearize_operator(theta)
        return replace(linearization, residual=linearization.residual + self.shift)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(theta)
        return residual + self.shift[self.n_data :], rows


@dataclass(frozen=True, eq=False)
class _OtherUnknowns:
    """All of `unknowns` but the one at `index`, whose free variable is fixed at `value`."""

    unknowns: Unknowns
    index: int
    value: float

    @property
    def names(self) -> tuple[str, ...]:
        return self._others(self.unknowns.names)

    @property
    def kinds(self) -> tuple[str, ...]:
        return self._others(self.unknowns.kinds)

    @property
    def units(self) -> tuple[str, ...]:
        return self._others(self.unknowns.units)

    @property
    def theta_start(self) -> FloatArray:
        return np.delete(self.unknowns.theta_start, self.index)

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,), from the others."""
        return np.insert(others, self.index, self.value)

    def physical(self, others: FloatArray) -> FloatArray:
        return np.delete(self.unknowns.physical(self.whole(others)), self.index)

    def slope(self, others: FloatArray) -> FloatArray:
        return np.delete(self.unknowns.slope(self.whole(others)), self.index)

    def sizes(self, physical: FloatArray) -> FloatArray:
        fixed = self.unknowns.physical(self.whole(self.theta_start))[self.index]
        return np.delete(self.unknowns.sizes(np.insert(physical, self.index, fixed)), self.index)

    @property
    def bounds(self) -> FloatArray:
        return np.delete(self.unknowns.bounds, self.index, axis=0)

    @property
    def reach(self) -> FloatArray:
        return np.delete(self.unknowns.reach, self.index, axis=0)

    def _others(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return entries[: self.index] + entries[self.index + 1 :]


@dataclass(frozen=True, eq=False)
class _OtherScores:
    """Noise `law` of a problem seen by all of its unknowns but the one at `index`."""

    law: NoiseLaw
    index: int

    @property
    def factor(self) -> FloatArray | None:
        return self.law.factor

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        whole = self.law.score_covariance(np.insert(jacobian, self.index, 0.0, axis=1))
        return None if whole is None else np.delete(np.delete(whole, self.index, axis=0), self.index, axis=1)


@dataclass(frozen=True, eq=False)
class FixedVariable(Problem):
    """`problem` with one free variable fixed at a value; the others are its unknowns.

    Parameters
    ----------
    problem : Problem
    index : int
        Index of the fixed variable.
    value : float
        Its value.
    """

    problem: Problem
    index: int
    value: float

    @property
    def unknowns(self) -> _OtherUnknowns:
        return _OtherUnknowns(self.problem.unknowns, self.index, self.value)

    @property
    def rows(self) -> DataRows:
        return self.problem.rows

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,), from the others."""
        return self.unknowns.whole(others)

    def residual(self, others: FloatArray) -> FloatArray:
        return self.problem.residual(self.whole(others))

    def linearize(self, others: FloatArray) -> Linearization:
        linearization = self.problem.linearize(self.whole(others))
        return replace(linearization, jacobian=np.delete(linearization.jacobian, self.index, axis=1))

    def noise_law(self, others: FloatArray) -> NoiseLaw:
        return _OtherScores(self.problem.noise_law(self.whole(others)), self.index)

    def prior_rows(self, others: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(self.whole(others))
        return residual, sparse.csr_array(rows[:, np.delete(np.arange(rows.shape[1]), self.index)])

"""Problems made of another one: with other data of the same noise, or with some free variables fixed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
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
    """All of `unknowns` but those at `indices`, whose free variables are fixed at `values`."""

    unknowns: Unknowns
    indices: IntArray
    values: FloatArray

    @cached_property
    def free(self) -> IntArray:
        """Indices of the other free variables, rising."""
        return np.delete(np.arange(len(self.unknowns.names)), self.indices)

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
        return np.asarray(self.unknowns.theta_start)[self.free]

    def whole(self, others: FloatArray) -> FloatArray:
        """All free variables, (n_params,), from those that are not fixed, `others` (n_free,), and the fixed values."""
        whole = np.empty(len(self.unknowns.names))
        whole[self.free], whole[self.indices] = others, self.values
        return whole

    def physical(self, others: FloatArray) -> FloatArray:
        return np.asarray(self.unknowns.physical(self.whole(others))[self.free])

    def slope(self, others: FloatArray) -> FloatArray:
        return np.asarray(self.unknowns.slope(self.whole(others))[self.free])

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Sizes of the other unknowns (n_free,) at their `physical` values, with the fixed ones at theirs."""
        whole = np.array(self.unknowns.physical(self.whole(self.theta_start)))
        whole[self.free] = physical
        return np.asarray(self.unknowns.sizes(whole)[self.free])

    @property
    def bounds(self) -> FloatArray:
        return np.asarray(self.unknowns.bounds[self.free])

    @property
    def reach(self) -> FloatArray:
        return np.asarray(self.unknowns.reach[self.free])

    def _others(self, entries: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(entries[i] for i in self.free)


@dataclass(frozen=True, eq=False)
class _OtherScores:
    """Noise `law` of a problem seen by the unknowns at indices `free` of all `n_params`."""

    law: NoiseLaw
    free: IntArray
    n_params: int

    @property
    def factor(self) -> FloatArray | None:
        return self.law.factor

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Covariance (n_free, n_free) of J'r for data rows J, `jacobian` (n_data, n_free), by the free unknowns.

        None if `self.law` gives None, which means that it is J'J.
        """
        padded = np.zeros((len(jacobian), self.n_params))
        padded[:, self.free] = jacobian
        whole = self.law.score_covariance(padded)
        return None if whole is None else whole[np.ix_(self.free, self.free)]


@dataclass(frozen=True, eq=False)
class FixedVariables(Problem):
    """`problem` with some free variables fixed at values; the others are its unknowns.

    Parameters
    ----------
    problem : Problem
    indices : (n_fixed,) int array
        Indices of the fixed variables.
    values : (n_fixed,) float array
        Their values.
    """

    problem: Problem
    indices: IntArray
    values: FloatArray

    @cached_property
    def unknowns(self) -> _OtherUnknowns:
        return _OtherUnknowns(self.problem.unknowns, self.indices, self.values)

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
        return replace(linearization, jacobian=linearization.jacobian[:, self.unknowns.free])

    def linearize_operator(self, others: FloatArray) -> OperatorLinearization:
        """Residual at the variables that are not fixed, `others` (n_free,), and products with its Jacobian by them."""
        whole, free = self.problem.linearize_operator(self.whole(others)), self.unknowns.free

        def forward(v: FloatArray) -> FloatArray:
            padded = np.zeros(whole.n_params)
            padded[free] = v
            return whole.forward(padded)

        return replace(
            whole,
            forward=forward,
            adjoint=lambda u: np.asarray(whole.adjoint(u)[free]),
            data_squares=whole.data_squares[free],
            prior=sparse.csr_array(whole.prior[:, free]),
            jacobian=None if whole.jacobian is None else whole.jacobian[:, free],
        )

    def noise_law(self, others: FloatArray) -> NoiseLaw:
        law = self.problem.noise_law(self.whole(others))
        return _OtherScores(law, self.unknowns.free, len(self.problem.names))

    def prior_rows(self, others: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.problem.prior_rows(self.whole(others))
        return residual, sparse.csr_array(rows[:, self.unknowns.free])

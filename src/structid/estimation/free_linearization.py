"""A linearization whose Jacobian is not formed: products with it and with its transpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray
from structid.estimation.problem import Problem


@dataclass(frozen=True, eq=False)
class FreeLinearization:
    """Whitened residual at one point, and what its derivative does to vectors.

    Attributes
    ----------
    residual : (n_residuals,) float array
        Data rows first, then those of the priors.
    forward : callable
        J v of the data rows, (n_params,) to (n_data,).
    adjoint : callable
        J' u of the data rows, (n_data,) to (n_params,).
    data_squares : (n_params,) float array
        Diagonal of J'J of the data rows.
    prior : (n_priors, n_params) sparse array
        Derivative of the rows of the priors.
    words : str
        How the products are made.
    jacobian : (n_data, n_params) float array, optional
        Of the data rows, where it is stored all the same.
    """

    residual: FloatArray
    forward: Callable[[FloatArray], FloatArray]
    adjoint: Callable[[FloatArray], FloatArray]
    data_squares: FloatArray
    prior: sparse.csr_array
    words: str = ""
    jacobian: FloatArray | None = None

    @property
    def n_data(self) -> int:
        return len(self.residual) - self.prior.shape[0]

    @property
    def n_params(self) -> int:
        return len(self.data_squares)

    def product(self, v: FloatArray) -> FloatArray:
        """J v, all rows."""
        return np.concatenate([self.forward(v), self.prior @ v])

    def transposed(self, u: FloatArray) -> FloatArray:
        """J' u, all rows."""
        return self.adjoint(u[: self.n_data]) + self.prior.T @ u[self.n_data :]

    def information(self, v: FloatArray) -> FloatArray:
        """J'J v, all rows."""
        return self.adjoint(self.forward(v)) + self.prior.T @ (self.prior @ v)

    @property
    def squares(self) -> FloatArray:
        """Diagonal of J'J, all rows, (n_params,)."""
        return self.data_squares + np.asarray(self.prior.multiply(self.prior).sum(axis=0)).ravel()


class FreeProblem(Problem, Protocol):
    """A least-squares problem that also linearizes without forming its Jacobian."""

    def linearize_free(self, theta: FloatArray) -> FreeLinearization: ...

"""What an estimator sees of a problem: names, a start, residuals and their derivatives, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from structid.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Linearization:
    """Whitened residual and its derivative at one point.

    Attributes
    ----------
    residual : (n_residuals,) float array
        Data rows first, then one row for each prior; unit variance each where model and noise are right.
    jacobian : (n_residuals, n_params) float array
        Derivative with respect to the free variables.
    n_eliminated : int
        Unknowns that the problem solved for inside; each takes one degree of freedom from chi-square.
    """

    residual: FloatArray
    jacobian: FloatArray
    n_eliminated: int = 0


class Problem(Protocol):
    """A least-squares problem in free variables theta, with its meaning in physical units."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def kinds(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    @property
    def theta_start(self) -> FloatArray: ...

    @property
    def n_data(self) -> int:
        """Number of data rows, which come first; priors follow."""
        ...

    @property
    def lines(self) -> IntArray:
        """Position of each data row along the frequency or time axis, (n_data,)."""
        ...

    @property
    def series(self) -> IntArray:
        """Which channel each data row belongs to, (n_data,)."""
        ...

    def residual(self, theta: FloatArray) -> FloatArray: ...

    def linearize(self, theta: FloatArray) -> Linearization: ...

    def physical(self, theta: FloatArray) -> FloatArray:
        """Physical parameters, (n_params,)."""
        ...

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of each physical parameter with respect to its own free variable, (n_params,)."""
        ...


def parameter_sizes(problem: Problem, physical: FloatArray) -> FloatArray:
    """What the standard deviation of each parameter is held against, (n_params,), physical units.

    The magnitude of its value, unless the problem has a method ``sizes(physical)`` of its own, as it must where a
    parameter may well be 0 (a delay, an offset).
    """
    own = getattr(problem, "sizes", None)
    return np.abs(physical) if own is None else np.asarray(own(physical))

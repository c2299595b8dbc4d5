"""What an estimator sees of a problem: names, a start, residuals and their derivatives, and what it offers beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.averaging import few_averages, score_factor
from structid.inversion.linearization import Linearization, OperatorLinearization


class Unknowns(Protocol):
    """What is sought, as free variables theta, with their meaning in physical units."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def kinds(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    @property
    def theta_start(self) -> FloatArray: ...

    def physical(self, theta: FloatArray) -> FloatArray:
        """Physical parameters, (n_params,)."""
        ...

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of each physical parameter with respect to its own free variable, (n_params,)."""
        ...

    def sizes(self, physical: FloatArray) -> FloatArray:
        """What the standard deviation of each parameter is held against, (n_params,), physical units.

        The magnitude of its value, but where it may well be 0 (a delay, an offset).
        """
        ...

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper bound of each physical parameter, (n_params, 2); infinite where it has none."""
        ...

    @property
    def reach(self) -> FloatArray:
        """Lowest and highest of each free variable that a search may come to, (n_params, 2); infinite where all may be."""
        ...


class Data(Protocol):
    """What the data rows of a residual are, which come first, and how they err; priors follow."""

    @property
    def n_data(self) -> int: ...

    @property
    def lines(self) -> IntArray:
        """Position of each data row along the frequency or time axis, (n_data,)."""
        ...

    @property
    def series(self) -> IntArray:
        """Which channel each data row belongs to, (n_data,)."""
        ...

    @property
    def quantities(self) -> IntArray | None:
        """What each data row measures that other records may measure too, such as the k-th mode, (n_data,) numbers.

        The same number is the same quantity in all records; negative where a row has none, None where no row has.
        """
        ...

    @property
    def averages(self) -> FloatArray | None:
        """How many averages tell the variance of each data row, (n_data,), infinite where it is known; None for all rows."""
        ...

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        """Changes of the data rows whose products sum to their covariance, (n_changes, n_data); None for the unit matrix."""
        ...

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        """Covariance of J'r over repeats of the data, (n_params, n_params), with the data rows J of the Jacobian.

        None for J'J, as rows of independent errors of known variance have.
        """
        ...


class Problem(Unknowns, Data, Protocol):
    """A least-squares problem: a residual of `Unknowns` against `Data`, and ways to its minimum.

    Whoever writes one inherits from `BaseProblem`, which answers all but names, kinds, units, start, physical values and
    their slope, the data rows, residual and Jacobian.
    """

    def residual(self, theta: FloatArray) -> FloatArray: ...

    def linearize(self, theta: FloatArray) -> Linearization: ...

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Residual (n_priors,) of the priors and its derivative, sparse (n_priors, n_params)."""
        ...

    @property
    def matrix_free_obstacle(self) -> str:
        """What a matrix-free search cannot take in it, as in "takes no errors of channels"; "" where nothing is."""
        ...

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        """As `linearize`, with no Jacobian formed; where there is no `matrix_free_obstacle`."""
        ...

    def stage_plans(self) -> Sequence[Stages]:
        """Ways to the answer for poor starts: easier forms of the problem, one after another; () where it has none."""
        ...

    def ways(self) -> Sequence[Way]:
        """The ways that a search with restarts takes in turn: `stage_plans`, and what is made for a start."""
        ...

    def thinned(self) -> Problem | None:
        """The problem with a part of its data, for the searches; None where it is small enough."""
        ...


#: Easier forms of a problem by name, run one after another before it.
Stages = Sequence[tuple[str, Problem]]
#: The same, or how they are made for a start.
Way = Stages | Callable[[FloatArray], Stages]


class BaseUnknowns:
    """What unknowns answer that may take any value."""

    def sizes(self, physical: FloatArray) -> FloatArray:
        return np.abs(physical)

    @property
    def bounds(self: Unknowns) -> FloatArray:
        return np.tile([-np.inf, np.inf], (len(self.theta_start), 1))

    @property
    def reach(self: Unknowns) -> FloatArray:
        return np.tile([-np.inf, np.inf], (len(self.theta_start), 1))


class OfUnknowns(ABC):
    """What has `unknowns` of its own, and answers for them."""

    @property
    @abstractmethod
    def unknowns(self) -> Unknowns: ...

    @property
    def names(self) -> tuple[str, ...]:
        return self.unknowns.names

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.unknowns.kinds

    @property
    def units(self) -> tuple[str, ...]:
        return self.unknowns.units

    @property
    def theta_start(self) -> FloatArray:
        return self.unknowns.theta_start

    def physical(self, theta: FloatArray) -> FloatArray:
        return self.unknowns.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        return self.unknowns.slope(theta)

    def sizes(self, physical: FloatArray) -> FloatArray:
        return self.unknowns.sizes(physical)

    @property
    def bounds(self) -> FloatArray:
        return self.unknowns.bounds

    @property
    def reach(self) -> FloatArray:
        return self.unknowns.reach


class OfData(ABC):
    """What has `data` of its own, and answers for it."""

    @property
    @abstractmethod
    def data(self) -> Data: ...

    @property
    def n_data(self) -> int:
        return self.data.n_data

    @property
    def lines(self) -> IntArray:
        return self.data.lines

    @property
    def series(self) -> IntArray:
        return self.data.series

    @property
    def quantities(self) -> IntArray | None:
        return self.data.quantities

    @property
    def averages(self) -> FloatArray | None:
        return self.data.averages

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        return self.data.data_changes(theta)

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        return self.data.score_covariance(theta, jacobian)


class BaseProblem(BaseUnknowns):
    """What a problem answers that has nothing to tell but its residual; others inherit from it and say more."""

    def __getstate__(self) -> dict[str, object]:
        """Without what is cached: it can be made again, and factorizations cannot go to another process."""
        kept = (name for name in vars(self) if not isinstance(getattr(type(self), name, None), cached_property))
        return {name: vars(self)[name] for name in kept}

    @property
    def quantities(self) -> IntArray | None:
        return None

    @property
    def averages(self) -> FloatArray | None:
        return None

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        return None

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        changes = self.data_changes(theta)
        if changes is None:
            few = few_averages(self.averages)
            return None if few is None else jacobian.T @ (score_factor(few)[:, None] * jacobian)
        scores = changes @ jacobian
        return scores.T @ scores

    def prior_rows(self: Problem, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        at = self.linearize(theta)
        return at.residual[self.n_data :], sparse.csr_array(at.jacobian[self.n_data :])

    @property
    def matrix_free_obstacle(self) -> str:
        return "takes problems that give products with their Jacobian"

    def linearize_operator(self: Problem, theta: FloatArray) -> OperatorLinearization:
        raise InputError(f"a matrix-free search {self.matrix_free_obstacle}; take a search with a Jacobian")

    def stage_plans(self) -> Sequence[Stages]:
        return ()

    def ways(self) -> Sequence[Way]:
        return self.stage_plans()

    def thinned(self) -> Problem | None:
        return None

"""The least-squares problem that searches, intervals and tests of residuals see, and the law of its whitened errors.

A variance that was estimated from few averages is itself uncertain; expected squares and scores allow for it.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse, special

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.inversion.linearization import Linearization, OperatorLinearization

#: Averages up to which squares over their estimated variance have no variance, so that nothing is expected of them.
TOO_FEW = 3.0


def expected_square(averages: FloatArray | float) -> FloatArray:
    """Mean square of complex errors over variances estimated from n averages: n / (n - 2), infinite up to two.

    n times the estimate over the variance is half a chi-square of 2 (n - 1) degrees of freedom, independent of the error: the
    square is n / (n - 1) times one of F(2, 2 (n - 1)).

    References
    ----------
    Goodman (1963), Ann. Math. Stat. 34, section 3, for the law of estimated spectra.
    """
    n = np.asarray(averages, dtype=np.float64)
    return np.divide(1.0, 1 - 2 / n, out=np.full(n.shape, np.inf), where=n > 2)


def square_variance(averages: FloatArray) -> FloatArray:
    """Variance (n,) that each of the two real rows of a complex error adds to the sum of squares, by numbers of `averages` (n,).

    It is 2 for infinitely many averages, and finite only above three.
    """
    mean = expected_square(averages)
    return 2 * mean**2 * (2 * (1 - 2 / averages) / (1 - 3 / averages) - 1)


def score_factor(averages: FloatArray) -> FloatArray:
    """Factor n / (n - 3) by which few averages n increase the covariance of weighted sums of errors, for each entry.

    Sums J'r of whitened rows have the covariance E(1/g^2) / E(1/g) J'J for estimates g of a variance of 1. The factor is 1
    for three averages or fewer, where it has no finite value.
    """
    return np.divide(1.0, 1 - 3 / averages, out=np.ones_like(averages), where=averages > TOO_FEW)


def normal_values(values: FloatArray, averages: FloatArray) -> FloatArray:
    """Whitened residual rows transformed from Student's t to standard normal values by equal tail probability.

    `values` are the rows and `averages` the number n of averages from which the variance of each was estimated, both
    (n_rows,). The t distribution has 2 (n - 1) degrees of freedom. Rows with infinitely many averages stay as they are.
    """
    known = np.isinf(averages)
    n = np.where(known, 2.0, averages)
    size = special.stdtr(2 * (n - 1), -np.abs(values) * np.sqrt(1 - 1 / n))
    return np.where(known, values, -np.sign(values) * special.ndtri(np.maximum(size, np.finfo(float).tiny)))


def few_averages(averages: FloatArray | None) -> FloatArray | None:
    """Array `averages` (n_rows,) where the estimated variances matter, else None.

    None if `averages` is None, if all entries are infinite (variances known), or if any entry is 3 or less.
    """
    if averages is None or np.isinf(averages).all() or (averages <= TOO_FEW).any():
        return None
    return averages


#: What stands between the name of a parameter and that of the record whose value it is; no parameter of the structure has it.
OF_RECORD = " @ "
NO_PRODUCTS = "takes problems that give products with their Jacobian"


class Unknowns(Protocol):
    """Parameters that are sought, as free variables theta, with their meaning in physical units."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def kinds(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    @property
    def theta_start(self) -> FloatArray: ...

    def physical(self, theta: FloatArray) -> FloatArray:
        """Values (n_params,) of the parameters in physical units at free variables `theta` (n_params,)."""
        ...

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative (n_params,) of each physical parameter with respect to its own free variable, at `theta`."""
        ...

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Sizes that the standard deviations are compared with, (n_params,), physical units.

        The size of a parameter is the magnitude of its value, but where it may well be 0 (a delay, an offset).
        """
        ...

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper bound of each physical parameter, (n_params, 2); infinite where it has none."""
        ...

    @property
    def reach(self) -> FloatArray:
        """Lowest and highest value of each free variable in a search, (n_params, 2); infinite where it has no limit."""
        ...


@dataclass(frozen=True, eq=False)
class FreeUnknowns:
    """Unknowns that are searched for as they are: free variables are physical values, and may take any.

    Attributes
    ----------
    names : tuple of str
    theta_start : (n_params,) float array
    kinds, units : tuple of str
        No kind and the unit 1 by default.
    """

    names: tuple[str, ...]
    theta_start: FloatArray
    kinds: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "kinds", self.kinds or ("",) * len(self.names))
        object.__setattr__(self, "units", self.units or ("1",) * len(self.names))

    def physical(self, theta: FloatArray) -> FloatArray:
        return np.array(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        return np.ones(len(theta))

    def sizes(self, physical: FloatArray) -> FloatArray:
        return np.abs(physical)

    @property
    def bounds(self) -> FloatArray:
        return np.tile([-np.inf, np.inf], (len(self.theta_start), 1))

    @property
    def reach(self) -> FloatArray:
        return self.bounds


@dataclass(frozen=True, eq=False)
class DataRows:
    """Labels of the data rows of a residual, which come first; the rows of priors follow.

    Attributes
    ----------
    lines : (n_data,) int array
        Position of each row along the frequency or time axis.
    series : (n_data,) int array
        Channel of each row.
    names : tuple of str
        Names of the distinct numbers of `series`, in their order.
    quantities : (n_data,) int array, optional
        Number of the quantity that a row measures and other records may measure too, such as the k-th mode: the same in all
        records, negative for a row that has none; None where no row has one.
    averages : (n_data,) float array, optional
        Number of averages that the variance of each row was estimated from, infinite where it is known; None where it is known
        for all rows.
    """

    lines: IntArray
    series: IntArray
    names: tuple[str, ...] = ()
    quantities: IntArray | None = None
    averages: FloatArray | None = None

    @property
    def n_data(self) -> int:
        return len(self.lines)


class NoiseLaw(Protocol):
    """Law of the errors of whitened data rows at one point."""

    @property
    def factor(self) -> FloatArray | None:
        """Rows F, (n_factors, n_data), with F'F the covariance of the data rows; None for the unit matrix."""
        ...

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Covariance (n_params, n_params) of J'r over repeats of the data, with J `jacobian` (n_data, n_params).

        None where it is J'J, as for rows with independent errors of known variance.
        """
        ...


@dataclass(frozen=True, eq=False)
class RowNoise:
    """Noise of unit variance, independent from row to row unless a `factor` of its covariance is given.

    Attributes
    ----------
    averages : (n_data,) float array or None
        See `DataRows`.
    factor : (n_factors, n_data) float array or None
        See `NoiseLaw`.
    """

    averages: FloatArray | None = None
    factor: FloatArray | None = None

    def score_covariance(self, jacobian: FloatArray) -> FloatArray | None:
        """Covariance (n_params, n_params) of J'e for the noise e of the data rows; None where it is J'J.

        `jacobian` (n_data, n_params) are the data rows J. With a `factor` F of the noise covariance it is (F J)'(F J);
        with variances from few averages, J' D J with a diagonal D.
        """
        if self.factor is None:
            few = few_averages(self.averages)
            return None if few is None else jacobian.T @ (score_factor(few)[:, None] * jacobian)
        projected = self.factor @ jacobian
        return projected.T @ projected


class Problem(metaclass=ABCMeta):
    """A whitened least-squares problem: data rows and rows of priors as functions of free variables theta.

    A problem states its `unknowns`, its data `rows`, and the `residual` with its Jacobian (`linearize`). It may also state
    products with a Jacobian that is not formed (`linearize_operator`), its `prior_rows` alone and the law of its noise
    (`noise_law`).
    """

    @property
    @abstractmethod
    def unknowns(self) -> Unknowns:
        """Parameters that are sought."""

    @property
    @abstractmethod
    def rows(self) -> DataRows:
        """Labels of the data rows."""

    @abstractmethod
    def residual(self, theta: FloatArray) -> FloatArray:
        """Whitened data rows, then the rows of the priors, (n_residuals,)."""

    @abstractmethod
    def linearize(self, theta: FloatArray) -> Linearization:
        """The residual and its Jacobian with respect to the free variables."""

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        """Residual at free variables `theta` (n_params,), and products with its Jacobian, which is not formed.

        Raises
        ------
        InputError
            If the problem has no such products, as by default.
        """
        raise InputError(f"a matrix-free search {NO_PRODUCTS}; take a search with a Jacobian")

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Residual (n_priors,) of the priors at `theta` (n_params,), and its sparse derivative (n_priors, n_params)."""
        linearization = self.linearize(theta)
        return linearization.residual[self.n_data :], sparse.csr_array(linearization.jacobian[self.n_data :])

    def noise_law(self, theta: FloatArray) -> NoiseLaw:
        """Law of the errors of the data rows at free variables `theta`; independent of unit variance by default."""
        return RowNoise(self.rows.averages)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.unknowns.names

    @property
    def theta_start(self) -> FloatArray:
        """Free variables of the start, (n_params,)."""
        return self.unknowns.theta_start

    def physical(self, theta: FloatArray) -> FloatArray:
        """Values (n_params,) of the parameters in physical units at free variables `theta` (n_params,)."""
        return self.unknowns.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative (n_params,) of each physical parameter with respect to its own free variable, at `theta`."""
        return self.unknowns.slope(theta)

    @property
    def n_data(self) -> int:
        """Number of data rows."""
        return self.rows.n_data

    def __getstate__(self) -> dict[str, object]:
        """Fields without cached properties: these can be made again, and factorizations cannot go to another process."""
        names = (name for name in vars(self) if not isinstance(getattr(type(self), name, None), cached_property))
        return {name: vars(self)[name] for name in names}


#: Easier forms of a problem by name, solved one after another before it.
Schedule = Sequence[tuple[str, Problem]]
#: A schedule, or a function that makes one for a start.
ContinuationPath = Schedule | Callable[[FloatArray], Schedule]

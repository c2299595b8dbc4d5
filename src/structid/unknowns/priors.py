"""Prior knowledge as whitened rows: of one parameter, or of combinations of several."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_finite, require_shape
from structid.core.errors import InputError

PriorKind = Literal["normal", "lognormal"]


@dataclass(frozen=True)
class Prior:
    """A belief about one parameter before the measurement.

    Parameters
    ----------
    mean, std : float
        Mean and standard deviation in the parameter's unit, of the distribution itself for both kinds.
    kind : {"normal", "lognormal"}
        Log-normal for what is positive and known to a factor: its logarithm is Gaussian.

    Notes
    -----
    Whoever minimizes takes the logarithm of a log-normal parameter as the variable, so that its prior alone gives the
    median, mean / sqrt(1 + (std / mean)^2).
    """

    mean: float
    std: float
    kind: PriorKind = "normal"

    @property
    def problem(self) -> str:
        """The reason why the prior cannot be used, as a clause after its name; "" if it can."""
        if self.kind not in ("normal", "lognormal"):
            return f"must be of kind 'normal' or 'lognormal', got {self.kind!r}"
        if not (np.isfinite(self.mean) and np.isfinite(self.std) and self.std > 0):
            return f"needs a finite mean and a positive std, got {self}"
        if self.kind == "lognormal" and self.mean <= 0:
            return f"needs a positive mean to be log-normal, got {self.mean:g}"
        return ""


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors of single parameters, one entry each.

    Attributes
    ----------
    mean, std : (n_params,) float arrays
        Physical units; NaN where there is none.
    lognormal : (n_params,) bool array
        Whether it is log-normal instead of Gaussian.
    """

    mean: FloatArray
    std: FloatArray
    lognormal: np.ndarray

    def __post_init__(self) -> None:
        for name, kind in (("mean", float), ("std", float), ("lognormal", bool)):
            object.__setattr__(self, name, locked(getattr(self, name), kind))

    @property
    def stated(self) -> np.ndarray:
        """Which parameters have one, (n_params,) bool."""
        return np.isfinite(self.std)

    def one(self, index: int) -> Prior | None:
        """The prior of the parameter `index`; None if it has none."""
        if not self.stated[index]:
            return None
        kind: PriorKind = "lognormal" if self.lognormal[index] else "normal"
        return Prior(float(self.mean[index]), float(self.std[index]), kind)

    def at(self, index: IntArray) -> Priors:
        """Priors of the parameters at `index`."""
        return Priors(self.mean[index], self.std[index], self.lognormal[index])

    def followed_by(self, other: Priors) -> Priors:
        """These priors, then those of `other`."""
        pairs = (self.mean, other.mean), (self.std, other.std), (self.lognormal, other.lognormal)
        return Priors(*(np.concatenate(pair) for pair in pairs))

    def entries(self, physical: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Whitened rows of the priors at `physical` (n_params,): parameter index, residual and derivative, (n_rows,) each.

        One row for each parameter with a prior. The residual is (p - mean) / std, or (log p - mu) / s with s^2 = log(1 + (std
        / mean)^2) and mu = log(mean) - s^2 / 2 for a log-normal prior.
        """
        rows = np.flatnonzero(self.stated)
        p, m, s, log = physical[rows], self.mean[rows], self.std[rows], self.lognormal[rows]
        slope, residual = 1 / s, (p - m) / s
        if log.any():
            width = np.sqrt(np.log1p((s[log] / m[log]) ** 2))
            residual[log] = (np.log(p[log] / m[log]) + width**2 / 2) / width
            slope[log] = 1 / (width * p[log])
        return rows, residual, slope


def priors_of(each: Iterable[Prior | None]) -> Priors:
    """Priors as arrays, one entry for each of `each`; NaN where it is None."""
    stated = [prior or Prior(np.nan, np.nan) for prior in each]
    log = [prior.kind == "lognormal" for prior in stated]
    return Priors(np.array([prior.mean for prior in stated]), np.array([prior.std for prior in stated]), np.array(log))


def no_priors(n_params: int) -> Priors:
    """Priors (n_params,) that say nothing: NaN means and deviations."""
    return priors_of([None]).at(np.zeros(n_params, dtype=int))


@dataclass(frozen=True, eq=False)
class Coupling:
    """Knowledge of combinations of parameters: ``matrix @ g(p) - target`` has unit variance a row.

    Parameters
    ----------
    name : str
        Name of the prior in reports.
    matrix : (n_rows, n_params) float array
        Sparse where parameters are many.
    target : (n_rows,) float array
    logarithmic : bool
        Whether g is the natural logarithm instead of the value itself.
    """

    name: str
    matrix: FloatArray | sparse.csr_array
    target: FloatArray
    logarithmic: bool = False

    def __post_init__(self) -> None:
        """Store copies of matrix and target, dense ones read-only; `InputError` unless they are finite and of one size.

        The matrix is (n_rows, n_params), sparse or dense, the target (n_rows,).
        """
        if sparse.issparse(self.matrix):
            rows = sparse.csr_array(self.matrix, dtype=np.float64, copy=True)
            require_finite("matrix", rows.data)
            object.__setattr__(self, "matrix", rows)
        else:
            object.__setattr__(self, "matrix", locked(self.matrix, np.float64))
            require_finite("matrix", self.matrix)
        object.__setattr__(self, "target", locked(self.target, np.float64))
        require_finite("target", self.target)
        require_shape("matrix", self.matrix, (None, None))
        require_shape("target", self.target, (self.matrix.shape[0],), "one entry a row of `matrix`")

    @property
    def used(self) -> np.ndarray:
        """True for each parameter that takes part in the coupling, (n_params,)."""
        if sparse.issparse(self.matrix):
            entries = sparse.coo_array(self.matrix)
            return np.bincount(entries.col[entries.data != 0], minlength=entries.shape[1]) > 0
        return np.asarray((self.matrix != 0).any(axis=0))

    def residual(self, physical: FloatArray) -> FloatArray:
        """Residual ``matrix @ g(p) - target`` at the parameters p = `physical` (n_params,), (n_rows,)."""
        if not self.logarithmic:
            return np.asarray(self.matrix @ physical - self.target)
        return np.asarray(self.matrix @ np.log(np.where(self.used, physical, 1.0)) - self.target)

    def sparse_rows(self, physical: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Residual (n_rows,) at `physical` (n_params,), and its derivative by these parameters, sparse (n_rows, n_params)."""
        slope = 1 / np.where(self.used, physical, 1.0) if self.logarithmic else np.ones(self.matrix.shape[1])
        return self.residual(physical), sparse.csr_array(sparse.csr_array(self.matrix) @ sparse.diags_array(slope))

    def rows(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residual (n_rows,) at the parameters `physical` (n_params,), in physical units, and its derivative by these.

        The residual is `self.matrix` times the parameters (their logarithms if `self.logarithmic`) less `self.target`.
        The derivative is dense, (n_rows, n_params).
        """
        if sparse.issparse(self.matrix):
            residual, jacobian = self.sparse_rows(physical)
            return residual, jacobian.toarray()
        if not self.logarithmic:
            return self.residual(physical), np.array(self.matrix)
        return self.residual(physical), self.matrix / np.where(self.used, physical, 1.0)

    def among(self, n_params: int, first: int) -> Coupling:
        """The prior with columns for all of `n_params` parameters; its own begin at number `first`."""
        return self.at(np.arange(first, first + self.matrix.shape[1]), n_params)

    def at(self, index: IntArray, n_params: int) -> Coupling:
        """The coupling among `n_params` parameters, with its k-th parameter at position ``index[k]`` of them."""
        matrix = sparse.csr_array(self.matrix)
        wide = sparse.csr_array((matrix.data, index[matrix.indices], matrix.indptr), (matrix.shape[0], n_params))
        kept = wide if sparse.issparse(self.matrix) else wide.toarray()
        return Coupling(self.name, kept, self.target, self.logarithmic)

    def scaled(self, strengths: FloatArray | float) -> Coupling:
        """Copy with each row multiplied by the square root of its strength; `strengths` is one number or (n_rows,)."""
        root = np.sqrt(np.broadcast_to(strengths, self.target.shape))
        scaled = sparse.diags_array(root) @ self.matrix if sparse.issparse(self.matrix) else self.matrix * root[:, None]
        return Coupling(self.name, scaled, self.target * root, self.logarithmic)


def joint_prior(
    name: str,
    names: tuple[str, ...],
    own_names: tuple[str, ...],
    mean: FloatArray,
    covariance: FloatArray,
    logarithmic: bool = False,
) -> Coupling:
    """A Gaussian prior on several parameters with all its correlations, as a coupling whose rows are whitened.

    Parameters
    ----------
    name : str
        Name of the prior in reports.
    names : tuple of str
        All parameters, in order.
    own_names : tuple of str
        Names of the parameters that the prior is about.
    mean, covariance : (n_own,), (n_own, n_own) float arrays
        Physical units.
    logarithmic : bool
        True if the logarithms are Gaussian, with means log(mean) and covariance C_ij / (mean_i mean_j).

    Raises
    ------
    InputError
        If a name is no parameter, the covariance is not finite and positive definite, or a mean of logarithms is not
        positive.
    """
    missing = [label for label in own_names if label not in names]
    if missing:
        raise InputError(f"`own_names` must name parameters, got {missing[0]!r}; they are {', '.join(names)}")
    require_shape("covariance", covariance, (len(own_names), len(own_names)))
    require_finite("covariance", covariance, "a parameter that was not determined cannot be carried; leave it out")
    if logarithmic:
        if not (mean > 0).all():
            raise InputError(f"`mean` of {name} must be positive to be taken in logarithms, got {mean.min():g}")
        mean, covariance = np.log(mean), covariance / np.outer(mean, mean)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    try:
        factor = np.linalg.cholesky(covariance / np.outer(std, std)) if (std > 0).all() else None
    except np.linalg.LinAlgError:
        factor = None
    if factor is None:
        raise InputError(
            f"`covariance` of {name} must be positive definite, got one that is not; carry fewer parameters"
        )
    whitener = np.linalg.solve(factor, np.diag(1 / std))
    matrix = np.zeros((len(own_names), len(names)))
    matrix[:, [names.index(label) for label in own_names]] = whitener
    return Coupling(name, matrix, whitener @ mean, logarithmic)


def free_prior_rows(
    free_prior: tuple[FloatArray, FloatArray] | None, theta: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Whitened rows of a Gaussian prior on the free variables: variable index, residual and derivative, (n_rows,) each.

    `free_prior` is its mean and standard deviation, (n_params,) each and NaN where there is none; all three are empty
    if it is None. `theta` (n_params,) are the free variables.
    """
    if free_prior is None:
        return np.zeros(0, dtype=int), np.zeros(0), np.zeros(0)
    mean, std = free_prior
    rows = np.flatnonzero(np.isfinite(std))
    return rows, ((theta - mean) / std)[rows], 1 / std[rows]

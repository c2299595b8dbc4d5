"""Uncertainty of the parameters at a minimum: covariance as a matrix or by draws, and which ones the data determine.

Of a parameter that ends at a bound it says how hard the data push it beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol, TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError
from structid.inversion.covariance import chi_square_law, model_error_covariance, noise_covariance
from structid.inversion.diagnostics.identifiability import (
    Bound,
    Identifiability,
    bound_at,
    carried,
    identifiability,
    refusal_words,
)
from structid.inversion.diagnostics.residual_tests import Agreement, agreement, misses_noise
from structid.inversion.fixed_values import FixedColumns, FixedValueInfluence
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem

#: Largest distance from a bound, in parts of the range and in standard deviations, at which a parameter is at it.
_CLOSE, _CLOSE_STD = 0.01, 0.1
#: Standard deviations beyond a bound where a push is more than chance.
_HARD = 3.0


@dataclass(frozen=True)
class AtBound:
    """A parameter whose best value lies at or beyond one of its bounds.

    Attributes
    ----------
    name, unit : str
    index : int
        Its position among the parameters.
    side : {"lower", "upper"}
    limit : float
        The bound.
    multiplier : float
        Decrease of half chi-square (priors included) for each unit of the parameter beyond the bound, at the bound, the
        other free parameters fitted again.
    std : float
        Standard deviation that the parameter would have without its bounds, from the noise.
    noise_scale : float
        The noise in parts of what is stated, where the fit misses it; else 1.
    """

    name: str
    unit: str
    index: int
    side: Literal["lower", "upper"]
    limit: float
    multiplier: float
    std: float
    noise_scale: float = 1.0

    @property
    def gain_per_std(self) -> float:
        """Decrease of chi-square if the bound were wider by one `std`, to second order."""
        push = self.multiplier * self.std
        return 2 * push - 1 if push > 1 else push**2

    @property
    def push(self) -> float:
        """Distance of the best value beyond the bound, to first order, in standard deviations of the fit."""
        return self.multiplier * self.std / self.noise_scale

    @property
    def is_pushed(self) -> bool:
        """True if the data push the parameter beyond the bound by more than chance."""
        return self.push > _HARD

    @property
    def words(self) -> str:
        """Sentence with the bound that a parameter is at, and how strongly the data push beyond it.

        If they push by more than chance, a remedy is added.
        """
        unit = "" if self.unit == "1" else f" {self.unit}"
        sentence = f"{self.name} is at its {self.side} bound {self.limit:.6g}{unit}"
        if not self.is_pushed:
            return f"{sentence}: the data allow it, and do not push beyond it by more than chance"
        side = "below" if self.side == "lower" else "above"
        return (
            f"{sentence}; the data push {side} it (a bound wider by one standard deviation, {self.std:.2g}{unit}, would lower"
            f" chi-square by {self.gain_per_std:.3g}): widen the bound or doubt the model"
        )


def is_free(at_bound: Sequence[AtBound], n_params: int) -> np.ndarray:
    """Mask of the parameters that are not in `at_bound`, (n_params,) bool."""
    free = np.ones(n_params, dtype=bool)
    free[[bound.index for bound in at_bound]] = False
    return free


def at_bounds(
    problem: Problem, theta: FloatArray, linearization: Linearization, noise_scale: float = 1.0
) -> tuple[AtBound, ...]:
    """Parameters at a bound at the minimum `theta`, in their order, from the linearized model; empty if there are none.

    A parameter is at a bound if it is within 1 % of its range and 0.1 standard deviations of the bound, and the minimum
    of the linear model lies beyond. A parameter without two finite bounds is never at one. If its standard deviation
    without bounds, times `noise_scale`, exceeds both its range and its size, it counts as undetermined and is not
    returned.

    Parameters
    ----------
    problem : Problem
    theta : (n_params,) float array
    linearization : Linearization
        At `theta`.
    noise_scale : float
        Factor on the noise: the root of chi-square per degree of freedom where the fit holds model error, else 1.

    References
    ----------
    Nocedal and Wright (2006), Numerical Optimization, section 12.3: multipliers of active bounds.
    """
    bounds, values, slope = problem.unknowns.bounds, problem.physical(theta), problem.slope(theta)
    span = bounds[:, 1] - bounds[:, 0]
    side = np.argmin(np.abs(bounds - values[:, None]), axis=1)
    limit = bounds[np.arange(len(values)), side]
    distance = np.abs(values - limit)
    near = np.isfinite(span) & (distance <= _CLOSE * span) & (slope != 0)
    if not near.any():
        return ()
    basis, kept = (
        np.linalg.qr(linearization.jacobian[:, ~near])
        if not near.all()
        else (np.zeros((len(linearization.residual), 0)), None)
    )
    if kept is not None:
        basis = basis[:, np.abs(np.diag(kept)) > 1e-12 * np.abs(np.diag(kept)).max(initial=0.0)]
    bounds_met = []
    for i in np.flatnonzero(near).tolist():
        column = linearization.jacobian[:, i] / slope[i]
        independent = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(independent))
        outward = -1.0 if side[i] == 0 else 1.0
        multiplier = -outward * float(independent @ linearization.residual)
        if not size > 0:
            continue
        std = 1 / size
        size_here = float(problem.unknowns.sizes(values)[i])
        is_beyond = multiplier * std**2 > distance[i] and distance[i] <= _CLOSE_STD * std
        if is_beyond and noise_scale * std <= max(span[i], size_here):
            words = problem.names[i], problem.unknowns.units[i]
            which: Literal["lower", "upper"] = "lower" if side[i] == 0 else "upper"
            bounds_met.append(AtBound(*words, i, which, float(limit[i]), multiplier, std, noise_scale))
    return tuple(bounds_met)


#: Singular values, with unit columns, below this part of the largest are of directions that nothing determines.
_SEEN = 1e-10
#: Combinations of parameters, one a row.
Rows: TypeAlias = "FloatArray | sparse.csr_array"


class Covariance(Protocol):
    """Covariance of the parameters in physical units."""

    @property
    def std(self) -> FloatArray:
        """Standard deviations, (n_params,); NaN where nothing is known."""
        ...

    @property
    def std_error(self) -> FloatArray:
        """Relative standard error of `std`, (n_params,); 0 where it is exact."""
        ...

    @property
    def freedom(self) -> float:
        """Degrees of freedom of Student's t for a parameter over its `std`; infinite where that is exact."""
        ...

    @property
    def has_matrix(self) -> bool: ...

    @property
    def matrix(self) -> FloatArray:
        """(n_params, n_params); NaN for what is not determined.

        Raises
        ------
        InputError
            Where there is none.
        """
        ...

    @property
    def draws(self) -> FloatArray:
        """Draws of errors of the parameters, (n_draws, n_params), whose covariance it is; none where there is a matrix."""
        ...

    def variance(self, rows: Rows) -> FloatArray:
        """Variances of combinations of parameters (n_rows, n_params), (n_rows,); NaN where that of a parameter in them is."""
        ...


@dataclass(frozen=True, eq=False)
class DenseCovariance:
    """A covariance that is a matrix.

    Parameters
    ----------
    matrix : (n_params, n_params) float array
    """

    matrix: FloatArray

    has_matrix = True
    freedom = np.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", locked(self.matrix, np.float64))

    @property
    def std(self) -> FloatArray:
        return np.sqrt(np.diag(self.matrix))

    @property
    def std_error(self) -> FloatArray:
        return np.zeros(len(self.matrix))

    @property
    def draws(self) -> FloatArray:
        return np.zeros((0, len(self.matrix)))

    def variance(self, rows: Rows) -> FloatArray:
        """Variance (n,) of each linear combination of parameters in `rows` (n, n_params); NaN if undetermined."""
        weights = sparse.csr_array(rows).toarray()
        used, lost = weights != 0, ~np.isfinite(self.matrix)
        variance = np.einsum("kp,kp->k", weights @ np.where(lost, 0.0, self.matrix), weights)
        return np.where(((used @ lost) & used).any(axis=1), np.nan, variance)


@dataclass(frozen=True, eq=False)
class DrawnCovariance:
    """A covariance that is known by draws, for parameters too many for a matrix.

    Parameters
    ----------
    draws : (n_draws, n_params) float array
    std, std_error : (n_params,) float arrays
        Of the draws, and better where it was found otherwise.
    """

    draws: FloatArray
    std: FloatArray
    std_error: FloatArray

    has_matrix = False

    @property
    def freedom(self) -> float:
        return float(max(len(self.draws), 1))

    @property
    def matrix(self) -> FloatArray:
        raise InputError(
            f"a matrix-free search gives no covariance matrix of its {len(self.std)} parameters; take `std`, or `variance` of"
            " combinations of them, or search with a Jacobian"
        )

    def with_changes(self, changes: FloatArray) -> DrawnCovariance:
        """Covariance with independent errors added, one for each column of `changes` (n_params, n_causes).

        A column is the change of the parameters by one standard deviation of the error. Every draw gets a random part
        of each error, from a fixed seed, of unit mean square and uncorrelated over the draws if there are more draws
        than errors.
        """
        n_draws, n_causes = len(self.draws), changes.shape[1]
        sizes = np.random.default_rng(0).standard_normal((n_draws, n_causes))
        if n_draws > n_causes:
            sizes = np.sqrt(n_draws) * np.linalg.qr(sizes)[0]
        std = np.hypot(self.std, np.linalg.norm(changes, axis=1))
        part = np.divide(self.std, std, out=np.ones(len(std)), where=std > 0)
        return DrawnCovariance(locked(self.draws + sizes @ changes.T), locked(std), locked(self.std_error * part**2))

    def variance(self, rows: Rows) -> FloatArray:
        """Variance (n,) of each linear combination of parameters in `rows` (n, n_params), as the mean square of draws.

        With fewer than two draws NaN, and 0 for a combination without entries.
        """
        weights = sparse.csr_array(rows)
        if len(self.draws) < 2:
            return np.where(np.diff(weights.indptr) > 0, np.nan, 0.0)
        return np.asarray(((weights @ self.draws.T) ** 2).mean(axis=1))


@dataclass(frozen=True, eq=False, kw_only=True)
class Spread:
    """Spread of the parameters: covariances from noise and model error, and identifiability.

    Attributes
    ----------
    noise : Covariance
        From the noise of the data alone (and the priors), physical units.
    model_error : Covariance
        From the residuals themselves, correlated along the axis and within channels; carries model error.
    covariance_basis : str
        ``"noise"`` or ``"model_error"``: which of the two `uncertainty` and `std` are.
    identified : (n_params,) bool array
        Whether the relative standard deviation is at most 1, at the estimate and at the initial values (see
        `diagnostics.identifiability.carried`).
    identifiability : Identifiability
        Rank, condition and undetermined directions, from the data alone; of a matrix-free search the rank only.
    determined : float
        How many combinations of parameters the data determine: the rank, or by posterior draws tr(C J'J).
    bound_initial : (n_params,) float array or None
        Cramer-Rao bound of each parameter if the truth were the initial values, physical units.
    at_bound : tuple of AtBound
        Parameters that ended at a bound. They have no standard deviation; those of the others, rank and directions are
        with them held there.
    disagreement : Agreement or None
        The test by which quantities that several records repeat ask for different parameters, where they do.
    fixed : FixedValueInfluence or None
        What the answer owes to the values that its model holds, whose tolerances `uncertainty` and `std` carry; None where these
        are taken as exact.
    """

    noise: Covariance
    model_error: Covariance
    covariance_basis: str
    identified: np.ndarray
    identifiability: Identifiability
    determined: float = float("nan")
    bound_initial: FloatArray | None = None
    at_bound: tuple[AtBound, ...] = ()
    disagreement: Agreement | None = None
    fixed: FixedValueInfluence | None = None

    @property
    def is_free(self) -> np.ndarray:
        """Which parameters are not at a bound, (n_params,) bool."""
        return is_free(self.at_bound, len(self.identified))

    @property
    def of_data(self) -> Covariance:
        """Covariance of the parameters from the data alone: by noise or by model error, as `covariance_basis` says."""
        return self.noise if self.covariance_basis == "noise" else self.model_error

    @cached_property
    def uncertainty(self) -> Covariance:
        """Covariance of the parameters that is reported: that from the data, with the tolerances of fixed values added."""
        data = self.of_data
        if self.fixed is None:
            return data
        if isinstance(data, DrawnCovariance):
            return data.with_changes(self.fixed.changes)
        return DenseCovariance(data.matrix + self.fixed.covariance)

    @property
    def covariance(self) -> FloatArray:
        """Reported covariance as a matrix, (n_params, n_params), physical units; `InputError` after a matrix-free search."""
        return self.uncertainty.matrix

    @property
    def covariance_of_data(self) -> FloatArray:
        """Covariance from the data alone as a matrix, (n_params, n_params), without the tolerances of fixed values."""
        return self.of_data.matrix

    @property
    def covariance_noise(self) -> FloatArray:
        return self.noise.matrix

    @property
    def covariance_model_error(self) -> FloatArray:
        return self.model_error.matrix

    @property
    def std(self) -> FloatArray:
        """Standard deviations (n_params,) from `uncertainty`, physical units; NaN where nothing is known."""
        return self.uncertainty.std

    @property
    def std_noise(self) -> FloatArray:
        return self.noise.std

    @property
    def std_model_error(self) -> FloatArray:
        return self.model_error.std

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (n_params, n_params) of the parameters; NaN where a variance is not known, or 0."""
        scale = np.outer(self.std, self.std)
        known = np.isfinite(scale) & (scale > 0)
        return np.divide(self.covariance, scale, out=np.full_like(scale, np.nan), where=known)


@dataclass(frozen=True, eq=False, kw_only=True)
class Uncertainty:
    """Uncertainty of the parameters at a minimum, with what decides about the status of the estimate.

    Attributes
    ----------
    spread : Spread
    carried : (n_params,) bool array
        Those that the initial values do not refuse; see `diagnostics.identifiability.carried`.
    freedom : float
        Degrees of freedom of chi-square.
    words : tuple of str
        How it was found, or why a parameter is refused.
    taken : float
        Degrees of freedom that the parameters take from the data: fewer than there are parameters where priors hold some of them.
    """

    spread: Spread
    carried: np.ndarray
    freedom: float
    words: tuple[str, ...]
    taken: float = float("nan")

    @property
    def misfit(self) -> bool:
        """True where the fit misses the noise, so that `model_error` counts."""
        return self.spread.covariance_basis == "model_error"


def dense_uncertainty(
    problem: Problem,
    theta: FloatArray,
    linearization: Linearization,
    converged: bool,
    misfit_probability: float,
    fixed: FixedColumns | None = None,
) -> Uncertainty:
    """Uncertainty of the parameters at the minimum `theta`, from the information matrix of the Jacobian.

    Parameters at a bound are held there: without information and uncertainty. The reported covariance is that from the
    residual where the fit holds model error, else that from noise.

    Parameters
    ----------
    problem : Problem
    theta : (n_params,) float array
    linearization : Linearization
        At `theta`.
    converged : bool
        True if the search converged.
    misfit_probability : float
        The fit holds model error if a larger chi-square, or a larger disagreement of quantities that several records
        repeat, is less probable than this.
    fixed : FixedColumns, optional
        Fixed values of the model; exact if None.
    """
    values, slope = problem.physical(theta), problem.slope(theta)
    data, sizes = linearization.residual[: problem.n_data], problem.unknowns.sizes(values)
    freedom = max(len(linearization.residual) - linearization.n_params - linearization.n_eliminated, 0)
    misfit, square, within = misfits(problem, theta, linearization, misfit_probability), float(data @ data), None
    if misfit and fixed is not None and fixed.within is not None:
        within, square = fixed.within, fixed.within.chi_square
        misfit = within.misfits(misfit_probability)
    noise_scale = float(np.sqrt(square / max(freedom, 1))) if misfit else 1.0
    held = at_bounds(problem, theta, linearization, noise_scale)
    free = is_free(held, len(values))
    linearization = (
        replace(linearization, jacobian=np.where(free, linearization.jacobian, 0.0)) if held else linearization
    )
    tested = (
        agreement(within.problem, within.at)
        if within is not None and isinstance(within.at, Linearization)
        else agreement(problem, linearization)
    )
    disagreement = None if tested is None or tested.probability >= misfit_probability else tested
    is_doubted = misfit or disagreement is not None
    noise = DenseCovariance(noise_covariance(problem, theta, linearization) * np.outer(slope, slope))
    model = DenseCovariance(model_error_covariance(problem, linearization) * np.outer(slope, slope))
    identified_directions = identifiability(
        relative_jacobian(problem, theta, linearization), values, problem.names, noise_scale, free
    )
    adopted = (model if is_doubted else noise).std
    initial = bound_at(problem, np.asarray(problem.theta_start), "the initial values")
    at_start = carried(initial, sizes, adopted, converged and not misfit) | ~free
    identified = at_start & (adopted <= sizes)
    stopped = not converged and misfit and bool(at_start.all())
    refused = not identified[free].all() and not stopped
    final = Bound(np.where(free, noise.std, 0.0), sizes, "the estimate")
    refusal = refusal_words(initial, final, at_start, problem.names) if refused else ""
    spread = Spread(
        noise=noise,
        model_error=model,
        covariance_basis=basis(is_doubted),
        identified=locked(identified),
        identifiability=identified_directions,
        determined=float(identified_directions.rank),
        bound_initial=initial.std,
        at_bound=held,
        disagreement=disagreement,
        fixed=None if fixed is None else fixed.influence(theta, linearization, slope),
    )
    return Uncertainty(
        spread=spread,
        carried=at_start,
        freedom=freedom,
        words=(refusal,),
        taken=effective_parameters(linearization, problem.n_data),
    )


def effective_parameters(linearization: Linearization, n_data: int) -> float:
    """Degrees of freedom that the parameters take from the first `n_data` rows of the Jacobian: tr(J_d (J'J)^-1 J_d').

    It is the rank of J without priors, and less where prior rows determine some combinations (Hoerl and Kennard 1970).
    """
    scale = np.linalg.norm(linearization.jacobian, axis=0)
    columns, singular, _ = np.linalg.svd(linearization.jacobian / np.where(scale > 0, scale, 1.0), full_matrices=False)
    sound = singular > _SEEN * singular.max(initial=0.0)
    return float((columns[:n_data, sound] ** 2).sum())


def basis(misfit: bool) -> str:
    """Covariance that counts: "model_error" if the fit misses the noise, `misfit`, else "noise"."""
    return "model_error" if misfit else "noise"


def misfits(problem: Problem, theta: FloatArray, linearization: Linearization, probability: float) -> bool:
    """True if noise alone would give a larger sum of squares than the residual at `theta` with less than this probability."""
    return misses_noise(problem, linearization.residual, *chi_square_law(problem, theta, linearization), probability)


def relative_jacobian(problem: Problem, theta: FloatArray, linearization: Linearization) -> FloatArray:
    """Data rows (n_data, n_params) of the Jacobian with respect to relative changes of the physical parameters.

    `theta` (n_params,) are the free variables at which `linearization` was made.
    """
    return linearization.jacobian[: problem.n_data] * relative_steps(problem, theta)


def relative_steps(problem: Problem, theta: FloatArray) -> FloatArray:
    """Changes (n_params,) of free variables that change each parameter by its size, at `theta` (n_params,).

    They are those of a linear step: by 1 where the size is 0, and 0 for a parameter that its free variable does not
    move.
    """
    sizes, slope = problem.unknowns.sizes(problem.physical(theta)), problem.slope(theta)
    return np.divide(np.where(sizes != 0, sizes, 1.0), slope, out=np.zeros(len(slope)), where=slope != 0)

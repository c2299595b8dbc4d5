"""The answer of a search without a Jacobian: values, standard deviations by posterior draws, and a status."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.arrays import FloatArray, locked
from structid.errors import InputError
from structid.estimation.covariance import LEAST_FREEDOM, error_blocks
from structid.estimation.estimate import Status
from structid.estimation.problem import parameter_sizes
from structid.estimation.search.free_linearization import FreeLinearization, FreeProblem
from structid.estimation.search.levenberg_marquardt_free import (
    FreeLevenbergMarquardt,
    conjugate_gradients,
    free_levenberg_marquardt,
    needs_free_search,
    preconditioner,
)
from structid.estimation.search.minimum import Keeper, Progress

#: x of a system of equations for its right-hand side.
Solver = Callable[[FloatArray], FloatArray]
_SOLVED = 1e-5
_KNOWN = "the search converged, and data and priors together hold every parameter"
_UNKNOWN = (
    "data and priors together do not hold every parameter; strengthen the smoothness, group the unknowns, or measure more"
    " places"
)


@dataclass(frozen=True, eq=False)
class FreeEstimate:
    """Very many parameters with their standard deviations; there is no covariance matrix.

    Attributes
    ----------
    names, kinds, units : tuple of str
    initial, values : (n_params,) float arrays
        Physical values before and after.
    std : (n_params,) float array
        Physical units, of the draws, and solved for where asked; NaN where neither data nor priors see a parameter, or
        the solution did not converge.
    identified : (n_params,) bool array
        Whether the standard deviation is known and at most the size of the value.
    slope : (n_params,) float array
        Derivative of each physical value with respect to its free variable at the estimate.
    covariance_basis : str
        ``"noise"``: standard deviations from the noise of the data and the priors; ``"model_error"``, where the fit
        misses the noise: from the residual itself, stretches of lines as blocks (see `model_error_covariance`).
    determined : float
        How many combinations of parameters the data determine, tr(C J'J); NaN without draws.
    std_error : (n_params,) float array
        Relative standard error of `std`: 1 / sqrt(2 n_draws) where it comes from draws, 0 where it was solved for.
    draws : (n_draws, n_params) float array
        Draws from the Gaussian posterior of the free variables near the estimate, less the estimate: their
        covariance estimates that of any combination.
    status : Status
    message : str
        What ended the search, how the products with the Jacobian were made, and what the standard deviations are.
    reason : str
        Why there is no dense search, or why there might be.
    chi_square : float
        Sum of squared whitened data residuals.
    n_data : int
    theta : (n_params,) float array
    costs : (n_iterations + 1,) float array
    inner : (n_iterations,) int array
        Conjugate gradient iterations of every step.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    initial: FloatArray
    values: FloatArray
    std: FloatArray
    identified: np.ndarray
    slope: FloatArray
    covariance_basis: str
    determined: float
    std_error: FloatArray
    draws: FloatArray
    status: Status
    message: str
    reason: str
    chi_square: float
    n_data: int
    theta: FloatArray
    costs: FloatArray
    inner: FloatArray

    @property
    def physical_draws(self) -> FloatArray:
        """The draws in physical units, to first order."""
        return self.draws * self.slope

    @property
    def chi_square_per_dof(self) -> float:
        """Per datum that the determined combinations leave; NaN without draws."""
        freedom = self.n_data - self.determined
        return self.chi_square / freedom if freedom > 0 else float("nan")

    @property
    def n_iterations(self) -> int:
        return len(self.inner)

    @property
    def distance(self) -> FloatArray:
        """Change from the initial value in standard deviations, (n_params,); NaN where there is none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            found: FloatArray = np.where(self.std > 0, (self.values - self.initial) / self.std, np.nan)
        return found

    def beyond_chance(self, level: float = 0.05) -> tuple[np.ndarray, float]:
        """Which parameters changed by more than chance alone allows anywhere among all of them, and the limit.

        With all parameters at their initial values the probability that any is marked is at most `level` (Bonferroni);
        the limit, in standard deviations, is that of Student's t with the number of draws as degrees of freedom. None
        without draws.
        """
        limit = float(special.stdtrit(max(len(self.draws), 1), 1 - level / (2 * max(len(self.names), 1))))
        return np.abs(np.nan_to_num(self.distance)) > limit, limit

    @property
    def status_words(self) -> str:
        """What happened, and what helps."""
        if self.status is Status.NOT_CONVERGED:
            return self.status.words
        return _KNOWN if self.status is Status.CONVERGED else _UNKNOWN


def free_estimate(
    problem: FreeProblem,
    method: FreeLevenbergMarquardt | None = None,
    draws: int = 32,
    solved: Sequence[str] = (),
    seed: int = 0,
    misfit_probability: float = 1e-3,
    progress: Progress | None = None,
    theta: FloatArray | None = None,
    keeper: Keeper | None = None,
) -> FreeEstimate:
    """Parameters that minimize the sum of squares of a problem with very many of them, and their uncertainty.

    Parameters
    ----------
    problem : FreeProblem
        Such as an `FrfProblem` with every element's stiffness and a smoothness prior.
    method : FreeLevenbergMarquardt, optional
    draws : int
        Posterior draws for the standard deviations; 0 gives NaN.
    solved : sequence of str
        Parameters whose standard deviation is solved for, one system of equations each.
    seed : int
        Of the draws.
    misfit_probability : float
        Below this probability of its chi-square the fit holds model error, and standard deviations come from it.
    progress : callable, optional
        Called with the iteration and the sum of squares.
    theta : (n_params,) float array, optional
        Where the search begins; the problem's own start by default.
    keeper : Keeper, optional
        Keeps the search's state after each iteration, and has one to go on from.

    Raises
    ------
    InputError
        If `solved` names no parameter, or `draws` is 1 or negative.
    """
    if draws < 0 or draws == 1:
        raise InputError(f"`draws` must be 0 or at least 2, got {draws}; 32 gives standard deviations to 12 %")
    places = [_place(problem.names, name) for name in solved]
    found = free_levenberg_marquardt(problem, method, theta, progress, keeper)
    at, slope = found.linearization, problem.slope(found.theta)
    values, generator = problem.physical(found.theta), np.random.default_rng(seed)
    precondition = preconditioner(at, np.zeros(at.n_params)) if draws or places else None
    sampled, determined, missed = counted_draws(at, draws, generator, precondition)
    data = at.residual[: at.n_data]
    chi_square = _squared(data)
    freedom = max(at.n_data - np.nan_to_num(determined), 1.0)
    misses = bool(special.gammaincc(freedom / 2, chi_square / 2) < misfit_probability)
    if misses and len(sampled):
        sampled, more = posterior_draws(at, draws, generator, error_draws(problem, at), precondition)
        sampled, missed = sampled[np.isfinite(sampled).all(axis=1)], missed + more
    std = np.sqrt((sampled**2).mean(axis=0)) if len(sampled) > 1 else np.full(len(slope), np.nan)
    error = np.full(len(slope), 1 / np.sqrt(2 * len(sampled)) if len(sampled) > 1 else np.nan)
    for place in () if misses else places:
        std[place], error[place] = solved_std(at, place, precondition), 0.0
    std[at.squares <= 0] = np.nan
    std = std * np.abs(slope)
    seen = std <= parameter_sizes(problem, values)
    status = Status.CONVERGED if seen.all() else Status.NOT_IDENTIFIABLE
    if not found.converged:
        status = Status.NOT_CONVERGED
    words = [found.message, at.words, _std_words(len(sampled), 0 if misses else len(places), missed)]
    if misses:
        words.append("the fit misses the noise: standard deviations come from the residual, not from the noise")
    return FreeEstimate(
        names=problem.names,
        kinds=problem.kinds,
        units=problem.units,
        initial=locked(problem.physical(np.asarray(problem.theta_start))),
        values=locked(values),
        std=locked(std),
        identified=locked(seen, bool),
        slope=locked(slope),
        covariance_basis="model_error" if misses else "noise",
        determined=determined,
        std_error=locked(error),
        draws=locked(sampled),
        status=status,
        message="; ".join(word for word in words if word),
        reason=needs_free_search(problem)[1],
        chi_square=chi_square,
        n_data=at.n_data,
        theta=locked(found.theta),
        costs=locked(found.costs),
        inner=locked(found.inner),
    )


def _squared(values: FloatArray) -> float:
    return float(values @ values)


def _place(names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise InputError(f"`solved` must name parameters, got {name!r}; the first of {len(names)} is {names[0]!r}")
    return names.index(name)


def _std_words(draws: int, n_solved: int, missed: int) -> str:
    words = (
        f"standard deviations from {draws} posterior draws, +-{100 / np.sqrt(2 * draws):.0f} % each"
        if draws > 1
        else "no standard deviations from draws (NaN)"
    )
    words += f", {n_solved} of them solved for" if n_solved else ""
    words += f"; {missed} draws did not converge and are left out" if missed else ""
    return words + "; no covariance matrix: it would not fit"


def posterior_draws(
    at: FreeLinearization,
    count: int,
    generator: np.random.Generator,
    errors: Callable[[np.random.Generator], FloatArray] | None = None,
    precondition: Solver | None = None,
) -> tuple[FloatArray, int]:
    """Draws of what errors of the data and the priors do to the answer, (count, n_params), and how many failed (NaN).

    A draw solves J'J s = J'e. With e of unit variance, as by default, its covariance is (J'J)^-1, the posterior's.

    Parameters
    ----------
    at : FreeLinearization
    count : int
    generator : numpy.random.Generator
    errors : callable, optional
        Errors of the data rows, (n_data,), such as `error_draws` gives.
    precondition : callable, optional
        The `preconditioner` without damping, where it is made already.

    References
    ----------
    Papandreou and Yuille (2010), Gaussian sampling by local perturbations, Advances in Neural Information Processing
    Systems 23, section 2.
    """
    made = np.empty((count, at.n_params))
    if not count:
        return made, 0
    precondition, missed = precondition or preconditioner(at, np.zeros(at.n_params)), 0
    for row in made:
        unit = generator.standard_normal(len(at.residual))
        if errors is not None:
            unit[: at.n_data] = errors(generator)
        right = at.transposed(unit)
        row[:], _, left = conjugate_gradients(at.information, right, precondition, _SOLVED, 2000)
        if left > _SOLVED:
            row[:], missed = np.nan, missed + 1
    return made, missed


def counted_draws(
    at: FreeLinearization, count: int, generator: np.random.Generator, precondition: Solver | None = None
) -> tuple[FloatArray, float, int]:
    """Posterior draws that converged, how many combinations the data determine, and how many draws did not converge.

    The number is tr(C J'J) = E |J s|^2 of the data rows; NaN without draws.
    """
    made, missed = posterior_draws(at, count, generator, None, precondition)
    sound = made[np.isfinite(made).all(axis=1)]
    determined = float(np.mean([_squared(at.forward(draw)) for draw in sound])) if len(sound) else float("nan")
    return sound, determined, missed


def error_draws(problem: FreeProblem, at: FreeLinearization) -> Callable[[np.random.Generator], FloatArray]:
    """Errors of the data as its residual shows them: each stretch of lines times a factor of its own, mean 0.

    Their scores J'e have the covariance sum of g_b g_b' of `model_error_covariance`, raised for few blocks in the
    same way.

    References
    ----------
    Liang and Zeger (1986), Biometrika 73, Eq. (5); Wu (1986), Ann. Statist. 14, 1261, section 7, for the factors.
    """
    residual = at.residual[: at.n_data]
    block = error_blocks(residual, problem.lines, problem.series)[0]
    count = int(block.max(initial=0)) + 1
    if count < 2:
        return lambda generator: np.full(at.n_data, np.nan)
    freedom = max(count - 1.0, LEAST_FREEDOM)
    raised = np.sqrt(count / (count - 1)) * special.stdtrit(freedom, 0.975) / special.ndtri(0.975)
    return lambda generator: residual * (raised * generator.standard_normal(count))[block]


def solved_std(at: FreeLinearization, place: int, precondition: Solver | None = None) -> float:
    """sqrt of entry `place` of the diagonal of (J'J)^-1, NaN where the equations could not be solved."""
    unit = np.zeros(at.n_params)
    unit[place] = 1.0
    precondition = precondition or preconditioner(at, np.zeros(at.n_params))
    column, _, left = conjugate_gradients(at.information, unit, precondition, _SOLVED, 2000)
    return float(np.sqrt(column[place])) if left <= _SOLVED and column[place] > 0 else float("nan")

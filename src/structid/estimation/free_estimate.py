"""The answer of a search without a Jacobian: values, standard deviations by posterior draws, and a status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.arrays import FloatArray, locked
from structid.errors import InputError
from structid.estimation.estimate import Status
from structid.estimation.free_linearization import FreeLinearization, FreeProblem
from structid.estimation.levenberg_marquardt_free import (
    FreeLevenbergMarquardt,
    conjugate_gradients,
    free_levenberg_marquardt,
    needs_free_search,
    preconditioner,
)
from structid.estimation.minimum import Progress
from structid.estimation.problem import parameter_sizes

_SOLVED = 1e-5


@dataclass(frozen=True, eq=False)
class FreeEstimate:
    """Very many parameters with their standard deviations; there is no covariance matrix.

    Attributes
    ----------
    names, kinds, units : tuple of str
    initial, values : (n_params,) float arrays
        Physical values before and after.
    std : (n_params,) float array
        From the noise of the data and the priors, physical units: of the draws, and solved for where asked; NaN where
        neither data nor priors see a parameter, or the solution did not converge.
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


def free_estimate(
    problem: FreeProblem,
    method: FreeLevenbergMarquardt | None = None,
    draws: int = 32,
    solved: Sequence[str] = (),
    seed: int = 0,
    misfit_probability: float = 1e-3,
    progress: Progress | None = None,
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
        Below this probability of its chi-square the message says that the fit holds model error.
    progress : callable, optional
        Called with the iteration and the sum of squares.

    Raises
    ------
    InputError
        If `solved` names no parameter, or `draws` is 1 or negative.
    """
    if draws < 0 or draws == 1:
        raise InputError(f"`draws` must be 0 or at least 2, got {draws}; 32 gives standard deviations to 12 %")
    places = [_place(problem.names, name) for name in solved]
    found = free_levenberg_marquardt(problem, method, None, progress)
    at, slope = found.linearization, problem.slope(found.theta)
    values = problem.physical(found.theta)
    sampled, missed = posterior_draws(at, draws, np.random.default_rng(seed))
    sampled = sampled[np.isfinite(sampled).all(axis=1)]
    std = np.sqrt((sampled**2).mean(axis=0)) if len(sampled) > 1 else np.full(len(slope), np.nan)
    error = np.full(len(slope), 1 / np.sqrt(2 * len(sampled)) if len(sampled) > 1 else np.nan)
    for place in places:
        std[place], error[place] = solved_std(at, place), 0.0
    std[at.squares <= 0] = np.nan
    std = std * np.abs(slope)
    seen = std <= parameter_sizes(problem, values)
    data = at.residual[: at.n_data]
    chi_square = float(data @ data)
    status = Status.CONVERGED if seen.all() else Status.NOT_IDENTIFIABLE
    if not found.converged:
        status = Status.NOT_CONVERGED
    words = [found.message, at.words, _std_words(len(sampled), len(places), missed)]
    if special.gammaincc(max(at.n_data, 1) / 2, chi_square / 2) < misfit_probability:
        words.append("the fit misses the noise: standard deviations carry noise and priors, not the model's error")
    return FreeEstimate(
        names=problem.names,
        kinds=problem.kinds,
        units=problem.units,
        initial=locked(problem.physical(np.asarray(problem.theta_start))),
        values=locked(values),
        std=locked(std),
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


def posterior_draws(at: FreeLinearization, count: int, generator: np.random.Generator) -> tuple[FloatArray, int]:
    """Draws from the Gaussian with precision J'J, (count, n_params), and how many of them did not converge (NaN).

    A draw solves J'J s = J'e with e of unit variance: its covariance is (J'J)^-1 J'J (J'J)^-1.

    References
    ----------
    Papandreou and Yuille (2010), Gaussian sampling by local perturbations, Advances in Neural Information Processing
    Systems 23, section 2.
    """
    made = np.empty((count, at.n_params))
    if not count:
        return made, 0
    precondition, missed = preconditioner(at, np.zeros(at.n_params)), 0
    for row in made:
        right = at.transposed(generator.standard_normal(len(at.residual)))
        row[:], _, left = conjugate_gradients(at.information, right, precondition, _SOLVED, 2000)
        if left > _SOLVED:
            row[:], missed = np.nan, missed + 1
    return made, missed


def solved_std(at: FreeLinearization, place: int) -> float:
    """sqrt of entry `place` of the diagonal of (J'J)^-1, NaN where the equations could not be solved."""
    unit = np.zeros(at.n_params)
    unit[place] = 1.0
    column, _, left = conjugate_gradients(
        at.information, unit, preconditioner(at, np.zeros(at.n_params)), _SOLVED, 2000
    )
    return float(np.sqrt(column[place])) if left <= _SOLVED and column[place] > 0 else float("nan")

"""Draws of what errors of data and priors do to very many parameters: their uncertainty without a covariance matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.core.errors import InputError
from structid.inversion.covariance import LEAST_FREEDOM, error_blocks, row_law
from structid.inversion.diagnostics.identifiability import Identifiability
from structid.inversion.diagnostics.residual_tests import misses_noise
from structid.inversion.fixed_values import FixedColumns, FixedValueInfluence
from structid.inversion.linearization import OperatorLinearization, Solver, conjugate_gradients, preconditioner
from structid.inversion.problem import Problem, few_averages, score_factor
from structid.inversion.uncertainty import DrawnCovariance, Spread, Uncertainty, basis

_SOLVED, _MOST_INNER = 1e-5, 2000
_MISFIT = "the fit misses the noise: standard deviations come from the residual, not from the noise"


def drawn_uncertainty(
    problem: Problem,
    theta: FloatArray,
    linearization: OperatorLinearization,
    draws: int,
    solved: Sequence[str],
    misfit_probability: float,
    seed: int,
    fixed: FixedColumns | None = None,
) -> Uncertainty:
    """Uncertainty of the parameters by draws from the Gaussian posterior near `theta`, for very many parameters.

    Parameters
    ----------
    problem : Problem
    theta : (n_params,) float array
    linearization : OperatorLinearization
    draws : int
        Number of posterior draws; 0 gives NaN.
    solved : sequence of str
        Names of parameters whose standard deviation is solved for, one system of equations each, instead of drawn; only
        where the fit holds no model error.
    misfit_probability : float
        Below this probability of its chi-square the fit holds model error.
    seed : int
        Of the draws.
    fixed : FixedColumns, optional
        Fixed values of the model, which may be wrong by their tolerances; exact if None.

    Raises
    ------
    InputError
        If `solved` names no parameter.
    """
    indices = [_index_of(problem.names, name) for name in solved]
    generator = np.random.default_rng(seed)
    precondition = (
        preconditioner(linearization, np.zeros(linearization.n_params))
        if draws or indices or fixed is not None
        else None
    )
    sampled, determined, missed = counted_draws(linearization, draws, generator, precondition)
    (scale, share), few = row_law(problem.rows.averages), few_averages(problem.rows.averages)
    freedom = share * max(linearization.n_data - np.nan_to_num(determined), 1.0)
    misfit = misses_noise(problem, linearization.residual, scale, freedom, misfit_probability)
    fixed = fixed.refitted() if misfit and fixed is not None else fixed
    if misfit and fixed is not None and fixed.within is not None:
        misfit = fixed.within.misfits_chi_square(misfit_probability, scale, freedom)
    influence, exact = (
        (None, "") if fixed is None else solved_influence(problem, theta, linearization, fixed, precondition)
    )
    wider = 1.0 if few is None else float(np.sqrt(score_factor(few).max()))
    noise = drawn_covariance(problem, theta, linearization, wider * sampled)
    std, error = np.array(noise.std), np.array(noise.std_error)
    for index in () if misfit else indices:
        std[index] = wider * solved_std(linearization, index, precondition) * abs(problem.slope(theta)[index])
        error[index] = 0.0
    noise = DrawnCovariance(noise.draws, locked(std), locked(error))
    model, used = drawn_covariance(problem, theta, linearization, sampled[:0]), len(sampled)
    if misfit and used:
        sampled, more = posterior_draws(
            linearization, draws, generator, error_draws(problem, linearization), precondition
        )
        model = drawn_covariance(problem, theta, linearization, sampled[np.isfinite(sampled).all(axis=1)])
        missed, used = missed + more, len(model.draws)
    words = [
        linearization.words,
        _std_words(used, 0 if misfit else len(indices), missed),
        _MISFIT if misfit else "",
        exact,
    ]
    identified = (model if misfit else noise).std <= problem.unknowns.sizes(problem.physical(theta))
    spread = Spread(
        noise=noise,
        model_error=model,
        covariance_basis=basis(misfit),
        identified=locked(identified),
        identifiability=Identifiability(round(np.nan_to_num(determined)), np.nan, np.zeros(0), ()),
        determined=determined,
        fixed=influence,
    )
    carried = np.ones(linearization.n_params, dtype=bool)
    return Uncertainty(spread=spread, carried=carried, freedom=linearization.n_data - determined, words=tuple(words))


def solved_influence(
    problem: Problem,
    theta: FloatArray,
    linearization: OperatorLinearization,
    fixed: FixedColumns,
    precondition: Solver | None = None,
) -> tuple[FixedValueInfluence | None, str]:
    """Influence of fixed values on the parameters by conjugate gradients, and words on values taken as exact.

    Each fixed value takes one system of equations; a value whose system does not converge is taken as exact. The
    influence is None if all are, and the words, which name these values, are "" if none is. `fixed` has the derivatives
    of the data by the fixed values. `precondition` is the `preconditioner` without damping, made if None. `theta`
    (n_params,) are the free variables at which `linearization` was made.
    """
    precondition = precondition or preconditioner(linearization, np.zeros(linearization.n_params))
    rest, kept, changes = np.zeros(linearization.prior.shape[0]), [], []
    for number, column in enumerate(fixed.columns.T):
        right = linearization.transposed(np.concatenate([column, rest]))
        change, _, left = conjugate_gradients(linearization.information, right, precondition, _SOLVED, _MOST_INNER)
        if left <= _SOLVED:
            kept.append(number)
            changes.append(-change)
    lost = [name for number, name in enumerate(fixed.names) if number not in kept]
    words = f"equations did not converge for {join_words(lost)}: taken as exact" if lost else ""
    if not kept:
        return None, words
    return fixed.only(kept).influence_by(theta, np.column_stack(changes), problem.slope(theta)), words


def drawn_covariance(
    problem: Problem, theta: FloatArray, linearization: OperatorLinearization, sampled: FloatArray
) -> DrawnCovariance:
    """Covariance represented by draws `sampled` (n_draws, n_params) of errors of the free variables, in physical units.

    Standard deviations are roots of the mean square, NaN with fewer than two draws, and for parameters with no
    influence on data and priors; each is known to 1 / sqrt(2 n_draws) of itself. `theta` (n_params,) are the free
    variables at the answer.
    """
    slope, count = problem.slope(theta), len(sampled)
    std = np.sqrt((sampled**2).mean(axis=0)) if count > 1 else np.full(linearization.n_params, np.nan)
    std[linearization.squares <= 0] = np.nan
    error = np.full(linearization.n_params, 1 / np.sqrt(2 * count) if count > 1 else np.nan)
    return DrawnCovariance(locked(sampled * slope), locked(std * np.abs(slope)), locked(error))


def _index_of(names: tuple[str, ...], name: str) -> int:
    """Index of `name` in `names`; `InputError` if it is not there."""
    if name not in names:
        raise InputError(f"`solved` must name parameters, got {name!r}; the first of {len(names)} is {names[0]!r}")
    return names.index(name)


def _std_words(draws: int, n_solved: int, missed: int) -> str:
    """Words on how standard deviations were computed, with their relative accuracy.

    `draws` is the number of draws used, `n_solved` the number of parameters solved for, `missed` the number of failed draws.
    """
    words = (
        f"standard deviations from {draws} posterior draws, +-{100 / np.sqrt(2 * draws):.0f} % each"
        if draws > 1
        else "no standard deviations from draws (NaN)"
    )
    words += f", {n_solved} of them solved for" if n_solved else ""
    words += f"; {missed} draws did not converge and are left out" if missed else ""
    return words + "; no covariance matrix: it would not fit"


def posterior_draws(
    linearization: OperatorLinearization,
    count: int,
    generator: np.random.Generator,
    errors: Callable[[np.random.Generator], FloatArray] | None = None,
    precondition: Solver | None = None,
) -> tuple[FloatArray, int]:
    """Posterior errors of the free variables, (count, n_params), NaN rows for failed draws, and number of these.

    A draw s solves J'J s = J'e by conjugate gradients, J with its prior rows. With e of unit variance, the default, its
    covariance is (J'J)^-1. A draw fails if the relative residual stays above 1e-5.

    Parameters
    ----------
    linearization : OperatorLinearization
    count : int
        Number of draws.
    generator : numpy.random.Generator
    errors : callable, optional
        Function of a generator that gives errors of the data rows, (n_data,), instead of standard normal ones; prior
        rows keep these.
    precondition : callable, optional
        The `preconditioner` without damping, made if None.

    References
    ----------
    Papandreou and Yuille (2010), Gaussian sampling by local perturbations, Advances in Neural Information Processing
    Systems 23, section 2.
    """
    made = np.empty((count, linearization.n_params))
    if not count:
        return made, 0
    precondition, missed = precondition or preconditioner(linearization, np.zeros(linearization.n_params)), 0
    for row in made:
        unit = generator.standard_normal(len(linearization.residual))
        if errors is not None:
            unit[: linearization.n_data] = errors(generator)
        right = linearization.transposed(unit)
        row[:], _, left = conjugate_gradients(linearization.information, right, precondition, _SOLVED, _MOST_INNER)
        if left > _SOLVED:
            row[:], missed = np.nan, missed + 1
    return made, missed


def counted_draws(
    linearization: OperatorLinearization, count: int, generator: np.random.Generator, precondition: Solver | None = None
) -> tuple[FloatArray, float, int]:
    """Posterior draws of errors of the free variables, number of directions that the data determine, failed draws.

    The last is the number of draws that failed. Of the `count` draws, those whose conjugate gradients converged are
    given, (n, n_params). The data determine tr(C J'J) directions, with J the Jacobian of the data rows and C the
    posterior covariance, estimated as the mean of |J s|^2 over the draws s; NaN without draws. `generator` draws the
    errors; `precondition` is the `preconditioner` without damping, made if None.
    """
    made, missed = posterior_draws(linearization, count, generator, None, precondition)
    sound = made[np.isfinite(made).all(axis=1)]
    determined = (
        float(np.mean([np.sum(linearization.forward(draw) ** 2) for draw in sound])) if len(sound) else float("nan")
    )
    return sound, determined, missed


def error_draws(problem: Problem, linearization: OperatorLinearization) -> Callable[[np.random.Generator], FloatArray]:
    """Function of a generator that draws data errors (n_data,): the residual times a random factor for each block.

    Blocks are stretches of lines. The scores J'e then have the covariance sum of g_b g_b' times a correction for few
    blocks, with g_b = J_b' r_b of block b of the residual r (see `model_error_covariance`). The function gives NaN if
    there is only one block. `linearization` is that of `problem` at the answer.

    References
    ----------
    Liang and Zeger (1986), Biometrika 73, Eq. (5); Wu (1986), Ann. Statist. 14, 1261, section 7, for the factors.
    """
    residual = linearization.residual[: linearization.n_data]
    block = error_blocks(residual, problem.rows.lines, problem.rows.series)[0]
    count = int(block.max(initial=0)) + 1
    if count < 2:
        return lambda generator: np.full(linearization.n_data, np.nan)
    freedom = max(count - 1.0, LEAST_FREEDOM)
    raised = np.sqrt(count / (count - 1)) * special.stdtrit(freedom, 0.975) / special.ndtri(0.975)
    return lambda generator: residual * (raised * generator.standard_normal(count))[block]


def solved_std(linearization: OperatorLinearization, index: int, precondition: Solver | None = None) -> float:
    """Posterior standard deviation of the free variable at `index` for unit errors; NaN if not solved.

    It takes conjugate gradients, with a relative residual of at most 1e-5. `precondition` is the `preconditioner`
    without damping, made if None.
    """
    unit = np.zeros(linearization.n_params)
    unit[index] = 1.0
    precondition = precondition or preconditioner(linearization, np.zeros(linearization.n_params))
    column, _, left = conjugate_gradients(linearization.information, unit, precondition, _SOLVED, _MOST_INNER)
    return float(np.sqrt(column[index])) if left <= _SOLVED and column[index] > 0 else float("nan")

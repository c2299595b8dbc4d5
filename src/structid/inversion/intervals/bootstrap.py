"""Bootstraps: the estimate from data drawn again, from the noise, from the residuals, or from repeated records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError, SingularModelError, StructidError
from structid.inversion.composed_problems import ShiftedResidual
from structid.inversion.covariance import LEAST_FREEDOM, effective_blocks, error_blocks
from structid.inversion.estimate import Estimate, Status, require_level
from structid.inversion.problem import Problem, few_averages, score_factor
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.inversion.search.work import SERIAL, TaskContext, TaskExecutor

BootstrapKind = Literal["noise", "blocks"]
Record = TypeVar("Record")

_MOST_FAILURES = 0.05
_SEARCH = LevenbergMarquardt(gain_tolerance=1e-9)


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Estimates from data drawn again.

    Attributes
    ----------
    names, units : tuple of str
    kind : str
        ``"noise"``, ``"blocks"`` or ``"repeats"``.
    original : (n_params,) float array
        The estimate from the data themselves, physical units.
    values : (n_succeeded, n_params) float array
        The estimates from the data drawn again.
    n_replicates : int
        How many were tried.
    failures : tuple of str
        Why the others gave none, one sentence each.
    degrees_of_freedom : (n_params,) float array
        One less than the number of independent pieces (repeats, effective blocks) that were drawn from; infinite for
        noise. Intervals are as much wider as Student's t is than the normal distribution.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    kind: str
    original: FloatArray
    values: FloatArray
    n_replicates: int
    failures: tuple[str, ...]
    degrees_of_freedom: FloatArray

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """All replicates as one chain, (1, n_succeeded, n_params), physical units; `n_draws` and `rng` are not used."""
        return self.values[None]

    @property
    def is_reliable(self) -> bool:
        """True where at most 5 % of the replicates failed, and there are 40 at least."""
        return len(self.values) >= 40 and len(self.failures) <= _MOST_FAILURES * self.n_replicates

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n_params, n_params) of the replicates about their mean, physical units; NaN if they are not reliable."""
        n_params = len(self.names)
        if not self.is_reliable:
            return np.full((n_params, n_params), np.nan)
        return np.cov(self.values, rowvar=False).reshape(n_params, n_params)

    @property
    def std(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance))

    @property
    def bias(self) -> FloatArray:
        """Mean of the replicates less the original estimate, (n_params,), physical units; NaN where they are not reliable."""
        if not self.is_reliable:
            return np.full(len(self.names), np.nan)
        return self.values.mean(axis=0) - self.original

    def interval(self, level: float = 0.95) -> FloatArray:
        """Bias-corrected percentile interval (n_params, 2), lower and upper end, physical units; NaN if not reliable.

        With z0 the normal quantile of the part of replicates below the original estimate, the ends are the quantiles of
        Phi(2 z0 -+ t) (Efron 1981), where t is Student's quantile instead of the normal one (Hesterberg 2015); the same
        in any transformation of the parameter. `level` is the probability of the interval; `InputError` if it is not
        between 0 and 1.
        """
        require_level(level)
        if not self.is_reliable:
            return np.full((len(self.names), 2), np.nan)
        n = len(self.values)
        below = (np.count_nonzero(self.values < self.original, axis=0) + 0.5) / (n + 1)
        shift = 2 * special.ndtri(below)[:, None]
        infinite = ~np.isfinite(self.degrees_of_freedom)
        half = special.stdtrit(np.where(infinite, 1.0, self.degrees_of_freedom), 0.5 + level / 2)
        half = np.where(infinite, special.ndtri(0.5 + level / 2), half)
        parts = special.ndtr(shift + half[:, None] * np.array([-1.0, 1.0]))
        return np.array([np.quantile(self.values[:, j], part) for j, part in enumerate(parts)])

    @property
    def words(self) -> tuple[str, ...]:
        """Warnings that bootstrap replicates failed, and that no interval is given; empty if neither is the case."""
        said = []
        if self.failures:
            said.append(
                f"{len(self.failures)} of {self.n_replicates} bootstrap replicates failed (first: {self.failures[0]})"
            )
        if not self.is_reliable:
            said.append(
                "no bootstrap interval is given: it needs 40 replicates at least and 95 % of them to succeed; take more,"
                " or give priors or bounds that keep the refits from running away"
            )
        return tuple(said)


def bootstrap(
    problem: Problem,
    estimate: Estimate,
    kind: BootstrapKind | None = None,
    n_replicates: int = 200,
    rng: np.random.Generator | None = None,
    work: TaskExecutor = SERIAL,
) -> Bootstrap:
    """Bootstrap replicates of an estimate: refits of `problem` to data simulated from the fit.

    A replicate has the residual r(theta) - r(estimate) + e, the prediction of the model with new errors e in units of
    the noise. Its search starts from the estimate. A search that fails or does not converge is counted, and left out of
    the values.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
        At its minimum.
    kind : {"noise", "blocks"}, optional
        ``noise``: e is standard normal, right where model and noise level are, and larger where few averages determine
        the noise. ``blocks``: e is the residual itself, with random signs of stretches of lines and of channels, which
        keep its correlation; for model error. By default the one that matches ``estimate.covariance_basis``.
    n_replicates : int
        Number of refits.
    rng : numpy Generator, optional
        Seed 0 by default. The answer does not depend on where the refits run.
    work : TaskExecutor
        Where they run: in this process by default; `structid.study.run.long_run` has others.

    Returns
    -------
    Bootstrap

    Raises
    ------
    InputError
        If `n_replicates` is below 1 or `kind` is unknown.

    Notes
    -----
    Prior rows get standard normal errors in both kinds: the prior counts as one more observation. The blocks are those
    of `model_error_covariance`, stretches and channels together.

    References
    ----------
    Efron (1979), Ann. Stat. 7; Wu (1986), Ann. Stat. 14; Cameron, Gelbach and Miller (2008),
    Rev. Econ. Stat. 90; Hesterberg (2015), Am. Stat. 69.
    """
    if n_replicates < 1:
        raise InputError(f"`n_replicates` must be at least 1, got {n_replicates}; 200 or more give an interval")
    chosen = kind or ("noise" if estimate.covariance_basis == "noise" else "blocks")
    if chosen not in ("noise", "blocks"):
        raise InputError(f"`kind` must be 'noise' or 'blocks', got {chosen!r}; use `bootstrap_repeats` for repeats")
    at_minimum = problem.residual(estimate.theta)
    children = (rng or np.random.default_rng(0)).spawn(n_replicates)
    shared = (problem, np.array(estimate.theta), at_minimum, chosen)
    results = work.map("bootstrap replicates", _refit_replicate, shared, children)
    freedom = np.full(len(estimate.names), np.inf)
    if chosen == "blocks":
        freedom = np.maximum(effective_blocks(problem, problem.linearize(estimate.theta)) - 1, LEAST_FREEDOM)
    return _collect_replicates(estimate, chosen, results, freedom)


def bootstrap_ends(
    problem: Problem, estimate: Estimate, level: float, seed: int, work: TaskExecutor
) -> tuple[FloatArray, tuple[str, ...]]:
    """Interval ends (n_params, 2) in physical units from 400 bootstrap replicates, and warnings as a tuple of sentences.

    `level` is the probability of the interval; the ends are NaN if the replicates are not reliable.
    """
    replicates = bootstrap(problem, estimate, rng=np.random.default_rng(seed), n_replicates=400, work=work)
    return replicates.interval(level), replicates.words


def _refit_replicate(
    shared: tuple[Problem, FloatArray, FloatArray, str], rng: np.random.Generator, tools: TaskContext
) -> FloatArray | str:
    """Physical values (n_params,) of one bootstrap replicate, or a sentence on why its refit failed.

    The replicate's residual at the estimate is replaced by drawn errors: standard normal ones ("noise"; larger for rows
    of few averages), or the data rows there with random signs by blocks ("blocks"); prior rows are normal in both.
    `shared` holds problem, free variables of the estimate, residual there and kind; `rng` draws, `tools` searches. A
    search that does not converge has failed.
    """
    problem, theta, at_minimum, kind = shared
    errors = rng.standard_normal(len(at_minimum))
    few = few_averages(problem.rows.averages)
    if few is not None:
        errors[: problem.n_data] *= np.sqrt(score_factor(few))
    if kind == "blocks":
        data = at_minimum[: problem.n_data]
        signs = np.zeros(len(data))
        for block in error_blocks(data, problem.rows.lines, problem.rows.series):
            signs += rng.choice([-1.0, 1.0], int(block.max(initial=0)) + 1)[block]
        errors[: problem.n_data] = data * signs
    try:
        minimum = tools.minimize(ShiftedResidual(problem, errors - at_minimum), _SEARCH, theta)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        return f"the model cannot be evaluated: {error}"
    return problem.physical(minimum.theta) if minimum.converged else f"the search {minimum.message}"


def bootstrap_repeats(
    repeats: Sequence[Record],
    refit: Callable[[Sequence[Record]], Estimate],
    n_replicates: int = 200,
    rng: np.random.Generator | None = None,
) -> Bootstrap:
    """Bootstrap replicates of an estimate by refits to repeated records drawn with replacement.

    Parameters
    ----------
    repeats : sequence of records
        Measured independently: averages, impacts, days. Three at least; ten or more for an interval.
    refit : callable
        The estimate from a sequence of such records. A refit that raises an error of structid or of linear algebra,
        does not converge or has values that are not finite is counted as failed, and left out.
    n_replicates : int
        How many refits.
    rng : numpy Generator, optional
        Seed 0 by default.

    Returns
    -------
    Bootstrap

    Raises
    ------
    InputError
        If there are fewer than three records.

    Notes
    -----
    From n repeats n - 1 are drawn each time, which makes the variance of a mean unbiased (Rao and Wu 1988);
    n would make it too small by (n - 1) / n. What is the same in all repeats (model error, a mounting) cannot show.

    References
    ----------
    Efron (1979), Ann. Stat. 7; Rao and Wu (1988), J. Am. Stat. Assoc. 83.
    """
    if len(repeats) < 3:
        raise InputError(
            f"`repeats` must be three records at least, got {len(repeats)}; use `bootstrap` for one record"
        )
    rng = rng or np.random.default_rng(0)
    original = refit(repeats)
    results: list[FloatArray | str] = []
    for _ in range(n_replicates):
        drawn = rng.integers(len(repeats), size=len(repeats) - 1)
        try:
            replicate = refit([repeats[i] for i in drawn])
        except (StructidError, np.linalg.LinAlgError) as error:
            results.append(str(error))
            continue
        good = replicate.status is not Status.NOT_CONVERGED and bool(np.isfinite(replicate.values).all())
        results.append(np.array(replicate.values) if good else f"{replicate.status.value}: {replicate.message}")
    return _collect_replicates(original, "repeats", results, np.full(len(original.names), len(repeats) - 1.0))


def _collect_replicates(
    original: Estimate, kind: str, results: Sequence[FloatArray | str], degrees_of_freedom: FloatArray
) -> Bootstrap:
    """`Bootstrap` of the replicates in `results`: physical values (n_params,), or a sentence for one that failed.

    `original` is the estimate from the data themselves, `degrees_of_freedom` (n_params,) those of the intervals. `kind`
    is "noise", "blocks" or "repeats".
    """
    values = [result for result in results if not isinstance(result, str)]
    failures = [f"replicate {i + 1}: {result}" for i, result in enumerate(results) if isinstance(result, str)]
    return Bootstrap(
        names=original.names,
        units=original.units,
        kind=kind,
        original=locked(original.values),
        values=locked(np.array(values).reshape(len(values), len(original.names))),
        n_replicates=len(results),
        failures=tuple(failures),
        degrees_of_freedom=locked(degrees_of_freedom),
    )

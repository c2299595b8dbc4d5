"""Intervals of the parameters by the chosen method, one for each parameter: curvature, profile likelihood, bootstrap or samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, get_args

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError
from structid.inversion.estimate import Estimate
from structid.inversion.problem import Problem
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.lazy import LoadedByKey

if TYPE_CHECKING:
    from arviz import InferenceData


IntervalKind = Literal["laplace", "profile", "bootstrap", "sampling"]
INTERVAL_KINDS: tuple[str, ...] = get_args(IntervalKind)

#: Remedy where ArviZ or a sampler is missing.
WITH_EXTRA = "install it with `pip install structid[sampling]`"


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals of all parameters in physical units.

    Attributes
    ----------
    kind : {"laplace", "profile", "bootstrap", "sampling"}
    level : float
    ends : (n_params, 2) float array
        Lower and upper; 0 or infinite (or a bound) where the data give no limit, NaN where nothing is known.
    notes : tuple of str
        What the reader should know of them.
    """

    kind: str
    level: float
    ends: FloatArray
    notes: tuple[str, ...]


def parameter_intervals(
    problem: Problem,
    estimate: Estimate,
    kind: IntervalKind = "laplace",
    level: float = 0.95,
    seed: int = 0,
    work: TaskExecutor = SERIAL,
) -> Intervals:
    """Intervals of every parameter at probability `level`, by the method that `kind` names.

    The tolerances of the estimate's fixed values widen the intervals of every kind.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
        Of that problem.
    kind : {"laplace", "profile", "bootstrap", "sampling"}
        In rising order of cost: none, some tens of linearizations a parameter, some hundred refits, some ten thousand
        linearizations.
    level : float
    seed : int
        Of bootstrap and sampling.
    work : TaskExecutor
        Where profiles, refits and chains run.

    Returns
    -------
    Intervals
        With (n_params, 2) ends in physical units: NaN, and a note that says why, where this method cannot give them.

    Raises
    ------
    InputError
        If `kind` is unknown or `level` is not between 0 and 1.
    """
    if kind not in INTERVAL_KINDS:
        raise InputError(f"`kind` must be one of {', '.join(INTERVAL_KINDS)}, got {kind!r}; 'laplace' costs nothing")
    if kind == "laplace" or estimate.fixed is None:
        ends, notes = _ENDS[kind](problem, estimate, level, seed, work)
        return Intervals(kind, level, locked(ends), notes)
    ends, notes = _ENDS[kind](problem, estimate.without_fixed_values(), level, seed, work)
    return Intervals(kind, level, locked(_with_tolerances(ends, estimate, level)), notes)


def _with_tolerances(ends: FloatArray, estimate: Estimate, level: float) -> FloatArray:
    """Interval ends (n_params, 2) in physical units, widened by the tolerances of the fixed values of `estimate`.

    Half-widths add in squares, in logarithms where value and end are positive. Ends that are 0, infinite or NaN stay.
    `level` is the probability of the interval. The estimate must have fixed values.
    """
    assert estimate.fixed is not None
    values, wide = estimate.values, np.array(ends)
    added = float(special.ndtri(0.5 + level / 2)) * estimate.fixed.std
    for side, sign in ((0, -1.0), (1, 1.0)):
        end = ends[:, side]
        is_log = (values > 0) & (end > 0) & np.isfinite(end)
        is_linear = ~is_log & np.isfinite(end) & (end != 0)
        ratio, part = np.log(end[is_log] / values[is_log]), added[is_log] / values[is_log]
        wide[is_log, side] = values[is_log] * np.exp(sign * np.hypot(ratio, part))
        wide[is_linear, side] = values[is_linear] + sign * np.hypot((end - values)[is_linear], added[is_linear])
    return wide


#: Interval ends (n_params, 2) in physical units, and notes on them.
IntervalEnds: TypeAlias = tuple[FloatArray, tuple[str, ...]]
#: Functions of problem, estimate, level, seed and work that give the ends; the module of a kind loads when it is asked for.
_ENDS: LoadedByKey[Callable[[Problem, Estimate, float, int, TaskExecutor], IntervalEnds]] = LoadedByKey(
    {
        "laplace": "structid.inversion.intervals:laplace_ends",
        "profile": "structid.inversion.intervals.profile:profile_ends",
        "bootstrap": "structid.inversion.intervals.bootstrap:bootstrap_ends",
        "sampling": "structid.inversion.intervals.sampling:sampled_ends",
    }
)


def laplace_ends(problem: Problem, estimate: Estimate, level: float, seed: int, work: TaskExecutor) -> IntervalEnds:
    """Interval ends (n_params, 2) at the probability `level` from the covariance of the estimate, and no warnings: ().

    `problem`, `seed` and `work` are not used.
    """
    return estimate.interval(level), ()


class DrawSource(Protocol):
    """Sources of draws: an `Estimate` (its Laplace interval), a `Profile`, a `Bootstrap`, `Samples`."""

    @property
    def names(self) -> tuple[str, ...]: ...

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """Draws in physical units, (n_chains, n_draws, n_params).

        Kinds that store draws give all of them, whatever `n_draws`.
        """
        ...


def to_arviz(found: DrawSource, n_draws: int = 4000, seed: int = 0) -> InferenceData:
    """Posterior draws as ``arviz.InferenceData``, one variable for each parameter.

    Parameters
    ----------
    found : Estimate, Profile, Bootstrap or Samples
        Of an estimate, draws from the normal distribution of the free variables that its intervals are of; of a
        profile, from the distribution whose quantiles are the ends of its intervals at all levels; of a bootstrap, its
        replicates; of samples, their chains.
    n_draws : int
        Number of draws of estimates and profiles; bootstraps and samples give all that they have.
    seed : int
        Of the draws.

    Raises
    ------
    InputError
        If ArviZ, of the extra ``sampling``, is missing, or a profile has no limit on a side.
    """
    try:
        import arviz
    except ImportError as error:
        raise InputError(f"`arviz` must be installed to export draws, got {error}; {WITH_EXTRA}") from error
    draws = found.drawn(n_draws, np.random.default_rng(seed))
    return arviz.from_dict(posterior={name: draws[:, :, j] for j, name in enumerate(found.names)})

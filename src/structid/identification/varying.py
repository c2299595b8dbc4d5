"""Values that differ from record to record: given to each record, their scatter found, and which stand out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError
from structid.forward import RecordProblem
from structid.forward.scatter import ScatterProblem, scatter_problems
from structid.inversion import Estimate
from structid.inversion.diagnostics.residual_tests import adjusted_p_values
from structid.inversion.problem import OF_RECORD
from structid.inversion.strengths import LocalModel, log_evidence
from structid.inversion.uncertainty import DenseCovariance
from structid.unknowns import own_values, with_scatter

#: Fewer records say nothing of a scatter.
FEWEST_RECORDS = 3
#: Family-wise risk that a record is called outlying where none is.
_RISK = 0.05
#: Scatters between which the posterior is looked at: parts of what makes data and scatter weigh the same, and parts.
_LEAST, _MOST, _GRID = 1e-2, 1.0, 81


@dataclass(frozen=True, eq=False)
class Varied:
    """A property that differs from record to record.

    Attributes
    ----------
    name : str
        Such as ``stiffness[clamp]``.
    rule : str
        ``given``, or ``marginal_likelihood`` where the data chose the scatter.
    scatter : float
        Standard deviation of the logarithm from record to record: 0.05 for 5 %.
    interval : (float, float)
        Of the scatter, at 95 %; NaN where it was given.
    common, own : tuple of str
        Names of the common value and of each record's own, one a pair.
    records : tuple of str
        The record of each pair.
    deviations : (n_pairs,) float array
        Of each own value from the common one, in scatters.
    p_values : (n_pairs,) float array
        That a deviation of this size is chance, corrected for their number (Holm); NaN where the data do not see it.
    """

    name: str
    rule: str
    scatter: float
    interval: tuple[float, float]
    common: tuple[str, ...]
    own: tuple[str, ...]
    records: tuple[str, ...]
    deviations: FloatArray
    p_values: FloatArray

    @property
    def outlying(self) -> tuple[int, ...]:
        """Indices of the values that stand out beyond chance; a value with a p-value of NaN does not."""
        return tuple(np.flatnonzero(np.nan_to_num(self.p_values, nan=1.0) < _RISK).tolist())

    @property
    def parts(self) -> tuple[tuple[str, str, str, float, float, bool], ...]:
        """Rows, one for each value: record, common name, own name, deviation, p-value and whether it is an outlier.

        The deviation is in multiples of the scatter; the p-value is corrected for the number of values.
        """
        outlying = self.outlying
        marks = (k in outlying for k in range(len(self.own)))
        rows = zip(
            self.records, self.common, self.own, self.deviations.tolist(), self.p_values.tolist(), marks, strict=True
        )
        return tuple(rows)

    @property
    def words(self) -> str:
        """A sentence on the scatter of the parameter from record to record, in % (1 standard deviation).

        It has the 95 % interval, except for a scatter that is given.
        """
        many = len(dict.fromkeys(self.records))
        size = f"{100 * self.scatter:.2g} %"
        if self.rule == "given":
            return f"{self.name} differs among {many} records, by {size} (1 std) as given"
        low, high = (f"{100 * end:.2g}" for end in self.interval)
        return f"{self.name} differs among {many} records by {size} (1 std; 95 % from {low} to {high} %)"

    @property
    def outlying_words(self) -> tuple[str, ...]:
        """Sentences on the values that stand out, one each; () if none does."""
        return tuple(
            f"{self.records[k]} stands out: its {self.common[k]} is {abs(self.deviations[k]):.2g} scatters"
            f" {'above' if self.deviations[k] > 0 else 'below'} the others (p = {self.p_values[k]:.2g})"
            for k in self.outlying
        )


@dataclass(frozen=True, eq=False)
class FoundScatter:
    """A scatter that the data chose.

    Attributes
    ----------
    interval : (float, float)
        At 95 %.
    more : (n_params, n_params) float array
        Covariance of the free variables beyond that at the chosen scatter, because it is not known exactly.
    """

    interval: tuple[float, float]
    more: FloatArray


def varying(problems: Sequence[RecordProblem], titles: Sequence[str]) -> tuple[RecordProblem, ...]:
    """Problems in which each parameter that varies from record to record has a value of its own in each record.

    `titles` name the records. Problems without such parameters stay as they are.

    Raises
    ------
    InputError
        If fewer than three records have it, or they state different scatters.
    """
    counts: dict[str, int] = {}
    stated: dict[str, float | None] = {}
    for problem in problems:
        for scatter in problem.parameters.scatters:
            counts[scatter.name] = counts.get(scatter.name, 0) + 1
            if stated.setdefault(scatter.name, scatter.given) != scatter.given:
                raise InputError(f"`varies` of {scatter.name} must be the same in all set-ups, got two; state it alike")
    for name, count in counts.items():
        if count < FEWEST_RECORDS:
            raise InputError(
                f"{name} cannot vary over {count} record{'' if count == 1 else 's'}: a scatter takes at least {FEWEST_RECORDS};"
                " leave `varies` out, or add records"
            )
    if not counts:
        return tuple(problems)
    made = zip(problems, titles, strict=True)
    return tuple(problem.with_parameters(own_values(problem.parameters, title)) for problem, title in made)


def with_scatters(problems: Sequence[RecordProblem], std: Mapping[str, float]) -> tuple[RecordProblem, ...]:
    """The problems with new standard deviations `std`, by name, of their scatters; unchanged without scatters."""
    return tuple(
        problem.with_parameters(with_scatter(problem.parameters, std)) if problem.parameters.scatters else problem
        for problem in problems
    )


def free_scatters(problems: Sequence[RecordProblem]) -> tuple[ScatterProblem, ...]:
    """Scatters whose size no record states, so that the data choose it; () if there are none."""
    stated = {scatter.name for p in problems for scatter in p.parameters.scatters if scatter.given is not None}
    return tuple(scatter for scatter in scatter_problems(problems) if scatter.name not in stated)


def found_scatter(model: LocalModel, strength: float) -> FoundScatter:
    """95 % interval of a scatter that the data choose, and the covariance that not knowing it exactly adds.

    The restricted likelihood times a uniform prior on the scatter is evaluated on a grid. The only penalty of `model`
    is that of the scatter; `strength` (1 / scatter^2) is the one chosen. The covariance (n_params, n_params) is of the
    free variables.

    References
    ----------
    Gelman (2006), Bayesian Analysis 1, 515, section 2.2, for the prior; Harville (1974), Biometrika 61, 383, Eq. (2),
    for the restricted likelihood as a marginal one.
    """
    grid = np.geomspace(_LEAST / np.sqrt(model.balance(0)), _MOST, _GRID)
    grid = grid[grid <= _MOST]
    log_weight, fits = [], []
    for std in grid:
        trial = (float(std**-2),)
        log_weight.append(log_evidence(model, trial) + float(np.log(std)))
        fits.append(model.solved(trial))
    weight = np.exp(np.array(log_weight) - max(log_weight))
    weight /= weight.sum()
    ends = np.exp(np.interp([0.025, 0.975], np.cumsum(weight) - weight / 2, np.log(grid)))
    chosen = model.solved((strength,))
    steps = np.array([fit.step for fit in fits])
    away = steps - weight @ steps
    mixed = np.tensordot(weight, np.array([fit.covariance for fit in fits]), 1) + (away * weight[:, None]).T @ away
    return FoundScatter((float(ends[0]), float(ends[1])), mixed - chosen.covariance)


def widened_estimate(estimate: Estimate, more: Sequence[FoundScatter]) -> Estimate:
    """Estimate to whose covariances those of the scatters in `more` are added.

    The estimate itself if there are none, or if it has no free variables.
    """
    slope, spread = estimate.parameters.slope, estimate.spread
    if not more or slope is None:
        return estimate
    added = np.sum([scatter.more for scatter in more], axis=0) * np.outer(slope, slope)
    widened = replace(
        spread,
        noise=DenseCovariance(spread.noise.matrix + added),
        model_error=DenseCovariance(spread.model_error.matrix + added),
    )
    return replace(estimate, spread=widened)


def varied(
    problems: Sequence[RecordProblem], estimate: Estimate, more: Mapping[str, FoundScatter]
) -> tuple[Varied, ...]:
    """Properties that differ from record to record, one `Varied` for each scatter; () if there is no scatter.

    Each has the deviations of the records' own values from the common one, in scatters, and a p-value for each. All
    p-values are corrected together by Holm's method. A deviation over its standard deviation is taken as normal for a
    given scatter, as Student's t for one that the data chose from the others (Grubbs 1950, Eq. (1)).

    Parameters
    ----------
    problems : sequence of RecordProblem
        Problems of all records, with own values of each record.
    estimate : Estimate
        Estimate with the covariance at the chosen scatters.
    more : mapping
        Interval and added covariance of each scatter that the data chose, by name; a scatter that is missing was given.
    """
    groups = scatter_problems(problems)
    if not groups:
        return ()
    index_of = {name: i for i, name in enumerate(estimate.names)}
    made, chances = [], []
    for group in groups:
        used = np.array([index_of[name] for name in group.names])
        residual, rows = group.coupling.rows(estimate.values[used])
        covariance = estimate.spread.covariance_noise[np.ix_(used, used)]
        variance = np.einsum("kp,pq,kq->k", rows, covariance, rows)
        chances.append(_p_values(residual, group.std, variance, is_known=group.name not in more))
        names = [group.names[int(np.argmax(row))] for row in group.coupling.matrix]
        common = [group.names[int(np.argmin(row))] for row in group.coupling.matrix]
        found_here = more.get(group.name)
        made.append(
            Varied(
                name=group.name,
                rule="given" if found_here is None else "marginal_likelihood",
                scatter=group.std,
                interval=(np.nan, np.nan) if found_here is None else found_here.interval,
                common=tuple(common),
                own=tuple(names),
                records=tuple(a.removeprefix(b + OF_RECORD) for a, b in zip(names, common, strict=True)),
                deviations=locked(residual / group.std),
                p_values=locked(chances[-1]),
            )
        )
    corrected = np.split(
        adjusted_p_values(np.concatenate(chances)), np.cumsum([len(chance) for chance in chances])[:-1]
    )
    return tuple(replace(parameter, p_values=locked(p)) for parameter, p in zip(made, corrected, strict=True))


def _p_values(residual: FloatArray, std: float, variance: FloatArray, is_known: bool) -> FloatArray:
    """Two-sided p-value (n,) of each deviation, before correction for their number; NaN where the data do not see it.

    `residual` (n,) are the deviations from the common value, `std` is the standard deviation of the scatter, `variance` (n,) the
    posterior variance of each deviation, and `is_known` is True if the scatter is stated. Otherwise it was estimated from
    these deviations, and each is compared with the scatter of the others (Grubbs's test).
    """
    explained = std**2 - variance
    seen = explained > 1e-3 * std**2
    score = np.abs(residual) / np.sqrt(np.where(seen, explained, 1.0))
    if is_known:
        chance = 2 * special.ndtr(-score)
    else:
        weight, n = np.where(seen, explained, 0.0) / std**2, int(seen.sum())
        weights, freedom = np.minimum(weight * n / max(n - 1, 1), 1.0), float(weight.sum())
        rest = np.maximum(freedom - weights, 1e-3)
        others = np.maximum(
            (freedom - weights * score**2) / rest, 1e-9
        )  # the scatter's variance without the value, in parts
        degrees = max(freedom - 1, 0.5) / np.where(seen, weights, 1.0) ** 2
        chance = 2 * special.stdtr(degrees, -score / np.sqrt(1 + weights * (others - 1)))
    return np.where(seen, chance, np.nan)

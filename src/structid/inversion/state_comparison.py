"""Two states of a structure: each change tested, corrected for the number of tests; or both as one joint problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.display import Overview, Shown, format_number, join_words, percent, unit_text, with_std
from structid.core.errors import InputError
from structid.inversion.composed_problems import JointProblem
from structid.inversion.diagnostics.residual_tests import Correction, adjusted_p_values, detectable, require_levels
from structid.inversion.estimate import Status
from structid.inversion.fixed_values import widen_changes
from structid.inversion.problem import OF_RECORD, Problem

_NOTHING_IN_COMMON = "the two states have no parameter in common to compare; give them the same unknowns"
#: What is added to the names of the later state's own parameters.
LATER = " (later)"
#: Probability of a larger sum of squares below which parameters are not the same in both states.
_CONTRADICTED = 1e-3
#: Parameters that the words name.
_MOST_NAMED = 4


@runtime_checkable
class Identified(Protocol):
    """The part of an estimate that a comparison needs, computed or read from a file."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def kinds(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    @property
    def values(self) -> FloatArray: ...

    @property
    def covariance(self) -> FloatArray: ...

    @property
    def covariance_of_data(self) -> FloatArray:
        """`covariance` without the tolerances of fixed values, (n_params, n_params)."""
        ...

    @property
    def status(self) -> Status: ...

    @property
    def fixed(self) -> FixedChanges | None:
        """Influence of the values that the model fixes; None where these are taken as exact."""
        ...


class FixedChanges(Protocol):
    """Changes of parameters for one tolerance of each fixed value."""

    @property
    def change_names(self) -> tuple[str, ...]: ...

    @property
    def change_tolerances(self) -> tuple[float, ...]:
        """Error of each fixed value that `changes` are for, in parts of its value; 0 of the second order."""
        ...

    @property
    def changes(self) -> FloatArray:
        """Changes of the parameters by one error of each cause, physical units, (n_params, n_changes)."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class States:
    """Two states side by side.

    Attributes
    ----------
    names, kinds, units : tuple of str
        The parameters compared.
    before, after : (n,) float arrays
        Values in both states, physical units. With `carried` parameters, `before` is the baseline's value corrected by what
        the later data say about those.
    covariance_before, covariance_after : (n, n) float arrays
        NaN where a state does not determine a parameter.
    carried : tuple of str
        Parameters taken as the same in both states, known to the later state as the baseline found them.
    only_before, only_after : tuple of str
        Parameters of one state only; what is held fixed in the other adds no uncertainty to the changes.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    before: FloatArray
    after: FloatArray
    covariance_before: FloatArray
    covariance_after: FloatArray
    carried: tuple[str, ...]
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]

    @property
    def change(self) -> FloatArray:
        """Value after less value before, (n,), physical units."""
        return self.after - self.before


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Comparison(Shown, States):
    """Change of every parameter from a baseline to a later state, with its significance; see `States` for the states.

    Attributes
    ----------
    covariance : (n, n) float array
        Of `change`; NaN where a state does not determine a parameter.
    level, power : float
    correction : str
        ``holm``: `level` is the probability of any false declaration; ``benjamini_hochberg``: the expected part of
        false ones among those declared.
    status : Status
        The worse of the two states'.
    least : float
        Least change of interest, in parts of the value before: what may be smaller is not declared.
    """

    covariance: FloatArray
    level: float
    power: float
    correction: Correction
    status: Status
    least: float = 0.0

    def overview(self) -> Overview:
        """Result in a sentence, and one row for each parameter in the `order`, declared changes first.

        A row has name, unit, both values and the relative change, all with standard deviations, the corrected p-value, and
        "changed" if the change is declared.
        """
        rows = [
            (
                self.names[i],
                unit_text(self.units[i]),
                with_std(float(self.before[i]), float(self.covariance_before[i, i]) ** 0.5),
                with_std(float(self.after[i]), float(self.covariance_after[i, i]) ** 0.5),
                f"{percent(float(self.relative_change[i]))} ± {percent(float(self.relative_std[i]), 2, signed=False)}",
                format_number(float(self.adjusted[i]), 2),
                "changed" if self.changed[i] else "",
            )
            for i in self.order
        ]
        return Overview(self.words, ("parameter", "unit", "before", "after", "change", "p corrected", ""), rows)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of every change, (n,), physical units; NaN where it is not determined."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def p_values(self) -> FloatArray:
        """Probability of a change as large if the true one were `least` at most, (n,); NaN where it is not tested.

        References
        ----------
        Hodges and Lehmann (1954), J. R. Statist. Soc. B 16, 261-268 (tests of hypotheses that are intervals).
        """
        std = _tested_std(self.covariance)
        size, least = np.abs(self.change) / std, self.least * np.abs(self.before) / std
        return locked(special.ndtr(least - size) + special.ndtr(-least - size))

    @cached_property
    def adjusted(self) -> FloatArray:
        """`p_values` corrected for their number, (n,); a change is declared where it is at most `level`."""
        return locked(adjusted_p_values(self.p_values, self.correction))

    @property
    def changed(self) -> np.ndarray:
        """True for each parameter with a declared change, (n,) bool."""
        return self.adjusted <= self.level

    @property
    def detection_limit(self) -> FloatArray:
        """Smallest single change that is declared with probability `power`, (n,), physical units."""
        std = _tested_std(self.covariance)
        limit = std * detectable(int(np.isfinite(std).sum()), self.level, self.power)
        return limit + self.least * np.abs(self.before)

    @property
    def order(self) -> list[int]:
        """Indices of the parameters: those with a declared change first, then by falling size of the relative change."""
        size = np.nan_to_num(np.abs(self.relative_change))
        return sorted(range(len(self.names)), key=lambda i: (not self.changed[i], -size[i]))

    @property
    def statistic(self) -> float:
        """Chi-square of all determined changes together; NaN if there is none or their covariance is singular."""
        return _joint_chi_square(self.change, self.covariance)[0]

    @property
    def probability(self) -> float:
        """Probability of a larger `statistic` if nothing had changed; NaN where `statistic` is."""
        return _joint_chi_square(self.change, self.covariance)[1]

    @property
    def relative_change(self) -> FloatArray:
        """Change as a part of the magnitude of the value before, (n,); NaN where that is 0."""
        return self.change / np.where(self.before != 0, np.abs(self.before), np.nan)

    @property
    def relative_std(self) -> FloatArray:
        return self.std / np.where(self.before != 0, np.abs(self.before), np.nan)

    @property
    def relative_detection_limit(self) -> FloatArray:
        return self.detection_limit / np.where(self.before != 0, np.abs(self.before), np.nan)

    @property
    def is_complete(self) -> bool:
        """True where both states determine all that is compared."""
        return self.status is Status.CONVERGED and bool(np.isfinite(self.p_values).all())

    @property
    def words(self) -> str:
        """Sentence with the parameters declared changed, in per cent of the value before, or that none is.

        Parameters are in the order of `self.order`; risk and level of the declarations are named.
        """
        ratio = self.relative_change
        declared = [
            f"{self.names[i]} ({100 * ratio[i]:{'+.1f' if abs(ratio[i]) > 1e-3 else '+.2g'}} %)"
            for i in self.order
            if self.changed[i]
        ]
        risk = "joint risk" if self.correction == "holm" else "false discovery rate"
        least = f"by more than {100 * self.least:g} % " if self.least else ""
        tail = f"{least}({risk} {100 * self.level:g} %)"
        if declared:
            return f"changed {tail}: {', '.join(declared)}"
        return f"no parameter changed {tail}"


def compare_states(
    baseline: Identified,
    later: Identified,
    carried: Sequence[str] = (),
    level: float = 0.05,
    power: float = 0.9,
    correction: Correction = "holm",
    least: float = 0.0,
) -> Comparison:
    """Change of every parameter that both estimates have, and which changes are more than noise.

    With d the difference of the estimates and C its covariance, each change is tested by d / sqrt(C_ii) against the
    normal distribution in both directions; the p-values are corrected for their number.

    Parameters
    ----------
    baseline, later : Estimate
        From independent data. Their adopted covariances count, which carry model error where there was one.
    carried : sequence of str
        Parameters that did not change, such as masses, and whose Gaussian prior in the later estimate was the
        baseline's result with its covariance (`joint_prior`). They tie the states: the later data correct the
        baseline too, and what is common to both drops out of the difference.
    level : float
        Accepted rate of false declarations; see `correction`.
    power : float
        Probability with which a change as large as the detection limit is declared.
    correction : {"holm", "benjamini_hochberg"}
        What `level` limits: the probability of any false declaration, or the expected part of false ones among all.
    least : float
        Least change of interest, in parts of the baseline's value; what may be smaller is not declared.

    Returns
    -------
    Comparison
        Also where an estimate is not determined: see `status` and NaN.

    Raises
    ------
    InputError
        If a state is no `Estimate`, one lacks a carried parameter, they share none but these, a unit differs, or an
        argument is out of range.

    Notes
    -----
    Independent states: C = P + Q, the sum of the covariances from the data, and (A - B) (A - B)' with the
    changes A and B of the parameters for one tolerance of each fixed value: what both states owe to the same fixed
    values is no change. With carried parameters m and covariance P of the baseline, G = P_km P_mm^-1 and Q the
    covariance of the later estimate,

        k_before = k + G (m_later - m),   C = Q_kk + P_kk - G P_mk + G Q_mm G' - G Q_mk - Q_km G',

    which is the Gaussian estimate from all data at once where the estimates are linear in the carried parameters. It is
    computed in logarithms of what is positive; `compare_jointly` needs no such thing.

    References
    ----------
    Holm (1979), Scand. J. Statist. 6, 65; Benjamini and Hochberg (1995), J. R. Statist. Soc. B 57, 289.
    """
    for argument, state in (("baseline", baseline), ("later", later)):
        if not isinstance(state, Identified):
            raise InputError(
                f"`{argument}` must be an estimate, got {type(state).__name__}; of an `Identification` give its `.estimate`"
            )
    require_levels(level, power, correction)
    carried = tuple(carried)
    for label in carried:
        if label not in baseline.names or label not in later.names:
            raise InputError(f"`carried` must name parameters of both states, got {label!r}; identify it in both")
    names = _common(baseline.names, later.names, carried)
    first, second = _places(baseline, names), _places(later, names)
    _require_units(names, [baseline.units[i] for i in first], [later.units[j] for j in second])
    before, p, q, cross = _update_by_carried(baseline, later, first, second, carried)
    by_fixed = _changes_by_fixed_values(baseline, later, first, second, carried)
    return Comparison(
        names=names,
        kinds=tuple(baseline.kinds[i] for i in first),
        units=tuple(baseline.units[i] for i in first),
        before=locked(before),
        after=locked(later.values[second]),
        covariance_before=locked(p + by_fixed[0] @ by_fixed[0].T),
        covariance_after=locked(q + by_fixed[1] @ by_fixed[1].T),
        carried=carried,
        only_before=tuple(n for n in baseline.names if n not in later.names and OF_RECORD not in n),
        only_after=tuple(n for n in later.names if n not in baseline.names and OF_RECORD not in n),
        covariance=locked(p + q - cross - cross.T + (by_fixed[0] - by_fixed[1]) @ (by_fixed[0] - by_fixed[1]).T),
        level=level,
        power=power,
        correction=correction,
        least=least,
        status=baseline.status if baseline.status is not Status.CONVERGED else later.status,
    )


def compare_jointly(
    identified: Identified,
    shared: Sequence[str],
    level: float = 0.05,
    power: float = 0.9,
    correction: Correction = "holm",
    least: float = 0.0,
) -> Comparison:
    """Changes of parameters between two states that were identified together in one estimate with shared parameters.

    The covariance alone is linearized; use it rather than `compare_states` where shared parameters are known poorly.
    Parameters named ``<name> (later)`` are paired with ``<name>``; parameters local to a record are not compared.

    Parameters
    ----------
    identified : Estimate
        Of a `states_problem`.
    shared : sequence of str
        The parameters that it has in common for both states.
    level : float
        Accepted rate of false declarations; see `correction`.
    power : float
        Probability with which a change as large as the detection limit is declared.
    correction : {"holm", "benjamini_hochberg"}
        What `level` limits: the probability of any false declaration, or the expected part of false ones among all.
    least : float
        Least change of interest, in parts of the baseline's value; what may be smaller is not declared.

    Raises
    ------
    InputError
        If the states have nothing but the shared parameters in common, or an argument is out of range.
    """
    require_levels(level, power, correction)
    shared_names = [(name, i) for i, name in enumerate(identified.names) if OF_RECORD not in name]
    second = {name.removesuffix(LATER): i for name, i in shared_names if name.endswith(LATER)}
    first = {name: i for name, i in shared_names if not name.endswith(LATER)}
    names = tuple(name for name in first if name in second)
    if not names:
        raise InputError(_NOTHING_IN_COMMON)
    in_first, in_second = (np.array([index_of[name] for name in names]) for index_of in (first, second))
    _require_units(names, [identified.units[i] for i in in_first], [identified.units[i] for i in in_second])
    p, q, cross = (
        identified.covariance[np.ix_(*pair)]
        for pair in ((in_first, in_first), (in_second, in_second), (in_first, in_second))
    )
    return Comparison(
        names=names,
        kinds=tuple(identified.kinds[i] for i in in_first),
        units=tuple(identified.units[i] for i in in_first),
        before=locked(identified.values[in_first]),
        after=locked(identified.values[in_second]),
        covariance_before=locked(p),
        covariance_after=locked(q),
        carried=tuple(shared),
        only_before=tuple(name for name in first if name not in second and name not in shared),
        only_after=tuple(name for name in second if name not in first),
        covariance=locked(p + q - cross - cross.T),
        level=level,
        power=power,
        correction=correction,
        least=least,
        status=identified.status,
    )


def _common(first: Sequence[str], second: Sequence[str], shared: Sequence[str]) -> tuple[str, ...]:
    """Names of the parameters to compare: in `first` and in `second`, not `shared`, and not local to a record.

    The order is that of `first`. Raises `InputError` if no name is left.
    """
    names = tuple(n for n in first if n in second and n not in shared and OF_RECORD not in n)
    if not names:
        raise InputError(_NOTHING_IN_COMMON)
    return names


def _require_units(names: Sequence[str], first: Sequence[str], second: Sequence[str]) -> None:
    """Raise `InputError` if a parameter has different units in the two states.

    `first` and `second` are the units in the baseline and the later state, in the order of `names`.
    """
    for name, unit, other in zip(names, first, second, strict=True):
        if unit != other:
            raise InputError(
                f"{name} must have one unit in both states, got {unit} and {other}; declare `factor` alike"
            )


def _tested_std(covariance: FloatArray) -> FloatArray:
    """Standard deviations of the changes, (n,), from their `covariance`; NaN where the variance is not positive."""
    variance = np.diag(covariance)
    return np.sqrt(np.where(variance > 0, variance, np.nan))


def _places(estimate: Identified, names: Sequence[str]) -> np.ndarray:
    """Indices of the parameters `names` in an estimate, (len(names),) int; each of them must exist."""
    return np.array([estimate.names.index(name) for name in names], dtype=int)


def _changes_by_fixed_values(
    baseline: Identified, later: Identified, first: np.ndarray, second: np.ndarray, carried: tuple[str, ...]
) -> tuple[FloatArray, FloatArray]:
    """Changes of the compared parameters by each cause in `FixedValueInfluence.changes`, in baseline and later state.

    Both results are (n, n_causes). Columns are the causes of the baseline in the order of `change_names`, then those of
    the later state alone; a fixed value of both has the larger error in both. `first` and `second` are the indices of
    the n compared parameters in the two estimates. `carried` names parameters whose prior in the later state was the
    result of the baseline; through them a fixed value of one state also changes the other, where the covariances are
    finite. Without fixed values both have no columns.
    """
    names = tuple(
        dict.fromkeys(name for state in (baseline, later) if state.fixed for name in state.fixed.change_names)
    )
    errors = np.maximum(*(_errors(state, names) for state in (baseline, later)))
    before, after = _aligned(baseline, names, errors), _aligned(later, names, errors)
    if not carried or not names:
        return before[first], after[second]
    in_first, in_second = _places(baseline, carried), _places(later, carried)
    p, q = baseline.covariance_of_data, later.covariance_of_data
    known = p[np.ix_(in_first, in_first)]
    if not (np.isfinite(known).all() and np.isfinite(q[:, in_second]).all()):
        return before[first], after[second]
    after = after + q[:, in_second] @ np.linalg.solve(known, before[in_first])
    moved = np.linalg.solve(known, after[in_second] - before[in_first])
    return before[first] + p[np.ix_(first, in_first)] @ moved, after[second]


def _aligned(estimate: Identified, names: tuple[str, ...], errors: FloatArray) -> FloatArray:
    """Changes (n_params, n_names) of all parameters of `estimate` by each of the causes `names`, for given `errors`.

    `errors` (n_names,) are the standard deviations of the causes; 0 where the estimate has no such cause.
    """
    changes = np.zeros((len(estimate.names), len(names)))
    if estimate.fixed is not None:
        changes[:, [names.index(name) for name in estimate.fixed.change_names]] = estimate.fixed.changes
    return widen_changes(changes, _errors(estimate, names), errors)


def _errors(estimate: Identified, names: tuple[str, ...]) -> FloatArray:
    """Error of each of the causes `names` in an estimate, (n_names,); 0 where it has no such fixed value."""
    fixed = estimate.fixed
    errors = {} if fixed is None else dict(zip(fixed.change_names, fixed.change_tolerances, strict=True))
    return np.array([errors.get(name, 0.0) for name in names])


def _update_by_carried(
    baseline: Identified, later: Identified, first: np.ndarray, second: np.ndarray, carried: tuple[str, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Values of the baseline and three covariances of the compared parameters, after the update by carried parameters.

    Returns the values (n,), the covariances of baseline and later state, and the cross-covariance (baseline by later),
    (n, n) each. `first` and `second` are the indices of the compared parameters in the two estimates. The update is
    linear in logarithms where both values are positive, else in the values. If the baseline does not determine
    `carried`, its covariance and the cross-covariance are NaN, and its values unchanged. Without `carried` nothing is
    changed, and the cross-covariance is 0.
    """
    p, q = baseline.covariance_of_data, later.covariance_of_data
    values, other = baseline.values[first], q[np.ix_(second, second)]
    if not carried:
        unchanged = p[np.ix_(first, first)]
        return values, unchanged, other, np.zeros_like(unchanged)
    in_first, in_second = _places(baseline, carried), _places(later, carried)
    rows, columns = np.concatenate([in_first, first]), np.concatenate([in_second, second])
    log = (baseline.values[rows] > 0) & (later.values[columns] > 0)
    scale = np.where(log, baseline.values[rows], 1.0)
    p = p[np.ix_(rows, rows)] / np.outer(scale, scale)
    scale = np.where(log, later.values[columns], 1.0)
    q = q[np.ix_(columns, columns)] / np.outer(scale, scale)
    n = len(in_first)
    if not np.isfinite(p[:n, :n]).all():
        nothing = np.full_like(other, np.nan)
        return values, nothing, other, nothing
    safe = np.where(log, baseline.values[rows], 1.0), np.where(log, later.values[columns], 1.0)
    moved = np.where(log, np.log(safe[1] / safe[0]), later.values[columns] - baseline.values[rows])[:n]
    gain = np.linalg.solve(p[:n, :n], p[:n, n:]).T
    step = gain @ moved
    before = np.where(log[n:], values * np.exp(np.where(log[n:], step, 0.0)), values + step)
    updated = p[n:, n:] - gain @ p[:n, n:] + gain @ q[:n, :n] @ gain.T
    scales = np.where(log[n:], before, 1.0), np.where(log[n:], later.values[second], 1.0)
    return before, updated * np.outer(scales[0], scales[0]), other, gain @ q[:n, n:] * np.outer(*scales)


def _joint_chi_square(change: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Chi-square of all determined changes jointly, and the probability of a larger value if nothing had changed.

    `change` is (n,), `covariance` (n, n). Both results are NaN if no change is determined or the covariance is singular.
    """
    seen = np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0)
    if not seen.any():
        return float("nan"), float("nan")
    std = np.sqrt(np.diag(covariance)[seen])
    correlation = covariance[np.ix_(seen, seen)] / np.outer(std, std)
    values, vectors = np.linalg.eigh(correlation)
    if values[0] <= 1e-10:
        return float("nan"), float("nan")
    scores = vectors.T @ (change[seen] / std)
    statistic = float((scores**2 / values).sum())
    return statistic, float(special.gammaincc(len(values) / 2, statistic / 2))


def states_problem(baseline: Problem, later: Problem, shared: Sequence[str]) -> JointProblem:
    """Joint problem of the data of both states, with the `shared` parameters equal and all others free in each.

    Parameters of the later state that are not shared are called ``<name> (later)``.

    Parameters
    ----------
    baseline, later : Problem
        From independent data.
    shared : sequence of str
        Names of parameters of both.

    Raises
    ------
    InputError
        If a shared parameter is missing in one of them, or differs in unit, transform, bounds or prior.
    """
    for name in shared:
        if name not in baseline.names or name not in later.names:
            raise InputError(f"`shared` must name parameters of both states, got {name!r}; identify it in both")
    names = tuple(name if name in shared else name + LATER for name in later.names)
    return JointProblem((baseline, later), labels=(baseline.names, names))


@dataclass(frozen=True)
class UnchangedTest:
    """A likelihood ratio test of parameters that two states have in common.

    Attributes
    ----------
    names : tuple of str
        The parameters that are the same.
    cost, separate_cost : float
        Sum of squares with them the same, and with them free in each state; what is held is free within its tolerances in both.
    degrees_of_freedom : float
        Of the data of both states, with everything free.
    freedom : int
        How many conditions the common parameters, and fixed values that both states share, make.
    differing : tuple of (str, float, float)
        Parameters among `names` that the states ask for differently: the relative change, and the same in standard deviations; the
        surest first.

    References
    ----------
    Wilks (1938), Ann. Math. Statist. 9, 60-62.
    """

    names: tuple[str, ...]
    cost: float
    separate_cost: float
    degrees_of_freedom: float
    freedom: int
    differing: tuple[tuple[str, float, float], ...]

    @property
    def statistic(self) -> float:
        """Increase of the sum of squares when the parameters are equal in both states, never below 0.

        It is divided by the chi-square per degree of freedom of the separate fit where that exceeds 1.
        """
        scale = max(1.0, self.separate_cost / self.degrees_of_freedom) if self.degrees_of_freedom > 0 else 1.0
        return max(self.cost - self.separate_cost, 0.0) / scale

    @property
    def probability(self) -> float:
        """Probability of a larger `statistic` if they are the same."""
        return float(special.gammaincc(self.freedom / 2, self.statistic / 2))

    @property
    def is_contradicted(self) -> bool:
        """True if the data of both states do not allow that they are the same."""
        return not np.isfinite(self.cost) or self.probability < _CONTRADICTED

    @property
    def words(self) -> str:
        """Sentence on whether the data allow that the parameters `self.names` did not change, with both chi-squares.

        If the data contradict it, those that differ most follow, with change (%) and number of standard deviations.
        """
        kept = join_words(self.names, _MOST_NAMED)
        same, separate = format_number(self.cost, 3), format_number(self.separate_cost, 3)
        sums = f"chi-square is {same} with them the same, and {separate} with them free"
        if not self.is_contradicted:
            return f"the data allow that {kept} did not change: {sums}"
        most = [
            f"{name} ({100 * ratio:+.2g} %, {format_number(abs(z), 2)} deviations)" for name, ratio, z in self.differing
        ]
        which = f": {join_words(most, _MOST_NAMED)}" if most else ""
        return (
            f"the data contradict that {kept} did not change: {sums}. What changed was named as unchanged{which}; name less, as no"
            " declared change is to be used"
        )

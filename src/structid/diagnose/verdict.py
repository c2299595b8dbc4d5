"""The verdict: whether an answer is to be trusted, and the fact or two that say so."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import special

from structid.core.display import Overview, Shown, as_sentence, exact, join_words, percent, plural, prefixed, with_unit
from structid.diagnose.data_rows import misfit_of_lines
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, doubted
from structid.diagnose.split_consistency import Disagreement, disagreements
from structid.diagnose.thresholds import (
    COMMON_RISK,
    CONTRADICTING_PART,
    DOUBT,
    ELEMENT_SCATTER,
    FAR_BEYOND,
    FEW_FREEDOMS,
    GROSSLY_CONTRADICTING_PART,
    HALF_BANDWIDTHS_OFF,
    LARGE_ERROR,
    LEAST_FREEDOM,
    LOCAL_MISFIT,
    MATTERS,
    MOST_OF_MISFIT,
    NEARLY_ALL,
    NOISE_TOLERANCE,
    NOT_THE_WHOLE,
    ORDERED_DATA,
    PAIR_MISFIT,
    SHIFTS,
    SHOWN_RATIO,
    TOLD_SHIFT,
    WHOLE,
)
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.alternatives import Alternatives
from structid.identification.identified import Identification
from structid.identification.record_fit import LEAST_DAMPING, RecordFit
from structid.identification.warning_words import is_gone, ran_away_words
from structid.inversion import Status
from structid.inversion.fixed_values import limit_of
from structid.inversion.search.work import SERIAL, TaskExecutor

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit

Verdict = Literal["sound", "approximate", "wrong_model", "undetermined", "untested"]

#: What intervals rest on where the noise is of another size than stated.
_INTERVALS = {
    "model_error": "the intervals come from the residual",
    "noise": "the intervals are those of the stated or assumed noise",
}
NOT_TRIED = "no change of model or record was tried that might explain it: `structid explain` does"


@dataclass(frozen=True)
class Judgement:
    """A verdict with its reasons.

    Attributes
    ----------
    verdict : Verdict
    words : str
        One or two sentences for the first line of everything that shows the answer.
    reasons : tuple of str
        All that speaks for it, the strongest first.
    """

    verdict: Verdict
    words: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class ParameterShift:
    """A value that a cause changes.

    Attributes
    ----------
    name, unit : str
    before, after : float
    interval : (float, float)
        Interval of the value after the change, were the cause the truth, at the probability of the answer's intervals.
    distance : float
        Change in standard deviations of the answer.
    """

    name: str
    unit: str
    before: float
    after: float
    interval: tuple[float, float]
    distance: float


@dataclass(frozen=True)
class Cause:
    """A change of model or record that explains a misfit.

    Attributes
    ----------
    kind : str
    where : tuple of str
    words : str
        Such as ``the support 9Y gives way``.
    share : float
        Part of the misfit that it removes.
    chi_square_per_dof : float
        Chi-square per degree of freedom that is left; data that the change leaves out are included, with larger errors.
    found : tuple of (str, float, str)
        Parameters that it adds: name, value, unit.
    moved : tuple of ParameterShift
        Values that change, the farthest first.
    is_alike : bool
        Whether the data do not tell it from the first.
    is_second : bool
        Whether it comes beside the first: its share is of what that leaves, and its study has both.
    study : str
        Name of the study that is written with it; "" where there is none.
    lines : tuple of str
        Lines in which that study differs from the present one, with + or - before each.
    rest_per_dof : float
        Where it leaves data out: chi-square per degree of freedom of the others alone.
    leaves_noise : bool
        Whether what it leaves is no more than chance makes of noise: of few values that may be well above the expected one.
    leaves_data_out : bool
        Whether it is data that do not go with the rest.
    has_fit : bool
        Whether a fit of the changed model is behind it, which can be written as a study.
    """

    kind: str
    where: tuple[str, ...]
    words: str
    share: float
    chi_square_per_dof: float
    found: tuple[tuple[str, float, str], ...] = ()
    moved: tuple[ParameterShift, ...] = ()
    is_alike: bool = False
    is_second: bool = False
    study: str = ""
    lines: tuple[str, ...] = ()
    rest_per_dof: float = 1.0
    leaves_noise: bool = False
    leaves_data_out: bool = False
    has_fit: bool = True

    @property
    def line(self) -> str:
        """Line for this cause in a list of causes."""
        return f"beside the first, {self.words}" if self.is_second else self.words

    @property
    def share_text(self) -> str:
        """The removed part of the misfit, or of what the first cause leaves, as a text in per cent."""
        return percent(self.share, 3, signed=False) + (" of what is left" if self.is_second else "")

    @property
    def moves(self) -> float:
        """Largest shift of a parameter by this cause, in standard deviations of the answer; 0 if no shift is known."""
        return self.moved[0].distance if self.moved else 0.0


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """The verdict on an answer, with the causes of a misfit.

    Attributes
    ----------
    judgement : Judgement
    causes : tuple of Cause
        The likeliest first.
    suggestions : tuple of Cause
        Changes that lower the misfit most, where none explains it and there are no causes.
    n_tried : int
        How many changes were held against the misfit; 0 where none were.
    sensitivities : tuple of FixedValueSensitivity
        Sensitivity of the values to those that the model fixes, where they may be used.
    """

    judgement: Judgement
    causes: tuple[Cause, ...] = ()
    suggestions: tuple[Cause, ...] = ()
    n_tried: int = 0
    sensitivities: tuple[FixedValueSensitivity, ...] = ()

    def overview(self) -> Overview:
        """The verdict, and a table with one row for each cause, or else for each change that lowers the misfit."""
        rows = [
            (
                cause.line,
                f"{100 * cause.share:.0f} %",
                ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in cause.found),
            )
            for cause in self.named
        ]
        what = "cause" if self.causes else "change that lowers the misfit"
        return Overview(self.judgement.words, (what, "removes", "finds"), rows)

    @property
    def named(self) -> tuple[Cause, ...]:
        """Changes to show: the causes, or, without causes, those that lower the misfit most; () without these too."""
        return self.causes or self.suggestions


def noise_ratio(identification: Identification) -> float | None:
    """True standard deviation of the noise over the assumed one: 1.0 if that fits, None if the residual is not just noise.

    It fits at a chance of 0.1 % either way, or if the variance is within 25 %. A ratio other than 1 needs a record of
    responses, and a white, normal residual of at least 300 data with fixed values within their tolerances. None too
    without residual tests.
    """
    tests = identification.estimate.goodness.residual_tests
    is_normal = tests is not None and tests.normality_probability >= DOUBT
    if tests is None or tests.not_white or tests.one_sided:
        return None
    ratio = identification.estimate.goodness.misfit
    is_of_size = tests.chi_square_probability >= DOUBT and 1 - tests.chi_square_probability >= DOUBT
    if is_of_size or 1 / NOISE_TOLERANCE < ratio < NOISE_TOLERANCE:
        return 1.0
    ratio = float(np.sqrt(identification.estimate.goodness.least_per_dof))
    is_ordered = identification.estimate.goodness.n_data >= ORDERED_DATA
    if not identification.fits or not is_normal or not is_ordered or _is_beyond_noise(identification, ratio):
        return None
    return ratio


def _is_beyond_noise(identification: Identification, ratio: float) -> bool:
    """True where fixed values or the calibration are farther off than tolerances and `ratio` times the noise explain.

    What the data ask of a fixed value, in its tolerances, scatters by the larger of 1 and `ratio` at most. False if no values
    are fixed.
    """
    fixed = identification.estimate.fixed
    return fixed is not None and bool(
        np.abs(fixed.asked).max(initial=0.0) > max(1.0, ratio) * limit_of(len(fixed.asked))
    )


def fits_noise(identification: Identification) -> bool:
    """True if the residual is what the noise leaves: of the right size, in whole and in parts, and without order.

    False if a record is missed or a fixed value is beyond its tolerance. Without residual tests the covariance basis
    decides: True if it is the noise.
    """
    fixed = identification.estimate.fixed
    if identification.missed or (fixed is not None and fixed.beyond):
        return False
    tests = identification.estimate.goodness.residual_tests
    if tests is None:
        return identification.estimate.covariance_basis == "noise"
    return noise_ratio(identification) == 1.0


def _is_within_tolerances(identification: Identification) -> bool:
    """True where fixed values, free within their tolerances, leave no more misfit than noise; False if unknown."""
    estimate = identification.estimate
    is_beyond = estimate.fixed is not None and bool(estimate.fixed.beyond)
    return np.isfinite(estimate.goodness.least_chi_square) and estimate.covariance_basis == "noise" and not is_beyond


def is_untested(identification: Identification) -> bool:
    """True if the misfit fits the noise, but too few data are left beyond the parameters, so that any model fits.

    That is no degree of freedom, or less than 0.99 of one that tests the model. False for a search without a Jacobian
    (`target` is None).
    """
    goodness = identification.estimate.goodness
    is_without_freedom = not goodness.degrees_of_freedom > 0 or goodness.test_freedom < LEAST_FREEDOM
    is_fitting = identification.estimate.covariance_basis == "noise"
    return identification.target is not None and is_fitting and is_without_freedom


def leaves_noise_alone(identification: Identification) -> bool:
    """True where the residual is noise of the stated size or smaller, and nothing speaks against the search."""
    return is_sound(identification) or _is_quiet(identification)


def is_sound(identification: Identification) -> bool:
    """True if nothing speaks against model, record and search."""
    return _is_unforced(identification) and fits_noise(identification)


def _is_quiet(identification: Identification) -> bool:
    """True if nothing speaks against model, record and search but noise that is stated too large."""
    return _is_unforced(identification) and _is_below_noise(identification)


def _is_unforced(identification: Identification) -> bool:
    """True where the search converged, no parameter ran away, and none is at a bound that the data push it against."""
    forced = identification.ran_away or any(one.is_pushed for one in identification.estimate.spread.at_bound)
    return identification.estimate.status is Status.CONVERGED and not forced


def are_causes(causes: Sequence[Cause], misfit: float, expected: float = 1.0, is_hidden: bool = False) -> bool:
    """True where changes are the causes of the misfit, and do not only lower it; False without changes.

    The first is a cause where it leaves no more than noise and tolerances do, and removes at least half of the misfit or moves
    a value by more than its interval and 1 %: small errors all over a model are lowered a little by many changes, none of which
    matters. A change that leaves more is no cause, but a pair that leaves noise alone is, if the misfit is above four times the
    expected one. Data that are left out are no cause where the rest misses the noise as well: beside a wrong model any sensor
    looks wrong. Nor is an element that differs from its group by less than 2 % and moves no value.

    Parameters
    ----------
    causes : sequence of Cause
        Changes, the likeliest first.
    misfit : float
        Chi-square per degree of freedom without a change.
    expected : float
        Its expected value where model and noise are right.
    is_hidden : bool
        True if the answer misses a record that the whole misfit hardly shows: then no value needs to move.
    """
    if not causes or _is_scatter(causes[0]):
        return False
    return _explains(causes[0], misfit, expected, is_hidden) or (
        misfit > PAIR_MISFIT * expected and _completing(causes, expected) is not None
    )


def _explains(cause: Cause, misfit: float, expected: float, is_hidden: bool) -> bool:
    """True if a cause leaves no more than noise, and removes most of the misfit or moves a value that matters.

    `misfit` and `expected` are chi-square per degree of freedom, of the answer and of noise. No more than noise is up
    to 1.25 times `expected`, or four times if 95 % of what goes beyond the noise is removed. Most is half of the
    misfit; if a value moves by more than 2.2 standard deviations and 1 %, 85 % of what goes beyond noise, or all of it.
    With `is_hidden`, parts of the data are missed although the whole is not, and no value needs to move.
    """
    left = cause.rest_per_dof if cause.leaves_data_out else cause.chi_square_per_dof
    beyond = (misfit - cause.chi_square_per_dof) / (misfit - expected) if misfit > expected else 0.0
    is_noise = cause.leaves_noise or left <= NOISE_TOLERANCE * expected
    if not is_noise and not (left <= NOT_THE_WHOLE * expected and beyond >= WHOLE):
        return False
    matters = is_hidden or any(map(_matters, cause.moved))
    return cause.share >= MOST_OF_MISFIT or (matters and (cause.leaves_noise or beyond >= NEARLY_ALL))


def _noise_ratio(cause: Cause) -> str:
    """Residual that a cause leaves, in times the noise, as text: two digits, or a whole number from 100 on."""
    ratio = float(np.sqrt(cause.chi_square_per_dof))
    return f"{ratio:.2g}" if ratio < 99.5 else f"{ratio:.0f}"


def _completing(causes: Sequence[Cause], expected: float) -> Cause | None:
    """First of the second `causes`, if it leaves nothing but noise in addition to the first cause; None otherwise.

    `expected` is the chi-square per degree of freedom of noise; up to 1.25 times this counts as noise.
    """
    second = next((one for one in causes if one.is_second), None)
    if second is None or not (second.leaves_noise or second.chi_square_per_dof <= NOISE_TOLERANCE * expected):
        return None
    return second


def _is_scatter(cause: Cause) -> bool:
    """True where a single element differs from its group by less than 2 % and no value moves: usual in manufacture."""
    is_small = all(unit == "1" and abs(ratio - 1) < ELEMENT_SCATTER for _, ratio, unit in cause.found)
    return cause.kind == "untied" and is_small and not any(map(_matters, cause.moved))


def _matters(value: ParameterShift) -> bool:
    return value.distance > MATTERS and abs(value.after - value.before) > SHIFTS * abs(value.before)


def judged(
    identification: Identification,
    causes: Sequence[Cause] = (),
    n_tried: int = 0,
    suggestions: Sequence[Cause] = (),
    untried: str = "",
    sensitivities: Sequence[FixedValueSensitivity] = (),
    is_asked: bool = False,
    find_disagreements: Callable[[], tuple[Disagreement, ...]] | None = None,
) -> Judgement:
    """Verdict on an identification, with its reasons, among them faults of channels and records that stand out.

    Parameters
    ----------
    identification : Identification
        Answer to judge.
    causes : sequence of Cause
        Accepted causes of the misfit, the likeliest first.
    n_tried : int
        Number of changes that were tried; 0 where none were.
    suggestions : sequence of Cause
        Where there is no cause: the changes that lower the misfit most.
    untried : str
        Reason why no changes were tried, added to the words where the misfit is beyond noise; "" for none.
    sensitivities : sequence of FixedValueSensitivity
        Fixed values with the sensitivity of the answer to them.
    is_asked : bool
        True if the record of an answer within its noise asks for the `suggestions` beyond chance.
    find_disagreements : callable, optional
        Returns the parts of the data that do not agree, and is called without arguments, only where they decide;
        `data_disagreements` by default.
    """
    find_disagreements = find_disagreements or partial(data_disagreements, identification)
    if is_asked and is_sound(identification):
        judgement = _asked_for(suggestions)
    else:
        judgement = _judged(identification, causes, n_tried, suggestions, doubted(sensitivities), find_disagreements)
    is_open = identification.alternatives is not None or judgement.verdict == "untested"
    if untried and not is_open and not fits_noise(identification):
        judgement = replace(
            judgement, words=f"{judgement.words} {as_sentence(untried)}", reasons=(*judgement.reasons, untried)
        )
    faults = record_faults(identification)
    if faults and judgement.verdict not in ("sound", "untested"):
        judgement = replace(
            judgement,
            words=f"{judgement.words} The record itself shows: {faults[0]}.",
            reasons=(*judgement.reasons, *faults),
        )
    shared = clock_or_stiffness(identification) if judgement.verdict in ("sound", "approximate") else ""
    if shared:
        judgement = replace(
            judgement, words=f"{judgement.words} {as_sentence(shared)}", reasons=(*judgement.reasons, shared)
        )
    return replace(
        judgement,
        reasons=(*judgement.reasons, *(words for one in identification.priors.varied for words in one.outlying_words)),
    )


def clock_or_stiffness(identification: Identification) -> str:
    """Clause that a clock may as well explain that all stiffnesses moved together from their starts; "" if none may.

    Frequencies that are all read c times too high give c^2 times all stiffnesses over masses, and nothing else. The
    clause is there for modes and accelerations of models without a fixed stiffness, where the ratios of at least two
    stiffnesses to their starts agree with one common ratio (chi-square, 5 %) that differs from 1 by more than their
    uncertainty and 1 %. Axial forces count as stiffnesses. A matrix-free search has no covariance matrix to test this
    with; "" then, and where it is singular or not finite.
    """
    estimate, problems = identification.estimate, identification.problems
    index = np.flatnonzero(np.isin(estimate.kinds, _STIFFENING))
    if len(index) < 2 or not all(problem.facts.takes_clock_for_stiffness for problem in problems):
        return ""
    values, begun = estimate.values[index], estimate.initial[index]
    if not (estimate.uncertainty.has_matrix and (values * begun > 0).all()):
        return ""
    covariance = estimate.covariance[np.ix_(index, index)] / np.outer(values, values)
    if not np.isfinite(covariance).all() or any(_fixes_stiffness(problem) for problem in problems):
        return ""
    moved = np.log(values / begun)
    try:
        weights = np.linalg.solve(covariance, np.ones(len(index)))
        apart = np.linalg.solve(covariance, moved - (common := float(weights @ moved / weights.sum())))
    except np.linalg.LinAlgError:
        return ""
    is_common = special.chdtrc(len(index) - 1, float((moved - common) @ apart)) > COMMON_RISK
    if not is_common or abs(common) < max(MATTERS / np.sqrt(weights.sum()), SHIFTS):
        return ""
    ratio = float(np.exp(common))
    forces = " and axial forces" if "axial_force" in np.array(estimate.kinds)[index] else ""
    measured = "measured modes" if all(compares_modes(problem) for problem in problems) else "accelerations"
    return (
        f"all stiffnesses{forces} moved together, to {ratio:.3g} times their starts: {measured} cannot tell that from"
        f" frequencies that are all read {100 * abs(np.sqrt(ratio) - 1):.2g} % too {'high' if ratio > 1 else 'low'}; check the"
        " clock or sampling rate"
    )


#: Kinds of properties that frequencies read too high by one factor move by one factor.
_STIFFENING = ("stiffness", "axial_force")


def _fixes_stiffness(problem: RecordProblem) -> bool:
    """True if a stiffness or an axial force that no parameter changes is a part of the stiffness matrix of a problem."""
    unknown, structure = problem.parameters, problem.structure
    is_fixed = unknown.is_fixed
    factors = np.ones(len(is_fixed))
    for item in structure.properties:
        if item.term.kind in _STIFFENING:
            factors[item.values][is_fixed[item.values]] = 2.0
    if (factors == 1.0).all():
        return False
    change = structure.matrix("stiffness", factors * structure.values) - structure.matrix("stiffness")
    return bool(np.any(change.data))


def data_disagreements(identification: Identification, work: TaskExecutor = SERIAL) -> tuple[Disagreement, ...]:
    """Pairs of parts of the data of an identification whose fits do not agree; empty for a search without a Jacobian.

    `work` runs the fits. Parts are halves of the band and of the sensors; fixed values are free within their
    tolerances.
    """
    if identification.target is None:
        return ()
    theta = identification.estimate.theta
    return disagreements(identification.problems, theta, work, identification.freed)


def record_faults(identification: Identification) -> tuple[str, ...]:
    """Sentences on faults of single channels that the histories show (dead, clipped, spikes): first loads, then sensors.

    Each group is sorted by its text; empty if there are none.
    """
    faults: list[tuple[bool, str]] = []
    for setup in identification.setups:
        loads = {str(dof) for role, dofs in setup.channels if role == "input" for dof in dofs}
        faults += [(fault.channel.split()[0] not in loads, fault.words) for fault in setup.faults]
    return tuple(words for _, words in sorted(faults))


def _asked_for(suggestions: Sequence[Cause]) -> Judgement:
    """Verdict "approximate" for an answer within its noise whose record asks for `suggestions` beyond chance.

    The words name the first of them, and the value that the most moving one moves farthest. There must be at least one,
    and that one must have shifts.
    """
    change_words = tuple(one.words for one in suggestions)
    most = max(suggestions, key=lambda one: one.moves)
    first = most.moved[0]
    part = abs(first.after / first.before - 1) if first.before else np.inf
    words = (
        f"Approximate: the model explains the record to within its noise, but the record asks for a change: {change_words[0]}."
        f" {first.name} may move by {100 * part:.2g} %, {most.moves:.2g} standard deviations: the intervals hold either way."
    )
    return Judgement("approximate", words, change_words)


def _weak_words(identification: Identification) -> str:
    """Exception for the parameters that the data determine weakly: ``" but mass[deck] (to ± 80 %)"``; "" if there are none.

    Parameters at a bound do not count, nor those that may be negative: near 0 a percentage says nothing.
    """
    estimate, lower = identification.estimate, identification.intervals.ends[:, 0]
    at_bound = {bound.index for bound in estimate.spread.at_bound}
    named = [
        f"{estimate.names[index]} (to ± {100 * estimate.std[index] / estimate.values[index]:.2g} %)"
        for index in np.flatnonzero(estimate.weakly_determined & ~(lower < 0) & (estimate.values > 0)).tolist()
        if index not in at_bound
    ]
    return f" but {join_words(named, 3)}" if named else ""


def _judged(
    identification: Identification,
    causes: Sequence[Cause],
    n_tried: int,
    suggestions: Sequence[Cause],
    doubts: Sequence[FixedValueSensitivity],
    find_disagreements: Callable[[], tuple[Disagreement, ...]],
) -> Judgement:
    """Verdict by misfit, noise, priors, bounds, causes and doubted fixed values; the first rule that applies decides.

    `causes` are accepted, `suggestions` lower the misfit without being causes, both the likeliest first; `doubts` are
    the fixed values that are doubted. Faults of channels do not count. `n_tried` counts the changes that were tried;
    `find_disagreements` fits parts of the data, and is called only where the verdict depends on it.
    """
    estimate = identification.estimate
    if identification.alternatives is not None:
        return _several(identification.alternatives)
    if is_untested(identification) and not causes:
        return _untested(identification)
    if estimate.spread.disagreement is not None and not causes and leaves_noise_alone(identification):
        objection = estimate.spread.disagreement.words
        words = f"Approximate: the misfit is no larger than the noise was stated, but {objection}; {_INTERVALS['model_error']}."
        return Judgement("approximate", words, (objection, *(one.words for one in doubts)))
    if is_sound(identification) and not causes and doubts:
        doubt_words = tuple(one.words for one in doubts)
        remedy = ": measure it, or make it an unknown, with a prior where it is known a little"
        words = (
            "Approximate: the model explains the record to within its noise, but"
            f" {doubt_words[0]}{'' if doubts[0].is_like_clock else remedy}."
        )
        return Judgement("approximate", words, doubt_words)
    by_priors = _by_priors(identification) if leaves_noise_alone(identification) and not causes else []
    rank, n_free = estimate.identifiability.rank, estimate.identifiability.n_free
    if by_priors:
        words = (
            "Approximate: the model explains the record to within its noise, but priors, not the data, determine"
            f" {join_words(by_priors, 4)}{_open_combinations(identification)}: the record cannot test what they say."
        )
        return Judgement("approximate", words, (words,))
    if is_sound(identification) and not causes:
        words = "Sound: the model explains the record to within its noise, and the data determine every"
        at_bound = "; ".join(one.words for one in estimate.spread.at_bound)
        if rank < n_free and estimate.uncertainty.has_matrix:
            words = (
                "Sound: the model explains the record to within its noise, and data and regularization together determine every"
                f" parameter{_weak_words(identification)} (the data alone {rank} of {n_free} combinations)."
            )
            return Judgement("sound", words)
        words += f"{' other' if at_bound else ''} parameter{_weak_words(identification)}{f'; {at_bound}' if at_bound else ''}."
        if estimate.goodness.degrees_of_freedom < FEW_FREEDOMS:
            counted = estimate.goodness.n_values or estimate.goodness.n_data
            values, parameters = plural(counted, "value"), plural(len(estimate.names), "parameter")
            words += f" But {values} hardly test {parameters}: a wrong model may fit as well."
        return Judgement("sound", words)
    away = tuple(ran_away_words(estimate, index) for index in identification.ran_away)
    pushed = tuple(one.words for one in estimate.spread.at_bound if one.is_pushed)
    also = f" But {pushed[0]}." if pushed else ""
    misfit = _misfit_words(identification)
    cut = tuple(one.warning for one in identification.truncations if one.warning)
    if cut and not fits_noise(identification):
        return Judgement("wrong_model", f"Wrong model: {cut[0]}: do not use the values.", (*cut, misfit, *away))
    is_noise = bool(causes) and causes[0].kind == "noise_level"
    if is_noise and estimate.status is Status.CONVERGED and not away and not pushed:
        basis = estimate.covariance_basis
        words = f"Approximate: the model explains the record, but {causes[0].words}; {_INTERVALS[basis]}."
        return Judgement("approximate", words, (causes[0].words,))
    if causes and not is_noise:
        best = causes[0]
        is_small = (
            best.share < MOST_OF_MISFIT
            and best.chi_square_per_dof < NOISE_TOLERANCE * identification.estimate.goodness.expected_per_dof
        )
        words = (
            f"Wrong model: do not use the values. {misfit[0].upper()}{misfit[1:]}, and one change removes"
            f" {'what goes beyond the noise' if is_small else f'{100 * best.share:.0f} % of it'}: {best.words}"
            + (
                f"; {best.moved[0].name} would move by {best.moves:.0f} standard deviations."
                if best.moves > TOLD_SHIFT
                else "."
            )
        )
        if best.chi_square_per_dof > NOT_THE_WHOLE * identification.estimate.goodness.expected_per_dof:
            words += f" It is not all: it leaves {_noise_ratio(best)} times the noise."
            words += _with_second(identification, causes)
        return Judgement("wrong_model", words, (misfit, *away, *pushed))
    off = [] if fits_noise(identification) or _is_within_tolerances(identification) else _off(identification)
    is_far = estimate.goodness.misfit > FAR_BEYOND
    moving = None if fits_noise(identification) else find_moving_change(suggestions)
    if moving is not None:
        change, shift = moving
        words = (
            f"Wrong model: {misfit}, and the change that lowers it most would move {shift.name} by {shift.distance:.2g} standard"
            f" deviations: {change.words}. It removes {100 * change.share:.0f} % and leaves"
            f" {_noise_ratio(change)} times the noise, so that it is not the cause, or not alone: do not use"
            f" the values.{also}"
        )
        return Judgement("wrong_model", words, (misfit, *off, *away, *pushed))
    if away:
        if estimate.status is Status.CONVERGED or off or is_far:
            words = f"Wrong model: {misfit}, and {away[0]}: do not use the values. {_searched(n_tried)}"
            return Judgement("wrong_model", words.rstrip(), (*away, *pushed, misfit))
        return Judgement(
            "undetermined",
            f"Undetermined: {away[0]}; {_status_beside_away(identification)}.",
            (*away, estimate.message),
        )
    if estimate.status is Status.NOT_IDENTIFIABLE and not off and is_far:
        words = f"Wrong model: {misfit}, and the data do not determine every parameter: do not use the values. {_searched(n_tried)}"
        return Judgement("wrong_model", words.rstrip(), (misfit, estimate.message, *pushed))
    if estimate.status is Status.NOT_IDENTIFIABLE and not off:
        return Judgement("undetermined", f"Undetermined: {estimate.status_words}.", (estimate.message, *pushed))
    is_like_noise = fits_noise(identification) or estimate.goodness.misfit**2 < NOISE_TOLERANCE
    if pushed and is_like_noise and estimate.status is Status.CONVERGED:
        words = (
            f"Wrong model: the record contradicts a bound: {pushed[0]}. The other values depend on it: do not use them."
        )
        return Judgement("wrong_model", words, pushed)
    if fits_noise(identification):
        return Judgement(
            "undetermined", f"Undetermined: the search did not end ({estimate.message}).", (estimate.message,)
        )
    if off:
        words = f"Wrong model: {off[0]}: do not use the values. {_searched(n_tried)}{also}"
        return Judgement("wrong_model", words, (*off, *pushed))
    if estimate.status is not Status.CONVERGED and is_far:
        words = f"Wrong model: {misfit}, and the search did not end ({estimate.message}): do not use the values."
        return Judgement("wrong_model", words, (misfit, *pushed))
    if estimate.status is not Status.CONVERGED:
        return Judgement(
            "undetermined", f"Undetermined: {misfit}, and the search did not end ({estimate.message}).", (misfit,)
        )
    if any(one.is_far for one in identification.missed):
        words = f"Wrong model: {misfit}: one model does not fit all of the data, do not use the values. {_searched(n_tried)}{also}"
        return Judgement("wrong_model", words.rstrip(), (*(one.words for one in identification.missed), *pushed))
    disagreements = find_disagreements()
    if any(one.share > (GROSSLY_CONTRADICTING_PART if one.is_gross else CONTRADICTING_PART) for one in disagreements):
        disagreements = tuple(sorted(disagreements, key=lambda one: (not one.is_gross, -one.share)))
        words = f"Wrong model: parts of the data contradict each other: {_apart(disagreements[0])}. {_searched(n_tried)}{also}"
        return Judgement("wrong_model", words, (*(_apart(one) for one in disagreements), *pushed))
    if is_far and _is_large(identification):
        words = (
            f"Wrong model: {misfit}; resonances agree, and so do most values from parts of the data, but the error may shift"
            f" all values alike, beyond their intervals: do not use them. {_searched(n_tried)}{also}"
        )
        return Judgement("wrong_model", words.rstrip(), (misfit, *pushed, *map(_apart, disagreements)))
    words = (
        f"Approximate: {misfit}; that is more than the data show, and {_INTERVALS['noise']}."
        if _is_below_noise(identification)
        else f"Approximate: {misfit}; the intervals include the model error."
    )
    if disagreements:
        name = disagreements[0].name
        words += f" Do not rely on {name}, {_values_apart(disagreements[0])}: its model is wrong or varies."
    words += also
    if suggestions:
        first = suggestions[0]
        words += f" The misfit falls {100 * first.share:.0f} % if {first.words}"
        words += f"{_far_outside_words(identification, first)}."
    return Judgement("approximate", words, (misfit, *pushed, *map(_apart, disagreements)))


def _far_outside_words(identification: Identification, change: Cause) -> str:
    """End of a sentence on a change of the model that would move a parameter far outside its interval; "" if none moves so.

    "" too for a parameter that the data do not determine, which another part of the verdict says.
    """
    if not change.moves > TOLD_SHIFT:
        return ""
    estimate, name = identification.estimate, change.moved[0].name
    flags = zip(estimate.names, estimate.identified, estimate.spread.is_free, strict=True)
    is_lost = any(other == name and is_free and not is_identified for other, is_identified, is_free in flags)
    return "" if is_lost else f"; do not rely on {name}, which would then be far outside its interval"


def find_moving_change(changes: Sequence[Cause]) -> tuple[Cause, ParameterShift] | None:
    """First likely change that removes at least half of the misfit and moves a value that matters, and its shift.

    None if there is none. Likely are the first of `changes` and those that the data do not distinguish from it. A value
    matters if it moves by more than 2.2 standard deviations and 1 %. A change that removes less is covered by the
    intervals.
    """
    likely = [change for k, change in enumerate(changes) if k == 0 or change.is_alike]
    for change in (one for one in likely if one.share >= MOST_OF_MISFIT):
        shift = next((shift for shift in change.moved if _matters(shift)), None)
        if shift is not None:
            return change, shift
    return None


def _several(sets: Alternatives) -> Judgement:
    """The verdict where several sets of values fit equally well: "untested" if priors choose one, else "undetermined"."""
    if sets.chosen_by_priors:
        return Judgement("untested", f"Untested: {sets.words}.", (sets.words, sets.search_words))
    return Judgement("undetermined", f"Undetermined: {sets.words}.", (sets.words, sets.search_words))


def _untested(identification: Identification) -> Judgement:
    """Verdict "untested", in words: too few data are left beyond the parameters, so that any model fits."""
    estimate, goodness = identification.estimate, identification.estimate.goodness
    parameters = plural(len(estimate.names), "parameter")
    size = f"{plural(goodness.n_values, 'value')} for" if goodness.n_values else "no more values than"
    prior_words, by_priors = "", _by_priors(identification)
    if by_priors:
        prior_words = (
            f"; priors, not the data, determine {join_words(by_priors, 4)}{_open_combinations(identification)}"
        )
    elif np.isfinite(identification.priors.std).any():
        prior_words = "; priors choose among the values that fit"
    words = f"Untested: the data are {size} {parameters}{prior_words}, and a wrong model fits as well."
    return Judgement("untested", words, (estimate.message,))


def _open_combinations(identification: Identification) -> str:
    """Words in brackets on how many combinations of parameters the data determine; "" if all are determined."""
    rank, n_free = identification.estimate.identifiability.rank, identification.estimate.identifiability.n_free
    return f" (the data determine {rank} of {n_free} combinations)" if rank < n_free else ""


def _status_beside_away(identification: Identification) -> str:
    """Status of the estimate in words; without remedy if all that is undetermined are stiffnesses gone to zero."""
    estimate = identification.estimate
    lost = {*np.flatnonzero(~estimate.identified & estimate.spread.is_free).tolist(), *identification.ran_away}
    is_all_gone = estimate.status is Status.NOT_IDENTIFIABLE and all(is_gone(estimate, index) for index in lost)
    return estimate.status_words.partition("; ")[0] if is_all_gone else estimate.status_words


def _by_priors(identification: Identification) -> list[str]:
    """Names of the parameters that priors determine more than the data do."""
    return [identification.estimate.names[index] for index in identification.by_prior]


def _is_large(identification: Identification) -> bool:
    """True if the model misses a record by more than 2 % of its responses (root of summed squares), whatever the noise.

    For modes the limits are 2 % of a shape, sqrt(1 - MAC), and 0.2 % of a frequency.
    """
    measured = [(fit.judged.record.values, fit.judged.final) for fit in identification.fits]
    of_frfs = [
        bool(np.linalg.norm(of_model - of_record) > LARGE_ERROR * np.linalg.norm(of_record))
        for of_record, of_model in measured
    ]
    of_modes = [
        bool(np.abs(fit.fitted.frequency / fit.problem.data.frequency - 1).max() > LARGE_ERROR / 10)
        or bool(np.sqrt(1 - np.nan_to_num(fit.fitted.mac, nan=1.0)).max() > LARGE_ERROR)
        for fit in identification.modal_fits
    ]
    return any((*of_frfs, *of_modes))


def not_found(identification: Identification, reached: float) -> Judgement:
    """The verdict "undetermined" where another start explains the record with other values.

    `reached` is the chi-square per degree of freedom at those values.
    """
    words = (
        f"Undetermined: the search ended in a wrong place (chi-square per degree of freedom"
        f" {identification.estimate.chi_square_per_dof:.3g}), and another start reaches {reached:.3g}: do not use the values;"
        ' allow more `max_iterations` or `restarts`, or write start = "continuation" in [method].'
    )
    return Judgement("undetermined", words, (identification.estimate.message,))


def _misfit_words(identification: Identification) -> str:
    """Clause on the misfit: the missed part of the data, the fixed value that is off, or a comparison with noise.

    The first that applies is stated: a missed record or kind of values if it is far off or the whole fits the noise;
    the fixed value that is farthest off in tolerances only where the misfit (root of chi-square per degree of freedom)
    is below 1.1. The comparison is this root, in times the noise, except where the misfit is like noise in size.
    """
    if identification.missed and (identification.missed[0].is_far or noise_ratio(identification) == 1.0):
        return identification.missed[0].words
    size = float(np.sqrt(identification.estimate.goodness.least_per_dof))
    fixed = identification.estimate.fixed
    if fixed is not None and fixed.beyond and size < SHOWN_RATIO:
        i = fixed.beyond[0]
        change = 100 * np.expm1(fixed.asked[i] * fixed.tolerance[i])
        return (
            f"the record prefers {fixed.names[i]}, fixed in the model, {change:+.2g} % away, {abs(fixed.asked[i]):.2g} times"
            " its tolerance"
        )
    noises = {problem.facts.noise for problem in identification.problems}
    noise = noises.pop() if len(noises) == 1 else "the noise of the records"
    if _is_below_noise(identification):
        return f"the model explains the record to within {size:.2g} times {noise}"
    if fits_noise(identification):
        return f"the misfit is no larger than {noise} may make it"
    if size < SHOWN_RATIO:
        return f"the misfit is as large as {noise}, but has an order that noise has not"
    return f"the misfit is {f'{size:.2g}' if size < 100 else f'{size:.0f}'} times {noise}"


def _is_below_noise(identification: Identification) -> bool:
    """True if what the model misses is less than the noise that is stated."""
    return not identification.missed and identification.estimate.goodness.least_per_dof <= 1 / SHOWN_RATIO**2


def _searched(n_tried: int) -> str:
    return f"None of {n_tried} single changes of model and record explains it." if n_tried else ""


def _apart(one: Disagreement) -> str:
    """Clause on a parameter whose values from two parts of the data do not agree."""
    return f"{one.name} is {_values_apart(one)} ({one.distance:.0f} standard deviations apart)"


def _values_apart(one: Disagreement) -> str:
    """The two values of a disagreement with their parts of the data, as in "19 below 51.5 Hz and 101 kN/m above 51.5 Hz"."""
    factor, unit = prefixed(one.unit, *one.values)
    first, second = (exact(value / factor, 3) for value in one.values)
    return f"{first} {one.parts[0]} and {with_unit(second, unit)} {one.parts[1]}"


def _with_second(identification: Identification, causes: Sequence[Cause]) -> str:
    """A sentence on the second cause, with a leading blank, where both leave no more than noise; "" otherwise."""
    second = _completing(causes, identification.estimate.goodness.expected_per_dof)
    return "" if second is None else f" With a second change, noise explains the rest: {second.words}."


def _off(identification: Identification) -> list[str]:
    """Clauses on the resonances that the model misses: records of FRFs, then of modes, in each the farthest first."""
    of_modes = [_off_modes(fit) for fit in identification.modal_fits]
    far = [*(_off_resonances(fit) for fit in identification.fits), *of_modes]
    return [words for misses in far for _, words in sorted(misses, key=lambda pair: -pair[0])]


def _off_modes(fit: ModalFit) -> list[tuple[float, str]]:
    """Measured modes that the model misses, as (distance in half-power half-widths, clause).

    A mode is missed if its frequency is off by more than its half-width and by more than five standard deviations.
    """
    data, pairs = fit.problem.data, fit.fitted
    damping = np.maximum(np.nan_to_num(fit.measured.damping_ratio[data.measured]), LEAST_DAMPING)
    off = pairs.frequency - data.frequency
    distance = np.abs(off) / (damping * data.frequency)
    is_off = (distance > HALF_BANDWIDTHS_OFF) & fit.is_far_off
    return [_missed(data.frequency[i], pairs.frequency[i], distance[i]) for i in np.flatnonzero(is_off)]


def _missed(measured: float, predicted: float, distance: float) -> tuple[float, str]:
    """`distance`, and a clause on a resonance that the model misses by it, in half widths of the resonance.

    `measured` and `predicted` are its frequencies in Hz.
    """
    part = percent(abs(predicted / measured - 1), 2, signed=False)
    words = (
        f"the model misses the resonance at {measured:.4g} Hz by {part}, {distance:.1f} times half its resonance width"
    )
    return float(distance), words


def _off_resonances(fit: RecordFit) -> list[tuple[float, str]]:
    """FRF resonances that the model misses by more than a half-power half-width, as (distance in half-widths, clause).

    The distance is infinite where the model has no resonance near. A half-width is at least one line spacing. Only
    those count about which (3 half-widths) the mean square of the whitened residual is 4 or more.
    """
    missed, frequency = [], fit.problem.frequency
    of_line = misfit_of_lines(fit.problem, fit.problem.data_rows(fit.predicted))
    spacing = float(np.median(np.diff(np.unique(frequency)))) if len(frequency) > 1 else 0.0
    for peak in fit.resonances:
        near = int(np.argmin(np.abs(fit.modes.frequency - peak.measured))) if len(fit.modes.frequency) else -1
        damping = max(float(fit.modes.damping_ratio[near]), LEAST_DAMPING) if near >= 0 else LEAST_DAMPING
        half = max(damping * peak.measured, spacing)
        about = np.abs(frequency - peak.measured) <= 3 * half
        if not about.any() or of_line[about].mean() < LOCAL_MISFIT:
            continue
        predicted = peak.predicted
        if (
            not np.isfinite(predicted)
            and near >= 0
            and abs(fit.modes.frequency[near] - peak.measured) <= HALF_BANDWIDTHS_OFF * half
        ):
            predicted = float(fit.modes.frequency[near])  # narrower than the lines: no peak of the model on them
        distance = abs(predicted - peak.measured) / half
        if not np.isfinite(distance):
            missed.append((np.inf, f"the model has no resonance near {peak.measured:.4g} Hz"))
        elif distance > HALF_BANDWIDTHS_OFF:
            missed.append(_missed(peak.measured, predicted, distance))
    return missed

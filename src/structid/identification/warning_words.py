"""Warnings of an identification, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.display import join_words
from structid.forward import RecordProblem
from structid.identification.joint_problem import first_values
from structid.inversion import Estimate, Status
from structid.inversion.search.within_tolerances import RUNAWAY_FACTOR
from structid.unknowns.named_unknowns import DAMPING, MAY_VANISH

#: What warnings say of a value whose interval reaches 0, and of standard deviations that are larger than those of noise.
MAY_BE_ZERO = "is not significantly different from 0"
OTHER_MINIMA = "searches ended at this minimum"
INCLUDES_MODEL_ERROR = "standard deviations include the model error"


def _scale_warnings(estimate: Estimate) -> list[str]:
    """List with a warning if an unknown gain leaves the absolute size of masses or stiffnesses undetermined; else empty."""
    kinds = np.array(estimate.kinds)
    for direction in estimate.identifiability.directions:
        part = np.abs(direction.vector) > 0.1 * np.abs(direction.vector).max()
        gains = [name for name, taken in zip(estimate.names, part & (kinds == "gain"), strict=True) if taken]
        if gains and {"mass", "stiffness"} & set(kinds[part]):
            return [
                f"absolute masses and stiffnesses are not measured while {' and '.join(gains)} is unknown: the data give"
                " only their ratios, and their size rests on priors alone; a known mass or a calibrated channel fixes it"
            ]
    return []


def unidentified_warnings(estimate: Estimate) -> list[str]:
    """Warnings about parameters that are not identified, one for each; a single one for a matrix-free search.

    Parameters at a bound are left out; the list is empty if all others are identified.
    """
    lost = np.flatnonzero(~estimate.identified & estimate.spread.is_free)
    if not estimate.uncertainty.has_matrix:
        words = (
            f"{len(lost)} of {len(estimate.names)} parameters are not identified: their standard deviations are larger than"
            f" their values or not known: {join_words([estimate.names[i] for i in lost], 4)}"
        )
        return [words] if lost.size else []
    where = ["at the initial values " if estimate.std[i] <= abs(estimate.values[i]) else "" for i in lost]
    return [
        f"{estimate.names[i]} is not identified: {when}its standard deviation is larger than its value"
        for i, when in zip(lost, where, strict=True)
    ]


def unused_damping(
    problems: Sequence[RecordProblem], names: Sequence[str], kinds: Sequence[str], is_determined: np.ndarray
) -> list[str]:
    """List with a warning if dampings are undetermined although measured damping ratios are not used; else empty.

    `names`, `kinds` and the mask `is_determined` are those of all parameters.
    """
    open_ones = np.flatnonzero(~is_determined & np.isin(kinds, DAMPING)).tolist()
    if not open_ones or not any(problem.facts.leaves_damping_out for problem in problems):
        return []
    return [
        f"damping is not determined ({join_words([names[i] for i in open_ones], 3)}), and the measured damping ratios are not used:"
        " write `use_damping = true` in"
        " [record.modes]"
    ]


def estimate_warnings(estimate: Estimate) -> tuple[str, ...]:
    """Warnings about an estimate, the most important first.

    They are on a search that did not converge, bounds, undetermined directions, an unknown scale, parameters that are
    not identified or may be 0, residual tests, other minima, and model error.
    """
    warnings = []
    if estimate.status is not Status.CONVERGED:
        warnings.append(f"{estimate.status_words} ({estimate.message})")
    warnings.extend(bound.words for bound in sorted(estimate.spread.at_bound, key=lambda bound: -bound.push))
    warnings.extend(f"the data determine {direction.words}" for direction in estimate.identifiability.directions)
    warnings.extend(_scale_warnings(estimate))
    warnings.extend(unidentified_warnings(estimate))
    absent = estimate.may_be_absent()
    for i in np.flatnonzero(absent & estimate.spread.is_free).tolist():
        unit = "" if estimate.units[i] == "1" else f" {estimate.units[i]}"
        warnings.append(
            f"{estimate.names[i]} {MAY_BE_ZERO} (95 % interval up to {estimate.interval()[i, 1]:.2g}{unit})"
        )
    tests = () if estimate.goodness.residual_tests is None else estimate.goodness.residual_tests.words
    too_large = [w for w in tests if "larger than the noise allows" in w]  # told below, with what is done about it
    warnings.extend(w for w in tests if w not in too_large)
    is_open = (
        estimate.search.n_fitting < 2
        and estimate.search.n_starts > 1
        and estimate.search.n_agreeing < estimate.search.n_starts
    )
    if is_open and not estimate.search.is_exhaustive:
        warnings.append(
            f"{estimate.search.n_agreeing} of {estimate.search.n_starts} {OTHER_MINIMA}, the others at worse ones:"
            " there may be a better one still; start closer, or try more `restarts`"
        )
    if estimate.spread.disagreement is not None:
        warnings.append(f"{estimate.spread.disagreement.words}: {INCLUDES_MODEL_ERROR}, each mode left out in turn")
    if estimate.covariance_basis == "model_error" and (too_large or estimate.spread.disagreement is None):
        warnings.append(
            f"the model does not fit to within the noise ({estimate.goodness.misfit_words}, residual correlated over"
            f" {estimate.goodness.residual_correlation:.0f} lines): {INCLUDES_MODEL_ERROR}"
        )
    return tuple(warnings)


def ran_away(estimate: Estimate, problems: Sequence[RecordProblem]) -> tuple[int, ...]:
    """Indices of positive parameters without prior that ended a factor of 1000 or more from their start.

    Parameters that are identified in a fit to within the noise do not count, nor do dampings that go to 0.
    """
    has_prior = first_values(estimate.names, problems, lambda part: part.priors.stated)
    positive = first_values(
        estimate.names, problems, lambda part: np.array(part.transforms.kinds, dtype=object) == "log"
    )
    unsure = ~estimate.identified | (estimate.covariance_basis == "model_error")
    candidates = positive.astype(bool) & ~has_prior.astype(bool) & unsure & (estimate.initial > 0)
    ratio = np.divide(estimate.values, estimate.initial, out=np.ones(len(candidates)), where=candidates)
    absent = np.isin(estimate.kinds, MAY_VANISH)
    far = (ratio >= RUNAWAY_FACTOR) | ((ratio <= 1 / RUNAWAY_FACTOR) & ~absent)
    return tuple(np.flatnonzero(candidates & far).tolist())


def ran_away_words(estimate: Estimate, index: int) -> str:
    """A clause that says which parameter (at `index`, from 0) ran away, from where and to where.

    A stiffness that went to 0 has words of its own.
    """
    unit = "" if estimate.units[index] == "1" else f" {estimate.units[index]}"
    moved = f"from {estimate.initial[index]:.3g} to {estimate.values[index]:.3g}{unit}"
    if is_gone(estimate, index):
        return f"{estimate.names[index]} went to zero ({moved}): the record shows no stiffness there"
    return f"{estimate.names[index]} ran away ({moved}): not an answer"


def ran_away_warning(estimate: Estimate, index: int) -> str:
    """A warning that a parameter (at `index`) ran away, with the remedy."""
    return f"{ran_away_words(estimate, index)}; {ran_away_remedy(estimate, index)}"


def ran_away_remedy(estimate: Estimate, index: int) -> str:
    """Remedy for a parameter (at `index`) that ran away, a clause without a full stop."""
    if is_gone(estimate, index):
        return "take it out of the model (a hinge, a free end), or give it a prior"
    return "check what holds it, give it bounds or a prior, or fix it"


def is_gone(estimate: Estimate, index: int) -> bool:
    """True for the stiffness of a spring, support or joint, at `index`, that fell to a thousandth of its start and is not known.

    A value with a deviation smaller than itself is known, and only its start was too high. One that comes back with fixed
    values free within their tolerances went to zero for their errors alone. Factors of groups of matrices, which have no unit,
    are no springs.
    """
    is_stiffness = estimate.names[index].startswith("stiffness[") and estimate.units[index] != "1"
    is_known = 0 < estimate.std[index] < estimate.values[index]  # 0 for a value that is held at a bound
    limit = estimate.initial[index] / RUNAWAY_FACTOR
    is_gone_within_tolerances = estimate.fixed is None or bool(_value_within_tolerances(estimate, index) <= limit)
    return is_stiffness and not is_known and bool(estimate.values[index] <= limit) and is_gone_within_tolerances


def _value_within_tolerances(estimate: Estimate, index: int) -> float:
    """Value of the positive parameter at `index` where fixed values are free within their tolerances.

    It is the value of the estimate where noise explains its residual.
    """
    assert estimate.fixed is not None
    return float(estimate.values[index] * np.exp(estimate.fixed.theta[index] - estimate.theta[index]))

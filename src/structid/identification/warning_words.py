"""Warnings of an identification, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.display import join_words
from structid.forward import RecordProblem
from structid.identification.joint_problem import first_values
from structid.inversion import Estimate, Status
from structid.unknowns.named_unknowns import DAMPING, MAY_VANISH

#: Times its start, or parts of it, from where on a value is no longer taken for an answer. Starts that were 50 times off
#: are found again, and what has no effect ends at the reach of the search, a million times the start.
_FAR = 1e3
#: What warnings say of a value whose interval reaches 0, and of standard deviations that are larger than those of noise.
MAY_BE_ZERO = "is not significantly different from 0"
OTHER_MINIMA = "searches ended at this minimum"
INCLUDES_MODEL_ERROR = "standard deviations include the model error"


def _scale_warnings(found: Estimate) -> list[str]:
    """A warning where an unknown gain leaves the absolute size of masses and stiffnesses open; none otherwise."""
    kinds = np.array(found.kinds)
    for direction in found.identifiability.directions:
        part = np.abs(direction.vector) > 0.1 * np.abs(direction.vector).max()
        gains = [name for name, taken in zip(found.names, part & (kinds == "gain"), strict=True) if taken]
        if gains and {"mass", "stiffness"} & set(kinds[part]):
            return [
                f"absolute masses and stiffnesses are not measured while {' and '.join(gains)} is unknown: the data give"
                " only their ratios, and their size rests on priors alone; a known mass or a calibrated channel fixes it"
            ]
    return []


def unidentified_warnings(found: Estimate) -> list[str]:
    """Warnings about parameters that are not identified, one for each, or one for all of a matrix-free search."""
    lost = np.flatnonzero(~found.identified & found.spread.is_free)
    if not found.uncertainty.has_matrix:
        words = (
            f"{len(lost)} of {len(found.names)} parameters are not identified: their standard deviations are larger than"
            f" their values or not known: {join_words([found.names[i] for i in lost], 4)}"
        )
        return [words] if lost.size else []
    where = ["at the initial values " if found.std[i] <= abs(found.values[i]) else "" for i in lost]
    return [
        f"{found.names[i]} is not identified: {at}its standard deviation is larger than its value"
        for i, at in zip(lost, where, strict=True)
    ]


def unused_damping(
    problems: Sequence[RecordProblem], names: Sequence[str], kinds: Sequence[str], is_determined: np.ndarray
) -> list[str]:
    """A warning that measured damping ratios are not used, where dampings are not determined; none otherwise."""
    open_ones = np.flatnonzero(~is_determined & np.isin(kinds, DAMPING)).tolist()
    if not open_ones or not any(problem.facts.leaves_damping_out for problem in problems):
        return []
    return [
        f"damping is not determined ({join_words([names[i] for i in open_ones], 3)}), and the measured damping ratios are not used:"
        " write `use_damping = true` in"
        " [record.modes]"
    ]


def estimate_warnings(found: Estimate) -> tuple[str, ...]:
    """Warnings about an estimate, the most important first."""
    warnings = []
    if found.status is not Status.CONVERGED:
        warnings.append(f"{found.status_words} ({found.message})")
    warnings.extend(one.words for one in sorted(found.spread.at_bound, key=lambda one: -one.push))
    warnings.extend(f"the data determine {direction.words}" for direction in found.identifiability.directions)
    warnings.extend(_scale_warnings(found))
    warnings.extend(unidentified_warnings(found))
    absent = found.may_be_absent()
    for i in np.flatnonzero(absent & found.spread.is_free).tolist():
        unit = "" if found.units[i] == "1" else f" {found.units[i]}"
        warnings.append(f"{found.names[i]} {MAY_BE_ZERO} (95 % interval up to {found.interval()[i, 1]:.2g}{unit})")
    tests = () if found.goodness.residual_tests is None else found.goodness.residual_tests.words
    too_large = [w for w in tests if "larger than the noise allows" in w]  # told below, with what is done about it
    warnings.extend(w for w in tests if w not in too_large)
    is_open = (
        found.search.n_fitting < 2 and found.search.n_starts > 1 and found.search.n_agreeing < found.search.n_starts
    )
    if is_open and not found.search.is_exhaustive:
        warnings.append(
            f"{found.search.n_agreeing} of {found.search.n_starts} {OTHER_MINIMA}, the others at worse ones:"
            " there may be a better one still; start closer, or try more `restarts`"
        )
    if found.spread.disagreement is not None:
        warnings.append(f"{found.spread.disagreement.words}: {INCLUDES_MODEL_ERROR}, each mode left out in turn")
    if found.covariance_basis == "model_error" and (too_large or found.spread.disagreement is None):
        warnings.append(
            f"the model does not fit to within the noise ({found.goodness.misfit_words}, residual correlated over"
            f" {found.goodness.residual_correlation:.0f} lines): {INCLUDES_MODEL_ERROR}"
        )
    return tuple(warnings)


def ran_away(found: Estimate, problems: Sequence[RecordProblem]) -> tuple[int, ...]:
    """Indices of positive parameters without prior that ended a factor of a thousand or more from their start.

    Those that the data determine in a fit to within the noise were only started far off, and a damping that goes to nothing
    is absent; these have not run away.
    """
    has_prior = first_values(found.names, problems, lambda part: part.priors.stated)
    positive = first_values(found.names, problems, lambda part: np.array(part.transforms.kinds, dtype=object) == "log")
    unsure = ~found.identified | (found.covariance_basis == "model_error")
    candidates = positive.astype(bool) & ~has_prior.astype(bool) & unsure & (found.initial > 0)
    ratio = np.divide(found.values, found.initial, out=np.ones(len(candidates)), where=candidates)
    absent = np.isin(found.kinds, MAY_VANISH)
    far = (ratio >= _FAR) | ((ratio <= 1 / _FAR) & ~absent)
    return tuple(np.flatnonzero(candidates & far).tolist())


def ran_away_words(found: Estimate, index: int) -> str:
    """A clause that says which parameter ran away, from where and to where."""
    unit = "" if found.units[index] == "1" else f" {found.units[index]}"
    return f"{found.names[index]} ran away (from {found.initial[index]:.3g} to {found.values[index]:.3g}{unit}): not an answer"

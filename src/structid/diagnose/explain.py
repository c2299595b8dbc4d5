"""The diagnosis of an identification: its verdict, and where that is not sound the changes that would explain why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from structid.core.display import as_sentence, plural
from structid.core.errors import InputError, StructidError
from structid.diagnose.causes.places import MOST_DOFS
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, doubted, is_clear
from structid.diagnose.freed_model import fixed_value_sensitivities
from structid.diagnose.model_averaging import intervals_of, widened
from structid.diagnose.modified_model import are_small, base_model
from structid.diagnose.refits import Fitted, ToleranceTest
from structid.diagnose.search import Explanation, requested_changes, search_causes, with_freed
from structid.diagnose.search_budget import UNLIMITED, SearchBudget, iteration_effort
from structid.diagnose.split_consistency import Disagreement
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.thresholds import (
    ALIKE,
    IDENTIFICATIONS,
    LARGE_MODEL_REFITS,
    MATTERS,
    MOST_ALIKE,
    MOST_FREED,
    SEARCH_EFFORT,
    STAGE_PART,
)
from structid.diagnose.verdict import (
    NOT_TRIED,
    Cause,
    Diagnosis,
    ParameterShift,
    are_causes,
    data_disagreements,
    fits_noise,
    is_sound,
    is_untested,
    judged,
    noise_ratio,
    not_found,
)
from structid.forward import FrfProblem
from structid.forward.frf.solvers.tabulated import NO_MATRICES
from structid.identification.identified import Identification
from structid.inversion.search.work import ALONE, Work

#: The verdict of an answer that is written while causes are still looked for.
_SEARCHING = "the search for causes had not ended when this was written"
_NO_MATRIX = "no change of model or record was tried: the search leaves no Jacobian to look for one with"
_FEW_FITTED = (
    f"of a model of more than {MOST_DOFS} degrees of freedom, {LARGE_MODEL_REFITS} likely changes are fitted at most"
)
_OF_RECORDS = "of a model as large as this, or with components, causes are looked for in the records alone"
_NO_PLACES = "causes were not looked for: frequencies without any shape show no place"


#: Gives the parts of the data that do not agree.
Parts = Callable[[], tuple[Disagreement, ...]]


@dataclass(frozen=True, eq=False)
class DiagnosedIdentification:
    """An identification with its diagnosis.

    Attributes
    ----------
    identification : Identification
        With intervals that hold whichever of the likely changes is the truth.
    diagnosis : Diagnosis
    fits : tuple of Fitted
        The fits behind its causes, in their order; a cause without a fit of its own has none.
    """

    identification: Identification
    diagnosis: Diagnosis
    fits: tuple[Fitted, ...] = ()


def budget_for_causes(identification: Identification) -> SearchBudget:
    """The default budget of a search for causes: in proportion to the effort of the identification, and some besides."""
    search, effort = identification.estimate.search, 0.0
    if identification.target is not None:
        effort = STAGE_PART * search.n_starts * search.n_iterations * iteration_effort(identification.target)
    return SearchBudget(IDENTIFICATIONS * effort + SEARCH_EFFORT)


def explain(identification: Identification, seconds: float | None = None) -> Diagnosis:
    """The verdict on an identification, and the changes of model or record that would explain its misfit.

    Parameters
    ----------
    identification : Identification
    seconds : float, optional
        Processor time of the search for causes; without a limit by default.

    Returns
    -------
    Diagnosis
        Printed, it begins with the verdict and lists the causes, the likeliest first.

    Raises
    ------
    InputError
        If `seconds` is not greater than 0, or the identification does not know its set-ups.
    """
    if seconds is not None and not seconds > 0:
        raise InputError(
            f"`seconds` must be greater than 0, got {seconds:g}; leave it out for a search without a limit"
        )
    if not identification.setups or identification.options is None:
        raise InputError("`identification` must be one of `identify` or `identify_together`, which keeps its set-ups")
    model = TestedModel(identification.setups, identification.options)
    budget = SearchBudget(seconds=np.inf if seconds is None else seconds)
    return diagnose(model, identification, explain=True, budget=budget).diagnosis


def diagnose(
    model: TestedModel,
    identification: Identification,
    explain: bool | None = None,
    work: Work = ALONE,
    budget: SearchBudget = UNLIMITED,
    before_search: Callable[[Diagnosis], None] | None = None,
) -> DiagnosedIdentification:
    """The diagnosis of an identification: its verdict, and where that is not sound the causes of the misfit.

    Parameters
    ----------
    model : TestedModel
    identification : Identification
        Its answer.
    explain : bool, optional
        Whether causes are looked for; by default where the answer is not sound.
    work : Work
        Where candidates are looked at and refitted.
    budget : SearchBudget
        What the search for causes may take from its beginning on; all is tried by default.
    before_search : callable, optional
        Takes the diagnosis as it is before causes are looked for, which may take long.
    """
    estimate = identification.estimate
    apart = cache(partial(data_disagreements, identification, work))  # the verdict is given before the search and after
    sensitivities: tuple[FixedValueSensitivity, ...] = ()
    if is_sound(identification):
        sensitivities = fixed_value_sensitivities(model, identification)
        if not explain and (explain is False or not is_clear(sensitivities)):
            return _diagnose_sound(model, identification, sensitivities, work, apart, is_asked=explain is None)
    if any(one.warning for one in identification.truncations) and not explain:
        return DiagnosedIdentification(identification, Diagnosis(judged(identification, apart=apart)))
    if is_untested(identification) and not explain:
        return DiagnosedIdentification(identification, Diagnosis(judged(identification, apart=apart)))
    ratio = noise_ratio(identification)
    if ratio is not None and ratio != 1.0 and not explain:
        causes = (_noise_level(estimate.goodness.least_per_dof, ratio),)
        return DiagnosedIdentification(identification, Diagnosis(judged(identification, causes, apart=apart), causes))
    if estimate.goodness.least_per_dof <= 1 and not identification.missed and not explain and not sensitivities:
        return DiagnosedIdentification(identification, Diagnosis(judged(identification, apart=apart)))
    why_not = _why_not_searched(model, identification, explain)
    if why_not:
        return _without_causes(identification, why_not, apart)
    if before_search is not None:
        before_search(_without_causes(identification, _SEARCHING, apart).diagnosis)
    try:
        explanation = search_causes(_base(model, identification), work, budget.portion(1.0))
    except (StructidError, np.linalg.LinAlgError, MemoryError) as error:
        return _without_causes(identification, f"causes could not be looked for: {error}", apart)
    if explanation.better is not None:
        reached = explanation.better.misfit / max(estimate.goodness.degrees_of_freedom, 1)
        return DiagnosedIdentification(identification, Diagnosis(not_found(identification, reached)))
    tests = estimate.goodness.residual_tests
    is_noise = tests is not None and not tests.words[1:] and bool(identification.modal_fits) and not sensitivities
    if not explanation.causes and is_noise:
        causes = (_noise_level(estimate.goodness.least_per_dof, float(np.sqrt(estimate.goodness.least_per_dof))),)
        judgement = judged(identification, causes, apart=apart)
        wider = widened(identification, explanation.likely, model.options.direction)
        return DiagnosedIdentification(wider, Diagnosis(judgement, causes, n_tried=explanation.tried))
    return _diagnose_explained(model, identification, explanation, sensitivities, apart)


def _why_not_searched(model: TestedModel, identification: Identification, explain: bool | None) -> str:
    """The reason why causes cannot be looked for, in words; "" where they can."""
    if explain is False:
        return NOT_TRIED
    if identification.target is None or not identification.estimate.uncertainty.has_matrix:
        return _NO_MATRIX
    if not model.setups[0].structure.has_matrices:
        return f"causes were not looked for: that {NO_MATRICES}"
    if any(role == "output" and not dofs for setup in model.setups for role, dofs in setup.channels):
        return _NO_PLACES
    return ""


def _base(model: TestedModel, identification: Identification) -> Fitted:
    """The answer as a fitted model without changes, with which a search for causes begins."""
    theta = identification.estimate.theta
    estimate = identification.estimate
    within = estimate.goodness.least_chi_square
    test = ToleranceTest(float(within), not fits_noise(identification)) if np.isfinite(within) else None
    modified = base_model(model, identification.problems, theta)
    return Fitted(modified, theta, estimate.goodness.chi_square, 0.0, test)


def _diagnose_sound(
    model: TestedModel,
    identification: Identification,
    sensitivities: tuple[FixedValueSensitivity, ...],
    work: Work,
    apart: Parts,
    is_asked: bool,
) -> DiagnosedIdentification:
    """The diagnosis of a sound answer, with fixed values or one change fitted where the record asks for them."""
    doubts = doubted(sensitivities)[:MOST_FREED]
    if doubts:
        try:
            names = [one.name for one in doubts]
            explanation = with_freed(_base(model, identification), names, len(sensitivities), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            why = f"it could not be fitted with what it holds set free: {error}"
            return _without_causes(identification, why, apart, sensitivities)
        return _diagnose_explained(model, identification, explanation, sensitivities, apart, is_search=False)
    if is_asked and _can_be_asked(model, identification):
        try:
            explanation = requested_changes(_base(model, identification), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            why = f"it could not be held against single changes: {error}"
            return _without_causes(identification, why, apart, sensitivities)
        shifts = [one for fit in explanation.causes for one in _shifts(identification, explanation.base, fit)]
        if any(one.distance > MATTERS for one in shifts):
            return _diagnose_explained(model, identification, explanation, sensitivities, apart, is_search=False)
    diagnosis = Diagnosis(judged(identification), sensitivities=sensitivities)
    return DiagnosedIdentification(identification, diagnosis)


def _can_be_asked(model: TestedModel, identification: Identification) -> bool:
    """True where a first-order test of all single changes is quick: small models, FRFs, and a known Jacobian."""
    are_frfs = all(isinstance(problem, FrfProblem) for problem in identification.problems)
    is_whole = identification.target is not None and identification.estimate.uncertainty.has_matrix
    return are_small(model.setups) and are_frfs and is_whole and model.setups[0].structure.has_matrices


def _diagnose_explained(
    model: TestedModel,
    identification: Identification,
    explanation: Explanation,
    sensitivities: tuple[FixedValueSensitivity, ...],
    apart: Parts,
    is_search: bool = True,
) -> DiagnosedIdentification:
    """The diagnosis with a search's results; without `is_search` its changes are no causes."""
    estimate = identification.estimate
    is_doubted = bool(doubted(sensitivities))
    likely = explanation.likely if is_doubted or not is_sound(identification) or not is_search else ()
    ranked = _ranked(explanation)
    made = tuple(_cause(identification, explanation, fit, is_alike) for fit, is_alike in ranked)
    made = (*made[:1], *(_friction_like(made[0]) if made else ()), *made[1:])
    is_hidden = bool(identification.missed)
    is_accepted = is_search and are_causes(
        made, estimate.goodness.least_per_dof, estimate.goodness.expected_per_dof, is_hidden
    )  # fmt: skip
    accepted, lowering = (made, made[:0]) if is_accepted else (made[:0], made)
    is_asked = not is_search and not is_doubted
    judgement = judged(
        identification, accepted, explanation.tried, lowering, held=sensitivities, is_asked=is_asked, apart=apart
    )
    wider = widened(identification, likely, model.options.direction)
    if judgement.verdict == "approximate":
        sensitivities = fixed_value_sensitivities(model, wider)
    unfinished = unfinished_words(explanation)
    judgement = replace(judgement, reasons=(*judgement.reasons, *unfinished))
    if judgement.verdict == "wrong_model" and not accepted:
        # "none of 587 changes explains it" is half of the truth where likely ones were not fitted
        judgement = replace(judgement, words=" ".join([judgement.words, *map(as_sentence, unfinished)]))
    is_used = judgement.verdict in ("sound", "approximate")
    shown = sensitivities if is_used else ()
    diagnosis = Diagnosis(judgement, accepted, lowering, explanation.tried, shown)
    return DiagnosedIdentification(wider, diagnosis, tuple(fit for fit, _ in ranked))


def unfinished_words(explanation: Explanation) -> tuple[str, ...]:
    """Sentences on causes that were not looked for for want of time, and how to go on."""
    modified = explanation.base.modified
    if modified.is_large:
        return (_FEW_FITTED if modified.has_places else _OF_RECORDS,)
    parts = [explanation, *([] if explanation.further is None else [explanation.further])]
    left_out = sum(part.left_out for part in parts)
    words = [f"{plural(left_out, 'likely change')} not tried"] * (left_out > 0)
    words += ["other pairs of causes not tried"] * explanation.is_single
    return (f"the search for causes ended at its limit, {' and '.join(words)}: `structid explain` goes on",) * bool(
        words
    )


def _without_causes(
    identification: Identification, why: str, apart: Parts, sensitivities: tuple[FixedValueSensitivity, ...] = ()
) -> DiagnosedIdentification:
    judgement = judged(identification, untried=why, held=sensitivities, apart=apart)
    return DiagnosedIdentification(identification, Diagnosis(judgement, sensitivities=sensitivities))


def _friction_like(cause: Cause) -> tuple[Cause, ...]:
    """Friction at the place of a damper to the ground, which the record cannot distinguish; none for other causes."""
    if cause.kind != "dashpot" or len(cause.where) > 1:
        return ()
    words = f"something rubs at {cause.where[0]}: one level of the force cannot distinguish it from a damper"
    return (replace(cause, kind="friction", words=words, is_alike=True, has_fit=False),)


def _noise_level(chi_square: float, ratio: float) -> Cause:
    words = f"the noise is not what it was taken for; it is {ratio:.3g} times that"
    share = 1.0 - 1 / chi_square if chi_square > 1 else 0.0
    return Cause("noise_level", ("all records",), words, share, 1.0, has_fit=False)


def _ranked(explanation: Explanation) -> list[tuple[Fitted, bool]]:
    """Fitted changes in the order of the report, each with whether it cannot be distinguished from the likeliest."""
    marked = [
        (one, criterion - explanation.criteria[0] < ALIKE)
        for one, criterion in zip(explanation.causes, explanation.criteria, strict=True)
    ]
    first = [pair for pair in marked if pair[1]][:MOST_ALIKE]
    others = [pair for pair in marked if not pair[1]]
    further = explanation.further
    second = [] if further is None else [(one, False) for one in further.causes[:MOST_ALIKE]]
    return [*first[:2], *second[:2], *first[2:], *others][: max(MOST_ALIKE, len(first) + len(second[:2]))]


def _cause(identification: Identification, explanation: Explanation, fit: Fitted, is_alike: bool) -> Cause:
    """A fitted change as a cause for the report, with its share of the misfit and the values that it moves."""
    base, before, after, target = explanation.base, explanation.base.values, fit.values, fit.modified.target
    candidate = fit.cause
    added = tuple(
        (name, after[name], unit)
        for name, unit in zip(target.names, target.unknowns.units, strict=True)
        if name not in before
    )
    first = base if len(fit.modified.changes) == 1 else explanation.causes[0]
    own = [value for name, value, _ in added if name not in first.values]
    value = own[0] if own and not candidate.leaves_data_out else None
    if value is None and candidate.other_strengths:
        value = fit.modified.changes[-1].strength
    return Cause(
        kind=candidate.named_kind(value),
        where=candidate.places,
        words=candidate.sentence(value),
        share=max(0.0, 1 - fit.misfit / first.misfit, 1 - fit.chi_square / first.chi_square),
        chi_square_per_dof=fit.misfit / max(base.modified.target.n_data - len(target.names), 1),
        rest_per_dof=(fit.misfit - fit.left_out) / max(target.n_data - len(target.names), 1),
        found=added,
        moved=_shifts(identification, base, fit),
        is_alike=is_alike,
        is_second=len(fit.modified.changes) > 1,
        leaves_noise=not fit.is_misfit,
        leaves_data_out=candidate.leaves_data_out,
    )


def _shifts(identification: Identification, base: Fitted, fit: Fitted) -> tuple[ParameterShift, ...]:
    """Parameters of the answer with their values before and after a change, the farthest moved first."""
    estimate, target = identification.estimate, fit.modified.target
    before, after, ends = base.values, fit.values, intervals_of(fit, identification.intervals.level)
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    shifts = (
        ParameterShift(
            name, unit, before[name], after[name], ends[name], _distance(after[name] - before[name], std[name])
        )
        for name, unit in zip(target.names, target.unknowns.units, strict=True)
        if name in before
    )
    return tuple(sorted(shifts, key=lambda one: -one.distance))


def _distance(change: float, std: float) -> float:
    return abs(change) / std if np.isfinite(std) and std > 0 else 0.0

"""Diagnoses for which changes of model or record are fitted: the search for causes, and changes that a sound answer asks for.

The model with all of its fixed values free at once says how sensitive an answer is to them. Intervals are widened so that they hold
whichever of the likely changes is the truth (model averaging).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.core.display import as_sentence, join_words, plural
from structid.core.errors import StructidError
from structid.diagnose.causes.candidate import MOST_DOFS
from structid.diagnose.causes.fixed_value import FixedValue, fixed_values
from structid.diagnose.diagnosis import DiagnosedIdentification, SplitCheck, noise_level, without_causes
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, doubted, influences
from structid.diagnose.modified_model import are_small, base_model, prepared_problems, started_at, weighed_like
from structid.diagnose.refits import FittedModel, ToleranceTest
from structid.diagnose.search import Explanation, requested_changes, search_causes, with_freed
from structid.diagnose.search_budget import SearchBudget
from structid.diagnose.tested_model import ModelDraft, TestedModel
from structid.diagnose.thresholds import ALIKE, LARGE_MODEL_REFITS, MATTERS, MOST_ALIKE, MOST_FREED
from structid.diagnose.verdict import (
    Cause,
    Diagnosis,
    ParameterShift,
    are_causes,
    fits_noise,
    is_sound,
    judged,
    not_found,
)
from structid.forward import FrfProblem
from structid.forward.scatter import scatter_problems
from structid.identification.identified import Identification
from structid.identification.identify import total_mass
from structid.identification.joint_problem import joint_problem
from structid.identification.warning_words import estimate_warnings
from structid.inversion import Problem
from structid.inversion.estimate import normal_intervals
from structid.inversion.search.work import TaskExecutor
from structid.inversion.uncertainty import DenseCovariance, relative_steps

#: All fixed stiffnesses by one factor, and the part of the clearness of another fixed value at which they are as clear.
_EVERY, _EQUAL = "every fixed stiffness", 1e-6


def fixed_value_sensitivities(model: TestedModel, identification: Identification) -> tuple[FixedValueSensitivity, ...]:
    """Sensitivity of an answer to every fixed mass and stiffness, by linearization with all of them free.

    Parameters
    ----------
    model : TestedModel
        Set-ups and options of the identification.
    identification : Identification
        The answer.

    Returns
    -------
    tuple of FixedValueSensitivity
        In the order of the properties. Empty for models of more than 1200 degrees of freedom or without matrices, for
        searches without a Jacobian, and if nothing is fixed. Values that cannot be freed, and those that the data do
        not see, are left out. The standard deviation of the change that the record asks for is NaN where the residual
        is not noise.
    """
    setup, estimate = model.setups[0], identification.estimate
    is_small = setup.structure.n_dofs <= MOST_DOFS and identification.target is not None
    if not is_small or not estimate.uncertainty.has_matrix or not setup.structure.has_matrices:
        return ()
    fixed = fixed_values(setup.structure, setup.parameters)
    known = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    target = _free_fixed_values(model, identification, fixed, known)
    if target is None:  # what can be freed, one by one
        fixed = tuple(one for one in fixed if _free_fixed_values(model, identification, (one,), known) is not None)
        target = _free_fixed_values(model, identification, fixed, known)
    if target is None or not fixed:
        return ()
    theta = target.theta_start
    at = target.linearize(theta)
    index = {name: i for i, name in enumerate(target.names)}
    free = [name for name, is_free in zip(estimate.names, estimate.spread.is_free, strict=True) if is_free]
    names = [name for name in target.names if name not in known]
    columns = [index[name] for name in (*free, *names)]
    scale = 1.0 if fits_noise(identification) else np.nan  # what a wrong model pulls at says nothing of a fixed value
    sizes = target.unknowns.sizes(target.physical(theta))[[index[name] for name in estimate.names]]
    tolerances = {} if estimate.fixed is None else dict(
        zip(estimate.fixed.names, estimate.fixed.tolerance.tolist(), strict=True)
    )  # fmt: skip
    rows = (at.jacobian * relative_steps(target, theta))[:, columns]
    std = (estimate.std / sizes)[estimate.spread.is_free]
    several = tuple(
        replace(one, tolerance=tolerances.get(one.name, 0.0))
        for one in influences(rows, at.residual, free, names, std, scale)
    )
    kinds = dict(zip(target.names, target.unknowns.kinds, strict=True))
    is_stiffness = np.array([kinds[name] == "stiffness" for name in (*free, *names)])
    is_held = np.arange(len(columns)) >= len(free)
    sought, held = is_stiffness & ~is_held, is_stiffness & is_held
    if not (
        sought.any() and held.any() and all(one.facts.takes_clock_for_stiffness for one in identification.problems)
    ):
        return several
    together = np.column_stack([rows[:, ~is_held], rows[:, held].sum(axis=1)])
    return _marked(
        several,
        influences(together, at.residual, free, [_EVERY], std, scale),
        [names[i] for i in np.flatnonzero(held[is_held])],
    )


def _marked(
    several: tuple[FixedValueSensitivity, ...], together: tuple[FixedValueSensitivity, ...], stiffnesses: Sequence[str]
) -> tuple[FixedValueSensitivity, ...]:
    """Copy of `several` in which the clearest of the fixed `stiffnesses` gets the pull at all of them as `clock_pull`.

    `together` has the sensitivity to one factor on all of them, or is empty. The copy is plain where a single fixed
    value explains more than all together do, or no fixed stiffness has a known pull. The clearest has the largest pull
    in its standard deviations.
    """
    clear = [abs(one.pull / one.pull_std) for one in (*several, *together)]
    seen = [i for i, one in enumerate(several) if one.name in stiffnesses and np.isfinite(clear[i])]
    if not together or not seen or not clear[-1] >= (1 - _EQUAL) * np.nanmax(clear):
        return several
    first = max(seen, key=lambda i: clear[i])
    return tuple(replace(one, clock_pull=together[0].pull) if i == first else one for i, one in enumerate(several))


def _free_fixed_values(
    model: TestedModel, identification: Identification, fixed: Sequence[FixedValue], known: dict[str, float]
) -> Problem | None:
    """Joint problem with the values `fixed` among its unknowns, started at the answer; None if that fails.

    `known` has the identified values by parameter name.
    """
    draft = ModelDraft(model)
    try:
        for value in fixed:
            for edit in value.edits(model, 1.0):
                edit.apply(draft)
        freed = draft.build()
        before = list(zip(model.setups, identification.problems, strict=True))
        problems = prepared_problems(freed, before, model.options)
        problems = weighed_like(problems, identification.problems, scatter_problems(identification.problems))
        return joint_problem([started_at(one, known) for one in problems])
    except (StructidError, np.linalg.LinAlgError):
        return None  # some property has no place among the unknowns


IntervalsByName = dict[str, tuple[float, float]]


def intervals_of(fitted: FittedModel, level: float) -> IntervalsByName:
    """Normal intervals of the parameters of a fitted study at the probability `level`: (low, high) in SI units, by name."""
    std = np.sqrt(np.diag(fitted.covariance))
    ends = normal_intervals(fitted.parameters, std, fitted.identified, level)
    return dict(zip(fitted.parameters.names, ((low, high) for low, high in ends.tolist()), strict=True))


def widened(identification: Identification, likely: Sequence[FittedModel], direction: str | None) -> Identification:
    """Identification with intervals and standard deviations that cover likely changed models as well; values stay.

    Intervals are the union of those of all these models; the covariance is the mean over the models of covariance plus
    square of the distance from the identified values. A model where that is not finite is left out of the mean. Models
    have equal weight: with the misfits of wrong models, likelihood weights would favour one changed model alone, which
    need not be the right one. A parameter on which the models disagree by more than its value is not identified; notes
    and warnings say so, and the total mass has its wider deviation.

    Parameters
    ----------
    identification : Identification
    likely : sequence of FittedModel
        Fits of the likely changed models; without any, or a target problem, the identification is returned as it is.
    direction : str, optional
        Direction of the translation for which the total mass is computed, such as ``X``.

    References
    ----------
    Draper (1995), J. R. Stat. Soc. B 57, Eq. (11), with equal weights and about the answer's own values.
    """
    if not likely or identification.target is None:
        return identification
    estimate, own = identification.estimate, identification.intervals
    ends, covariance = own.ends.copy(), estimate.covariance_of_data
    squares = [covariance]
    for fitted in likely:
        place = {name: number for number, name in enumerate(fitted.modified.target.names)}
        here = np.array([number for number, name in enumerate(estimate.names) if name in place], dtype=np.intp)
        there = np.array([place[estimate.names[number]] for number in here], dtype=np.intp)
        change = np.array(list(fitted.values.values()))[there] - estimate.values[here]
        square = covariance.copy()
        square[np.ix_(here, here)] = fitted.covariance_of_data[np.ix_(there, there)] + np.outer(change, change)
        if np.isfinite(square).all():
            squares.append(square)
        others = np.array(list(intervals_of(fitted, own.level).values()))[there]
        ends[here] = np.stack([np.fmin(ends[here, 0], others[:, 0]), np.fmax(ends[here, 1], others[:, 1])], axis=1)
    many = "one change" if len(likely) == 1 else f"{len(likely)} changes"
    words = f"intervals and deviations hold with the model as it is and with {many} that would explain the misfit about as well"
    union = DenseCovariance(np.mean(squares, axis=0))
    known = estimate.identified & ~(union.std > identification.target.unknowns.sizes(estimate.values))
    lost = [
        name for name, before, now in zip(estimate.names, estimate.identified, known, strict=True) if before and not now
    ]
    notes = (
        (words, f"these disagree by more than the value about {join_words(lost)}: not identified") if lost else (words,)
    )
    wider = replace(
        estimate,
        spread=replace(estimate.spread, model_error=union, covariance_basis="model_error", identified=known),
    )
    before, now = estimate_warnings(estimate), estimate_warnings(wider)
    kept = [one for one in identification.warnings if one in now or one not in before]
    _, std = total_mass(
        identification.problems[0], wider, direction, identification.freed[0] if identification.freed else None
    )
    return replace(
        identification,
        estimate=wider,
        warnings=(*(one for one in now if one not in kept), *kept),
        intervals=replace(own, ends=ends, notes=(*own.notes, *notes)),
        mass=replace(identification.mass, std=std),
    )


_FEW_FITTED = (
    f"of a model of more than {MOST_DOFS} degrees of freedom, {LARGE_MODEL_REFITS} likely changes are fitted at most"
)
_OF_RECORDS = "of a model as large as this, or with components, causes are looked for in the records alone"


def diagnose_by_search(
    model: TestedModel,
    identification: Identification,
    sensitivities: tuple[FixedValueSensitivity, ...],
    work: TaskExecutor,
    budget: SearchBudget,
    find_disagreements: SplitCheck,
) -> DiagnosedIdentification:
    """Diagnosis of an answer after a search for the causes of its misfit within a budget of effort.

    `sensitivities` are those of the answer to fixed values, `work` runs the fits, and `find_disagreements` returns
    parts of the data whose fits disagree. Where the search fails, the diagnosis says so and has no causes; where it
    found a better fit of the unchanged model, it says that the identification missed it; where nothing explains a
    misfit of modes that is like noise but for its size, the noise level is the cause.
    """
    estimate = identification.estimate
    try:
        explanation = search_causes(_answer_as_model(model, identification), work, budget.portion(1.0))
    except (StructidError, np.linalg.LinAlgError, MemoryError) as error:
        return without_causes(identification, f"causes could not be looked for: {error}", find_disagreements)
    if explanation.better is not None:
        reached = explanation.better.misfit / max(estimate.goodness.degrees_of_freedom, 1)
        return DiagnosedIdentification(identification, Diagnosis(not_found(identification, reached)))
    tests = estimate.goodness.residual_tests
    is_noise = tests is not None and not tests.words[1:] and bool(identification.modal_fits) and not sensitivities
    if not explanation.causes and is_noise:
        causes = (noise_level(estimate.goodness.least_per_dof, float(np.sqrt(estimate.goodness.least_per_dof))),)
        judgement = judged(identification, causes, find_disagreements=find_disagreements)
        wider = widened(identification, explanation.likely, model.options.direction)
        return DiagnosedIdentification(wider, Diagnosis(judgement, causes, n_tried=explanation.tried))
    return _diagnose_explained(model, identification, explanation, sensitivities, find_disagreements)


def _answer_as_model(model: TestedModel, identification: Identification) -> FittedModel:
    """Answer of an identification as a `FittedModel` without changes, from which a search for causes starts.

    No fit is made for it. It has a test of the fit within tolerances where the identification made one.
    """
    theta = identification.estimate.theta
    estimate = identification.estimate
    within = estimate.goodness.least_chi_square
    test = ToleranceTest(float(within), not fits_noise(identification)) if np.isfinite(within) else None
    modified = base_model(model, identification.problems, theta)
    return FittedModel(modified, theta, estimate.goodness.chi_square, 0.0, test)


def diagnose_sound(
    model: TestedModel,
    identification: Identification,
    sensitivities: tuple[FixedValueSensitivity, ...],
    work: TaskExecutor,
    find_disagreements: SplitCheck,
    may_test_changes: bool,
) -> DiagnosedIdentification:
    """Diagnosis of a sound answer; doubted fixed values or single changes are fitted where the record asks for them.

    `sensitivities` are those of the answer to fixed values, `work` runs the fits, `find_disagreements` returns parts of
    the data whose fits disagree. At most three doubted fixed values are freed. Without doubts and with
    `may_test_changes` (False where the user asked for no search, or for all of it) single changes are tested; they
    count if they shift a parameter. A fit that fails gives a diagnosis without causes that says why.
    """
    doubts = doubted(sensitivities)[:MOST_FREED]
    if doubts:
        try:
            names = [one.name for one in doubts]
            explanation = with_freed(_answer_as_model(model, identification), names, len(sensitivities), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            why = f"it could not be fitted with its fixed values free: {error}"
            return without_causes(identification, why, find_disagreements, sensitivities)
        return _diagnose_explained(
            model, identification, explanation, sensitivities, find_disagreements, is_search=False
        )
    if may_test_changes and _can_be_asked(model, identification):
        try:
            explanation = requested_changes(_answer_as_model(model, identification), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            why = f"single changes could not be tested: {error}"
            return without_causes(identification, why, find_disagreements, sensitivities)
        shifts = [one for fit in explanation.causes for one in _shifts(identification, explanation.base, fit)]
        if any(one.distance > MATTERS for one in shifts):
            return _diagnose_explained(
                model, identification, explanation, sensitivities, find_disagreements, is_search=False
            )
    diagnosis = Diagnosis(judged(identification), sensitivities=sensitivities)
    return DiagnosedIdentification(identification, diagnosis)


def _can_be_asked(model: TestedModel, identification: Identification) -> bool:
    """True where a first-order test of all single changes is quick: small models, FRFs only, and a known Jacobian."""
    are_frfs = all(isinstance(problem, FrfProblem) for problem in identification.problems)
    is_whole = identification.target is not None and identification.estimate.uncertainty.has_matrix
    return are_small(model.setups) and are_frfs and is_whole and model.setups[0].structure.has_matrices


def _diagnose_explained(
    model: TestedModel,
    identification: Identification,
    explanation: Explanation,
    sensitivities: tuple[FixedValueSensitivity, ...],
    find_disagreements: SplitCheck,
    is_search: bool = True,
) -> DiagnosedIdentification:
    """The diagnosis of an answer from the fitted changes of an `explanation`, with intervals that cover the likely ones.

    With `is_search` False the changes count as suggestions, never as causes. `sensitivities` are those of the answer to
    fixed values, and are computed anew where the verdict is approximate; `find_disagreements` returns parts of the data
    whose fits disagree. The result also has the fits of the changes in the order of the report.
    """
    estimate = identification.estimate
    is_doubted = bool(doubted(sensitivities))
    likely = explanation.likely if is_doubted or not is_sound(identification) or not is_search else ()
    ranked = _rank_changes(explanation)
    made = tuple(_cause(identification, explanation, fit, is_alike) for fit, is_alike in ranked)
    made = (*made[:1], *(_friction_like(made[0]) if made else ()), *made[1:])
    is_hidden = bool(identification.missed)
    is_accepted = is_search and are_causes(
        made, estimate.goodness.least_per_dof, estimate.goodness.expected_per_dof, is_hidden
    )  # fmt: skip
    accepted, lowering = (made, made[:0]) if is_accepted else (made[:0], made)
    is_asked = not is_search and not is_doubted
    judgement = judged(
        identification,
        accepted,
        explanation.tried,
        lowering,
        sensitivities=sensitivities,
        is_asked=is_asked,
        find_disagreements=find_disagreements,
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
    """Sentence, in a tuple, on causes that were not tried for lack of time, and how to continue; empty if all were.

    `explanation` is that of the search. Of a model of more than 1200 degrees of freedom it says instead that only a few
    changes are fitted, or only those of the records.
    """
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


def _friction_like(cause: Cause) -> tuple[Cause, ...]:
    """Dry friction, as a tuple of one cause, that one force level cannot distinguish from a damper to the ground.

    Empty if `cause` is no damper, or one between two degrees of freedom.
    """
    if cause.kind != "dashpot" or len(cause.where) > 1:
        return ()
    words = f"something rubs at {cause.where[0]}: one level of the force cannot distinguish it from a damper"
    return (replace(cause, kind="friction", words=words, is_alike=True, has_fit=False),)


def _rank_changes(explanation: Explanation) -> list[tuple[FittedModel, bool]]:
    """Fitted changes in the order of the report, each with True if it cannot be distinguished from the likeliest.

    Such are those whose criterion is less than 6 above the least. First the two likeliest of them, then two changes in
    addition to the first cause, then the rest of at most four of them, then others. The list is cut at four entries, or
    after those that cannot be distinguished and two second changes if these are more. `explanation` has these changes
    with their criteria.
    """
    marked = [
        (one, criterion - explanation.criteria[0] < ALIKE)
        for one, criterion in zip(explanation.causes, explanation.criteria, strict=True)
    ]
    first = [pair for pair in marked if pair[1]][:MOST_ALIKE]
    others = [pair for pair in marked if not pair[1]]
    further = explanation.further
    second = [] if further is None else [(one, False) for one in further.causes[:MOST_ALIKE]]
    return [*first[:2], *second[:2], *first[2:], *others][: max(MOST_ALIKE, len(first) + len(second[:2]))]


def _cause(identification: Identification, explanation: Explanation, fit: FittedModel, is_alike: bool) -> Cause:
    """Fitted change as a cause for the report, with the part of the misfit that it removes and the values it shifts.

    `is_alike` says that the data cannot distinguish it from the likeliest cause. The part of a second change is that of
    the misfit which the first leaves. Added parameters are stated with value and unit. `explanation` has the fit
    without changes, and the first cause.
    """
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


def _shifts(identification: Identification, base: FittedModel, fit: FittedModel) -> tuple[ParameterShift, ...]:
    """Parameters of the answer with their values before (`base`) and after a change (`fit`), the farthest first.

    Distance is the change in standard deviations of the answer; intervals are those of the fit with the change.
    """
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

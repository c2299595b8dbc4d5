"""The answer to a study with its verdict, and where that is not sound the changes that would explain why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.core.display import plural
from structid.core.errors import StructidError
from structid.criticism.candidate import Candidate
from structid.criticism.held import MATTERS, HeldValue, doubted, is_clear
from structid.criticism.pool import MOST_DOFS
from structid.criticism.verdict import (
    NOT_TRIED,
    Cause,
    Criticism,
    Moved,
    are_causes,
    is_sound,
    judged,
    noise_ratio,
    not_found,
)
from structid.explanation.explain import ALIKE, Explanation, asked_for, explained, is_misfit, with_freed
from structid.explanation.held import held_values
from structid.explanation.refits import Fitted
from structid.explanation.suggestions import FOLDER, suggestion_name, suggestion_text, write_suggestion
from structid.explanation.time_budget import TimeBudget
from structid.explanation.trial import are_small, base_trial
from structid.explanation.union import intervals_of, widened
from structid.explanation.words import cause_kind, cause_words
from structid.forward import FrfProblem
from structid.forward.frf.solvers.tabulated import NO_MATRICES
from structid.identification.identified import Identification
from structid.inversion.search.work import ALONE, Work
from structid.study.results.result import StudyResult
from structid.study.run.start import Start
from structid.study.run.workers import threads_for

_MOST, _MOST_ALIKE = 4, 4
#: Held values at most that a sound answer is fitted without.
_MOST_HELD = 3
#: The search for causes may take so many identifications, and so many seconds of a processor more.
_IDENTIFICATIONS, _SECONDS = 3.0, 5.0
#: The verdict of an answer that is written while causes are still looked for.
_SEARCHING = "the search for causes had not ended when this was written"
_NO_MATRIX = "no change of model or record was tried: the search leaves no Jacobian to look for one with"
_OF_RECORDS = f"of a model of more than {MOST_DOFS} degrees of freedom, causes are looked for in the records alone"
_NO_PLACES = "causes were not looked for: frequencies without any shape show no place"
#: Whose first added parameter says how large the cause is.
_STATISTICAL = ("channel", "outlying_lines", "record", "noise_level", "extra_mode")


def time_for_causes(identification_seconds: float) -> TimeBudget:
    """The processor time that causes are looked for by default, from now on, after an identification that took so long."""
    return TimeBudget(_IDENTIFICATIONS * identification_seconds + _SECONDS)


def criticized(
    ready: Start,
    result: StudyResult,
    explain: bool | None = None,
    work: Work = ALONE,
    budget: Callable[[], TimeBudget] = TimeBudget,
    before_search: Callable[[StudyResult], None] | None = None,
) -> tuple[StudyResult, tuple[Fitted, ...]]:
    """The result with its verdict, and the fits behind its causes.

    Parameters
    ----------
    ready : Start
        The study with its records.
    result : StudyResult
    explain : bool, optional
        Whether causes are looked for; by default where the answer is not sound.
    work : Work
        Where candidates are looked at and refitted.
    budget : callable
        The processor time that the search for causes may take, asked for when it begins; without a limit by default.
    before_search : callable, optional
        Takes the result as it is before causes are looked for, which may take long.
    """
    with threads_for(result.identification.problems):
        return _criticized(ready, result, explain, work, budget, before_search)


def _criticized(
    ready: Start,
    result: StudyResult,
    explain: bool | None,
    work: Work,
    budget: Callable[[], TimeBudget],
    before_search: Callable[[StudyResult], None] | None,
) -> tuple[StudyResult, tuple[Fitted, ...]]:
    found = result.identification
    held: tuple[HeldValue, ...] = ()
    if is_sound(found):
        found = replace(found, warnings=tuple(one for one in found.warnings if one not in ready.sensor_warnings))
        result = replace(result, identification=found)
        held = held_values(ready, found)
        if not explain and (explain is False or not is_clear(held)):
            return _sound(ready, result, held, work, is_asked=explain is None)
    if any(one.warning for one in found.truncations) and not explain:
        return replace(result, criticism=Criticism(judged(found, work=work))), ()
    ratio = noise_ratio(found)
    if ratio is not None and ratio != 1.0 and not explain:
        causes = (_noise_level(found.estimate.goodness.least_per_dof, ratio),)
        return replace(result, criticism=Criticism(judged(found, causes, work=work), causes)), ()
    if found.estimate.goodness.least_per_dof <= 1 and not found.missed and not explain and not held:
        return replace(result, criticism=Criticism(judged(found, work=work))), ()
    if explain is False or found.target is None or not found.estimate.uncertainty.has_matrix:
        return _without_causes(result, NOT_TRIED if explain is False else _NO_MATRIX, work)
    if not ready.study.structure.has_matrices:
        return _without_causes(result, f"causes were not looked for: that {NO_MATRICES}", work)
    if any(role == "output" and not dofs for setup in ready.setups for role, dofs in setup.channels):
        return _without_causes(result, _NO_PLACES, work)
    if before_search is not None:
        before_search(_without_causes(result, _SEARCHING, work)[0])
    try:
        explanation = explained(_base(ready, found), work, budget())
    except (StructidError, np.linalg.LinAlgError, MemoryError) as error:
        return _without_causes(result, f"causes could not be looked for: {error}", work)
    if explanation.better is not None:
        reached = explanation.better.cost / max(found.estimate.goodness.degrees_of_freedom, 1)
        judgement = not_found(found, reached)
        return replace(result, criticism=Criticism(judgement)), ()
    tests = found.estimate.goodness.residual_tests
    if not explanation.causes and tests is not None and not tests.words[1:] and found.modal_fits and not held:
        causes = (
            _noise_level(found.estimate.goodness.least_per_dof, float(np.sqrt(found.estimate.goodness.least_per_dof))),
        )
        wider = _wider(ready, result, explanation.likely)
        judgement = judged(found, causes, work=work)
        return replace(wider, criticism=Criticism(judgement, causes, n_tried=explanation.tried)), ()
    return _told(ready, result, explanation, held, work)


def _base(ready: Start, found: Identification) -> Fitted:
    theta = found.estimate.theta
    return Fitted(
        base_trial(ready.study, ready.setups, found.problems, theta), theta, found.estimate.goodness.chi_square
    )


def _sound(
    ready: Start, result: StudyResult, held: tuple[HeldValue, ...], work: Work, is_asked: bool
) -> tuple[StudyResult, tuple[Fitted, ...]]:
    """A sound answer, but where the record would have other values of what the model holds, or another single change: then with
    these fitted as well.
    """
    found, doubts = result.identification, doubted(held)[:_MOST_HELD]
    if doubts:
        try:
            explanation = with_freed(_base(ready, found), [one.name for one in doubts], len(held), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            return _without_causes(result, f"it could not be fitted with what it holds set free: {error}", work, held)
        return _told(ready, result, explanation, held, work, is_search=False)
    if is_asked and _can_be_asked(ready, found):
        try:
            explanation = asked_for(_base(ready, found), work)
        except (StructidError, np.linalg.LinAlgError) as error:
            return _without_causes(result, f"it could not be held against single changes: {error}", work, held)
        if any(
            one.distance > MATTERS for fitted in explanation.causes for one in _moved(result, explanation.base, fitted)
        ):
            return _told(ready, result, explanation, held, work, is_search=False)
    return replace(result, criticism=Criticism(judged(found), held=held)), ()


def _can_be_asked(ready: Start, found: Identification) -> bool:
    """Whether a linear look at all single changes is one at the data themselves, and takes less than the answer did."""
    are_frfs = all(isinstance(problem, FrfProblem) for problem in found.problems)
    is_whole = found.target is not None and found.estimate.uncertainty.has_matrix
    return are_small(ready.setups) and are_frfs and is_whole and ready.study.structure.has_matrices


def _told(
    ready: Start,
    result: StudyResult,
    explanation: Explanation,
    held: tuple[HeldValue, ...],
    work: Work,
    is_search: bool = True,
) -> tuple[StudyResult, tuple[Fitted, ...]]:
    """The result with what was found; without `is_search` as changes that would lower the misfit, not as causes."""
    found = result.identification
    likely = explanation.likely if doubted(held) or not is_sound(found) or not is_search else ()
    ranked = _ranked(explanation)
    made = tuple(_cause(result, explanation, one, k, is_alike) for k, (one, is_alike) in enumerate(ranked, 1))
    made = (*made[:1], *(_like_damper(made[0]) if made else ()), *made[1:])
    misfit, expected = found.estimate.chi_square_per_dof, found.estimate.goodness.expected_per_dof
    is_accepted = is_search and are_causes(made, misfit, expected, bool(found.missed))
    accepted, lowering = (made, made[:0]) if is_accepted else (made[:0], made)
    is_asked = not is_search and not doubted(held)
    judgement = judged(found, accepted, explanation.tried, lowering, held=held, is_asked=is_asked, work=work)
    wider = _wider(ready, result, likely)
    if judgement.verdict == "approximate":
        held = held_values(ready, wider.identification)
    judgement = replace(judgement, reasons=(*judgement.reasons, *unlooked(explanation)))
    is_used = judgement.verdict in ("sound", "approximate")
    criticism = Criticism(judgement, accepted, lowering, explanation.tried, held if is_used else ())
    return replace(wider, criticism=criticism), tuple(one for one, _ in ranked)


def _wider(ready: Start, result: StudyResult, likely: Sequence[Fitted]) -> StudyResult:
    wider = widened(result.identification, likely, ready.study.options.direction)
    return replace(result, identification=wider)


def unlooked(explanation: Explanation) -> tuple[str, ...]:
    """What causes were not looked for, and how to go on."""
    if explanation.base.trial.is_large:
        return (_OF_RECORDS,)
    parts = [explanation, *([] if explanation.further is None else [explanation.further])]
    left_out = sum(part.left_out for part in parts)
    words = [f"{plural(left_out, 'likely change')} not tried"] * (left_out > 0)
    words += ["other pairs of causes not tried"] * explanation.is_single
    spent = sum(part.spent for part in parts)
    ended = f"the search for causes ended after {spent:.2g} s of the processor"
    return (f"{ended}, {' and '.join(words)}: `structid explain` goes on",) * bool(words)


def _without_causes(
    result: StudyResult, why: str, work: Work, held: tuple[HeldValue, ...] = ()
) -> tuple[StudyResult, tuple[Fitted, ...]]:
    judgement = judged(result.identification, untried=why, held=held, work=work)
    return replace(result, criticism=Criticism(judgement, held=held)), ()


def _like_damper(cause: Cause) -> tuple[Cause, ...]:
    """Friction beside a damper to the ground: at one level of a broad-band drive nothing tells them apart."""
    if cause.kind != "dashpot" or len(cause.where) > 1:
        return ()
    words = f"something rubs at {cause.where[0]}: one level of the force cannot distinguish it from a damper"
    return (replace(cause, kind="friction", words=words, is_alike=True, study="", lines=()),)


def _noise_level(chi_square: float, ratio: float) -> Cause:
    candidate = Candidate("noise_level", ("all records",))
    words = cause_words(candidate, ratio)
    return Cause(candidate.kind, candidate.where, words, 1.0 - 1 / chi_square if chi_square > 1 else 0.0, 1.0)


def _ranked(explanation: Explanation) -> list[tuple[Fitted, bool]]:
    """The likeliest cause and what cannot be told from it, a second cause beside it, and what comes next."""
    marked = [
        (one, criterion - explanation.criteria[0] < ALIKE)
        for one, criterion in zip(explanation.causes, explanation.criteria, strict=True)
    ]
    first = [pair for pair in marked if pair[1]][:_MOST_ALIKE]
    others = [pair for pair in marked if not pair[1]]
    further = explanation.further
    second = [] if further is None else [(one, False) for one in further.causes[:_MOST_ALIKE]]
    return [*first[:2], *second[:2], *first[2:], *others][: max(_MOST, len(first) + len(second[:2]))]


def _cause(result: StudyResult, explanation: Explanation, fitted: Fitted, number: int, is_alike: bool) -> Cause:
    base, before, after, target = explanation.base, explanation.base.values, fitted.values, fitted.trial.target
    candidate, _ = fitted.trial.changes[-1]
    added = tuple(
        (name, after[name], unit)
        for name, unit in zip(target.names, target.unknowns.units, strict=True)
        if name not in before
    )
    changes = fitted.trial.changes
    first = base if len(changes) == 1 else explanation.causes[0]
    own = [value for name, value, _ in added if name not in first.values]
    value = own[0] if own and candidate.kind not in _STATISTICAL else None
    return Cause(
        kind=cause_kind(candidate, value),
        where=_places(candidate),
        words=cause_words(candidate, value),
        share=max(0.0, 1 - fitted.cost / first.cost),
        chi_square_per_dof=fitted.cost / max(base.trial.target.n_data - len(target.names), 1),
        rest_per_dof=(fitted.cost - fitted.aside) / max(target.n_data - len(target.names), 1),
        found=added,
        moved=_moved(result, base, fitted),
        is_alike=is_alike,
        is_second=len(changes) > 1,
        study=f"{FOLDER}/{suggestion_name(number, changes)}",
        lines=suggestion_text(result.study, changes)[1],
        leaves_noise=not is_misfit(fitted),
    )


def _moved(result: StudyResult, base: Fitted, fitted: Fitted) -> tuple[Moved, ...]:
    """The values that a changed study has otherwise, the farthest first."""
    estimate, target = result.identification.estimate, fitted.trial.target
    before, after, ends = base.values, fitted.values, intervals_of(fitted, result.identification.intervals.level)
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    moved = (
        Moved(name, unit, before[name], after[name], ends[name], _distance(after[name] - before[name], std[name]))
        for name, unit in zip(target.names, target.unknowns.units, strict=True)
        if name in before
    )
    return tuple(sorted(moved, key=lambda one: -one.distance))


def _places(candidate: Candidate) -> tuple[str, ...]:
    return ("/".join(candidate.where),) if candidate.kind == "joint" else candidate.where


def _distance(change: float, std: float) -> float:
    return abs(change) / std if np.isfinite(std) and std > 0 else 0.0


def write_suggestions(result: StudyResult, fits: Sequence[Fitted], folder: Path, place: Path) -> None:
    """Write the studies of the causes into `folder`, which will be `place`."""
    given = result.criticism
    causes: Sequence[Cause] = () if given is None else given.named
    if not fits:
        return
    (folder / FOLDER).mkdir()
    for cause, fitted in zip([cause for cause in causes if cause.study], fits, strict=True):
        write_suggestion(result.study, fitted.trial.changes, folder / cause.study, place / FOLDER)

"""The answer to a study with its verdict, and where that is not sound the changes that would explain why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.criticism.candidate import Candidate
from structid.criticism.verdict import Cause, Criticism, Moved, is_sound, judged
from structid.explanation.explain import ALIKE, Explanation, Fitted, Told, explained
from structid.explanation.suggestions import FOLDER, suggestion_name, suggestion_text, write_suggestion
from structid.explanation.trial import Trial
from structid.explanation.words import cause_kind, cause_words
from structid.study.results.result import StudyResult
from structid.study.run.run import Start

_MOST = 6
_MOST_MOVED = 8
#: Whose first added parameter says how large the cause is.
_STATISTICAL = ("channel", "outlying_lines", "record", "noise_level")


def criticized(ready: Start, result: StudyResult, explain: bool = True, told: Told | None = None) -> tuple[StudyResult, Explanation | None]:
    """The result with its verdict.

    Parameters
    ----------
    ready : Start
        The study with its records.
    result : StudyResult
    explain : bool
        Whether causes are looked for where the answer is not sound.
    told : callable, optional
        Called with the name of a stage, and how many of how many steps of it are done.
    """
    found = result.identification
    if is_sound(found) or not explain or found.target is None or not found.estimate.uncertainty.has_matrix:
        return replace(result, criticism=Criticism(judged(found))), None
    base = Fitted(Trial(ready.study, ready.setups, found.problems), found.estimate.theta, found.estimate.chi_square)
    explanation = explained(base, told)
    causes = named_causes(result, explanation)
    judgement = judged(found, causes, explanation.tried)
    return replace(result, criticism=Criticism(judgement, causes, explanation.tried)), explanation


def named_causes(result: StudyResult, explanation: Explanation) -> tuple[Cause, ...]:
    """The accepted causes in words, the likeliest first."""
    made = []
    for number, (fitted, criterion) in enumerate(zip(explanation.causes, explanation.criteria, strict=True), 1):
        if number > _MOST:
            break
        is_alike = criterion - explanation.criteria[0] < ALIKE
        made.append(_cause(result, explanation, fitted, number, is_alike))
    return tuple(made)


def _cause(result: StudyResult, explanation: Explanation, fitted: Fitted, number: int, is_alike: bool) -> Cause:
    base, estimate = explanation.base, result.identification.estimate
    candidate, _ = fitted.trial.changes[-1]
    before, after = base.values, fitted.values
    target = fitted.trial.target
    added = tuple((name, after[name], unit) for name, unit in zip(target.names, target.units, strict=True) if name not in before)
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    moved = sorted(
        (
            Moved(name, unit, before[name], after[name], _distance(after[name] - before[name], std[name]))
            for name, unit in zip(target.names, target.units, strict=True) if name in before
        ),
        key=lambda one: -one.distance,
    )  # fmt: skip
    value = added[0][1] if added and candidate.kind not in _STATISTICAL else None
    if candidate.kind == "load_gain" and value is not None:
        value = float(value)
    changes = fitted.trial.changes
    return Cause(
        kind=cause_kind(candidate, value),
        where=_places(candidate),
        words=cause_words(candidate, value),
        share=max(0.0, 1 - fitted.cost / base.cost),
        chi_square_per_dof=fitted.cost / max(base.trial.target.n_data - len(target.names), 1),
        found=added,
        moved=tuple(moved[:_MOST_MOVED]),
        is_alike=is_alike,
        study=f"{FOLDER}/{suggestion_name(number, changes)}",
        lines=suggestion_text(result.study, changes)[1],
    )


def _places(candidate: Candidate) -> tuple[str, ...]:
    plain = tuple(text.removesuffix("+") for text in candidate.where)
    return (f"{plain[0]}/{plain[1]}",) if candidate.kind == "joint" else plain


def _distance(change: float, std: float) -> float:
    return abs(change) / std if np.isfinite(std) and std > 0 else 0.0


def write_suggestions(result: StudyResult, explanation: Explanation, folder: Path, place: Path) -> None:
    """Write the studies of the causes into `folder`, which will be `place`."""
    causes: Sequence[Cause] = result.criticism.causes if result.criticism is not None else ()
    if not causes:
        return
    (folder / FOLDER).mkdir()
    for cause, fitted in zip(causes, explanation.causes, strict=False):
        write_suggestion(result.study, fitted.trial.changes, folder / cause.study, place / FOLDER)

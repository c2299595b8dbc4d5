"""A solver's modes at the answer: differences are taken anew about each answer until it stays, and the deck is written with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from structid.arrays import FloatArray
from structid.errors import InputError, NoAnswerError, SingularModelError
from structid.estimation.search.work import ALONE, StageProgress, Work
from structid.identification.identified import Identification
from structid.identification.identify import identify_together
from structid.identification.options import IdentifyOptions
from structid.identification.together import by_name
from structid.observation import RecordProblem
from structid.solver.runs import point_words
from structid.solver.solved import Checked, Solved
from structid.study.results.result import StudyResult
from structid.study.results.solver import SolverAnswer
from structid.study.run.start import Start, started
from structid.study.run.workers import threads_for
from structid.study.schema.study import Study, load_study

MOST_ROUNDS = 12
#: The answer stays where it moves by less than this part of its standard deviation, or of its value.
_OF_STD, _OF_VALUE = 1e-2, 1e-6
#: Most that a parameter moves in a round, as a part of its value.
_FARTHEST = 0.5


def about_answer(ready: Start, progress: StageProgress | None = None, work: Work = ALONE) -> Start:
    """The study with its solver's differences taken about the answer; as it is where it has none, or exact matrices.

    Raises
    ------
    InputError
        If a run of the solver fails.
    NoAnswerError
        If a search does.
    """
    solved = ready.study.solved
    if solved is None or solved.is_exact:
        return ready
    quick = replace(ready.study.options, intervals="laplace", restarts=0, uniqueness_starts=0)
    moves: list[float] = []
    for _ in range(MOST_ROUNDS):
        found = _answered(ready, quick, progress, work)
        solved = ready.study.solved
        assert solved is not None
        values, std = deck_values(solved, found.problems, found), deck_std(solved, found)
        goal = {name: _within(solved, name, value) for name, value in values.items()}
        moves = [
            abs(goal[name] - at) / max(_OF_STD * std[name], _OF_VALUE * abs(at), np.finfo(float).tiny)
            for name, at in solved.at.items()
        ]
        if max(moves) <= 1.0:
            return ready
        ready = started(_about(ready.study, goal, found, work))
    words = (
        f"the answer still moves by {_OF_STD * max(moves):.2g} standard deviations after {MOST_ROUNDS} rounds of differences of the"
        " solver; give larger `step`, priors or bounds"
    )
    return replace(ready, warnings=(*ready.warnings, words))


def _answered(ready: Start, options: IdentifyOptions, progress: StageProgress | None, work: Work) -> Identification:
    """The answer with differences where they are."""
    try:
        with threads_for(ready.problems):
            return identify_together(ready.setups, options, progress, work)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        solved = ready.study.solved
        at = "" if solved is None else point_words(solved.at)
        raise NoAnswerError(
            f"{ready.study.path}: the search with differences of the solver about {at} failed: {error}; begin closer to the"
            " truth, or give bounds or priors"
        ) from error


def from_nominal(result: StudyResult) -> StudyResult:
    """The result with the study's own initial values, where the last search began at an answer before it."""
    study, found = result.study, result.identification
    if study.solved is None or study.solved.is_exact:
        return result
    first = load_study(study.path, _tables(study, {one.name: None for one in study.solved.solver.deck.parameters}))
    known: dict[str, float] = {}
    for source in first.setups:
        known |= dict(zip(source.parameters.names, source.parameters.start.tolist(), strict=True))
    pairs = zip(found.estimate.names, found.estimate.initial.tolist(), strict=True)
    initial = np.array([known.get(name, own) for name, own in pairs])
    return replace(result, identification=replace(found, estimate=replace(found.estimate, initial=initial)))


def deck_values(solved: Solved, problems: Sequence[RecordProblem], found: Identification) -> dict[str, float]:
    """What the answer makes of each parameter of the deck, by the first record."""
    values, problem = _property_values(problems[0], found.estimate.names, found.estimate.values), problems[0]
    return {
        item.term.property: float(values[item.values][0])
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }


def deck_std(solved: Solved, found: Identification) -> dict[str, float]:
    """Standard deviation of each of them; 0 where it is not known."""
    problem = found.problems[0]
    std = by_name(found.estimate.names, found.problems, lambda part: np.zeros(part.n_params))
    std = np.where(np.isfinite(found.estimate.std), found.estimate.std, 0.0) + std
    base = problem.parameters.offset
    values = _property_values(problem, found.estimate.names, std) - base
    return {
        item.term.property: abs(float(values[item.values][0]))
        for item in problem.structure.properties
        if item.element == solved.model.name and item.term.property in solved.at
    }


def with_solver(result: StudyResult, work: Work = ALONE) -> StudyResult:
    """The result with the updated deck of its solver, which is run once more with it."""
    solved, found = result.study.solved, result.identification
    if solved is None:
        return result
    values = solved.solver.deck.shown(deck_values(solved, found.problems, found))
    try:
        checked = solved.checked(values, work)
    except InputError as error:
        checked = Checked(float("nan"), f"the solver could not be run with the updated deck: {error}")
    answer = SolverAnswer(
        values,
        solved.solver.deck.written(values),
        solved.solver.linked,
        solved.solver.command,
        solved.counts.made,
        solved.counts.kept,
        solved.facts,
        checked.words,
        checked.difference,
    )
    return replace(result, solver=answer)


def _property_values(problem: RecordProblem, names: Sequence[str], values: FloatArray) -> FloatArray:
    known = dict(zip(names, values.tolist(), strict=True))
    own = np.array([known[name] for name in problem.parameters.names])
    return problem.parameters.values(own)


def _within(solved: Solved, name: str, value: float) -> float:
    """`value` no farther than a round may go, and within the bounds of the parameter."""
    at = solved.at[name]
    low, high = next(one.limits for one in solved.solver.deck.parameters if one.name == name)
    far = _FARTHEST * abs(at) or np.inf
    return float(np.clip(value, max(low, at - far), min(high, at + far)))


def _tables(study: Study, at: Mapping[str, float | None]) -> dict[str, Any]:
    """The study's tables with other places of differences; the nominal values where it is None."""
    tables = deepcopy(dict(study.root.table))
    for entry in tables["structure"]["solver"]["parameter"]:
        value = at[entry["name"]]
        entry.pop("at", None)
        if value is not None:
            entry["at"] = value
    return tables


def _about(study: Study, at: Mapping[str, float], found: Identification, work: Work) -> Study:
    """The study with differences about `at`, searches beginning at the answer so far."""
    moved = load_study(study.path, _tables(study, at), work)
    known = dict(zip(found.estimate.names, found.estimate.values.tolist(), strict=True))
    sources = []
    for before, after in zip(study.setups, moved.setups, strict=True):
        own = before.parameters
        values = np.array([known.get(name, start) for name, start in zip(own.names, own.start, strict=True)])
        inside = (values > own.transforms.lower) & (values < own.transforms.upper)
        begun = own.started_at(np.where(inside, values, own.start))
        sources.append(replace(before, structure=after.structure, parameters=begun))
    return replace(moved, setups=tuple(sources))

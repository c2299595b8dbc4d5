"""A solver's modes at the answer: differences are taken anew about each answer until it stays, and the deck is written with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.core.errors import InputError, NoAnswerError, SingularModelError
from structid.external.frf_model import SolvedFrfs
from structid.external.runs import point_words
from structid.external.solved import SolvedModel, SolverCheck
from structid.forward import FrfProblem, RecordProblem
from structid.identification.fits.record_fit import RecordFit
from structid.identification.identified import Identification
from structid.identification.identify import identify_together
from structid.identification.joint_problem import indices_of, joint_problem
from structid.identification.options import IdentifyOptions
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.study.results.result import SolverAnswer, StudyResult
from structid.study.run.solver.stages import (
    confirm_move,
    deck_std,
    deck_values,
    led_near,
    limit_to_bounds,
    relinearize_study,
    tables,
)
from structid.study.run.start import PreparedStudy, prepare_study, study_problems
from structid.study.run.workers import threads_for
from structid.study.schema.study import edited_study

MOST_ROUNDS = 12
#: The answer stays where it moves by less than this part of its standard deviation, or of its value.
_OF_STD, _OF_VALUE = 1e-2, 1e-6
#: Such parts that are worth a word where the solver confirms no further move.
_OPEN = 50.0


def relinearize_solver(
    ready: PreparedStudy, progress: StageProgress | None = None, work: TaskExecutor = SERIAL
) -> PreparedStudy:
    """The study with the finite differences of its solver taken about the answer, after repeated searches.

    It is unchanged without a solver or with exact matrices. A warning is added if the answer still moves after the last round.

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
    is_led = isinstance(solved, SolvedFrfs) and not ready.study.options.regularization
    if isinstance(solved, SolvedFrfs):
        ready = led_near(ready, work)
    moves: list[float] = []
    for _ in range(MOST_ROUNDS):
        identification = _identify(ready, quick, progress, work)
        solved = ready.study.solved
        assert solved is not None
        values, std = found_values(solved, identification), deck_std(solved, identification)
        goal = {name: limit_to_bounds(solved, name, value) for name, value in values.items()}
        moves = [
            abs(goal[name] - at) / max(_OF_STD * std[name], _OF_VALUE * abs(at), np.finfo(float).tiny)
            for name, at in solved.at.items()
        ]
        if max(moves) <= 1.0:
            return ready
        known = dict(zip(identification.estimate.names, identification.estimate.values.tolist(), strict=True))
        if is_led:
            estimate = identification.estimate
            end = estimate.theta[indices_of(estimate.names, joint_problem(ready.problems).names)]
            moved = confirm_move(ready, list, end, work)
            if moved is None:
                return ready if max(moves) <= _OPEN else replace(ready, warnings=(*ready.warnings, _open_words(moves)))
            ready = moved[1]
            continue
        ready = prepare_study(relinearize_study(ready.study, goal, known, work))
    words = (
        f"the answer still moves by {_OF_STD * max(moves):.2g} standard deviations after {MOST_ROUNDS} rounds of differences of the"
        " solver; give larger `step`, priors or bounds"
    )
    return replace(ready, warnings=(*ready.warnings, words))


def _open_words(moves: Sequence[float]) -> str:
    return (
        f"the differences of the solver point {_OF_STD * max(moves):.2g} standard deviations further, where its own FRFs fit no"
        " better: they are not smooth, or printed with few digits; write more digits, or give larger `step`"
    )


def _identify(
    ready: PreparedStudy, options: IdentifyOptions, progress: StageProgress | None, work: TaskExecutor
) -> Identification:
    """Identification with the finite differences that the study has now; `NoAnswerError` if the search fails."""
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


def with_nominal_start(result: StudyResult) -> StudyResult:
    """The result with the initial values that the study states, where the last search started at an earlier answer."""
    study, answer = result.study, result.identification
    if study.solved is None or study.solved.is_exact:
        return result
    first = edited_study(
        study, tables(study, {parameter.name: None for parameter in study.solved.solver.deck.parameters})
    )
    known: dict[str, float] = {}
    for source in first.setups:
        known |= dict(zip(source.parameters.names, source.parameters.start.tolist(), strict=True))
    pairs = zip(answer.estimate.names, answer.estimate.initial.tolist(), strict=True)
    initial = np.array([known.get(name, value) for name, value in pairs])
    fits = answer.fits
    if isinstance(study.solved, SolvedFrfs):  # about the answer, its model says nothing of where the search began
        fits = tuple(
            _with_initial_responses(fit, before) for fit, before in zip(fits, study_problems(first), strict=True)
        )
    return replace(
        result,
        identification=replace(answer, estimate=answer.estimate.with_initial(initial), fits=fits),
    )


def _with_initial_responses(fit: RecordFit, before: RecordProblem) -> RecordFit:
    """The fit with its initial responses replaced by those of `before`, the problem at the study's initial values."""
    assert isinstance(before, FrfProblem)
    start = before.physical(before.theta_start)
    used, judged = (
        replace(lines, initial=before.predicted_on(lines.record, start)) for lines in (fit.used, fit.judged)
    )
    return replace(fit, used=used, judged=judged)


def found_values(solved: SolvedModel, identification: Identification) -> dict[str, float]:
    """Value of each parameter of the deck at the answer, by name, from the problem of the first record."""
    return deck_values(
        solved, identification.problems[0], identification.estimate.names, identification.estimate.values
    )


def with_solver(result: StudyResult, work: TaskExecutor = SERIAL) -> StudyResult:
    """The result with the updated deck of its solver, and the outcome of one more run of the solver with that deck.

    It is unchanged without a solver; a run that fails is reported in words.
    """
    solved, identification = result.study.solved, result.identification
    if solved is None:
        return result
    values = solved.solver.deck.shown(found_values(solved, identification))
    try:
        checked = solved.checked(values, work)
    except InputError as error:
        checked = SolverCheck(float("nan"), f"the solver could not be run with the updated deck: {error}")
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

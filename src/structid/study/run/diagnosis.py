"""The diagnosis of a study: its verdict, and its causes as studies ready to run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from structid.diagnose.diagnosis import diagnose_identification
from structid.diagnose.search_budget import UNLIMITED, SearchBudget
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.verdict import Diagnosis, Judgement, is_sound
from structid.identification.fits.model_modes import structure_modes
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.results.result import StudyResult
from structid.study.results.suggestions import with_suggestions
from structid.study.run.start import PreparedStudy
from structid.study.run.workers import threads_for
from structid.study.schema.records.record import read_histories

if TYPE_CHECKING:
    from structid.diagnose.refits import FittedModel

#: Modes of a model that windows may blur.
_MOST_MODES = 12


def diagnose_study(
    ready: PreparedStudy,
    result: StudyResult,
    explain: bool | None = None,
    work: TaskExecutor = SERIAL,
    budget: SearchBudget = UNLIMITED,
    before_search: Callable[[StudyResult], None] | None = None,
) -> tuple[StudyResult, tuple[FittedModel, ...]]:
    """The result with its diagnosis, and the refits behind its causes, in the order of the causes.

    Warnings about sensors are left out of a sound result. Where the verdict is "approximate" or "wrong_model",
    windows of averaged spectra that blur resonances are among its reasons.

    Parameters
    ----------
    ready : PreparedStudy
        The study with its records.
    result : StudyResult
        Result of the identification.
    explain : bool, optional
        True to search for causes, False not to; by default they are searched for where the answer is not sound.
    work : TaskExecutor
        The way in which candidates are computed and refitted: in this process, or on workers with a checkpoint.
    budget : SearchBudget
        Limits of the search for causes, counted from its beginning; unlimited by default.
    before_search : callable, optional
        Called with the result so far before the search for causes, which may take long.
    """
    identification = result.identification
    if is_sound(identification):
        kept = tuple(one for one in identification.warnings if one not in ready.sensor_warnings)
        identification = replace(identification, warnings=kept)

    def show(diagnosis: Diagnosis) -> None:
        if before_search is not None:
            before_search(replace(result, identification=identification, diagnosis=diagnosis))

    model = TestedModel(ready.setups, ready.study.options)
    with threads_for(identification.problems):
        diagnosed = diagnose_identification(model, identification, explain, work, budget, show)
    diagnosis = with_suggestions(ready.study, diagnosed.diagnosis, diagnosed.fits)
    if diagnosis.judgement.verdict in ("approximate", "wrong_model"):
        diagnosis = replace(diagnosis, judgement=_with_findings(diagnosis.judgement, _window_warnings(ready)))
    return replace(result, identification=diagnosed.identification, diagnosis=diagnosis), diagnosed.fits


def _with_findings(judgement: Judgement, findings: tuple[str, ...]) -> Judgement:
    """The judgement with all `findings` of the record's check added to its reasons, and the first of them to its words.

    It is unchanged if there are none.
    """
    if not findings:
        return judgement
    words = f"{judgement.words} The record itself shows: {findings[0]}."
    return replace(judgement, words=words, reasons=(*judgement.reasons, *findings))


def _window_warnings(ready: PreparedStudy) -> tuple[str, ...]:
    """Warnings on windows of averaged spectra that blur the resonances of the initial models; each text once."""
    warnings: list[str] = []
    for source, setup, problem in zip(ready.study.setups, ready.setups, ready.problems, strict=True):
        if source.record.frf is not None and source.record.time is None and setup.structure.has_modes:
            histories = read_histories(source.record)
            if not histories:
                continue
            from structid.study.run.check import leaking_windows  # for spectra averaged from histories alone

            modes = structure_modes(setup.structure, setup.parameters.values(setup.parameters.start), _MOST_MODES)
            warnings += leaking_windows(source.record, histories, problem, modes)
    return tuple(dict.fromkeys(warnings))

"""The diagnosis of a study: its verdict, and its causes as studies ready to run, with the lines in which they differ."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structid.core.errors import InputError
from structid.diagnose.diagnosis import diagnose_identification
from structid.diagnose.search_budget import UNLIMITED, SearchBudget
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.verdict import Cause, Diagnosis, Judgement, is_sound
from structid.identification.record_fit import structure_modes
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.results.result import StudyResult
from structid.study.run.start import PreparedStudy
from structid.study.run.workers import threads_for
from structid.study.schema.records.record import read_histories
from structid.study.schema.study import Study

if TYPE_CHECKING:
    from structid.diagnose.modified_model import Change
    from structid.diagnose.refits import FittedModel


FOLDER = "suggestions"


def suggestion_name(number: int, changes: Sequence[Change]) -> str:
    """File name of a suggested study, made of its number and the places of its changes, such as ``1-support-9Y.toml``."""
    words = " ".join(f"{one.candidate.place[0]} {' '.join(one.candidate.where[:2])}" for one in changes)
    return f"{number}-{re.sub(r'[^A-Za-z0-9]+', '-', words).strip('-')[:60]}.toml"


def suggestion_text(study: Study, changes: Sequence[Change]) -> tuple[str, tuple[str, ...]]:
    """The text of a study file after `changes`, with its comments, and the lines that were added or removed.

    These lines begin with "+ " or "- "; blank ones are left out. `InputError` if the file cannot hold a change.
    """
    from structid.study.schema.edits import changed_text  # an editor of TOML is needed for suggestions alone

    def change_tables(tables: dict[str, Any]) -> None:
        for change in changes:
            for edit in change.edits:
                edit.write(tables)

    text = changed_text(study.text, change_tables)
    lines = difflib.ndiff(study.text.splitlines(), text.splitlines())
    return text, tuple(line for line in lines if line[:2] in ("+ ", "- ") and line[2:].strip())


def with_suggestions(study: Study, diagnosis: Diagnosis, fits: Sequence[FittedModel]) -> Diagnosis:
    """The diagnosis with, for each refitted cause, the path of a study file to suggest and the lines that differ.

    Nothing is written (see `write_suggestions`); paths are in the results folder. `fits` are refits of the causes, or
    without any of the suggested changes, that have one, in order. A change that no file can hold gets no path.
    """
    changes = iter(fits)
    number = 0

    def suggested(cause: Cause) -> Cause:
        """The cause with the path of its suggested study file in the results folder, and the lines of it that differ.

        Files are numbered from 1. A cause is unchanged if it has no refit, or a study file cannot hold its change.
        """
        nonlocal number
        if not cause.has_fit:
            return cause
        number += 1
        own = next(changes).modified.changes
        try:
            lines = suggestion_text(study, own)[1]
        except InputError:  # the change has no line in a file that is written so
            return cause
        return replace(cause, study=f"{FOLDER}/{suggestion_name(number, own)}", lines=lines)

    named = tuple(suggested(cause) for cause in diagnosis.named) if fits else diagnosis.named
    return replace(diagnosis, causes=named) if diagnosis.causes else replace(diagnosis, suggestions=named)


def write_suggestions(result: StudyResult, fits: Sequence[FittedModel], folder: Path, target: Path) -> None:
    """Write the suggested study file of each cause that has one into `folder`, whose content later moves to `target`.

    `fits` are the refits of the causes that have one, in the order of the causes. Nothing is written if no cause has a
    study.
    """
    diagnosis = result.diagnosis
    causes: Sequence[Cause] = () if diagnosis is None else diagnosis.named
    if not any(cause.study for cause in causes):
        return
    (folder / FOLDER).mkdir()
    for cause, fit in zip([cause for cause in causes if cause.has_fit], fits, strict=True):
        if cause.study:
            title = f"{result.study.title}, if {cause.words}"
            write_suggestion(result.study, fit.modified.changes, folder / cause.study, target / FOLDER, title)


def write_suggestion(study: Study, changes: Sequence[Change], path: Path, folder: Path, title: str) -> None:
    """Write the study with `changes` and a new `title` to the file `path`, which will later stand in `folder`.

    Relative paths of its input files are rewritten so that they are right from `folder`.
    """
    from structid.study.schema.edits import changed_text  # as in `suggestion_text`

    away = Path(os.path.relpath(study.path.parent.resolve(), folder.resolve()))
    names = {name for name in study.digests if name != study.path.name}

    def retitle_and_move(tables: Any) -> None:
        tables["title"] = title
        _move_paths(tables, names, away)

    text = changed_text(suggestion_text(study, changes)[0], retitle_and_move)
    schema = re.match(r"#:schema (?!\w+://)(\S+)", text)
    if schema:
        text = text.replace(schema[1], (away / schema[1]).as_posix(), 1)
    path.write_bytes(text.encode("utf-8"))


def _move_paths(table: Any, names: set[str], away: Path) -> None:
    """Rewrite, in place, the relative paths among the texts of a table or list for use from another folder.

    `names` are the texts that are paths of input files; `away` leads from the new folder to that of the study.
    """
    items = list(table.items()) if isinstance(table, dict) else list(enumerate(table))
    for key, value in items:
        if isinstance(value, str):
            if Path(value).as_posix() in names and not Path(value).is_absolute():
                table[key] = (away / value).as_posix()
        elif isinstance(value, dict | list):
            _move_paths(value, names, away)


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

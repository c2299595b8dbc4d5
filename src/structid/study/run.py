"""A study from start to end: read, check, identify."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import ComplexArray
from structid.errors import SingularModelError, StructidError
from structid.estimation.estimate import StageProgress
from structid.observation import FrfProblem
from structid.records import FrfRecord
from structid.study.checks import require_sound_model, unit_warnings
from structid.study.identification import Identification, identify, prepared_problem, used_lines
from structid.study.record_section import load_record
from structid.study.result import StudyResult, provenance
from structid.study.section import Section
from structid.study.study import Study, load_study

__all__ = ["SearchFailedError", "Start", "load_study", "run_study", "started"]


class SearchFailedError(StructidError):
    """The search came to where the model cannot be evaluated; there is no estimate."""


@dataclass(frozen=True, eq=False)
class Start:
    """A study with its record, ready for a search.

    Attributes
    ----------
    study : Study
    record : FrfRecord
        All lines.
    problem : FrfProblem
        Of the lines in the band.
    predicted : complex array
        The initial model's FRF at those lines.
    warnings : tuple of str
    unit_warnings : tuple of str
        Those that only a comparison with the initial model gives.
    """

    study: Study
    record: FrfRecord
    problem: FrfProblem
    predicted: ComplexArray
    warnings: tuple[str, ...]
    unit_warnings: tuple[str, ...]


def started(study: Study) -> Start:
    """The study's record read and compared with its initial model.

    Raises
    ------
    InputError
        If the record, the sensors or the band cannot be used; with the place in the study file.
    SingularModelError
        If the initial model has a mechanism; with the place of the structure.
    """
    record = load_record(study.record)
    section = study.record.section
    for key, dofs in (("outputs", record.outputs), ("inputs", record.inputs)):
        with section.located(_channel_key(section, key)):
            study.structure.selection(dofs)
    method = study.section("method")
    with method.located("band" if "band" in method.table else None):
        used = used_lines(record, study.options)
    with method.located("evaluation_band"):
        judged = record.band(*study.options.evaluation_band) if study.options.evaluation_band else used
    values = study.parameters.values(study.parameters.start)
    with _placed_mechanism(study.section("structure")):
        require_sound_model(study.structure, values, min(used.frequency[0], judged.frequency[0]))
    with section.located():
        problem, warnings = prepared_problem(study.structure, study.parameters, record, study.options)
    with _placed_mechanism(study.section("structure")), section.located():
        predicted = problem.predicted(study.parameters.theta_start)
    if not np.isfinite(predicted).all():
        raise study.section("structure").error(
            "the initial model's response is not finite; check its masses, stiffnesses and supports"
        )
    return Start(study, record, problem, predicted, warnings, unit_warnings(problem.record, predicted))


def _channel_key(section: Section, key: str) -> str:
    """The key that says which channels there are: the list itself, or the file."""
    for candidate in (key, "channels", "path", "repeats"):
        if candidate in section.table:
            return candidate
    return key


@contextmanager
def _placed_mechanism(section: Section) -> Iterator[None]:
    """Gives a `SingularModelError` the place of the structure."""
    try:
        yield
    except SingularModelError as error:
        raise SingularModelError(str(section.error(str(error)))) from error


def run_study(study: Study, progress: StageProgress | None = None) -> StudyResult:
    """What the study identifies.

    Parameters
    ----------
    study : Study
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.

    Returns
    -------
    StudyResult
        Also where the search did not converge or the data do not determine the answer: see
        ``identification.estimate.status``.

    Raises
    ------
    InputError, SingularModelError
        If the study cannot be run as it is; see `started`.
    SearchFailedError
        If the search came to where there is no model response.
    """
    ready = started(study)
    try:
        found = identify(study.structure, study.parameters, ready.record, study.options, progress)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SearchFailedError(
            f"{study.path}: the search failed: {error}; start closer to the truth, give bounds or priors, or narrow"
            " the band"
        ) from error
    return StudyResult(study, _with_warnings(found, ready.unit_warnings), provenance(study))


def _with_warnings(found: Identification, first: tuple[str, ...]) -> Identification:
    return replace(found, warnings=(*first, *found.warnings)) if first else found

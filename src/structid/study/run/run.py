"""A study from start to end: read, check, identify."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import ComplexArray
from structid.errors import InputError, NoAnswerError, SingularModelError
from structid.estimation.estimate import StageProgress
from structid.estimation.search.work import ALONE, Work
from structid.identification.checks import require_sound_model, unit_warnings
from structid.identification.free_search import free_obstacle, identify_free, searches_free
from structid.identification.identified import AnySetup
from structid.identification.identify import (
    Setup,
    identify_together,
    prepared_problem,
    prepared_setup,
    titles,
    used_lines,
)
from structid.identification.modal_setup import ModalSetup
from structid.identification.search import RecordProblem, alike, shared_parts, together
from structid.observation import FrfProblem, ModalProblem
from structid.records import FrfRecord
from structid.study.results.result import FreeResult, StudyResult, provenance
from structid.study.run.needs import require_room
from structid.study.schema.record import load_histories
from structid.study.schema.section import Section
from structid.study.schema.setups import SetupSource
from structid.study.schema.study import Study, load_study

__all__ = [
    "SearchFailedError",
    "Start",
    "is_free",
    "load_study",
    "run_free_study",
    "run_started",
    "run_study",
    "started",
    "study_parts",
    "study_problems",
]


class SearchFailedError(NoAnswerError):
    """The search came to where the model cannot be evaluated; there is no estimate."""


@dataclass(frozen=True, eq=False)
class Start:
    """A study with its records, ready for a search.

    Attributes
    ----------
    study : Study
    setups : tuple of Setup or ModalSetup
        With all lines of their records.
    problems : tuple of FrfProblem or ModalProblem
        Of the lines in the band, one a record.
    predicted : tuple of complex arrays
        The initial model's FRF at those lines, one a record of responses.
    warnings : tuple of str
    unit_warnings : tuple of str
        Those that only a comparison with the initial model gives.
    """

    study: Study
    setups: tuple[AnySetup, ...]
    problems: tuple[RecordProblem, ...]
    predicted: tuple[ComplexArray, ...]
    warnings: tuple[str, ...]
    unit_warnings: tuple[str, ...]

    @property
    def record(self) -> FrfRecord | None:
        """The first record of responses, all lines; None where all records are of modes."""
        return next((setup.record for setup in self.setups if isinstance(setup, Setup)), None)

    @property
    def used(self) -> FrfRecord | None:
        """The lines of it in the band."""
        return next((problem.record for problem in self.problems if isinstance(problem, FrfProblem)), None)


def started(study: Study) -> Start:
    """The study's records read and compared with their initial models.

    Raises
    ------
    InputError
        If a record, its sensors or the band cannot be used, or set-ups contradict each other; with the place in the
        study file.
    SingularModelError
        If an initial model has a mechanism; with the place of the structure.
    """
    setups = tuple(_loaded(study, source) for source in study.setups)
    problems: list[RecordProblem] = []
    predicted: list[ComplexArray] = []
    warnings: list[str] = []
    units: list[str] = []
    for title, setup, source in zip(titles(setups), setups, study.setups, strict=True):
        problem, own = _prepared(study, source, setup)
        prefix = f"{title}: " if len(setups) > 1 else ""
        problems.append(problem)
        warnings += [prefix + warning for warning in own]
        if isinstance(problem, FrfProblem):
            predicted.append(_initial(study, source, problem))
            units += [prefix + warning for warning in unit_warnings(problem.record, predicted[-1])]
    with study.root.located():
        same = alike(problems)
        together(same)
    return Start(study, setups, same, tuple(predicted), tuple(warnings), tuple(units))


def study_parts(study: Study) -> tuple[object, ...]:
    """Structure and record of each problem of the study, as `identify_together` names them to its `work`."""
    return shared_parts(study_problems(study))


def study_problems(study: Study) -> tuple[RecordProblem, ...]:
    """The problem of each record, nothing evaluated yet.

    Raises
    ------
    InputError
        If a record, its sensors or the band cannot be used.
    """
    setups = [_loaded(study, source) for source in study.setups]
    return alike([prepared_setup(setup, study.options)[0] for setup in setups])


def _loaded(study: Study, source: SetupSource) -> AnySetup:
    section = source.section
    if source.record.modes is not None:
        modes = source.record.modes.load()
        with section.located("channels_used" if source.record.channels_used else "path"):
            source.structure.selection(modes.channels)
        return ModalSetup(source.structure, source.parameters, modes, source.record.modes.settings, source.name)
    record, time = load_histories(source.record)
    for key, dofs in (("outputs", record.outputs), ("inputs", record.inputs)):
        with section.located(_channel_key(section, key)):
            source.structure.selection(dofs)
    source.require_channels(record)
    return Setup(source.structure, source.parameters, record, source.channel_unknowns, source.name, time)


def _prepared(study: Study, source: SetupSource, setup: AnySetup) -> tuple[RecordProblem, tuple[str, ...]]:
    """The problem of one record, its model looked at first."""
    if isinstance(setup, ModalSetup):
        return _prepared_modes(study, source, setup)
    method = study.section("method")
    with method.located("band" if "band" in method.table else None):
        used = used_lines(setup.record, study.options)
    with method.located("evaluation_band"):
        judged = setup.record.band(*study.options.evaluation_band) if study.options.evaluation_band else used
    values = setup.parameters.values(setup.parameters.start)
    with _placed_mechanism(study.section("structure")):
        require_sound_model(setup.structure, values, min(used.frequency[0], judged.frequency[0]))
    with source.section.located():
        return prepared_problem(setup.structure, setup.parameters, setup.record, study.options, setup.channel_unknowns)


def _prepared_modes(study: Study, source: SetupSource, setup: ModalSetup) -> tuple[ModalProblem, tuple[str, ...]]:
    """The problem of one record of modes, its model looked at first, and its pairs at the start."""
    with _placed_mechanism(study.section("structure")):
        require_sound_model(setup.structure, setup.parameters.values(setup.parameters.start), np.inf)
    inner = source.section.section("modes") or source.section
    with _placed_mechanism(study.section("structure")), inner.located():
        problem = setup.problem()
        problem.residual(problem.theta_start)
    return problem, setup.record.warnings


def _initial(study: Study, source: SetupSource, problem: FrfProblem) -> ComplexArray:
    """The initial model's FRF."""
    with _placed_mechanism(study.section("structure")), source.section.located():
        predicted = problem.predicted(problem.theta_start)
    if not np.isfinite(predicted).all():
        raise study.section("structure").error(
            "the initial model's response is not finite; check its masses, stiffnesses and supports"
        )
    return predicted


def _channel_key(section: Section, key: str) -> str:
    """The key that says which channels there are: the list itself, or the file."""
    for candidate in (key, "channels", "path", "repeats"):
        if candidate in section.table:
            return candidate
    return key


@contextmanager
def _placed_mechanism(section: Section) -> Iterator[None]:
    """Gives a `SingularModelError`, and what a factorization raises on such matrices, the place of the structure."""
    try:
        yield
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SingularModelError(str(section.error(str(error)))) from error


def run_study(study: Study, progress: StageProgress | None = None, work: Work = ALONE) -> StudyResult:
    """What the study identifies.

    Parameters
    ----------
    study : Study
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : Work
        Where searches and their repeats run, and whether they are kept; see `structid.study.run.long_run`.

    Returns
    -------
    StudyResult
        Also where the search did not converge or the data do not determine the answer: see
        ``identification.estimate.status``.

    Raises
    ------
    InputError, SingularModelError
        If the study cannot be run as it is, see `started`, or does not fit in memory.
    SearchFailedError
        If the search came to where there is no model response.
    """
    return run_started(started(study), progress, work)


def run_started(ready: Start, progress: StageProgress | None = None, work: Work = ALONE) -> StudyResult:
    """The same for a study whose records are read; see `run_study`."""
    study = ready.study
    if study.options.matrix_free:
        raise InputError(
            f"{study.path}: [method] search is 'matrix_free', which gives no covariance matrix; use `structid identify` (in"
            " Python `run_free_study`), or group the unknowns and leave it out"
        )
    require_room(study, ready.problems)
    with _placed_failure(study):
        found = identify_together(ready.setups, study.options, progress, work)
    first = ready.unit_warnings
    found = replace(found, warnings=(*first, *found.warnings)) if first else found
    return StudyResult(study, found, provenance(study))


def run_free_study(ready: Start, progress: StageProgress | None = None, work: Work = ALONE) -> FreeResult:
    """What a study of very many parameters identifies, without a Jacobian; see `identify_free`.

    Raises
    ------
    InputError
        If the study has what such a search cannot do.
    SearchFailedError
        If the search came to where there is no model response.
    """
    study = ready.study
    obstacle = _histories(ready) or free_obstacle(ready.problems, study.options)
    if obstacle:
        raise InputError(f"{study.path}: a search without a Jacobian {obstacle}")
    with _placed_failure(study):
        found = identify_free([s for s in ready.setups if isinstance(s, Setup)], study.options, progress, work)
    found = replace(found, warnings=(*ready.unit_warnings, *found.warnings))
    return FreeResult(study, found, provenance(study))


def is_free(ready: Start) -> bool:
    """Whether the parameters of a study are searched for without a Jacobian; see `searches_free`.

    Raises
    ------
    InputError
        If that is asked for and cannot be; with the place in the study file.
    """
    method = ready.study.section("method")
    with method.located("search" if "search" in method.table else None):
        if _histories(ready):
            if ready.study.options.matrix_free:
                raise InputError(f"search 'matrix_free' {_histories(ready)}; leave it out, or fit FRFs")
            return False
        return searches_free(ready.problems, ready.study.options)


def _histories(ready: Start) -> str:
    """That time histories are to be fitted themselves, which needs a Jacobian; "" where none are."""
    fitted = any(isinstance(setup, Setup) and setup.time is not None for setup in ready.setups)
    return "takes FRFs, not time histories that are fitted themselves" if fitted else ""


@contextmanager
def _placed_failure(study: Study) -> Iterator[None]:
    try:
        yield
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SearchFailedError(
            f"{study.path}: the search failed: {error}; start closer to the truth, give bounds or priors, or narrow"
            " the band"
        ) from error

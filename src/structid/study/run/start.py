"""The start of a study: its records read, and compared with their initial models."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from structid.core.dof import Dof
from structid.core.errors import InputError, NoLinesError, SingularModelError
from structid.diagnose.checks.initial_comparison import InitialComparison, compare_with_initial_model
from structid.diagnose.checks.mesh import MeshErrors, checked_mesh
from structid.fem import Structure
from structid.fem.elements.matrix_group import SolverModel
from structid.forward import RecordProblem, ResponseCache
from structid.identification import setups as record_setups
from structid.identification.joint_problem import harmonize_shared_parameters, joint_problem
from structid.identification.mesh_pieces import MOST_DOFS, MOST_PIECES, dofs_of_pieces
from structid.identification.setups.setup import (
    AnySetup,
    Prepared,
    prefixes,
    prepared_warnings,
    require_sound_model,
    titles,
)
from structid.records import FrfRecord, TimeRecord
from structid.study.schema.records.record import faults, load_histories, load_record, read_files
from structid.study.schema.section import Section
from structid.study.schema.study import SetupSource, Study, cut_study

#: Times by which pieces are made shorter at once: the error that a far too coarse mesh shows of itself is a guess.
_MOST_FINER = 4


@dataclass(frozen=True, eq=False)
class PreparedStudy:
    """A study with its records, ready for a search.

    Attributes
    ----------
    study : Study
    setups : tuple of RecordSetup
        With all lines of their records.
    problems : tuple of RecordProblem
        Of the lines in the band, one a record.
    warnings : tuple of str
    comparisons : tuple of InitialComparison
        Each record beside its initial model.
    """

    study: Study
    setups: tuple[AnySetup, ...]
    problems: tuple[RecordProblem, ...]
    warnings: tuple[str, ...]
    comparisons: tuple[InitialComparison, ...]

    @property
    def channel_warnings(self) -> tuple[str, ...]:
        """Warnings on channels from the comparison of records with the initial models."""
        return self._titled(comparison.warnings.words for comparison in self.comparisons)

    @property
    def sensor_warnings(self) -> tuple[str, ...]:
        """Warnings on sensors from that comparison, which a sound answer proves wrong."""
        return self._titled(comparison.warnings.of_sensors for comparison in self.comparisons)

    @property
    def fault_warnings(self) -> tuple[str, ...]:
        """Warnings on faults that histories show by themselves."""
        return self._titled(tuple(one.words for one in setup.faults) for setup in self.setups)

    def _titled(self, of_each: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
        """Warnings of each record with its name before them, where there are several."""
        return tuple(name + words for name, own in zip(prefixes(self.setups), of_each, strict=True) for words in own)


def prepare_study(study: Study) -> PreparedStudy:
    """The study with its records read, prepared and compared with their initial models.

    Raises
    ------
    InputError
        If a record, its sensors or the band cannot be used, or set-ups contradict each other; with the place in the
        study file.
    SingularModelError
        If an initial model has a mechanism; with the place of the structure.
    """
    return compare_with_models(study, load_setups(study))


def compare_with_models(study: Study, setups: tuple[AnySetup, ...]) -> PreparedStudy:
    """The study prepared for its identification, with the records of `setups` compared with their initial models.

    It has the set-ups, their problems with shared parameters, and warnings. `StudyError` if a record cannot be used
    with its model.
    """
    records = zip(prefixes(setups), setups, study.setups, strict=True)
    pairs = [_prepare_record(study, source, setup, name) for name, setup, source in records]
    setups = tuple(setup for setup, _, _ in pairs)
    prepared, comparisons = [ready for _, ready, _ in pairs], tuple(comparison for _, _, comparison in pairs)
    with study.root.located():
        same = harmonize_shared_parameters([ready.problem for ready in prepared], titles(setups))
        joint_problem(same)
    return PreparedStudy(study, setups, same, tuple(prepared_warnings(setups, prepared)), comparisons)


def load_setups(study: Study) -> tuple[AnySetup, ...]:
    """The set-ups of a study, with their records read; beams whose pieces the study leaves open are as drawn."""
    cache = ResponseCache()
    return tuple(load_setup(source, cache) for source in study.setups)


def with_pieces(study: Study, setups: tuple[AnySetup, ...], count: int) -> tuple[Study, tuple[AnySetup, ...]]:
    """The study with its beams cut into `count` pieces each, and its set-ups with this structure.

    No record is read again.
    """
    cut, cache = cut_study(study, count), ResponseCache()
    sources = zip(cut.setups, study.setups, strict=True)
    cut = replace(cut, setups=tuple(replace(new, parameters=old.parameters) for new, old in sources))
    return cut, tuple(load_setup(source, cache, setup) for source, setup in zip(cut.setups, setups, strict=True))


def pieces_for_band(ready: PreparedStudy, mesh: MeshErrors | str) -> tuple[int, MeshErrors | str]:
    """Number of pieces of each beam and bar with which the modes in the first record's band are right, and their mesh.

    `mesh` has the errors of that set-up's modes, or says why it was not judged; what is returned is the same with the
    number of pieces. The number is 1 where the mesh is fine enough or was not judged, where the study states the
    number, and beside cells, which are not divided. It is less than the modes ask for where an identification would not
    take so many.
    """
    setup, structures = ready.setups[0], [made.structure for made in ready.setups]
    is_mixed = any(element.cells for structure in structures for element in structure.elements)
    if not ready.study.leaves_pieces_open or is_mixed or not setup.structure.divisible:
        return 1, mesh
    count = 1
    while not isinstance(mesh, str) and mesh.finding:
        finer = min(count * min(max(mesh.needed, 2), _MOST_FINER), MOST_PIECES)
        if finer == count or max(dofs_of_pieces(made, finer) for made in ready.setups) > MOST_DOFS:
            break
        count = finer
        cut = replace(setup.structure, subdivide=count)
        mesh = checked_mesh(setup.modelled_by(cut, setup.parameters, setup.channel_unknowns), ready.problems[0])
    return count, mesh


def study_problems(study: Study) -> tuple[RecordProblem, ...]:
    """The problem of each record of a study, before its responses are computed.

    Measured modes beyond all of the model are left out.

    Raises
    ------
    InputError
        If a record, its sensors or the band cannot be used.
    """
    sources = zip(study.setups, load_setups(study), strict=True)
    setups = tuple(_within_model(source, setup) for source, setup in sources)
    return harmonize_shared_parameters([setup.prepared(study.options).problem for setup in setups], titles(setups))


def load_setup(source: SetupSource, cache: ResponseCache, measured: AnySetup | None = None) -> AnySetup:
    """The set-up of a source: its record read, and its channels checked against the structure.

    Parameters
    ----------
    source : SetupSource
        Structure, parameters and record as the study file states them.
    cache : ResponseCache
        Cache shared by all set-ups of a study.
    measured : RecordSetup, optional
        A set-up with the same record, which is then not read again.

    Raises
    ------
    StudyError
        If a file cannot be used, or the structure lacks a channel; with its place in the study.
    """
    section, structure, parameters, name = source.section, source.structure, source.parameters, source.name
    setup: AnySetup
    if measured is not None:
        setup = measured.modelled_by(structure, parameters, source.channel_unknowns)
    elif source.record.modes is not None:
        modes = source.record.modes
        setup = record_setups.ModalSetup(
            structure, parameters, modes.load(), modes.settings, name, source.channel_unknowns
        )
    else:
        setup = _measured_setup(source, read_files(source.record), cache)
    if measured is None:
        source.require_channels(setup)
    for role, dofs in setup.channels:
        with section.located(_channel_key(section, f"{role}s")):
            _require_dofs(structure, dofs, role == "input")
    return setup


def _measured_setup(source: SetupSource, read: list[FrfRecord | TimeRecord], cache: ResponseCache) -> AnySetup:
    """The set-up of FRFs or of time histories from `read`, the records of its files.

    Time histories are fitted as they are if the source has settings for that, else their FRFs. `cache` is shared by all
    set-ups.
    """
    record, time, fault_list = source.record, source.record.time, faults(read)
    common = (source.structure, source.parameters)
    if time is None:
        frfs = load_record(record, read)
        return record_setups.Setup(
            *common,
            frfs,
            source.channel_unknowns,
            source.name,
            cache=cache,
            faults=fault_list,
            calibration=record.calibration,
        )
    frf_record = None if record.frf is None else load_record(record, read)
    histories = load_histories(record, time, read)
    settings, unknowns = time.settings, source.channel_unknowns
    return record_setups.TimeSetup(
        *common,
        histories,
        settings,
        unknowns,
        source.name,
        frf_record,
        cache,
        fault_list,
        calibration=record.calibration,
    )


def _require_dofs(structure: Structure, dofs: Iterable[Dof], inputs: bool) -> None:
    """Raise `InputError` if the structure lacks a channel; if a solver gives the model, the message has a hint on its nodes.

    `inputs` is True where the channels are inputs, which may also be supports.
    """
    try:
        structure.require_dofs(dofs, inputs)
    except InputError as error:
        if not any(isinstance(element, SolverModel) for element in structure.elements):
            raise
        raise InputError(
            f"{error}; nodes are those that the solver writes: of shells and beams CalculiX makes solids with nodes of their own,"
            " but with *NODE FILE, OUTPUT=2D and modes"
        ) from error


def _channel_key(section: Section, key: str) -> str:
    """The key of the section that names its channels, for error messages.

    It is the first that the section has of `key`, "channels_used", "channels", "path" and "repeats"; `key` itself if it
    has none.
    """
    for candidate in (key, "channels_used", "channels", "path", "repeats"):
        if candidate in section.table:
            return candidate
    return key


def _within_model(source: SetupSource, setup: AnySetup) -> AnySetup:
    """The set-up without measured modes beyond those of its model; an error gets the place of the record in the study file."""
    with (source.section.section("modes") or source.section).located():
        return setup.without_modes_beyond_model()


def _prepare_record(
    study: Study, source: SetupSource, setup: AnySetup, name: str
) -> tuple[AnySetup, Prepared[RecordProblem], InitialComparison]:
    """One set-up, its problem, and the comparison of its record with the initial model.

    `name` is put before messages about it. Measured modes beyond those of the model are left out of the set-up. Errors
    are raised with the place in the study file, also if the model is singular or no line is left in a band.
    """
    method, structure, options = study.section("method"), study.section("structure"), study.options
    section = source.section.section("modes") or source.section
    with section.located(), _locate_empty_band(method, "band", name):
        used, _ = setup.axes(replace(options, evaluation_band=None))
    with section.located(), _locate_empty_band(method, "evaluation_band", name):
        _, judged = setup.axes(options)
    values = setup.parameters.values(setup.parameters.start)
    with placed_mechanism(structure):
        require_sound_model(setup.structure, values, min(used[0], judged[0]))
    with placed_mechanism(structure), section.located():
        setup = _within_model(source, setup)
        prepared = setup.prepared(options)
        return setup, prepared, compare_with_initial_model(setup, prepared.problem, options)


@contextmanager
def _locate_empty_band(method: Section, key: str, name: str) -> Iterator[None]:
    """Context manager that raises a `NoLinesError` of its block again as `StudyError`, with the place of the key.

    `name` is put before the message. The key is the option that the error names, else `key`; without the key in
    ``[method]``, the section alone is named.
    """
    try:
        yield
    except NoLinesError as error:
        key_at_fault = error.option or key
        raise method.error(name + str(error), key_at_fault if key_at_fault in method.table else None) from error


@contextmanager
def placed_mechanism(section: Section) -> Iterator[None]:
    """Context manager: a `SingularModelError`, or an error of a factorization, gets the place of the structure in the study."""
    try:
        yield
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SingularModelError(str(section.error(str(error)))) from error

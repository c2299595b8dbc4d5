"""The study file: structure, unknowns, record and method of one identification, in TOML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from structid.core.display import Overview, Shown, plural
from structid.core.json_types import JsonValue, StoredEntry
from structid.fem import MeasuredComponent, Structure
from structid.forward import ChannelUnknown
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.schema.method import read_method
from structid.study.schema.model.structure import leaves_pieces_open, read_structure, read_tolerances
from structid.study.schema.records.record import RecordSource, read_source
from structid.study.schema.records.sensors import channel_names
from structid.study.schema.section import InputFiles, Section, read_root, record_sections, root_of, title_of
from structid.study.schema.unknowns import CHANNEL_ERROR, read_parameters, read_prior, read_regularization
from structid.unknowns import Parameters

if TYPE_CHECKING:
    from structid.external.solved import SolvedModel


@dataclass(frozen=True, eq=False, repr=False)
class Study(Shown):
    """A study file as read and checked; nothing of the record's content has been read yet.

    Attributes
    ----------
    title : str
    setups : tuple of SetupSource
        One a record: the structure as it was then, its parameters and where the record is.
    options : IdentifyOptions
    root : Section
        The whole file, for the place of errors.
    digests : mapping of str to str
        SHA-256 of the study file and of every file that it names.
    solved : SolvedModel, optional
        What its solver gave.
    measured : mapping
        See `InputFiles`.
    """

    title: str
    setups: tuple[SetupSource, ...]
    options: IdentifyOptions
    root: Section
    digests: Mapping[str, str]
    solved: SolvedModel | None = None
    measured: Mapping[tuple[str, str], MeasuredComponent] = field(default_factory=dict)

    def overview(self) -> Overview:
        """Title and counts, and the parameters with their starts and priors."""
        structure, records = self.structure, plural(len(self.setups), "record")
        words = f"{self.title}: {plural(structure.n_dofs, 'degree')} of freedom, {records}"
        return replace(self.parameters.overview(), words=f"{words}, {self.parameters.overview().words}")

    @property
    def structure(self) -> Structure:
        """Structure of the first set-up."""
        return self.setups[0].structure

    @property
    def parameters(self) -> Parameters:
        """Parameters of the first set-up."""
        return self.setups[0].parameters

    @property
    def record(self) -> RecordSource:
        """Record of the first set-up."""
        return self.setups[0].record

    @property
    def leaves_pieces_open(self) -> bool:
        """True if the error of the mesh decides into how many pieces beams are cut: no number is stated.

        False where a solver gives the model.
        """
        return self.solved is None and leaves_pieces_open(self.root.inner("structure"))

    @property
    def path(self) -> Path:
        return self.root.source.path

    @property
    def text(self) -> str:
        """Text of the study file, word for word."""
        return self.root.source.text

    @property
    def settings(self) -> dict[str, StoredEntry]:
        """All options of the identification as plain values, defaults included: the fields of `IdentifyOptions`.

        The search is under ``search`` in place of ``method``, with its ``type``; each regularization has its ``kind``.
        """
        settings = asdict(self.options)
        settings["search"] = {"type": type(self.options.method).__name__, **settings.pop("method")}
        settings["regularization"] = [
            {"kind": type(term).__name__.lower(), **asdict(term)} for term in self.options.regularization
        ]
        return settings

    def section(self, name: str) -> Section:
        """The table `name` of the study file, or the whole file if there is no such table."""
        return self.root.section(name) or self.root


def load_study(path: str | Path, work: TaskExecutor = SERIAL) -> Study:
    """The study in the TOML file at `path`.

    Parameters
    ----------
    path : path
        The study file.
    work : TaskExecutor
        Executor of a solver's runs, in a study that has a solver.

    Raises
    ------
    InputError
        If the file or a file named in it is missing, a key is unknown, missing or of the wrong kind, or structure and unknowns
        contradict each other; the message has file, line, section and key.
    """
    root, files = read_root(path, work)
    return _make_study(root, files)


def edited_study(study: Study, tables: Mapping[str, JsonValue], work: TaskExecutor = SERIAL) -> Study:
    """The study with the changed `tables` in place of its own, as `load_study` would read it.

    Structures and measured components whose tables and files are unchanged are reused. Errors have the places that the
    original file had.
    """
    files = InputFiles(study.path.parent, dict(study.digests), work, measured=dict(study.measured))
    edited = _make_study(root_of(replace(study.root.source, edited=tables)), files, study.setups)
    return edited if edited.solved is not None else replace(edited, solved=study.solved)


def cut_study(study: Study, count: int) -> Study:
    """The study with `subdivide = count` in its structure: bars and beams that can be cut are cut into so many pieces.

    The same object is returned where they are already.
    """
    if all(source.structure.subdivide == count for source in study.setups):
        return study
    tables = dict(study.root.table)
    tables["structure"] = {**dict(study.section("structure").table), "subdivide": count}
    return edited_study(study, tables)


def _make_study(root: Section, files: InputFiles, before: Sequence[SetupSource] = ()) -> Study:
    """The study of a root section; structures of the set-ups `before` are reused where their tables are unchanged.

    `files` is the list of input files, to which those that are read are added. `StudyError` without ``[record]``, or if
    a section cannot be used.
    """
    if "record" not in root.table:
        raise root.error(
            'the section [record] is missing; add it with the file of the test, `path = "record.csv"`, or plan a test first'
            " with `structid plan`"
        )
    setups = read_setups(root, files, before)
    options = read_method(root.section("method"))
    terms = read_regularization(root, setups[0].structure, setups[0].parameters)
    options = replace(options, regularization=terms, tolerances=read_tolerances(root.inner("structure")))
    solved = files.solved[0] if files.solved else None
    return Study(title_of(root), setups, options, root, files.digests, solved, files.measured)


@dataclass(frozen=True, eq=False)
class SetupSource:
    """One record of a study and what it was measured on; nothing of the record's content has been read yet.

    Attributes
    ----------
    name : str
        "" where the study gives none.
    structure : Structure
        With the changes that ``[record.structure]`` makes.
    parameters : Parameters
        Of that structure.
    record : RecordSource
    channel_unknowns : tuple of ChannelUnknown
    """

    name: str
    structure: Structure
    parameters: Parameters
    record: RecordSource
    channel_unknowns: tuple[ChannelUnknown, ...]

    @property
    def section(self) -> Section:
        """The section ``[record]`` of this set-up."""
        return self.record.section

    def require_channels(self, setup: AnySetup) -> None:
        """Raise `StudyError` at a ``channel_error`` whose channel the record of `setup` lacks, or that repeats an entry."""
        for count, entry in enumerate(self.section.sections("channel_error"), 1):
            with entry.located():
                setup.channel_errors(self.channel_unknowns[:count])


def read_setups(root: Section, files: InputFiles, before: Sequence[SetupSource] = ()) -> tuple[SetupSource, ...]:
    """The set-ups of ``[record]`` or several ``[[record]]``; those with the same tables share one structure.

    Parameters
    ----------
    root : Section
        The whole study file.
    files : InputFiles
        List of input files, to which those of the set-ups are added.
    before : sequence of SetupSource
        Set-ups of an earlier version of the study; their structures are reused where their tables are equal.

    Raises
    ------
    StudyError
        If one of them, the structure or the unknowns cannot be read, or two records have the same name.
    """
    records, structure = record_sections(root), root.inner("structure")
    if not records:
        raise root.error("holds no record; write [record] or [[record]] above its keys", "record")
    made_of = [(_structure_tables(source.section), source.structure) for source in before]
    for record in records:
        tables = _structure_tables(record)
        made = next((earlier for earlier_tables, earlier in made_of if earlier_tables == tables), None)
        made_of.append((tables, made or read_structure(structure, files, record.section("structure"), record)))
    structures = [made for _, made in made_of[len(before) :]]
    set_names = frozenset(element.name for made in structures for element in (*made.elements, *made.sets))
    names: set[str] = set()
    setups = []
    for record, made in zip(records, structures, strict=True):
        unknown = read_parameters(root, made, set_names)
        errors = tuple(_channel_error(entry) for entry in record.sections("channel_error"))
        aimed = channel_names(made)
        source = read_source(record, files, aimed, made.base_supports)
        name = str(record.table.get("name", ""))
        if name and name in names:
            raise record.error(f"two records are called {name!r}; give one of them another name", "name")
        names.add(name)
        setups.append(SetupSource(name, made, unknown, source, errors))
    return tuple(setups)


def _structure_tables(record: Section) -> tuple[object, ...]:
    """All tables that the structure of a record is made of."""
    return record.source.table["structure"], record.table.get("structure"), record.table.get("sensors")


def _channel_error(entry: Section) -> ChannelUnknown:
    return ChannelUnknown(**entry.values(CHANNEL_ERROR), prior=read_prior(entry))

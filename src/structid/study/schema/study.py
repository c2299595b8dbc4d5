"""The study file: structure, unknowns, record and method of one identification, in TOML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from structid.core.display import Overview, Shown, plural
from structid.core.json_types import JsonValue, StoredEntry
from structid.fem import MeasuredComponent, Structure
from structid.identification.options import IdentifyOptions
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.schema.method import read_method
from structid.study.schema.model.structure import leaves_pieces_open, read_tolerances
from structid.study.schema.records.record import RecordSource
from structid.study.schema.records.setups import SetupSource, read_setups
from structid.study.schema.root import InputFiles, read_root, root_of, title_of
from structid.study.schema.section import Section
from structid.study.schema.unknowns import read_regularization
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
        """True if the error of the mesh decides into how many pieces beams are cut: `subdivide = "auto"`."""
        return leaves_pieces_open(self.root.inner("structure"))

    @property
    def path(self) -> Path:
        return self.root.source.path

    @property
    def text(self) -> str:
        """The file, word for word."""
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
    found = _make_study(root_of(replace(study.root.source, edited=tables)), files, study.setups)
    return found if found.solved is not None else replace(found, solved=study.solved)


def cut_study(study: Study, count: int) -> Study:
    """The study with `subdivide = count` in its structure: bars and beams that can be cut are cut into so many pieces."""
    tables = dict(study.root.table)
    tables["structure"] = {**dict(study.section("structure").table), "subdivide": count}
    return edited_study(study, tables)


def _make_study(root: Section, files: InputFiles, before: Sequence[SetupSource] = ()) -> Study:
    """The study of a root section; structures of the set-ups `before` are reused where their tables are unchanged.

    `files` is the list of input files, to which those that are read are added.
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

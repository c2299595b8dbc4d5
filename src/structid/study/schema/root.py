"""The study file as a whole: its text, its sections by name, and the files that it reads."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from structid.core.errors import StudyError
from structid.fem import MeasuredComponent
from structid.files import digest, require_readable
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.schema.kinds import TEXT
from structid.study.schema.section import Section, StudyText
from structid.study.schema.tables import Key, Table

if TYPE_CHECKING:
    from structid.external.solved import SolvedModel

#: Bytes of a study file at most: one with a node a line and a million nodes has 30 MB.
MOST_STUDY_BYTES = 100_000_000
#: Its keys; those of the sections stand where each is read.
SECTIONS = Table(
    {
        "title": Key(TEXT, "The file's name by default"),
        "structure": Key(Table(), "Nodes, elements, supports and ties", required=True),
        "unknown": Key(Table(), "What is to be identified", listed=True),
        "record": Key(Table(), "What was measured; several, as [[record]], are fitted together"),
        "method": Key(Table(), "How it is identified"),
        "regularization": Key(Table(), "What holds parameters that the data do not determine", listed=True),
        "plan": Key(Table(), "What a test that is still to come may use"),
    }
)


@dataclass(frozen=True, eq=False)
class InputFiles:
    """Files named in a study, relative to its folder; a list in the making, used while a study is read.

    Attributes
    ----------
    folder : Path
        Of the study file.
    digests : dict of str to str
        SHA-256 by the name in the study; the last part of it only where that is an absolute path.
    work : TaskExecutor
        Executor of a solver's runs.
    solved : list of SolvedModel
        What the study's solver gave, once it has run.
    measured : dict
        Measured components that were read, by the digest of their file and their table.
    """

    folder: Path
    digests: dict[str, str] = field(default_factory=dict)
    work: TaskExecutor = SERIAL
    solved: list[SolvedModel] = field(default_factory=list)
    measured: dict[tuple[str, str], MeasuredComponent] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """The path of the input file `name` relative to the study's folder; its digest is added to those of the inputs.

        Raises
        ------
        FileError
            If there is no such file, or it is empty or not permitted.
        """
        path = require_readable(self.folder / name)
        self.digests[_told_name(name)] = digest(path)
        return path

    def digest(self, name: str) -> str:
        """Digest of the file `name`, which `path` has read."""
        return self.digests[_told_name(name)]


def _told_name(name: str) -> str:
    """Name of a file of the study in results: without the folders of an absolute path."""
    return Path(name).name if Path(name).is_absolute() else Path(name).as_posix()


def read_root(path: str | Path, work: TaskExecutor = SERIAL) -> tuple[Section, InputFiles]:
    """The root section of the study file at `path`, and the list of its input files, which begins with the study file itself.

    Parameters
    ----------
    path : path
        The study file.
    work : TaskExecutor
        Executor of a solver's runs.

    Raises
    ------
    InputError
        If there is no such file, it is not TOML, or a section is unknown.
    """
    source = read_study_text(path)
    files = InputFiles(source.path.parent, work=work)
    files.path(source.path.name)
    return root_of(source), files


def root_of(source: StudyText) -> Section:
    """The root section of a study file, after a check that the names of its sections are known."""
    root = Section(source, (), source.table)
    root.values(SECTIONS)
    root.section("structure")
    return root


def record_sections(root: Section) -> list[Section]:
    """The sections ``[[record]]`` in order, or the single ``[record]``; an empty list if there is none."""
    if isinstance(root.table.get("record"), list):
        return root.sections("record")
    single = root.section("record")
    return [] if single is None else [single]


def title_of(root: Section) -> str:
    """The title of the study."""
    return str(root.table.get("title", root.source.path.stem))


def read_study_text(path: str | Path) -> StudyText:
    """The text of the study file at `path`, parsed as TOML.

    Raises
    ------
    InputError
        If there is no such file, it is too large, not UTF-8 text, or not TOML; with the line.
    """
    path = require_readable(path)
    if path.stat().st_size > MOST_STUDY_BYTES:
        raise StudyError(
            f"{path}: is larger than {MOST_STUDY_BYTES // 1_000_000} MB, which no study is; keep meshes, matrices and records in"
            " files of their own"
        )
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise StudyError(f"{path}, line {line}: the file is not UTF-8 text; save it as UTF-8") from error
    source = StudyText(path, text)
    try:
        _ = source.table
    except tomllib.TOMLDecodeError as error:
        position = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)", str(error))
        line = int(position[1]) if position and position[1] else text.rstrip().count("\n") + 1
        column = f", column {position[2]}" if position and position[2] else ""
        message = re.sub(r" \(at .*\)$", "", str(error))
        raise StudyError(f"{path}, line {line}{column}: not TOML: {message}; {_syntax_remedy(text, line)}") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, thousands of brackets
        raise StudyError(f"{path}: cannot be read as TOML: {error}; correct what is so long or so deep") from error
    return source


def _syntax_remedy(text: str, line: int) -> str:
    lines = text.splitlines()
    shown = lines[line - 1].strip() if line <= len(lines) else ""
    return f"correct {shown!r}; texts stand in quotes, lists in brackets, each key once in its table"

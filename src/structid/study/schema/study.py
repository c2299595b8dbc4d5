"""The study file: structure, unknowns, record and method of one identification, in TOML."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from structid.files import require_readable
from structid.identification.identify import IdentifyOptions
from structid.structure import Structure
from structid.study.schema.input_files import InputFiles
from structid.study.schema.method import read_method
from structid.study.schema.record import RecordSource
from structid.study.schema.regularization import read_regularization
from structid.study.schema.section import TEXT, Section, StudyError, StudyText
from structid.study.schema.setups import SetupSource, read_setups
from structid.unknowns import Parameters

KNOWN_SECTIONS = ("structure", "unknown", "record", "method", "regularization", "plan")


@dataclass(frozen=True, eq=False)
class Study:
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
    """

    title: str
    setups: tuple[SetupSource, ...]
    options: IdentifyOptions
    root: Section
    digests: Mapping[str, str]

    @property
    def structure(self) -> Structure:
        """Of the first set-up."""
        return self.setups[0].structure

    @property
    def parameters(self) -> Parameters:
        """Of the first set-up."""
        return self.setups[0].parameters

    @property
    def record(self) -> RecordSource:
        """Of the first set-up."""
        return self.setups[0].record

    @property
    def path(self) -> Path:
        return self.root.source.path

    @property
    def text(self) -> str:
        """The file, word for word."""
        return self.root.source.text

    @property
    def settings(self) -> dict[str, Any]:
        """Options with their defaults, as plain values."""
        settings = asdict(self.options)
        settings["search"] = {"type": type(self.options.method).__name__, **settings.pop("method")}
        settings["regularization"] = [
            {"kind": type(term).__name__.lower(), **asdict(term)} for term in self.options.regularization
        ]
        return settings

    def section(self, name: str) -> Section:
        """The table `name` of the file, or the whole file where there is none."""
        return self.root.section(name) or self.root


def load_study(path: str | Path) -> Study:
    """The study in the TOML file at `path`.

    Raises
    ------
    InputError
        If the file or one that it names is missing, a key is unknown, missing or of the wrong kind, or structure
        and unknowns contradict each other; the message gives file, line, section and key.
    """
    source = read_study_text(path)
    root = Section(source, (), source.table)
    given = root.values({"title": TEXT}, others=KNOWN_SECTIONS)
    structure = root.section("structure")
    for name in ("structure", "record"):
        if name not in root.table:
            raise root.error(f"the section [{name}] is missing; add it")
    files = InputFiles(source.path.parent)
    files.path(source.path.name)
    setups = read_setups(root, structure or root, files)
    options = read_method(root.section("method"))
    terms = read_regularization(root, setups[0].structure, setups[0].parameters)
    options = replace(options, regularization=terms)
    return Study(given.get("title", source.path.stem), setups, options, root, files.digests)


def read_study_text(path: str | Path) -> StudyText:
    """The text of the study file at `path`, parsed.

    Raises
    ------
    InputError
        If there is no such file, it is not UTF-8 text, or not TOML.
    """
    path = require_readable(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise StudyError(f"{path}, line {line}: the file is not UTF-8 text; save it as UTF-8") from error
    source = StudyText(path, text)
    try:
        _ = source.table
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)", str(error))
        line = int(place[1]) if place and place[1] else text.rstrip().count("\n") + 1
        column = f", column {place[2]}" if place and place[2] else ""
        what = re.sub(r" \(at .*\)$", "", str(error))
        raise StudyError(f"{path}, line {line}{column}: not TOML: {what}; {_syntax_remedy(text, line)}") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, thousands of brackets
        raise StudyError(f"{path}: cannot be read as TOML: {error}; correct what is so long or so deep") from error
    return source


def _syntax_remedy(text: str, line: int) -> str:
    lines = text.splitlines()
    shown = lines[line - 1].strip() if line <= len(lines) else ""
    return f"correct {shown!r}; texts stand in quotes, lists in brackets, each key once in its table"

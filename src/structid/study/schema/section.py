"""The study file and its tables: keys checked and read, files that it names, and every error told with file, line and key."""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from structid.core.errors import FileError, InputError, StudyError, require_class
from structid.core.json_types import JsonValue
from structid.fem import MeasuredComponent
from structid.files import digest, require_readable
from structid.inversion.search.work import SERIAL, TaskExecutor
from structid.study.schema.tables import TEXT, Given, Key, Kind, Table, own_table
from structid.study.schema.toml_lines import KeyPath, parse_toml, toml_lines

if TYPE_CHECKING:
    from structid.external.solved import SolvedModel

T = TypeVar("T")
_LABEL = re.compile(r"\d{1,9}")


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
class StudyText:
    """The study file as read.

    Attributes
    ----------
    path : Path
    text : str
    edited : mapping, optional
        Tables in place of those of the text.
    """

    path: Path
    text: str
    edited: Mapping[str, JsonValue] | None = None

    @cached_property
    def table(self) -> Mapping[str, JsonValue]:
        """Content of the study as a table, as edited; raises as `parse_toml` where it is not TOML."""
        return parse_toml(self.text) if self.edited is None else self.edited

    @cached_property
    def lines(self) -> Mapping[KeyPath, int]:
        """Line of every path of keys; found when first asked for, as only errors name lines."""
        return toml_lines(self.text)

    def line(self, path: KeyPath) -> int:
        """Line (from 1) of `path`, or of the innermost table around it that has a line."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


@dataclass(frozen=True, eq=False)
class Section:
    """One table of a study file.

    Attributes
    ----------
    source : StudyText
    path : tuple
        Names and positions that lead to it; () for the whole file.
    table : mapping
        Its content.
    """

    source: StudyText
    path: KeyPath
    table: Mapping[str, JsonValue]

    @property
    def title(self) -> str:
        """The header as messages show it, such as ``[[structure.beam]] "deck"``; "top level" for the root.

        An entry of an array of tables has its name or property, or else its number (from 1).
        """
        if not self.path:
            return "top level"
        words = ".".join(str(part) for part in self.path if isinstance(part, str))
        if not isinstance(self.path[-1], int):
            return f"[{words}]"
        name = self.table.get("name") or self.table.get("property")
        return f"[[{words}]] " + (f'"{name}"' if isinstance(name, str) else f"number {self.path[-1] + 1}")

    def error(self, message: str, key: str | None = None) -> StudyError:
        """An error with `message` after file, line and header of this section, and `key` if there is one; it is not raised."""
        line = self.source.line(self.path if key is None else (*self.path, key))
        return StudyError(f"{self.source.path}, line {line}: {self.title}{'' if key is None else ' ' + key}: {message}")

    @contextmanager
    def located(self, key: str | None = None) -> Iterator[None]:
        """Context manager that adds the position of this section and of a key to an `InputError` raised in its block.

        The key is the option that the error names, if the section has it, else `key`; without either only the section is named. The
        error becomes a `StudyError`; one that is a `StudyError` already is left as it is.
        """
        try:
            yield
        except StudyError:
            raise
        except InputError as error:
            raise self.error(str(error), error.option if error.option in self.table else key) from error

    def values(self, table: Table) -> Given:
        """Value of each key of `table` that is present and not itself a table, checked and converted to its kind.

        Defaults are not filled in.

        Raises
        ------
        StudyError
            If a key is unknown (the nearest is named), missing or of the wrong kind.
        """
        keys = table.keys
        if table.labels is not None:
            keys = {**keys, **dict.fromkeys(filter(_LABEL.fullmatch, self.table), Key(table.labels))}
        for name in self.table:
            if name not in keys and table.labels is not None:
                raise self.error("labels must be whole numbers, as in `12 = [0.0, 0.5, 0.0]`", name)
            if name not in keys:
                nearest_keys = " and ".join(
                    f"`{nearest_key}`" for nearest_key in _nearest(name, self.table[name], keys)
                )
                nearest = (
                    f"the nearest {'are' if ' and ' in nearest_keys else 'is'} {nearest_keys}; " if nearest_keys else ""
                )
                raise self.error(f"unknown key; {nearest}valid keys are {', '.join(keys)}", name)
        for name, key in keys.items():
            if key.required and name not in self.table:
                if isinstance(key.holds, Table):
                    raise self.error(f"the section [{self.joined(name)}] is missing; add it")
                raise self.error(f"`{name}` is missing; add `{name} = ...` ({key.holds.words})")
        values = {}
        for name, key in keys.items():
            if name in self.table and isinstance(key.holds, Kind):
                if not key.holds.accepts(self.table[name]):
                    remedy = f"; {key.holds.remedy}" if key.holds.remedy else ""
                    raise self.error(f"must be {key.holds.words}, got {_shown(self.table[name])}{remedy}", name)
                values[name] = key.holds.made(self.table[name])
        return values

    def read(self, make: Callable[..., T]) -> T:
        """The object that `make`, a class or function, makes of the keys of this section as its arguments; see `table_of`."""
        values = self.values(own_table(make))
        with self.located():
            return make(**values)

    def section(self, key: str) -> Section | None:
        """The table `key` inside this one, or None if it is absent; `StudyError` if the key holds no table."""
        if key not in self.table:
            return None
        inner = self.table[key]
        if not isinstance(inner, dict):
            raise self.error(f"must be a table, got {_shown(inner)}; write [{self.joined(key)}] above its keys", key)
        return Section(self.source, (*self.path, key), inner)

    def inner(self, key: str) -> Section:
        """The table `key` inside this one, empty where it is not there."""
        return self.section(key) or Section(self.source, (*self.path, key), {})

    def sections(self, key: str) -> list[Section]:
        """The entries of the array of tables `key` inside this one, in order; an empty list if it is absent.

        `StudyError` if the key holds anything else.
        """
        entries = self.table.get(key, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise self.error(f"must be an array of tables; write [[{self.joined(key)}]] above each entry", key)
        return [Section(self.source, (*self.path, key, i), entry) for i, entry in enumerate(entries)]

    def joined(self, key: str) -> str:
        """Header of the table `key` inside this one, without its brackets."""
        return ".".join([str(part) for part in self.path if isinstance(part, str)] + [key])


#: Words that are often written for keys of other spelling.
_MEANT = {
    "tolerance": ("prior", "calibration"),
    "file": ("path",),
    "filename": ("path",),
    "EI": ("bending_stiffness", "bending_stiffness_y", "bending_stiffness_z"),
    "EA": ("axial_stiffness",),
    "GJ": ("torsional_stiffness",),
    "E": ("youngs_modulus", "bending_stiffness", "bending_stiffness_y"),
    "k": ("stiffness",),
    "c": ("damping",),
    "m": ("mass",),
}


def _nearest(name: str, value: JsonValue, keys: Mapping[str, Key]) -> list[str]:
    """Names of the keys most similar to `name`: those of the highest ratio of common letters, several in a tie.

    They are sought among keys that may hold a table if `value` is one, else a plain value; among all if there are none.
    A word that usually stands for known keys has these instead, as far as `keys` has them.
    """
    meant = [key_name for key_name in _MEANT.get(name, ()) if key_name in keys]
    if meant:
        return meant
    in_tables = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(entry, dict) for entry in value))
    comparable = [
        key_name for key_name, key in keys.items() if (key.holds_tables if in_tables else key.holds_values)
    ] or keys
    ratios = {key_name: difflib.SequenceMatcher(None, key_name, name).ratio() for key_name in comparable}
    return [key_name for key_name, ratio in ratios.items() if ratio == max(ratios.values())]


def _shown(value: JsonValue) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


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
    """The root section of a study file.

    `StudyError` if a section is unknown or missing, or ``structure`` is no table.
    """
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
    """The title of a study, by default the name of its file without the suffix; `root` is its root section."""
    return str(root.table.get("title", root.source.path.stem))


def read_study_text(path: str | Path) -> StudyText:
    """The text of the study file at `path`, parsed as TOML.

    Raises
    ------
    InputError
        If there is no such file, it is too large, not UTF-8 text, or not TOML; with the line.
    """
    require_class("path", path, (str, os.PathLike), "give the path of a study file")
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
        if path.suffix.lower() != ".toml" and "structure" not in text:
            raise FileError(
                f"{path}: is no study; a study is a text file in TOML; `structid init` writes one, and a record is named in it"
                " as `path` of [record]"
            ) from error
        raise StudyError(f"{path}, line {line}{column}: not TOML: {message}; {_syntax_remedy(text, line)}") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, thousands of brackets
        raise StudyError(f"{path}: cannot be read as TOML: {error}; correct what is so long or so deep") from error
    return source


def _syntax_remedy(text: str, line: int) -> str:
    lines = text.splitlines()
    shown = lines[line - 1].strip() if line <= len(lines) else ""
    return f"correct {shown!r}; texts stand in quotes, lists in brackets, each key once in its table"

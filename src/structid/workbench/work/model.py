"""A study's structure and record as the page asks for them, of one record of several, and the element types that it edits."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from structid.core.constraints import parameter_descriptions
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.external.runs import Solver
from structid.fem import ELEMENT_TYPES, Structure
from structid.fem.elements.element import declarations
from structid.inversion.search.work import SerialExecutor, StageProgress, Task
from structid.study.schema.model.structure import read_structure
from structid.study.schema.records.record import RecordSource, read_source
from structid.study.schema.records.sensors import channel_names
from structid.study.schema.section import Section, read_root, record_sections

#: Element types whose properties the page can edit.
EDITED = ("beam", "bar", "space_beam", "point_mass", "spring")


@dataclass(frozen=True)
class ReadModel:
    """A study's structure as it was under one of its records.

    Attributes
    ----------
    root : Section
        The study.
    record : Section or None
        ``[record]``, or one of several; None where there is none yet.
    structure : Structure
        With the changes that the record makes.
    """

    root: Section
    record: Section | None
    structure: Structure


def read_model(path: Path, number: int = 0) -> ReadModel:
    """Structure of the study at `path` as it was under its record `number` (counted from 0), with the study's sections.

    Without any record, number 0 gives the structure alone.

    Raises
    ------
    InputError
        If the file or its structure cannot be used, or there are records but none of this number.
    """
    root, files = read_root(path, work=LOOKING)
    record = _record(root, number)
    changes = record.section("structure") if record is not None else None
    return ReadModel(root, record, read_structure(root.inner("structure"), files, changes, record))


def read_record_section(path: Path, number: int = 0) -> Section:
    """Section of record `number` (counted from 0) of the study at `path`, the only ``[record]`` or one of several.

    Raises
    ------
    InputError
        If there is none.
    """
    return _required(_record(read_root(path, work=LOOKING)[0], number))


def _required(record: Section | None) -> Section:
    """`record`, or `InputError` if it is None: the study has no record yet."""
    if record is None:
        raise InputError("the study has no record yet: drop a record file on the start page, and use it in this study")
    return record


def read_record_source(path: Path, number: int = 0) -> tuple[Section, RecordSource]:
    """Root section of the study at `path`, and the source of its record `number` (counted from 0).

    Files of the other records may be missing.

    Raises
    ------
    InputError
        If the file, its structure or this record cannot be used.
    """
    root, files = read_root(path, work=LOOKING)
    record = _required(_record(root, number))
    structure = read_structure(root.inner("structure"), files, record.section("structure"), record)
    aimed = channel_names(structure)
    return root, read_source(record, files, aimed, structure.base_supports)


def _record(root: Section, number: int) -> Section | None:
    """Section of record `number` (counted from 0) of a study; None if the study has no records.

    Raises `InputError` if it has records, but none of this number. `root` is the top section of the study.
    """
    listed = record_sections(root)
    if not 0 <= number < max(len(listed), 1):
        raise InputError(f"the study has {len(listed)} records and none of number {number + 1}; it was changed since")
    return listed[number] if listed else None


class Looking(SerialExecutor):
    """Work that refuses to run solvers; stored runs are still read."""

    def map(
        self,
        name: str,
        task: Task,
        shared: Any,
        items: Sequence[Any],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[Any]:
        """Results of `task` for each of `items`, as from `SerialExecutor.map`, without ever starting a solver.

        Raises
        ------
        InputError
            If `shared` is a solver, which would have to run.
        """
        if isinstance(shared, Solver):
            raise InputError(
                f"[structure.solver] names a program that has yet to run {len(items)} times ({shared.command}), and looking at a"
                " study runs none: where you trust the study, start a run, or `structid check` in a terminal; both keep what"
                " the program gives"
            )
        return super().map(name, task, shared, items, progress, first)


LOOKING = Looking()


def element_kinds() -> dict[str, StoredEntry]:
    """Keys of each element type that the page can edit, by type: a list of mappings, one for each key.

    They have ``name``, ``unit``, ``words`` (description) and ``required`` (True if there is no default).
    """
    kinds: dict[str, StoredEntry] = {}
    for name in EDITED:
        kind = ELEMENT_TYPES[name]
        declared, words = declarations(kind), parameter_descriptions(kind)
        kinds[name] = [
            {
                "name": item.name,
                "unit": declared[item.name].unit,
                "words": words.get(item.name, ""),
                "required": item.default is dataclasses.MISSING,
            }
            for item in dataclasses.fields(kind)
            if item.init
        ]
    return kinds

"""The ``[record.modes]`` of a study file: measured modes in place of responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from structid.dof import Dof, parse_dofs, renamed
from structid.identification.modal_setup import ModalSettings, chosen_modes
from structid.modal import ModalRecord
from structid.modal.files.files import read_modes
from structid.observation import ModalProblem
from structid.study.schema.kinds import COUNT, Kind, as_list, list_of
from structid.study.schema.root import InputFiles
from structid.study.schema.section import Section
from structid.study.schema.sensors import used_names
from structid.study.schema.tables import Key, Table, table_of

_NUMBERS = Kind("numbers of modes, counted from 1, as in [1, 2, 4]", list_of(COUNT.schema), made=tuple)
MODES = table_of(ModalSettings, words_of=ModalProblem) | {"use": Key(_NUMBERS, "Numbers of the modes; all by default")}


@dataclass(frozen=True, eq=False)
class ModesSource:
    """Where the modes of a study are, and how they are fitted.

    Attributes
    ----------
    section : Section
        ``[record]``, for the place of errors.
    path : Path
    use : tuple of int
        Numbers of the modes that are fitted, from 1; all if empty.
    channels_used : tuple of Dof
        Sensors used; all if empty.
    relabel : mapping of str to str
        See `renamed`.
    settings : ModalSettings
    aimed : mapping of str to str
        See `RecordSource`.
    """

    section: Section
    path: Path
    use: tuple[int, ...]
    channels_used: tuple[Dof, ...]
    relabel: Mapping[str, str]
    settings: ModalSettings
    aimed: Mapping[str, str]

    @property
    def modes_section(self) -> Section:
        """``[record.modes]``."""
        return self.section.section("modes") or self.section

    def load(self) -> ModalRecord:
        """The modes and sensors that are used.

        Raises
        ------
        StudyError
            If the file is damaged, or lacks a mode or sensor that the study asks for.
        """
        with self.section.located("path"):
            record = read_modes(self.path)
        with self.section.located("relabel"):
            record = replace(record, channels=renamed(record.channels, (), self.relabel)[0])
        with self.section.located("sensors"):
            renamed(record.channels, (), self.aimed)  # whether every channel is there
        with self.modes_section.located("use"):
            record = chosen_modes(record, self.use)
        if self.channels_used:
            place = {dof.unsigned: i for i, dof in enumerate(record.channels)}
            for dof in self.channels_used:
                if dof.unsigned not in place:
                    known = ", ".join(map(str, record.channels))
                    raise self.section.error(f"the modes have no sensor {dof}; they have {known}", "channels_used")
            record = record.some_channels([place[dof.unsigned] for dof in self.channels_used])
        with self.section.located("sensors"):
            return replace(record, channels=renamed(record.channels, (), used_names(self.aimed, record.channels))[0])


def read_modes_source(section: Section, table: Table, files: InputFiles, aimed: Mapping[str, str]) -> ModesSource:
    """The source that a ``[record]`` with ``[record.modes]`` describes, its file found but not read.

    `table` has the keys of such a record.
    """
    given = section.values(table)
    with section.located("path"):
        path = files.path(given["path"])
    with section.located("channels_used"):
        used = parse_dofs(as_list(given.get("channels_used", [])))
    inner = section.section("modes")
    own = {} if inner is None else inner.values(MODES)
    return ModesSource(section, path, own.pop("use", ()), used, given.get("relabel", {}), ModalSettings(**own), aimed)

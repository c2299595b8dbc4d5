"""The ``[record.modes]`` of a study file: measured modes in place of responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from structid.core.constraints import Positive
from structid.core.dof import Dof, parse_dofs, renamed
from structid.core.errors import InputError
from structid.forward import ModalSettings
from structid.identification.setups.modal import chosen_modes
from structid.modal import ModalRecord, formats
from structid.modal.formats.options import ModeFileOptions
from structid.modal.modal_record import independent_errors, largest_entries
from structid.study.schema.records.sensors import used_names
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import COUNT, Key, Kind, Table, as_list, list_of, table_of

_NUMBERS = Kind("numbers of modes, counted from 1, as in [1, 2, 4]", list_of(COUNT.schema), made=tuple)


@dataclass(frozen=True)
class ModeDeviations:
    """Standard deviations that a file of modes lacks; each one for all modes of the file, or one a mode."""

    frequency_std: Annotated[tuple[Positive, ...], "Of the frequencies, Hz; of a file that says none"] = ()
    damping_std: Annotated[tuple[Positive, ...], "Of the damping ratios; of a file that says none"] = ()
    shape_std: Annotated[
        tuple[Positive, ...], "Of shape entries, in parts of the largest; of a file that says none"
    ] = ()

    def added_to(self, record: ModalRecord) -> ModalRecord:
        """The modal record with the stated standard deviations of frequencies (Hz), damping ratios and shapes.

        Those of a shape are the stated part of its largest entry; what is not stated stays as the record has it.

        Raises
        ------
        InputError
            If the record has standard deviations of its own, or their number is not that of the modes.
        """
        n = record.n_modes
        stated = {name: self._value_of_each_mode(name, n) for name in (item.name for item in fields(self))}
        frequency, damping, shape = (stated[name] for name in ("frequency_std", "damping_std", "shape_std"))
        of_record = record.std.reshape(2, n)
        for what, std, existing, other in (
            ("frequencies", frequency, of_record[0], "frequency_error"),
            ("damping ratios", damping, of_record[1], "damping_error"),
        ):
            self._require_none(
                f"standard deviations of {what}", std is not None and not np.isnan(existing).all(), other
            )
        if frequency is not None or damping is not None:
            stds = np.concatenate(
                [
                    existing if std is None else std
                    for std, existing in zip((frequency, damping), of_record, strict=True)
                ]
            )
            record = replace(record, covariance=independent_errors(stds))
        if shape is not None:
            self._require_none("standard deviations of shapes", record.shape_std is not None, "shape_error")
            entries = np.broadcast_to(shape * largest_entries(record.mode_shapes), record.mode_shapes.shape)
            record = replace(record, shape_std=entries)
        return record

    def _value_of_each_mode(self, name: str, n: int) -> np.ndarray | None:
        """One value for each of `n` modes from the field `name`, (n,), or None if it is empty.

        `InputError` if the field has neither one value nor `n`.
        """
        values = getattr(self, name)
        if len(values) not in (0, 1, n):
            raise InputError(f"`{name}` must be one number or {n}, one for each mode of the file, got {len(values)}")
        return np.broadcast_to(np.asarray(values, float), (n,)) if values else None

    @staticmethod
    def _require_none(what: str, is_there: bool, other: str) -> None:
        if is_there:
            raise InputError(f"the file has {what} of its own; leave them out, or add a stated error with `{other}`")


MODES = (
    table_of(ModalSettings)
    | table_of(ModeDeviations).keys
    | table_of(ModeFileOptions).keys
    | {"use": Key(_NUMBERS, "Numbers of the modes; all by default")}
)


@dataclass(frozen=True, eq=False)
class ModesSource:
    """Source of the modes of a study, and options of their fit.

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
    deviations : ModeDeviations
    file_options : ModeFileOptions
    """

    section: Section
    path: Path
    use: tuple[int, ...]
    channels_used: tuple[Dof, ...]
    relabel: Mapping[str, str]
    settings: ModalSettings
    aimed: Mapping[str, str]
    deviations: ModeDeviations = ModeDeviations()
    file_options: ModeFileOptions = field(default_factory=ModeFileOptions)

    @property
    def modes_section(self) -> Section:
        """The section ``[record.modes]``, or ``[record]`` if there is none."""
        return self.section.section("modes") or self.section

    def load(self) -> ModalRecord:
        """The modes and sensors of the file that are used, with names, directions and deviations that the study states.

        Raises
        ------
        StudyError
            If the file is damaged, or lacks a mode or sensor that the study asks for.
        """
        with self.section.located("path"):
            record = formats.read_modes(self.path, self.file_options)
        with self.section.located("relabel"):
            record = replace(record, channels=renamed(record.channels, (), self.relabel)[0])
        with self.section.located("sensors"):
            renamed(record.channels, (), self.aimed)  # whether every channel is there
        with self.modes_section.located():
            record = self.deviations.added_to(record)
        with self.modes_section.located("use"):
            record = chosen_modes(record, self.use)
        if self.channels_used:
            index_of = {dof.unsigned: i for i, dof in enumerate(record.channels)}
            for dof in self.channels_used:
                if dof.unsigned not in index_of:
                    names = ", ".join(map(str, record.channels))
                    raise self.section.error(f"the modes have no sensor {dof}; they have {names}", "channels_used")
            record = record.some_channels([index_of[dof.unsigned] for dof in self.channels_used])
        with self.section.located("sensors"):
            return replace(record, channels=renamed(record.channels, (), used_names(self.aimed, record.channels))[0])


def read_modes_source(section: Section, table: Table, files: InputFiles, aimed: Mapping[str, str]) -> ModesSource:
    """The source that a ``[record]`` with ``[record.modes]`` describes; its file must exist but is not read.

    `table` has the valid keys of ``[record]``, `aimed` the structure's names of aimed sensors. The file is added to `files`.
    """
    values = section.values(table)
    with section.located("path"):
        path = files.path(values["path"])
    with section.located("channels_used"):
        used = parse_dofs(as_list(values.get("channels_used", [])))
    inner = section.section("modes")
    mode_values = {} if inner is None else inner.values(MODES)
    names = [item.name for item in fields(ModeDeviations)]
    deviations = ModeDeviations(
        **{name: tuple(as_list(mode_values.pop(name))) for name in names if name in mode_values}
    )
    named = {item.name: mode_values.pop(item.name) for item in fields(ModeFileOptions) if item.name in mode_values}
    if "deck" in named:
        with (inner or section).located("deck"):
            named["deck"] = files.path(named["deck"])
    with (inner or section).located():
        file_options = ModeFileOptions(**named)
    chosen, relabel = mode_values.pop("use", ()), values.get("relabel", {})
    return ModesSource(
        section, path, chosen, used, relabel, ModalSettings(**mode_values), aimed, deviations, file_options
    )

"""The ``[[structure.measured_component]]`` of a study file: parts that have no model but measured FRFs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import MeasuredComponent
from structid.records import FrfRecord
from structid.records.formats import ReadOptions
from structid.study.schema.kinds import TEXTS, as_list
from structid.study.schema.records.record import load_record, read_source, record_table
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import Key, Table

_RECORD = record_table(Table())
#: All keys of a measured component: those that say how a record is read, and its own.
MEASURED = _RECORD.only("relabel", "frf", "noise", *(one.name for one in fields(ReadOptions))) | {
    "name": replace(_RECORD.keys["name"], words="What messages call it", required=True),
    "path": replace(
        _RECORD.keys["path"],
        words="Its FRFs, measured by itself: a file as records are, see docs/record-files.md",
        required=True,
    ),
    "interface": Key(TEXTS, "Degrees of freedom at which it moves with the model; all sensors of the file by default"),
}


def read_measured(entry: Section, files: InputFiles, dofs_of_set: Callable[[str], list[Dof]]) -> MeasuredComponent:
    """The component that an entry of ``[[structure.measured_component]]`` describes; an equal entry is read only once.

    Parameters
    ----------
    entry : Section
        The entry.
    files : InputFiles
        List of input files, to which the component's file is added.
    dofs_of_set : callable
        Gives the degrees of freedom of a text of `interface`, and checks that they are at nodes of the structure.

    Raises
    ------
    StudyError
        If its file cannot be read, or does not hold FRFs between all degrees of freedom of the interface.
    """
    source, given = read_source(entry, files, keys=MEASURED), entry.values(MEASURED)
    named = [dof for text in as_list(given.get("interface", ())) for dof in dofs_of_set(text)]
    key = files.digest(given["path"]), repr(entry.table)
    if key not in files.measured:
        files.measured[key] = _make_component(entry, given["name"], load_record(source), named)
    return files.measured[key]


def _make_component(entry: Section, name: str, record: FrfRecord, named: list[Dof]) -> MeasuredComponent:
    """The component called `name` from an FRF record, at the degrees of freedom `named` or, if empty, at all its sensors.

    Its FRFs are receptances along the positive directions, at frequencies above 0. `entry` is the table of the component, at which
    `StudyError` points if a channel is missing.
    """
    interface = tuple(dict.fromkeys(dof.unsigned for dof in named or record.outputs))
    with entry.located("interface" if named else "path"):
        rows, columns = (_channel_indices(record, role, interface) for role in ("outputs", "inputs"))
        moving = record.lines(record.frequency > 0).as_kind("receptance")
        values = moving.values[:, rows[0][:, None], columns[0]] * np.outer(rows[1], columns[1])
        variance = None if moving.variance is None else moving.variance[:, rows[0][:, None], columns[0]]
        return MeasuredComponent(name, interface, moving.frequency, values, record.source, variance)


def _channel_indices(record: FrfRecord, role: str, interface: tuple[Dof, ...]) -> tuple[IntArray, FloatArray]:
    """Index and sign (1 or -1) of the channel of a record at each degree of freedom of `interface`, both (n_interface,).

    `role` is "outputs" or "inputs"; `InputError` if a channel is missing.
    """
    channels = {"outputs": record.outputs, "inputs": record.inputs}
    index_of = {dof.unsigned: index for index, dof in enumerate(channels[role])}
    missing = [dof.place for dof in interface if dof not in index_of]
    if missing:
        raise InputError(
            f"{record.source} has no {role.removesuffix('s')} {', '.join(missing)}: a component needs FRFs from loads at all"
            f" degrees of freedom of its interface to sensors at all of them, and the file has outputs {join_words(record.outputs)}"
            f" and inputs {join_words(record.inputs)}; measure the rest, correct names by `relabel`, or leave some out of"
            " `interface`"
        )
    index = np.array([index_of[dof] for dof in interface])
    return index, np.array([float(channels[role][k].sign) for k in index])

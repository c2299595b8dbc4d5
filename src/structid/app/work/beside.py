"""Measured modes beside those of a study's model, as the page shows them: frequencies side by side, MAC, pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.app.work.model import ReadModel
from structid.correlation.correlating import values_at
from structid.correlation.modes import correlated_modes
from structid.dof import parse_dofs, renamed
from structid.errors import InputError
from structid.modal import ModalRecord
from structid.study.results.values import stored_values
from structid.study.schema.records.sensors import channel_names, used_names
from structid.study.schema.unknowns import read_parameters


def posted_modes(given: dict[str, Any]) -> ModalRecord:
    """Modes that the page has found and not saved yet, shapes as `picked` told them.

    Raises
    ------
    InputError
        If there is none.
    """
    if not given["frequency"]:
        raise InputError("no mode is taken that has a shape; take one, or save the modes first")
    shapes = np.array(given["shapes"], dtype=float).T
    return ModalRecord(given["frequency"], given["damping"], shapes, parse_dofs(given["channels"]), source="the page")


def beside(model: ReadModel, measured: ModalRecord, results: Path | None) -> dict[str, Any]:
    """`measured` beside the modes of `model` at its start values, or at those that the folder `results` holds.

    Channels are renamed as the record of the study says, where it has them.

    Raises
    ------
    InputError
        If a channel is not part of the structure, or the folder holds no value of the study's parameters.
    """
    structure, unknown = model.structure, read_parameters(model.root, model.structure)
    known = {} if results is None else stored_values(results)
    values = unknown.values(values_at(unknown.names, unknown.start, known))
    aimed = channel_names(structure)
    given = {} if model.record is None else model.record.inner("relabel").table
    relabel = {name: str(own) for name, own in given.items()}
    channels = measured.channels
    for names in (relabel, aimed):
        channels = renamed(channels, (), used_names(names, channels))[0]
    found = correlated_modes(structure, values, replace(measured, channels=channels))
    pairing, shown = found.pairing, found.shown
    column = {int(mode): k for k, mode in enumerate(shown)}
    return {
        "frequency": found.measured.frequency,
        "model": found.model.frequency[shown],
        "number": shown + 1,
        "mac": pairing.mac[:, shown],
        "pair": [column.get(int(mode)) for mode in pairing.number],
        "together": [[column[k] for k in pairing.partners(i) if k in column] for i in range(found.measured.n_modes)],
        "difference": found.frequency_difference,
        "likeness": pairing.likeness,
        "remarks": [found.remark(i) for i in range(found.measured.n_modes)],
        "warnings": found.warnings,
        "sensors": len(channels),
    }

"""Sliding amplitudes of friction elements from the sensors that they name."""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.errors import InputError
from structid.records import FrfRecord
from structid.structure import Friction, Structure


def sliding_amplitudes(structure: Structure, record: FrfRecord) -> dict[str, FloatArray]:
    """Measured sliding amplitude per unit drive of the friction elements that name sensors.

    Raises
    ------
    InputError
        If a friction element names a sensor that the record lacks, or the record has several loads.
    """
    amplitudes = {}
    for element in structure.elements:
        if not isinstance(element, Friction) or not element.measured_by:
            continue
        require_one_load(element, record)
        measured = record.channels(_as_recorded(element.measured_by, record)).as_kind("receptance")
        signs = np.array([dof.sign for dof in measured.outputs])
        amplitudes[element.name] = element.sliding(measured.values[:, :, 0] * signs)
    return amplitudes


def _as_recorded(wanted: tuple[Dof, ...], record: FrfRecord) -> tuple[Dof, ...]:
    """The record's own outputs at the same places and directions, whatever their sense."""
    own = {dof.unsigned: dof for dof in record.outputs}
    return tuple(own.get(dof.unsigned, dof) for dof in wanted)


def require_one_load(element: Friction, record: FrfRecord) -> None:
    """Raise `InputError` unless the record has one load: friction makes the response to each load its own."""
    if len(record.inputs) != 1:
        raise InputError(f"friction {element.name!r} needs a record with one load, got {len(record.inputs)}")

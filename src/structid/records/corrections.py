"""Corrections of what a record is taken for: the names of its channels, the segments behind its averages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from structid.core.dof import renamed
from structid.core.errors import InputError
from structid.records.record import LOADS, FrfRecord, TimeRecord

R = TypeVar("R", bound=FrfRecord | TimeRecord)

#: Largest difference of line spacings that rounding explains, as a part of their mean.
_EVEN = 0.02


def rename_channels(record: R, names: Mapping[str, str]) -> R:
    """The record with its channels renamed by `names`, as in `structid.core.dof.renamed`; values and order stay.

    Outputs and inputs of FRFs, and motions and loads of time histories, are renamed separately. An empty mapping returns
    `record` itself.
    """
    if not names:
        return record
    if isinstance(record, FrfRecord):
        outputs, inputs = renamed(record.outputs, record.inputs, names)
        return replace(record, outputs=outputs, inputs=inputs)
    is_load = [quantity in LOADS for quantity in record.quantities]
    pairs = list(zip(record.channels, is_load, strict=True))
    sensors, loads = renamed([dof for dof, load in pairs if not load], [dof for dof, load in pairs if load], names)
    left, right = iter(sensors), iter(loads)
    return replace(record, channels=tuple(next(right if load else left) for load in is_load))


def segment_duration(record: FrfRecord) -> float:
    """Duration in s of the averaged segments behind an FRF record: 1 over the spacing of its lines.

    Raises
    ------
    InputError
        If the lines are not evenly spaced, or there is only one.
    """
    gaps = np.diff(record.frequency)
    if not len(gaps) or np.ptp(gaps) > _EVEN * gaps.mean():
        raise InputError("the lines are not evenly spaced, so that they do not tell how long the segments were")
    return float(1 / gaps.mean())

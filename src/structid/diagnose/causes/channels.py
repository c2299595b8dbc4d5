"""Sensors and loads of a record, among which candidates are enumerated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.diagnose.receptances import Receptances

#: Factors, as logarithms, and parts of the period of the highest line, that are tried.
FACTORS = np.array([0.005, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])
#: By which a channel may be turned, rad.
ANGLES = np.radians([3.0, 8.0, 15.0, 25.0, 40.0, 60.0, 90.0, -3.0, -8.0, -15.0, -25.0, -40.0, -60.0, -90.0])
#: Steps on a number of a study whose fit is bracketed.
NUMBER_STEPS = (1.6, 1.25, 1.1, 1.04, 1.015)


class Channel(NamedTuple):
    """A sensor (axis 1 of the FRF) or a load (axis 2) of a record, its number, and how many of them there are."""

    record: int
    axis: int
    number: int
    dof: Dof
    n_alike: int


def channels(records: Sequence[Receptances], axis: int) -> Iterator[tuple[Receptances, Channel]]:
    """Pairs (receptances of the record, channel) of every sensor (`axis` 1) or load (`axis` 2) of all records.

    `records` are the receptances of each record. A channel has the index of its record and of itself, from 0, and the
    number of channels of its kind.
    """
    for number, receptances in enumerate(records):
        dofs = receptances.problem.record.outputs if axis == 1 else receptances.problem.record.inputs
        for index, dof in enumerate(dofs):
            yield receptances, Channel(number, axis, index, dof, len(dofs))


def index_of(receptances: Receptances, axis: int, place: str) -> int:
    """Position of the channel at a place such as ``3X`` among the sensors (axis 1) or loads (axis 2) of the record.

    Raises
    ------
    ValueError
        If there is no channel at the place.
    """
    dofs = receptances.problem.record.outputs if axis == 1 else receptances.problem.record.inputs
    return [dof.place for dof in dofs].index(place)


def other_directions(receptances: Receptances, dof: Dof) -> Iterator[tuple[str, FloatArray]]:
    """Pairs (name, weights) of the other directions in which the node of `dof` moves, weights (n_dofs,).

    Of a translation these are the other translations, of a rotation the other rotations.
    """
    for other, column in receptances.columns.items():
        if other.node == dof.node and other.direction != dof.direction and other.is_rotation == dof.is_rotation:
            yield other.place, column

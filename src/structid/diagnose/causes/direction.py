"""A sensor or load is turned towards another direction of its node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError
from structid.diagnose.causes.candidate import ANGLES, NUMBER_STEPS, Candidate, channels, index_of, other_directions
from structid.diagnose.effects import channel_change, channel_reading
from structid.diagnose.model_edits import AddNode, AddPart, AimSensor, Edits, HoldSupports, renamed_channels, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel

#: Angle, rad, within which a sensor that is turned stands at right angles.
_SQUARE = 0.03
_BOUNDS = (-np.pi, np.pi)


def _effect(
    receptances: Receptances, axis: int, dof_names: Sequence[str], sign: int, angles: FloatArray
) -> ComplexArray:
    """Changes of the FRF, (n_angles, n_lines, n_outputs, n_inputs), by turning a sensor or a load.

    `dof_names` are the degree of freedom of the sensor (`axis` 1) or load (`axis` 2) and the one that it turns to, the
    latter in the sense `sign` (1 or -1); `angles` (n_angles,) are in rad.
    """
    index = index_of(receptances, axis, dof_names[0])
    column = sign * receptances.columns[parse_dof(dof_names[1])]
    own = receptances.frf.take(index, axis)
    turns = angles[:, None, None]
    reading = channel_reading(receptances, axis, index, column[None])
    return channel_change(receptances, axis, index, (np.cos(turns) - 1) * own + np.sin(turns) * reading)


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorDirection(Candidate):
    """A sensor that is turned by an angle, rad, towards another direction of its node."""

    kind: ClassVar[str] = "direction"
    other_strengths: ClassVar[tuple[float, ...]] = NUMBER_STEPS
    strengths: FloatArray
    bounds: tuple[float, float] = _BOUNDS
    record: int | None = 0

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for receptances, channel in channels(records, 1):
            for place, _ in other_directions(receptances, channel.dof):
                yield cls(where=(channel.dof.place, place), strengths=ANGLES, record=channel.record)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 1, self.where, 1, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits for a sensor that is turned by `strength` rad towards another direction of its node.

        Within 0.03 rad of a right angle the channel is renamed, with a minus sign for a negative angle; else the sensor
        is aimed along the weighted directions at a new node of `model`.

        Raises
        ------
        InputError
            If the sensor measures a rotation and is not at a right angle.
        """
        record, names = self.record or 0, self.where
        dofs = [parse_dof(name) for name in names]
        if abs(abs(strength) - np.pi / 2) < _SQUARE:
            return [renamed_channels(model, record, {names[0]: names[1] if strength > 0 else f"{names[1]}-"})]
        vector = [0.0, 0.0, 0.0]
        for dof, part in zip(dofs, (np.cos(strength), np.sin(strength)), strict=True):
            if dof.is_rotation:
                raise InputError(f"{dof} is a rotation, and a sensor is aimed along translations")
            vector[dof.axis] = rounded(float(part))
        x, y, z = vector
        return [AimSensor(record, dofs[0], (x, y, z), model.new_node())]

    def sentence(self, value: float | None) -> str:
        return f"sensor {self.where[0]} is turned towards {self.where[1]}"


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadDirection(Candidate):
    """A load that is turned by an angle, rad, towards another direction of its node."""

    kind: ClassVar[str] = "load_direction"
    result_kind: ClassVar[str] = "direction"
    other_strengths: ClassVar[tuple[float, ...]] = NUMBER_STEPS
    strengths: FloatArray
    bounds: tuple[float, float] = _BOUNDS
    record: int | None = 0
    sign: int = 1

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """Candidate turns of each measured force towards every other direction of its node; none for motions of supports.

        `records` are the receptances of each record. Strengths are angles, 3 to 90 degrees either way, in rad.
        `record_names` are not used.
        """
        for receptances, channel in channels(records, 2):
            if not receptances.problem.facts.measures_force:
                continue
            for place, _ in other_directions(receptances, channel.dof):
                where = (channel.dof.place, place)
                yield cls(where=where, strengths=ANGLES, record=channel.record, sign=channel.dof.sign)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 2, self.where, self.sign, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        """Edits that let the load act on a new node of `model`, whose motion is a weighted sum of both directions.

        The weights are cosine (present direction) and sine (other direction) of `strength`, the angle in rad.
        """
        dof, label = parse_dof(self.where[0]), model.new_node()
        weights = (np.cos(strength), np.sin(strength))
        pairs = [[name, rounded(float(part))] for name, part in zip(self.where, weights, strict=True)]
        name = model.unique_name(f"drive {self.where[0]}")
        return follower(model, self.record or 0, name, dof, label, pairs, AddNode(label, dof.node), "load ")

    def sentence(self, value: float | None) -> str:
        return f"the force at {self.where[0]} is turned towards {self.where[1]}"


def follower(
    model: TestedModel,
    record: int,
    tie_name: str,
    dof: Dof,
    new_label: int,
    weighted_dofs: Sequence[object],
    node: AddNode,
    role_prefix: str,
) -> Edits:
    """Edits that let a channel of a record act at a new node, which follows weighted degrees of freedom through a tie.

    Parameters
    ----------
    model : TestedModel
    record : int
        Index of the record, from 0.
    tie_name : str
        Name of the new tie.
    dof : Dof
        The channel's present degree of freedom; the new node moves in its direction.
    new_label : int
        Label of the new node, supported in all other directions.
    weighted_dofs : sequence of (name, weight)
        Degrees of freedom that the new node follows.
    node : AddNode
        The edit that adds the node.
    role_prefix : str
        "load " for a load, "" for a sensor.

    Returns
    -------
    list of Edit
        In this order: the node, the tie, the supports, and the new name of the channel.
    """
    acts = f"{new_label}{dof.direction}"
    active = model.setups[record].structure.active or DIRECTIONS
    held = tuple(f"{new_label}{direction}" for direction in active if direction != dof.direction)
    return [
        node,
        AddPart("constraint", {"name": tie_name, "dependent": acts, "depends_on": list(weighted_dofs)}),
        HoldSupports(held),
        renamed_channels(model, record, {f"{role_prefix}{dof.place}": acts}),
    ]

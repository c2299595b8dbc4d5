"""``[record.sensors]``: channels that read along a direction of their own, at a node or at the node nearest to a point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from structid.core.constraints import Positive
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.fem.measuring_points import AimedSensor, nearest_nodes, unit_direction
from structid.study.schema.section import Section
from structid.study.schema.tables import POSITION, VECTOR, Key, Kind, table_of

_LOAD = "load "
_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class SensorEntry:
    """One channel of ``[record.sensors]``."""

    node: Annotated[int | None, "Node that it reads; that of its name by default"] = None
    point: Annotated[
        float | tuple[float, ...] | None, POSITION, "In place of `node`: where it is, m; it reads the nearest node"
    ] = None
    direction: Annotated[list[float] | None, VECTOR, "Along which it reads, X Y Z; that of its name by default"] = None
    tolerance: Annotated[Positive | None, "Of `point`: farthest node, m; by default a hundredth of the structure"] = (
        None
    )


_ENTRY = table_of(SensorEntry)
SENSORS = Key(
    Kind(
        'a table of channels, as in { "101Z" = { node = 12, direction = [0.3, 0.95, 0.0] } }',
        {"type": "object", "minProperties": 1, "additionalProperties": _ENTRY.schema},
        bool,
    ),
    "Channels that read along a direction of their own, or at the node nearest to a point",
)


def read_sensors(
    record: Section, nodes: Mapping[int, Sequence[float]], structure: Structure
) -> list[tuple[Section, AimedSensor]]:
    """The sensors that ``[record.sensors]`` of a record declares, each with its place in the study; [] without that section.

    Parameters
    ----------
    record : Section
        ``[record]``.
    nodes : mapping of int to position
        Positions of the structure's nodes, m.
    structure : Structure
        The structure without these sensors. Only nodes that its elements use can be nearest.

    Raises
    ------
    StudyError
        If a channel or its node cannot be used, a direction has no length or is one in which its node does not move, or a
        point is far from every node.
    """
    section = record.section("sensors")
    if section is None:
        return []
    if not section.table:
        raise section.error('holds no channel; add lines such as "101Z" = { node = 12, direction = [0.3, 0.95, 0.0] }')
    names = [name.removeprefix(_LOAD) for name in section.table]
    with section.located():
        dofs = [parse_dof(name) for name in names]
    fresh = max([*nodes, *(dof.node for dof in dofs)]) + 1
    moves = [d for d in DIRECTIONS[:3] if d in (structure.active or ())]
    found = []
    for channel, dof in zip(section.table, dofs, strict=True):
        entry = _sensor_section(section, channel)
        stated = SensorEntry(**entry.values(_ENTRY))
        if dof.is_rotation or not moves:
            raise section.error("must be a translation, of a structure that has some; leave it out", channel)
        with section.located(channel):
            node, distance = _node_of_sensor(stated, dof.node, nodes, structure.elements)
            whole = unit_direction(_AXES[dof.axis] if stated.direction is None else stated.direction)
            direction = _moving_direction(whole, node, structure)
        label, seen = dof.node, dof.direction
        if label in nodes or seen not in moves:
            label, seen, fresh = fresh, moves[0], fresh + 1
        found.append((section, AimedSensor(f"sensor {channel}", channel, label, seen, node, direction, distance)))
    return found


def _sensor_section(section: Section, channel: str) -> Section:
    """The table of the channel `channel` in ``[record.sensors]``, whose section is `section`.

    `StudyError` if it is no table.
    """
    entry = section.table[channel]
    if not isinstance(entry, dict):
        raise section.error("must be a table, as in { node = 12, direction = [0.3, 0.95, 0.0] }", channel)
    return Section(section.source, (*section.path, channel), entry)


def _node_of_sensor(
    sensor: SensorEntry, number: int, nodes: Mapping[int, Sequence[float]], elements: Sequence[ElementSet]
) -> tuple[int, float]:
    """Label of the node that a sensor reads, and its distance in m from the stated point (0 without a point).

    `number` is the node in the sensor's name, taken if neither node nor point is stated. `nodes` are positions in m by
    label; those of `elements` can be nearest to a point. Raises `InputError` if node and point are both stated, there
    is no such node, or none is within the tolerance.
    """
    if sensor.point is not None:
        if sensor.node is not None:
            raise InputError("has `node` and `point`; keep one of them")
        point = sensor.point if isinstance(sensor.point, tuple) else (sensor.point,)
        coordinates = [*map(float, point), 0.0, 0.0][:3]
        used = {int(n) for element in elements for n in element.nodes.ravel()}
        nearest = nearest_nodes([coordinates], {n: np.asarray(nodes[n]) for n in nodes if n in used}, sensor.tolerance)
        return nearest.nodes[0], float(nearest.distance[0])
    node = number if sensor.node is None else sensor.node
    if node not in nodes:
        raise InputError(f"node {node} does not exist; give `node` of the structure, or `point = [x, y, z]` in m")
    return node, 0.0


def _moving_direction(
    direction: tuple[float, float, float], node: int, structure: Structure
) -> tuple[float, float, float]:
    """The vector `direction`, along X, Y and Z, with 0 where `node` cannot move; `InputError` if nothing is left."""
    moves = structure.numbering.directions(node)
    x, y, z = (part if axis in moves else 0.0 for part, axis in zip(direction, DIRECTIONS, strict=False))
    if not (x or y or z):
        way = ", ".join(f"{part:g}" for part in direction)
        raise InputError(
            f"points along ({way}), where node {node} does not move; it moves in {', '.join(moves) or 'nothing'}: give"
            " one of these as `direction`"
        )
    return x, y, z


def is_load(name: str) -> bool:
    """True if a name of ``[record.sensors]`` is that of a load."""
    return name.startswith(_LOAD)


def channel_names(structure: Structure) -> dict[str, str]:
    """Places in the structure of the channels of ``[record.sensors]``, such as "7X", by their names in the record.

    Names are those along positive directions; those of loads begin with "load ". The sense of a channel stays: `3X-` of
    the record reads against the direction that is declared.
    """
    names = {}
    for sensor in (tie for tie in structure.ties if isinstance(tie, AimedSensor)):
        load, dof = _LOAD * is_load(sensor.channel), parse_dof(sensor.channel.removeprefix(_LOAD))
        names[load + dof.place] = sensor.dof.place
    return names


def used_names(names: Mapping[str, str], channels: Iterable[Dof]) -> dict[str, str]:
    """The entries of `names` (names in the structure by channel) whose channel is among `channels`."""
    names_of_channels = {dof.place for dof in channels}
    return {name: dof for name, dof in names.items() if name.removeprefix(_LOAD) in names_of_channels}

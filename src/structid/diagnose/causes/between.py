"""Sensors and loads between their node and the next one: they follow the beam or bar that is there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.diagnose.causes.candidate import NUMBER_STEPS, Candidate, Channel, channels, index_of
from structid.diagnose.causes.direction import follower
from structid.diagnose.effects import channel_change, channel_reading
from structid.diagnose.model_edits import AddNode, Edits, rounded
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.fem import Bar, Beam, SpaceBeam, Structure
from structid.fem.elements.element import dof_code

#: Where between two nodes a channel may be, in parts of their distance.
_PARTS = np.array([0.1, 0.25, 0.5, 0.75, 0.9])
_BOUNDS = (0.0, 1.0)


def following(ends: Sequence[FloatArray], axis: int, fraction: float, bends: bool) -> FloatArray:
    """Weights (2, 6) by which a translation at a point between two nodes follows the six motions of each node.

    Rows are the nodes, columns the translations X, Y, Z, then the rotations. Along the line the motion is interpolated
    linearly, across it by cubic beam shape functions where a beam bends between the nodes.

    Parameters
    ----------
    ends : two (n_axes,) float arrays
        Positions of the two nodes, m, which must differ.
    axis : int
        Axis of the translation: 0, 1 or 2.
    fraction : float
        Distance of the point from the first node, as a fraction of the distance between the nodes.
    bends : bool
        True if a beam joins the nodes, False for a bar.
    """
    line = np.zeros(3)
    line[: len(ends[0])] = ends[1] - ends[0]
    length = float(np.linalg.norm(line))
    tangent, unit_axis = line / length, np.eye(3)[axis]
    along = tangent[axis] * tangent
    moved = fraction**2 * (3 - 2 * fraction) if bends else fraction
    slopes = length * fraction * (1 - fraction) * np.array([1 - fraction, -fraction]) * bends
    weights = np.zeros((2, 6))
    weights[:, :3] = np.outer([1 - moved, moved], unit_axis - along) + np.outer([1 - fraction, fraction], along)
    weights[:, 3:] = np.outer(slopes, np.cross(tangent, unit_axis))
    return weights


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorBetween(Candidate):
    """A sensor between its node and a neighbouring one; the strength is the fraction of the way to that.

    Attributes
    ----------
    bends : bool
        True if a beam joins the two nodes, False for bars alone.
    """

    kind: ClassVar[str] = "between"
    result_kind: ClassVar[str] = "place"
    n_hidden: ClassVar[int] = 1
    other_strengths: ClassVar[tuple[float, ...]] = NUMBER_STEPS
    bounds: tuple[float, float] = _BOUNDS
    record: int | None = 0
    bends: bool

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        for channel, other, bends in _channels_and_neighbours(records, 1):
            where = (channel.dof.place, other.place)
            yield cls(where=where, strengths=_PARTS, record=channel.record, bends=bends)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 1, self.where, self.bends, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return _edits(model, self.record or 0, self.where, self.bends, strength, "")

    def sentence(self, value: float | None) -> str:
        return f"sensor {self.where[0]} sits between its node and that of {self.where[1]}"


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadBetween(Candidate):
    """A load between its node and a neighbouring one; the strength is the fraction of the way to that.

    Attributes
    ----------
    bends : bool
        True if a beam joins the two nodes, False for bars alone.
    """

    kind: ClassVar[str] = "load_between"
    result_kind: ClassVar[str] = "load_place"
    n_hidden: ClassVar[int] = 1
    other_strengths: ClassVar[tuple[float, ...]] = NUMBER_STEPS
    bounds: tuple[float, float] = _BOUNDS
    record: int | None = 0
    bends: bool

    @classmethod
    def from_receptances(cls, records: Sequence[Receptances], record_names: Sequence[str]) -> Iterator[Candidate]:
        """A candidate for each load and each neighbour of its node on a bar or beam: the load acts between the two.

        `records` are the receptances of each record. Strengths are fractions of the way to the neighbour, 0.1 to 0.9.
        Motions of supports have no candidates. `record_names` are not used.
        """
        for channel, other, bends in _channels_and_neighbours(records, 2):
            if records[channel.record].problem.facts.measures_force:
                where = (channel.dof.place, other.place)
                yield cls(where=where, strengths=_PARTS, record=channel.record, bends=bends)

    def effect(self, receptances: Receptances, strengths: FloatArray) -> ComplexArray:
        return _effect(receptances, 2, self.where, self.bends, strengths)

    def edits(self, model: TestedModel, strength: float) -> Edits:
        return _edits(model, self.record or 0, self.where, self.bends, strength, "load ")

    def sentence(self, value: float | None) -> str:
        return f"the force at {self.where[0]} acts between its node and that of {self.where[1]}"


def _channels_and_neighbours(records: Sequence[Receptances], axis: int) -> Iterator[tuple[Channel, Dof, bool]]:
    """Channels with a neighbouring node on a bar or beam: sensors of all records for `axis` 1, loads for `axis` 2.

    Each item is (channel, degree of freedom of the neighbour in the channel's direction, True if a beam joins the nodes
    or False for bars alone). Rotations have none, nor have neighbours that do not move in this direction or lie at the
    same point.
    """
    for receptances, channel in channels(records, axis):
        bends: dict[int, bool] = {}
        dof = channel.dof
        for element in receptances.structure.elements if not dof.is_rotation else ():
            if isinstance(element, Bar | Beam | SpaceBeam):
                for pair in element.nodes.tolist():
                    if dof.node in pair:
                        node = pair[1 - pair.index(dof.node)]
                        bends[node] = bends.get(node, False) or not isinstance(element, Bar)
        nodes = receptances.structure.nodes
        for node, is_beam in bends.items():
            other = Dof(node, dof.direction)
            if other in receptances.columns and np.any(np.atleast_1d(nodes[dof.node]) != np.atleast_1d(nodes[node])):
                yield channel, other, is_beam


def _ends(structure: Structure, dof_names: Sequence[str]) -> tuple[tuple[Dof, Dof], list[FloatArray]]:
    """The two degrees of freedom `dof_names`, such as ``3X``, and the positions of their nodes, m, (n_axes,) each."""
    first, second = (parse_dof(place) for place in dof_names)
    return (first, second), [np.atleast_1d(structure.nodes[dof.node]) for dof in (first, second)]


def _effect(
    receptances: Receptances, axis: int, dof_names: Sequence[str], bends: bool, fractions: FloatArray
) -> ComplexArray:
    """Changes of the FRF, (n_fractions, n_lines, n_outputs, n_inputs), by moving a channel towards a neighbouring node.

    The channel is a sensor (`axis` 1) or a load (`axis` 2). `dof_names` are its degree of freedom and that of the
    neighbour; `fractions` (n_fractions,) are of the way from one to the other, along which a beam (`bends`) or a bar
    lies.
    """
    index = index_of(receptances, axis, dof_names[0])
    record = receptances.problem.record
    sign = (record.outputs if axis == 1 else record.inputs)[index].sign
    (first, second), ends = _ends(receptances.structure, dof_names)
    codes = np.array([dof_code(dof.node, direction) for dof in (first, second) for direction in DIRECTIONS])
    weights = np.stack([following(ends, first.axis, float(part), bends).ravel() for part in fractions])
    reading = channel_reading(receptances, axis, index, sign * weights @ receptances.reached(codes))
    return channel_change(receptances, axis, index, reading - receptances.frf.take(index, axis))


def _edits(
    model: TestedModel, record: int, dof_names: Sequence[str], bends: bool, fraction: float, role_prefix: str
) -> Edits:
    """Edits that move a channel of a record to a new node between the nodes of two degrees of freedom.

    `dof_names` are the channel's present degree of freedom and the one at the neighbour; `fraction` is that of the way
    between. The new node moves with both nodes as a beam (`bends`) or bar does. `role_prefix` is "load " for a load, ""
    for a sensor, and `record` the index of the record, from 0.
    """
    structure = model.setups[record].structure
    (first, second), ends = _ends(structure, dof_names)
    label, weights = model.new_node(), following(ends, first.axis, fraction, bends)
    pairs = [
        [f"{dof.node}{direction}", rounded(weight)]
        for dof, own in zip((first, second), weights.tolist(), strict=True)
        for direction, weight in zip(DIRECTIONS, own, strict=True)
        if direction in (structure.active or DIRECTIONS) and rounded(weight)
    ]
    name = model.unique_name(f"between {' '.join(dof_names)}")
    node = AddNode(label, first.node, second.node, fraction)
    return follower(model, record, name, first, label, pairs, node, role_prefix)

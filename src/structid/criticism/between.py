"""Sensors and loads between their node and the next one: they follow the beam or bar that is there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.criticism.candidate import Candidate, of_channel, picked_by
from structid.criticism.fields import Fields
from structid.fem import Bar, Beam, SpaceBeam
from structid.fem.elements.element import dof_code

#: Where between two nodes a channel may be, in parts of their distance.
_PARTS = np.array([0.1, 0.25, 0.5, 0.75, 0.9])


class _Line(NamedTuple):
    """From the node of a channel to the next: codes of both nodes' directions, (12,), where the nodes are, and what is there."""

    codes: IntArray
    ends: tuple[FloatArray, FloatArray]
    axis: int
    bends: bool

    def weights(self, parts: FloatArray) -> FloatArray:
        """How the channel follows both nodes, (n, 12)."""
        return np.stack([following(self.ends, self.axis, float(part), self.bends).ravel() for part in parts])


def following(ends: Sequence[FloatArray], axis: int, part: float, bends: bool) -> FloatArray:
    """How a translation of a point on the line between two nodes follows the directions of both, (2, 6).

    Along the line it is straight, across it cubic where a beam bends between them.

    Parameters
    ----------
    ends : two (n_axes,) float arrays
        Where the nodes are, m.
    axis : int
        Of the translation.
    part : float
        Of the distance from the first node.
    bends : bool
    """
    line = np.zeros(3)
    line[: len(ends[0])] = ends[1] - ends[0]
    length = float(np.linalg.norm(line))
    tangent, own = line / length, np.eye(3)[axis]
    along = tangent[axis] * tangent
    far = part**2 * (3 - 2 * part) if bends else part
    slopes = length * part * (1 - part) * np.array([1 - part, -part]) * bends
    found = np.zeros((2, 6))
    found[:, :3] = np.outer([1 - far, far], own - along) + np.outer([1 - part, part], along)
    found[:, 3:] = np.outer(slopes, np.cross(tangent, own))
    return found


def between_nodes(fields: Fields, number: int) -> Iterator[Candidate]:
    """Every translation that a channel of a record stands for, part of the way to each next node."""
    record, active = fields.problem.record, fields.structure.active or ()
    loads = record.inputs if fields.problem.facts.measures_force else ()
    for kind, axis, dofs in (("between", 1, record.outputs), ("load_between", 2, loads)):
        for i, dof in enumerate(dofs):
            for other, line in _lines(fields, dof):
                yield Candidate(
                    kind, (dof.place, other.place), partial(_moved, axis, i, dof.sign, line), _PARTS, (0.0, 1.0), number,
                    active, detail={"bends": float(line.bends)},
                )  # fmt: skip


def _lines(fields: Fields, dof: Dof) -> Iterator[tuple[Dof, _Line]]:
    """The next nodes that move in the direction of `dof`, with the lines to them."""
    bends: dict[int, bool] = {}
    for element in fields.structure.elements if not dof.is_rotation else ():
        if isinstance(element, Bar | Beam | SpaceBeam):
            for pair in element.nodes.tolist():
                if dof.node in pair:
                    node = pair[1 - pair.index(dof.node)]
                    bends[node] = bends.get(node, False) or not isinstance(element, Bar)
    for node, is_beam in bends.items():
        other = Dof(node, dof.direction)
        ends = (np.atleast_1d(fields.structure.nodes[dof.node]), np.atleast_1d(fields.structure.nodes[node]))
        if other in fields.columns and np.any(ends[0] != ends[1]):
            codes = np.array([dof_code(end, direction) for end in (dof.node, node) for direction in DIRECTIONS])
            yield other, _Line(codes, ends, dof.axis, is_beam)


def _moved(axis: int, i: int, sign: int, line: _Line, fields: Fields, strengths: FloatArray) -> ComplexArray:
    """Of a channel that is so far on its way."""
    ways = sign * line.weights(strengths) @ fields.reached(line.codes)
    return of_channel(fields, axis, i, picked_by(fields, axis, i, ways) - fields.frf.take(i, axis))

"""Sensors that point along a line of their own, at a node or at the node nearest to a point: lasers, turned sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.dof import DIRECTIONS, Dof
from structid.errors import InputError
from structid.structure.elements.element import dof_code
from structid.structure.supports import Equations


@dataclass(frozen=True)
class AimedSensor:
    """A degree of freedom of its own that reads a node along a direction.

    Attributes
    ----------
    name : str
        Such as ``sensor 101Z``.
    channel : str
        What the record calls it.
    label : int
        Node of its own, which carries no element.
    seen : str
        Direction under which it is known there.
    node : int
        The node that it reads.
    direction : (float, float, float)
        X, Y and Z, of length 1 but for parts in which the node does not move.
    distance : float
        From the point where the sensor is to that node, m.
    """

    name: str
    channel: str
    label: int
    seen: str
    node: int
    direction: tuple[float, float, float]
    distance: float = 0.0

    @property
    def dof(self) -> Dof:
        """What the structure calls it."""
        return Dof(self.label, self.seen)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> Equations:
        """Its own code with those of the node; see `Tie.equations`."""
        parts = {
            dof_code(self.node, d): part
            for d, part in zip(DIRECTIONS, self.direction, strict=False)
            if part and d in active
        }
        if not parts:
            moves = ", ".join(active)
            raise InputError(
                f"{self.name!r} points where node {self.node} does not move: the structure moves in {moves}"
            )
        return {dof_code(self.label, self.seen): parts}


def unit_direction(vector: Sequence[float]) -> tuple[float, float, float]:
    """`vector` of X, Y and Z at length 1.

    Raises
    ------
    InputError
        If it is not three finite numbers, or has no length.
    """
    given = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(given)) if given.shape == (3,) else np.nan
    if not np.isfinite(length) or length == 0:
        raise InputError(f"`direction` must be three numbers that are not all 0, got {list(vector)}")
    x, y, z = (given / length).tolist()
    return x, y, z


@dataclass(frozen=True, eq=False)
class NearestNodes:
    """The node of a model for each test point.

    Attributes
    ----------
    nodes : tuple of int
    distance : (n_points,) float array
        m.
    """

    nodes: tuple[int, ...]
    distance: FloatArray


def nearest_nodes(
    points: Sequence[Sequence[float]], nodes: Mapping[int, FloatArray], tolerance: float | None = None
) -> NearestNodes:
    """The node nearest to each of `points`.

    Parameters
    ----------
    points : (n_points, 3) array-like
        m; coordinates that `nodes` do not have count as 0 there.
    nodes : mapping of int to position
        One to three coordinates, m.
    tolerance : float, optional
        Largest distance, m; a hundredth of the diagonal of `nodes` by default.

    Raises
    ------
    InputError
        If a point is farther from every node; with the nearest and its distance.
    """
    labels = list(nodes)
    if not labels:
        raise InputError("there is no node that a point could be near")
    places = np.zeros((len(labels), 3))
    for row, label in zip(places, labels, strict=True):
        row[: len(nodes[label])] = nodes[label]
    reach = 0.01 * float(np.linalg.norm(np.ptp(places, axis=0))) if tolerance is None else tolerance
    found, distances = [], []
    for point in points:
        away = np.linalg.norm(places - np.asarray(point, dtype=np.float64), axis=1)
        best = int(away.argmin())
        if away[best] > reach:
            told = ", ".join(f"{x:g}" for x in point)
            raise InputError(
                f"point ({told}) m is {away[best]:.3g} m from the nearest node {labels[best]}, farther than {reach:.3g} m;"
                " correct it (m, in the coordinates of the structure), or give a larger `tolerance`"
            )
        found.append(labels[best])
        distances.append(float(away[best]))
    return NearestNodes(tuple(found), np.array(distances))

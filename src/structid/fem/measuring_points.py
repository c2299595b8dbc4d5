"""Sensors and forces that no single degree of freedom names: on lines, on meshes, several as one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import InputError
from structid.fem.elements import ElementSet
from structid.fem.elements.element import dof_code, dof_of_code, joined_codes
from structid.fem.structure import Structure
from structid.fem.supports import Constraint, DofEquations

if TYPE_CHECKING:
    from structid.fem.meshes import Mesh

#: Part of a force that is rounding, and of the largest eigenvalue of a correlation matrix what counts as 0.
_NOTHING, _SAME = 1e-12, 1e-8


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
        """Degree of freedom that stands for the sensor in the structure."""
        return Dof(self.label, self.seen)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """The sensor's motion by translations of its node: {code of the sensor: {code at the node: direction cosine}}.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ. `positions` are not needed; `active` are the
        directions in which nodes move, and others are left out. Raises `InputError` if the node moves in no direction
        that the sensor sees.
        """
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
    """`vector` (X, Y, Z) scaled to length 1.

    Raises
    ------
    InputError
        If it is not three finite numbers, or has no length.
    """
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array)) if array.shape == (3,) else np.nan
    if not np.isfinite(length) or length == 0:
        raise InputError(f"`direction` must be three numbers that are not all 0, got {list(vector)}")
    x, y, z = (array / length).tolist()
    return x, y, z


@dataclass(frozen=True, eq=False)
class NearestNodes:
    """The node of a model for each test point.

    Attributes
    ----------
    nodes : tuple of int
    distance : (n_points,) float array
        Distance of each point from its node, m.
    """

    nodes: tuple[int, ...]
    distance: FloatArray


def nearest_nodes(
    points: Sequence[Sequence[float]], nodes: Mapping[int, FloatArray], tolerance: float | None = None
) -> NearestNodes:
    """The node nearest to each of `points` (the first of several), and its distance in m, in the order of `points`.

    Parameters
    ----------
    points : (n_points, 3) array-like
        m; coordinates that `nodes` do not have count as 0 there.
    nodes : mapping of int to position
        One to three coordinates, m.
    tolerance : float, optional
        Largest distance, m; a hundredth of the diagonal of the box around all `nodes` by default.

    Raises
    ------
    InputError
        If there are no nodes, or a point is farther than `tolerance` from every node; the message names the nearest.
    """
    labels = list(nodes)
    if not labels:
        raise InputError("there is no node that a point could be near")
    positions = np.zeros((len(labels), 3))
    for row, label in zip(positions, labels, strict=True):
        row[: len(nodes[label])] = nodes[label]
    reach = 0.01 * float(np.linalg.norm(np.ptp(positions, axis=0))) if tolerance is None else tolerance
    nearest, distances = [], []
    for point in points:
        away = np.linalg.norm(positions - np.asarray(point, dtype=np.float64), axis=1)
        best = int(away.argmin())
        if away[best] > reach:
            words = ", ".join(f"{x:g}" for x in point)
            raise InputError(
                f"point ({words}) m is {away[best]:.3g} m from the nearest node {labels[best]}, farther than {reach:.3g} m;"
                " correct it (m, in the coordinates of the structure), or give a larger `tolerance`"
            )
        nearest.append(labels[best])
        distances.append(float(away[best]))
    return NearestNodes(tuple(nearest), np.array(distances))


@dataclass(frozen=True)
class MeshPoint:
    """A node that moves as the nearest node of a mesh.

    Attributes
    ----------
    name : str
        Such as ``point 101``.
    label : int
        Its own label, which sensors and loads name.
    node : int
        The mesh's node that it follows.
    distance : float
        Distance of the point from that node, m.
    directions : tuple of str
        Directions in which that node moves.
    """

    name: str
    label: int
    node: int
    distance: float
    directions: tuple[str, ...]

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Own codes with those of the node; see `Tie.equations`."""
        return {dof_code(self.label, d): {dof_code(self.node, d): 1.0} for d in self.directions if d in active}


def mesh_points(
    mesh: Mesh, elements: Iterable[ElementSet], points: Mapping[int, Sequence[float]]
) -> tuple[MeshPoint, ...]:
    """One `MeshPoint` for each of `points` (label: position in m), which moves as the nearest node that `elements` use.

    It moves in the directions in which `elements` let that node move.

    Raises
    ------
    InputError
        If a label is that of a node of `mesh`, or the nearest node is farther away than the cells there are long.
    """
    sets = list(elements)
    used = {int(n) for element in sets for n in element.nodes.ravel() if n in mesh.nodes}
    made = []
    for label, position in points.items():
        if label in mesh.nodes:
            raise InputError(f"point {label} is a node of {mesh.source} already; take another number for the point")
        node, distance, size = mesh.nearest(position, used)
        if distance > size:
            raise InputError(
                f"point {label} is {distance:.3g} m from the nearest node {node} of {mesh.source}, farther than the cells"
                f" there are long ({size:.3g} m); correct its position (in m), or the unit of the mesh"
            )
        made.append(MeshPoint(f"point {label}", label, node, distance, _directions(sets, node, mesh)))
    return tuple(made)


def _directions(elements: list[ElementSet], node: int, mesh: Mesh) -> tuple[str, ...]:
    """Directions, such as "X", in which `elements` let `node` move, or nodes at offsets that it carries.

    They are in the order X, Y, Z, RX, RY, RZ; `mesh` gives positions and carried nodes. Empty if no element is there.
    """
    here = [node, *(made for made, carrier in mesh.carriers.items() if carrier == node)]
    used = [element.codes(mesh.nodes) for element in elements if np.isin(element.nodes, here).any()]
    codes = joined_codes(used)
    directions = {dof_of_code(code).direction for code in codes[np.isin(codes // 6, here)].tolist()}
    return tuple(direction for direction in DIRECTIONS if direction in directions)


def joint_weights(values: FloatArray) -> FloatArray | None:
    """Weights W that combine series into the fewest joint ones without loss; None if all series are needed.

    Directions in which the series, scaled to unit RMS, have no more than 1e-8 of the largest mean square are left
    out.

    Parameters
    ----------
    values : (n_samples, n_series) float array

    Returns
    -------
    (n_series, n_joint) float array or None
        Orthonormal columns W; the joint series are ``values @ W`` and ``values = joint @ W.T``. None also for a single
        series, or if a series is zero throughout.
    """
    size = np.sqrt((values**2).mean(axis=0))
    if values.shape[1] < 2 or not (size > 0).all():
        return None
    strength, ways = np.linalg.eigh((values / size).T @ (values / size) / len(values))
    kept = strength > _SAME * strength[-1]
    if kept.all():
        return None
    parts: FloatArray = np.linalg.qr(size[:, None] * ways[:, kept])[0]
    return parts * np.where(parts.sum(axis=0) < 0, -1.0, 1.0)


def with_joint_forces(
    structure: Structure, joint_dofs: Sequence[Dof], loads: Sequence[Dof], parts: FloatArray
) -> Structure:
    """Copy of the structure with one new degree of freedom for each joint force, that is for each column of `parts`.

    `parts` (n_loads, n_joint) are the weights of the `loads` in each joint force, `joint_dofs` the n_joint new degrees
    of freedom. Each follows the `loads`, weighted by its column (weights that are rounding left out), so that its force
    does the same work; its new node lies where the load with the largest weight is.
    """
    nodes, ties = dict(structure.nodes), list(structure.ties)
    for dof, column in zip(joint_dofs, parts.T, strict=True):
        nodes[dof.node] = structure.nodes[loads[int(np.abs(column).argmax())].node]
        acting = [(load, float(part)) for load, part in zip(loads, column, strict=True) if abs(part) > _NOTHING]
        ties.append(Constraint(f"joint force {dof.node}", dof, acting))
    return replace(structure, nodes=nodes, ties=tuple(ties))

"""What moves in a picture of mode shapes, and where: sensors on their geometry, or in a row where there is none."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.dof import DIRECTIONS, Dof
from structid.modal import ModalRecord
from structid.records import Geometry

#: Largest displacement drawn, as a part of the diagonal of the geometry.
_AMPLITUDE = 0.12
#: Where the viewer of three dimensions stands, degrees.
AZIMUTH, ELEVATION = -55.0, 22.0


@dataclass(frozen=True, eq=False)
class Path:
    """A chain of points that is drawn as one, -1 for a gap.

    Attributes
    ----------
    name : str
        For the legend.
    points : tuple of int
    is_measured : bool
        False where no sensor says how the points move, so that they stand still in the drawing.
    """

    name: str
    points: tuple[int, ...]
    is_measured: bool


@dataclass(frozen=True, eq=False)
class Scene:
    """Points at rest and how each mode moves them, in drawing units.

    Attributes
    ----------
    rest : (n_points, n_axes) float array
        Two or three axes.
    motion : (n_modes, n_points, n_axes) complex array
        Displacement at phase 0 is the real part; largest size chosen for the drawing.
    labels : tuple of str
        One a point.
    axes : tuple of str
        Name of each axis.
    paths : tuple of Path
    ticks : tuple of str
        Names along the first axis of a row; empty on a geometry.
    notes : tuple of str
        What the reader should know about the drawing.
    """

    rest: FloatArray
    motion: ComplexArray
    labels: tuple[str, ...]
    axes: tuple[str, ...]
    paths: tuple[Path, ...]
    ticks: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def is_row(self) -> bool:
        """Whether sensors stand in a row, for want of a geometry."""
        return bool(self.ticks)

    def at(self, mode: int, phase: float) -> FloatArray:
        """Points of `mode` at `phase` in rad, (n_points, n_axes)."""
        return np.asarray(self.rest + (self.motion[mode] * np.exp(1j * phase)).real)


def mode_scene(modes: ModalRecord, geometry: Geometry | None) -> Scene:
    """The scene of `modes`, each turned to the phase in which most of it is real."""
    shapes = modes.mode_shapes * np.exp(-0.5j * np.angle(np.sum(modes.mode_shapes**2, axis=0)))
    signed = shapes * np.array([dof.sign for dof in modes.channels])[:, None]
    return _row(modes.channels, signed) if geometry is None else _placed(modes.channels, signed, geometry)


def _row(channels: tuple[Dof, ...], shapes: ComplexArray) -> Scene:
    nodes = list(dict.fromkeys(dof.node for dof in channels))
    rest = np.array([[nodes.index(dof.node), 0.0] for dof in channels])
    motion = np.zeros((shapes.shape[1], len(channels), 2), dtype=complex)
    motion[:, :, 1] = (shapes / np.maximum(np.abs(shapes).max(axis=0), 1e-300)).T
    paths = []
    for direction in DIRECTIONS:
        here = tuple(i for i, dof in enumerate(channels) if dof.direction == direction)
        if here:
            paths.append(Path(f"direction {direction}", here, True))
    note = (
        "No geometry was given: sensors stand in a row in the order of the channels, one line a direction, and their"
        " distances mean nothing. Give the positions of the nodes with --geometry to see the shapes in space."
    )
    axes = ("node", "shape, positive along the axis")
    texts = tuple(str(node) for node in nodes)
    return Scene(rest, motion, tuple(map(str, channels)), axes, tuple(paths), texts, (note,))


def _placed(channels: tuple[Dof, ...], shapes: ComplexArray, geometry: Geometry) -> Scene:
    nodes = list(geometry.nodes)
    rest = np.array([geometry.nodes[node] for node in nodes], dtype=float)
    motion = np.zeros((shapes.shape[1], len(nodes), 3), dtype=complex)
    measured, turning = set(), []
    for dof, row in zip(channels, shapes, strict=True):
        if dof.is_rotation:
            turning.append(str(dof))
            continue
        motion[:, nodes.index(dof.node), dof.axis] += row
        measured.add(nodes.index(dof.node))
    largest = np.sqrt((np.abs(motion) ** 2).sum(axis=2)).max(axis=1, initial=0.0)
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0))) or 1.0
    motion *= (_AMPLITUDE * diagonal / np.where(largest > 0, largest, 1.0))[:, None, None]
    notes = []
    if len(measured) < len(nodes):
        notes.append("Grey points have no sensor: they stand still in the drawing, whatever the structure does there.")
    if turning:
        notes.append(f"Rotations are not drawn: {', '.join(turning)}.")
    used = [j for j in range(3) if np.ptp(rest[:, j]) > 0 or np.abs(motion[:, :, j]).max() > 0]
    used = sorted({*used, *[j for j in range(3) if j not in used][: max(0, 2 - len(used))]})
    names = tuple(f"{DIRECTIONS[j]} (m)" for j in used)
    paths = _paths(geometry, nodes, measured)
    labels = tuple(f"node {node}" for node in nodes)
    return Scene(rest[:, used], motion[:, :, used], labels, names, paths, (), tuple(notes))


def _paths(geometry: Geometry, nodes: list[int], measured: set[int]) -> tuple[Path, ...]:
    """Lines between two sensors, and all others; points that no line touches by themselves."""
    chains: dict[bool, list[int]] = {True: [], False: []}
    touched = set()
    for line in geometry.lines:
        for first, second in pairwise(line):
            if first and second:
                ends = [nodes.index(first), nodes.index(second)]
                touched.update(ends)
                chains[measured.issuperset(ends)] += [*ends, -1]
    for i in range(len(nodes)):
        if i not in touched:
            chains[i in measured] += [i, -1]
    names = {True: "between sensors", False: "not between two sensors"}
    return tuple(Path(names[kind], tuple(chain[:-1]), kind) for kind, chain in chains.items() if chain)


def flat(points: FloatArray) -> FloatArray:
    """Points of two or three axes as seen on paper, (n_points, 2)."""
    if points.shape[1] == 2:
        return points
    turn, tilt = np.radians(AZIMUTH), np.radians(ELEVATION)
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([-np.sin(tilt) * np.cos(turn), -np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    return np.asarray(points @ np.stack([right, up], axis=1))

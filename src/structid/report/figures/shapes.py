"""Mode shapes that move: sensors on their geometry, or in a row where there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.quantities import value_words
from structid.modal import ModalRecord
from structid.modal.survey.survey import ModesResult
from structid.records import Geometry
from structid.report.drawing import palette
from structid.report.rendering import plot
from structid.similarity import real_turn

#: Largest displacement drawn, as a part of the diagonal of the geometry.
_AMPLITUDE = 0.12
#: Ellipse of a point, in parts of the square of the largest motion, below which all are lines; points drawn of each.
_FLAT, _PHASES = 0.02, 37
_SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross")
_DASHES: tuple[Literal["solid", "dash", "dot"], ...] = ("solid", "dash", "dot")


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
    axes : tuple of plot.Axis
    measured, still : mapping of name to points
        Chains of points that are drawn as one, -1 for a gap; no sensor says how those that stand still move.
    notes : tuple of str
        What the reader should know about the drawing.
    """

    rest: FloatArray
    motion: ComplexArray
    labels: tuple[str, ...]
    axes: tuple[plot.Axis, ...]
    measured: dict[str, list[int]]
    still: dict[str, list[int]]
    notes: tuple[str, ...]


def mode_scene(modes: ModalRecord, geometry: Geometry | None) -> Scene:
    """Points, motions and axes for drawing mode shapes, each turned in phase to be as real as possible.

    Without `geometry` (None) the sensors are drawn in a row. Unknown entries of shapes are drawn as 0, with a note.
    """
    shapes = modes.mode_shapes * real_turn(modes.mode_shapes)
    signed = shapes * np.array([dof.sign for dof in modes.channels])[:, None]
    still = np.where(modes.known, signed, 0.0)
    scene = _row(modes.channels, still) if geometry is None else _scene_in_space(modes.channels, still, geometry)
    if modes.known.all():
        return scene
    words = "Sensors that no set-up with this mode has stand still in its drawing; their motion is unknown."
    return replace(scene, notes=(*scene.notes, words))


def _row(channels: tuple[Dof, ...], shapes: ComplexArray) -> Scene:
    """Scene of mode shapes without geometry: sensors in a row, with one line for each direction.

    `shapes` (n_channels, n_modes) are along positive axes; each mode is scaled to a largest entry of 1. `channels` are
    the sensors.
    """
    nodes = list(dict.fromkeys(dof.node for dof in channels))
    rest = np.array([[nodes.index(dof.node), 0.0] for dof in channels])
    motion = np.zeros((shapes.shape[1], len(channels), 2), dtype=complex)
    motion[:, :, 1] = (shapes / np.maximum(np.abs(shapes).max(axis=0), 1e-300)).T
    paths = {
        f"direction {direction}": [i for i, dof in enumerate(channels) if dof.direction == direction]
        for direction in DIRECTIONS
    }
    note = (
        "No geometry was given: sensors stand in a row in the order of the channels, one line a direction, and their"
        " distances mean nothing. Give the positions of the nodes with --geometry to see the shapes in space."
    )
    ticks = plot.named_ticks([str(node) for node in nodes], 40)
    axes = (
        plot.Axis("node", limits=(-0.4, len(nodes) - 0.6), ticks=ticks),
        plot.Axis("shape, positive along the axis", limits=(-1.15, 1.15)),
    )
    measured = {name: path for name, path in paths.items() if path}
    return Scene(rest, motion, tuple(map(str, channels)), axes, measured, {}, (note,))


def _scene_in_space(channels: tuple[Dof, ...], shapes: ComplexArray, geometry: Geometry) -> Scene:
    """Scene of mode shapes on the positions of the nodes (m), scaled to 12 % of the structure's diagonal.

    `shapes` (n_channels, n_modes) are along positive axes; rotations are left out. `channels` are the sensors.
    `geometry` has the positions of the nodes and the lines between them.
    """
    nodes = list(geometry.nodes)
    rest = np.array([geometry.nodes[node] for node in nodes], dtype=float)
    motion = np.zeros((shapes.shape[1], len(nodes), 3), dtype=complex)
    for dof, row in zip(channels, shapes, strict=True):
        if not dof.is_rotation:
            motion[:, nodes.index(dof.node), dof.axis] += row
    seen = {nodes.index(dof.node) for dof in channels if not dof.is_rotation}
    turning = [str(dof) for dof in channels if dof.is_rotation]
    largest = np.sqrt((np.abs(motion) ** 2).sum(axis=2)).max(axis=1, initial=0.0)
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0))) or 1.0
    motion *= (_AMPLITUDE * diagonal / np.where(largest > 0, largest, 1.0))[:, None, None]
    notes = [geometry.unit_words] if geometry.unit_words else []
    if len(seen) < len(nodes):
        notes.append("Grey points have no sensor: they stand still in the drawing, whatever the structure does there.")
    if turning:
        notes.append(f"Rotations are not drawn: {', '.join(turning)}.")
    used = [j for j in range(3) if np.ptp(rest[:, j]) > 0 or np.abs(motion[:, :, j]).max() > 0]
    used = sorted({*used, *[j for j in range(3) if j not in used][: max(0, 2 - len(used))]})
    rest, motion = rest[:, used], motion[:, :, used]
    measured, still = _paths(geometry, nodes, seen)
    labels = tuple(f"node {node}" for node in nodes)
    return Scene(rest, motion, labels, _equal_axes(rest, motion, used), measured, still, tuple(notes))


def _equal_axes(positions: FloatArray, motion: ComplexArray, used: list[int]) -> tuple[plot.Axis, ...]:
    """Axes in m, one for each axis in `used`, that hold every mode at every phase with equal margins.

    `used` are indices, 0 for X, 1 for Y, 2 for Z, in the order of the last axes of `positions` (n_points, n_axes) and
    of the complex `motion` (n_modes, n_points, n_axes).
    """
    reach = np.abs(motion).max(axis=0)
    low, high = (positions - reach).min(axis=0), (positions + reach).max(axis=0)
    pad = 0.04 * float(np.max(high - low))
    ends = zip((low - pad).tolist(), (high + pad).tolist(), strict=True)
    return tuple(plot.Axis(DIRECTIONS[j], "m", limits) for j, limits in zip(used, ends, strict=True))


def _paths(geometry: Geometry, nodes: list[int], seen: set[int]) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Chains of point indices by name, with -1 between lines: first those between two sensors, then all others.

    Each result has one chain, or none if there is nothing to draw. Points without lines are in the chain of their kind.
    `nodes` are the node labels in the order of the points, `seen` the indices of those with a sensor. `geometry` has
    the lines, whose node 0 lifts the pen.
    """
    chains: dict[bool, list[int]] = {True: [], False: []}
    touched = set()
    for line in geometry.lines:
        for first, second in pairwise(line):
            if first and second:
                ends = [nodes.index(first), nodes.index(second)]
                touched.update(ends)
                chains[seen.issuperset(ends)] += [*ends, -1]
    for i in range(len(nodes)):
        if i not in touched:
            chains[i in seen] += [i, -1]
    names = {True: "between sensors", False: "not between two sensors"}
    measured, still = ({names[kind]: chain[:-1]} if chain else {} for kind, chain in chains.items())
    return measured, still


def shapes_figure(result: ModesResult) -> plot.Figure:
    """Animated figure of the mode shapes of a modal survey, one at a time, or at most 24 small ones.

    With the survey's geometry they are drawn in space, else over the sensors in a row.
    """
    scene, is_row = mode_scene(result.modes, result.geometry), result.geometry is None
    x, y, *deep = scene.axes
    panels = []
    for k, f in enumerate(result.modes.frequency):
        strip = plot.Strip(y, tuple(_curves(scene, k, is_row)))
        name = f"mode {k + 1}: {value_words(f, result.std[k])} Hz"
        panels.append(plot.Panel(x, (strip,), name=name, z=deep[0] if deep else None, equal=not is_row))
    small, height, columns = ((330.0, 230.0), 520.0, 3) if is_row else ((270.0, 290.0), 640.0, 4)
    choice = plot.Choice("Mode", tuple(range(min(len(panels), plot.MOST_PANELS))), small, moves=True)
    return plot.Figure(tuple(panels), (1150.0, height), columns, " ".join(scene.notes), choice)


def _curves(scene: Scene, mode: int, is_row: bool) -> list[plot.Curve]:
    """Plot curves of one mode (index `mode`): the structure at rest and its measured lines deflected, moving ones last.

    `is_row` is True for sensors in a row, where each direction has its symbol. `scene` has positions, motions of all
    modes and chains of points.
    """
    traces = []
    for number, (name, path) in enumerate(scene.measured.items()):
        symbol = _SYMBOLS[number % len(_SYMBOLS)] if is_row else "circle"
        dash = _DASHES[number % len(_DASHES)] if is_row else "solid"
        label = "at rest" if is_row else f"at rest, {name}"
        traces.append(_curve(scene, path, plot.Pen(palette.RIGID, 1.6), plot.Marker(symbol, 4.0, palette.RIGID), label))
        pen, marker = plot.Pen(palette.VERMILLION, 2.5, dash), plot.Marker(symbol, 6.0, palette.VERMILLION)
        traces.append(_curve(scene, path, pen, marker, name if is_row else "deflected", mode))
    if not is_row and (orbits := _orbits(scene, mode)) is not None:
        traces.append(orbits)
    grey = plot.Pen(palette.FAINT, 1.6), plot.Marker(size=4.0, colour=palette.FAINT)
    traces += [_curve(scene, path, *grey, f"at rest, {name}") for name, path in scene.still.items()]
    return sorted(traces, key=lambda curve: curve.sway is not None)


def _orbits(scene: Scene, mode: int) -> plot.Curve | None:
    """Plot curve of the ellipses that points follow in a cycle of the mode of index `mode` (from 0).

    None if nothing moves or all ellipses are nearly flat. `scene` has positions and motions of all modes.
    """
    motion = scene.motion[mode]
    moving = np.flatnonzero(np.abs(motion).max(axis=1) > 0)
    padded = np.zeros((len(motion), 3), dtype=complex)
    padded[:, : motion.shape[1]] = motion
    areas = np.linalg.norm(np.cross(padded.real, padded.imag), axis=1)
    if not len(moving) or areas.max() <= _FLAT * np.abs(motion).max() ** 2:
        return None
    phases = np.exp(1j * np.linspace(0, 2 * np.pi, _PHASES))
    path = scene.rest[moving, None, :] + (motion[moving, None, :] * phases[:, None]).real
    lifted = np.concatenate([path, np.full((len(moving), 1, path.shape[2]), np.nan)], axis=1)
    x, y, *deep = lifted.reshape(-1, path.shape[2]).T
    return plot.Curve(x, y, plot.Pen(palette.FAINT, 1.0), None, "path of each point", z=deep[0] if deep else None)


def _curve(
    scene: Scene, path: list[int], pen: plot.Pen, marker: plot.Marker, label: str, mode: int | None = None
) -> plot.Curve:
    """Plot curve along the point indices `path` (-1 lifts the pen), moving in mode `mode`, at rest if None.

    `mode` is an index from 0, `label` the entry in the legend; `pen` and `marker` draw lines and points. `scene` has
    positions and motions of all modes.
    """
    lifted = (np.array(path) < 0)[:, None]
    x, y, *deep = np.where(lifted, np.nan, scene.rest[path]).T
    words = tuple("" if i < 0 else scene.labels[i] for i in path)
    sway = None if mode is None else np.where(lifted, 0.0, scene.motion[mode, path])
    return plot.Curve(x, y, pen, marker, label, words, deep[0] if deep else None, sway)

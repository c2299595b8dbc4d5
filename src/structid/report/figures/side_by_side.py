"""Measured shapes and the model's like, moving side by side on the structure, or on one row of sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import likeness, number
from structid.core.dof import DIRECTIONS, Dof
from structid.dynamics import Modes
from structid.fem import Structure
from structid.fem.measuring_points import AimedSensor
from structid.fem.supports import RigidLink
from structid.report.drawing import palette
from structid.report.drawing.picture import cell_edges, is_cells
from structid.report.rendering import plot

if TYPE_CHECKING:
    from structid.compare.mode_correlation import ModesCorrelation

#: Largest displacement, and gap between the two, in parts of the diagonal.
_AMPLITUDE, _GAP = 0.1, 0.3
#: Lines and nodes of a structure that are drawn at most.
_MOST_LINES, _MOST_NODES = 2500, 1200
_MEASURED, _MODEL = palette.MEASURED, palette.FITTED


def side_by_side_figure(correlation: ModesCorrelation) -> plot.Figure | None:
    """Animated figure of measured mode shapes beside their model counterparts; None if no pair has a known shape.

    At most 24 pairs are drawn. Without node positions the sensors are drawn in a row.
    """
    pairs = correlation.pairing.paired[correlation.measured.known[:, correlation.pairing.paired].any(axis=0)]
    chosen = pairs[: plot.MOST_PANELS]
    if not len(chosen):
        return None
    scene = _make_scene(correlation.structure, correlation.measured.channels)
    panels = _row_panels(correlation, chosen) if scene is None else _panels(correlation, chosen, scene)
    caption = (
        "Sensors in a row in the order of the channels, as the nodes of the structure have no places."
        if scene is None
        else "Black: measured shape, carried on to the structure, with dots at the sensors as they were measured. Orange: the"
        " model's, in the same scale. Grey: at rest."
    )
    if len(pairs) > len(chosen):
        caption += f" The first {len(chosen)} of {len(pairs)} pairs."
    small = (330.0, 230.0) if scene is None else (380.0, 300.0)
    choice = plot.Choice("Mode", tuple(range(min(len(panels), 12))), small, moves=True)
    return plot.Figure(panels, (1150.0, 420.0 if scene is None else 620.0), 3, caption, choice)


@dataclass(frozen=True, eq=False)
class _Scene:
    """Geometry for drawing the measured and the modelled shape of a structure beside each other.

    Attributes
    ----------
    nodes : tuple of int
        Labels.
    rest : (n_nodes, 3) float array
        Coordinates, m.
    lines : (n,) int array
        Chain of node indices, with -1 between lines.
    shift : (3,) float array
        From the drawing of the measured shape to that of the model's, m.
    used : list of int
        Axes that are drawn: 0, 1, 2 for X, Y, Z.
    rows : (n_nodes, 3) int array
        Index of each node's displacement in X, Y, Z among the free degrees of freedom; -1 where it is none of these.
    at : (n_channels,) int array
        Node index of each sensor.
    along : (n_channels, 3) float array
        Unit direction of each sensor with its sign; 0 for rotations.
    diagonal : float
        Of the box around all nodes, m.
    """

    nodes: tuple[int, ...]
    rest: FloatArray
    lines: IntArray
    shift: FloatArray
    used: list[int]
    rows: IntArray
    at: IntArray
    along: FloatArray
    diagonal: float


def model_shapes_figure(structure: Structure, modes: Modes) -> plot.Figure | None:
    """Animated figure of the first 24 mode shapes of a model at most, each scaled to the same largest motion.

    None if there are no modes, or nodes all have the same position or cannot move.
    """
    scene = _make_scene(structure, ())
    n_modes = min(len(modes.frequency), plot.MOST_PANELS)
    if scene is None or n_modes == 0:
        return None
    motion = _moved(structure, scene, modes.mode_shapes[:, :n_modes])
    largest = np.abs(motion).max(axis=(1, 2))
    scale = _AMPLITUDE * scene.diagonal / np.where(largest > 0, largest, 1.0)
    reach = 1.3 * _AMPLITUDE * scene.diagonal
    low, high = scene.rest.min(axis=0) - reach, scene.rest.max(axis=0) + reach
    x, y, *deep = (plot.Axis(DIRECTIONS[j], "m", (float(low[j]), float(high[j]))) for j in scene.used)
    panels = []
    for k in range(n_modes):
        rest = _curve(scene, scene.lines, np.zeros(3), plot.Pen(palette.FAINT, 1.0), None, "at rest")
        pen = plot.Pen(_MODEL, 2.2)
        moved = _curve(scene, scene.lines, np.zeros(3), pen, None, "identified model", scale[k] * motion[k])
        name = f"mode {k + 1}: {number(float(modes.frequency[k]), 4)} Hz"
        panels.append(
            plot.Panel(x, (plot.Strip(y, (rest, moved)),), name=name, z=deep[0] if deep else None, equal=True)
        )
    columns = min(n_modes, 3)
    choice = plot.Choice("Mode", tuple(range(min(n_modes, 12))), (1000.0 / columns, 300.0), moves=True)
    return plot.Figure(
        tuple(panels), (1150.0, 560.0), columns, "Shapes of the identified model. Grey: at rest.", choice
    )


def _make_scene(structure: Structure, channels: Sequence[Dof]) -> _Scene | None:
    """Geometry for drawing shapes of a structure and of the sensors `channels` in space.

    Measured and model shape stand side by side along the axis of least extent. None if all nodes have the same
    coordinates or no node has a free translation.
    """
    labels = tuple(structure.nodes)
    rest = np.zeros((len(labels), 3))
    rest[:, : structure.dimension] = np.array([structure.nodes[node] for node in labels])
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
    if diagonal == 0:
        return None
    positions = {node: i for i, node in enumerate(labels)}
    rows = np.full((len(labels), 3), -1)
    for row, code in enumerate(structure.numbering.codes.tolist()):
        node, axis = divmod(code, 6)
        if node in positions and axis < 3:
            rows[positions[node], axis] = row
    if not (rows >= 0).any():
        return None
    aimed = {tie.dof: tie for tie in structure.ties if isinstance(tie, AimedSensor)}
    along = np.zeros((len(channels), 3))
    at = np.array([positions[dof.node] for dof in channels], dtype=int)
    for c, dof in enumerate(channels):
        sensor = aimed.get(dof.unsigned)
        if sensor is not None:
            at[c], along[c] = positions[sensor.node], dof.sign * np.array(sensor.direction)
        elif not dof.is_rotation:
            along[c, dof.axis] = dof.sign
    extent = np.ptp(rest, axis=0)
    moving = [axis for axis in range(3) if extent[axis] > 0 or (rows[:, axis] >= 0).any()]
    used = sorted({*moving, *[axis for axis in range(3) if axis not in moving][: max(0, 2 - len(moving))]})
    aside = min(used, key=lambda axis: (extent[axis] == 0 and axis == 2, extent[axis], axis))
    shift = np.zeros(3)
    shift[aside] = extent[aside] + _GAP * diagonal
    return _Scene(labels, rest, _lines(structure, positions), shift, used, rows, at, along, diagonal)


def _lines(structure: Structure, row_of: dict[int, int]) -> IntArray:
    """Edges of the elements and rigid links as one chain of node rows, with -1 between lines.

    Above 2500 edges, or without any, single nodes, at most 1200. `row_of` maps node labels to rows. The result is (n,).
    """
    edges: dict[tuple[int, int], None] = {}
    for element in structure.elements:
        pairs = cell_edges(element) if is_cells(element) else _spans(element.nodes)
        edges.update(dict.fromkeys((min(edge), max(edge)) for edge in pairs))
    for tie in structure.ties:
        if isinstance(tie, RigidLink):
            edges.update(dict.fromkeys((tie.main, node) for node in tie.dependents))
    if not edges or len(edges) > _MOST_LINES:
        step = -(-len(row_of) // _MOST_NODES)
        return np.array([entry for i in range(0, len(row_of), step) for entry in (i, -1)])
    chain: list[int] = []
    for first, second in edges:
        if first in row_of and second in row_of:
            one, other = row_of[first], row_of[second]
            chain += [other] if chain and chain[-1] == one else [*([-1] if chain else []), one, other]
    return np.array(chain)


def _spans(nodes: IntArray) -> list[tuple[int, int]]:
    """Pairs of node labels that two-node elements join; `nodes` (n_elements, n) is filled up with -1."""
    rows = [row[row >= 0].tolist() for row in np.atleast_2d(nodes)]
    return [pair for row in rows if len(row) == 2 for pair in pairwise(row)]


def _panels(correlation: ModesCorrelation, chosen: IntArray, scene: _Scene) -> tuple[plot.Panel, ...]:
    """Plot panels, one for each mode pair, with measured and model shape side by side; all have the same axes.

    `chosen` (n_chosen,) are the indices of the measured modes. A measured shape is drawn as expanded to the structure,
    or as the model's if it was not, with dots at the sensors as measured. Each pair has its scale. `scene` is the
    geometry, with rows of nodes and sensors.
    """
    structure = correlation.structure
    like = correlation.model.mode_shapes @ correlation.coefficients[:, chosen]
    carried = like if correlation.expanded is None else correlation.expanded.shapes[:, chosen]
    moved = [_moved(structure, scene, shapes) for shapes in (carried, like)]
    at_sensors = [correlation.shapes[:, chosen], correlation.seen @ correlation.coefficients[:, chosen]]
    dots = [np.einsum("cm,cx->mcx", np.nan_to_num(values), scene.along) for values in at_sensors]
    largest = np.array([max(float(np.abs(m[k]).max()) for m in (*moved, *dots)) for k in range(len(chosen))])
    scale = _AMPLITUDE * scene.diagonal / np.where(largest > 0, largest, 1.0)
    reach = 1.3 * _AMPLITUDE * scene.diagonal
    low = np.minimum(scene.rest.min(axis=0), scene.rest.min(axis=0) + scene.shift) - reach
    high = scene.rest.max(axis=0) + scene.shift + reach
    x, y, *deep = (plot.Axis(DIRECTIONS[j], "m", (float(low[j]), float(high[j]))) for j in scene.used)
    panels, known = [], correlation.measured.known
    for k, i in enumerate(chosen.tolist()):
        curves: list[plot.Curve] = []
        sides = ((0.0, _MEASURED, "measured"), (1.0, _MODEL, "model"))
        for (side, colour, label), motion, dot in zip(sides, moved, dots, strict=True):
            offset = side * scene.shift
            curves.append(_curve(scene, scene.lines, offset, plot.Pen(palette.FAINT, 1.0), None, "at rest"))
            sway = scale[k] * motion[k]
            curves.append(_curve(scene, scene.lines, offset, plot.Pen(colour, 2.2), None, label, sway))
            there = scene.at[known[:, i]] if label == "measured" else scene.at
            own = np.stack([there, np.full(len(there), -1)], axis=1).ravel()
            swing = np.zeros((len(scene.nodes), 3))
            np.add.at(swing, scene.at, scale[k] * dot[k])
            marker = plot.Marker("circle", 5.0 if len(scene.at) <= 30 else 3.0, colour)
            curves.append(_curve(scene, own, offset, None, marker, f"{label} at sensors", swing))
        curves.sort(key=lambda curve: curve.sway is not None)
        strip = plot.Strip(y, tuple(curves))
        panels.append(plot.Panel(x, (strip,), name=_name(correlation, i), z=deep[0] if deep else None, equal=True))
    return tuple(panels)


def _moved(structure: Structure, scene: _Scene, shapes: FloatArray) -> FloatArray:
    """Displacements X, Y, Z of the nodes, (n_modes, n_nodes, 3), from mode shapes `shapes`; 0 for fixed directions."""
    everything = np.vstack([structure.numbering.matrix @ shapes, np.zeros((1, shapes.shape[1]))])
    return np.moveaxis(everything[scene.rows], 2, 0)


def _curve(
    scene: _Scene,
    path: IntArray,
    offset: FloatArray,
    pen: plot.Pen | None,
    marker: plot.Marker | None,
    label: str,
    motion: FloatArray | None = None,
) -> plot.Curve:
    """Plot curve along the node rows `path` (-1 lifts the pen), shifted by `offset` (m).

    `motion` (n_nodes, 3) is the displacement that animates it, None at rest. A path without lines is drawn as dots.
    `label` is its entry in the legend. `pen` draws lines and `marker` points; None draws none. `scene` has the
    positions of the nodes.
    """
    lifted = (path < 0)[:, None]
    x, y, *deep = np.where(lifted, np.nan, (scene.rest + offset)[path][:, scene.used]).T
    words = None if marker is None else tuple("" if i < 0 else f"node {scene.nodes[i]}" for i in path.tolist())
    sway = None if motion is None else np.where(lifted, 0.0, motion[path][:, scene.used]).astype(complex)
    is_dots = not (path[1:] >= 0)[path[:-1] >= 0].any()
    if pen is not None and is_dots:
        marker = plot.Marker("circle", 2.5, pen.colour)
        pen = None
    return plot.Curve(x, y, pen, marker, label, words, deep[0] if deep else None, sway)


def _row_panels(correlation: ModesCorrelation, chosen: IntArray) -> tuple[plot.Panel, ...]:
    """Plot panels of mode pairs without geometry, one for each: measured and model shape over the sensors in a row.

    `chosen` (n_chosen,) are the indices of the measured modes; each pair is scaled to a largest entry of 1.
    """
    names = [str(dof) for dof in correlation.measured.channels]
    positions = np.arange(len(names), dtype=float)
    x = plot.Axis("sensor", limits=(-0.5, len(names) - 0.5), ticks=plot.named_ticks(names, 40))
    y = plot.Axis("shape", "1", (-1.2, 1.2))
    rest = np.zeros(len(names))
    panels = []
    for i in chosen.tolist():
        own, like = correlation.shapes[:, i], correlation.seen @ correlation.coefficients[:, i]
        size, known = float(np.nanmax(np.abs([own, like]))), ~np.isnan(own)
        curves = [plot.Curve(positions, rest, plot.Pen(palette.FAINT, 1.0), None, "at rest")]
        for values, colour, label, symbol in (
            (own, _MEASURED, "measured", "circle"), (like, _MODEL, "model", "diamond"),
        ):  # fmt: skip
            shown = known if label == "measured" else np.ones(len(names), bool)
            sway = np.column_stack([rest, values / size])[shown].astype(complex)
            marker, told = plot.Marker(symbol, 6.0, colour), tuple(np.array(names)[shown].tolist())
            curves.append(
                plot.Curve(positions[shown], rest[shown], plot.Pen(colour, 2.0), marker, label, told, sway=sway)
            )
        panels.append(plot.Panel(x, (plot.Strip(y, tuple(curves)),), name=_name(correlation, i)))
    return tuple(panels)


def _name(correlation: ModesCorrelation, i: int) -> str:
    """Name of the pair of measured mode `i` (from 0): mode number, both frequencies (Hz) and the MAC."""
    k = int(correlation.pairing.number[i])
    own, like = number(float(correlation.measured.frequency[i]), 4), number(float(correlation.model.frequency[k]), 4)
    return f"mode {i + 1}: {own} Hz beside {like} Hz, MAC {likeness(float(correlation.pairing.mac[i, k]), 2)}"

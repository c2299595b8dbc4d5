"""Figures of `structid modes`: poles over the order, singular values, damping, MAC and realness of shapes, and shapes that move.

Shapes move at the sensors on their geometry, or in a row where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import DASH, number, value_words
from structid.core.dof import DIRECTIONS, Dof
from structid.modal import ModalRecord
from structid.modal.poles.poles import modal_phase_collinearity
from structid.modal.survey.survey import ModesResult
from structid.modal.tracking import ModeTracks
from structid.records import FrfRecord, Geometry
from structid.report.drawing import palette, symbols
from structid.report.rendering import plot
from structid.similarity import mac, real_turn

#: What a pole of the sweep is: shut out by the criteria, alone, in the cluster of a mode, or the mode itself.
OUTSIDE, ALONE, CLUSTERED, CHOSEN = 0, 1, 2, 3
#: Told apart by shape as well as by colour.
_KINDS = (
    ("outside the criteria", plot.Marker(size=3.0, colour=palette.FAINT)),
    ("not in a cluster", plot.Marker("x-thin", 6.0, "", plot.Pen(palette.MUTED, 1.2))),
    ("in the cluster of a mode", plot.Marker("circle", 6.5, "white", plot.Pen(palette.BLUE, 1.6))),
    ("the mode itself", plot.Marker("diamond", 10.0, palette.VERMILLION, plot.Pen("white", 1.0))),
)
_SINGULAR = (
    ("first singular value", plot.Pen(palette.INK, 1.4)),
    ("second singular value", plot.Pen(palette.BLUE, 1.4, "dash")),
    ("third singular value", plot.Pen(palette.PURPLE, 1.4, "dot")),
)
_MOST_LINES = 2400
_COLOURS = (palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.INK)


def pole_kinds(result: ModesResult) -> list[np.ndarray]:
    """Kind of each pole, one integer array (n_poles,) for each model order of the sweep.

    Kinds are 0 for a pole outside the criteria, 1 for one alone, 2 for one of a cluster and 3 for one chosen as a mode.
    Without clusters the pole nearest to each mode in frequency and damping is the chosen one.
    """
    found, modes = result.identification, result.modes
    kinds = [np.full(len(poles.poles), OUTSIDE) for poles in found.sweep]
    for kind, poles in zip(kinds, found.sweep, strict=True):
        kind[found.options.criteria.indices(poles)] = ALONE
    for cluster in found.clusters:
        for order, index in zip(cluster.number, cluster.index, strict=True):
            kinds[order][index] = CLUSTERED
        kinds[cluster.number[cluster.chosen]][cluster.index[cluster.chosen]] = CHOSEN
    if not found.clusters:  # one order: the poles nearest to the modes
        for f, ratio in zip(modes.frequency, modes.damping_ratio, strict=True):
            gaps = [np.abs(p.frequency / f - 1) + np.abs(p.damping_ratio - ratio) for p in found.sweep]
            which = int(np.argmin([gap.min(initial=np.inf) for gap in gaps]))
            kinds[which][int(gaps[which].argmin())] = CHOSEN
    return kinds


def stabilization_figure(result: ModesResult) -> plot.Figure | None:
    """Stabilization diagram: poles by frequency and model order over the first singular value of the spectra.

    Kinds of poles have different marks, and modes a line. None without model orders.
    """
    sweep = result.identification.sweep
    if not sweep:
        return None
    frequency = np.concatenate([poles.frequency for poles in sweep])
    ratio = 100 * np.concatenate([poles.damping_ratio for poles in sweep])
    order = np.repeat([float(poles.order) for poles in sweep], [len(poles.poles) for poles in sweep])
    kinds, top = np.concatenate(pole_kinds(result)), float(order.max()) * 1.04 + 1
    x, values = _thinned_lines(result, 1)
    traces: list[plot.Trace] = [
        plot.Curve(x, values[:, 0], plot.Pen(palette.SKY, 1.4), label="first singular value", right=True),
        *_mode_marks(result, (0.0, top)),
    ]
    for kind, (label, marker) in enumerate(_KINDS):
        f, n, r = (values[kinds == kind] for values in (frequency, order, ratio))
        rows = zip(n.tolist(), f.tolist(), r.tolist(), strict=True)
        texts = tuple(f"order {n:g}: {f:.6g} Hz, damping {r:.4g} %" for n, f, r in rows)
        traces.append(plot.Curve(f, n, None, marker, label, texts))
    right = plot.Axis("first of the singular values", result.spectra.unit, _spectrum_limits(result), log=True)
    y = plot.Axis("order of the model (states)", limits=(0.0, top))
    strip = plot.Strip(y, tuple(trace for trace in traces if len(trace.x)), right=right)
    caption = (
        "Poles of the models of all orders. A mode keeps its place from order to order; a pole of noise does not."
        f" Behind them: {result.spectra.name}. Double-click for the whole range."
    )
    panel = plot.Panel(plot.Axis("frequency", "Hz", _view(result)), (strip,))
    return plot.Figure((panel,), (900.0, 520.0), caption=caption)


def _view(result: ModesResult) -> plot.Limits:
    """Frequency limits (low, high) in Hz of the range shown first: about the band, or up to 1.5 times the highest mode.

    A band is widened by 5 %; without one the range begins at 0, or at the first line of FRFs that begin near the lowest
    mode.
    """
    lines, modes = result.spectra.frequency, result.modes.frequency
    high = min(float(lines[-1]), 1.5 * float(modes.max(initial=0.0)) or float(lines[-1]))
    low = 0.0
    if isinstance(result.record, FrfRecord) and len(modes) and lines[0] > 0.3 * modes.min():
        low = float(lines[0])
    if result.options.band is not None:
        low, wanted = result.options.band
        high = min(float(lines[-1]), wanted * 1.05)
        low = max(0.0, low - 0.05 * (high - low))
    return low, high


def mode_labels(result: ModesResult) -> list[tuple[float, str]]:
    """Labels of the modes in the range shown first: pairs of frequency (Hz) and text with the mode number.

    Modes closer than 2.2 % of the range share a label.
    """
    low, high = _view(result)
    labels: list[tuple[float, list[int]]] = []
    for k, f in enumerate(result.modes.frequency.tolist()):
        if not low <= f <= high:
            continue
        if labels and f - labels[-1][0] < 0.022 * (high - low):
            labels[-1][1].append(k + 1)
        else:
            labels.append((f, [k + 1]))
    return [(f, ",".join(map(str, group)) if len(group) < 4 else f"{group[0]}{DASH}{group[-1]}") for f, group in labels]


def _mode_marks(result: ModesResult, limits: plot.Limits) -> tuple[plot.Trace, ...]:
    """Plot traces of a vertical line at every mode, from the lower to the upper of `limits`, with its number on top."""
    f, labels = result.modes.frequency, mode_labels(result)
    at, words = np.array([x for x, _ in labels]), tuple(text for _, text in labels)
    height = np.full(len(at), 0.9999 * limits[1])
    return (
        plot.segments((f, f), limits, plot.Pen(palette.VERMILLION, 1.0)),
        plot.Texts(at, height, words, palette.VERMILLION, 11.0, "top center"),
    )


def _thinned_lines(result: ModesResult, n_values: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies (n,) in Hz and the first `n_values` singular values (n, n_values) of the spectra.

    Above 2400 lines, neighbouring lines are grouped: their mean frequency and largest values; lines of an incomplete
    last group are dropped.
    """
    frequency, values = result.spectra.frequency, result.spectra.values[:, :n_values]
    step = -(-len(frequency) // _MOST_LINES)
    if step == 1:
        return frequency, values
    whole = len(frequency) // step * step
    grouped = values[:whole].reshape(-1, step, values.shape[1])
    return frequency[:whole].reshape(-1, step).mean(axis=1), grouped.max(axis=1)


def _spectrum_limits(result: ModesResult) -> plot.Limits:
    """Limits (low, high) of the logarithmic axis for the first three singular values in the range shown first.

    They hold all positive values down to 1e-9 of the largest, with room at both ends. Where the range begins at 0 Hz,
    lines below a quarter of the first mode's frequency do not count, as drift may be large there. (0.1, 10) without
    positive values.
    """
    low, high = _view(result)
    if low == 0 and result.modes.n_modes:  # drift stands above every mode, and would set the scale
        low = 0.25 * float(result.modes.frequency[0])
    inside = (result.spectra.frequency >= low) & (result.spectra.frequency <= high)
    values = result.spectra.values[inside, :3] if inside.any() else result.spectra.values[:, :3]
    positive = values[values > 0]
    if not positive.size:
        return 0.1, 10.0
    top = float(positive.max())
    return max(float(positive.min()), 1e-9 * top) / 2, 3 * top


def spectra_figure(result: ModesResult) -> plot.Figure:
    """Figure of the first three singular values of the spectra over frequency (Hz), with the modes marked."""
    frequency, values = _thinned_lines(result, len(_SINGULAR))
    limits = _spectrum_limits(result)
    curves = [
        plot.Curve(frequency, column, pen, label=label, hover=plot.NUMBERS)
        for column, (label, pen) in zip(values.T, _SINGULAR, strict=False)
    ]
    y = plot.Axis("singular values", result.spectra.unit, limits, log=True)
    panel = plot.panel(plot.Axis("frequency", "Hz", _view(result)), y, *_mode_marks(result, limits), *curves)
    caption = (
        f"The {result.spectra.name}; one line that stands out is one mode there, two are two. Numbers: modes."
        " Double-click for the whole range."
    )
    return plot.Figure((panel,), (900.0, 400.0), caption=caption)


def damping_figure(result: ModesResult) -> plot.Figure | None:
    """Figure of damping ratio (%) over frequency with error bars of one standard deviation; None if no damping is known."""
    modes, n = result.modes, result.modes.n_modes
    known = np.flatnonzero(np.isfinite(modes.damping_ratio))
    if not len(known):
        return None
    f, ratio, f_std, ratio_std = modes.frequency, 100 * modes.damping_ratio, result.std[:n], 100 * result.std[n:]
    texts = tuple(
        f"mode {k + 1}: {value_words(f[k], f_std[k])} Hz, {value_words(ratio[k], ratio_std[k])} %" for k in known
    )
    f, ratio, f_std, ratio_std = (np.nan_to_num(values[known]) for values in (f, ratio, f_std, ratio_std))
    low, high = ratio - ratio_std, ratio + ratio_std
    panel = plot.panel(
        plot.Axis("frequency", "Hz", _view(result)),
        plot.Axis("damping ratio", "%", (min(0.0, 1.1 * float(low.min())), max(1.12 * float(high.max()), 0.1))),
        plot.segments((f, f), (low, high), plot.Pen(palette.INK)),
        plot.segments((f - f_std, f + f_std), (ratio, ratio), plot.Pen(palette.INK)),
        plot.Curve(f, ratio, None, plot.Marker("diamond", 9.0, palette.VERMILLION), hover=texts),
        plot.Texts(f, ratio, tuple(f"{k + 1}" for k in known), palette.VERMILLION, 11.0, "top right"),
    )
    caption = "Damping ratios; bars: one standard deviation. Without bars: the method gives none."
    return plot.Figure((panel,), (900.0, 340.0), caption=caption)


def mac_figure(result: ModesResult) -> plot.Figure:
    """Matrix figure of the MAC between all pairs of identified modes of one survey."""
    n = result.modes.n_modes
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "MAC")
    names = tuple(f"{k + 1}" for k in range(n))
    panel = plot.matrix_panel(mac(result.modes.mode_shapes), names, "mode", scale)
    caption = (
        "Modal assurance criterion between the shapes at the sensors: 1 where two shapes agree, 0 where they are"
        " orthogonal. Modes alike at few sensors may still differ elsewhere."
    )
    size = min(260.0 + 34 * n, 620.0)
    return plot.Figure((panel,), (size + 90, size), caption=caption)


def mpc(result: ModesResult) -> FloatArray:
    """Modal phase collinearity of every mode, (n_modes,), from 0 to 1 for a real shape."""
    return modal_phase_collinearity(np.asarray(result.modes.mode_shapes, dtype=np.complex128))


def complexity_figure(result: ModesResult) -> plot.Figure:
    """Figure of the complex entries of each mode shape, one circle for each of the first 24 modes.

    Each shape is turned to be as real as possible and scaled to a largest entry of size 1.
    """
    shapes, collinearity = np.asarray(result.modes.mode_shapes, dtype=np.complex128), mpc(result)
    shapes = shapes * real_turn(shapes)
    shapes = shapes / np.nanmax(np.abs(shapes), axis=0)
    names = [str(dof) for dof in result.modes.channels]
    panels = tuple(
        _circle(f"mode {k + 1}: {number(f)} Hz, MPC {collinearity[k]:.3f}", shapes[:, k], names)
        for k, f in enumerate(result.modes.frequency[: plot.MOST_PANELS])
    )
    caption = (
        "Entries of each shape in the complex plane, one line a channel. All on one diameter: every sensor moves in phase"
        " or in opposition, as in a structure with light or proportional damping (MPC 1). A fan: damping in one place, noise,"
        " or two modes in one."
    )
    if result.modes.n_modes > len(panels):
        caption += f" The first {len(panels)} of {result.modes.n_modes} modes."
    return plot.Figure(panels, (290.0, 290.0), 4, caption)


def _circle(title: str, shape: ComplexArray, names: list[str]) -> plot.Panel:
    """Plot panel of the complex entries `shape` (n_channels,) of one mode, as lines from the centre of a unit circle.

    `names` are those of the channels. `title` stands above the panel.
    """
    x, y = shape.real, shape.imag
    rings = symbols.joined(symbols.disc(np.zeros(2), radius) for radius in (0.5, 1.0))
    angles = np.degrees(np.angle(shape))
    texts = tuple(f"{name}: {abs(e):.3g} at {a:.3g}°" for name, e, a in zip(names, shape, angles, strict=True))
    round_ = np.array([1.16, 0.0, -1.16, 0.0])
    grid = plot.Pen(palette.FAINT, 1.0)
    reach = plot.Axis(limits=(-1.35, 1.35))
    traces = (
        plot.Curve(rings[:, 0], rings[:, 1], grid),
        plot.segments(([-1.0, 0.0], [1.0, 0.0]), ([0.0, -1.0], [0.0, 1.0]), plot.Pen(palette.GRID, 1.0)),
        plot.segments((0.0, x), (0.0, y), plot.Pen(palette.BLUE, 1.6)),
        plot.Curve(x, y, None, plot.Marker("circle", 7.0, palette.VERMILLION, plot.Pen("white", 0.8)), hover=texts),
        plot.Texts(round_, np.roll(round_, 1), ("0°", "90°", "180°", "270°"), palette.MUTED, 10.0),
    )
    return plot.Panel(reach, (plot.Strip(reach, traces),), title, title, equal=True, bare=True)


def tracks_figure(tracks: ModeTracks) -> plot.Figure:
    """Figure of the relative change (%) of each tracked natural frequency over the records.

    Changes count from the first record that shows the mode; bars are one standard deviation.
    """
    number = np.arange(len(tracks.names))
    traces: list[plot.Trace] = []
    change = 100 * tracks.change
    std = 100 * np.nan_to_num(tracks.frequency_std / np.where(tracks.frequency > 0, tracks.frequency, 1.0))
    for k in range(tracks.n_tracks):
        seen, pen = np.flatnonzero(tracks.members[:, k] >= 0), plot.Pen(_COLOURS[k % len(_COLOURS)], 1.4)
        x, y, half = number[seen], change[seen, k], std[seen, k]
        texts = tuple(
            f"{tracks.names[i]}: {value_words(tracks.frequency[i, k], tracks.frequency_std[i, k])} Hz" for i in seen
        )
        label = f"{np.nanmean(tracks.frequency[:, k]):.4g} Hz"
        marker = plot.Marker("circle", 6.0, _COLOURS[k % len(_COLOURS)])
        traces.append(plot.segments((x, x), (y - half, y + half), pen))
        traces.append(plot.Curve(x.astype(float), y, pen, marker, label, hover=texts))
    panel = plot.panel(
        plot.Axis("record", "", (-0.5, len(number) - 0.5), ticks=plot.named_ticks(tracks.names)),
        plot.Axis("change of frequency", "%"),
        *traces,
    )
    caption = (
        "Change of each natural frequency since the first record that shows it; bars: one standard deviation. Temperature and"
        " load move all modes alike, damage some more than others."
    )
    return plot.Figure((panel,), (900.0, 420.0), caption=caption)


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
    for i, (name, path) in enumerate(scene.measured.items()):
        symbol = _SYMBOLS[i % len(_SYMBOLS)] if is_row else "circle"
        dash = _DASHES[i % len(_DASHES)] if is_row else "solid"
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

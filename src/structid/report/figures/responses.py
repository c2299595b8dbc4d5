"""Measured and fitted frequency response functions, and what is left between them, by channel and frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import percent
from structid.core.dof import Dof
from structid.identification.identified import RecordFit
from structid.report.drawing import palette
from structid.report.rendering import plot

#: Most channels in a picture.
MAX_CHANNELS = 16
#: Beyond this many values of a figure the lines are thinned, to keep the page small.
MOST_VALUES = 250_000
_MOTION = {"receptance": ("m", "rad"), "mobility": ("m/s", "rad/s"), "accelerance": ("m/s^2", "rad/s^2")}
_TURNS = tuple((float(angle), str(angle).replace("-", "\u2212")) for angle in (-180, -90, 0, 90, 180))
_FITTED, _INITIAL = plot.Pen(palette.FITTED, 1.8), plot.Pen(palette.INITIAL, 1.2, "dash")
#: Fewer lines than this stand apart.
_FEW = 12


@dataclass(frozen=True)
class Channel:
    """One sensor and load: name, unit, and relative errors of the FRF over the lines on which the fit is judged.

    They are median and 90 % quantile of the fitted model, and the median of the initial one.
    """

    label: str
    unit: str
    median_error: float
    high_error: float
    median_error_initial: float


def channels(fit: RecordFit) -> tuple[Channel, ...]:
    """Every pair of sensor and load with its relative errors, in the order of the record; loads vary fastest.

    Errors are medians and 90 % quantiles over the lines on which the fit is judged.
    """
    record, errors = fit.evaluation, fit.relative_error
    parts = (np.median(errors, axis=0), np.quantile(errors, 0.9, axis=0), np.median(fit.initial_relative_error, axis=0))
    return tuple(
        Channel(f"{sensor}/{load}", channel_unit(record.kind, sensor, load), *row)
        for (sensor, load), row in zip(
            product(record.outputs, record.inputs), np.stack(parts, axis=-1).reshape(-1, 3).tolist(), strict=True
        )
    )


def channel_unit(kind: str, sensor: Dof, load: Dof) -> str:
    """SI unit of an FRF of this `kind` between a sensor and a load, which may be a rotation and a moment.

    `kind` is "receptance", "mobility", "accelerance" or "transmissibility".
    """
    if kind == "transmissibility":
        return "1" if sensor.is_rotation == load.is_rotation else "rad/m" if sensor.is_rotation else "m/rad"
    motion = _MOTION[kind][sensor.is_rotation]
    top = f"({motion})" if "/" in motion else motion
    return f"{top}/{'(N m)' if load.is_rotation else 'N'}"


def worst_channels(fit: RecordFit, count: int = MAX_CHANNELS) -> list[int]:
    """Indices of the `count` channels with the largest median relative error, in increasing order."""
    errors = np.array([channel.median_error for channel in channels(fit)])
    return sorted(np.argsort(-errors, kind="stable")[:count].tolist())


def responses_figure(fit: RecordFit) -> plot.Figure:
    """Figure of magnitude, phase and coherence of measured and model FRFs, one channel at a time.

    Models are drawn at the lines that were used or judged. Above 250 000 values only every k-th line is drawn, and the
    caption says so. The channels shown at first are those of largest median error.
    """
    whole, found, shown = fit.measured, channels(fit), worst_channels(fit)
    stride = max(1, -(-whole.values.size // MOST_VALUES))
    rows = np.searchsorted(whole.frequency, fit.problem.record.frequency)
    judged = np.searchsorted(whole.frequency, fit.evaluation.frequency)
    used = np.isin(np.arange(len(whole.frequency)), rows)
    fitted, initial = (np.full(whole.values.shape, np.nan, dtype=np.complex128) for _ in range(2))
    fitted[judged], initial[judged] = fit.evaluation_predicted, fit.evaluation_initial
    fitted[rows], initial[rows] = fit.predicted, fit.predicted_initial
    tables = np.array([table.reshape(len(used), -1)[::stride] for table in (whole.values, initial, fitted)])
    coherence = None if whole.coherence is None else whole.coherence.reshape(len(used), -1)[::stride]
    low, high = float(whole.frequency[0]), float(whole.frequency[-1])
    x = plot.Axis("frequency", "Hz", (low, high) if high > low else (low - 0.5, high + 0.5))
    panels = []
    for c, channel in enumerate(found):
        strips = _strips(
            whole.frequency[::stride], used[::stride], tables[:, :, c], plot.Axis(whole.kind, channel.unit)
        )
        if coherence is not None:
            strips.append(_coherence(whole.frequency[::stride], used[::stride], coherence[:, c]))
        error, before = (percent(e, 3, signed=False) for e in (channel.median_error, channel.median_error_initial))
        title = f"{channel.label}: median relative error {error}, initial model {before}"
        panels.append(plot.Panel(x, tuple(strips), title, channel.label))
    columns = 1 if len(shown) == 1 else 2 if len(shown) <= 4 else 3 if len(shown) <= 9 else 4
    note = (
        f"{len(shown)} of {len(found)} channels: those with the largest median relative error; all are in report.html"
    )
    small = (1150 / columns, 190.0 if len(shown) > columns else 300.0)
    choice = plot.Choice("Channel (sensor/load)", tuple(shown), small, note if len(shown) < len(found) else "")
    caption = "Lines outside the band, or left out, are grey."
    caption += f" Every {stride}th line of the record is shown here." if stride > 1 else ""
    height = 620.0 if coherence is None else 720.0
    return plot.Figure(tuple(panels), (1150.0, height), columns, caption, choice)


def extremes_figure(fit: RecordFit) -> plot.Figure:
    """Figure of the FRF magnitudes of the channels with largest and smallest median error.

    One panel if they are the same channel.
    """
    whole = responses_figure(fit)
    errors = np.array([channel.median_error for channel in channels(fit)])
    chosen = dict.fromkeys((int(np.argmax(errors)), int(np.argmin(errors))))
    panels = tuple(
        replace(
            whole.panels[index], strips=whole.panels[index].strips[:1], title=f"{word}, {whole.panels[index].title}"
        )
        for index, word in zip(chosen, ("Worst", "Best"), strict=False)
    )
    return plot.Figure(panels, (560.0, 340.0), len(panels), whole.caption)


def _strips(frequency: FloatArray, used: np.ndarray, values: ComplexArray, y: plot.Axis) -> list[plot.Strip]:
    """Plot strips of magnitude and phase (degrees) of one channel.

    `values` (3, n_lines) are measured, initial and fitted FRF, NaN where a model is not drawn; `used` (n_lines,) is
    True for the lines used in the fit. `frequency` (n_lines,) is in Hz; `y` is the axis of magnitudes.
    """
    sizes, angles = np.where(np.abs(values) > 0, np.abs(values), np.nan), np.degrees(np.angle(values))
    turns = np.abs(np.diff(angles[1:], axis=1, prepend=angles[1:, :1])) > 270
    angles[1:][turns] = np.nan  # a gap where the phase would jump by a turn
    phase = plot.Axis("phase", "degrees", (-190.0, 190.0), ticks=_TURNS)
    magnitude = plot.Axis(y.label, y.unit, plot.decade_limits(sizes), log=True)
    faint = (plot.Pen(palette.OUTSIDE, 1.2), None), (None, plot.Marker(size=2.0, colour=palette.OUTSIDE))
    return [
        plot.Strip(magnitude, _curves(frequency, used, sizes, *faint[0]), 0.55, name="magnitude"),
        plot.Strip(phase, _curves(frequency, used, angles, *faint[1]), 0.27, name="phase"),
    ]


def _curves(
    frequency: FloatArray, used: np.ndarray, values: FloatArray, pen: plot.Pen | None, dot: plot.Marker | None
) -> tuple[plot.Trace, ...]:
    """Plot curves of one channel: measured values at unused and used lines, then initial and fitted model.

    `values` (3, n_lines) are measured, initial and fitted; `pen` and `dot` draw the unused lines. `frequency`
    (n_lines,) is in Hz, `used` a mask (n_lines,); None for `pen` or `dot` draws no lines or no points.
    """
    measured, initial, fitted = values
    count = int(used.sum())
    inside = plot.Marker(size=float(np.clip(4.2 * np.sqrt(300 / max(count, 1)), 2.2, 4.2)), colour=palette.MEASURED)
    marks = [plot.Marker(size=5.0, colour=own.colour) if count < _FEW else None for own in (_INITIAL, _FITTED)]
    traces = (
        (np.where(used, np.nan, measured), pen, dot, "measured, not used"),
        (np.where(used, measured, np.nan), None, inside, "measured"),
        (initial, _INITIAL, marks[0], "initial model"),
        (fitted, _FITTED, marks[1], "fitted model"),
    )
    shown = traces[1:] if used.all() else traces
    return tuple(plot.Curve(frequency, y, own, mark, label, plot.NUMBERS) for y, own, mark, label in shown)


def _coherence(frequency: FloatArray, used: np.ndarray, values: FloatArray) -> plot.Strip:
    curves = tuple(
        plot.Curve(frequency, np.where(which, values, np.nan), plot.Pen(colour, 1.1), hover=plot.NUMBERS)
        for which, colour in ((~used, palette.OUTSIDE), (used, palette.MEASURED))
    )
    return plot.Strip(plot.Axis("coherence", "1", (0.0, 1.05)), curves, 0.18, name="coherence")


def residual_channels_figure(fit: RecordFit) -> plot.Figure:
    """Figure of the relative error (%) of every channel: median and 90 % quantile when fitted, initial median.

    The axis is logarithmic; fitted medians of 0 are drawn at its lower end.
    """
    errors = channels(fit)
    labels, positions = [c.label for c in errors], np.arange(len(errors), dtype=float)
    rows = np.array([(c.median_error, c.high_error, c.median_error_initial) for c in errors])
    median, high, before = 100 * rows.T
    smallest = min((e for e in (*median, *before) if e > 0), default=1.0)
    floor = float(10.0 ** np.floor(np.log10(max(smallest, 1e-13))))
    top = max(1.4 * float(max(high.max(), before.max())), 2.8 * floor)
    words = ("median relative error", "90 % quantile", "initial model")
    texts = tuple(
        f"{label}: " + ", ".join(f"{word} {percent(e, 3, signed=False)}" for word, e in zip(words, row, strict=True))
        for label, row in zip(labels, rows.tolist(), strict=True)
    )
    square = plot.Marker("square", 8.0, "white", plot.Pen(palette.INITIAL, 2.0))
    dot = plot.Marker("circle", 9.0, palette.FITTED, plot.Pen("white", 1.0))
    panel = plot.panel(
        plot.Axis(
            "channel (sensor/load)", limits=(-0.7, len(errors) - 0.3), ticks=plot.named_ticks(labels), grid=False
        ),
        plot.Axis("relative FRF error", "%", (floor, top), log=True, ticks=plot.decade_ticks(floor, top)),
        plot.segments(
            (positions, positions), (median, high), plot.Pen(palette.INK, 1.6), "fitted, up to the 90 % quantile"
        ),
        plot.Curve(positions, before, None, square, "initial, median", texts),
        plot.Curve(positions, np.maximum(median, floor), None, dot, "fitted, median", texts),
    )
    caption = (
        "Relative error of the FRFs by channel: medians over the lines, and the 90 % quantile of the fitted model."
    )
    return plot.Figure((panel,), (max(700.0, min(1400.0, 250.0 + 32 * len(errors))), 380.0), caption=caption)


def residual_map_figure(fit: RecordFit) -> plot.Figure:
    """Heat map of the whitened residual's magnitude over frequency and channel; empty cells at unused lines.

    Values below 0.1 have the colour of 0.1. Above 250 000 values only every k-th line is drawn.
    """
    labels = tuple(channel.label for channel in channels(fit))
    frequency, values = whitened(fit)
    stride = max(1, -(-values.size // MOST_VALUES))
    low, high = 0.1, max(10.0, float(np.nanquantile(values, 0.999)))  # farther where the fit is worse
    edges, n = line_edges(frequency[::stride]), len(labels)
    cells = plot.HeatMap(edges, np.arange(n + 1) - 0.5, np.clip(values[::stride].T, low, None), labels)
    used = fit.problem.record.frequency
    x = plot.Axis("frequency", "Hz", (float(used[0]), float(used[-1])) if len(used) > 1 else None, grid=False)
    y = plot.Axis("channel (sensor/load)", limits=(n - 0.5, -0.5), ticks=plot.named_ticks(labels), grid=False)
    label = "residual / its expected size (1)"
    scale = plot.ColourScale(palette.SEQUENTIAL, low, high, label, plot.decade_ticks(low, high), log=True)
    caption = (
        "Magnitude of the whitened residual. About 1 where the model fits to within the noise; larger where it"
        " does not; empty where no line was used."
    )
    return plot.Figure(
        (plot.panel(x, y, cells, scale=scale),), (1100.0, float(np.clip(150 + 20 * n, 320, 900))), caption=caption
    )


def whitened(fit: RecordFit) -> tuple[FloatArray, FloatArray]:
    """Frequencies (n_lines,) in Hz of all measured lines, and size of the whitened residual (n_lines, n_channels).

    The size is the root mean square of the residual's real and imaginary part, about 1 if the model fits to within the
    noise; NaN at lines that the fit does not use. Channels are in the order of outputs, and for each output of inputs.
    """
    frequency, used = fit.measured.frequency, fit.problem.record.frequency
    residual = fit.problem.residual(fit.theta)[: fit.problem.n_data].reshape(2, len(used), -1)
    size = np.full((len(frequency), residual.shape[2]), np.nan)
    size[np.searchsorted(frequency, used)] = np.sqrt((residual**2).mean(axis=0))
    return frequency, size


def line_edges(frequency: FloatArray) -> FloatArray:
    """Cell edges (n_lines + 1,) for a map over the lines `frequency` (Hz): midpoints, and one edge beyond each end.

    A single line gets a cell of 1 Hz.
    """
    if len(frequency) == 1:
        return np.array([frequency[0] - 0.5, frequency[0] + 0.5])
    middle = 0.5 * (frequency[1:] + frequency[:-1])
    return np.concatenate([[2 * frequency[0] - middle[0]], middle, [2 * frequency[-1] - middle[-1]]])

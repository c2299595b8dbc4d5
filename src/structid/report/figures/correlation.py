"""Test and model side by side: MAC, COMAC, FRAC and FDAC, of one model or of two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray
from structid.report.drawing import palette
from structid.report.rendering import plot

if TYPE_CHECKING:
    from structid.compare.correlation.modes import ModesCorrelation
    from structid.compare.correlation.responses import ResponsesCorrelation

#: What the models of a figure are called, one, or two with their colours.
ALONE, BEFORE_AND_AFTER = ("model",), ("initial", "identified")
_COLOURS = {"model": palette.FITTED, "initial": palette.INITIAL, "identified": palette.FITTED}
#: FDAC maps at most, of the first loads.
_MOST_MAPS = 2


def mac_figure(parts: Sequence[ModesCorrelation], words: Sequence[str]) -> plot.Figure:
    """Matrix figure of the MAC between measured and model modes, one panel for each model, with pairs framed.

    `parts` holds one correlation for each model, `words` the models' names, `ALONE` or `BEFORE_AND_AFTER`.
    """
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "MAC")
    panels, largest = [], 1
    for part, word in zip(parts, words, strict=True):
        shown = part.shown if len(part.shown) else np.arange(part.model.frequency.size)
        rows = [f"{i + 1}: {f:.4g} Hz" for i, f in enumerate(part.measured.frequency)]
        columns = [f"{k + 1}: {part.model.frequency[k]:.4g}" for k in shown]
        made = plot.matrix_panel(
            part.pairing.mac[:, shown], rows, "measured mode", scale, columns, f"mode of the {_model(word)}, Hz"
        )
        column = {int(k): j for j, k in enumerate(shown)}
        cells = [(column[k], i) for i in part.pairing.paired.tolist() for k in part.pairing.partners(i) if k in column]
        frames = _frames(np.array(cells, dtype=float).reshape(-1, 2))
        (strip,) = made.strips
        strips = (replace(strip, traces=(*strip.traces, *frames)),)
        is_large = max(len(rows), len(columns)) > plot.MOST_WRITTEN
        panels.append(replace(made, strips=strips, title=_title(word, len(parts)), equal=not is_large))
        largest = max(largest, len(rows), len(columns))
    size = float(np.clip(280 + 26 * largest, 400, 760))
    caption = (
        "Modal assurance criterion of measured and modelled shapes at the sensors: 1 where they agree up to a factor. Framed:"
        " the pairs, chosen by MAC and frequency together."
    )
    return plot.Figure(tuple(panels), (size + 60, size), len(panels) if size < 560 else 1, caption)


def _frames(cells: FloatArray) -> list[plot.Curve]:
    """Curve of square frames around the matrix cells `cells` (n, 2), given as column and row; [] if there are none."""
    if not len(cells):
        return []
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1), (np.nan, np.nan)]) * 0.47
    path = (cells[:, None] + corners).reshape(-1, 2)
    return [plot.Curve(path[:, 0], path[:, 1], plot.Pen(palette.VERMILLION, 2.2), label="pair")]


def comac_figure(parts: Sequence[ModesCorrelation], words: Sequence[str]) -> plot.Figure:
    """Bar charts of COMAC and ECOMAC of every sensor, over all mode pairs, with one bar for each model.

    `parts` holds one correlation for each model, `words` the models' names.
    """
    names = [str(dof) for dof in parts[-1].measured.channels]
    panels = (
        _bars(names, "sensor", plot.Axis("COMAC", "1", (0.0, 1.05)), [part.comac for part in parts], words),
        _bars(names, "sensor", plot.Axis("ECOMAC", "1"), [part.ecomac for part in parts], words),
    )
    caption = (
        "By sensor, over all pairs. COMAC: 1 where the sensor follows the model in every mode; a sensor that is only turned"
        " round keeps its COMAC. ECOMAC: mean distance of the scaled shapes, 0 where they agree. Check sense, gain and position"
        " of a sensor that stands out."
    )
    return plot.Figure(panels, (1050.0, 300.0), 1, caption)


def frac_figure(parts: Sequence[ResponsesCorrelation], words: Sequence[str]) -> plot.Figure:
    """Bar charts of the FRAC of every output, one panel for each load, with one bar for each model.

    `parts` holds one correlation for each model, `words` the models' names.
    """
    record = parts[-1].record
    names = [str(dof) for dof in record.outputs]
    panels = tuple(
        _bars(
            names,
            "output",
            plot.Axis("FRAC", "1", (0.0, 1.05)),
            [part.frac[:, i] for part in parts],
            words,
            f"load {load}" if len(record.inputs) > 1 else "",
        )
        for i, load in enumerate(record.inputs)
    )
    caption = (
        "Frequency response assurance criterion along the lines judged: 1 where measured and modelled function agree up to a"
        " factor; a resonance off by its own width already costs most of it."
    )
    return plot.Figure(panels, (1050.0, 300.0), 1, caption)


def fdac_figure(parts: Sequence[ResponsesCorrelation], words: Sequence[str]) -> plot.Figure | None:
    """Matrix figure of the FDAC for the first two loads and each model; None if it was not computed, as for a single output.

    `parts` holds one correlation for each model, `words` the models' names.
    """
    if any(part.fdac is None for part in parts):
        return None
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "FDAC")
    panels = []
    for i, load in enumerate(parts[-1].record.inputs[:_MOST_MAPS]):
        for part, word in zip(parts, words, strict=True):
            f = part.record.frequency[part.map_lines]
            edges = np.concatenate([[f[0]], 0.5 * (f[1:] + f[:-1]), [f[-1]]])
            values = np.round(part.fdac[i], 3) if part.fdac is not None else np.zeros((len(f), len(f)))
            cells = plot.HeatMap(edges, edges, values, tuple(f"measured {line:.5g} Hz" for line in f))
            ends = (float(f[0]), float(f[-1]))
            x = plot.Axis(f"frequency of the {_model(word)}", "Hz", ends, grid=False)
            y = plot.Axis("measured frequency", "Hz", ends, grid=False)
            diagonal = plot.segments(([ends[0]], [ends[1]]), ([ends[0]], [ends[1]]), plot.Pen("white", 1.2, "dash"))
            title = _title(word, len(parts)) + (f", load {load}" if len(part.record.inputs) > 1 else "")
            panels.append(replace(plot.panel(x, y, cells, diagonal, scale=scale), equal=True, title=title.lstrip(", ")))
    caption = (
        "Frequency domain assurance criterion: agreement of the operating shapes at every pair of lines. A ridge of ones below"
        " the dashed diagonal: the model has the same shapes at higher frequencies, it is too stiff or too light; above it,"
        " too soft or too heavy."
    )
    return plot.Figure(tuple(panels), (520.0, 460.0), 2, caption)


def _bars(
    names: Sequence[str],
    label: str,
    y: plot.Axis,
    values: Sequence[FloatArray],
    words: Sequence[str],
    title: str = "",
) -> plot.Panel:
    """Bar chart panel with a group of bars for each of `names`, one bar for each model.

    `values` holds one array (n_names,) for each model, `words` the models' names; `label` is that of the axis. NaN has
    no bar. `title` stands above the panel.
    """
    positions, count = np.arange(len(names), dtype=float), len(values)
    width = 0.8 / count
    traces: list[plot.Trace] = []
    for k, (heights, word) in enumerate(zip(values, words, strict=True)):
        known = np.isfinite(heights)
        left = positions[known] - 0.4 + k * width
        own = word if count > 1 else ""
        traces.append(plot.boxes((left, left + width), (0.0, heights[known]), _COLOURS[word], own))
        texts = tuple(
            f"{name}: {value:.3f}" for name, value in zip(names, heights.tolist(), strict=True) if value == value
        )
        traces.append(plot.Curve(left + width / 2, heights[known], None, plot.UNSEEN, hover=texts))
    highest = max((float(np.nanmax(heights)) for heights in values if np.isfinite(heights).any()), default=1.0)
    x = plot.Axis(label, limits=(-0.6, len(names) - 0.4), ticks=plot.named_ticks(names, 50), grid=False)
    limits = y.limits or (0.0, 1.1 * highest or 1.0)
    return plot.panel(x, replace(y, limits=limits), *traces, title=title)


def _model(word: str) -> str:
    return word if word == "model" else f"{word} model"


def _title(word: str, count: int) -> str:
    return f"{word} model" if count > 1 else ""

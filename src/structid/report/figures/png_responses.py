"""Measured and fitted FRFs as grids of small axes: magnitude, phase and coherence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from structid.report.drawing import palette
from structid.report.figures.data import (
    Responses,
    frequency_limits,
    magnitude,
    magnitude_limits,
    phase_degrees,
    worst_channels,
)
from structid.report.figures.png_style import plain
from structid.report.text import unit_text

#: Most channels that one grid shows.
MAX_CHANNELS = 16


def magnitude_figure(data: Responses) -> Figure:
    """Magnitudes on a logarithmic axis."""

    def draw(axes: Axes, channel: int) -> None:
        _curves(axes, data, channel, magnitude)
        axes.set_yscale("log")
        axes.set_ylim(*magnitude_limits(data, channel))
        unit = unit_text(data.channels[channel].unit)
        axes.set_title(f"{plain(data.channels[channel].label)}   {unit}", loc="left")

    return _grid(data, draw, f"magnitude of {data.kind}, unit as in each title", 2.1)


def phase_figure(data: Responses) -> Figure:
    """Phases from -180 to 180 degrees."""

    def draw(axes: Axes, channel: int) -> None:
        _curves(axes, data, channel, phase_degrees, dots=True)
        axes.set_ylim(-190, 190)
        axes.set_yticks([-180, -90, 0, 90, 180])
        axes.set_title(plain(data.channels[channel].label), loc="left")

    return _grid(data, draw, f"phase of {data.kind} (degrees)", 1.7)


def coherence_figure(data: Responses) -> Figure | None:
    """Coherences from 0 to 1; None where the record has none."""
    coherence = data.coherence
    if coherence is None:
        return None

    def draw(axes: Axes, channel: int) -> None:
        axes.plot(data.frequency, coherence[:, channel], color=palette.OUTSIDE, lw=0.8)
        axes.plot(data.frequency, np.where(data.used, coherence[:, channel], np.nan), color=palette.INK, lw=0.9)
        axes.set_ylim(0, 1.05)
        axes.set_title(plain(data.channels[channel].label), loc="left")

    return _grid(data, draw, "coherence (1)", 1.5, legend=False)


def _grid(
    data: Responses, draw: Callable[[Axes, int], None], label: str, row_height: float, legend: bool = True
) -> Figure:
    """One small axes for each channel, the worst-fitted ones where there are too many."""
    chosen = worst_channels(data, MAX_CHANNELS)
    n = len(chosen)
    n_columns = 1 if n == 1 else 2 if n <= 4 else 3 if n <= 9 else 4
    n_rows = -(-n // n_columns)
    height = (row_height * 1.6 if n_rows == 1 else row_height) * n_rows + 1.2
    figure = Figure(figsize=(11.5, height), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    for place, axes in enumerate(grid.flat):
        if place >= n:
            axes.set_visible(False)
            continue
        draw(axes, chosen[place])
        axes.set_xlim(*frequency_limits(data))
        axes.grid(color=palette.GRID, lw=0.6)
        if place + n_columns >= n:
            axes.tick_params(labelbottom=True)
    figure.supxlabel(f"frequency (Hz){_note(n, len(data.channels))}", fontsize=9.5)
    figure.supylabel(label, fontsize=9.5)
    if legend:
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure


def _note(shown: int, count: int) -> str:
    if shown == count:
        return ""
    return f"\n{shown} of {count} channels: those with the largest median relative error; all are in report.html"


def _curves(
    axes: Axes, data: Responses, channel: int, read: Callable[[np.ndarray], np.ndarray], dots: bool = False
) -> None:
    frequency = data.frequency
    measured = read(data.measured[:, channel])
    mark = "." if data.sparse else ""
    if not data.used.all():
        style: dict[str, Any] = {"ls": "", "marker": ".", "ms": 1.5} if dots else {"lw": 0.9}
        axes.plot(frequency, measured, color=palette.OUTSIDE, label="measured, not used", **style)
    inside = np.where(data.used, measured, np.nan)
    size = float(np.clip(3.0 * np.sqrt(300 / data.used.sum()), 1.5, 3.0))
    axes.plot(frequency, inside, ls="", marker=".", ms=size, color=palette.MEASURED, label="measured")
    models: tuple[tuple[np.ndarray, dict[str, Any]], ...] = (
        (data.initial, {"color": palette.INITIAL, "lw": 0.8, "ls": "--", "label": "initial model"}),
        (data.fitted, {"color": palette.FITTED, "lw": 1.2, "label": "fitted model"}),
    )
    for values, look in models:
        axes.plot(frequency, _unwound(read(values[:, channel]), dots), marker=mark, **look)


def _unwound(values: np.ndarray, is_phase: bool) -> np.ndarray:
    """`values` with a gap instead of a jump from -180 to 180 degrees."""
    if not is_phase:
        return values
    jump = np.concatenate([[False], np.abs(np.diff(values)) > 270])
    return np.where(jump, np.nan, values)

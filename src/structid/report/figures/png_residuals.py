"""Residuals by channel, and by channel and frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from structid.report.drawing import palette
from structid.report.figures.data import Responses, bar_floor, line_edges, residual_range
from structid.report.figures.png_style import plain, skipped


def residual_channels_figure(data: Responses) -> Figure:
    """Median relative error of every channel, with the 90 % quantile and the initial model."""
    n = len(data.channels)
    figure = Figure(figsize=(max(7.0, min(14.0, 2.5 + 0.32 * n)), 4.2), layout="constrained")
    axes = figure.subplots()
    place = np.arange(n)
    median = 100 * np.array([c.median_error for c in data.channels])
    high = 100 * np.array([c.high_error for c in data.channels])
    before = 100 * np.array([c.median_error_initial for c in data.channels])
    axes.bar(place, median, width=0.66, color=palette.SKY, label="fitted, median")
    axes.vlines(place, median, high, color=palette.INK, lw=1.2, label="fitted, up to the 90 % quantile")
    axes.plot(place, before, "s", mfc="white", mec=palette.INITIAL, ms=5, label="initial, median")
    axes.set_yscale("log")
    axes.set_ylim(bottom=bar_floor(data))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set_xticks(
        skipped(n, 45), [plain(data.channels[i].label) for i in skipped(n, 45)], rotation=90 if n > 8 else 0
    )
    axes.set_xlim(-0.7, n - 0.3)
    axes.set_xlabel("channel (sensor/load)")
    axes.set_ylabel("relative FRF error (%)")
    axes.grid(axis="y", color=palette.GRID)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def residual_map_figure(data: Responses) -> Figure:
    """Size of the whitened residual over frequency and channel."""
    n = len(data.channels)
    figure = Figure(figsize=(11.0, max(3.2, min(9.0, 1.6 + 0.22 * n))), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("white")
    low, high = residual_range(data)
    mesh = axes.pcolormesh(
        line_edges(data.frequency), np.arange(n + 1) - 0.5, np.clip(data.whitened.T, low, None),
        cmap=palette.SEQUENTIAL, norm=LogNorm(low, high), rasterized=True,
    )  # fmt: skip
    ticks = skipped(n, 40)
    axes.set_yticks(ticks, [plain(data.channels[i].label) for i in ticks])
    axes.invert_yaxis()
    if data.band[1] > data.band[0]:
        axes.set_xlim(*data.band)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("channel (sensor/load)")
    bar = figure.colorbar(mesh, ax=axes, aspect=25)
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    bar.set_label("residual / its expected size (1)")
    return figure

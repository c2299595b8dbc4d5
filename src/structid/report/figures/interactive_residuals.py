"""Residuals on the page: by channel, and by channel and frequency."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.report.drawing import palette
from structid.report.figures.data import Responses, bar_floor, residual_range
from structid.report.figures.interactive_base import Figure, axis, base_layout, clean, numbers

_MOST_VALUES = 200_000


def residual_channels_figure(data: Responses) -> Figure:
    """Median relative error of every channel, with the 90 % quantile and the initial model."""
    n = len(data.channels)
    place = list(range(n))
    median = 100 * np.array([c.median_error for c in data.channels])
    high = 100 * np.array([c.high_error for c in data.channels])
    before = 100 * np.array([c.median_error_initial for c in data.channels])
    square = {"symbol": "square-open", "size": 8, "color": palette.INITIAL, "line": {"width": 2}}
    upwards = {"array": numbers(high - median), "arrayminus": [0] * n, "symmetric": False}
    error = {"type": "data", "width": 3, "color": palette.INK} | upwards
    traces: list[dict[str, Any]] = [
        {
            "type": "bar", "x": place, "y": numbers(median), "name": "fitted, median to 90 % quantile",
            "error_y": error, "marker": {"color": palette.SKY}, "width": 0.66,
        },
        {
            "type": "scatter", "mode": "markers", "x": place, "y": numbers(before), "name": "initial, median",
            "marker": square,
        },
    ]  # fmt: skip
    layout = base_layout(380)
    labels = [clean(c.label) for c in data.channels]
    layout["xaxis"] = axis("channel (sensor/load)") | {
        "tickvals": place, "ticktext": labels, "automargin": True, "tickangle": -90 if n > 12 else 0,
        "tickfont": {"size": 12 if n <= 30 else 10}, "range": [-0.7, n - 0.3],
    }  # fmt: skip
    span = {"type": "log", "dtick": 1, "range": _log_range(data, high, before)}
    layout["yaxis"] = axis("relative FRF error (%)") | span
    caption = (
        "Relative error of the FRFs by channel: medians over the lines, and the 90 % quantile of the fitted model."
    )
    return Figure(traces, layout, caption)


def _log_range(data: Responses, *values: np.ndarray) -> list[float]:
    top = max(float(v.max(initial=0.0)) for v in values)
    floor = bar_floor(data)
    return [float(np.log10(floor)), float(np.log10(max(top, 2 * floor) * 1.4))]


def residual_map_figure(data: Responses) -> Figure:
    """Size of the whitened residual over frequency and channel."""
    n = len(data.channels)
    stride = max(1, -(-data.whitened.size // _MOST_VALUES))
    low, high = np.log10(residual_range(data))
    z = np.log10(np.clip(data.whitened[::stride], 10**low, None)).T
    ticks = [e for e in range(int(np.floor(low)), int(np.ceil(high)) + 1) if low <= e <= high]
    bar = {
        "title": {"text": "residual / expected size", "side": "right", "font": {"size": 12}},
        "tickvals": ticks, "ticktext": [f"{10.0**e:g}" for e in ticks],
    }  # fmt: skip
    trace = {
        "type": "heatmap", "x": numbers(data.frequency[::stride], 6), "y": list(range(n)),
        "z": [numbers(row, 3) for row in z], "zmin": float(low), "zmax": float(high),
        "colorscale": palette.plotly_scale(palette.SEQUENTIAL), "colorbar": bar,
        "hovertemplate": "%{x} Hz, channel %{y}: 10^%{z:.2f}<extra></extra>", "hoverongaps": False,
    }  # fmt: skip
    layout = base_layout(int(max(320, min(900, 150 + 20 * n))), left=None)
    layout["xaxis"] = (
        axis("frequency (Hz)")
        | {"showgrid": False}
        | ({"range": list(data.band)} if data.band[1] > data.band[0] else {})
    )
    layout["yaxis"] = axis("channel (sensor/load)") | {
        "tickvals": list(range(n)), "ticktext": [clean(c.label) for c in data.channels], "automargin": True,
        "autorange": "reversed", "showgrid": False, "tickfont": {"size": 12 if n <= 24 else 9},
    }  # fmt: skip
    caption = (
        "Magnitude of the whitened residual. About 1 where the model fits to within the stated errors; bright where it"
        " does not; white where no line was used."
    )
    return Figure([trace], layout, caption)

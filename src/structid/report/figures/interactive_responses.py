"""Measured and fitted FRFs on the page: one channel at a time, chosen from a list."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.report.drawing import palette
from structid.report.figures.data import Responses, frequency_limits, magnitude, magnitude_limits, phase_degrees
from structid.report.figures.interactive_base import Figure, axis, base_layout, clean, numbers
from structid.report.text import percent, unit_text

#: Beyond this many values the lines are thinned on the page, to keep the file small.
MOST_VALUES = 250_000


def responses_figure(data: Responses) -> Figure:
    """Magnitude, phase and coherence of the first channel, and the curves of all others to choose from."""
    stride = max(1, -(-data.measured.size // MOST_VALUES))
    keep = slice(None, None, stride)
    frequency = numbers(data.frequency[keep], 6)
    traces = [trace | {"x": frequency} for trace in _traces(data)]
    channels = [_channel(data, c, keep) for c in range(len(data.channels))]
    for trace, y in zip(traces, channels[0]["y"], strict=True):
        trace["y"] = y
    layout = base_layout(720 if data.coherence is not None else 620) | _axes(data)
    layout["margin"] = {"l": 80, "r": 20, "t": 78, "b": 55}
    layout["title"] = {
        "text": channels[0]["heading"],
        "font": {"size": 14},
        "x": 0,
        "xref": "paper",
        "y": 0.985,
        "yanchor": "top",
    }
    layout["yaxis"]["title"]["text"] = channels[0]["title"]
    layout["yaxis"]["range"] = channels[0]["range"]
    caption = "Lines outside the band, or left out, are grey."
    if stride > 1:
        caption += f" Every {stride}th line of the record is shown here."
    return Figure(traces, layout, caption, {"channels": channels})


def _axes(data: Responses) -> dict[str, Any]:
    """Three axes on one frequency axis, or two where there is no coherence."""
    has_coherence = data.coherence is not None
    cuts = ([0.47, 1.0], [0.2, 0.43], [0.0, 0.16]) if has_coherence else ([0.42, 1.0], [0.0, 0.37], None)
    anchor = {"anchor": "y3" if has_coherence else "y2", "range": list(frequency_limits(data))}
    powers = {"type": "log", "exponentformat": "power", "dtick": 1, "tickfont": {"size": 11}}
    turns = {"range": [-190, 190], "tickvals": [-180, -90, 0, 90, 180]}
    layout = {
        "xaxis": axis("frequency (Hz)") | anchor,
        "yaxis": axis("") | powers | {"domain": cuts[0]},
        "yaxis2": axis("phase (degrees)") | turns | {"domain": cuts[1]},
    }
    if has_coherence:
        layout["yaxis3"] = axis("coherence") | {"domain": cuts[2], "range": [0, 1.05]}
    return layout


def _traces(data: Responses) -> list[dict[str, Any]]:
    """Style of every curve; `_channel` gives the values in the same order."""
    joined = "lines+markers" if data.sparse else "lines"
    styles: list[dict[str, Any]] = [
        {"name": "measured, not used", "mode": "lines", "line": {"color": palette.OUTSIDE, "width": 1}},
        {"name": "measured", "mode": "markers", "marker": {"color": palette.MEASURED, "size": 3.5}},
        {"name": "initial model", "mode": joined, "line": {"color": palette.INITIAL, "width": 1, "dash": "dash"}},
        {"name": "fitted model", "mode": joined, "line": {"color": palette.FITTED, "width": 1.8}},
    ]
    found = [style | {"type": "scatter", "yaxis": "y"} for style in styles]
    outside = {"mode": "markers", "marker": {"color": palette.OUTSIDE, "size": 2}}
    for style in (styles[0] | outside, *styles[1:]):
        found.append(style | {"type": "scatter", "yaxis": "y2", "showlegend": False})
    if data.coherence is not None:
        line = {"color": palette.MEASURED, "width": 1}
        found.append(
            {"type": "scatter", "mode": "lines", "name": "coherence", "line": line, "yaxis": "y3", "showlegend": False}
        )
    return found


def _channel(data: Responses, c: int, keep: slice) -> dict[str, Any]:
    """Curves, axis title and heading of one channel."""
    channel = data.channels[c]
    measured = data.measured[keep, c]
    used = data.used[keep]
    curves = [
        (np.where(used, np.nan, measured), measured),
        (np.where(used, measured, np.nan),) * 2,
        (data.initial[keep, c],) * 2,
        (data.fitted[keep, c],) * 2,
    ]
    y = [numbers(magnitude(m)) for m, _ in curves]
    y += [numbers(_phase(p, i), 4) for i, (_, p) in enumerate(curves)]
    if data.coherence is not None:
        y.append(numbers(data.coherence[keep, c], 4))
    error = percent(channel.median_error, 3, signed=False)
    before = percent(channel.median_error_initial, 3, signed=False)
    heading = f"{clean(channel.label)}: median relative error {error}, initial model {before}"
    span = numbers(np.log10(magnitude_limits(data, c)))
    return {"y": y, "range": span, "title": f"{data.kind} ({unit_text(channel.unit)})", "heading": heading}


def _phase(values: np.ndarray, which: int) -> np.ndarray:
    """Phase in degrees; curves of the model get a gap where they would jump by a turn."""
    degrees = phase_degrees(values)
    if which < 2:
        return degrees
    jump = np.concatenate([[False], np.abs(np.diff(degrees)) > 270])
    return np.where(jump, np.nan, degrees)

"""Measured modes beside those of the model: one figure, on the page and as PNG."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure as PngFigure
from matplotlib.ticker import MaxNLocator

from structid.report.drawing import palette
from structid.report.figures.interactive_base import Figure, axis, base_layout, numbers
from structid.report.figures.modal_data import ModalRows

_CAPTION = (
    "Left: frequencies of the model over those measured. Grey bars: 95 % interval of the measured frequency."
    " Right: MAC between measured and modelled shapes at the sensors."
)


def modal_fit_page_figure(rows: ModalRows) -> Figure:
    """Differences in frequency, and MAC, before and after."""
    data: list[dict[str, Any]] = [
        {
            "type": "bar", "x": numbers(rows.number), "y": numbers(200 * rows.half), "base": numbers(-100 * rows.half),
            "width": 0.5, "marker": {"color": palette.FAINT}, "name": "95 % interval of the measurement",
            "hoverinfo": "skip",
        }
    ]  # fmt: skip
    pairs = (("", 100 * rows.initial, 100 * rows.fitted), ("2", rows.initial_mac, rows.fitted_mac))
    for which, before, after in pairs:
        places: dict[str, Any] = {
            "type": "scatter", "mode": "markers", "x": numbers(rows.number), "xaxis": f"x{which}", "yaxis": f"y{which}",
        }  # fmt: skip
        square = {"symbol": "square-open", "size": 10, "color": palette.INITIAL, "line": {"width": 2}}
        dot = {"size": 9, "color": palette.FITTED}
        data.append(places | {"y": numbers(before), "name": "initial", "marker": square, "showlegend": not which})
        data.append(places | {"y": numbers(after), "name": "identified", "marker": dot, "showlegend": not which})
    layout = base_layout(360)
    whole = {"dtick": 1 if len(rows.number) < 16 else 5}
    layout["xaxis"] = axis("measured mode") | {"domain": [0, 0.46]} | whole
    layout["xaxis2"] = axis("measured mode") | {"domain": [0.56, 1], "anchor": "y2"} | whole
    layout["yaxis"] = axis("model / measured frequency less 1 (%)") | {"zeroline": True, "zerolinecolor": palette.MUTED}
    layout["yaxis2"] = axis("MAC (1)") | {"anchor": "x2", "range": [0.0, 1.05]}
    return Figure(data, layout, _CAPTION)


def modal_fit_png(rows: ModalRows) -> PngFigure:
    """The same as a PNG figure."""
    figure = PngFigure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.bar(
        rows.number, 200 * rows.half, bottom=-100 * rows.half, width=0.5, color=palette.FAINT,
        label="95 % interval of the measurement", zorder=1,
    )  # fmt: skip
    left.axhline(0.0, color=palette.MUTED, lw=0.8, zorder=2)
    pairs = ((left, 100 * rows.initial, 100 * rows.fitted), (right, rows.initial_mac, rows.fitted_mac))
    for axes, before, after in pairs:
        axes.plot(rows.number, before, "s", mfc="none", mec=palette.INITIAL, mew=1.5, ms=8, label="initial", zorder=3)
        axes.plot(rows.number, after, "o", color=palette.FITTED, ms=6, label="identified", zorder=4)
        axes.set_xlabel("measured mode")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlim(rows.number.min() - 0.6, rows.number.max() + 0.6)
        axes.grid(axis="y", color=palette.GRID)
    left.set_ylabel("model / measured frequency less 1 (%)")
    right.set_ylabel("MAC with the measured shape (1)")
    right.set_ylim(0.0, 1.05)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure

"""The reproduced figures as PNG: one set of axes a panel, curves with their bands."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from structid.arrays import FloatArray
from structid.report.drawing import palette
from structid.report.figures.png_style import DPI, STYLE, plain
from structid.report.text import unit_text
from structid.reproduce.item import Curve, Item, Panel

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)))
#: Curves with more points than this have no markers.
_MOST_MARKED = 40
_LEGEND_LINE = 0.19


def panels_png(item: Item) -> bytes:
    """The panels of `item` as the bytes of a PNG file; the same panels give the same bytes."""
    stream = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        panels_figure(item.panels).savefig(stream, dpi=DPI, format="png", metadata={"Software": None})
    return stream.getvalue()


def panels_figure(panels: tuple[Panel, ...]) -> Figure:
    """A grid of up to two axes side by side, each with its legend below, or one legend for all where they share it."""
    n_columns = min(2, len(panels))
    n_rows = -(-len(panels) // n_columns)
    longest = max(len(panel.curves) for panel in panels)
    shared = len({tuple(_label(curve) for curve in panel.curves) for panel in panels}) == 1 < len(panels)
    width = 10.5 if n_columns == 2 else 7.5
    legends = _LEGEND_LINE * longest * (1 if shared else n_rows)
    figure = Figure(figsize=(width, n_rows * 3.3 + legends), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        _draw(axes, panel)
        if not shared and _needs_legend(panel):
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), borderaxespad=0.0)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    if shared and _needs_legend(panels[0]):
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center")
    return figure


def _needs_legend(panel: Panel) -> bool:
    return len(panel.curves) > 1 or panel.curves[0].low is not None


def _draw(axes: Axes, panel: Panel) -> None:
    logarithmic = panel.log_y and any((_finite(curve.y) > 0).any() for curve in panel.curves)
    drawn = [
        np.abs(_finite(values)) for curve in panel.curves for values in (curve.y, curve.high) if values is not None
    ]
    highest = max((float(np.nanmax(values)) for values in drawn if np.isfinite(values).any()), default=1.0)
    for index, curve in enumerate(panel.curves):
        _draw_curve(axes, curve, index, logarithmic, highest)
    axes.set_title(plain(panel.title), loc="left", fontweight="bold")
    axes.set_xlabel(plain(unit_text(panel.x_label)))
    axes.set_ylabel(plain(unit_text(panel.y_label)))
    if logarithmic:
        axes.set_yscale("log")
    if panel.x_label.startswith("x (") and panel.y_label.startswith("y ("):
        axes.set_aspect("equal")
    _scale_x(axes, panel)
    axes.grid(color=palette.GRID)


def _scale_x(axes: Axes, panel: Panel) -> None:
    """Whole numbers where all are whole; a logarithmic axis where few points are spread over powers of ten."""
    points = np.unique(np.concatenate([np.asarray(curve.x, dtype=np.float64) for curve in panel.curves]))
    if 3 <= len(points) <= 12 and points[0] > 0 and points[-1] > 100 * points[0]:
        axes.set_xscale("log")
        axes.set_xticks(points, [f"{x:g}" for x in points])
        axes.xaxis.set_minor_locator(NullLocator())
    elif np.array_equal(points, np.round(points)):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_curve(axes: Axes, curve: Curve, index: int, logarithmic: bool, highest: float) -> None:
    """One curve over its band; where the band has no finite upper end it reaches to the `highest` value.

    Later curves are thinner, so that those below still show where they coincide.
    """
    colour = palette.CYCLE[index % len(palette.CYCLE)]
    dash = _DASHES[index // len(palette.CYCLE) % len(_DASHES)]
    marker = _MARKERS[index % len(_MARKERS)] if len(curve.x) <= _MOST_MARKED else ""
    if curve.low is not None and curve.high is not None:
        low = _drawable(curve.low, logarithmic)
        high = _drawable(np.where(np.isposinf(curve.high), highest, curve.high), logarithmic)
        axes.fill_between(curve.x, low, high, color=colour, alpha=0.18, lw=0, zorder=1)
    size: dict[str, Any] = {"lw": max(1.2, 3.2 - index), "ms": max(3.5, 7.0 - 1.5 * index)}
    y = _drawable(curve.y, logarithmic)
    axes.plot(curve.x, y, color=colour, ls=dash, marker=marker, label=plain(_label(curve)), zorder=3, **size)


def _label(curve: Curve) -> str:
    if curve.low is None or curve.high is None:
        return curve.label
    middle = "" if "median" in curve.label else "median, "
    return f"{curve.label} ({middle}5\N{EN DASH}95 % band)"


def _drawable(values: FloatArray, logarithmic: bool) -> FloatArray:
    """`values` with a gap where they cannot be drawn."""
    finite = _finite(values)
    return np.where(finite > 0, finite, np.nan) if logarithmic else finite


def _finite(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(values), values, np.nan)

"""The reproduced figures of the dissertation: a panel each, curves with their bands."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.report.drawing import palette, symbols
from structid.report.rendering import plot
from structid.reproduce.item import Curve, Panel

_SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x", "star")
_DASHES: tuple[Literal["solid", "dash", "dot"], ...] = ("solid", "dash", "dot")
#: Curves with more points than this have no markers.
_MOST_MARKED = 40


def panels_figure(panels: tuple[Panel, ...]) -> plot.Figure:
    """Figure of reproduced panels, at most two in a row; curves of one label have the same colour in all panels."""
    columns = min(2, len(panels))
    labels = list(dict.fromkeys(_label(curve) for panel in panels for curve in panel.curves))
    shown = tuple(_panel(panel, labels) for panel in panels)
    return plot.Figure(shown, (525.0 if columns == 2 else 750.0, 340.0), columns)


def _panel(panel: Panel, labels: list[str]) -> plot.Panel:
    """Plot panel of the curves of `panel`, with bands and axes; `labels` sets the order of colours."""
    log = panel.log_y and any((_finite(curve.y) > 0).any() for curve in panel.curves)
    ends = [values for curve in panel.curves for values in (curve.y, curve.low, curve.high) if values is not None]
    drawn = np.abs(np.concatenate([_drawable(values, log) for values in ends]))
    highest = float(np.nanmax(drawn, initial=0.0)) or 1.0
    bands = [_band(c, labels.index(_label(c)), log, highest) for c in panel.curves if c.low is not None]
    curves = [_curve(c, labels.index(_label(c)), below, log) for below, c in enumerate(panel.curves)]
    y = plot.Axis(panel.y_label, limits=plot.decade_limits(drawn) if log else None, log=log)
    is_plan = panel.x_label.startswith("x (") and panel.y_label.startswith("y (")
    return replace(plot.panel(_x_axis(panel), y, *bands, *curves, title=panel.title), equal=is_plan)


def _x_axis(panel: Panel) -> plot.Axis:
    """Horizontal axis of a panel: logarithmic for 3 to 12 points over more than two decades, integer ticks for integers."""
    points = np.unique(np.concatenate([np.asarray(curve.x, dtype=np.float64) for curve in panel.curves]))
    first, last = float(points[0]), float(points[-1])
    if 3 <= len(points) <= 12 and first > 0 and last > 100 * first:
        return plot.Axis(panel.x_label, log=True, ticks=tuple((x, f"{x:g}") for x in points.tolist()))
    is_whole = np.array_equal(points, np.round(points)) and last > first
    return plot.Axis(panel.x_label, ticks=plot.whole_ticks(int(first), int(last), 10) if is_whole else ())


def _curve(curve: Curve, index: int, below: int, log: bool) -> plot.Curve:
    """Plot curve with colour, dash and symbol number `index`, drawn thinner the more curves lie `below` it.

    `log` is True for a logarithmic axis, where values of 0 and less are gaps.
    """
    colour = palette.CYCLE[index % len(palette.CYCLE)]
    pen = plot.Pen(colour, max(1.7, 4.4 - 1.4 * below), _DASHES[index // len(palette.CYCLE) % len(_DASHES)])
    sign = plot.Marker(_SYMBOLS[index % len(_SYMBOLS)], max(4.9, 9.7 - 2.1 * below), colour)
    marker = sign if len(curve.x) <= _MOST_MARKED else None
    return plot.Curve(
        np.asarray(curve.x, dtype=float), _drawable(curve.y, log), pen, marker, _label(curve), plot.NUMBERS
    )


def _band(curve: Curve, index: int, log: bool, highest: float) -> plot.Area:
    """Filled area between the low and the high end of a curve, in the colour number `index`; a missing end is the curve.

    `log` is True for a logarithmic axis. Infinite ends are drawn at the value `highest`.
    """
    ends = (curve.y if end is None else end for end in (curve.low, curve.high))
    low, high = (_drawable(np.where(np.isposinf(end), highest, end), log) for end in ends)
    x, gaps = np.asarray(curve.x, dtype=float), np.isnan(low + high)
    outlines = []
    for stretch in np.split(np.arange(len(x)), np.flatnonzero(gaps)):
        run = stretch[~gaps[stretch]]
        there_and_back = np.concatenate([run, run[::-1], run[:1]])
        outlines.append(np.column_stack([x[there_and_back], np.concatenate([low[run], high[run[::-1]], low[run[:1]]])]))
    shown = symbols.joined(outline for outline in outlines if len(outline))
    return plot.Area(shown[:, 0], shown[:, 1], palette.CYCLE[index % len(palette.CYCLE)], 0.18)


def _label(curve: Curve) -> str:
    """Legend text of a curve, with the words "5-95 % band" if it has a band."""
    if curve.low is None or curve.high is None:
        return curve.label
    middle = "" if "median" in curve.label else "median, "
    return f"{curve.label} ({middle}5\N{EN DASH}95 % band)"


def _drawable(values: FloatArray, log: bool) -> FloatArray:
    """Copy of `values` with NaN for values that cannot be drawn: not finite, or not positive if `log`."""
    finite = _finite(values)
    return np.where(finite > 0, finite, np.nan) if log else finite


def _finite(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(values), values, np.nan)

"""A comparison of two states: every change with its interval, and where on the structure the declared ones are."""

from __future__ import annotations

import numpy as np

from structid.compare.states.comparing import ComparisonResult
from structid.compare.states.state import DrawableStructure
from structid.core.quantities import percent
from structid.inversion.comparison.comparison import Comparison
from structid.report.drawing import palette
from structid.report.drawing.changes import (
    KINDS,
    Change,
    Changes,
    Shading,
    elements_of,
    properties_of,
    round_limit,
    shading,
)
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.parameters import NORMAL_95
from structid.report.figures.structure import structure_figure
from structid.report.rendering import plot


def comparison_figures(result: ComparisonResult) -> dict[str, plot.Figure]:
    """Figures of a comparison by name: "changes", and "map" if one of the two states has a structure to draw."""
    figures = {"changes": changes_figure(result.comparison)}
    drawn = result.later.drawn or result.baseline.drawn
    if drawn is not None:
        figures["map"] = map_figure(result.comparison, drawn)
    return figures


def changes_figure(comparison: Comparison) -> plot.Figure:
    """Figure of the relative change (%) of every parameter with its 95 % interval, over its detection limit."""
    heights, limit = np.arange(len(comparison.names), dtype=float), 100 * _axis_limit(comparison)
    ratio, std = 100 * comparison.relative_change, 100 * comparison.relative_std
    seen, half = np.isfinite(std), 100 * comparison.relative_detection_limit
    at, middle, tail = heights[seen], ratio[seen], NORMAL_95 * std[seen]
    below = f"below the detection limit ({percent(comparison.power, 2, signed=False)} power)"
    traces: list[plot.Trace] = [
        plot.boxes((-half[seen], half[seen]), (at - 0.36, at + 0.36), palette.GRID, below),
        plot.segments((0.0, 0.0), (-0.6, len(heights) - 0.4), plot.Pen(palette.MUTED)),
        plot.segments((middle - tail, middle + tail), (at, at), plot.Pen(palette.INK, 1.8), "95 % interval"),
    ]
    rows = zip(comparison.names, comparison.relative_change, comparison.relative_std, strict=True)
    texts = [f"{name}: {percent(change)}, std {percent(spread, 2, signed=False)}" for name, change, spread in rows]
    edge = plot.Pen(palette.INK, 1.2)
    for which, marker, label in (
        (seen & ~comparison.changed, plot.Marker("circle", 8.0, "white", edge), "no change declared"),
        (seen & comparison.changed, plot.Marker("diamond", 9.0, palette.FITTED, edge), "change declared"),
        (~seen, plot.Marker("x-thin", 8.0, "", plot.Pen(palette.MUTED)), "not determined"),
    ):
        words = tuple(text for text, chosen in zip(texts, which, strict=True) if chosen)
        traces.append(plot.Curve(np.where(seen, ratio, 0.0)[which], heights[which], None, marker, label, words))
    x = plot.Axis("change as a part of the baseline", "%", (-limit, limit))
    return plot.Figure((plot.panel(x, plot.rows_axis(comparison.names), *traces),), plot.rows_size(len(heights)))


def _axis_limit(comparison: Comparison) -> float:
    """Largest relative change on the axis (a fraction): holds all changes and most intervals; 1 if no change is known."""
    reach = np.abs(comparison.relative_change) + NORMAL_95 * comparison.relative_std
    reach = reach[np.isfinite(reach)]
    if not reach.size:
        return 1.0
    return float(
        min(1.15 * reach.max(), max(1.5 * np.nanmax(np.abs(comparison.relative_change)), 4 * np.median(reach)))
    )


def map_figure(comparison: Comparison, drawn: DrawableStructure) -> plot.Figure:
    """Figure of the structure with each element coloured by its declared change, white without; one panel for each kind.

    Kinds of property without compared parameters are left out.
    """
    shown = (_shading(comparison, drawn, name, kinds) for name, kinds in KINDS.items())
    picture = structure_picture(drawn.structure, drawn.outputs, drawn.inputs)
    return structure_figure(picture, tuple(shade for shade in shown if shade is not None))


def _shading(comparison: Comparison, drawn: DrawableStructure, name: str, kinds: tuple[str, ...]) -> Shading | None:
    """Shading of elements by the declared changes of one kind of property; None if none of its parameters was compared.

    `name` is the kind's name in the title, `kinds` are the kinds of property that belong to it. Changes not declared count as
    0.
    """
    index_of = {label: i for i, label in enumerate(comparison.names)}
    changes: Changes = {}
    for item in properties_of(drawn.structure, kinds):
        for key, _, columns in elements_of(item, drawn.parameters.design.tocsr()):
            names = [drawn.parameters.names[c] for c in columns]
            for i in (index_of[label] for label in names if label in index_of):
                ratio = float(comparison.relative_change[i]) if comparison.changed[i] else 0.0
                change = Change(
                    ratio, bool(np.isfinite(comparison.p_values[i])), f"{comparison.names[i]}: {percent(ratio)}"
                )
                if key not in changes or abs(ratio) > abs(changes[key].ratio):
                    changes[key] = change
    if not changes:
        return None
    title = f"Declared change of {name} parameters (white: none declared)"
    return shading(title, changes, round_limit(change.ratio for change in changes.values()))

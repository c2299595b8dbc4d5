"""The figures of a comparison: every change with its interval, and where on the structure the declared ones are."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from structid.comparison.comparing import ComparisonResult
from structid.comparison.state import Drawn
from structid.estimation.comparison.comparison import Comparison
from structid.report.drawing import palette
from structid.report.drawing.changes import PANELS, Change, Changes, Panel
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.data import NORMAL_95
from structid.report.figures.png_structure import structure_figure
from structid.report.figures.png_style import DPI, STYLE, plain
from structid.report.text import percent

_ROWS_A_COLUMN = 32
_LIMITS = (0.05, 0.1, 0.2, 0.3, 0.5)


def comparison_pictures(result: ComparisonResult) -> dict[str, bytes]:
    """PNG files by name: ``changes``, and ``map`` where the structure is known."""
    figures = {}
    with matplotlib.rc_context(STYLE):
        figures["changes"] = _png(changes_figure(result.comparison))
        drawn = result.later.drawn or result.baseline.drawn
        if drawn is not None:
            figures["map"] = _png(map_figure(result.comparison, drawn))
    return figures


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, format="png", metadata={"Software": None})
    return buffer.getvalue()


def changes_figure(found: Comparison) -> Figure:
    """Relative change of every parameter with its 95 % interval, over its detection limit."""
    n = len(found.names)
    n_columns = 1 if n <= _ROWS_A_COLUMN else 2
    per_column = -(-n // n_columns)
    figure = Figure(figsize=(9.5 if n_columns == 1 else 15, 1.7 + 0.27 * per_column), layout="constrained")
    limit = _axis_limit(found)
    for column, axes in enumerate(figure.subplots(1, n_columns, squeeze=False)[0]):
        part = np.arange(column * per_column, min((column + 1) * per_column, n))
        _rows(axes, found, part, limit)
        axes.set_ylim(per_column - 0.4, -0.6)
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=3)
    return figure


def _axis_limit(found: Comparison) -> float:
    """Largest relative change shown: what the changes and most intervals need."""
    reach = np.abs(found.relative_change) + NORMAL_95 * found.relative_std
    reach = reach[np.isfinite(reach)]
    if not reach.size:
        return 1.0
    return float(min(1.15 * reach.max(), max(1.5 * np.nanmax(np.abs(found.relative_change)), 4 * np.median(reach))))


def _rows(axes: Axes, found: Comparison, part: np.ndarray, limit: float) -> None:
    place = np.arange(len(part))
    ratio, std = 100 * found.relative_change[part], 100 * found.relative_std[part]
    seen, declared = np.isfinite(std), found.changed[part]
    axes.axvline(0.0, color=palette.MUTED, lw=1.0, zorder=1)
    half = 100 * found.relative_detection_limit[part][seen]
    label = f"below the detection limit ({percent(found.power, 2, signed=False)} power)"
    axes.barh(place[seen], 2 * half, left=-half, height=0.72, color=palette.GRID, zorder=0, label=label)
    tail = NORMAL_95 * std[seen]
    axes.hlines(
        place[seen], ratio[seen] - tail, ratio[seen] + tail, color=palette.INK, lw=1.3, label="95 % interval", zorder=3
    )
    for which, colour, marker, text in (
        (seen & ~declared, "white", "o", "no change declared"),
        (seen & declared, palette.FITTED, "D", "change declared"),
    ):
        if which.any():
            axes.plot(ratio[which], place[which], ls="", marker=marker, ms=6, mfc=colour, mec=palette.INK, mew=0.9,
                      label=text, zorder=5)  # fmt: skip
    if not seen.all():
        axes.plot(np.zeros((~seen).sum()), place[~seen], ls="", marker="x", color=palette.MUTED, ms=6,
                  label="not determined", zorder=4)  # fmt: skip
    axes.set_xlim(-100 * limit, 100 * limit)
    axes.set_yticks(place, [plain(found.names[i]) for i in part])
    axes.set_xlabel("change as a part of the baseline (%)")
    axes.grid(axis="y", color=palette.GRID)


def map_figure(found: Comparison, drawn: Drawn) -> Figure:
    """The structure, each element in the colour of the change that is declared for it; without one it is white."""
    shown = tuple(panel for name, kinds in PANELS.items() if (panel := _panel(found, drawn, name, kinds)) is not None)
    figure = structure_figure(structure_picture(drawn.structure, drawn.outputs, drawn.inputs, shown))
    for axes in figure.axes:
        if axes.get_title(loc="left"):
            axes.set_title(f"declared {axes.get_title(loc='left')} (white: none declared)", loc="left")
    return figure


def _panel(found: Comparison, drawn: Drawn, name: str, kinds: tuple[str, ...]) -> Panel | None:
    """Declared changes of one kind of property by element; None where nothing of it was compared."""
    place = {label: i for i, label in enumerate(found.names)}
    design = drawn.parameters.design.tocsr()
    changes: Changes = {}
    for item in drawn.structure.properties:
        if item.term.kind not in kinds:
            continue
        for row, value in enumerate(range(item.values.start, item.values.stop)):
            columns = design.indices[design.indptr[value] : design.indptr[value + 1]]
            names = [drawn.parameters.names[c] for c in columns]
            for i in (place[label] for label in names if label in place):
                ratio = float(found.relative_change[i]) if found.changed[i] else 0.0
                change = Change(ratio, bool(np.isfinite(found.p_values[i])), f"{found.names[i]}: {percent(ratio)}")
                key = (item.element, row)
                if key not in changes or abs(ratio) > abs(changes[key].ratio):
                    changes[key] = change
    if not changes:
        return None
    largest = max(abs(change.ratio) for change in changes.values())
    return Panel(name, changes, next((step for step in _LIMITS if largest <= step), 1.0))

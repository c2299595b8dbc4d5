"""The structure, coloured by what changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke

from structid.report.drawing import palette
from structid.report.drawing.changes import Panel, look
from structid.report.drawing.drawing import PANEL_INCHES, WIDE_INCHES
from structid.report.drawing.picture import Arrow, Mark, Picture
from structid.report.figures.png_style import plain

_DASHES = (0, (2.2, 1.3))
_ROLES = {"load": palette.LOAD, "sensor": palette.SENSOR, "node": palette.MUTED, "element": palette.INK}
_EDGE = "#333333"


def structure_figure(drawn: Picture) -> Figure:
    """One panel for each of mass, stiffness and damping that has a parameter."""
    shown: Sequence[Panel | None] = drawn.panels or (None,)
    n = len(shown)
    if drawn.is_wide:
        size = (WIDE_INCHES + 1.4, n * (WIDE_INCHES / drawn.aspect + 0.55) + 0.9)
        shape = (n, 1)
    else:
        size = (n * (PANEL_INCHES + 0.9), 0.88 * PANEL_INCHES / drawn.aspect + 1.3)
        shape = (1, n)
    figure = Figure(figsize=size, layout="constrained")
    for axes, panel in zip(figure.subplots(*shape, squeeze=False).flat, shown, strict=True):
        _panel(figure, axes, drawn, panel)
    figure.legend(handles=_key(bool(drawn.panels)), loc="outside lower center", ncols=4)
    return figure


def _panel(figure: Figure, axes: Axes, drawn: Picture, panel: Panel | None) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=drawn.bounds[:2], ylim=drawn.bounds[2:])
    axes.plot(*drawn.links.T, color=palette.RIGID, lw=1.1, ls="--", zorder=1)
    axes.plot(*drawn.grounds.T, color=palette.SUPPORT, lw=1.0, zorder=1)
    for path in drawn.supports:
        axes.fill(*path.T, color=palette.SUPPORT, zorder=4.5)
    axes.plot(*drawn.nodes.T, ls="", marker="o", ms=2.2, color=_EDGE, zorder=5)
    for mark in drawn.marks:
        _mark(axes, mark, panel)
    for arrow in drawn.sensors:
        _arrow(axes, arrow, palette.SENSOR, 1.5, 6)
    for arrow in drawn.loads:
        _arrow(axes, arrow, palette.LOAD, 2.4, 7)
    for name, path in drawn.axes:
        axes.plot(*path.T, color=palette.MUTED, lw=1.2)
        end = path[1] + 0.35 * (path[1] - path[0])
        axes.text(end[0], end[1], name, color=palette.MUTED, fontsize=8, ha="center", va="center")
    for label in drawn.labels:
        axes.text(
            label.at[0],
            label.at[1],
            plain(label.text),
            color=_ROLES[label.role],
            fontsize=7,
            ha="center",
            va="center",
            zorder=9,
            path_effects=[Stroke(linewidth=2.0, foreground="white"), Normal()],
        )
    if panel is None:
        return
    axes.set_title(f"change of {panel.name} parameters", loc="left")
    scale = ScalarMappable(Normalize(-panel.limit, panel.limit), palette.DIVERGING)
    bar = figure.colorbar(scale, ax=axes, shrink=0.8, aspect=22, extend="both" if panel.is_exceeded else "neither")
    bar.set_ticks([value for value, _ in panel.ticks], labels=[text for _, text in panel.ticks])
    bar.set_label("relative change")


def _mark(axes: Axes, mark: Mark, panel: Panel | None) -> None:
    """One element in its colour; dashed or hatched where it is not identified."""
    shown = look(panel, mark.element, mark.index)
    if mark.filled:
        hatch = "////" if shown.is_doubtful else None
        axes.fill(
            *mark.path.T, facecolor=shown.colour, edgecolor=_EDGE, lw=0.9, hatch=hatch, zorder=2.5 if mark.nodes else 4
        )
        return
    width = 3.0 if shown.is_unknown else 1.4
    style = _DASHES if shown.is_doubtful else "-"
    path = PathPatch(Path(*_path_codes(mark.path)), fill=False, edgecolor=shown.colour, lw=width, ls=style, zorder=3)
    path.set_capstyle("butt")
    if shown.is_unknown:
        path.set_path_effects([Stroke(linewidth=width + 1.3, foreground=_EDGE), Normal()])
    axes.add_patch(path)


def _path_codes(path: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Vertices and codes of a polyline in which rows of NaN lift the pen."""
    lifted = np.isnan(path[:, 0])
    starts = np.concatenate([[True], lifted[:-1]])[~lifted]
    return path[~lifted], [int(Path.MOVETO if s else Path.LINETO) for s in starts]


def _arrow(axes: Axes, arrow: Arrow, colour: str, width: float, order: int) -> None:
    axes.plot(*arrow.shaft.T, color=colour, lw=width, solid_capstyle="butt", zorder=order)
    for head in arrow.heads:
        axes.fill(*head.T, color=colour, lw=0.5, zorder=order)


def _key(has_changes: bool) -> list[Line2D | Patch]:
    changes: list[Line2D | Patch] = [
        Line2D([], [], color=palette.colours(palette.DIVERGING)[17], lw=3.5, label="parameter, coloured by change"),
        Line2D([], [], color=palette.colours(palette.DIVERGING)[17], lw=3.5, ls=_DASHES, label="line not identified"),
        Patch(facecolor="white", edgecolor=_EDGE, lw=0.9, hatch="////", label="mass or cell not identified"),
    ]
    known = "not a parameter of this kind" if has_changes else "element"
    return [
        *(changes if has_changes else []),
        Line2D([], [], color=palette.KNOWN, lw=2.5, label=known),
        Line2D([], [], color=palette.RIGID, lw=1.1, ls="--", label="rigid link"),
        Line2D([], [], color=palette.SENSOR, lw=1.5, marker=">", label="sensor, positive sense"),
        Line2D([], [], color=palette.LOAD, lw=2.4, marker=">", label="load"),
        Line2D([], [], color=palette.SUPPORT, ls="", marker="^", label="support"),
    ]

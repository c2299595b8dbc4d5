"""Figures as PNG files, drawn by Matplotlib with no global state left behind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, cast

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure as Picture
from matplotlib.font_manager import findfont, get_font
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import NullLocator

from structid.core.errors import InputError
from structid.files import atomic_write, make_folder
from structid.report.drawing import palette
from structid.report.rendering.plot import (
    VIEW,
    Area,
    Axis,
    ColourScale,
    Curve,
    Figure,
    HeatMap,
    Marker,
    Panel,
    Pen,
    Texts,
)

DPI = 150
#: A pixel of the page in points.
_PIXEL = 0.72
#: Settings that hold while a figure is drawn, so that a user's own do not change it.
STYLE: dict[Any, object] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.edgecolor": palette.MUTED,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "grid.color": palette.GRID,
    "grid.linewidth": 0.7,
    "hatch.linewidth": 0.8,
    "text.usetex": False,
    "path.simplify": True,
}
_SYMBOLS = {
    "circle": "o", "square": "s", "diamond": "D", "triangle-up": "^", "triangle-down": "v", "triangle-left": "<",
    "triangle-right": ">", "x-thin": "x", "x": "X", "cross": "P", "star": "*", "none": "",
}  # fmt: skip
_DASHES = {"solid": "-", "dash": (0, (4, 2.5)), "dot": ":"}
_HALO = [Stroke(linewidth=2.0, foreground="white"), Normal()]
#: Height of a row of the legend and of a note.
_LEGEND_ROW, _NOTE = 20, 30
_NONE = Pen("none", 0.0)


def write_pngs(figures: Mapping[str, Figure], folder: Path) -> None:
    """Write a PNG file for each picture of `figures` into `folder`, created if missing.

    Figures are by name, which is the name of the file; a figure whose panels have several strips gives one file for
    each strip, with the name of the strip appended.
    """
    make_folder(folder)
    for name, figure in pictures(figures).items():
        with atomic_write(folder / f"{name}.png") as temporary, matplotlib.rc_context(STYLE):
            drawn(figure).savefig(temporary, dpi=DPI, format="png", metadata={"Software": None})


def pictures(figures: Mapping[str, Figure]) -> dict[str, Figure]:
    """Figures to be drawn as pictures, by name: one for each of `figures`, or for each strip if panels have several.

    The name of a strip is appended, with an underscore, to that of its figure.
    """
    strips_by_name = {}
    for name, figure in figures.items():
        strips = figure.panels[0].strips
        for number, strip in enumerate(strips):
            alone = len(strips) == 1
            strips_by_name[name if alone else f"{name}_{strip.name}"] = figure if alone else figure.strip(number)
    return strips_by_name


class NotebookPicture(Picture):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, dpi=DPI, format="png")
        return content.getvalue()


def plotted(figure: Figure, axes: Axes | Sequence[Axes] | None = None) -> Picture:
    """Matplotlib picture of a figure with all strips one above the other.

    `axes` are Matplotlib axes to draw on, one for each strip; strips without an axis are left out. By default a new
    picture is made.

    Raises
    ------
    InputError
        If there are more axes than strips, or fewer than panels.
    """
    with matplotlib.rc_context(STYLE):
        strips = [
            replace(panel, strips=(strip,), title=panel.title if strip is panel.strips[0] else "")
            for panel in figure.panels
            for strip in panel.strips
        ]
        if axes is None:
            if len(strips) == len(figure.panels):
                return drawn(figure)
            picture: Picture = NotebookPicture(
                figsize=(figure.size[0] / 100, figure.size[1] / 100), layout="constrained"
            )
            weights = [panel.strips[0].weight for panel in strips]
            panels_axes = list(picture.subplots(len(strips), height_ratios=weights, sharex=True))
        else:
            panels_axes = [axes] if isinstance(axes, Axes) else list(axes)
            if not len(figure.panels) <= len(panels_axes) <= len(strips):
                raise InputError(f"`axes` must be {len(strips)}, one for each panel, got {len(panels_axes)}")
            picture = cast("Picture", panels_axes[0].get_figure(root=True))
        handles: dict[str, Artist] = {}
        last = len(panels_axes) - 1
        for k, (panel_axes, panel) in enumerate(zip(panels_axes, strips, strict=False)):
            named = k == last or axes is not None
            _whole_panel(picture, panel_axes, panel, handles, figure.size[0], (named, True))
            panel_axes.set_title(plain(panel.title), loc="left")
        if handles and axes is None:
            picture.legend([*handles.values()], [*handles], loc="outside upper center", ncols=len(handles))
        elif handles:
            panels_axes[0].legend([*handles.values()], [*handles])
        return picture


def _whole_panel(
    picture: Picture, axes: Axes, panel: Panel, handles: dict[str, Artist], width: float, named: tuple[bool, bool]
) -> None:
    """Draw a panel of one strip on `axes`, with scales, titles and colour bar.

    `named` says if the x and the y axis, in this order, get a title. Legend entries are added to `handles`, by label;
    `width` is that of the axes in pixels.
    """
    _panel(axes, panel, handles)
    _scale(axes, "x", panel.x, width, named[0])
    _scale(axes, "y", panel.strips[0].y, width, named[1])
    if panel.scale is not None:
        _bar(picture, axes, panel.scale)


def drawn(figure: Figure) -> Picture:
    """Matplotlib picture of a figure whose panels have one strip each, in rows of at most `figure.columns`.

    Of a figure with a choice only the panels that it shows at first are drawn, with its note below.
    """
    choice = figure.choice
    shown = figure.panels if choice is None else tuple(figure.panels[i] for i in choice.shown)
    width, height = figure.size if choice is None else choice.size
    columns = min(figure.columns, len(shown))
    rows = -(-len(shown) // columns)
    longest = max((len(trace.label) for trace in figure.legend), default=0)
    across = max(1, min(len(figure.legend), int(columns * width / (62 + 6.2 * longest))))
    below = _NOTE if choice and choice.note else 0
    high = rows * height + _LEGEND_ROW * -(-len(figure.legend) // across) + below
    picture = NotebookPicture(figsize=(columns * width / 100, high / 100), layout="constrained")
    handles: dict[str, Artist] = {}
    same_x, same_y = (
        len({axis.title for axis in axes}) == 1 for axes in zip(*((p.x, p.strips[0].y) for p in shown), strict=True)
    )
    for k, panel in enumerate(shown):
        axes = picture.add_subplot(rows, columns, k + 1, projection=None if panel.z is None else "3d")
        named = not same_x or k + columns >= len(shown), not same_y or k % columns == 0
        _whole_panel(picture, axes, panel, handles, width, named)
        axes.set_title(plain(panel.title if choice is None else panel.name), loc="left")
    if handles:
        picture.legend([*handles.values()], [*handles], loc="outside upper center", ncols=across)
    if choice and choice.note:
        picture.supxlabel(plain(choice.note), fontsize=9.0)
    return picture


def _panel(axes: Axes, panel: Panel, handles: dict[str, Artist]) -> None:
    """Draw a panel that has a single strip (one y axis, or one left and one right) on Matplotlib `axes`.

    Its legend entries are added to `handles`, by label.
    """
    (strip,) = panel.strips
    axes.set_facecolor(panel.background)
    beside = axes.twinx() if strip.right is not None else axes
    canvas = _Canvas(axes, beside, panel, handles)
    for trace in strip.traces:
        trace.draw(canvas)
    if strip.right is not None:
        _scale(beside, "y", replace(strip.right, grid=False), 0.0, True)
        beside.spines["right"].set_visible(True)
        axes.set_zorder(beside.get_zorder() + 1)
        axes.patch.set_visible(False)
    if panel.z is not None:
        spans = [ends[1] - ends[0] for ends in (panel.x.limits, strip.y.limits, panel.z.limits) if ends]
        axes.set(zlim=panel.z.limits, proj_type="ortho", box_aspect=spans)
        axes.view_init(azim=VIEW[0], elev=VIEW[1])  # type: ignore[attr-defined]
    elif panel.equal:
        axes.set_aspect("equal")
    if panel.bare or panel.z is not None:
        axes.set_axis_off()


def _scale(axes: Axes, which: Literal["x", "y"], axis: Axis, width: float, is_named: bool) -> None:
    """Set scale, limits, ticks and title of the x or y axis (`which`) of Matplotlib `axes`.

    `width` is that of the axes in pixels, which decides if long tick texts are turned. Without `is_named` there is no title.
    """
    side = axes.xaxis if which == "x" else axes.yaxis
    if axis.log:
        axes.set(**{f"{which}scale": "log"})
    if axis.ticks:
        values, texts = [value for value, _ in axis.ticks], [plain(text) for _, text in axis.ticks]
        turned = which == "x" and 8 * sum(len(text) + 1 for text in texts) > width
        side.set_ticks(values, labels=texts, rotation=90 if turned else 0, fontsize=8.5 if len(texts) <= 40 else 7.0)
        side.set_minor_locator(NullLocator())
    if axis.limits is not None:
        axes.set(**{f"{which}lim": axis.limits})
    axes.grid(axis.grid, axis=which)
    side.label.set_text(plain(axis.title) if is_named else "")


def _bar(picture: Picture, axes: Axes, scale: ColourScale) -> None:
    """Add a bar for the colour scale beside `axes`, with arrows at its ends if values exceed it."""
    extend = "both" if scale.is_exceeded else "neither"
    colours = ScalarMappable(_norm(scale), _colours(scale.colours))
    bar = picture.colorbar(colours, ax=axes, aspect=25, shrink=0.9, extend=extend)
    if scale.ticks:
        bar.set_ticks([value for value, _ in scale.ticks], labels=[text for _, text in scale.ticks])
        bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.set_label(plain(scale.label))


@dataclass(frozen=True, eq=False)
class _Canvas:
    """The canvas of one strip: artists on `axes`, or on those `beside` them whose scale is at the right."""

    axes: Axes
    beside: Axes
    panel: Panel
    handles: dict[str, Artist]

    def curve(self, trace: Curve) -> None:
        """Draw a curve; one that sways is drawn at rest plus its motion at phase 0, and again half a period later."""
        self._line(trace, trace.at(0.0))
        if trace.sway is not None:
            marker = trace.marker and replace(trace.marker, colour=palette.BLUE)
            later = replace(trace, pen=Pen(palette.BLUE, 1.6, "dash"), marker=marker, label="half a period later")
            self._line(later, trace.at(np.pi))

    def _line(self, trace: Curve, points: tuple[np.ndarray, ...]) -> None:
        """Draw one line of a curve through `points`, arrays x, y and perhaps z, (n,) each, and note its legend entry."""
        pen, marker = trace.pen or _NONE, trace.marker or Marker("none", 0.0, "")
        edge, axes = marker.edge or _NONE, self.beside if trace.right else self.axes
        (line,) = axes.plot(
            *points, color=pen.colour, linewidth=pen.width * _PIXEL, linestyle=_DASHES[pen.dash], zorder=self._order(),
            marker=_SYMBOLS[marker.symbol], markersize=marker.size * _PIXEL, markerfacecolor=marker.colour or "none",
            markeredgecolor=edge.colour, markeredgewidth=edge.width * _PIXEL,
        )  # fmt: skip
        if trace.label:
            self.handles.setdefault(plain(trace.label), line)

    def area(self, trace: Area) -> None:
        """Draw an area as filled polygons, one for each outline of its path, and note its legend entry."""
        edge = trace.edge or _NONE
        shape = PolyCollection(
            _outlines(trace.x, trace.y), facecolor=trace.colour, edgecolor=edge.colour, linewidth=edge.width * _PIXEL,
            alpha=trace.opacity, hatch="////" if trace.hatched else None, zorder=self._order(),
        )  # fmt: skip
        self.axes.add_collection(shape)
        self.axes.autoscale_view()
        if trace.label:
            self.handles.setdefault(plain(trace.label), shape)

    def heat_map(self, trace: HeatMap) -> None:
        """Draw coloured cells, blank where a value is not finite, with their values if these are to be written."""
        scale = self.panel.scale or ColourScale(palette.SEQUENTIAL, 0.0, 1.0, "")
        colours, norm = _colours(scale.colours), _norm(scale)
        self.axes.pcolormesh(
            trace.x, trace.y, np.ma.masked_invalid(trace.values), cmap=colours, norm=norm, rasterized=True,
            edgecolors="white" if trace.columns else "none", linewidth=0.5 if trace.columns else 0.0,
        )  # fmt: skip
        for (row, column), value in np.ndenumerate(trace.values) if trace.written else ():
            centre = trace.x[column : column + 2].mean(), trace.y[row : row + 2].mean()
            light = np.dot(colours(norm(value))[:3], (0.299, 0.587, 0.114)) if np.isfinite(value) else 1.0
            text = f"{value:.2f}".replace("-", "\u2212") if np.isfinite(value) else ""
            self.axes.text(
                *centre, text, ha="center", va="center", size=7.0, color="white" if light < 0.5 else palette.INK
            )

    def texts(self, trace: Texts) -> None:
        """Draw texts with a white halo, legible over lines."""
        up, along = trace.side.split()
        aside = {"left": "right", "right": "left", "center": "center"}[along]
        below = {"top": "bottom", "bottom": "top", "middle": "center"}[up]
        shift = ({"left": -3, "right": 3, "center": 0}[along], {"top": 2, "bottom": -2, "middle": 0}[up])
        for x, y, word in zip(trace.x, trace.y, trace.words, strict=True):
            self.axes.annotate(
                plain(word), (x, y), shift, textcoords="offset points", ha=aside, va=below, color=trace.colour,
                size=trace.size * _PIXEL, path_effects=_HALO, zorder=self._order(), annotation_clip=True,
            )  # fmt: skip

    def _order(self) -> float:
        """Matplotlib drawing order (zorder) above all artists that `axes` have so far."""
        return 2.0 + 0.001 * len(self.axes.get_children())


def _outlines(x: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
    """Separate outlines, each (n, 2), of the path `x`, `y` that NaN in `x` divides."""
    points = np.column_stack([x, y])
    gaps = np.flatnonzero(np.isnan(x))
    pieces = (piece[~np.isnan(piece[:, 0])] for piece in np.split(points, gaps))
    return [piece for piece in pieces if len(piece)]


def _norm(scale: ColourScale) -> Normalize:
    return LogNorm(scale.low, scale.high, clip=True) if scale.log else Normalize(scale.low, scale.high)


@cache
def _colours(name: str) -> Colormap:
    return LinearSegmentedColormap.from_list(name, palette.SCALES[name])


@cache
def _glyphs() -> frozenset[int]:
    return frozenset(get_font(findfont("DejaVu Sans")).get_charmap())


def plain(text: str) -> str:
    """The text for Matplotlib, with dollar signs escaped and a box in place of characters that the font lacks."""
    drawable = "".join(c if c == "\n" or ord(c) in _glyphs() else "□" for c in text)
    return drawable.replace("$", r"\$")

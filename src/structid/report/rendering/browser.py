"""Figures for a page: descriptions that Plotly draws in the browser, and the swatches of their legends."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from structid.core.arrays import FloatArray
from structid.report.drawing import palette
from structid.report.rendering.plot import (
    NUMBERS,
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
    Ticks,
)

#: What JSON can hold.
Described = dict[str, object]
_DIGITS = 6
#: Pixels between strips, and above and below all of them.
_GAP, _TOP, _BOTTOM = 26, 30, 55
_DASHED = {"solid": "", "dash": "6,3", "dot": "2,3"}
#: Signs of swatches, round (13, 6); those that are not here are round.
_SYMBOLS = {
    "square": "M9,2 h8 v8 h-8 z",
    "diamond": "M13,1 l5,5 l-5,5 l-5,-5 z",
    "triangle-up": "M13,1 l5,9 h-10 z",
    "triangle-down": "M13,11 l5,-9 h-10 z",
    "triangle-left": "M8,6 l9,-5 v10 z",
    "triangle-right": "M18,6 l-9,-5 v10 z",
    "x-thin": "M9,2 l8,8 M17,2 l-8,8",
    "x": "M9,3 l1,-1 l3,3 l3,-3 l1,1 l-3,3 l3,3 l-1,1 l-3,-3 l-3,3 l-1,-1 l3,-3 z",
    "cross": "M12,2 h2 v3 h3 v2 h-3 v3 h-2 v-3 h-3 v-2 h3 z",
    "star": "M13,0 l2,4 l4,1 l-3,3 l1,4 l-4,-2 l-4,2 l1,-4 l-3,-3 l4,-1 z",
}


@dataclass(frozen=True, eq=False)
class Arrays:
    """Every array of a page once, however many traces show it: rounded `rows`, and `places` by the bytes of each."""

    rows: list[list[float | None]] = field(default_factory=list)
    places: dict[bytes, int] = field(default_factory=dict)

    def place(self, values: FloatArray) -> int:
        """Row number, from 0, of `values` (n,) among the stored arrays; they are added if no equal array is stored."""
        given = np.ascontiguousarray(values, dtype=np.float64)
        index = self.places.setdefault(given.tobytes(), len(self.rows))
        if index == len(self.rows):
            self.rows.append(numbers(given))
        return index


def numbers(values: FloatArray) -> list[float | None]:
    """List of `values` (n,) rounded to six significant digits, with None for values that are not finite.

    Zero stays zero.
    """
    given = np.asarray(values, dtype=np.float64)
    finite = np.isfinite(given)
    size = np.abs(np.where(finite & (given != 0), given, 1.0))
    power = _DIGITS - 1 - np.floor(np.log10(size)).astype(int)
    up, down = 10.0 ** np.clip(power, 0, None), 10.0 ** np.clip(-power, 0, None)
    whole = np.rint(np.where(finite, given, 0.0) / down * up)
    return [
        value if known else None for value, known in zip((whole / up * down).tolist(), finite.tolist(), strict=True)
    ]


def embedded(figures: Mapping[str, Figure]) -> str:
    """All figures of a page as JSON text for its script: panels by figure, and the arrays to which they refer by number."""
    arrays = Arrays()
    panels = {name: [_panel(figure, n, arrays) for n in range(len(figure.panels))] for name, figure in figures.items()}
    return json.dumps({"figures": panels, "arrays": arrays.rows}, allow_nan=False, separators=(",", ":"))


def _panel(figure: Figure, number: int, arrays: Arrays) -> Described:
    """Plotly title, data and layout of panel `number` (from 0) of a figure; numbers are stored in `arrays`."""
    panel, height = figure.panels[number], figure.size[1]
    axes: dict[str, Described] = {"xaxis": _axis(panel.x, panel.bare)}
    data: list[Described] = []
    for k, (strip, domain) in enumerate(zip(panel.strips, _domains(panel, height), strict=True)):
        left, right = str(k + 1 if k else ""), str(len(panel.strips) + k + 1)
        axes["yaxis" + left] = _axis(strip.y, panel.bare) | {"domain": domain, "uirevision": f"{number}"}
        axes["xaxis"]["anchor"] = "y" + left
        if strip.right is not None:
            beside: Described = {"side": "right", "showgrid": False, "domain": domain, "anchor": "x"}
            axes["yaxis" + right] = _axis(strip.right, False) | beside
            axes["yaxis" + left] |= {"overlaying": "y" + right, "tickmode": "auto"}
        canvas = _Traces(arrays, panel, "y" + left, "y" + right, data)
        for trace in strip.traces:
            trace.draw(canvas)
    if panel.equal:
        axes = {
            name: axis | {"constrain": "domain"} for name, axis in axes.items()
        }  # else each resize widens the limits
        axes["yaxis"]["scaleanchor"] = "x"
    margin = {"l": 10, "r": 20, "t": _TOP, "b": 5 if panel.bare else _BOTTOM}
    layout: Described = {
        "height": height,
        "margin": margin,
        "uirevision": "kept",
        "plot_bgcolor": panel.background,
        **axes,
    }
    if panel.z is not None:
        space = _space(panel.x, panel.strips[0].y, panel.z)
        layout = {"height": height, "margin": {"l": 0, "r": 0, "t": 0, "b": 0}, "uirevision": "kept", "scene": space}
    if panel.scale is not None:
        layout["coloraxis"] = _colours(panel.scale)
        bar: Described = {"color": [0], "coloraxis": "coloraxis", "opacity": 0}  # of a trace that shows nothing else
        data.append(
            {"type": "scatter", "mode": "markers", "x": [None], "y": [None], "marker": bar, "hoverinfo": "skip"}
        )
    return {"title": panel.title, "data": data, "layout": layout}


def _domains(panel: Panel, height: float) -> list[list[float]]:
    """Lower and upper end of every strip of a panel, from the top down, as fractions of the plot height.

    Strips are as high as their weights say, with gaps between them; `height` is that of the figure in pixels.
    """
    shares = np.array([strip.weight for strip in panel.strips])
    tops = 1.0 - np.concatenate([[0.0], np.cumsum(shares)]) / shares.sum()
    gap = _GAP / (height - _TOP - _BOTTOM)
    return [[max(foot, 0.0) + (gap if foot > 1e-9 else 0.0), top] for top, foot in pairwise(tops.tolist())]


def clean(text: str) -> str:
    """`text` with the characters escaped that Plotly would read as markup, and its line breaks."""
    return html.escape(text, quote=False).replace("\n", "<br>")


def _axis(axis: Axis, is_bare: bool) -> Described:
    """Plotly description of an axis with its title, scale, limits and ticks; hidden if `is_bare`.

    Limits of a logarithmic axis are given as logarithms to base 10; its ticks stay values.
    """
    described: Described = {"title": {"text": clean(axis.title)}, "visible": not is_bare, "showgrid": axis.grid}
    ends = axis.limits
    if axis.log:
        decades = np.log10(max(ends) / min(ends)) if ends else 1.0
        described |= {
            "type": "log",
            "exponentformat": "power",
            "dtick": "D2" if decades < 1.5 else 1 + int(decades / 9),
        }
        ends = None if ends is None else (float(np.log10(ends[0])), float(np.log10(ends[1])))
    if ends is not None:
        described["range"] = [round(end, 9) for end in ends]
    return described | _ticks(axis.ticks)


def _ticks(ticks: Ticks) -> Described:
    """Plotly description of `ticks`, pairs of a value on the axis and a text; {} for automatic ticks."""
    if not ticks:
        return {}
    texts = [clean(text) for _, text in ticks]
    return {
        "tickvals": [value for value, _ in ticks],
        "ticktext": texts,
        "tickfont": {"size": 12 if len(ticks) <= 40 else 10},
    }


def _colours(scale: ColourScale) -> Described:
    """Plotly description of a colour scale with its bar; values of a logarithmic scale become their log10."""
    place = np.log10 if scale.log else np.asarray
    anchors = palette.SCALES[scale.colours]
    title = scale.label + (" (or beyond)" if scale.is_exceeded else "")
    bar: Described = {"title": {"text": clean(title), "side": "right", "font": {"size": 12}}, "thickness": 14}
    return {
        "colorscale": [[k / (len(anchors) - 1), colour] for k, colour in enumerate(anchors)],
        "cmin": float(place(scale.low)),
        "cmax": float(place(scale.high)),
        "colorbar": bar | _ticks(tuple((float(place(value)), text) for value, text in scale.ticks)),
    }


def _space(*axes: Axis) -> Described:
    """Plotly description of the axes x, y and z, in this order, at equal scale, seen from the direction `VIEW`.

    An axis without limits counts as 0 to 1.
    """
    turn, tilt = np.radians(VIEW)
    eye = 1.8 * np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    spans = np.ptp([axis.limits or (0.0, 1.0) for axis in axes], axis=1)
    named = zip("xyz", axes, strict=True)
    return {
        **{f"{name}axis": {"title": {"text": clean(axis.title)}, "range": axis.limits} for name, axis in named},
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", numbers(spans / spans.max()), strict=True)),
        "camera": {"eye": dict(zip("xyz", numbers(eye), strict=True)), "center": {"x": 0, "y": 0, "z": -0.08}},
    }


@dataclass(frozen=True, eq=False)
class _Traces:
    """The canvas of one strip: Plotly traces added to `data`, on the left or the right axis."""

    arrays: Arrays
    panel: Panel
    left: str
    right: str
    data: list[Described]

    def _add(self, trace: Described, label: str, **indices: int | list[int]) -> None:
        named: Described = {"name": clean(label)} if label else {}
        self.data.append({"type": "scatter", "yaxis": self.left} | trace | named | {"arrays": indices})

    def curve(self, trace: Curve) -> None:
        """Add a curve as a Plotly scatter trace, in the plane or in space, with the motion of a swaying curve."""
        described: Described = {"mode": "+".join(["lines"] * bool(trace.pen) + ["markers"] * bool(trace.marker))}
        described |= {"line": _pen(trace.pen)} if trace.pen else {}
        described |= {"marker": _marker(trace.marker)} if trace.marker else {}
        described |= {"yaxis": self.right} if trace.right else {}
        described |= {"type": "scatter3d", "yaxis": None} if trace.z is not None else {}
        if trace.hover is None:
            described["hoverinfo"] = "skip"
        elif trace.hover == NUMBERS:
            described["hovertemplate"] = "%{x}, %{y}"
        else:
            described |= {"text": [clean(text) for text in trace.hover], "hovertemplate": "%{text}<extra></extra>"}
        indices: dict[str, int | list[int]] = {
            key: self.arrays.place(v) for key, v in zip("xyz", trace.at(), strict=False)
        }
        if trace.sway is not None:
            indices["real"], indices["imaginary"] = (
                [self.arrays.place(column) for column in part.T] for part in (trace.sway.real, trace.sway.imag)
            )
        self._add(described, trace.label, **indices)

    def area(self, trace: Area) -> None:
        """Add an area as a filled Plotly outline, hatched if the area says so."""
        described: Described = {"mode": "lines", "fill": "toself", "fillcolor": trace.colour, "hoverinfo": "skip"}
        described |= {"line": _pen(trace.edge or Pen(trace.colour, 0.0)), "opacity": trace.opacity}
        pattern = {"shape": "/", "fgcolor": palette.INK, "bgcolor": trace.colour, "size": 6, "solidity": 0.25}
        described |= {"fillpattern": pattern} if trace.hatched else {}
        self._add(described, trace.label, x=self.arrays.place(trace.x), y=self.arrays.place(trace.y))

    def heat_map(self, trace: HeatMap) -> None:
        """Add a heat map in the colours of the panel's scale; on a logarithmic scale the logarithms (base 10) are stored."""
        is_log = self.panel.scale is not None and self.panel.scale.log
        shown = np.log10(trace.values) if is_log else trace.values
        place = "%{text}: " if trace.columns else "%{x}, %{text}: "
        described: Described = {
            "type": "heatmap",
            "coloraxis": "coloraxis",
            "hoverongaps": False,
            "hovertemplate": place + ("10^%{z:.2f}" if is_log else "%{z:.3f}") + "<extra></extra>",
            "rows": [clean(name) for name in trace.rows],
            "columns": [clean(name) for name in trace.columns],
        }
        described |= {"texttemplate": "%{z:.2f}"} if trace.written else {}
        described |= {"xgap": 1, "ygap": 1} if trace.columns else {}
        rows = [self.arrays.place(row) for row in shown]
        self._add(described, "", x=self.arrays.place(trace.x), y=self.arrays.place(trace.y), z=rows)

    def texts(self, trace: Texts) -> None:
        """Add texts, each at an invisible marker at its position."""
        described: Described = {"mode": "markers+text", "text": [clean(word) for word in trace.words]}
        described |= {"textposition": trace.side, "textfont": {"size": trace.size, "color": trace.colour}}
        described |= {"marker": {"size": 8, "opacity": 0}, "hoverinfo": "skip", "cliponaxis": False}
        self._add(described, "", x=self.arrays.place(trace.x), y=self.arrays.place(trace.y))


def _pen(pen: Pen) -> Described:
    return {"color": pen.colour, "width": pen.width, "dash": pen.dash}


def _marker(marker: Marker) -> Described:
    line: Described = {"line": {"color": marker.edge.colour, "width": marker.edge.width}} if marker.edge else {}
    return {"symbol": marker.symbol, "size": marker.size, "color": marker.colour or "rgba(0,0,0,0)"} | line


def legend(figure: Figure) -> list[tuple[str, Markup]]:
    """Legend entries of a figure, as pairs of a label and an SVG swatch of 26 by 12 pixels."""
    entries = []
    for trace in figure.legend:
        swatch = _Swatch()
        trace.draw(swatch)
        shapes = Markup("").join(swatch.shapes)
        entries.append((trace.label, Markup('<svg width="26" height="12" aria-hidden="true">{}</svg>').format(shapes)))
    return entries


@dataclass(frozen=True, eq=False)
class _Swatch:
    """The canvas of one entry of a legend."""

    shapes: list[Markup] = field(default_factory=list)

    def _path(self, path: str, fill: str, edge: Pen, opacity: float = 1.0) -> None:
        form = '<path d="{}" fill="{}" stroke="{}" stroke-width="{}" stroke-dasharray="{}" opacity="{}"/>'
        width, dash = min(edge.width, 4.0), _DASHED[edge.dash]
        self.shapes.append(Markup(form).format(path, fill or "none", edge.colour, width, dash, opacity))

    def curve(self, trace: Curve) -> None:
        """Add the swatch of a curve to the legend: its line, with its marker in the middle."""
        if trace.pen:
            self._path("M1,6 h24", "", trace.pen)
        if trace.marker:
            r = min(trace.marker.size, 9.0) / 2
            disc = f"M{13 - r},6 a{r},{r} 0 1,0 {2 * r},0 a{r},{r} 0 1,0 {-2 * r},0"
            self._path(_SYMBOLS.get(trace.marker.symbol, disc), trace.marker.colour, trace.marker.edge or Pen("none"))

    def area(self, trace: Area) -> None:
        """Add the swatch of an area to the legend: a box, hatched if the area is."""
        self._path("M3,1 h20 v10 h-20 z", trace.colour, trace.edge or Pen("none"), trace.opacity)
        if trace.hatched:
            self._path("M4,10 L10,2 M10,10 L16,2 M16,10 L22,2", "", Pen(palette.INK, 1.0))

    def heat_map(self, trace: HeatMap) -> None:
        """Draw no swatch: the colour bar explains a heat map."""

    def texts(self, trace: Texts) -> None:
        """Words explain themselves."""

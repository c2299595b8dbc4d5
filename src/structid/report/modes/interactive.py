"""The figures of modes as Plotly descriptions, and what the page's script needs to move the shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.modal.survey.survey import ModesResult
from structid.report.drawing import palette
from structid.report.figures.interactive_base import Figure, axis, base_layout, clean, numbers
from structid.report.modes.data import (
    ALONE,
    CHOSEN,
    CLUSTERED,
    KIND_NAMES,
    MOST_SHAPES,
    OUTSIDE,
    auto_mac,
    mode_labels,
    spectrum_label,
    spectrum_limits,
    sweep_poles,
    thinned_lines,
    turned_shapes,
    view,
)
from structid.report.modes.scene import AZIMUTH, ELEVATION, Scene, mode_scene
from structid.report.modes.text import mpc, value_words
from structid.report.text import number

_MARKERS: dict[int, dict[str, Any]] = {
    OUTSIDE: {"symbol": "circle", "size": 3, "color": palette.FAINT},
    ALONE: {"symbol": "x-thin", "size": 6, "line": {"color": palette.MUTED, "width": 1.2}},
    CLUSTERED: {"symbol": "circle", "size": 7, "color": "white", "line": {"color": palette.BLUE, "width": 1.6}},
    CHOSEN: {"symbol": "diamond", "size": 11, "color": palette.VERMILLION, "line": {"color": "white", "width": 1}},
}
_NAMES = ("first", "second", "third")
_COLOURS = (palette.INK, palette.BLUE, palette.PURPLE)
_DASHES = ("solid", "dash", "dot")
_SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross")


def mode_figures(result: ModesResult) -> dict[str, Figure]:
    """Every figure of the page by name."""
    makers = {
        "stabilization": stabilization_figure(result),
        "shapes": shapes_figure(result),
        "singular-values": spectra_figure(result),
        "damping": damping_figure(result),
        "automac": mac_figure(result),
        "complexity": complexity_figure(result),
    }
    return {name: figure for name, figure in makers.items() if figure is not None}


def stabilization_figure(result: ModesResult) -> Figure | None:
    """Poles of every order, over the first singular value on a logarithmic axis."""
    poles = sweep_poles(result)
    if poles is None:
        return None
    frequency, values = thinned_lines(result, 1)
    data: list[dict[str, Any]] = [
        {
            "type": "scatter", "mode": "lines", "x": numbers(frequency, 6), "y": numbers(values[:, 0], 4), "yaxis": "y2",
            "line": {"color": palette.SKY, "width": 1.4}, "name": "first singular value", "hoverinfo": "skip",
        }
    ]  # fmt: skip
    for kind, marker in _MARKERS.items():
        here = poles.kind == kind
        if here.any():
            data.append(
                {
                    "type": "scatter", "mode": "markers", "name": KIND_NAMES[kind], "marker": marker,
                    "x": numbers(poles.frequency[here], 6), "y": poles.order[here].tolist(),
                    "customdata": numbers(100 * poles.damping_ratio[here], 4),
                    "hovertemplate": "order %{y}: %{x} Hz, damping %{customdata} %<extra></extra>",
                }
            )  # fmt: skip
    layout = base_layout(520)
    low, high = np.log10(spectrum_limits(result))
    layout["xaxis"] = axis("frequency (Hz)") | {"range": list(view(result))}
    layout["yaxis"] = axis("order of the model (states)") | {
        "range": [0, float(poles.order.max()) * 1.04 + 1],
        "overlaying": "y2", "tickmode": "auto", "nticks": 8,
    }  # fmt: skip
    layout["yaxis2"] = axis(f"first of the {clean(spectrum_label(result))}") | {
        "type": "log", "side": "right", "range": [float(low), float(high)],
        "showgrid": False, "exponentformat": "power", "dtick": 1,
    }  # fmt: skip
    layout["margin"]["r"] = 80
    layout["shapes"], layout["annotations"] = _mode_marks(result)
    caption = (
        "Poles of the models of all orders. A mode keeps its place from order to order; a pole of noise does not."
        f" Behind them: {result.spectra.name}. Double-click for the whole range."
    )
    return Figure(data, layout, caption)


def _mode_marks(result: ModesResult) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A line at every mode and its number above it."""
    lines, texts = [], []
    for f in result.modes.frequency.tolist():
        line = {"color": palette.VERMILLION, "width": 1}
        lines.append(
            {
                "type": "line",
                "x0": f,
                "x1": f,
                "y0": 0,
                "y1": 1,
                "yref": "paper",
                "line": line,
                "opacity": 0.6,
                "layer": "below",
            }
        )
    font = {"size": 11, "color": palette.VERMILLION}
    for f, text in mode_labels(result):
        texts.append(
            {
                "x": f, "y": 1, "yref": "paper", "yanchor": "top", "xanchor": "left", "xshift": 1, "text": text,
                "showarrow": False, "font": font,
            }
        )  # fmt: skip
    return lines, texts


def spectra_figure(result: ModesResult) -> Figure:
    """The first three singular values, the modes marked."""
    frequency, values = thinned_lines(result)
    data = [
        {
            "type": "scatter", "mode": "lines", "x": numbers(frequency, 6), "y": numbers(values[:, j], 4),
            "line": {"color": _COLOURS[j], "width": 1.4, "dash": _DASHES[j]}, "name": f"{_NAMES[j]} singular value",
            "hovertemplate": "%{x} Hz: %{y}<extra></extra>",
        }
        for j in range(values.shape[1])
    ]  # fmt: skip
    layout = base_layout(400)
    low, high = np.log10(spectrum_limits(result))
    layout["xaxis"] = axis("frequency (Hz)") | {"range": list(view(result))}
    layout["yaxis"] = axis(clean(spectrum_label(result))) | {
        "type": "log", "range": [float(low), float(high)], "exponentformat": "power", "dtick": 1,
    }  # fmt: skip
    layout["shapes"], layout["annotations"] = _mode_marks(result)
    layout["margin"]["l"] = 80
    caption = (
        f"The {result.spectra.name}; one line that stands out is one mode there, two are two. Numbers: modes."
        " Double-click for the whole range."
    )
    return Figure(data, layout, caption)


def damping_figure(result: ModesResult) -> Figure | None:
    """Damping ratio over frequency with one standard deviation."""
    modes, n = result.modes, result.modes.n_modes
    if not np.isfinite(modes.damping_ratio).any():
        return None
    std = result.std
    texts = [
        f"mode {k + 1}: {value_words(modes.frequency[k], std[k])} Hz,"
        f" {value_words(100 * modes.damping_ratio[k], 100 * std[n + k])} %"
        for k in range(n)
    ]
    sides = ["top right" if k % 2 == 0 else "bottom left" for k in range(n)]
    bars = {"type": "data", "color": palette.INK, "thickness": 1.2}
    trace = {
        "type": "scatter", "mode": "markers+text", "x": numbers(modes.frequency, 6), "showlegend": False,
        "y": numbers(100 * modes.damping_ratio), "marker": {"symbol": "diamond", "size": 9, "color": palette.VERMILLION},
        "text": [f" {k + 1}" for k in range(n)], "textposition": sides, "hovertext": texts, "hoverinfo": "text",
        "textfont": {"color": palette.VERMILLION, "size": 11}, "cliponaxis": False,
        "error_y": bars | {"array": numbers(100 * std[n:], 3)}, "error_x": bars | {"array": numbers(std[:n], 3)},
    }  # fmt: skip
    layout = base_layout(340)
    layout["xaxis"] = axis("frequency (Hz)") | {"range": list(view(result))}
    layout["yaxis"] = axis("damping ratio (%)") | {"rangemode": "tozero"}
    caption = "Damping ratios; bars: one standard deviation. Without bars: the method gives none."
    return Figure([trace], layout, caption)


def mac_figure(result: ModesResult) -> Figure:
    """MAC of the modes with each other."""
    matrix, n = auto_mac(result), result.modes.n_modes
    names = [str(k + 1) for k in range(n)]
    size = int(min(200 + 30 * n, 620))
    trace: dict[str, Any] = {
        "type": "heatmap", "z": [numbers(row, 3) for row in matrix], "zmin": 0, "zmax": 1, "xgap": 1, "ygap": 1,
        "x": names, "y": names, "colorscale": palette.plotly_scale(palette.SEQUENTIAL),
        "colorbar": {"title": {"text": "MAC", "side": "right"}},
        "hovertemplate": "modes %{y} and %{x}: %{z}<extra></extra>",
    }  # fmt: skip
    if n <= 14:
        trace |= {"texttemplate": "%{z:.2f}", "textfont": {"size": 11}}
    layout = base_layout(size, left=None)
    layout["margin"] |= {"t": 45}
    layout["xaxis"] = axis("mode") | {"type": "category", "showgrid": False, "constrain": "domain"}
    layout["yaxis"] = axis("mode") | {
        "type": "category", "showgrid": False, "autorange": "reversed", "scaleanchor": "x", "constrain": "domain",
    }  # fmt: skip
    caption = (
        "Modal assurance criterion between the shapes at the sensors: 1 where two shapes agree, 0 where they are"
        " orthogonal. Modes alike at few sensors may still differ elsewhere."
    )
    return Figure([trace], layout, caption)


def complexity_figure(result: ModesResult) -> Figure:
    """Entries of every shape in the complex plane, one polar plot a mode."""
    shapes, collinearity = turned_shapes(result), mpc(result)
    count = min(result.modes.n_modes, MOST_SHAPES)
    columns = min(count, 4)
    rows = -(-count // columns)
    data, layout = [], base_layout(90 + 270 * rows, left=None)
    layout["margin"] = {"l": 30, "r": 30, "t": 60, "b": 20}
    layout["showlegend"] = False
    layout["annotations"] = []
    wide, high = 1 / columns, 1 / rows
    for k in range(count):
        name = "polar" if k == 0 else f"polar{k + 1}"
        left, top = (k % columns) * wide, 1 - (k // columns) * high
        ticks = {"tickvals": [0, 90, 180, 270], "tickfont": {"size": 10}, "gridcolor": palette.GRID}
        layout[name] = {
            "domain": {"x": [left + 0.16 * wide, left + 0.84 * wide], "y": [top - 0.80 * high, top - 0.14 * high]},
            "radialaxis": {"range": [0, 1.08], "showticklabels": False, "gridcolor": palette.GRID, "ticks": ""},
            "angularaxis": ticks,
        }
        layout["annotations"].append(
            {
                "x": left + wide / 2, "y": top + 0.06 * high, "xref": "paper", "yref": "paper", "yanchor": "top",
                "xanchor": "center", "showarrow": False,
                "text": f"mode {k + 1}: {number(result.modes.frequency[k])} Hz<br>MPC {collinearity[k]:.3f}",
                "font": {"size": 12},
            }
        )  # fmt: skip
        data += _arrows(result, shapes[:, k], name)
    caption = (
        "Entries of each shape in the complex plane, one line a channel. All on one diameter: every sensor moves in phase"
        " or in opposition, as in a structure with light or proportional damping (MPC 1). A fan: damping in one place, noise,"
        " or two modes in one."
    )
    if result.modes.n_modes > count:
        caption += f" The first {count} of {result.modes.n_modes} modes."
    return Figure(data, layout, caption)


def _arrows(result: ModesResult, shape: np.ndarray, polar: str) -> list[dict[str, Any]]:
    """Lines from the centre to every entry."""
    size, angle = np.abs(shape), np.degrees(np.angle(shape))
    blank = np.full(len(shape), np.nan)
    r = np.column_stack([0 * size, size, blank]).ravel()
    theta = np.column_stack([angle, angle, blank]).ravel()
    labels = [str(dof) for dof in result.modes.channels]
    return [
        {
            "type": "scatterpolar", "subplot": polar, "mode": "lines", "r": numbers(r, 4), "theta": numbers(theta, 5),
            "line": {"color": palette.BLUE, "width": 1.6}, "hoverinfo": "skip",
        },
        {
            "type": "scatterpolar", "subplot": polar, "mode": "markers", "r": numbers(size, 4), "theta": numbers(angle, 5),
            "marker": {"size": 7, "color": palette.VERMILLION, "line": {"color": "white", "width": 0.8}}, "text": labels,
            "hovertemplate": "%{text}: %{r} at %{theta}°<extra></extra>",
        },
    ]  # fmt: skip


def shapes_figure(result: ModesResult) -> Figure:
    """The structure at rest and the first mode; `extra` holds what every mode needs to move."""
    scene = mode_scene(result.modes, result.geometry)
    kind = "scatter" if scene.rest.shape[1] == 2 else "scatter3d"
    data: list[dict[str, Any]] = []
    for moving in (False, True):
        for place, path in enumerate(scene.paths):
            data.append(_path_trace(scene, place, kind, moving))
            if not path.is_measured and moving:
                data.pop()  # it stands still
    layout = base_layout(520 if scene.is_row else 640)
    layout |= _row_layout(scene) if scene.is_row else _space_layout(scene)
    titles = [
        f"mode {k + 1}: {value_words(f, result.std[k])} Hz" for k, f in enumerate(result.modes.frequency.tolist())
    ]
    extra = {
        "motion": {
            "rest": [numbers(row) for row in scene.rest],
            "real": [[numbers(row) for row in mode.real] for mode in scene.motion],
            "imaginary": [[numbers(row) for row in mode.imag] for mode in scene.motion],
            "paths": [list(path.points) for path in scene.paths if path.is_measured],
            "first": len(scene.paths),
            "titles": titles,
        }
    }
    return Figure(data, layout, " ".join(scene.notes), extra)


def _path_trace(scene: Scene, place: int, kind: str, moving: bool) -> dict[str, Any]:
    path = scene.paths[place]
    points = scene.at(0, 0.0) if moving else scene.rest
    chain = np.array(path.points)
    line = np.where((chain < 0)[:, None], np.nan, points[chain])
    colour = palette.VERMILLION if moving else (palette.RIGID if path.is_measured else palette.FAINT)
    name = path.name if scene.is_row else ("deflected" if moving else f"at rest, {path.name}")
    dots = scene.is_row or kind == "scatter"
    marker: dict[str, Any] = {"symbol": _SYMBOLS[place % len(_SYMBOLS)] if scene.is_row else "circle"}
    trace: dict[str, Any] = {
        "type": kind, "mode": "lines+markers", "name": name, "connectgaps": False,
        "line": {"color": colour, "width": 4 if moving and kind == "scatter3d" else 2},
        "marker": marker | {"size": (8 if moving else 5) if dots else (4 if moving else 3), "color": colour},
        "text": ["" if i < 0 else clean(scene.labels[i]) for i in path.points], "hovertemplate": "%{text}<extra></extra>",
        "showlegend": moving if scene.is_row else True,
    }  # fmt: skip
    if moving and scene.is_row:
        trace["line"] |= {"dash": ("solid", "dash", "dot")[place % 3]}
    return trace | dict(zip("xyz", ([*numbers(column)] for column in line.T), strict=False))


def _row_layout(scene: Scene) -> dict[str, Any]:
    ticks = {"tickvals": list(range(len(scene.ticks))), "ticktext": list(scene.ticks)} if len(scene.ticks) <= 40 else {}
    return {
        "xaxis": axis(scene.axes[0]) | ticks | {"range": [-0.4, len(scene.ticks) - 0.6]},
        "yaxis": axis(scene.axes[1]) | {"range": [-1.15, 1.15]},
    }


def _space_layout(scene: Scene) -> dict[str, Any]:
    """Axes of equal scale that hold every mode at every phase."""
    reach = np.abs(scene.motion).max(axis=0)
    low, high = (scene.rest - reach).min(axis=0), (scene.rest + reach).max(axis=0)
    pad = 0.04 * float(np.max(high - low))
    ranges = [[float(a - pad), float(b + pad)] for a, b in zip(low, high, strict=True)]
    if len(ranges) == 2:
        return {
            "xaxis": axis(scene.axes[0]) | {"range": ranges[0]},
            "yaxis": axis(scene.axes[1]) | {"range": ranges[1], "scaleanchor": "x"},
        }
    names = ("xaxis", "yaxis", "zaxis")
    scenes: dict[str, Any] = {
        name: {"title": {"text": text}, "range": r, "backgroundcolor": "white", "gridcolor": palette.GRID}
        for name, text, r in zip(names, scene.axes, ranges, strict=True)
    }
    turn, tilt = np.radians(AZIMUTH), np.radians(ELEVATION)
    eye = 1.8 * np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    spans = np.array([b - a for a, b in ranges])
    ratio = dict(zip("xyz", numbers(spans / spans.max(), 4), strict=True))
    scenes |= {
        "aspectmode": "manual",
        "aspectratio": ratio,
        "camera": {"eye": dict(zip("xyz", numbers(eye, 4), strict=True)), "center": {"x": 0, "y": 0, "z": -0.08}},
    }
    return {"scene": scenes, "margin": {"l": 0, "r": 0, "t": 40, "b": 0}}

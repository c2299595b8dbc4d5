"""The structure on the page: one figure for each of mass, stiffness and damping."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from structid.report.drawing import palette, symbols
from structid.report.drawing.changes import Look, Panel, look
from structid.report.drawing.picture import Arrow, Mark, Picture
from structid.report.figures.interactive_base import Figure, axis, base_layout, clean, numbers

_EDGE = "#333333"
_DASH = "7px,4px"
#: Changes of colour from the far faces of a mesh to the near ones, up to which each gets a trace of its own.
_MOST_RUNS = 300
_ROLES = {"load": palette.LOAD, "sensor": palette.SENSOR, "node": palette.MUTED, "element": palette.INK}


def structure_figures(drawn: Picture) -> dict[str, Figure]:
    """One figure a panel, by the name ``structure-mass`` and so on; ``structure`` where there is no panel."""
    shown: Sequence[Panel | None] = drawn.panels or (None,)
    return {f"structure-{p.name}" if p else "structure": _figure(drawn, p) for p in shown}


def _figure(drawn: Picture, panel: Panel | None) -> Figure:
    traces = [
        _line(drawn.links, palette.RIGID, 1.4, "5px,4px"),
        _line(drawn.grounds, palette.SUPPORT, 1.3),
        *(_area(symbols.joined(drawn.supports), palette.SUPPORT) for _ in drawn.supports[:1]),
        *_mark_traces(drawn.marks, panel),
        *_arrow_traces(drawn.sensors, palette.SENSOR, 2.0, "sensor"),
        *_arrow_traces(drawn.loads, palette.LOAD, 3.2, "load"),
        _line(symbols.joined(path for _, path in drawn.axes), palette.MUTED, 1.5),
        _points(drawn.nodes, drawn.node_texts, 4, _EDGE),
        *_hover(drawn.marks, panel),
        *([_scale(panel)] if panel else []),
    ]
    width = 960 if drawn.is_wide else 430
    layout = base_layout(int(np.clip(width / drawn.aspect + 50, 230, 640)))
    layout |= {"showlegend": False, "margin": {"l": 10, "r": 95, "t": 34, "b": 10}}
    hidden = {"visible": False}
    left, right, bottom, top = drawn.bounds
    layout["xaxis"] = axis("") | hidden | {"range": [left, right]}
    layout["yaxis"] = axis("") | hidden | {"range": [bottom, top], "scaleanchor": "x"}
    layout["annotations"] = _annotations(drawn)
    if panel:
        layout["title"] = {"text": f"Change of {panel.name} parameters", "font": {"size": 14}, "x": 0.01}
    return Figure(traces, layout, "")


def _annotations(drawn: Picture) -> list[dict[str, Any]]:
    found = [_text(label.text, label.at, _ROLES[label.role]) for label in drawn.labels]
    return found + [_text(name, path[1] + 0.35 * (path[1] - path[0]), palette.MUTED) for name, path in drawn.axes]


def _text(text: str, at: np.ndarray, colour: str) -> dict[str, Any]:
    x, y = numbers(at)
    return {"text": clean(text), "x": x, "y": y, "showarrow": False, "font": {"size": 9.5, "color": colour}}


def _line(path: np.ndarray, colour: str, width: float, dash: str = "solid") -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "x": numbers(path[:, 0]), "y": numbers(path[:, 1]),
        "line": {"color": colour, "width": width, "dash": dash}, "hoverinfo": "skip",
    }  # fmt: skip


def _area(path: np.ndarray, colour: str, hatched: bool = False, edge: str = "") -> dict[str, Any]:
    found = _line(path, edge or colour, 1.0) | {"fill": "toself", "fillcolor": colour}
    if hatched:
        found["fillpattern"] = {"shape": "/", "fgcolor": _EDGE, "bgcolor": colour, "size": 6, "solidity": 0.25}
    return found


def _points(points: np.ndarray, texts: Sequence[str], size: float, colour: str) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "markers", "x": numbers(points[:, 0]), "y": numbers(points[:, 1]),
        "marker": {"size": size, "color": colour}, "text": [clean(t) for t in texts],
        "hovertemplate": "%{text}<extra></extra>",
    }  # fmt: skip


def _mark_traces(marks: Iterable[Mark], panel: Panel | None) -> list[dict[str, Any]]:
    """All elements of one look as one trace: faces of a mesh below, far ones first, then lines, then other areas."""
    looks = [(mark, look(panel, mark.element, mark.index)) for mark in marks]
    changes = sum(a[1] != b[1] for a, b in pairwise(looks) if b[0].nodes)
    in_depth = changes <= _MOST_RUNS  # else one trace for each look, so that the page stays small
    groups: dict[tuple[int, int, Look], list[np.ndarray]] = {}
    run, last = 0, None
    for mark, shown in looks:
        run, last = run + int(in_depth and bool(mark.nodes) and shown != last), shown
        layer = 0 if mark.nodes else 2 if mark.filled else 1
        groups.setdefault((layer, run if mark.nodes else 0, shown), []).append(mark.path)
    traces = []
    for (layer, _, shown), paths in sorted(groups.items(), key=lambda item: item[0][:2]):
        filled = layer != 1
        path = symbols.joined(paths)
        if filled:
            traces.append(_area(path, shown.colour, shown.is_doubtful, _EDGE))
            continue
        dash = _DASH if shown.is_doubtful else "solid"
        if shown.is_unknown:
            traces.append(_line(path, _EDGE, 6.0, dash))
        traces.append(_line(path, shown.colour, 4.0 if shown.is_unknown else 2.0, dash))
    return traces


def _arrow_traces(arrows: Sequence[Arrow], colour: str, width: float, noun: str) -> list[dict[str, Any]]:
    if not arrows:
        return []
    heads = symbols.joined(head for arrow in arrows for head in arrow.heads)
    tips = np.array([arrow.tip for arrow in arrows])
    texts = [f"{noun} {arrow.dof}" for arrow in arrows]
    shafts = symbols.joined(arrow.shaft for arrow in arrows)
    return [_line(shafts, colour, width), _area(heads, colour), _points(tips, texts, 6, "rgba(0,0,0,0)")]


def _hover(marks: Sequence[Mark], panel: Panel | None) -> list[dict[str, Any]]:
    """Invisible points in the middle of the elements, with what became of them."""
    if not marks:
        return []
    texts = []
    for mark in marks:
        change = panel.changes.get((mark.element, mark.index)) if panel else None
        texts.append(f"{mark.label}: {change.text}" if change else mark.label)
    found = _points(np.array([m.centre for m in marks]), texts, 12, "rgba(0,0,0,0)")
    found["text"] = [t.replace("\n", "<br>") for t in found["text"]]
    return [found]


def _scale(panel: Panel) -> dict[str, Any]:
    """A trace that draws nothing but the colour bar."""
    title = "relative change (or beyond)" if panel.is_exceeded else "relative change"
    bar = {
        "title": {"text": title, "side": "right", "font": {"size": 12}},
        "tickvals": [value for value, _ in panel.ticks], "ticktext": [text for _, text in panel.ticks],
        "len": 1.0, "thickness": 14,
    }  # fmt: skip
    marker = {
        "color": [0], "cmin": -panel.limit, "cmax": panel.limit, "showscale": True, "colorbar": bar,
        "colorscale": palette.plotly_scale(palette.DIVERGING),
    }  # fmt: skip
    return {"type": "scatter", "mode": "markers", "x": [None], "y": [None], "marker": marker, "hoverinfo": "skip"}

"""The structure: elements in the colours of what became of them, sensors, loads, supports and names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.report.drawing import palette, symbols
from structid.report.drawing.changes import ElementStyle, Shading, element_style
from structid.report.drawing.drawing import MOST_INCHES, PANEL_INCHES, WIDE_INCHES
from structid.report.drawing.picture import Mark, Picture, curve, points
from structid.report.rendering import plot

_EDGE = "#333333"
#: Changes of colour from the far faces of a mesh to the near ones, up to which their order is kept whole.
_MOST_RUNS = 300
#: Slices of a mesh, from far to near, that keep their order where there are more.
_SLICES = 12
#: Marks that answer to the mouse at most; faces that have an edge, and a strong one.
_MOST_HOVER, _MOST_EDGED, _MOST_STRONG = 3000, 6000, 1500
_CAPTION = (
    "Coloured: change of the parameter beyond its 95 % interval; the colour of 0: within it. Dashed or hatched: not identified."
    " Grey: not a parameter of this kind. Arrows point in the positive sense."
)


def structure_figure(
    picture: Picture, shadings: Sequence[Shading] = (), title: str = "", caption: str = ""
) -> plot.Figure:
    """Figure of a structure, one panel for each shading, or one plain panel with `title` if there is none.

    `title` is not used with shadings. An empty `caption` gives the usual one.
    """
    left, right, bottom, top = picture.bounds
    x, y = plot.Axis(limits=(left, right)), plot.Axis(limits=(bottom, top))
    panels = tuple(
        replace(plot.panel(x, y, *_traces(picture, shade), title=name, scale=scale), equal=True, bare=True)
        for shade, name, scale in _headed(shadings, title)
    )
    inches, beside = (WIDE_INCHES, 1.4) if picture.is_wide else (PANEL_INCHES, 0.9)
    size = (
        100 * (inches + (beside if shadings else 0.0)),
        float(np.clip(100 * inches / picture.aspect + 60, 240, 100 * MOST_INCHES)),
    )
    columns = 1 if picture.is_wide else len(panels)
    return plot.Figure(
        panels, size, columns, caption or (_CAPTION if shadings else "Arrows point in the positive sense.")
    )


def _headed(shadings: Sequence[Shading], title: str) -> list[tuple[Shading | None, str, plot.ColourScale | None]]:
    return [(shade, shade.title, shade.scale) for shade in shadings] or [(None, title, None)]


def _traces(picture: Picture, shade: Shading | None) -> Iterator[plot.Trace]:
    """Yield the plot traces of a structure's drawing from back to front; without `shade` the elements have a plain colour."""
    yield from picture.behind
    yield from _marks(picture.marks, shade)
    yield from picture.before
    if shade:
        yield curve(_region(picture.marks, shade), plot.Pen(palette.INK, 2.2), "round changes beyond chance")
    answering = picture.marks if len(picture.marks) <= _MOST_HOVER else ()
    yield points(np.array([mark.centre for mark in answering]).reshape(-1, 2), _words(answering, shade))


def _marks(marks: Sequence[Mark], shade: Shading | None) -> Iterator[plot.Trace]:
    """Yield plot traces that draw all elements, one for each appearance: cell faces, then lines, then other areas.

    `marks` are in drawing order; faces keep it, from far to near, but with more than 300 changes of colour only by 12
    slices. None for `shade` draws all elements in grey.
    """
    styled = [(mark, element_style(shade, mark.element, mark.index)) for mark in marks]
    changes = sum(a[1] != b[1] for a, b in pairwise(styled) if b[0].nodes)
    groups: dict[tuple[int, int, ElementStyle], list[FloatArray]] = {}
    run, last = 0, None
    for k, (mark, shown) in enumerate(styled):
        run, last = run + int(bool(mark.nodes) and shown != last), shown
        depth = run if changes <= _MOST_RUNS else k * _SLICES // len(styled)
        layer = 0 if mark.nodes else 2 if mark.filled else 1
        groups.setdefault((layer, depth if mark.nodes else 0, shown), []).append(mark.path)
    strong = len(marks) <= _MOST_STRONG
    for (layer, _, shown), paths in sorted(groups.items(), key=lambda item: item[0][:2]):
        path, doubtful = symbols.joined(paths), shown.is_doubtful
        label = "not a parameter of this kind" if shade and not shown.is_unknown else "not identified" * doubtful
        if layer != 1:
            edge = plot.Pen(_EDGE, 1.1 if strong else 0.4) if len(marks) <= _MOST_EDGED else plot.Pen(shown.colour, 0.4)
            yield plot.Area(path[:, 0], path[:, 1], shown.colour, label=label, edge=edge, hatched=doubtful)
            continue
        dash: Literal["solid", "dash"] = "dash" if doubtful else "solid"
        if shown.is_unknown:
            yield curve(path, plot.Pen(_EDGE, 6.0, dash), label)
        yield curve(path, plot.Pen(shown.colour, 4.2 if shown.is_unknown else 2.0, dash), label)


def _region(marks: Sequence[Mark], shade: Shading) -> FloatArray:
    """Boundary of the faces outlined in `shade` as a path (n, 2) with NaN between lines.

    It has the sides that belong to one outlined face only; (0, 2) if no face is outlined.
    """
    lines_of_side: dict[tuple[int, int], list[FloatArray]] = {}
    for mark in marks:
        if (mark.element, mark.index) in shade.outlined:
            for k, node in enumerate(mark.nodes):
                other = mark.nodes[k - 1]
                lines_of_side.setdefault((min(node, other), max(node, other)), []).append(mark.outline[[k - 1, k]])
    return symbols.joined(sides[0] for sides in lines_of_side.values() if len(sides) == 1)


def _words(marks: Sequence[Mark], shade: Shading | None) -> tuple[str, ...]:
    """Hover text of each mark: its label, and the change of its element if `shade` has any."""
    changes = ((mark, shade.changes.get((mark.element, mark.index)) if shade else None) for mark in marks)
    return tuple(f"{mark.label}: {change.text}" if change else mark.label for mark, change in changes)

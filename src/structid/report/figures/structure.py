"""The structure: elements in the colours of their relative changes by kind of property, sensors, loads, supports and names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from structid.core.arrays import FloatArray
from structid.core.display import exact, percent, with_unit
from structid.fem import Structure
from structid.fem.contribution import Property
from structid.identification.identified import Identification
from structid.report.drawing import palette, symbols
from structid.report.drawing.drawing import MOST_INCHES, PANEL_INCHES, WIDE_INCHES
from structid.report.drawing.picture import Mark, Picture, curve, points
from structid.report.rendering import plot
from structid.unknowns import Parameters

#: Shadings of a structure, and the kinds of property that each shows.
KINDS: dict[str, tuple[str, ...]] = {
    "mass": ("mass", "rotary_inertia"),
    "stiffness": ("stiffness",),
    "axial force": ("axial_force",),
    "damping": ("viscous_damping", "loss_factor", "friction"),
    "thickness": ("thickness",),
}
_LIMITS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class Change:
    """Change of one element: the largest relative change among its parameters, and a text on each of them.

    `identified` is True if the data determine all of these parameters, `is_significant` if the interval of one of them
    leaves its initial value out.
    """

    ratio: float
    identified: bool
    text: str
    is_significant: bool = True


#: By element set and index.
Changes = dict[tuple[str, int], Change]


@dataclass(frozen=True, eq=False)
class Shading:
    """Colours of the elements in one drawing of the structure.

    Attributes
    ----------
    title : str
    changes : mapping of (element set, index) to Change
        Only elements that have a colour.
    scale : ColourScale
    outlined : frozenset of (element set, index)
        Elements with a line round the region that they make up.
    """

    title: str
    changes: Changes
    scale: plot.ColourScale
    outlined: frozenset[tuple[str, int]] = frozenset()


@dataclass(frozen=True)
class ElementStyle:
    """Appearance of a drawn element: its colour, whether it is shaded, and whether its change is in doubt."""

    colour: str = palette.KNOWN
    is_unknown: bool = False
    is_doubtful: bool = False


def element_style(shading: Shading | None, element: str, index: int) -> ElementStyle:
    """Colour and style of one element: the one of row `index` in the element set named `element`.

    Grey if `shading` is None or has no value for it. An identified change within its 95 % interval has the colour of 0;
    one that is not identified is marked as doubtful.
    """
    change = shading.changes.get((element, index)) if shading else None
    if shading is None or change is None:
        return ElementStyle()
    ratio = change.ratio if change.is_significant or not change.identified else 0.0
    return ElementStyle(shading.scale.colour(ratio), True, not change.identified)


def shading(title: str, changes: Changes, limit: float) -> Shading:
    """Shading called `title` of elements by relative `changes` on a diverging colour scale, white at 0.

    The scale runs from -`limit` to `limit`, a fraction, as are the changes; larger changes have the end colours.
    """
    ticks = [part * limit for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    texts = tuple((value, f"{'+' if value > 0 else ''}{exact(100 * value, 3)} %") for value in ticks)
    exceeded = any(abs(change.ratio) > limit for change in changes.values())
    scale = plot.ColourScale(palette.DIVERGING, -limit, limit, "relative change", texts, is_exceeded=exceeded)
    return Shading(title, changes, scale)


def round_limit(ratios: Iterable[float], least: float = 0.05) -> float:
    """Round number for the ends of a colour scale: the smallest of 0.02, 0.05, 0.1, 0.2, 0.3, 0.5 and 1 that holds `ratios`.

    At least `least`; at most 1, even if a ratio is larger.
    """
    largest = max((abs(r) for r in ratios if np.isfinite(r)), default=0.0)
    return next((step for step in _LIMITS if max(largest, least) <= step), 1.0)


def properties_of(structure: Structure, kinds: tuple[str, ...]) -> Iterator[Property]:
    """Properties of `structure` of the given kinds."""
    return (item for item in structure.properties if item.term.kind in kinds)


def elements_of(item: Property, design: csr_array) -> Iterator[tuple[tuple[str, int], int, np.ndarray]]:
    """Yield key, index and parameters of each element of the property `item` on which a parameter acts.

    The key is (element set, row in it, from 0); the index is that of its value among all properties, which is its row
    in `design` (n_values, n_params). The parameters are an int array of the columns that are not 0 in this row.
    """
    for row, index in enumerate(range(item.values.start, item.values.stop)):
        columns = design.indices[design.indptr[index] : design.indptr[index + 1]]
        if len(columns):
            yield (item.element, row), index, columns


@dataclass(frozen=True, eq=False)
class IdentifiedParameters:
    """Initial and identified values of the parameters of a structure.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    initial, values : (n_params,) float array
    identified : (n_params,) bool array
    intervals : (n_params, 2) float array
        95 % intervals.
    """

    structure: Structure
    parameters: Parameters
    initial: FloatArray
    values: FloatArray
    identified: NDArray[np.bool_]
    intervals: FloatArray


def shadings(identification: Identification) -> tuple[Shading, ...]:
    """Shadings of an identification's relative parameter changes, one for each kind of property that has parameters."""
    found, own = identification.estimate, identification.own_index
    return parameter_shadings(
        IdentifiedParameters(
            identification.structure,
            identification.parameters,
            found.initial[own],
            found.values[own],
            found.identified[own],
            identification.intervals.ends[own],
        )
    )


def parameter_shadings(answer: IdentifiedParameters) -> tuple[Shading, ...]:
    """Shadings of relative parameter changes, one for each kind of property in `KINDS` that has parameters.

    They are in the order of `KINDS`. The colour scale ends at a round value that holds the significant changes.
    `answer` has the structure and its parameters, initial and identified values.
    """
    shadings = []
    for name, kinds in KINDS.items():
        changes = _changes(answer, kinds)
        if changes:
            limit = round_limit(c.ratio for c in changes.values() if c.identified and c.is_significant)
            shadings.append(shading(f"Change of {name} parameters", changes, limit))
    return tuple(shadings)


def _changes(answer: IdentifiedParameters, kinds: tuple[str, ...]) -> Changes:
    """Relative change of each element in its properties of these `kinds`, by (element set, row).

    Elements without parameters are left out. Of several properties the largest change counts, significant ones (beyond
    the 95 % interval) first, and all texts are joined; the change is identified if all parameters are. NaN where the
    initial value is 0. `answer` has the structure and its parameters, initial and identified values and intervals.
    """
    before, after = answer.parameters.values(answer.initial), answer.parameters.values(answer.values)
    design = answer.parameters.design.tocsr()
    is_outside = (answer.initial < answer.intervals[:, 0]) | (answer.initial > answer.intervals[:, 1])
    changes: Changes = {}
    for item in properties_of(answer.structure, kinds):
        for key, index, columns in elements_of(item, design):
            ratio = float(after[index] / before[index] - 1) if before[index] else np.nan
            values = f"{exact(float(before[index]))} to {with_unit(exact(float(after[index])), item.term.unit)}"
            identified = bool(answer.identified[columns].all())
            text = f"{item.term.property.replace('_', ' ')}: {values} ({percent(ratio)})"
            is_significant = bool(is_outside[columns].any())
            text += ", not identified" if not identified else "" if is_significant else ", within its interval"
            changes[key] = _merge_changes(changes.get(key), Change(ratio, identified, text, is_significant))
    return changes


def _merge_changes(first: Change | None, second: Change) -> Change:
    """Combined change of one element: the larger of both by magnitude, significant ones before others, with both texts.

    The first counts if they are equal. The texts are on two lines. Identified only if both are; `second` if `first` is
    None.
    """
    if first is None:
        return second
    larger = max((first, second), key=lambda one: (one.is_significant, abs(np.nan_to_num(one.ratio))))
    text = f"{first.text}\n{second.text}"
    return Change(larger.ratio, first.identified and second.identified, text, larger.is_significant)


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

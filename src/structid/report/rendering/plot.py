"""Figures as data: what stands on which axes, in which colours, with which words.

Renderers (`browser` for pages, `png` for files) draw it and compute nothing. Lengths are in pixels of the page; a picture
has 100 of them in an inch. Later traces cover earlier ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import unit_text
from structid.report.drawing import palette

#: Where the viewer of three dimensions stands: azimuth and elevation, degrees.
VIEW = (-55.0, 22.0)
#: Texts of points that show their coordinates to the reader who points at them.
NUMBERS: tuple[str, ...] = ()
#: Rows and columns of a matrix at most whose cells show their values.
MOST_WRITTEN = 16
Ticks = tuple[tuple[float, str], ...]
Limits = tuple[float, float]


class Canvas(Protocol):
    """A renderer: one method for each kind of trace."""

    def curve(self, trace: Curve) -> None: ...
    def area(self, trace: Area) -> None: ...
    def heat_map(self, trace: HeatMap) -> None: ...
    def texts(self, trace: Texts) -> None: ...


class Trace(Protocol):
    """A part of a figure that knows how it is drawn; traces of one `label` are one entry of the legend."""

    @property
    def label(self) -> str: ...
    @property
    def x(self) -> FloatArray: ...
    def draw(self, canvas: Canvas) -> None: ...


@dataclass(frozen=True)
class Pen:
    """Colour, width in pixels and dashes of a line."""

    colour: str
    width: float = 1.4
    dash: Literal["solid", "dash", "dot"] = "solid"


@dataclass(frozen=True)
class Marker:
    """A sign at a point: a symbol of Plotly's names, `size` pixels wide; an empty colour leaves it open."""

    symbol: str = "circle"
    size: float = 8.0
    colour: str = palette.INK
    edge: Pen | None = None


#: No sign at all, for points that only answer to the mouse.
UNSEEN = Marker(size=12.0, colour="")


@dataclass(frozen=True, eq=False)
class Curve:
    """Points of a plane or of space; NaN lifts the pen.

    Attributes
    ----------
    x, y : (n,) float arrays
    pen : Pen, optional
        None leaves the points apart.
    marker : Marker, optional
    label : str
    hover : tuple of str, optional
        A text for each point; `NUMBERS`; None for points that keep silent.
    z : (n,) float array, optional
        Where the panel is in space.
    sway : (n, n_axes) complex array, optional
        The point moves by the real part of ``sway * exp(1j * phase)``; a picture shows phases 0 and pi.
    right : bool
        Whether `y` is read on the axis on the right.
    """

    x: FloatArray
    y: FloatArray
    pen: Pen | None = None
    marker: Marker | None = None
    label: str = ""
    hover: tuple[str, ...] | None = None
    z: FloatArray | None = None
    sway: ComplexArray | None = None
    right: bool = False

    def draw(self, canvas: Canvas) -> None:
        """Draw the trace as a curve."""
        canvas.curve(self)

    def at(self, phase: float | None = None) -> tuple[FloatArray, ...]:
        """Coordinates of the curve, one array (n,) for each of two or three axes, at rest or, if it sways, at `phase` (rad)."""
        coordinates = (self.x, self.y) if self.z is None else (self.x, self.y, self.z)
        if self.sway is None or phase is None:
            return coordinates
        moved = (self.sway * np.exp(1j * phase)).real
        return tuple(coordinate + moved[:, axis] for axis, coordinate in enumerate(coordinates))


@dataclass(frozen=True, eq=False)
class Area:
    """Closed outlines with NaN between them, filled; `x` and `y` are (n,), and `label` is "" for no legend entry."""

    x: FloatArray
    y: FloatArray
    colour: str
    opacity: float = 1.0
    label: str = ""
    edge: Pen | None = None
    hatched: bool = False

    def draw(self, canvas: Canvas) -> None:
        """Draw the trace as a filled area."""
        canvas.area(self)


@dataclass(frozen=True, eq=False)
class HeatMap:
    """Values in cells.

    Attributes
    ----------
    x, y : (n_columns + 1,), (n_rows + 1,) float arrays
        Edges of the cells.
    values : (n_rows, n_columns) float array
        NaN where there is no cell.
    rows, columns : tuple of str
        Their names, for the reader who points at a cell; without `columns` it is told the place on the axis.
    written : bool
        Whether each cell shows its value, to two decimals.
    """

    x: FloatArray
    y: FloatArray
    values: FloatArray
    rows: tuple[str, ...]
    columns: tuple[str, ...] = ()
    written: bool = False
    label: str = ""

    def draw(self, canvas: Canvas) -> None:
        """Draw the trace as a heat map."""
        canvas.heat_map(self)


@dataclass(frozen=True, eq=False)
class Texts:
    """Words at points; `side` is where they stand from there, as in ``top right``.

    `x` and `y` are (n,), one for each of the `words`; `size` is that of the font in pixels.
    """

    x: FloatArray
    y: FloatArray
    words: tuple[str, ...]
    colour: str = palette.INK
    size: float = 11.0
    side: str = "middle center"
    label: str = ""

    def draw(self, canvas: Canvas) -> None:
        """Draw the trace as texts at points."""
        canvas.texts(self)


@dataclass(frozen=True)
class ColourScale:
    """A colour scale of `palette.SCALES` over a range of values, with a bar beside the panel.

    Without `ticks` the renderer chooses them; `is_exceeded` tells that some values lie beyond the ends `low` and `high`.
    """

    colours: str
    low: float
    high: float
    label: str
    ticks: Ticks = ()
    log: bool = False
    is_exceeded: bool = False

    def colour(self, value: float) -> str:
        """Colour of the step of the scale nearest to `value`: the end colour beyond an end, the middle colour for NaN."""
        fraction = 0.5 if np.isnan(value) else min(max((value - self.low) / (self.high - self.low), 0.0), 1.0)
        steps = palette.steps(self.colours)
        return steps[round(fraction * (len(steps) - 1))]


@dataclass(frozen=True)
class Axis:
    """A scale of positions; limits and ticks that are not given are what the traces need.

    The first of `limits` is at the left or below. `ticks` are values and texts.
    """

    label: str = ""
    unit: str = ""
    limits: Limits | None = None
    log: bool = False
    ticks: Ticks = ()
    grid: bool = True

    @property
    def title(self) -> str:
        """Title of the axis with its unit in brackets and raised powers."""
        unit = self.unit if self.unit == "1" else unit_text(self.unit)
        return f"{unit_text(self.label)} ({unit})" if unit else unit_text(self.label)


@dataclass(frozen=True, eq=False)
class Strip:
    """Traces over one vertical axis, and one on the right for some of them.

    `weight` is the height in parts of the other strips of the panel, `name` that of the picture of this strip alone.
    """

    y: Axis
    traces: tuple[Trace, ...]
    weight: float = 1.0
    right: Axis | None = None
    name: str = ""


@dataclass(frozen=True, eq=False)
class Panel:
    """Strips above each other on one horizontal axis.

    Attributes
    ----------
    x : Axis
    strips : tuple of Strip
    title : str
        Above the panel.
    name : str
        Short: in the list to choose from, and in small pictures.
    scale : ColourScale, optional
        Of heat maps, and for the bar beside a drawing.
    z : Axis, optional
        Where the panel shows space.
    equal, bare : bool
        Whether a unit is as long on both axes; whether the axes are left out.
    background : str
    """

    x: Axis
    strips: tuple[Strip, ...]
    title: str = ""
    name: str = ""
    scale: ColourScale | None = None
    z: Axis | None = None
    equal: bool = False
    bare: bool = False
    background: str = "white"

    @property
    def traces(self) -> Iterator[Trace]:
        """Traces of all strips, from the first strip to the last."""
        return (trace for strip in self.strips for trace in strip.traces)


#: Modes that have a panel of their own in a `Choice` at most.
MOST_PANELS = 24


@dataclass(frozen=True)
class Choice:
    """One panel at a time on a page, chosen from a list under `label`; a picture shows those `shown`, small.

    Each of those is `size` wide and high, with `note` below them. What `moves` the reader can set in motion.
    """

    label: str
    shown: tuple[int, ...]
    size: tuple[float, float]
    note: str = ""
    moves: bool = False


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels in a grid of at most so many `columns`, or one of them at a time.

    `size` is width and height of a panel; on a page it is as wide as there is room.
    """

    panels: tuple[Panel, ...]
    size: tuple[float, float]
    columns: int = 1
    caption: str = ""
    choice: Choice | None = None

    @property
    def legend(self) -> tuple[Trace, ...]:
        """Traces for the legend: the first one of each label that is not ""."""
        first: dict[str, Trace] = {}
        for panel in self.panels:
            for trace in panel.traces:
                first.setdefault(trace.label, trace)
        return tuple(trace for label, trace in first.items() if label)

    def strip(self, number: int) -> Figure:
        """Copy of the figure with only strip `number` of each panel."""
        return replace(self, panels=tuple(replace(panel, strips=(panel.strips[number],)) for panel in self.panels))


def panel(x: Axis, y: Axis, *traces: Trace, title: str = "", scale: ColourScale | None = None) -> Panel:
    """Plot panel of one strip over axis `x` with axis `y` and those of `traces` that have points.

    `title` heads the panel and names it; `scale` is drawn beside it, if any.
    """
    return Panel(x, (Strip(y, tuple(trace for trace in traces if len(trace.x))),), title, title, scale)


def matrix_panel(
    matrix: FloatArray,
    rows: Sequence[str],
    label: str,
    scale: ColourScale,
    columns: Sequence[str] = (),
    across: str = "",
) -> Panel:
    """Heat map panel of a matrix (n_rows, n_columns) with a name for every row and column, first row on top.

    `rows` and `columns` are the names, `label` and `across` the titles of the axes of rows and columns. Without
    `columns` the matrix is square, with the names and title of the rows on both axes. Values are written into the
    cells, to two decimals, if there are at most 16 rows and columns.
    """
    names = tuple(columns) or tuple(rows)
    n, m = len(rows), len(names)
    cells = HeatMap(
        np.arange(m + 1) - 0.5, np.arange(n + 1) - 0.5, matrix, tuple(rows), names, max(n, m) <= MOST_WRITTEN
    )
    x = Axis(across or label, limits=(-0.5, m - 0.5), ticks=named_ticks(names), grid=False)
    y = Axis(label, limits=(n - 0.5, -0.5), ticks=named_ticks(tuple(rows)), grid=False)
    return replace(panel(x, y, cells, scale=scale), equal=True)


def segments(ends: Sequence[ArrayLike], heights: Sequence[ArrayLike], pen: Pen, label: str = "") -> Curve:
    """A curve of separate lines from (``ends[0]``, ``heights[0]``) to (``ends[1]``, ``heights[1]``).

    Each of the four is an array (n,) or a number for all lines.
    """
    x0, x1, y0, y1 = np.broadcast_arrays(*map(np.atleast_1d, (*ends, *heights)))
    return Curve(_lines(x0, x1), _lines(y0, y1), pen, label=label)


def boxes(
    ends: Sequence[ArrayLike], heights: Sequence[ArrayLike], colour: str, label: str = "", opacity: float = 1.0
) -> Area:
    """An area of rectangles from ``ends[0]`` to ``ends[1]`` along x and from ``heights[0]`` to ``heights[1]`` along y.

    Each of the four is an array (n,) or a number for all rectangles.
    """
    x0, x1, y0, y1 = np.broadcast_arrays(*map(np.atleast_1d, (*ends, *heights)))
    return Area(_lines(x0, x1, x1, x0, x0), _lines(y0, y0, y1, y1, y0), colour, opacity, label)


def _lines(*points: FloatArray) -> FloatArray:
    """One coordinate of n lines, (n (m + 1),), from those of their m `points`, (n,) each, with NaN after each line."""
    return np.column_stack([*points, np.full(len(points[0]), np.nan)]).ravel()


def rows_axis(names: Sequence[str]) -> Axis:
    """`names` one below the other at 0, 1, ..."""
    return Axis(limits=(len(names) - 0.4, -0.6), ticks=named_ticks(names, len(names)))


def rows_size(count: int) -> tuple[float, float]:
    """Width and height in pixels of a panel with `count` rows."""
    return 1050.0, 130.0 + (25.0 if count <= 40 else 18.0) * count


def named_ticks(names: Sequence[str], most: int = 60) -> Ticks:
    """A tick for each of `names` at 0, 1, ...; only every second, third, ... if there are more than `most`."""
    step = max(1, -(-len(names) // most))
    return tuple((float(fraction), names[fraction]) for fraction in range(0, len(names), step))


def whole_ticks(first: int, last: int, most: int = 15) -> Ticks:
    """Ticks at whole numbers from `first` to `last`, in steps of 1, 2 or 5 times a power of ten, about `most` at most."""
    steps = (digit * 10**power for power in range(9) for digit in (1, 2, 5))
    step = next(step for step in steps if (last - first) / step < most)
    return tuple((float(value), str(value)) for value in range(-(-first // step) * step, last + 1, step))


def decade_ticks(low: float, high: float) -> Ticks:
    """Ticks at the powers of ten from `low` to `high`, ends included."""
    powers = range(int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9)) + 1)
    return tuple((10.0**power, f"{10.0**power:g}") for power in powers)


def decade_limits(values: ArrayLike) -> Limits:
    """Limits of a logarithmic axis that hold the positive `values`, with a margin, and span at least 1.2 decades.

    Values that are 0, negative or not finite do not count. Without any other it is centred at 1.
    """
    given = np.ravel(values)
    powers = np.log10(given[np.isfinite(given) & (given > 0)])
    low, high = (float(powers.min()), float(powers.max())) if powers.size else (0.0, 0.0)
    half, middle = max(0.54 * (high - low), 0.6), 0.5 * (low + high)
    return float(10.0 ** (middle - half)), float(10.0 ** (middle + half))

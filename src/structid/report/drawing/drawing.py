"""The structure as flat shapes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import plural
from structid.core.dof import DIRECTIONS, Dof
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.fem.supports import Constraint, RigidLink
from structid.report.drawing import palette, symbols
from structid.report.drawing.picture import (
    Mark,
    Picture,
    cell_faces,
    curve,
    hidden_nodes,
    is_cells,
    is_spatial,
    labelled_marks,
    paper_axes,
    points,
)
from structid.report.rendering import plot

if TYPE_CHECKING:
    from structid.fem.elements.discrete import Connector, PointMass

#: Width that a wide drawing and one panel of several have, in hundreds of pixels of the page, which are inches of a picture.
WIDE_INCHES, PANEL_INCHES = 11.0, 5.6
#: Height of a drawing at most, in the same unit.
MOST_INCHES = 7.0
_CHARACTER_INCHES = (0.068, 0.115)
_MANY_NODES = 40
#: Marks beyond which labels may stand before them.
_MOST_OBSTACLES = 2000
#: Cosine beyond which two directions count as the same.
_IN_THE_WAY = 0.9


@dataclass(frozen=True, eq=False)
class _Frame:
    """Positions (2,) of nodes on paper by label, and the sizes of symbols, in one unit.

    `axes` (3, 2) are the directions of X, Y and Z on paper. `size` is the extent of the drawing, `spacing` the least
    distance of nodes that elements join, `height` half that of connectors and `radius` that of masses.
    """

    structure: Structure
    points: Mapping[int, FloatArray]
    axes: FloatArray
    size: float
    spacing: float
    height: float
    radius: float

    def direction(self, dof: Dof) -> FloatArray:
        """Direction (2,) on paper of the positive sense of `dof`, not of unit length."""
        return self.axes[dof.axis % 3]


def structure_picture(
    structure: Structure, outputs: Sequence[Dof], inputs: Sequence[Dof], is_field: bool = False
) -> Picture:
    """Picture of a structure with arrows for sensors (`outputs`) and loads (`inputs`), supports, axes and labels.

    With `is_field`, which is for cells that show a field, nodes are hidden and nodes and element sets have no names.
    Labels that would cover another are left out, and a note counts them.
    """
    frame, notes = _frame(structure)
    marks, grounds = _marks(frame)
    hidden = frozenset(frame.points) if is_field else hidden_nodes(structure, frame.points, marks)
    sensors = [_arrow(frame, dof, is_load=False) for dof in outputs]
    loads = [_arrow(frame, dof, is_load=True) for dof in inputs]
    foot = min(1.6 * frame.height, max(0.9 * frame.spacing, 0.012 * frame.size))
    held = dict.fromkeys(dof.node for dof in structure.fixed if is_field or dof.node not in hidden)
    supports = symbols.joined(symbols.triangle(frame.points[node], foot) for node in held)
    links = symbols.joined(_links(frame))
    shown = [node for node in frame.points if node not in hidden]
    nodes = np.array([frame.points[node] for node in shown]).reshape(-1, 2)
    shapes = [nodes, grounds, links, supports, *(m.path for m in marks)]
    shapes += [part for arrow in (*sensors, *loads) for part in (arrow.shaft, *arrow.heads)]
    corners = np.concatenate(shapes)
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    is_wide = high[0] - low[0] > 1.8 * (high[1] - low[1])
    across, up = (0.86 * WIDE_INCHES if is_wide else 0.72 * PANEL_INCHES), 0.84 * MOST_INCHES
    per_inch = max((high[0] - low[0]) / across, (high[1] - low[1]) / up)
    character = (_CHARACTER_INCHES[0] * per_inch, _CHARACTER_INCHES[1] * per_inch)
    inside = [m.centre + share * (m.path - m.centre) for m in marks if m.filled for share in (0.35, 0.7)]
    in_the_way = [*shapes[1:], *inside] if len(marks) <= _MOST_OBSTACLES else []
    obstacles = symbols.sampled(symbols.joined(in_the_way), 0.4 * character[1])
    wanted = [*_dof_labels(frame, loads, palette.LOAD), *_dof_labels(frame, sensors, palette.SENSOR)]
    wanted += [] if is_field else _place_labels(frame, shown, marks, {arrow.dof.node for arrow in (*sensors, *loads)})
    placed, lost = place_without_overlap(wanted, character, 0.08 * per_inch, obstacles)
    if lost:
        are = "is" if lost == 1 else "are"
        left = f"{plural(lost, 'label')} that would cover another {are} left out of the drawing"
        notes = (*notes, f"{left}; point at an element to read its name.")
    axes = _axes(frame, low, {dof.direction for dof in (*outputs, *inputs)})
    behind = (
        curve(links, plot.Pen(palette.RIGID, 1.5, "dash"), "rigid link"),
        curve(grounds, plot.Pen(palette.SUPPORT)),
    )
    before: tuple[plot.Trace, ...] = (
        plot.Area(supports[:, 0], supports[:, 1], palette.SUPPORT, label="support"),
        points(nodes, _node_texts(structure, shown), plot.Marker(size=3.5, colour=palette.INK)),
        *_arrow_traces(sensors, palette.SENSOR, 2.0, "sensor"),
        *_arrow_traces(loads, palette.LOAD, 3.2, "load"),
        *(curve(path, plot.Pen(palette.MUTED, 1.6)) for _, path in axes),
        *_text_traces([(name, path[1] + 0.35 * (path[1] - path[0]), palette.MUTED) for name, path in axes], 11.0),
        *_text_traces([(label.text, at, label.colour) for label, at in placed], 9.5),
    )
    bounds = _bounds(corners, [(label.text, at) for label, at in placed], [path for _, path in axes], per_inch)
    return Picture(behind, marks, before, bounds, notes)


def _text_traces(words: Sequence[tuple[str, FloatArray, str]], size: float) -> list[plot.Texts]:
    """Text traces of the triples `words` (text, position, colour) with the font size `size`, one trace for each colour."""
    traces = []
    for colour in dict.fromkeys(colour for *_, colour in words):
        texts, places = zip(*((text, at) for text, at, own in words if own == colour), strict=True)
        traces.append(
            plot.Texts(np.array([at[0] for at in places]), np.array([at[1] for at in places]), texts, colour, size)
        )
    return traces


def _frame(structure: Structure) -> tuple[_Frame, tuple[str, ...]]:
    """Node positions on paper and symbol sizes for drawing a structure, and notes for the reader.

    Nodes that all have the same position are drawn in a row, with a note.
    """
    axes = paper_axes(structure)
    table = np.array(list(structure.nodes.values()))
    flat = table @ axes[: structure.dimension]
    notes: tuple[str, ...] = ()
    if float(np.ptp(table, axis=0).max()) == 0 and len(table) > 1:
        flat = np.column_stack([np.arange(len(table), dtype=float), np.zeros(len(table))])
        notes = ("All nodes are at one place, so they are drawn in a row.",)
    size = float(np.ptp(flat, axis=0).max()) or 1.0
    points = dict(zip(structure.nodes, flat, strict=True))
    connectors = [e for e in structure.elements if _is_connector(e)]
    areas = [e for e in structure.elements if not (_is_connector(e) or e.is_line)]
    height = np.clip(0.22 * _spacing(points, connectors, size), 0.008 * size, 0.020 * size)
    radius = np.clip(0.32 * _spacing(points, areas, size), 0.008 * size, 0.036 * size)
    spacing = _spacing(points, structure.elements, size)
    return _Frame(structure, points, axes, size, spacing, float(height), float(radius)), notes


def _spacing(points: Mapping[int, FloatArray], elements: Sequence[ElementSet], size: float) -> float:
    """Smallest distance on paper between nodes of `elements` that are apart; `size` if there is none.

    `points` are node positions (2,) on paper, `size` is the extent of the drawing. Of very many nodes a few hundred are
    compared.
    """
    nodes = sorted({int(n) for e in elements for n in np.unique(e.nodes) if n >= 0})
    few = np.array([points[n] for n in nodes[:: max(1, len(nodes) // 400)]]).reshape(-1, 2)
    distance = np.hypot(*(few[:, None] - few[None]).transpose(2, 0, 1))
    apart = distance[distance > 1e-3 * size]
    return float(apart.min()) if apart.size else size


def _is_connector(element: ElementSet) -> TypeGuard[Connector]:
    """True for springs, dashpots and friction contacts, which are drawn between two points."""
    return element.symbol in ("spring", "dashpot", "friction")


def _is_mass(element: ElementSet) -> TypeGuard[PointMass]:
    return element.symbol == "disc"


def _marks(frame: _Frame) -> tuple[tuple[Mark, ...], FloatArray]:
    """Marks of all elements in drawing order, and wall lines (n, 2) of connectors to the ground.

    Cell faces come first, then connectors, lines, and symbols of masses, which cover the lines. Walls have NaN between
    them. `frame` has the node positions on paper and the sizes of symbols.
    """
    sets = frame.structure.elements
    connectors = [(e, k) for e in sets if _is_connector(e) for k in range(len(e.nodes))]
    lines = [(e, k) for e in sets if e.is_line for k in range(len(e.nodes))]
    rest = [e for e in sets if not (_is_connector(e) or e.is_line) and not is_cells(e)]
    heaviest = max((float(e.mass.max()) for e in rest if _is_mass(e)), default=1.0)
    taken: Counter[object] = Counter()
    areas = [(e, k, *_area(frame, e, k, taken, heaviest)) for e in rest for k in range(len(e.nodes))]
    obstacles = _Obstacles(Counter(_pair(e.nodes[k]) for e, k in lines), Counter(), {}, {})
    for element, k, path, centre in areas:
        radius, node = float(np.nanmax(np.hypot(*(path - centre).T))), int(element.nodes[k][0])
        obstacles.clearance[node] = max(obstacles.clearance.get(node, 0.0), radius)
    obstacles.connectors.update(_place_key(e, k) for e, k in connectors if not e.first[k].is_rotation)
    for first, second in (_pair(e.nodes[k]) for e, k in (*connectors, *lines)):
        if first >= 0:
            obstacles.neighbours.setdefault(first, set()).add(second)
            obstacles.neighbours.setdefault(second, set()).add(first)
    shapes = [(e, k, *_connector(frame, e, k, obstacles, taken)) for e, k in connectors]
    marks = [_mark(e, k, path, False, centre) for e, k, path, _, centre in shapes]
    for element, k in lines:
        path = np.array([frame.points[int(n)] for n in element.nodes[k]])
        marks.append(_mark(element, k, path, False, path.mean(axis=0)))
    marks += [_mark(e, k, path, e.symbol != "ring", centre) for e, k, path, centre in areas]
    walls = symbols.joined(wall for *_, wall, _ in shapes if len(wall))
    return (*cell_faces(frame.structure, frame.points), *marks), walls


def _mark(element: ElementSet, index: int, path: FloatArray, filled: bool, centre: FloatArray) -> Mark:
    label = element.name if len(element.nodes) == 1 else f"{element.name}:{index + 1}"
    return Mark(element.name, index, label, path, filled, centre)


def _pair(nodes: Sequence[int]) -> tuple[int, int]:
    return min(int(n) for n in nodes), max(int(n) for n in nodes)


def _place_key(element: Connector, index: int) -> object:
    """Key that the connector `index` shares with parallel ones: its pair of nodes, or node and direction to the ground."""
    first = element.first[index]
    if element.second is None:
        return (first.node, first.direction)
    return _pair((first.node, element.second[index].node))


@dataclass(frozen=True, eq=False)
class _Obstacles:
    """Parts of a drawing that the symbol of a spring, dashpot or friction contact keeps clear of.

    Attributes
    ----------
    lines : Counter
        Number of beams and bars between each pair of nodes.
    connectors : Counter
        Number of connectors that would lie on each other, by the key that `_place_key` gives them.
    neighbours : mapping of int to set of int
        Nodes that an element joins to each node.
    clearance : mapping of int to float
        Radius of what is drawn at a node, in drawing units.
    """

    lines: Counter[tuple[int, int]]
    connectors: Counter[object]
    neighbours: dict[int, set[int]]
    clearance: dict[int, float]


def _connector(
    frame: _Frame, element: Connector, index: int, obstacles: _Obstacles, taken: Counter[object]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Path (n, 2), wall line (n, 2) and centre (2,) of the symbol of a spring, dashpot or friction contact.

    Lengths are in drawing units. `index` is the element's row in its set; `obstacles` decide how far the symbol is
    shifted and to which side the ground lies; `taken` counts the parallel connectors drawn so far, and is increased.
    Only a connector of a translation to the ground has a wall line; others have an empty one. `frame` has the node
    positions on paper and the sizes of symbols.
    """
    first = element.first[index]
    second = None if element.second is None else element.second[index]
    start = frame.points[first.node]
    end = start if second is None else frame.points[second.node]
    if first.is_rotation:
        taken[(first.node, "turn")] += 1
        radius = (1.2 + 0.7 * taken[(first.node, "turn")]) * frame.height
        centre = 0.5 * (start + end)
        return symbols.spiral(centre, radius), np.zeros((0, 2)), centre
    key = _place_key(element, index)
    number, count = taken[key], obstacles.connectors[key]
    taken[key] += 1
    if second is None:
        along, blocked = _ground_direction(frame, first, obstacles)
    else:
        along, blocked = symbols.unit(end - start), obstacles.lines[_pair((first.node, second.node))] > 0
    stub = second is None or bool(np.hypot(*(end - start)) <= 1e-6 * frame.size)
    along = symbols.unit(frame.direction(first)) if stub and second is not None else along
    step = (number + 1 if blocked else number - 0.5 * (count - 1)) * 3.2 * frame.height
    shift = step * symbols.across(along)
    begin = start + obstacles.clearance.get(first.node, 0.0) * along
    if stub:
        finish = begin + max(9 * frame.height, 0.06 * frame.size) * along
    else:
        finish = end - obstacles.clearance.get(second.node if second else first.node, 0.0) * along
    lead = [begin, begin + shift] if step else []
    tail = [finish + shift, finish] if step and not stub else []
    body = symbols.connector(element.symbol, begin + shift, finish + shift, frame.height)
    path = symbols.joined([p for p in (np.array(lead), body, np.array(tail)) if len(p)])
    wall = symbols.ground(finish + shift, along, frame.height) if second is None else np.zeros((0, 2))
    return path, wall, 0.5 * (begin + finish) + shift


def _ground_direction(frame: _Frame, dof: Dof, obstacles: _Obstacles) -> tuple[FloatArray, bool]:
    """Unit direction (2,) on paper from a node to the ground for its connector, and True if an element lies there.

    It is opposite to the positive axis of `dof`, unless an element lies on that side alone: within about 26 degrees of
    the direction. `obstacles` has the nodes to which elements join the node of `dof`, `frame` the node positions on
    paper.
    """
    along = symbols.unit(frame.direction(dof))
    ways = [symbols.unit(frame.points[n] - frame.points[dof.node]) for n in obstacles.neighbours.get(dof.node, ())]
    against, with_axis = (max((float(way @ side) for way in ways), default=-1.0) for side in (-along, along))
    if with_axis < min(against, _IN_THE_WAY) and against > _IN_THE_WAY:
        return along, False
    return -along, against > _IN_THE_WAY


def _area(
    frame: _Frame, element: ElementSet, index: int, taken: Counter[object], heaviest: float
) -> tuple[FloatArray, FloatArray]:
    """Outline (n, 2) and centre (2,) of an element's symbol: disc for a mass, ring for rotary inertia, else a square.

    `index` is the element's row in its set. The area of a disc is in proportion to its mass, down to a limit, with
    `heaviest` the largest mass (kg). `taken` counts symbols other than discs at the same position, which are drawn
    beside each other or as wider rings, and is increased. `frame` has the node positions on paper and the sizes of
    symbols.
    """
    centre = np.mean([frame.points[int(n)] for n in element.nodes[index] if n >= 0], axis=0)
    if _is_mass(element):
        share = float(element.mass[index]) / heaviest if heaviest > 0 else 1.0
        return symbols.disc(centre, frame.radius * max(np.sqrt(share), 0.35)), centre
    key = ("area", round(float(centre[0]) / frame.size, 6), round(float(centre[1]) / frame.size, 6))
    taken[key] += 1
    if element.symbol == "ring":
        return symbols.disc(centre, frame.radius * (1.15 + 0.35 * taken[key])), centre
    centre = centre + np.array([2.6 * frame.radius * (taken[key] - 1), 0.0])
    return symbols.square(centre, frame.radius), centre


@dataclass(frozen=True, eq=False)
class _Arrow:
    """Arrow of a sensor or a load: paths (n, 2) of its shaft and heads, and the point (2,) with its hover text."""

    dof: Dof
    shaft: FloatArray
    heads: tuple[FloatArray, ...]
    tip: FloatArray


def _arrow_traces(arrows: Sequence[_Arrow], colour: str, width: float, noun: str) -> tuple[plot.Trace, ...]:
    """Plot traces of `arrows`: shafts, filled heads, and tips whose hover text is `noun` with the degree of freedom."""
    heads = symbols.joined(head for arrow in arrows for head in arrow.heads)
    tips = np.array([arrow.tip for arrow in arrows]).reshape(-1, 2)
    return (
        curve(symbols.joined(arrow.shaft for arrow in arrows), plot.Pen(colour, width), noun),
        plot.Area(heads[:, 0], heads[:, 1], colour, label=noun),
        points(tips, tuple(f"{noun} {arrow.dof}" for arrow in arrows)),
    )


def _arrow(frame: _Frame, dof: Dof, is_load: bool) -> _Arrow:
    """Arrow of a sensor, which starts at its node, or with `is_load` of a load, which ends there.

    Rotations have two heads, or a curved arrow about the axis normal to a plane structure. `frame` has the node
    positions on paper and the sizes of symbols; `dof` is that of the channel, with its sign.
    """
    point = frame.points[dof.node]
    head = min(0.022 * frame.size, max(0.7 * frame.spacing, 0.012 * frame.size))
    length = 0.10 * frame.size
    if dof.direction == "RZ" and not is_spatial(frame.structure):
        shaft, tip_head = symbols.turning_arrow(point, dof.sign, (0.055 if is_load else 0.04) * frame.size, head)
        return _Arrow(dof, shaft, (tip_head,), tip_head[0])
    way = dof.sign * frame.direction(dof)
    along = symbols.unit(way)
    length *= max(min(float(np.hypot(*way)), 1.0), 0.55)
    if frame.structure.dimension == 1 and dof.axis % 3 == 0:
        point = point + np.array([0.0, (-1 if is_load else 1) * (1.5 * frame.radius + 2 * frame.height)])
    tip = point if is_load else point + length * along
    tail = point - length * along if is_load else point
    heads = [symbols.arrow_head(tip, along, head)]
    if dof.is_rotation:
        heads.append(symbols.arrow_head(tip - 0.8 * head * along, along, head))
    return _Arrow(dof, np.array([tail, tip - 0.8 * head * along]), tuple(heads), tail if is_load else tip)


def _links(frame: _Frame) -> list[FloatArray]:
    """Line segments (2, 2) from one node to every other node of each rigid link or constraint, in drawing units.

    They start at the main node of a link, and at the dependent node of a constraint. `frame` has the node positions on
    paper, and the structure with these ties.
    """
    segments = []
    for tie in frame.structure.ties:
        if isinstance(tie, RigidLink):
            pairs = [(tie.main, node) for node in tie.dependents]
        elif isinstance(tie, Constraint):
            pairs = [(tie.dependent.node, dof.node) for dof, _ in tie.depends_on]
        else:
            continue
        segments += [np.array([frame.points[a], frame.points[b]]) for a, b in pairs if a != b]
    return segments


def _dof_labels(frame: _Frame, arrows: Sequence[_Arrow], colour: str) -> list[Label]:
    aways = (symbols.unit(arrow.tip - frame.points[arrow.dof.node], (0.0, 1.0)) for arrow in arrows)
    return [Label(str(arrow.dof), arrow.tip, away, colour) for arrow, away in zip(arrows, aways, strict=True)]


def _place_labels(frame: _Frame, shown: Sequence[int], marks: Sequence[Mark], busy: set[int]) -> list[Label]:
    """Labels of nodes below them, and of element sets beside one of their `marks`.

    Nodes in `busy` are labelled, and all `shown` ones if the structure has at most 40 nodes; both hold node labels.
    `frame` has the node positions on paper.
    """
    few = frozenset(shown if len(frame.points) <= _MANY_NODES else ())
    aside, below = symbols.unit(np.array([-1.0, -1.0])), np.array([0.0, -frame.height])
    labels = [
        Label(str(node), point + below, aside, palette.MUTED)
        for node, point in frame.points.items()
        if node in few or node in busy
    ]
    for mark in labelled_marks(marks):
        away = symbols.unit(np.array([1.0, 0.6]) if mark.filled else np.array([0.4, 1.0]))
        anchor = mark.centre + (frame.radius if mark.filled else frame.height) * away
        labels.append(Label(mark.element, anchor, away, palette.INK))
    return labels


def _axes(frame: _Frame, corner: FloatArray, used: set[str]) -> tuple[tuple[str, FloatArray], ...]:
    """Names of the global axes with short lines (2, 2) at the lower left of the drawing.

    `corner` (2,) is the lower left of the structure; Z is left out in a plane unless it is in `used`, the directions of
    arrows.
    """
    origin = corner - np.array([0.11, 0.05 if is_spatial(frame.structure) else 0.0]) * frame.size
    count = 3 if is_spatial(frame.structure) or "Z" in used else 2
    return tuple((DIRECTIONS[i], np.array([origin, origin + 0.05 * frame.size * frame.axes[i]])) for i in range(count))


def _bounds(
    corners: FloatArray, texts: Sequence[tuple[str, FloatArray]], paths: Sequence[FloatArray], per_inch: float
) -> tuple[float, float, float, float]:
    """Drawing limits (x low, x high, y low, y high) that hold corners, texts and paths with a margin of 4 %.

    `texts` are pairs of text and centre (2,); `per_inch` is the number of drawing units in an inch of text. `corners` and each of
    `paths` are (n, 2).
    """
    half = 0.5 * per_inch * np.array(_CHARACTER_INCHES)
    boxes = [at + sign * half * (len(text), 1.0) for text, at in texts for sign in (-1.0, 1.0)]
    everything = np.concatenate([corners, *paths, np.array(boxes).reshape(-1, 2)])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    margin = 0.04 * max(high - low)
    return float(low[0] - margin), float(high[0] + margin), float(low[1] - margin), float(high[1] + margin)


def _node_texts(structure: Structure, nodes: Sequence[int]) -> tuple[str, ...]:
    """Hover texts of `nodes`, in their order: label, coordinates (m) and fixed directions."""
    fixed_directions: dict[int, list[str]] = {}
    for dof in structure.fixed:
        fixed_directions.setdefault(dof.node, []).append(dof.direction)
    texts = []
    for node in nodes:
        place_text = ", ".join(f"{x:g}" for x in structure.nodes[node])
        fixed = f", fixed: {' '.join(fixed_directions[node])}" if node in fixed_directions else ""
        texts.append(f"node {node} ({place_text}) m{fixed}")
    return tuple(texts)


@dataclass(frozen=True, eq=False)
class Label:
    """A text wanted near `anchor`, away from it in the direction `away`."""

    text: str
    anchor: FloatArray
    away: FloatArray
    colour: str


def place_without_overlap(
    labels: Iterable[Label], character: tuple[float, float], gap: float, obstacles: FloatArray
) -> tuple[list[tuple[Label, FloatArray]], int]:
    """Labels placed without overlap, each with the centre (2,) of its text, and the number of labels left out.

    Of the positions that are free of earlier labels, the one that covers the fewest obstacles is taken; a label without such a
    position is left out.

    Parameters
    ----------
    labels : iterable of Label
        In order of importance.
    character : (float, float)
        Width and height of a character, in the units of the drawing.
    gap : float
        Distance between anchor and text.
    obstacles : (n, 2) float array
        Points of the drawing that texts should not cover.
    """
    boxes = np.zeros((0, 4))
    placed, lost = [], 0
    for label in labels:
        half = 0.5 * np.array([len(label.text) * character[0], 1.25 * character[1]])
        best, fewest = None, np.inf
        for centre in _candidates(label, half, gap):
            box = np.concatenate([centre - half, centre + half])
            clear = (boxes[:, 2:] <= box[:2]) | (boxes[:, :2] >= box[2:])
            if not clear.any(axis=1).all():
                continue
            covered = int(((obstacles > box[:2]) & (obstacles < box[2:])).all(axis=1).sum())
            if covered < fewest:
                best, fewest = centre, covered
            if covered == 0:
                break
        if best is None:
            lost += 1
            continue
        boxes = np.vstack([boxes, np.concatenate([best - half, best + half])])
        placed.append((label, best))
    return placed, lost


def _candidates(label: Label, half: FloatArray, gap: float) -> list[FloatArray]:
    """Centres (2,) to try for a label, best first: the wanted direction, then turned by up to 135 degrees, then farther out.

    `half` (2,) is half the width and height of the text, `gap` the smallest distance from the anchor.
    """
    centres = []
    for distance in (1.0, 2.5, 4.5):
        for turn in (0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75):
            c, s = np.cos(np.pi * turn), np.sin(np.pi * turn)
            way = np.array([c * label.away[0] - s * label.away[1], s * label.away[0] + c * label.away[1]])
            centres.append(label.anchor + distance * gap * way + half * way / max(float(np.abs(way).max()), 1e-12))
    return centres

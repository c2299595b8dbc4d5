"""The structure as flat shapes: what the PNG figure and the page draw, with nothing left to compute."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.dof import DIRECTIONS, Dof
from structid.identification.identified import Identification
from structid.report.drawing import symbols
from structid.report.drawing.changes import Panel, panels
from structid.report.drawing.faces import cell_faces, hidden_nodes, is_cells, labelled_marks
from structid.report.drawing.labels import Label, Placed, place
from structid.report.drawing.picture import Arrow, Mark, Picture
from structid.report.drawing.projection import PLANE_AXES, SPACE_AXES
from structid.report.text import counted
from structid.structure import (
    Dashpot,
    Friction,
    PointMass,
    RotaryInertia,
    Spring,
    Structure,
)
from structid.structure.elements import ElementSet
from structid.structure.supports import Constraint, RigidLink

_SYMBOLS = {Spring: symbols.spring, Dashpot: symbols.dashpot, Friction: symbols.friction}
#: Width in inches that a wide drawing and one panel of several have in the PNG figure.
WIDE_INCHES, PANEL_INCHES = 11.0, 5.6
_CHARACTER_INCHES = (0.068, 0.115)
_MANY_NODES = 40
#: Cosine beyond which two directions count as the same.
_IN_THE_WAY = 0.9


@dataclass(frozen=True, eq=False)
class _Frame:
    """Projected nodes and the sizes of symbols."""

    structure: Structure
    points: Mapping[int, FloatArray]
    axes: FloatArray
    size: float
    spacing: float
    height: float
    radius: float

    def direction(self, dof: Dof) -> FloatArray:
        """Where the positive sense of `dof` points on paper, not of unit length."""
        return self.axes[dof.axis % 3]

    @property
    def centre(self) -> FloatArray:
        return np.mean(list(self.points.values()), axis=0)


def picture(identification: Identification) -> Picture:
    """The structure of `identification` with its sensors, loads and changes."""
    found = identification
    return structure_picture(found.structure, found.sensors, found.loads, panels(found))


def structure_picture(
    structure: Structure, outputs: Sequence[Dof], inputs: Sequence[Dof], shown: tuple[Panel, ...] = ()
) -> Picture:
    """`structure` with sensors and loads, and with what `shown` says of its elements."""
    frame, notes = _frame(structure)
    marks, grounds = _marks(frame)
    hidden = hidden_nodes(structure, frame.points, marks)
    sensors = tuple(_arrow(frame, dof, is_load=False) for dof in outputs)
    loads = tuple(_arrow(frame, dof, is_load=True) for dof in inputs)
    foot = min(1.6 * frame.height, max(0.9 * frame.spacing, 0.012 * frame.size))
    held = dict.fromkeys(dof.node for dof in structure.fixed if dof.node not in hidden)
    supports = tuple(symbols.triangle(frame.points[node], foot) for node in held)
    links = symbols.joined(_links(frame))
    shown_nodes = [node for node in frame.points if node not in hidden]
    points = np.array([frame.points[node] for node in shown_nodes]).reshape(-1, 2)
    shapes = [points, grounds, links, *supports, *(m.path for m in marks)]
    shapes += [part for arrow in (*sensors, *loads) for part in (arrow.shaft, *arrow.heads)]
    corners = np.concatenate(shapes)
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    is_wide = high[0] - low[0] > 2.2 * (high[1] - low[1])
    per_inch = (high[0] - low[0]) / (0.86 * WIDE_INCHES if is_wide else 0.72 * PANEL_INCHES)
    character = (_CHARACTER_INCHES[0] * per_inch, _CHARACTER_INCHES[1] * per_inch)
    inside = [m.centre + share * (m.path - m.centre) for m in marks if m.filled for share in (0.35, 0.7)]
    obstacles = symbols.sampled(symbols.joined([*shapes[1:], *inside]), 0.4 * character[1])
    labels, lost = place(_wanted(frame, shown_nodes, marks, sensors, loads), character, 0.08 * per_inch, obstacles)
    if lost:
        left = (
            f"{counted(lost, 'label')} that would cover another {'is' if lost == 1 else 'are'} left out of the drawing"
        )
        notes = (*notes, f"{left}; point at an element to read its name.")
    axes = _axes(frame, low, {dof.direction for dof in (*outputs, *inputs)})
    return Picture(
        marks, grounds, links, supports, points, _node_texts(structure, shown_nodes), sensors, loads, axes, labels,
        _bounds(corners, labels, axes, per_inch), shown, notes,
    )  # fmt: skip


def _frame(structure: Structure) -> tuple[_Frame, tuple[str, ...]]:
    axes = SPACE_AXES if structure.dimension == 3 else PLANE_AXES
    table = np.array(list(structure.nodes.values()))
    flat = table @ axes[: structure.dimension]
    notes: tuple[str, ...] = ()
    if float(np.ptp(table, axis=0).max()) == 0 and len(table) > 1:
        flat = np.column_stack([np.arange(len(table), dtype=float), np.zeros(len(table))])
        notes = ("All nodes are at one place, so they are drawn in a row.",)
    size = float(np.ptp(flat, axis=0).max()) or 1.0
    points = dict(zip(structure.nodes, flat, strict=True))
    connectors = [e for e in structure.elements if isinstance(e, Spring | Dashpot | Friction)]
    areas = [e for e in structure.elements if e not in connectors and not _is_line(e)]
    height = np.clip(0.22 * _spacing(points, connectors, size), 0.008 * size, 0.020 * size)
    radius = np.clip(0.32 * _spacing(points, areas, size), 0.008 * size, 0.036 * size)
    spacing = _spacing(points, structure.elements, size)
    return _Frame(structure, points, axes, size, spacing, float(height), float(radius)), notes


def _spacing(points: Mapping[int, FloatArray], elements: Sequence[ElementSet], size: float) -> float:
    """Smallest distance on paper between nodes of `elements` that are not at the same place."""
    nodes = sorted({int(n) for e in elements for n in np.unique(e.nodes) if n >= 0})
    few = np.array([points[n] for n in nodes[:: max(1, len(nodes) // 400)]]).reshape(-1, 2)
    distance = np.hypot(*(few[:, None] - few[None]).transpose(2, 0, 1))
    apart = distance[distance > 1e-3 * size]
    return float(apart.min()) if apart.size else size


def _marks(frame: _Frame) -> tuple[tuple[Mark, ...], FloatArray]:
    """All elements, lines first so that masses stand before them, and the walls of grounded connectors."""
    taken: Counter[object] = Counter()
    heaviest = max((float(e.mass.max()) for e in frame.structure.elements if isinstance(e, PointMass)), default=1.0)
    areas: list[Mark] = []
    owners: list[int] = []
    rest: list[tuple[ElementSet, int, str]] = []
    cells = cell_faces(frame.structure, frame.points)
    for element in frame.structure.elements:
        for index, row in enumerate(element.nodes if not is_cells(element) else ()):
            label = element.name if len(element.nodes) == 1 else f"{element.name}:{index + 1}"
            if isinstance(element, Spring | Dashpot | Friction) or _is_line(element):
                rest.append((element, index, label))
            else:
                areas.append(_area(frame, element, index, label, taken, heaviest))
                owners.append(int(row[0]))
    around = _around(frame, areas, owners)
    lines: list[Mark] = []
    walls: list[FloatArray] = []
    for element, index, label in rest:
        if isinstance(element, Spring | Dashpot | Friction):
            path, wall, centre = _connector(frame, element, index, around, taken)
            walls.extend([wall] if len(wall) else [])
        else:
            path = np.array([frame.points[int(n)] for n in element.nodes[index]])
            centre = path.mean(axis=0)
        lines.append(Mark(element.name, index, label, path, False, centre))
    return (*cells, *lines, *areas), symbols.joined(walls)


def _is_line(element: ElementSet) -> bool:
    connector = isinstance(element, Spring | Dashpot | Friction)
    return not connector and element.nodes.shape[1] == 2 and hasattr(element, "mass")


def _pair(nodes: Sequence[int]) -> tuple[int, int]:
    return min(int(n) for n in nodes), max(int(n) for n in nodes)


def _place_key(element: Spring | Dashpot | Friction, index: int) -> object:
    """What connectors side by side have in common: the pair of nodes, or the grounded direction."""
    first = element.first[index]
    if element.second is None:
        return (first.node, first.direction)
    return _pair((first.node, element.second[index].node))


@dataclass(frozen=True, eq=False)
class _Around:
    """What a connector has to keep clear of.

    Attributes
    ----------
    lines : Counter
        Beams and bars between each pair of nodes.
    connectors : Counter
        Connectors that share a place, see `_place_key`.
    neighbours : mapping of node to nodes
        Nodes that elements join.
    clearance : mapping of node to float
        Radius of the masses and inertias drawn at each node.
    """

    lines: Counter[tuple[int, int]]
    connectors: Counter[object]
    neighbours: dict[int, set[int]]
    clearance: Counter[int]


def _around(frame: _Frame, areas: Sequence[Mark], nodes: Sequence[int]) -> _Around:
    lines: Counter[tuple[int, int]] = Counter()
    connectors: Counter[object] = Counter()
    neighbours: dict[int, set[int]] = {}
    for element in frame.structure.elements:
        is_connector = isinstance(element, Spring | Dashpot | Friction)
        for index, row in enumerate(element.nodes if is_connector or _is_line(element) else ()):
            first, second = _pair(row)
            if isinstance(element, Spring | Dashpot | Friction):
                connectors[_place_key(element, index)] += 0 if element.first[index].is_rotation else 1
            else:
                lines[(first, second)] += 1
            if first >= 0:
                neighbours.setdefault(first, set()).add(second)
                neighbours.setdefault(second, set()).add(first)
    clearance: Counter[int] = Counter()
    for mark, node in zip(areas, nodes, strict=True):
        radius = float(np.nanmax(np.hypot(*(mark.path - mark.centre).T)))
        clearance[node] = max(clearance[node], radius)  # type: ignore[assignment]
    return _Around(lines, connectors, neighbours, clearance)


def _connector(
    frame: _Frame,
    element: Spring | Dashpot | Friction,
    index: int,
    around: _Around,
    taken: Counter[object],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Path, wall and middle of one spring, dashpot or friction pad."""
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
    number, count = taken[key], around.connectors[key]
    taken[key] += 1
    if second is None:
        along, blocked = _outward(frame, first, around)
    else:
        along, blocked = symbols.unit(end - start), around.lines[_pair((first.node, second.node))] > 0
    stub = second is None or bool(np.hypot(*(end - start)) <= 1e-6 * frame.size)
    along = symbols.unit(frame.direction(first)) if stub and second is not None else along
    step = (number + 1 if blocked else number - 0.5 * (count - 1)) * 3.2 * frame.height
    shift = step * symbols.across(along)
    begin = start + around.clearance[first.node] * along
    if stub:
        finish = begin + max(9 * frame.height, 0.06 * frame.size) * along
    else:
        finish = end - around.clearance[second.node if second else first.node] * along
    lead = [begin, begin + shift] if step else []
    tail = [finish + shift, finish] if step and not stub else []
    body = _SYMBOLS[type(element)](begin + shift, finish + shift, frame.height)
    path = symbols.joined([p for p in (np.array(lead), body, np.array(tail)) if len(p)])
    wall = symbols.ground(finish + shift, along, frame.height) if second is None else np.zeros((0, 2))
    return path, wall, 0.5 * (begin + finish) + shift


def _outward(frame: _Frame, dof: Dof, around: _Around) -> tuple[FloatArray, bool]:
    """The side on which a connector goes to the ground, and whether an element is in its way there.

    Against the sense of the axis where nothing else is attached on that side.
    """
    along = symbols.unit(frame.direction(dof))
    ways = [symbols.unit(frame.points[n] - frame.points[dof.node]) for n in around.neighbours.get(dof.node, ())]
    against, with_axis = (max((float(way @ side) for way in ways), default=-1.0) for side in (-along, along))
    if with_axis < min(against, _IN_THE_WAY) and against > _IN_THE_WAY:
        return along, False
    return -along, against > _IN_THE_WAY


def _area(frame: _Frame, element: ElementSet, index: int, label: str, taken: Counter[object], heaviest: float) -> Mark:
    """A disc for a mass, rings for rotary inertias, a square for what is left."""
    nodes = [int(n) for n in element.nodes[index] if n >= 0]
    centre = np.mean([frame.points[n] for n in nodes], axis=0)
    if isinstance(element, PointMass):
        share = float(element.mass[index]) / heaviest if heaviest > 0 else 1.0
        path = symbols.disc(centre, frame.radius * max(np.sqrt(share), 0.35))
        return Mark(element.name, index, label, path, True, centre)
    key = ("area", round(float(centre[0]) / frame.size, 6), round(float(centre[1]) / frame.size, 6))
    taken[key] += 1
    if isinstance(element, RotaryInertia):
        path = symbols.disc(centre, frame.radius * (1.15 + 0.35 * taken[key]))
        return Mark(element.name, index, label, path, False, centre)
    centre = centre + np.array([2.6 * frame.radius * (taken[key] - 1), 0.0])
    return Mark(element.name, index, label, symbols.square(centre, frame.radius), True, centre)


def _arrow(frame: _Frame, dof: Dof, is_load: bool) -> Arrow:
    """A sensor starts at its node, a load ends there; rotations turn in a plane and have two heads in space."""
    point = frame.points[dof.node]
    head = min(0.022 * frame.size, max(0.7 * frame.spacing, 0.012 * frame.size))
    length = 0.10 * frame.size
    if dof.direction == "RZ" and frame.structure.dimension < 3:
        shaft, tip_head = symbols.turning_arrow(point, dof.sign, (0.055 if is_load else 0.04) * frame.size, head)
        return Arrow(dof, shaft, (tip_head,), tip_head[0])
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
    return Arrow(dof, np.array([tail, tip - 0.8 * head * along]), tuple(heads), tail if is_load else tip)


def _links(frame: _Frame) -> list[FloatArray]:
    """Lines from the main node of every rigid link or constraint to those that follow it."""
    found = []
    for tie in frame.structure.ties:
        if isinstance(tie, RigidLink):
            pairs = [(tie.main, node) for node in tie.dependents]
        elif isinstance(tie, Constraint):
            pairs = [(tie.dependent.node, dof.node) for dof, _ in tie.depends_on]
        else:
            continue
        found += [np.array([frame.points[a], frame.points[b]]) for a, b in pairs if a != b]
    return found


def _wanted(
    frame: _Frame, shown: Sequence[int], marks: Sequence[Mark], sensors: Sequence[Arrow], loads: Sequence[Arrow]
) -> list[Label]:
    """Labels by importance: loads, sensors, nodes, element names."""
    found = []
    for arrows, role in ((loads, "load"), (sensors, "sensor")):
        for arrow in arrows:
            away = symbols.unit(arrow.tip - frame.points[arrow.dof.node], (0.0, 1.0))
            found.append(Label(str(arrow.dof), arrow.tip, away, role))
    busy = {arrow.dof.node for arrow in (*sensors, *loads)}
    few = frozenset(shown if len(frame.points) <= _MANY_NODES else ())
    for node, point in frame.points.items():
        if node in few or node in busy:
            found.append(
                Label(str(node), point + np.array([0.0, -frame.height]), symbols.unit(np.array([-1.0, -1.0])), "node")
            )
    for mark in labelled_marks(marks):
        away = symbols.unit(np.array([1.0, 0.6]) if mark.filled else np.array([0.4, 1.0]))
        anchor = mark.centre + (frame.radius if mark.filled else frame.height) * away
        found.append(Label(mark.element, anchor, away, "element"))
    return found


def _axes(frame: _Frame, corner: FloatArray, used: set[str]) -> tuple[tuple[str, FloatArray], ...]:
    """Short lines along the global axes, at the lower left of the drawing."""
    origin = corner - np.array([0.11, 0.0 if frame.structure.dimension < 3 else 0.05]) * frame.size
    count = 3 if frame.structure.dimension == 3 or "Z" in used else 2
    return tuple((DIRECTIONS[i], np.array([origin, origin + 0.05 * frame.size * frame.axes[i]])) for i in range(count))


def _bounds(
    corners: FloatArray, labels: Sequence[Placed], axes: Sequence[tuple[str, FloatArray]], per_inch: float
) -> tuple[float, float, float, float]:
    points = [corners, *(path for _, path in axes)]
    for label in labels:
        half = 0.5 * per_inch * np.array([len(label.text) * _CHARACTER_INCHES[0], _CHARACTER_INCHES[1]])
        points.append(np.array([label.at - half, label.at + half]))
    everything = np.concatenate(points)
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    margin = 0.04 * max(high - low)
    return float(low[0] - margin), float(high[0] + margin), float(low[1] - margin), float(high[1] + margin)


def _node_texts(structure: Structure, shown: Sequence[int]) -> tuple[str, ...]:
    held: dict[int, list[str]] = {}
    for dof in structure.fixed:
        held.setdefault(dof.node, []).append(dof.direction)
    texts = []
    for node in shown:
        place_text = ", ".join(f"{x:g}" for x in structure.nodes[node])
        fixed = f", fixed: {' '.join(held[node])}" if node in held else ""
        texts.append(f"node {node} ({place_text}) m{fixed}")
    return tuple(texts)

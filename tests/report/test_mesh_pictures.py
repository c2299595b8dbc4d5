"""Meshes as the drawing shows them: outer faces of solids, shells in space, what is hidden, and in which order."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from page_parts import pieces

from structid import Plate, PointMass, Shell, Solid, SpaceBeam, Structure, parse_dof
from structid.report.drawing import picture
from structid.report.drawing.drawing import structure_picture
from structid.report.drawing.picture import SPACE_AXES
from structid.report.figures.structure import Change, shading, structure_figure
from structid.report.rendering.plot import Area, Curve
from structid.report.rendering.png import drawn as png_drawn

SIGHT = np.cross(*SPACE_AXES.T)
GIVEN = {"youngs_modulus": 70e9, "density": 2700.0, "poisson": 0.3}


def block(shape=(4, 3, 2)):
    """A block of cubes of side 1 in two sets, with nodes numbered from 1."""
    axes = [np.arange(n + 1.0) for n in shape]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(1, len(points) + 1).reshape([n + 1 for n in shape])
    low, high = slice(None, -1), slice(1, None)
    square = [(low, low), (high, low), (high, high), (low, high)]
    cells = np.stack([number[(*s, z)] for z in (low, high) for s in square], axis=-1).reshape(-1, 8)
    half = len(cells) // 2
    sets = [Solid("left", cells[:half], **GIVEN), Solid("right", cells[half:], **GIVEN)]
    return dict(enumerate(points, 1)), sets, number


def tube(n_along=4, n_around=12):
    angle = np.linspace(0, 2 * np.pi, n_around, endpoint=False)
    rings = [
        np.column_stack([np.full(n_around, x), np.cos(angle), np.sin(angle)]) for x in np.linspace(0, 3, n_along + 1)
    ]
    number = np.arange(1, (n_along + 1) * n_around + 1).reshape(n_along + 1, -1)
    after = np.roll(number, -1, axis=1)
    cells = np.stack([number[:-1], number[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    return dict(enumerate(np.concatenate(rings), 1)), cells


def node_texts(drawn):
    return [t for trace in drawn.before if isinstance(trace, Curve) for t in trace.hover or () if t.startswith("node ")]


def doubled_area(path):
    x, y = path.T
    return x @ np.roll(y, -1) - y @ np.roll(x, -1)


def test_a_block_shows_the_three_sides_that_look_at_the_eye_and_none_between_its_parts():
    nodes, sets, number = block()
    drawn = structure_picture(Structure(nodes, sets), [], [])
    assert len(drawn.marks) == 4 * 3 + 3 * 2 + 4 * 2
    ends = {"X": 0.0, "Y": 0.0, "Z": 0.0}
    for mark in drawn.marks:
        at = np.array([nodes[n] for n in mark.nodes])
        flat = int(np.argmin(np.ptp(at, axis=0)))
        ends["XYZ"[flat]] += 1
        assert at[0, flat] == (([4, 3, 2][flat]) if SIGHT[flat] > 0 else 0)
        own = next(e for e in sets if e.name == mark.element).nodes[mark.index]
        assert set(mark.nodes) <= set(own.tolist())
        assert mark.label == f"{mark.element}:{mark.index + 1}"
        assert doubled_area(mark.path) > 0
    assert sorted(ends.values()) == [6, 8, 12]
    seen = {n for mark in drawn.marks for n in mark.nodes}
    assert len(node_texts(drawn)) == len(seen) < len(nodes)
    assert int(number[1, 1, 1]) not in seen


@pytest.mark.parametrize("tip", [(0.5, 0.5, 1.0), (0.5, 0.5, -1.0)])
def test_faces_of_pyramids_and_quadratic_cells_are_their_corners(tip):
    base = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    nodes = dict(enumerate([*base, tip], 1))
    order = [1, 2, 3, 4, 5] if tip[2] > 0 else [4, 3, 2, 1, 5]
    drawn = structure_picture(Structure(nodes, [Solid("pyramid", [order], **GIVEN)]), [], [])
    assert 1 <= len(drawn.marks) <= 3
    assert {len(mark.nodes) for mark in drawn.marks} <= {3, 4}


def test_shells_are_drawn_from_far_to_near_and_nodes_behind_them_are_not():
    nodes, cells = tube()
    drawn = structure_picture(Structure(nodes, [Shell("tube", cells, thickness=0.01, **GIVEN)]), [parse_dof("1Z")], [])
    assert len(drawn.marks) == len(cells)
    depth = [np.mean([nodes[n] @ SIGHT for n in mark.nodes]) for mark in drawn.marks]
    assert np.all(np.diff(depth) >= 0)
    assert min(doubled_area(mark.path) for mark in drawn.marks) > 0  # back and front in one sense
    assert 0.4 * len(nodes) < len(node_texts(drawn)) < 0.8 * len(nodes)
    texts = [t for trace in drawn.before if isinstance(trace, Curve) for t in trace.hover or ()]
    assert [text for text in texts if text.startswith("sensor")] == ["sensor 1Z+"]
    shown = {text.split()[1] for text in node_texts(drawn)}
    middle = [n for n, p in nodes.items() if 0.7 < p[0] < 1.6]
    front = [n for n in middle if nodes[n] @ [0, SIGHT[1], SIGHT[2]] > 0.75]
    back = [n for n in middle if nodes[n] @ [0, SIGHT[1], SIGHT[2]] < -0.3]
    assert front
    assert back
    assert {str(n) for n in front} <= shown
    assert not {str(n) for n in back} & shown


def test_nodes_that_other_elements_use_are_always_drawn():
    nodes, sets, number = block()
    inner = int(number[2, 1, 1])
    drawn = structure_picture(Structure(nodes, [*sets, PointMass("lump", [inner], 1.0)]), [], [])
    assert any(text.startswith(f"node {inner} ") for text in node_texts(drawn))


def test_large_meshes_have_no_nodes_drawn(monkeypatch):
    nodes, cells = tube()
    monkeypatch.setattr(picture, "_MOST_PAIRS", 10)
    drawn = structure_picture(Structure(nodes, [Shell("tube", cells, thickness=0.01, **GIVEN)]), [parse_dof("1Z")], [])
    assert node_texts(drawn) == []
    png_drawn(structure_figure(drawn))


def test_flat_cells_keep_a_gap_and_names_stand_where_they_are_seen():
    points = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (1.0, 1.0), 4: (0.0, 1.0)}
    flat = Structure(points, [Plate("p", [[1, 2, 3, 4]], thickness=0.01, **GIVEN)])
    (mark,) = structure_picture(flat, [], []).marks
    assert doubled_area(mark.path) / 2 == pytest.approx(0.94**2)
    away = SIGHT / np.linalg.norm(SIGHT)
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    far = np.concatenate([square, square + np.array([3.0, 0, 0])])
    nodes = dict(enumerate(np.concatenate([far, square + 0.5 * away]), 1))
    behind = Shell("behind", [[1, 2, 3, 4], [5, 6, 7, 8]], thickness=0.01, **GIVEN)
    before = Shell("before", [[9, 10, 11, 12]], thickness=0.01, **GIVEN)
    marks = structure_picture(Structure(nodes, [behind, before]), [], []).marks
    named = {mark.element: mark for mark in picture.labelled_marks(marks)}
    assert named["behind"].index == 1  # the other square is covered
    assert named["before"].index == 0


def test_faces_have_their_colours_and_lie_below_lines_on_page_and_figure():
    nodes, cells = tube()
    ring = np.stack([np.arange(1, 12), np.arange(2, 13)], axis=-1)
    beams = SpaceBeam("ring", ring, 1.0, 1.0, 1.0)
    structure = Structure(nodes, [Shell("tube", cells, thickness=0.01, **GIVEN), beams])
    changes = {("tube", k): Change(0.1 * (k % 2) - 0.05, True, f"change {k}") for k in range(len(cells))}
    drawn = structure_picture(structure, [], [])
    traces = list(structure_figure(drawn, (shading("stiffness", changes, 0.05),)).panels[0].traces)
    filled = [k for k, trace in enumerate(traces) if isinstance(trace, Area)]
    line = next(k for k, trace in enumerate(traces) if isinstance(trace, Curve) and trace.pen and len(trace.x) > 20)
    assert max(filled) < line
    assert len({traces[k].colour for k in filled}) == 2
    hover = [
        text for trace in traces if isinstance(trace, Curve) for text in trace.hover or () if text.endswith(" change 3")
    ]
    assert hover == ["tube:4: change 3"]


def test_regions_are_outlined_where_no_neighbour_belongs_to_them():
    nodes = {k: (float(k % 4), float(k // 4)) for k in range(12)}
    cells = [[k, k + 1, k + 5, k + 4] for k in (0, 1, 2, 4, 5, 6)]
    structure = Structure(nodes, [Plate("p", cells, thickness=0.01, **GIVEN)])
    changes = {("p", k): Change(0.1, True, "") for k in range(6)}
    both = replace(shading("", changes, 0.1), outlined=frozenset({("p", 0), ("p", 1)}))
    traces = structure_figure(structure_picture(structure, [], []), (both,)).panels[0].traces
    (border,) = [trace for trace in traces if trace.label == "round changes beyond chance"]
    drawn = {frozenset(map(tuple, side.tolist())) for side in pieces(border.x, border.y)}
    corners = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)]
    assert drawn == {frozenset((a, b)) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)}


def test_meshes_of_many_colours_keep_their_order_from_far_to_near():
    nodes, cells = tube(n_along=40, n_around=40)
    structure = Structure(nodes, [Shell("tube", cells, thickness=0.01, **GIVEN)])
    changes = {("tube", k): Change(0.05 * np.sin(k), True, "") for k in range(len(cells))}
    drawn = structure_picture(structure, [], [])
    traces = [t for t in structure_figure(drawn, (shading("", changes, 0.05),)).panels[0].traces if isinstance(t, Area)]
    assert len(traces) < 600
    order = {mark.path.tobytes(): k for k, mark in enumerate(drawn.marks)}
    places = []
    for trace in traces:
        places.append([order[part.tobytes()] for part in pieces(trace.x, trace.y)])
    assert sum(map(len, places)) == len(cells)
    for first, second in pairwise(places):  # a trace never holds a face behind the slice before
        assert min(second) > min(first) - len(cells) / 12

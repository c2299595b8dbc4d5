"""Mean motions and tied surfaces of decks against another library's numbers, least squares and rigid motion."""

import numpy as np
import pytest
from scipy.linalg import eigh

from structid import Structure
from structid.core.dof import DIRECTIONS
from structid.fem import Solid
from structid.fem.meshes import read_mesh, require_sound

GRIDS = """BEGIN BULK
CORD2C,9,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.
GRID,100,,1.,0.,.2
GRID,200,,.1,1.,0.
GRID,300,,-1.,0.,.3
GRID,400,,0.,-1.2,.1
GRID,500,,.2,.1,.5
GRID,600,,1.,1.,.5,9
CQUAD4,1,1,100,200,300,400
"""
#: pyyeti 1.4.7, `formrbe3`: [123 (weight 1.5) of 100 and 200, 123456 (0.7) of 300, 45 (2) of 400].
MIXED = """
0.458840718 0.087423223 -0.068749025 0.322556836 -0.01922319 0.011296375 0.218602445 -0.068200033 0.05745265
-0.003700081 0.056409392 0.068855899 -0.01057166 0.161169693 -0.008412931 0.397046726 0.046076266 0.012047343
0.391563524 -0.073410977 -0.003634412 0.21138975 0.027334711 -0.073568121 0.003674577 -0.012765985 -0.210194631
0.01049879 0.001279704 0.006651917 0.433486663 -0.002824404 -0.014685221 0.345269461 0.0015447 0.008033304 0.221243876
-0.062618652 0.011938988 0.000025504 -0.178910434 0.034111395 -0.002125138 -0.023703731 -0.129180288 0.00381117
0.048145094 0.203350448 -0.001686032 -0.024441364 -0.07417016 0.203408695 -0.008748508 -0.001740972 0.581167701
-0.024995737 0.011111902 -0.010348199 -0.200347959 -0.02925559 0.000326851 0.03468101 0.018143688 0.010021348
0.165666949 -0.008748508 0.163278294 -0.008918728 -0.024995737 0.466509412 0.161788238 0.298524348 0.012473337
-0.236581606 -0.063330783 -0.004138022 0.074793368 -0.235193566 -0.008335316 -0.001740972 -0.008918728 0.236033559
-0.004974206 -0.025482079
"""
MIXED_COLUMNS = [(n, d) for n, ds in ((100, "123"), (200, "123"), (300, "123456"), (400, "45")) for d in ds]
#: The same: 123 of four nodes with 12 of 100, 3 of 200, 23 of 300 and 3 of 400 as dependents (UM).
SOLVED = """
0 -1 0 -1 -1 0 4 0 0 0 -1.4 0.6 0 0.5 -0.55 0 -0.6 -0.5 0.1 2.05 0 0.775 0.01 1.875 -1.034482759 -0.125 -0.105603448
0.051724138 -0.025862069 -0.064655172 0.099137931 0.170258621 2.034482759 0.875215517 -0.790086207 -0.107543103 0 -0.5
-0.45 0 0.6 -0.5 -0.1 1.95 0 0.625 -0.01 -2.575 0.896551724 0.1875 -0.010560345 -0.094827586 0.097413793 -0.006465517
-0.190086207 0.017025862 0.103448276 -0.002478448 2.030991379 0.04924569 -0.862068966 -0.0625 0.116163793 0.043103448
-0.071551724 0.07112069 0.090948276 -0.187284483 1.862068966 -1.472737069 -0.540905172 0.058297414
"""
SOLVED_ROWS = [(100, "1"), (100, "2"), (200, "3"), (300, "2"), (300, "3"), (400, "3")]
SOLVED_COLUMNS = [(n, d) for n, ds in ((100, "3"), (200, "12"), (300, "1"), (400, "12"), (500, "123456")) for d in ds]


def read(tmp_path, cards, suffix=".bdf", head=GRIDS, **units):
    path = tmp_path / f"a{suffix}"
    path.write_text(head + cards + ("ENDDATA\n" if suffix == ".bdf" else ""))
    return read_mesh(path, **units)


def part_of(mesh, kind):
    return next(part for part in mesh.parts if part.kind == kind)


def table(part, rows, columns):
    """Coefficients of the constraints of a part by dependent (row) and what it depends on (column)."""
    names = [(node, DIRECTIONS[int(digit) - 1]) for node, digit in columns]
    values = np.zeros((len(rows), len(columns)))
    by_dof = {(tie.dependent.node, tie.dependent.direction): tie for tie in part.ties}
    assert set(by_dof) == {(node, DIRECTIONS[int(digit) - 1]) for node, digit in rows}
    for row, (node, digit) in enumerate(rows):
        for dof, factor in by_dof[node, DIRECTIONS[int(digit) - 1]].depends_on:
            values[row, names.index((dof.node, dof.direction))] = factor
    return values


def numbers(text):
    return np.array([float(word) for word in text.split()]).reshape(6, -1)


def rigid(positions, seed=1):
    """Motion (6,) of each node in a small rigid motion."""
    shift, turn = np.random.default_rng(seed).standard_normal((2, 3))
    return {node: np.concatenate([shift + np.cross(turn, place), turn]) for node, place in positions.items()}


def largest_error(part, moves):
    """How far constraints are from motions."""
    return max(
        abs(
            moves[tie.dependent.node][DIRECTIONS.index(tie.dependent.direction)]
            - sum(factor * moves[dof.node][DIRECTIONS.index(dof.direction)] for dof, factor in tie.depends_on)
        )
        for tie in part.ties
    )


def test_means_of_translations_and_rotations_weigh_as_in_nastran(tmp_path):
    mesh = read(tmp_path, "RBE3,7,,500,123456,1.5,123,100,200\n,.7,123456,300,2.,45,400\n")
    rows = [(500, digit) for digit in "123456"]
    assert table(part_of(mesh, "RBE3"), rows, MIXED_COLUMNS) == pytest.approx(numbers(MIXED), abs=2e-9)
    assert largest_error(part_of(mesh, "RBE3"), rigid(mesh.nodes)) < 1e-12


def test_means_are_solved_for_what_um_names(tmp_path):
    mesh = read(
        tmp_path,
        "RBE3,7,,500,123456,1.,123,100,200\n,300,400,,,,,,\n,UM,100,12,200,3,300,23\n,,400,3,,,,\n,ALPHA,1.-5\n",
    )
    assert table(part_of(mesh, "RBE3"), SOLVED_ROWS, SOLVED_COLUMNS) == pytest.approx(numbers(SOLVED), abs=2e-9)


def test_means_of_a_few_components_are_least_squares_in_their_own_directions(tmp_path):
    mesh = read(tmp_path, "RBE3,7,,600,1235,1.,123,100,200\n,300,.5,3,400\n")
    moves = {node: np.random.default_rng(node).standard_normal(6) for node in mesh.nodes}
    equations, values = [], []
    for node, digits, weight in ((100, "123", 1), (200, "123", 1), (300, "123", 1), (400, "3", 0.5)):
        x, y, z = mesh.nodes[node] - mesh.nodes[600]
        lever = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        for digit in digits:
            equations.append(weight**0.5 * lever[int(digit) - 1])
            values.append(weight**0.5 * moves[node][int(digit) - 1])
    motion = np.linalg.lstsq(np.array(equations), np.array(values), rcond=None)[0]
    part = part_of(read(tmp_path, "RBE3,7,,600,123,1.,123,100,200\n,300,.5,3,400\n"), "RBE3")
    moves[600][:3] = motion[:3]
    assert largest_error(part, moves) < 1e-12
    assert part_of(mesh, "RBE3").obstacle.startswith("a dependent node's own displacement system is turned")


def test_nodes_of_rigid_elements_from_one_to_another(tmp_path):
    mesh = read(tmp_path, "RBE2,7,500,123456,100,THRU,400,BY\n,100,1.-5\n")
    [link] = part_of(mesh, "RBE2").ties
    assert link.dependents == (100, 200, 300, 400)
    for nodes, words in (("100,TO,400", "cannot be read"), ("1,THRU,99999999", "are more than 1000000 nodes")):
        assert words in part_of(read(tmp_path, f"RBE2,7,500,123456,{nodes}\n"), "RBE2").obstacle


BLOCKS = """*NODE
1, 0, 0, 0
2, 2, 0, 0
3, 2, 2, 0
4, 0, 2, 0
5, 0, 0, 1
6, 2, 0, 1
7, 2, 2, 1
8, 0, 2, 1
11, 0.5, 0.5, {gap}
12, 1.5, 0.5, {gap}
13, 1.5, 1.5, {gap}
14, 0.5, 1.5, {gap}
15, 0.5, 0.5, 2
16, 1.5, 0.5, 2
17, 1.5, 1.5, 2
18, 0.5, 1.5, 2
20, 1, 1, 3
*ELEMENT, TYPE=C3D8, ELSET=LOW
1, 1, 2, 3, 4, 5, 6, 7, 8
*ELEMENT, TYPE=C3D8, ELSET=HIGH
2, 11, 12, 13, 14, 15, 16, 17, 18
*SURFACE, NAME=TOP
LOW, S2
*SURFACE, NAME=BOTTOM, TYPE=ELEMENT
2, S1
*SURFACE, NAME=POINTS, TYPE=NODE
15
18
16
"""


def test_nodes_of_a_tied_surface_move_as_the_face_does_where_they_are(tmp_path):
    mesh = read(tmp_path, "*TIE, NAME=T\nBOTTOM, TOP\n", ".inp", BLOCKS.format(gap=1))
    part = part_of(mesh, "TIE")
    assert (part.count, part.obstacle, len(part.ties)) == (1, "", 12)
    tie = next(tie for tie in part.ties if str(tie.dependent) == "12Y+")
    # a quarter of the way from the side x = 2, y = 0: 3/4 and 1/4 along each side
    assert {str(dof): factor for dof, factor in tie.depends_on} == pytest.approx(
        {"5Y+": 3 / 16, "6Y+": 9 / 16, "7Y+": 3 / 16, "8Y+": 1 / 16}
    )


@pytest.mark.parametrize("gap", [1.0, 1.04, 0.97])
def test_tied_surfaces_move_rigidly_over_a_gap(tmp_path, gap):
    mesh = read(tmp_path, "*TIE, NAME=T, ADJUST=NO\nBOTTOM, TOP\n", ".inp", BLOCKS.format(gap=gap))
    assert largest_error(part_of(mesh, "TIE"), rigid(mesh.nodes)) < 1e-12


def test_nodes_far_from_the_other_surface_stay_free_and_are_counted(tmp_path):
    mesh = read(tmp_path, "*TIE, NAME=T\nBOTTOM, TOP\n", ".inp", BLOCKS.format(gap=1.2))
    [part] = mesh.parts
    assert part.words == "4 TIE"
    assert part.obstacle == "nodes that lie farther than 0.1 m from the other surface, which the solver leaves free"
    near = read(tmp_path, "*TIE, NAME=T, POSITION TOLERANCE=0.3\nBOTTOM, TOP\n", ".inp", BLOCKS.format(gap=1.2))
    assert largest_error(part_of(near, "TIE"), rigid(near.nodes)) < 1e-12


def test_faces_of_quadratic_solids_carry_by_their_middles_too(tmp_path):
    rng = np.random.default_rng(2)
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2.0]])
    edges = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    places = [*corners, *(corners[list(edge)].mean(axis=0) for edge in edges)]
    lines = [f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(places, 1)]
    head = "*NODE\n" + "\n".join(lines) + "\n31, 0.3, 0.4, 0\n32, 0.9, 0.2, 0\n33, 0.2, 0.2, -1\n"
    head += "*ELEMENT, TYPE=C3D10, ELSET=LOW\n1, " + ", ".join(map(str, range(1, 11)))
    head += "\n*ELEMENT, TYPE=S3, ELSET=HIGH\n2, 31, 32, 33\n"
    head += "*SURFACE, NAME=M\nLOW, S1\n*SURFACE, NAME=S, TYPE=NODE\n31\n32\n*TIE, NAME=T\nS, M\n"
    mesh = read(tmp_path, "", ".inp", head)
    a = rng.standard_normal((3, 6))

    def field(place):
        x, y, _ = place
        return np.concatenate([a @ [1, x, y, x * x, x * y, y * y], np.zeros(3)])

    assert largest_error(part_of(mesh, "TIE"), {node: field(place) for node, place in mesh.nodes.items()}) < 1e-12


def test_shells_that_are_tied_turn_together_unless_the_file_says_otherwise(tmp_path):
    head = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 1, 0.25, 0
6, 2, 0.25, 0
7, 2, 1, 0
*ELEMENT, TYPE=S4, ELSET=A
1, 1, 2, 3, 4
*ELEMENT, TYPE=S3, ELSET=B
2, 5, 6, 7
*SURFACE, NAME=M
A, SPOS
*SURFACE, NAME=S, TYPE=NODE
5
"""
    mesh = read(tmp_path, "*TIE, NAME=T\nS, M\n", ".inp", head)
    ties = {str(tie.dependent): tie for tie in part_of(mesh, "TIE").ties}
    assert set(ties) == {f"5{direction}+" for direction in DIRECTIONS}
    assert {str(dof): factor for dof, factor in ties["5RY+"].depends_on} == pytest.approx({"2RY+": 0.75, "3RY+": 0.25})
    apart = read(tmp_path, "*TIE, NAME=T, NO ROTATION\nS, M\n", ".inp", head)
    assert len(part_of(apart, "TIE").ties) == 3


def test_distributing_couplings_share_forces_by_area(tmp_path):
    cards = "*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=TOP\n*DISTRIBUTING\n"
    mesh = read(
        tmp_path,
        cards,
        ".inp",
        BLOCKS.format(gap=1).replace("3, 2, 2, 0", "3, 2, 2, 0").replace("7, 2, 2, 1", "7, 4, 2, 1"),
    )
    part = part_of(mesh, "COUPLING")
    assert {str(tie.dependent) for tie in part.ties} == {f"20{d}+" for d in DIRECTIONS}
    assert largest_error(part, rigid(mesh.nodes)) < 1e-12
    # by hand: bilinear shares of the trapezium (0, 0), (2, 0), (4, 2), (0, 2), whose height is 2 and sides 2 and 4
    s, w = np.polynomial.legendre.leggauss(4)
    corners = np.array([[0, 0], [2, 0], [4, 2], [0, 2]], float)
    area = np.zeros(4)
    for xi, wx in zip(s, w, strict=True):
        for eta, wy in zip(s, w, strict=True):
            shape = (
                np.array([(1 - xi) * (1 - eta), (1 + xi) * (1 - eta), (1 + xi) * (1 + eta), (1 - xi) * (1 + eta)]) / 4
            )
            along = np.array([-(1 - eta), 1 - eta, 1 + eta, -(1 + eta)]) / 4 @ corners
            across = np.array([-(1 - xi), -(1 + xi), 1 + xi, 1 - xi]) / 4 @ corners
            area += wx * wy * shape * abs(along[0] * across[1] - along[1] * across[0])
    assert area.sum() == pytest.approx(6)
    places = np.array([mesh.nodes[node] for node in (5, 6, 7, 8)])
    centre = area @ places / area.sum()
    moves = {node: np.random.default_rng(node).standard_normal(6) for node in (5, 6, 7, 8)}
    inertia, momentum = np.zeros((3, 3)), np.zeros(3)
    for weight, place, node in zip(area, places, (5, 6, 7, 8), strict=True):
        arm = place - centre
        inertia += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        momentum += weight * np.cross(arm, moves[node][:3])
    turn = np.linalg.solve(inertia, momentum)
    mean = sum(weight * moves[node][:3] for weight, node in zip(area, (5, 6, 7, 8), strict=True)) / area.sum()
    moves[20] = np.concatenate([mean + np.cross(turn, mesh.nodes[20] - centre), turn])
    assert largest_error(part, moves) < 1e-12


@pytest.mark.parametrize(
    "cards, words",
    [
        ("*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=POINTS\n*DISTRIBUTING\n1, 3\n", ""),
        ("*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=TOP\n*KINEMATIC\n", ""),
        (
            "*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=NONE\n*KINEMATIC\n",
            "cannot be read: there is no surface 'NONE'",
        ),
        (
            "*COUPLING, CONSTRAINT NAME=C, REF NODE=20, SURFACE=TOP\n*DISTRIBUTING, WEIGHTING METHOD=LINEAR\n",
            "its weights are not uniform, or it couples rotations",
        ),
        ("*SURFACE, NAME=FREE\nLOW,\n*TIE, NAME=T\nPOINTS, FREE\n", "names no faces, so that all free ones are meant"),
        ("*TIE, NAME=T\nTOP, POINTS\n", "its second surface is of nodes"),
        ("*SURFACE, NAME=U, COMBINE=UNION\nTOP, BOTTOM\n*TIE, NAME=T\nPOINTS, U\n", "surface 'U' is made of others"),
    ],
)
def test_couplings_and_ties_that_nothing_stands_for_are_listed(tmp_path, cards, words):
    mesh = read(tmp_path, cards, ".inp", BLOCKS.format(gap=1))
    [part] = [part for part in mesh.parts if part.kind in ("COUPLING", "TIE")]
    assert words in part.obstacle if words else part.obstacle == ""
    if not words:
        assert largest_error(part, rigid(mesh.nodes)) < 1e-12 if "DISTRIBUTING" in cards else part.ties[0].dependents


def test_tied_blocks_vibrate_as_in_calculix(tmp_path):
    """Two blocks of 2 and 3 cells along their common side, the lower one clamped; frequencies of ccx 2.20 (C3D8, *TIE)."""
    lines, elements, first = ["*NODE"], [], {}
    for name, n, bottom, top in (("LOW", 2, 0.0, 1.0), ("HIGH", 3, 1.0, 2.2)):
        start = first[name] = 1 if name == "LOW" else 1001
        label = {key: start + k for k, key in enumerate(np.ndindex(3, n + 1, n + 1))}
        for (k, j, i), node in label.items():
            lines.append(f"{node}, {i / n}, {j / n}, {bottom + k * (top - bottom) / 2}")
        elements.append(f"*ELEMENT, TYPE=C3D8, ELSET={name}")
        for count, (k, j, i) in enumerate(np.ndindex(2, n, n)):
            square = ((0, 0), (0, 1), (1, 1), (1, 0))
            corners = [label[k + c, j + b, i + a] for c in (0, 1) for b, a in square]
            elements.append(", ".join(map(str, [start + count, *corners])))
    faces = "*ELSET, ELSET=ET, GENERATE\n5, 8, 1\n*ELSET, ELSET=EB, GENERATE\n1001, 1009, 1\n"
    ties = "*SURFACE, NAME=M\nET, S2\n*SURFACE, NAME=S\nEB, S1\n*TIE, NAME=T\nS, M\n"
    mesh = read(tmp_path, "\n".join([*lines, *elements, ""]) + faces + ties, ".inp", "")
    mesh = require_sound(mesh, take="all", duplicates="keep")
    sets = [Solid(name, mesh.cells(name), 2.1e11, 7800.0, 0.3, formulation="full") for name in ("LOW", "HIGH")]
    clamped = [f"{node}{d}" for node in range(1, 10) for d in "XYZ"]
    structure = Structure(mesh.nodes, sets, fixed=clamped, ties=part_of(mesh, "TIE").ties)
    stiffness, mass = (structure.matrix(law).toarray() for law in ("stiffness", "mass"))
    frequency = np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:6]) / (2 * np.pi)
    assert frequency == pytest.approx([167.1027, 167.1027, 366.4574, 608.5324, 698.7926, 698.7926], rel=5e-7)

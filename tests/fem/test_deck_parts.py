"""Masses, springs and rigid elements of decks against energies and motions worked out by hand."""

import importlib
import random
from pathlib import Path

import numpy as np
import pytest

from structid import Structure
from structid.core.dof import DIRECTIONS, Dof
from structid.fem import Shell
from structid.fem.meshes import read_mesh, require_sound
from structid.fem.supports import RigidLink

ROOT = Path(__file__).parents[2]
GRIDS = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
GRID,5,,2.,0.5,1.
GRID,6,,1.,1.,0.
CQUAD4,1,1,1,2,3,4
"""
PANEL = """*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0., 1., 0.
5, 2., 0.5, 1.
*ELEMENT, TYPE=S4, ELSET=SKIN
1, 1, 2, 3, 4
*NSET, NSET=EDGE
2, 3
"""


@pytest.fixture
def deck(tmp_path):
    def read(cards, suffix=".bdf", length="m", force="N"):
        path = tmp_path / f"a{suffix}"
        path.write_text((PANEL if suffix == ".inp" else GRIDS) + cards)
        return read_mesh(path, length, force)

    return read


def part_of(mesh, kind):
    return next(part for part in mesh.parts if part.kind == kind)


def energy(spring, moves):
    """Twice the strain energy of a spring for displacements and rotations by node."""
    weights = spring.weights.items()
    return spring.stiffness * sum(w * moves[node][DIRECTIONS.index(d)] for (node, d), w in weights) ** 2


def random_moves():
    rng = np.random.default_rng(3)
    return {node: rng.standard_normal(6) for node in range(1, 7)}


def test_bushings_work_where_they_are_between_their_ends_along_their_axes(deck):
    mesh = deck("CBUSH,7,8,2,5,0.,1.,0.,,\n,.25\nPBUSH,8,K,10.,20.,30.,40.,50.,60.\n,B,1.,,,,,2.\nENDDATA\n")
    springs = part_of(mesh, "CBUSH").springs
    start, end = np.array([1.0, 0.0, 0.0]), np.array([2.0, 0.5, 1.0])
    place = start + 0.25 * (end - start)
    x = (end - start) / np.linalg.norm(end - start)
    z = np.cross(x, [0.0, 1.0, 0.0])
    z /= np.linalg.norm(z)
    axes = [x, np.cross(z, x), z]
    moves = random_moves()
    jump = moves[5][:3] + np.cross(moves[5][3:], place - end) - moves[2][:3] - np.cross(moves[2][3:], place - start)
    turn = moves[5][3:] - moves[2][3:]
    expected = [k * (axis @ jump) ** 2 for k, axis in zip((10, 20, 30), axes, strict=True)]
    expected += [k * (axis @ turn) ** 2 for k, axis in zip((40, 50, 60), axes, strict=True)]
    assert [energy(spring, moves) for spring in springs] == pytest.approx(expected)
    assert [spring.damping for spring in springs] == [1.0, 0, 0, 0, 0, 2.0]


def test_rigid_motion_strains_no_bushing_and_the_structure_has_its_stiffness(deck):
    mesh = require_sound(
        deck("CBUSH,7,8,2,5,0.,1.,0.\nPBUSH,8,K,10.,20.,30.,40.,50.,60.\nENDDATA\n"), True, "keep", ["CBUSH"]
    )
    part = part_of(mesh, "CBUSH")
    skin = Shell("skin", mesh.cells(), 1.0, 1.0, 0.1, 0.3)
    structure = Structure(mesh.nodes, [skin, *part.elements()])
    stiffness = structure.matrix("stiffness")
    about = np.random.default_rng(1).standard_normal(6)
    motion = []
    for dof in structure.dofs:
        at = mesh.nodes[dof.node]
        row = np.concatenate([about[:3] + np.cross(about[3:], at), about[3:]])
        motion.append(row[DIRECTIONS.index(dof.direction)])
    assert np.abs(stiffness @ np.array(motion)).max() < 1e-9 * abs(stiffness).max()
    alone = Structure(mesh.nodes, [skin])
    assert abs(stiffness).sum() > abs(alone.matrix("stiffness")).sum()


@pytest.mark.parametrize(
    "cards, why",
    [
        ("CBUSH,7,8,2,5\nPBUSH,8,K,10.,20.\nENDDATA\n", "it has no orientation"),
        ("CBUSH,7,8,3,6\nPBUSH,8,K,10.\nENDDATA\n", "it has no orientation"),
        ("CBUSH,7,8,2,5\nPBUSH,8,K,RIGID\nENDDATA\n", "its stiffness is rigid"),
        ("CBUSH,7,9,2,5\nPBUSH,8,K,1.\nENDDATA\n", "its property is not in the deck"),
        ("CBUSH,7,8,2,99\nPBUSH,8,K,1.\nENDDATA\n", "it is at a scalar point, or a grid point that is not there"),
    ],
)
def test_bushings_that_nothing_stands_for_are_listed_with_the_reason(deck, cards, why):
    mesh = deck(cards)
    assert part_of(mesh, "CBUSH").obstacle == why
    assert part_of(mesh, "CBUSH").elements() == []


def test_springs_and_dampers_of_properties_join_components(deck):
    mesh = deck(
        "CELAS1,1,5,1,3,2,3\nCELAS1,2,6,1,4\nPELAS,5,100.,.02,,6,7.\nCDAMP1,3,9,4,1\nPDAMP,9,11.\nCDAMP2,4,12.,3,6,6,6\nENDDATA\n"
    )
    first, second = part_of(mesh, "CELAS1").springs
    assert (dict(first.weights), first.stiffness, first.loss_factor) == ({(1, "Z"): -1.0, (2, "Z"): 1.0}, 100.0, 0.02)
    assert (dict(second.weights), second.stiffness, second.set_name) == ({(1, "RX"): -1.0}, 7.0, "6")
    names = [(element.name, type(element).__name__) for element in part_of(mesh, "CELAS1").elements()]
    assert names == [("celas1 5", "Spring"), ("celas1 6", "Spring")]
    [dashpot] = part_of(mesh, "CDAMP1").elements()
    assert (dashpot.name, dashpot.viscous_damping.tolist()) == ("cdamp1 9", [11.0])
    [turning] = part_of(mesh, "CDAMP2").springs
    assert (dict(turning.weights), turning.damping) == ({(3, "RZ"): -1.0, (6, "RZ"): 1.0}, 12.0)
    inches = deck("CELAS2,2,3.,1,4\nCELAS2,3,3.,1,1\nENDDATA\n", length="in", force="lbf")
    rotation, translation = part_of(inches, "CELAS2").springs
    assert rotation.stiffness == pytest.approx(3 * 4.4482216152605 * 0.0254)
    assert translation.stiffness == pytest.approx(3 * 4.4482216152605 / 0.0254)


def test_full_mass_matrices_are_those_of_the_card(deck):
    rows = np.arange(1.0, 22.0)
    words = [f"{value:.0f}." for value in rows]
    mesh = deck(
        "CONM1,9,2,," + ",".join(words[:5]) + "\n," + ",".join(words[5:13]) + "\n," + ",".join(words[13:]) + "\n"
    )
    matrix = part_of(mesh, "CONM1").masses[0].matrix
    assert matrix[np.tril_indices(6)].tolist() == rows.tolist()
    assert (matrix == matrix.T).all()
    [group] = part_of(mesh, "CONM1").elements()
    order = [DIRECTIONS.index(dof.direction) for dof in group.dofs]
    assert group.mass.toarray() == pytest.approx(matrix[np.ix_(order, order)])


def test_bodies_are_point_masses_rotary_inertias_or_one_matrix(deck):
    mesh = deck("CONM2,1,2,,5.\nCONM2,2,3,,6.\n,1.,,2.,,,3.\nCONM2,3,4,,7.,.5\nENDDATA\n")
    sets = {element.name: element for element in part_of(mesh, "CONM2").elements()}
    assert sorted(sets) == ["conm2", "conm2 RX", "conm2 RY", "conm2 RZ", "conm2 bodies"]
    assert sets["conm2"].mass.tolist() == [5.0, 6.0]
    assert [sets[f"conm2 {d}"].rotary_inertia[0] for d in ("RX", "RY", "RZ")] == [1.0, 2.0, 3.0]
    skin = Shell("skin", mesh.cells(), 1.0, 1.0, 0.01, 0.3)
    structure = Structure(mesh.nodes, [skin, *sets.values()])
    assert structure.mass_of() == pytest.approx(0.01 + 18.0)


def carried(ties, moves):
    """Displacements of dependent components by constraints, from those of the others."""
    values = {}
    for tie in ties:
        if isinstance(tie, RigidLink):
            continue
        total = sum(f * moves[dof.node][DIRECTIONS.index(dof.direction)] for dof, f in tie.depends_on)
        values[tie.dependent.node, tie.dependent.direction] = total
    return values


def test_rigid_elements_follow_their_main_node(deck):
    mesh = deck("RBE2,1,5,123456,2,3\nRBE2,2,5,12,4\nRBAR,3,1,4,123456\nENDDATA\n")
    whole, *parts = part_of(mesh, "RBE2").ties
    assert (whole.main, whole.dependents, whole.directions) == (5, (2, 3), None)
    moves = random_moves()
    arm = np.array([0.0, 1.0, 0.0]) - np.array([2.0, 0.5, 1.0])
    expected = moves[5][:3] + np.cross(moves[5][3:], arm)
    assert carried(parts, moves) == pytest.approx({(4, "X"): expected[0], (4, "Y"): expected[1]})
    [bar] = part_of(mesh, "RBAR").ties
    assert (bar.main, bar.dependents) == (1, (4,))


def test_weighted_means_follow_every_rigid_motion_and_weigh_translations(deck):
    mesh = deck("RBE3,1,,5,123456,1.,123,1,2\n,3,2.,123,4\nENDDATA\n")
    ties = part_of(mesh, "RBE3").ties
    about = np.random.default_rng(4).standard_normal(6)
    moves = {node: np.concatenate([about[:3] + np.cross(about[3:], at), about[3:]]) for node, at in mesh.nodes.items()}
    expected = {(5, d): moves[5][k] for k, d in enumerate(DIRECTIONS)}
    assert carried(ties, moves) == pytest.approx(expected)
    # least squares by another way: the rigid motion whose weighted distance to the displacements is smallest
    moves = random_moves()
    rows, values = [], []
    for node, weight in ((1, 1.0), (2, 1.0), (3, 1.0), (4, 2.0)):
        r = mesh.nodes[node] - mesh.nodes[5]
        for k in range(3):
            rows.append(np.sqrt(weight) * np.concatenate([np.eye(3)[k], np.cross(r, np.eye(3)[k])]))
            values.append(np.sqrt(weight) * moves[node][k])
    motion = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
    assert [carried(ties, moves)[5, d] for d in DIRECTIONS] == pytest.approx(motion.tolist())


def test_multi_point_constraints_are_those_of_the_set_that_is_asked_for(deck):
    cards = "MPC,1,2,3,2.,3,3,-1.\n,,4,4,3.\nMPC,2,1,1,1.,2,1,-1.\n"
    assert part_of(deck(cards + "ENDDATA\n"), "MPC").obstacle == "it is not clear which set of MPC is meant"
    asked = deck(cards, length="mm")
    assert asked.parts  # no case control: both sets
    only = deck("MPC,1,2,3,2.,3,3,-1.\n,,4,4,3.\nENDDATA\n", length="mm")
    [tie] = part_of(only, "MPC").ties
    assert tie.dependent == Dof(2, "Z")
    # 2 u2 - u3 + 3 rx4 = 0 in mm, so that in m the rotation counts a thousandth
    assert dict(tie.depends_on) == pytest.approx({Dof(3, "Z"): 0.5, Dof(4, "RX"): -1.5e-3})


def test_terms_of_a_constraint_along_turned_directions_add_up(deck):
    cards = "CORD2R,1,,0.,0.,0.,0.,0.,1.\n,1.,1.,0.\nGRID,7,,3.,0.,0.,1\nMPC,1,2,1,1.,7,1,-1.\n,,7,2,-3.\nENDDATA\n"
    moves = random_moves() | {7: np.array([0.3, -0.7, 0.2, 0.0, 0.0, 0.0])}
    along = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) @ moves[7][:3] / np.sqrt(2)
    assert carried(part_of(deck(cards), "MPC").ties, moves) == pytest.approx({(2, "X"): along[0] + 3 * along[1]})


@pytest.mark.parametrize(
    ("cards", "suffix", "kind"),
    [
        ("CELAS2,1,5.,2,1,5,4\nENDDATA\n", ".bdf", "CELAS2"),
        ("*ELEMENT, TYPE=SPRING2, ELSET=SP\n9, 5, 2\n*SPRING, ELSET=SP\n4, 1\n5.\n", ".inp", "SPRING"),
    ],
)
def test_a_spring_between_a_translation_and_a_rotation_has_the_energy_of_the_file(deck, cards, suffix, kind):
    [spring] = part_of(deck(cards, suffix, "mm"), kind).springs
    moves = random_moves()
    in_mm = 1e3 * moves[2][0]  # 5 N mm per unit of the difference between mm and rad
    assert energy(spring, moves) == pytest.approx(5e-3 * (in_mm - moves[5][3]) ** 2)


def test_cards_without_an_element_are_listed(deck):
    mesh = deck("CGAP,1,1,2,3\nGENEL,2\nCFOO,3,1,2\nDMIG,K2GG,0,6,1,0\nCAERO1,5\nPSHELL,1,1,.1,,,,,4.\nENDDATA\n")
    assert {part.kind: (part.count, part.obstacle) for part in mesh.parts} == {
        "CGAP": (1, "contact"),
        "GENEL": (1, "general elements"),
        "CFOO": (1, "not known"),
        "DMIG": (1, "matrices"),
        "PSHELL NSM": (1, "add it to the density"),
    }


def test_coincident_nodes_that_a_taken_spring_joins_are_no_duplicates(deck):
    mesh = deck("CQUAD4,2,1,1,2,6,4\nCELAS2,1,5.,3,1,6,1\nENDDATA\n")
    with pytest.raises(Exception, match=r"nodes 3 and 6 of a\.bdf lie at one place"):
        require_sound(mesh, drop_orphans=True)
    assert 6 in require_sound(mesh, True, take=["CELAS2"]).nodes
    merged = require_sound(mesh, True, "merge")
    assert part_of(merged, "CELAS2").springs == ()


def test_nodes_that_only_parts_use_are_named_with_what_uses_them(deck):
    mesh = deck("RBE2,1,5,123456,2,3\nCONM2,2,5,,1.\nENDDATA\n")
    with pytest.raises(Exception, match="belong to no cell, only to CONM2, RBE2, which `take` would take"):
        require_sound(mesh, duplicates="keep")
    assert 5 in require_sound(mesh, True, "keep", ["RBE2"]).nodes


def test_couplings_rigid_bodies_and_multi_point_constraints_of_abaqus(deck):
    mesh = deck(
        "*KINEMATIC COUPLING, REF NODE=5\nEDGE, 1, 2\n4, 1, 6\n"
        "*RIGID BODY, REF NODE=5, PIN NSET=EDGE\n*MPC\nBEAM, 1, 4\nPIN, EDGE, 5\nSLIDER, 1, 2\n"
        "*SURFACE, NAME=S, TYPE=NODE\nEDGE, 1.\n*COUPLING, CONSTRAINT NAME=C, REF NODE=5, SURFACE=S\n*KINEMATIC\n3, 3\n",
        ".inp",
    )
    moves = random_moves()
    arms = {node: mesh.nodes[node] - mesh.nodes[5] for node in (2, 3)}
    rigid = {node: moves[5][:3] + np.cross(moves[5][3:], arm) for node, arm in arms.items()}
    *partial, whole = part_of(mesh, "KINEMATIC COUPLING").ties
    assert carried(partial, moves) == pytest.approx({(n, "XY"[k]): rigid[n][k] for n in (2, 3) for k in range(2)})
    assert (whole.main, whole.dependents) == (5, (4,))
    assert carried(part_of(mesh, "COUPLING").ties, moves) == pytest.approx({(n, "Z"): rigid[n][2] for n in (2, 3)})
    [pinned] = part_of(mesh, "RIGID BODY").ties
    assert (pinned.main, pinned.dependents, pinned.directions) == (5, (2, 3), ("X", "Y", "Z"))
    joined = part_of(mesh, "MPC").ties
    assert (joined[0].main, joined[0].dependents) == (4, (1,))
    assert carried(joined, moves) == pytest.approx({(n, "XYZ"[k]): moves[5][k] for n in (2, 3) for k in range(3)})
    assert [(part.count, part.obstacle) for part in mesh.parts if part.kind == "MPC"] == [(3, ""), (1, "type SLIDER")]


def test_transforms_turn_springs_and_are_noted(deck):
    mesh = deck(
        "*TRANSFORM, NSET=EDGE, TYPE=C\n0., 0., 0., 0., 0., 1.\n"
        "*ELEMENT, TYPE=SPRING1, ELSET=SP\n9, 3\n*SPRING, ELSET=SP\n1\n50.\n",
        ".inp",
    )
    [spring] = part_of(mesh, "SPRING").springs
    assert spring.weights == pytest.approx({(3, "X"): np.sqrt(0.5), (3, "Y"): np.sqrt(0.5)})
    assert mesh.displacement_axes[3][1] == pytest.approx([-np.sqrt(0.5), np.sqrt(0.5), 0.0])
    assert "nodes 3 have directions of their own" in mesh.notes[0]


def test_reference_points_of_an_assembly_come_with_what_is_taken(tmp_path):
    path = tmp_path / "a.inp"
    path.write_text(
        "*PART, NAME=P\n"
        + PANEL.replace("5, 2., 0.5, 1.\n", "")
        + "*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n"
        "*END INSTANCE\n*NODE\n1, 0.5, 0.5, 2.\n*ELEMENT, TYPE=MASS, ELSET=PM\n1, 1\n*MASS, ELSET=PM\n3.\n"
        "*NSET, NSET=RP\n1\n*NSET, NSET=TOP, INSTANCE=I\nEDGE\n*RIGID BODY, REF NODE=RP, TIE NSET=TOP\n*END ASSEMBLY\n"
    )
    mesh = read_mesh(path)
    assert require_sound(mesh).labels.tolist() == [1, 2, 3, 4]
    taken = require_sound(mesh, take="all")
    assert taken.nodes[11] == pytest.approx([0.5, 0.5, 2.0])
    [link] = part_of(taken, "RIGID BODY").ties
    assert (link.main, link.dependents) == (11, (2, 3))
    assert part_of(taken, "MASS").masses[0].node == 11


@pytest.mark.parametrize("kind", ["nastran", "abaqus"])
def test_decks_of_known_truth_are_read_right_however_they_are_written(tmp_path, monkeypatch, kind):
    monkeypatch.syspath_prepend(str(ROOT))
    true_decks = importlib.import_module("fuzz.true_decks")
    for seed in random.Random(38).sample(range(10**6), 40):
        folder = tmp_path / str(seed)
        folder.mkdir()
        assert true_decks.check_deck(kind, seed, folder) == [], f"{kind} {seed}"


def test_constraints_between_merged_nodes_keep_what_they_say(deck):
    cards = "CTRIA3,2,1,2,5,6\nMPC,1,3,1,1.,1,1,-.25\n,,6,1,-.5\nMPC,1,6,2,1.,3,2,-1.\n,,1,2,-.5\n,,2,2,.25\nENDDATA\n"
    ties = part_of(require_sound(deck(cards), True, "merge"), "MPC").ties  # 6 lies at 3
    assert [(str(tie.dependent), {str(dof): c for dof, c in tie.depends_on}) for tie in ties] == [
        ("3X+", {"1X+": 0.5}),
        ("2Y+", {"1Y+": 2.0}),
    ]


def test_blank_words_of_inertias_and_masses_are_0_and_move_no_others(tmp_path):
    head = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n*ELEMENT, TYPE=B31, ELSET=BM\n1, 1, 2\n"
    inertia = "*ELEMENT, TYPE=ROTARYI, ELSET=R\n2, 2\n*ROTARY INERTIA, ELSET=R\n, , 5.\n"
    mass = "*ELEMENT, TYPE=MASS, ELSET=PM\n3, 1\n*MASS, ELSET=PM\n{}\n"
    for row in ("2., , 2.", "2.,", "2., 2., 2."):
        path = tmp_path / "a.inp"
        path.write_text(head + inertia + mass.format(row))
        mesh = read_mesh(path, "m")
        assert part_of(mesh, "MASS").obstacle == ("it is not the same in all directions" if row == "2., , 2." else "")
        [turning] = part_of(mesh, "ROTARY INERTIA").masses
        assert np.diag(turning.matrix).tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]


def test_a_mean_without_its_first_weight_is_not_read_as_another(deck):
    mesh = deck("RBE3,1,,5,123456,,123,1,2,3,4\nENDDATA\n")
    part = part_of(mesh, "RBE3")
    assert (part.obstacle, part.ties) == ("RBE3 1 cannot be read: its first weight is blank", ())


@pytest.mark.parametrize(
    "fields, word", [("1.,123,1,2,,123,3,4", "123"), ("1.,,123,1,2,3,4", "123"), ("1.,123,1,2\n,,3,4", "3")]
)
def test_a_mean_without_a_later_weight_is_not_read_as_another(deck, fields, word):
    obstacle = part_of(deck(f"GRID,123,,0.,0.,5.\nRBE3,1,,5,123456,{fields}\nENDDATA\n"), "RBE3").obstacle
    assert obstacle.startswith(f"RBE3 1 cannot be read: a field before {word} is blank, where a weight may be left out")


def test_blank_fields_of_a_mean_before_a_weight_are_passed_over(deck):
    near, far = (
        part_of(deck(f"RBE3,1,,5,123456,1.,123,1,2,{gap}\n,.5,123,3,4\nENDDATA\n"), "RBE3") for gap in ("", ",")
    )
    assert (near.obstacle, far.obstacle) == ("", "")
    assert near.ties == far.ties

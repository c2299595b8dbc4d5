"""Cells that stand off their nodes: matrices against those of cells at their true places, carried by arms written out here."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from structid import Structure
from structid.core.dof import DIRECTIONS
from structid.core.errors import InputError
from structid.fem import Shell, SpaceBeam
from structid.fem.measuring_points import mesh_points
from structid.fem.meshes import read_mesh, require_sound
from structid.study.schema.study import load_study

FILES = Path(__file__).parent / "field_files"
GRIDS = """BEGIN BULK
CORD2C,9,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,.1
GRID,3,,1.,1.,.2,9
GRID,4,,0.,1.,.1
GRID,5,,2.,.5,1.
"""
POSITIONS = {1: [0, 0, 0], 2: [1, 0, 0.1], 3: [1, 1, 0.2], 4: [0, 1, 0.1], 5: [2, 0.5, 1.0]}
DIAGONAL = np.array([1, 1, 0]) / np.sqrt(2)
CYLINDER = np.array([DIAGONAL, [-DIAGONAL[0], DIAGONAL[0], 0], [0, 0, 1]])


def read(tmp_path, cards, suffix=".bdf", head=GRIDS, **units):
    path = tmp_path / f"a{suffix}"
    path.write_text(head + cards + ("ENDDATA\n" if suffix == ".bdf" else ""))
    return read_mesh(path, **units)


def carried(nodes, arms, made, names):
    """Mass and stiffness of elements `made(nodes)` whose corners stand at arms off the nodes, on all six motions of each."""
    ends = {label: np.array(POSITIONS[label], float) + arms[label] for label in nodes}
    alone = Structure(ends, [made(np.array([nodes]))])
    carry = np.zeros((len(alone.dofs), 6 * len(names)))
    for row, dof in enumerate(alone.dofs):
        x, y, z = arms[dof.node]
        lever = np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]])
        motion = np.vstack([lever, np.eye(3, 6, 3)])
        at = 6 * names.index(dof.node)
        carry[row, at : at + 6] = motion[DIRECTIONS.index(dof.direction)]
    return [carry.T @ alone.matrix(law).toarray() @ carry for law in ("mass", "stiffness")]


def matrices(mesh, kind, elements):
    """Mass and stiffness of the structure on a mesh, in the order of node and direction."""
    sound = require_sound(mesh, True, take=[kind])
    part = next(part for part in sound.parts if part.kind == kind)
    structure = Structure(sound.nodes, elements(sound), ties=part.ties)
    names = sorted({dof.node for dof in structure.dofs})
    order = sorted(
        range(len(structure.dofs)),
        key=lambda i: (structure.dofs[i].node, DIRECTIONS.index(structure.dofs[i].direction)),
    )
    assert len(structure.dofs) == 6 * len(names)
    return names, [structure.matrix(law).toarray()[np.ix_(order, order)] for law in ("mass", "stiffness")]


def shell(nodes):
    return Shell("skin", nodes, 70e9, 2700.0, 0.01, 0.3)


def beam(nodes):
    return SpaceBeam("rib", nodes, 3.0, 200.0, 300.0, 4e6, 500.0, 0.1)


@pytest.mark.parametrize(
    "card, corners, offset",
    [
        ("CQUAD4,7,1,1,2,3,4,,.03\n", (1, 2, 3, 4), 0.03),
        ("CQUAD4,7,1,4,3,2,1,,.03\n", (4, 3, 2, 1), 0.03),
        ("CTRIA3,7,1,1,2,4,,-.02\n", (1, 2, 4), -0.02),
        ("CQUADR,7,1,1,2,3,4,,.03\n", (1, 2, 3, 4), 0.03),
        # two plies of 4 and 6 mm above a bottom 1 mm over the reference: the middle is at 6 mm
        ("CQUAD4,7,1,1,2,3,4\nPCOMP,1,.001,,,,,,\n,1,.004,0.,,1,.006\n", (1, 2, 3, 4), 0.006),
        ("CQUAD4,7,1,1,2,3,4,,.01\nPCOMP,1,.001,,,,,,SYM\n,1,.004,0.,,1\n", (1, 2, 3, 4), 0.019),
        ("CQUAD4,7,1,1,2,3,4\nPCOMPG,1,0.\n,1,1,.004\n,2,1,.006\n", (1, 2, 3, 4), 0.005),
    ],
)
def test_plates_stand_along_their_normals(tmp_path, card, corners, offset):
    at = np.array([POSITIONS[label] for label in corners], float)
    normal = np.cross(at[2] - at[0], at[3] - at[1]) if len(corners) == 4 else np.cross(at[1] - at[0], at[2] - at[0])
    arms = dict.fromkeys(corners, offset * normal / np.linalg.norm(normal))
    mesh = read(tmp_path, card)
    names, found = matrices(mesh, card.split(",")[0] + " offset", lambda sound: [shell(sound.cells())])
    assert names == sorted(corners)
    for matrix, expected in zip(found, carried(corners, arms, shell, names), strict=True):
        assert np.abs(matrix - expected).max() < 1e-12 * np.abs(expected).max()


X, V = np.array([2.0, 0.5, 1.0]), np.array([0.0, 1.0, 0.0])
Z = np.cross(X, V) / np.linalg.norm(np.cross(X, V))
ELEMENT = np.array([X / np.linalg.norm(X), np.cross(Z, X / np.linalg.norm(X)), Z])


@pytest.mark.parametrize(
    "card, nodes, arms",
    [
        ("CBAR,7,1,1,5,0.,1.,0.,,\n,,,.1,.2,.3,-.1,0.,.2\n", (1, 5), ([0.1, 0.2, 0.3], [-0.1, 0, 0.2])),
        ("CBEAM,7,1,1,5,0.,1.,0.,GGG\n,,,.1,.2,.3\n", (1, 5), ([0.1, 0.2, 0.3], [0, 0, 0])),
        ("CBAR,7,1,1,5,0.,1.,0.,GOG\n,,,.1,.2,.3,-.1,0.,.2\n", (1, 5), ([0.1, 0.2, 0.3] @ ELEMENT, [-0.1, 0, 0.2])),
        ("CBAR,7,1,1,5,0.,1.,0.,BOO\n,,,,.2,,,,.2\n", (1, 5), ([0, 0.2, 0] @ ELEMENT, [0, 0, 0.2] @ ELEMENT)),
        (
            "BAROR,,1,,,0.,1.,0.,GOO\nCBAR,7,1,1,5,0.,1.,0.\n,,,,.2,,,,.2\n",
            (1, 5),
            ([0, 0.2, 0] @ ELEMENT, [0, 0, 0.2] @ ELEMENT),
        ),
    ],
)
def test_bars_stand_along_the_axes_that_they_name(tmp_path, card, nodes, arms):
    mesh = read(tmp_path, card)
    kind = "CBEAM offset" if "CBEAM" in card else "CBAR offset"
    names, found = matrices(mesh, kind, lambda sound: [beam(sound.cells())])
    expected = carried(nodes, dict(zip(nodes, map(np.array, arms), strict=True)), beam, names)
    for matrix, wanted in zip(found, expected, strict=True):
        assert np.abs(matrix - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_arms_are_along_the_motions_of_the_grid_point(tmp_path):
    mesh = read(tmp_path, "CBAR,7,1,1,3,0.,1.,0.\n,,,,,,.1,.2,.3\n")
    [part] = [part for part in mesh.parts if part.kind == "CBAR offset"]
    assert part.offsets[0].arms[0, 0] == pytest.approx([0.0, 0.0, 0.0])
    assert part.offsets[0].arms[0, 1] == pytest.approx(np.array([0.1, 0.2, 0.3]) @ CYLINDER)


def test_ends_of_one_node_at_one_place_are_one_and_the_files_nodes_are_found(tmp_path):
    grids = GRIDS + "GRID,6,,2.,0.,.1\nGRID,7,,2.,1.,.2\n"
    flat = grids.replace(",.1\n", ",0.\n").replace(",.2\n", ",0.\n").replace(",.2,9\n", ",0.\n")
    mesh = read(tmp_path, "CQUAD4,7,1,1,2,3,4,,.03\nCQUAD4,8,1,2,6,7,3,,.03\n", head=flat)
    sound = require_sound(mesh, True, take="all")
    assert len(sound.labels) == 12
    assert sound.group_nodes("1").tolist() == [1, 2, 3, 4, 6, 7]
    assert sound.nodes_at({"x": (1.0, 1.0)}).tolist() == [2, 3]
    assert sound.nearest([1.0, 0.0, 0.03])[0] == 2
    [point] = mesh_points(sound, [shell(sound.cells())], {101: [1.02, 0.0, 0.03]})
    assert (point.node, point.directions) == (2, DIRECTIONS)
    assert require_sound(sound, take="all").labels.tolist() == sound.labels.tolist()  # once


@pytest.mark.parametrize(
    "cards, words",
    [
        ("CBAR,7,1,1,5,0.,1.,0.,GXG\n,,,.1\n", "1 CBAR offset: its OFFT 'GXG' is not known"),
        ("CBAR,7,1,1,5,0.,1.,0.\n,45,5\n", "1 CBAR released end: loosen its ends by [[structure.joint]]"),
        (
            "CBAR,7,1,1,5,,,,GOO\n,,,.1\n",
            "1 CBAR offset: it is along axes of the element, which has no orientation vector of its own",
        ),
        ("CBEAM,7,3,1,5,0.,1.,0.\nPBEAM,3,1,.1,.1,.1,.1,.1,7.\n", "1 PBEAM NSM: add it to the density"),
        (
            "CBEAM,7,3,1,5,0.,1.,0.\nPBEAM,3,1,.1,.1,.1,.1,.1,\n,1.,1.,1.,1.,1.,1.,1.,1.\n,YES,1.,.1,.1,.1,.1,.1,2.\n,,,,,,,,\n,,,,,,,,\n,,,,,.3\n",
            "1 PBEAM NSM: add it to the density; 1 PBEAM neutral axis: its neutral axis is not its shear centre",
        ),
        ("CBAR,7,3,1,5,0.,1.,0.\nPBARL,3,1,,T,,,,\n,1.,2.,3.,4.,5.\n", "1 PBARL NSM: add it to the density"),
        ("CBAR,7,3,1,5,0.,1.,0.\nPBARL,3,1,,T,,,,\n,1.,2.,3.,4.\n", ""),
        ("CQUAD8,7,1,1,2,3,4,,,\n,,,,,,,,.1\n", "1 CQUAD8 offset: no element for its cells"),
        ("CQUAD4,7,1,1,2,3,4\nPCOMP,1,-.005,,,,,,\n,1,.004,0.,,1,.006\n", ""),
    ],
)
def test_what_cannot_be_placed_is_listed(tmp_path, cards, words):
    mesh = read(tmp_path, cards)
    assert "; ".join(f"{part.words}: {part.obstacle}" for part in mesh.parts if part.obstacle) == words


def test_offsets_need_nodes_that_turn(tmp_path):
    path = tmp_path / "masses.toml"
    study = (
        (FILES / "masses.toml").read_text().replace("masses.bdf", "a.bdf").replace('"a.bdf"', '"a.bdf", take = "all"')
    )
    shutil.copy(FILES / "modes3.csv", tmp_path)
    deck = (FILES / "masses.bdf").read_text().splitlines()
    deck = [line + (",,.03" if line.startswith("CQUAD4") else "") for line in deck]
    (tmp_path / "a.bdf").write_text("\n".join(deck))
    path.write_text(study)
    structure = load_study(path).structure
    assert any(tie.name.startswith("offset") for tie in structure.ties)
    assert {dof.node for dof in structure.dofs} <= {1, 2, 3, 4, 5, 6}
    path.write_text(study.replace("structure.shell", "structure.plate"))
    with pytest.raises(InputError, match="offsets of CQUAD4 offset need element sets that move in all six directions"):
        _ = load_study(path).structure


INP = """*NODE
1, 0, 0, 0
2, 1, 0, 0.1
3, 1, 1, 0.2
4, 0, 1, 0.1
5, 2, 0.5, 1.0
*ELEMENT, TYPE=S4, ELSET=SK
1, 1, 2, 3, 4
*ELEMENT, TYPE=B31, ELSET=BM
2, 1, 5
"""


@pytest.mark.parametrize(
    "offset, size, part",
    [
        ("0.5", "0.1", -0.5),  # ccx 2.20 expands a shell of OFFSET=0.5 from -thickness to 0 along its normal
        ("SPOS", "0.1", -0.5),
        ("SNEG", "0.1", 0.5),
        ("-1.25", "0.1", 1.25),
        ("0.5, COMPOSITE", "0.04, 3, ALU\n.06, 3, ALU", -0.5),
    ],
)
def test_shells_of_abaqus_stand_in_thicknesses_below_their_nodes(tmp_path, offset, size, part):
    cards = f"*SHELL SECTION, ELSET=SK, MATERIAL=ALU, OFFSET={offset}\n{size}\n"
    mesh = read(tmp_path, cards, ".inp", INP, length_unit="mm")
    at = np.array([POSITIONS[label] for label in (1, 2, 3, 4)], float)
    normal = np.cross(at[2] - at[0], at[3] - at[1])
    [found] = [item for item in mesh.parts if item.kind == "SHELL SECTION OFFSET"]
    expected = part * 1e-4 * normal / np.linalg.norm(normal)
    assert found.offsets[0].arms[0] == pytest.approx(np.tile(expected, (4, 1)), abs=1e-18)


def test_matrices_of_offset_shells_of_abaqus(tmp_path):
    mesh = read(tmp_path, "*SHELL SECTION, ELSET=SK, MATERIAL=ALU, OFFSET=0.5\n.01\n", ".inp", INP)
    at = np.array([POSITIONS[label] for label in (1, 2, 3, 4)], float)
    normal = np.cross(at[2] - at[0], at[3] - at[1])
    arms = dict.fromkeys((1, 2, 3, 4), -0.005 * normal / np.linalg.norm(normal))
    names, found = matrices(mesh, "SHELL SECTION OFFSET", lambda sound: [shell(sound.cells("SK"))])
    for matrix, wanted in zip(found, carried((1, 2, 3, 4), arms, shell, names), strict=True):
        assert np.abs(matrix - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_beams_of_calculix_stand_in_widths_off_their_nodes(tmp_path):
    # ccx 2.20 puts a beam along x with direction 1 along y, OFFSET1=0.5 and OFFSET2=0.25 at y = -0.1, z = -0.1
    head = "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n*ELEMENT, TYPE=B31, ELSET=BM\n1, 1, 2\n"
    cards = "*BEAM SECTION, ELSET=BM, MATERIAL=ALU, SECTION=RECT, OFFSET1=0.5, OFFSET2=0.25\n.2, .4\n0, 1, 0\n"
    [found] = read(tmp_path, cards, ".inp", head).parts
    assert found.offsets[0].arms == pytest.approx(np.tile([0, -0.1, -0.1], (1, 2, 1)))
    [found] = read(tmp_path, cards.replace("0, 1, 0", ", 1"), ".inp", head).parts  # blank words are 0
    assert found.offsets[0].arms == pytest.approx(np.tile([0, -0.1, -0.1], (1, 2, 1)))
    [found] = read(tmp_path, cards.replace("0, 1, 0", "1, 0, 0"), ".inp", head).parts
    assert found.obstacle == "its local direction 1 is along its axis, or one of them has no length"
    [found] = read(tmp_path, cards.replace("RECT", "PIPE"), ".inp", head).parts
    assert found.obstacle == "its section PIPE has no width"


def test_normals_of_shells_of_abaqus_are_those_of_nodes_unless_they_differ_much(tmp_path):
    head = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 2, 0, {height}
6, 2, 1, {height}
*ELEMENT, TYPE=S4, ELSET=SK
1, 1, 2, 3, 4
2, 2, 5, 6, 3
*SHELL SECTION, ELSET=SK, MATERIAL=ALU, OFFSET=SPOS
.1
"""
    (low,) = read(tmp_path, "", ".inp", head.format(height=0.2)).parts
    angle = np.arctan(0.2) / 2
    assert low.offsets[0].arms[0, 1] == pytest.approx([0.05 * np.sin(angle), 0, -0.05 * np.cos(angle)])
    assert low.offsets[0].arms[1, 0] == pytest.approx(low.offsets[0].arms[0, 1])
    (high,) = read(tmp_path, "", ".inp", head.format(height=1.0)).parts
    assert high.offsets[0].arms[0, 1] == pytest.approx([0, 0, -0.05])
    assert high.offsets[0].arms[1, 0] == pytest.approx([0.05 * 0.5**0.5, 0, -0.05 * 0.5**0.5])


def test_a_cell_of_two_sections_with_offsets_is_refused(tmp_path):
    section = "*SHELL SECTION, ELSET=SK, MATERIAL=ALU, OFFSET=0.5\n.01\n"
    mesh = read(tmp_path, 2 * section, ".inp", INP)
    with pytest.raises(InputError, match=r"the cell of nodes 1, 2, 3, 4 of a\.inp has two offsets"):
        require_sound(mesh, True, take="all")

"""Cells that stand off their nodes: matrices against those of cells at their true places, carried by arms written out here."""

import numpy as np
import pytest

from structid import Structure
from structid.core.dof import DIRECTIONS
from structid.core.errors import InputError
from structid.fem import Shell, SpaceBeam
from structid.fem.meshes import read_mesh, require_sound
from structid.fem.places import mesh_points
from structid.study.schema.study import load_study

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
    return [carry.T @ alone.matrix(law).toarray() @ carry for law in ("inertia", "elastic")]


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
    return names, [structure.matrix(law).toarray()[np.ix_(order, order)] for law in ("inertia", "elastic")]


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
    study = """[structure]
mesh = { path = "a.bdf", take = "all", orphan_nodes = "drop" }
[[structure.NAME]]
name = "skin"
youngs_modulus = 70e9
density = 2700.0
thickness = 0.01
poisson = 0.3
"""
    text = GRIDS.replace(",.1\n", ",0.\n").replace("2.,.5,1.", "1.,1.,0.") + "CQUAD4,7,1,1,2,5,4,,.03\nENDDATA\n"
    (tmp_path / "a.bdf").write_text(text)
    (tmp_path / "a.toml").write_text(study.replace("NAME", "shell"))
    assert len(load_study(tmp_path / "a.toml").structure.dofs) == 24
    (tmp_path / "a.toml").write_text(study.replace("NAME", "plate"))
    with pytest.raises(InputError, match="offsets of CQUAD4 offset need element sets that move in all six directions"):
        _ = load_study(tmp_path / "a.toml").structure

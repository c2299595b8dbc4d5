"""Fields of decks that are out of range, zero, blank or no number: no value is made of them in silence."""

import numpy as np
import pytest
from scipy import sparse

from structid.core.errors import FileError, InputError
from structid.fem.importers import ImportedMatrix, on_dofs, read_matrices
from structid.fem.importers.fixed_fields import FieldError, as_real, whole_numbers
from structid.fem.meshes import read_mesh

GRIDS = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
GRID,5,,2.,0.5,1.
CQUAD4,1,1,1,2,3,4
"""
PANEL = """*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0.1, 0.2, 0.3
*ELEMENT, TYPE=S3, ELSET=S
1, 1, 2, 3
"""


@pytest.fixture
def bulk(tmp_path):
    def read(cards):
        path = tmp_path / "a.bdf"
        path.write_text(f"{GRIDS}{cards}\nENDDATA\n")
        return read_mesh(path)

    return read


@pytest.fixture
def keywords(tmp_path):
    def read(lines):
        path = tmp_path / "a.inp"
        path.write_text(f"{PANEL}{lines}\n")
        return read_mesh(path)

    return read


def part_of(mesh, kind):
    [part] = [part for part in mesh.parts if part.kind == kind]
    return part


def test_points_that_only_rounding_keeps_off_a_line_make_no_axes(bulk, keywords):
    assert np.cross([0.1, 0.2, 0.3], [0.3, 0.6, 0.9]).any()
    with pytest.raises(FileError, match="coordinate system 7 lie on a line"):
        bulk("GRID,9,7,1.,0.,0.\nCORD2C,7,0,0.,0.,0.,0.1,0.2,0.3\n,0.3,0.6,0.9")
    for kind, points in (("R", "0.1, 0.2, 0.3, 0.3, 0.6, 0.9"), ("S", "0., 0., 0., 0.3, 0.6, 0.9")):
        with pytest.raises(FileError, match="the points of the system lie on a line"):
            keywords(f"*NSET, NSET=N\n4\n*TRANSFORM, NSET=N, TYPE={kind}\n{points}")


def test_a_system_of_points_on_a_line_is_refused_and_another_has_its_axes(tmp_path):
    path = tmp_path / "a.inp"
    path.write_text(f"*SYSTEM\n0., 0., 0., 0.1, 0.2, 0.3\n0.3, 0.6, 0.9\n{PANEL}")
    with pytest.raises(FileError, match="the points of the system lie on a line"):
        read_mesh(path)
    path.write_text(f"*SYSTEM\n0., 0., 0., 1., 1., 0.\n1., 1., 5.\n{PANEL}")
    half = np.sqrt(0.5)
    np.testing.assert_allclose(read_mesh(path).nodes[2], [half, half, 0.0], atol=1e-15)
    np.testing.assert_allclose(read_mesh(path).nodes[3], [half, half, 1.0], atol=1e-15)


def test_directions_of_transforms_are_those_of_their_points(keywords):
    turned = keywords("*NSET, NSET=N\n2\n*TRANSFORM, NSET=N, TYPE=R\n0., 2., 0., -3., 1., 0.")
    np.testing.assert_allclose(turned.displacement_axes[2], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    round_a_pole = keywords("*NSET, NSET=N\n3\n*TRANSFORM, NSET=N, TYPE=S\n1., 0., 0., 1., 0., 5.")
    np.testing.assert_allclose(round_a_pole.displacement_axes[3], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)


COMPONENT = "a component must be one digit from 1 to 6, got "
COMPONENTS = "components must be among 1 to 6, each once, got "


@pytest.mark.parametrize(
    "cards, why",
    [
        ("CBUSH,7,7,4,5,4\nPBUSH,7,K,1.,2.,3.", "its orientation is along its axis, or has no length"),
        ("CBUSH,7,7,4,5,0.,0.,0.\nPBUSH,7,K,1.,2.,3.", "its orientation is along its axis, or has no length"),
        ("CELAS2,8,5.,1,12", f"CELAS2 8 cannot be read: {COMPONENT}'12'"),
        ("CELAS2,8,5.,1,7", f"CELAS2 8 cannot be read: {COMPONENT}'7'"),
        ("CMASS2,8,5.,1,12", f"CMASS2 8 cannot be read: {COMPONENT}'12'"),
        ("CELAS2,8,5.,1_0,1", "CELAS2 8 cannot be read: '1_0' is no whole number"),
        ("MPC,1,5,12,1.,1,1,-1.", f"MPC 1 cannot be read: {COMPONENT}'12'"),
        ("MPC,1,5,1,0.,1,1,-1.", "the factor of its dependent term is 0"),
        ("MPC,1,5,1,1.,,1,-1.", "MPC 1 cannot be read: a term ', 1, -1.' has no grid point"),
        ("MPC,x,5,1,1.,1,1,-1.", "'X' is no number of a set"),
        ("RBE2,7,5,,1,2", f"RBE2 7 cannot be read: {COMPONENTS}''"),
        ("RBE2,7,5,11,1,2", f"RBE2 7 cannot be read: {COMPONENTS}'11'"),
        ("RBE2,7,5,123", "RBE2 7 cannot be read: it needs dependent nodes other than its main node 5"),
        ("RBE2,7,5,123,5,1", "RBE2 7 cannot be read: it needs dependent nodes other than its main node 5"),
        ("RBE2,7,5,123,2,THRU,4,BY,0", "RBE2 7 cannot be read: steps of 0 do not lead from 2 to 4"),
        ("RBE2,7,5,123,4,THRU,2", "RBE2 7 cannot be read: steps of 1 do not lead from 4 to 2"),
        ("CVISC,7,1,1,2\nPVISC,1,x", "its property 1 cannot be read: X"),
        ("CBUSH,7,7,4,5,,,,0\nPBUSH,7,K,x", "its property 7 cannot be read: X"),
        ("CBUSH1D,7,7,4,5\nPBUSH1D,7,x", "its property 7 cannot be read: X"),
        ("RBE2,7,5,123,1,-2", "it is at a scalar point, or a grid point that is not there"),
        ("RBE2,7,5,123,1,2.,3", "RBE2 7 cannot be read: '2.' is no whole number"),
        ("RBE3,7,,5,123,1.,123", "RBE3 7 cannot be read: the weight 1. has no nodes"),
        ("CBUSH,7,7,4,4,,,,0\nPBUSH,7,K,1.", "it joins a node with itself"),
        ("CBUSH,7,7,4,5,,,,0\n,1.5\nPBUSH,7,K,1.", "its spring stands beyond the ends"),
        (
            "CBUSH,7,7,4,5,,,,0\nPBUSH,7,1.,2.",
            "its property 7 cannot be read: 1. stands behind no K, B or GE, or is a seventh value",
        ),
        (
            "CBUSH,7,7,4,5,,,,0\nPBUSH,7,K,1.,2.,3.,4.,5.,6.\n,7.",
            "its property 7 cannot be read: 7. stands behind no K, B or GE, or is a seventh value",
        ),
        ("CONM2,8,1,,5.\nCONM2,8,2,,5.", "CONM2 8 stands twice, with other fields"),
        ("CELAS1,8,5,1,1\nPELAS,5,1.\nPELAS,5,2.", "its PELAS stands twice, with other fields"),
        ("CVISC,7,1,1,2\nPVISC,1,1.\nPVISC,1,2.\nPVISC,1,2.", "its PVISC stands twice, with other fields"),
    ],
)
def test_cards_with_odd_fields_are_obstacles_with_the_reason(bulk, cards, why):
    part = part_of(bulk(cards), cards.partition(",")[0])
    assert part.obstacle == why
    assert (part.springs, part.masses, part.ties) == ((), (), ())


@pytest.mark.parametrize(
    "card, word", [("PVISC,1.0,3.", "1.0"), ("PELAS,x,3.", "X"), ("PMASS,,3.", ""), ("PBUSH,x,K,3.", "X")]
)
def test_a_property_without_a_number_is_listed_and_others_are_read(bulk, card, word):
    mesh = bulk(f"{card}\nPELAS,5,7.\nCELAS1,8,5,1,1")
    assert part_of(mesh, card.partition(",")[0]).obstacle == f"it has {word!r} for its number"
    assert [spring.stiffness for spring in part_of(mesh, "CELAS1").springs] == [7.0]


def test_a_card_that_stands_twice_counts_once(bulk):
    part = part_of(bulk("CONM2,8,1,,5.\nCONM2,9,1,,3.\nCONM2,8,1,,5."), "CONM2")
    assert (part.count, part.mass, part.obstacle) == (2, 8.0, "")


def test_loss_factors_of_bushings_are_those_of_their_directions(bulk):
    cards = "CBUSH,7,7,1,2,,,,0\nPBUSH,7,K,1.,2.,3.\n,,GE,"
    for losses, expected in (("0.1", [0.1, 0.1, 0.1]), ("0.1,0.2", [0.1, 0.2, 0.0])):
        springs = part_of(bulk(cards + losses), "CBUSH").springs
        assert [(spring.stiffness, spring.loss_factor) for spring in springs] == list(
            zip([1, 2, 3], expected, strict=True)
        )


@pytest.mark.parametrize(
    "card, nodes",
    [("RBE2,7,1,3,2,2,5,1.-5,20.", (2, 5)), ("RBE2,7,1,3,2,5,6.5-6", (2, 5)), ("RBAR,7,1,2,123456,0,0,3", (2,))],
)
def test_nodes_named_twice_expansion_and_zeros_leave_rigid_elements_as_they_are(bulk, card, nodes):
    ties = part_of(bulk(card), card.partition(",")[0]).ties
    assert tuple(str(tie.dependent) for tie in ties) == tuple(f"{node}Z+" for node in nodes)


def test_a_blank_property_is_that_of_the_number_of_the_element(bulk):
    mesh = bulk("PELAS,8,7.\nPDAMP,9,3.\nCELAS1,8,,1,1\nCDAMP1,9,,1,1")
    assert [(spring.stiffness, spring.set_name) for spring in part_of(mesh, "CELAS1").springs] == [(7.0, "8")]
    assert [spring.damping for spring in part_of(mesh, "CDAMP1").springs] == [3.0]


@pytest.mark.parametrize("word", ["", "0.", "-1.", "x"])
def test_a_factor_of_masses_that_is_not_above_0_is_refused(bulk, word):
    with pytest.raises(FileError, match=f"PARAM,WTMASS with the value '{word.upper()}'"):
        bulk(f"PARAM,WTMASS,{word}\nCONM2,8,1,,5.")


@pytest.mark.parametrize("word", ["NAN", "inf", "-Infinity", "1e999", "-", "+", "1_0"])
def test_words_that_are_no_finite_number_are_no_field(bulk, word):
    with pytest.raises(FieldError):
        as_real(word.encode())
    part = part_of(bulk(f"CONM2,8,1,,{word}"), "CONM2")
    assert part.obstacle == f"CONM2 8 cannot be read: {word.upper()}"
    with pytest.raises(FileError, match="line 8: field 4 must be a real number"):
        bulk(f"GRID,9,,{word},0.,0.")


def test_a_sign_alone_is_no_whole_number():
    fields = np.array([b"   12", b"  -12", b"     ", b"  -  "], dtype="S5")
    table = fields.view(np.uint8).reshape(4, 5)
    assert whole_numbers(table[:3]).tolist() == [12, -12, 0]
    with pytest.raises(FieldError) as caught:
        whole_numbers(table)
    assert (caught.value.index, caught.value.text) == (3, "-")


def test_rows_without_a_diagonal_entry_are_counted(tmp_path):
    (tmp_path / "a.dof").write_text("1.1\n1.2\n1.3\n")
    (tmp_path / "a.sti").write_text("1 1 2.0\n2 3 1.0\n3 3 2.0\n")
    with pytest.raises(FileError, match="diagonal entries of 1 of its 3 rows, the first of row 2"):
        read_matrices(tmp_path / "a.sti")


def test_a_rectangular_matrix_has_no_place_on_degrees_of_freedom():
    table = np.array([[1, 1], [1, 2], [1, 3]])
    rectangular = ImportedMatrix("B", sparse.csc_array(np.arange(6.0).reshape(3, 2)), table, table[1:])
    with pytest.raises(InputError, match=r"'B' has columns \(2\) that are not its rows \(3\)"):
        on_dofs(rectangular, table)


def test_the_nearest_of_no_nodes_is_refused(bulk):
    mesh = bulk("")
    assert mesh.nearest([0.9, 0.1, 0.0])[0] == 2
    for among in ([], [77]):
        with pytest.raises(InputError, match=r"no node of a\.bdf to choose the nearest from"):
            mesh.nearest([0.9, 0.1, 0.0], among)


@pytest.mark.parametrize("text", ["ENDDATA\n", "SOL 103\nCEND\nBEGIN BULK\nENDDATA\n", "\n"])
def test_a_deck_of_nothing_says_so(tmp_path, text):
    (tmp_path / "a.bdf").write_text(text)
    with pytest.raises(FileError, match="holds no GRID"):
        read_mesh(tmp_path / "a.bdf")


FREEDOM = "cannot be read: a degree of freedom must be one from 1 to 6, got "
SPRING = "*ELEMENT, TYPE=SPRING1, ELSET=K\n9, 2\n*SPRING, ELSET=K\n"
DASHPOT = "*ELEMENT, TYPE=DASHPOT2, ELSET=K\n9, 2, 3\n*DASHPOT, ELSET=K\n"
COUPLING = "*SURFACE, NAME=F, TYPE=NODE\n1\n2\n*COUPLING, REF NODE=4, SURFACE=F, CONSTRAINT NAME=C\n*KINEMATIC\n"


@pytest.mark.parametrize(
    "lines, kind, why",
    [
        *((f"{SPRING}{word}\n5.", "SPRING", f"line 10 {FREEDOM}'{word}'") for word in ("7", "8", "0", "-1")),
        (f"{SPRING}2\nNAN", "SPRING", "line 10 cannot be read: 'NAN' is no finite number"),
        (f"{DASHPOT}1, 7\n5.", "DASHPOT", f"line 10 {FREEDOM}'7'"),
        (f"{DASHPOT.replace('2, 3', '2, 2')}1, 1\n5.", "DASHPOT", "it joins a component with itself"),
        ("*EQUATION\n2\n4, 0, 1., 1, 1, -1.", "EQUATION", "it works on no displacement"),
        ("*EQUATION\n2\n4, 1, 1., 1, -1, -1.", "EQUATION", "it works on no displacement"),
        ("*EQUATION\n2\n4, 1, 0., 1, 1, -1.", "EQUATION", "the factor of its dependent term is 0"),
        ("*EQUATION\n2\n4, 1, 1., 1, 1, INF", "EQUATION", "line 8 cannot be read: 'INF' is no finite number"),
        *(
            (f"*KINEMATIC COUPLING, REF NODE=4\n1, {word}", "KINEMATIC COUPLING", f"line 8 {FREEDOM}'{wrong}'")
            for word, wrong in (("7", "7"), ("0", "0"), (" , 3", ""))
        ),
        (
            "*KINEMATIC COUPLING, REF NODE=4\n1, 6, 1",
            "KINEMATIC COUPLING",
            "line 8 cannot be read: degrees of freedom from 6 to 1 are none",
        ),
        ("*EQUATION\n2.5\n4, 1, 1., 1, 1, -1.", "EQUATION", "line 8 cannot be read: an equation has 2.5 terms"),
        ("*EQUATION\n0", "EQUATION", "line 8 cannot be read: an equation has 0 terms"),
        (
            "*EQUATION\n2\n4, 1, 1., 1, 1, -1., 2, 1, -1.",
            "EQUATION",
            "line 8 cannot be read: an equation of 2 terms has 9 words instead of 6",
        ),
        ("*MPC\nTIE, 2, 2", "MPC", "line 8 cannot be read: it ties node 2 to itself"),
        ("*MPC\nPIN, 2, 3, 4", "MPC", "line 8 cannot be read: type PIN needs two nodes or sets, got 3"),
        ("*RIGID BODY, REF NODE=4", "RIGID BODY", "it has no nodes but its reference node"),
        ("*KINEMATIC COUPLING, REF NODE=4\n4, 1", "KINEMATIC COUPLING", "it has no nodes but its reference node"),
        (f"{COUPLING}1, 7", "COUPLING", f"line 11 {FREEDOM}'7'"),
        (
            "*SHELL SECTION, ELSET=S, OFFSET=NAN\n0.1",
            "SHELL SECTION OFFSET",
            "its offset 'NAN' is a distribution, or no number",
        ),
        (
            "*ELEMENT, TYPE=B31, ELSET=B\n7, 1, 2\n*BEAM SECTION, SECTION=RECT, ELSET=B, OFFSET1=0.5\n0.1, 0.1\n0., 0., 0.",
            "BEAM SECTION OFFSET",
            "its local direction 1 is along its axis, or one of them has no length",
        ),
    ],
)
def test_keywords_with_odd_words_are_obstacles_with_the_reason(keywords, lines, kind, why):
    part = part_of(keywords(lines), kind)
    assert part.obstacle == why
    assert (part.springs, part.masses, part.ties, part.offsets) == ((), (), (), ())


def test_ranges_of_degrees_of_freedom_are_those_of_the_line(keywords):
    for words, expected in (("2", ["1Y+"]), ("2, 3", ["1Y+", "1Z+"])):
        part = part_of(keywords(f"*KINEMATIC COUPLING, REF NODE=4\n1, {words}"), "KINEMATIC COUPLING")
        assert [str(tie.dependent) for tie in part.ties] == expected
    [link] = part_of(keywords("*KINEMATIC COUPLING, REF NODE=4\n1,"), "KINEMATIC COUPLING").ties
    assert (link.main, link.dependents) == (4, (1,))


def test_factors_of_a_degree_of_freedom_that_is_named_twice_add_up(bulk, keywords):
    for mesh, kind in (
        (bulk("MPC,1,5,1,1.,1,1,-6.\n,,5,1,2."), "MPC"),
        (keywords("*EQUATION\n3\n3, 1, 1., 1, 1, -6., 3, 1, 2."), "EQUATION"),
    ):
        [tie] = part_of(mesh, kind).ties
        assert [(str(dof), factor) for dof, factor in tie.depends_on] == [("1X+", 2.0)]

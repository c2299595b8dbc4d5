"""What decks say in places where nobody looks, and what they say twice: read, or said."""

import pytest

from structid.core.errors import FileError
from structid.fem.meshes import describe_unassigned_cells, read_mesh

GRIDS = """GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
CQUAD4,1,1,1,2,3,4
"""
PANEL = "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n*ELEMENT,TYPE=S4,ELSET=S\n1,1,2,3,4\n"


def read(tmp_path, text, suffix=".bdf"):
    path = tmp_path / f"a{suffix}"
    path.write_text(text)
    return read_mesh(path)


def part_of(mesh, kind):
    return next(part for part in mesh.parts if part.kind == kind)


@pytest.mark.parametrize("line", ["PARAM,WTMASS,.00259", "param  wtmass  2.59-3", "  PARAM, WTMASS , 2.59E-3 $ lbf"])
def test_the_factor_of_masses_may_stand_in_case_control(tmp_path, line):
    mesh = read(tmp_path, f"SOL 103\nCEND\n{line}\nBEGIN BULK\n{GRIDS}CONM2,9,1,,500.\nENDDATA\n")
    assert part_of(mesh, "CONM2").mass == pytest.approx(1.295)


def test_two_factors_of_masses_are_refused(tmp_path):
    with pytest.raises(FileError, match=r"PARAM,WTMASS with the values \.1, \.2"):
        read(tmp_path, f"BEGIN BULK\nPARAM,WTMASS,.1\nPARAM,WTMASS,.2\n{GRIDS}ENDDATA\n")


def test_sets_of_constraints_that_a_set_names_are_taken_together(tmp_path):
    cards = "MPCADD,100,1,2\nMPC,1,2,1,1.,1,1,-1.\nMPC,2,3,1,1.,2,1,-.5\nMPC,3,4,1,1.,2,1,-1.\n"
    mesh = read(tmp_path, f"SOL 103\nCEND\nMPC=100\nBEGIN BULK\n{GRIDS}{cards}ENDDATA\n")
    ties = part_of(mesh, "MPC").ties
    assert [(str(tie.dependent), [(str(dof), c) for dof, c in tie.depends_on]) for tie in ties] == [
        ("2X+", [("1X+", 1.0)]),
        ("3X+", [("2X+", 0.5)]),
    ]
    unclear = read(tmp_path, f"BEGIN BULK\n{GRIDS}{cards}ENDDATA\n")
    assert part_of(unclear, "MPC").obstacle == "it is not clear which set of MPC is meant"


def test_elements_that_stand_twice_count_once_or_are_refused(tmp_path):
    mesh = read(tmp_path, f"BEGIN BULK\n{GRIDS}CQUAD4*,1,1,1,2\n*,3,4\nENDDATA\n")
    assert len(mesh.cells()) == 1
    with pytest.raises(FileError, match="CQUAD4 1 stands twice, with other fields"):
        read(tmp_path, f"BEGIN BULK\n{GRIDS}CQUAD4,1,2,1,2,3,4\nENDDATA\n")


@pytest.mark.parametrize(
    "cards, kind, why",
    [
        (
            "CBUSH,5,6,1,2,,,,0\nPBUSH,6,K,1.\nPBUSHT,6,K,4\n",
            "CBUSH",
            "its values depend on frequency or force (PBUSHT, PDAMPT, PELAST)",
        ),
        (
            "CELAS1,5,6,1,1\nPELAS,6,1.\nPELAST,6,4\n",
            "CELAS1",
            "its values depend on frequency or force (PBUSHT, PDAMPT, PELAST)",
        ),
        (
            "CDAMP1,5,6,1,1\nPDAMP,6,1.\nPDAMPT,6,4\n",
            "CDAMP1",
            "its values depend on frequency or force (PBUSHT, PDAMPT, PELAST)",
        ),
    ],
)
def test_springs_of_tables_are_listed(tmp_path, cards, kind, why):
    assert part_of(read(tmp_path, f"BEGIN BULK\n{GRIDS}{cards}ENDDATA\n"), kind).obstacle == why


def test_supports_of_grid_points_are_said(tmp_path):
    mesh = read(tmp_path, "BEGIN BULK\n" + GRIDS.replace("0.,1.,0.\n", "0.,1.,0.,,123456\n") + "ENDDATA\n")
    assert mesh.notes == ("its PS of grid points are not read: supports are those of the study",)


def test_elements_of_a_users_own_belong_to_no_element_set(tmp_path):
    mesh = read(tmp_path, PANEL + "*USER ELEMENT,TYPE=U1,NODES=2\n1,2\n*ELEMENT,TYPE=U1,ELSET=U\n20,1,2\n", ".inp")
    assert describe_unassigned_cells(mesh, [mesh.cells("S")]) == "1 cells (U1), in group U"


@pytest.mark.parametrize("keyword", ["MASS ADJUST", "MODEL CHANGE"])
def test_keywords_that_change_masses_are_listed(tmp_path, keyword):
    assert part_of(read(tmp_path, PANEL + f"*{keyword}, ELSET=S\n5.\n", ".inp"), keyword).obstacle


@pytest.mark.parametrize(
    "head, obstacle",
    [
        ("SOL 103\nCEND\nBEGIN BULK\n", "case control asks for no set of MPC (`MPC = ...`)"),
        ("SOL 103\nCEND\nMPC = 7\nBEGIN BULK\n", ""),
        ("SOL 103\nCEND\nSUBCASE 1\n  MPC=7\nBEGIN BULK\n", ""),
        ("BEGIN BULK\n", ""),
        ("", ""),
    ],
)
def test_constraints_that_case_control_does_not_ask_for_are_none(tmp_path, head, obstacle):
    mesh = read(tmp_path, f"{head}{GRIDS}MPC,7,2,1,1.,1,1,-1.\n")
    assert part_of(mesh, "MPC").obstacle == obstacle


@pytest.mark.parametrize(
    "cards, kind, why",
    [
        (", COMPLEX STIFFNESS\n2\n100.,5.", "SPRING", "its stiffness has a loss"),
        ("\n2\n100.,10.\n200.,20.", "SPRING", "its values depend on frequency, temperature or fields"),
        (
            ", DEPENDENCIES=1\n2\n100.,,,1.\n200.,,,2.",
            "SPRING",
            "its values depend on frequency, temperature or fields",
        ),
        ("\n2\n100.", "SPRING", ""),
        ("\n2\n100.\n*BEAM ADDED INERTIA\n2.", "BEAM ADDED INERTIA", "mass along beams; add it to the density"),
        ("\n2\n100.\n*FOUNDATION\nS,F1,1e5", "FOUNDATION", "elastic foundations"),
    ],
)
def test_springs_of_tables_and_masses_along_beams_are_listed(tmp_path, cards, kind, why):
    text = f"{PANEL}*ELEMENT,TYPE=SPRING1,ELSET=K\n9,2\n*SPRING,ELSET=K{cards}\n"
    part = part_of(read(tmp_path, text, ".inp"), kind)
    assert part.obstacle == why
    if not why:
        assert [spring.stiffness for spring in part.springs] == [100.0]


def test_nodes_with_decimal_commas_are_refused(tmp_path):
    """Read as Abaqus reads them, these would be other places, without a word."""
    nodes = (
        PANEL.replace("2,1,0,0", "2,1,5,0,0,0,0")
        .replace("3,1,1,0", "3,1,5,1,5,0,0")
        .replace("1,0,0,0", "1,0,0,0,0,0,0")
    )
    with pytest.raises(FileError, match=r"node 1 has 6 numbers and none has a decimal point.*with commas"):
        read(tmp_path, nodes, ".inp")
    flat = PANEL.replace("3,1,1,0", "3,0,5,1,5")
    with pytest.raises(FileError, match=r"node 3 has 4 numbers and none has a decimal point"):
        read(tmp_path, flat, ".inp")
    normals = "*NODE\n1,0,0,0,0,0,1\n2,1,0,0,0,-1,0\n3,1,1,0,1,1,0\n4,0,1,0,,,\n" + PANEL.partition("4,0,1,0\n")[2]
    assert len(read(tmp_path, normals, ".inp").labels) == 4


def test_continuations_behind_another_card_are_refused(tmp_path):
    """They would be taken for lines of that card, and the inertia of this mass for none."""
    mass = "CONM2   9       3       0       2.      .1      .2      .3              +C9\n"
    inertia = "+C9     1.              2.                      3.\n"
    here = read(tmp_path, f"BEGIN BULK\n{GRIDS}{mass}{inertia}GRID,11,,0.,0.,1.\nENDDATA\n")
    assert part_of(here, "CONM2").masses[0].matrix[5, 5] == pytest.approx(3 + 2 * (0.1**2 + 0.2**2))
    for between in ("GRID,11,,0.,0.,1.\n", "GRID    11              0.      0.      1.\n", "PSHELL,1,1,.01\n"):
        with pytest.raises(FileError, match=r"line 9: goes on with mark 'C9'.*put each line behind the one"):
            read(tmp_path, f"BEGIN BULK\n{GRIDS}{mass}{between}{inertia}ENDDATA\n")


@pytest.mark.parametrize(
    ("placing", "place"),
    [
        (",,2.5\n", (1, 0, 2.5)),
        ("1.,0.,0.,\n0.,0.,0.,0.,0.,1.,90.,\n", (0, 2, 0)),
        (",,\n0.,0.,0.,0.,0.,1.,90.\n", (0, 1, 0)),
        ("0.,0.,0.,0.,0.,1.,90.\n", (0, 1, 0)),
    ],
)
def test_blanks_in_the_place_of_an_instance_are_noughts(tmp_path, placing, place):
    text = f"*PART,NAME=P\n{PANEL}*END PART\n*ASSEMBLY,NAME=A\n*INSTANCE,NAME=P-1,PART=P\n{placing}*END INSTANCE\n*END ASSEMBLY\n"
    assert read(tmp_path, text, ".inp").nodes[2] == pytest.approx(place)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "*PARAMETER\na=2.\n" + PANEL.replace("2,1,", "2,<a>,"),
            r"line 3: \*NODE has <a>, and \*PARAMETER is not evaluated; write numbers",
        ),
        ("*PARAMETER\nn=4\n" + PANEL + "*NSET,NSET=T,GENERATE\n1,<n>\n", r"line 10: \*NSET has <n>, and"),
        (PANEL.replace("*ELEMENT", "*ELEM"), r"\*ELEM is short for \*ELEMENT; write it in full"),
        (PANEL + "*TRANS, NSET=T\n1.,0.,0.,0.,1.,0.\n", r"\*TRANS is short for \*TRANSFORM"),
    ],
)
def test_parameters_and_short_keywords_are_refused(tmp_path, text, words):
    with pytest.raises(FileError, match=words):
        read(tmp_path, text, ".inp")


def test_parameters_that_no_line_of_the_mesh_uses_are_passed_over(tmp_path):
    text = f"*PARAMETER\nE=70e9\nm=2.\n{PANEL}*ELASTIC\n<E>,0.3\n*ELEMENT,TYPE=MASS,ELSET=M\n2,1\n*MASS,ELSET=M\n{{}}\n"
    assert part_of(read(tmp_path, text.format("2."), ".inp"), "MASS").obstacle == ""
    assert "'<m>'" in part_of(read(tmp_path, text.format("<m>"), ".inp"), "MASS").obstacle


def test_a_reference_node_may_be_spelt_as_calculix_takes_it(tmp_path):
    text = PANEL + "*NODE\n9,.5,.5,1.\n*NSET,NSET=N\n1,2\n*SURFACE,TYPE=NODE,NAME=SF\nN,\n"
    ties = [
        part_of(
            read(tmp_path, f"{text}*COUPLING,SURFACE=SF,{key}=9,CONSTRAINT NAME=C\n*KINEMATIC\n", ".inp"), "COUPLING"
        ).ties
        for key in ("REF NODE", "refnode")
    ]
    assert ties[0]
    assert ties[0] == ties[1]

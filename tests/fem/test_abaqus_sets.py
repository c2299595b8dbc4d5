"""Sets, element lines and systems of Abaqus and CalculiX decks: members by hand, and what has no clear members."""

import numpy as np
import pytest

from structid.core.errors import FileError
from structid.fem.meshes import read_mesh
from structid.fem.meshes.abaqus_assembly import Assembly, PartData

PANEL = "*NODE\n1,0.,0,0\n2,1.,0,0\n3,1.,1,0\n4,0.,1,0\n*ELEMENT,TYPE=S4,ELSET=S\n1,1,2,3,4\n"
ASSEMBLY = (
    f"*PART,NAME=P\n{PANEL}*END PART\n*ASSEMBLY,NAME=A\n*INSTANCE,NAME=P-1,PART=P\n*END INSTANCE\n"
    "*INSTANCE,NAME=P-2,PART=P\n3.,0.,0.\n*END INSTANCE\n*NODE\n1,.5,.5,2.\n{}*END ASSEMBLY\n"
)


def read(tmp_path, text, length_unit="m"):
    path = tmp_path / "a.inp"
    path.write_text(text)
    return read_mesh(path, length_unit)


def part_of(mesh, kind):
    return next(part for part in mesh.parts if part.kind == kind)


@pytest.mark.parametrize(
    ("row", "members"),
    [
        ("1,4", [1, 2, 3, 4]),
        ("1,4,", [1, 2, 3, 4]),
        ("2,4,2", [2, 4]),
        ("4,1,-1", [1, 2, 3, 4]),
        ("4,2,-2", [2, 4]),
        ("3,3", [3]),
        ("3,3,0", [3]),
        ("2,9", [2, 3, 4]),
    ],
)
def test_ranges_hold_both_ends_and_pass_over_numbers_that_are_not_there(tmp_path, row, members):
    mesh = read(tmp_path, f"{PANEL}*NSET,NSET=N,GENERATE\n{row}\n")
    assert mesh.group_nodes("N").tolist() == members
    assert not mesh.notes


@pytest.mark.parametrize("row", ["4,1", "1,4,0", "1,4,2", "1,4,-1", "1", "1,,2", "1,2,1,3,4,1"])
@pytest.mark.parametrize("keyword", ["NSET", "ELSET"])
def test_ranges_whose_members_are_not_clear_are_refused(tmp_path, keyword, row):
    """Abaqus wants a whole number of steps; CalculiX takes the last label besides and the first of a range backwards."""
    with pytest.raises(FileError, match=rf"line 8: cannot read the lines of \*{keyword} \((steps of|a range is)"):
        read(tmp_path, f"{PANEL}*{keyword},{keyword}=N,GENERATE\n{row}\n")


def test_labels_of_sets_that_are_not_there_are_said(tmp_path):
    mesh = read(tmp_path, f"{PANEL}*NSET,NSET=N\n1,7,8\n*ELSET,ELSET=E\n1,5\n")
    assert mesh.group_nodes("N").tolist() == [1]
    assert mesh.notes == (
        "*NSET N names node 7, 8, which the file does not have: left out",
        "*ELSET E names element 5, which the file does not have: left out",
    )
    sets = "*NSET,NSET=N,INSTANCE=P-2\n1,9\n*NSET,NSET=N\nP-1.2,3\n"
    mesh = read(tmp_path, ASSEMBLY.format(sets))
    assert mesh.group_nodes("N").tolist() == [2, 11]
    assert "*NSET N names node 9 of P-2, which the file does not have: left out" in mesh.notes
    assert "*NSET N names node 3, which the file does not have: left out" in mesh.notes


def test_sets_of_an_assembly_hold_what_each_word_names(tmp_path):
    """A label is one of the instance that the keyword names, also beside words of other instances and of the assembly."""
    sets = (
        "*NSET,NSET=RP\n1\n*NSET,NSET=MIX,INSTANCE=P-2\n2,P-1.3,RP\n*ELSET,ELSET=E,INSTANCE=P-2\n1\n"
        "*NSET,NSET=OF,ELSET=E\n*NSET,NSET=ONE,INSTANCE=P-1,ELSET=S\n*NSET,NSET=R,INSTANCE=P-2,GENERATE\n2,4,2\n"
    )
    mesh = read(tmp_path, ASSEMBLY.format(sets))
    assert mesh.nodes[12] == pytest.approx([4, 0, 0])
    assert mesh.group_nodes("MIX").tolist() == [3, 12, 21]
    assert mesh.group_nodes("OF").tolist() == [11, 12, 13, 14]
    assert mesh.group_nodes("ONE").tolist() == [1, 2, 3, 4]
    assert mesh.group_nodes("R").tolist() == [12, 14]


def test_an_element_that_lacks_a_node_does_not_take_the_next_label(tmp_path):
    hexahedron = "*NODE\n" + "".join(f"{n},{n * 0.1},0.,{n}.\n" for n in range(1, 21))
    short = f"{hexahedron}*ELEMENT,TYPE=C3D8\n1,1,2,3,4,5,6,7\n2,9,10,11,12,13,14,15,16\n"
    with pytest.raises(FileError, match=r"element 1 of 8 nodes has 16 on 2 lines, as where one is missing"):
        read(tmp_path, short)
    lines = "1," + ",".join(map(str, range(1, 11))) + ",\n" + ",".join(map(str, range(11, 20)))
    twenty = f"{hexahedron}*ELEMENT,TYPE=C3D20\n{lines}{{}}\n2," + ",".join(map(str, range(1, 21))) + "\n"
    with pytest.raises(FileError, match=r"element 1 of 20 nodes has 40 on 3 lines"):
        read(tmp_path, twenty.format(","))
    assert len(read(tmp_path, twenty.format(",20,")).cells()) == 2


def test_springs_whose_lines_end_in_a_comma_are_as_many_as_their_lines(tmp_path):
    text = f"{PANEL}*ELEMENT,TYPE=SPRING1,ELSET=K\n5,2,\n6,3,\n*ELEMENT,TYPE=SPRINGA,ELSET=L\n7,1,3,\n8,2,4,\n"
    mesh = read(tmp_path, f"{text}*SPRING,ELSET=K\n1\n5.\n*SPRING,ELSET=L\n\n7.\n")
    springs = [spring for part in mesh.parts for spring in part.springs]
    assert [sorted({node for node, _ in spring.weights}) for spring in springs] == [[2], [3], [1, 3], [2, 4]]


@pytest.mark.parametrize("kind", ["CONN3D2", "CONN2D2", "JOINTC"])
@pytest.mark.parametrize("rows", ["10,1\n11,2\n", "10,1,\n11,,2\n", "10,1,2\n11,3\n"])
def test_connectors_to_the_ground_have_one_node_a_line(tmp_path, kind, rows):
    part = part_of(read(tmp_path, f"{PANEL}*ELEMENT,TYPE={kind},ELSET=C\n{rows}"), kind)
    assert (part.count, part.obstacle) == (2, "no element for it")


def test_lines_without_words_are_no_lines_of_an_element(tmp_path):
    mesh = read(tmp_path, PANEL.replace("1,1,2,3,4\n", ",\n1,1,2,3,4,5\n"))
    assert mesh.blocks[0].nodes.tolist() == [[1, 2, 3, 4]]
    assert "lines of S4 name more nodes than it has" in mesh.notes[0]


def test_ranges_are_gone_through_once_for_all_sets():
    class Counted(list):
        n_rounds = 0

        def __iter__(self):
            self.n_rounds += 1
            return super().__iter__()

    ranges = Counted([("NSET", range(10 * k, 10 * k + 4)) for k in range(50)])
    sets = {str(k): set(passed) | {7000 + k} for k, (_, passed) in enumerate(ranges)}
    ranges.n_rounds = 0
    assembly = Assembly([PartData("", {0: [0.0, 0.0, 0.0]}, node_sets=sets, ranges=ranges)])
    assembly.number()
    sentences = assembly.drop_unknown()
    assert ranges.n_rounds == 1
    assert sentences[3] == "*NSET 3 names node 7003, which the file does not have: left out"
    assert [len(labels) for labels in sets.values()] == [1] + 49 * [0]


@pytest.mark.parametrize("system", ["C", "c", "CYLINDRICAL"])
def test_cylindrical_nodes_are_named_by_a_letter_or_in_full(tmp_path, system):
    text = PANEL.replace("*NODE\n", f"*NODE,SYSTEM={system}\n").replace("2,1.,0,0", "2,2.,90.,0")
    assert read(tmp_path, text).nodes[2] == pytest.approx([0, 2, 0])


@pytest.mark.parametrize("system", ["CARTESIAN", "S", "CART", "RC", "RADIAL"])
def test_other_systems_of_nodes_are_refused(tmp_path, system):
    with pytest.raises(FileError, match=f"coordinates of SYSTEM={system} are not read"):
        read(tmp_path, PANEL.replace("*NODE\n", f"*NODE,SYSTEM={system}\n"))
    with pytest.raises(FileError, match="there is no TYPE=CARTESIAN; write R, C or S"):
        read(tmp_path, PANEL + "*NSET,NSET=N\n1\n*TRANSFORM,NSET=N,TYPE=CARTESIAN\n1.,0.,0.,0.,1.,0.\n")


def test_cylindrical_directions_turn_about_the_axis_of_the_deck_in_its_unit(tmp_path):
    """The axis goes through (500, 0, 0) mm; node 4 at (0, 1000, 0) mm lies 500 mm off in -x and 1000 mm in y."""
    nodes = PANEL.replace("1.", "1000.").replace(",1,0", ",1000.,0").replace("1000.,1,", "1000.,1000.,")
    text = f"{nodes}*NSET,NSET=N\n4\n*TRANSFORM,NSET=N,TYPE=C\n500.,0.,0.,500.,0.,100.\n"
    mesh = read(tmp_path, text, "mm")
    assert mesh.displacement_axes[4][0] == pytest.approx(np.array([-1, 2, 0]) / np.sqrt(5))


def test_directions_of_a_part_go_with_its_instance(tmp_path):
    """The part's axis is at its node 1; the instance moves that to (5, 0, 0) and turns it by 90 degrees about z."""
    part = f"{PANEL}*NSET,NSET=N\n3\n*TRANSFORM,NSET=N,TYPE=C\n0.,0.,0.,0.,0.,1.\n"
    text = (
        f"*PART,NAME=P\n{part}*END PART\n*ASSEMBLY,NAME=A\n*INSTANCE,NAME=I,PART=P\n5.,0.,0.\n5.,0.,0.,5.,0.,1.,90.\n"
    )
    mesh = read(tmp_path, f"{text}*END INSTANCE\n*END ASSEMBLY\n")
    assert mesh.nodes[3] == pytest.approx([4, 1, 0])
    assert mesh.displacement_axes[3][0] == pytest.approx(np.array([-1, 1, 0]) / np.sqrt(2))


def test_keywords_without_blanks_are_those_of_calculix(tmp_path):
    """CalculiX takes blanks out of every line before it reads it."""
    text = PANEL + "*NODE\n9,.5,.5,1.\n*NSET,NSET=N\n1,2\n*RIGIDBODY,TIENSET=N,REFNODE=9\n"
    [link] = part_of(read(tmp_path, text), "RIGID BODY").ties
    assert (link.main, link.dependents) == (9, (1, 2))
    assert part_of(read(tmp_path, PANEL + "*CONTACTPAIR,INTERACTION=I\nA,B\n"), "CONTACT PAIR").count == 1


def test_a_reference_node_that_the_solver_moves_is_said(tmp_path):
    text = PANEL + "*NODE\n9,.5,.5,1.\n*RIGID BODY,ELSET=S,REF NODE=9,POSITION={}\n"
    assert part_of(read(tmp_path, text.format("INPUT")), "RIGID BODY").obstacle == ""
    moved = part_of(read(tmp_path, text.format("CENTER OF MASS")), "RIGID BODY")
    assert moved.obstacle == "its reference node is moved to the centre of mass"


def test_coordinates_may_have_exponents_of_fortran(tmp_path):
    mesh = read(tmp_path, PANEL.replace("2,1.,0,0", "2,2.5D+00,1.0d-1,"))
    assert mesh.nodes[2].tolist() == [2.5, 0.1, 0.0]


def test_names_in_quotes_are_found_with_their_instance(tmp_path):
    text = ASSEMBLY.format('*NSET,NSET=N\n"P-2".2,\n"P-1.3"\n').replace("NAME=P-2", 'NAME="P-2"')
    assert read(tmp_path, text).group_nodes("N").tolist() == [3, 12]


def test_the_middle_of_a_quadratic_line_stands_last(tmp_path):
    mesh = read(tmp_path, "*NODE\n1,0.,0.,0.\n2,1.,0.,0.\n3,.5,0.,0.\n*ELEMENT,TYPE=B32\n1,1,3,2\n")
    assert [(block.kind, block.nodes.tolist()) for block in mesh.blocks] == [("line3", [[1, 2, 3]])]


@pytest.mark.parametrize(("rows", "weights"), [("1,5.\n2,1.\n3,1.\n4,1.\n", {1: 0.625, 2: 0.125, 3: 0.125, 4: 0.125}),
                                             ("1\n2\n3\n4\n", dict.fromkeys((1, 2, 3, 4), 0.25)),
                                             ("1,1.\n2,1.\n3\n4,1.\n", dict.fromkeys((1, 2, 4), 1 / 3))])  # fmt: skip
def test_surfaces_of_nodes_weigh_a_mean_as_they_say(tmp_path, rows, weights):
    """The reference node stands above the weighted middle of the panel, so that its z motion is the mean."""
    at = sum(
        np.array(weight) * np.array([[0, 0], [1, 0], [1, 1], [0, 1]][node - 1]) for node, weight in weights.items()
    )
    text = f"{PANEL}*NODE\n9,{at[0]:.17g},{at[1]:.17g},1.\n*SURFACE,TYPE=NODE,NAME=F\n{rows}"
    part = part_of(
        read(tmp_path, text + "*COUPLING,CONSTRAINT NAME=C,REF NODE=9,SURFACE=F\n*DISTRIBUTING\n"), "COUPLING"
    )
    assert part.obstacle == ""
    along_z = {dof.node: weight for dof, weight in part.ties[2].depends_on if abs(weight) > 1e-12}
    assert along_z == pytest.approx(weights)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("1,1d0\n2,1.D+0\n3,1.\n4,1.\n", ""),
        ("1,0.\n2,0.\n", "no node of its surface has a weight"),
        ("1,nan\n2,1.\n3,1.\n", "'nan' is no finite number"),
    ],
)
def test_weights_of_a_mean_are_finite_numbers_that_are_not_all_0(tmp_path, rows, words):
    text = (
        f"{PANEL}*NODE\n9,.5,.5,1.\n*SURFACE,TYPE=NODE,NAME=F\n{rows}*COUPLING,CONSTRAINT NAME=C,REF NODE=9,SURFACE=F\n"
    )
    part = part_of(read(tmp_path, text + "*DISTRIBUTING\n"), "COUPLING")
    assert part.obstacle.endswith(words)
    assert bool(part.obstacle) == bool(words)


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        ("EQUATION", "2\nA,1,1.,B,1,-1.\n"),
        ("EQUATION", "2\nA,1,1.,4,1,-1.\n"),
        ("MPC", "BEAM,A,1\n"),
        ("MPC", "TIE,A,B\n"),
        ("MPC", "TIE,1,B\n"),
    ],
)
def test_constraints_between_sets_without_nodes_are_said(tmp_path, kind, rows):
    sets = "*NSET,NSET=A,GENERATE\n100,110\n*NSET,NSET=B,GENERATE\n200,210\n"
    part = part_of(read(tmp_path, f"{PANEL}{sets}*{kind}\n{rows}"), kind)
    assert (part.count, part.obstacle) == (1, "its sets hold no node that is there")


def test_masses_and_springs_without_a_value_are_said(tmp_path):
    text = f"{PANEL}*ELEMENT,TYPE=MASS,ELSET=M\n5,1\n6,2\n*ELEMENT,TYPE=SPRING1,ELSET=K\n7,3\n*MASS,ELSET=N\n2.\n"
    mesh = read(tmp_path, text.replace("*MASS", "*ELSET,ELSET=N\n6\n*MASS"))
    assert [(part.kind, part.count, part.obstacle) for part in mesh.parts] == [
        ("MASS", 1, ""),
        ("MASS", 1, "no *MASS gives its value"),
        ("SPRING", 1, "no *SPRING gives its value"),
    ]


def test_equations_of_unsorted_sets_are_not_paired_by_number(tmp_path):
    sets = "*NSET,NSET=A{0}\n1,2\n*NSET,NSET=B{0}\n4,3\n*EQUATION\n2\nA,1,1.,B,1,-1.\n"
    assert part_of(read(tmp_path, PANEL + sets.format("")), "EQUATION").obstacle == ""
    part = part_of(read(tmp_path, PANEL + sets.format(",UNSORTED")), "EQUATION")
    assert part.obstacle == "its nodes are paired in the order of a set (UNSORTED)"


def test_a_deck_may_begin_with_the_mark_of_its_encoding(tmp_path):
    path = tmp_path / "a.inp"
    path.write_text("*INCLUDE, INPUT=b.inp\n" + PANEL[PANEL.index("*ELEMENT") :], encoding="utf-8-sig")
    (tmp_path / "b.inp").write_text(PANEL[: PANEL.index("*ELEMENT")], encoding="utf-8-sig")
    assert read_mesh(path).labels.tolist() == [1, 2, 3, 4]

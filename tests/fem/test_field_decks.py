"""Small decks as people have them: each is read as its solver reads it, or what is left aside is said."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from structid.core.dof import Dof
from structid.core.errors import FileError, InputError
from structid.fem.elements.cells import CELLS
from structid.fem.meshes import read_mesh, require_sound
from structid.study.schema.study import load_study

FILES = Path(__file__).parent / "field_files"


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(FILES, tmp_path / "files"))


def study_with(folder, name, **keys):
    """The study of a file with keys added to its mesh, or to the structure where they begin with `total`."""
    path = folder / name
    text = path.read_text()
    mesh = "".join(f", {key} = {value}" for key, value in keys.items() if key != "total_mass")
    head, brace, rest = text.partition(" }")
    total = f"\ntotal_mass = {keys['total_mass']}" if "total_mass" in keys else ""
    path.write_text(head + mesh + brace + total + rest)
    return load_study(path)


def part_of(mesh, kind):
    return next(part for part in mesh.parts if part.kind == kind)


def test_cylindrical_nodes_of_abaqus_stand_on_their_circles(folder):
    mesh = read_mesh(folder / "a_cyl.inp")
    assert mesh.nodes[5] == pytest.approx([2 * np.cos(np.pi / 3), 2 * np.sin(np.pi / 3), 0.0])
    structure = load_study(folder / "cyl.toml").structure
    assert structure.mass_of() == pytest.approx(3 * 0.5 * (2**2 - 1) * np.sin(np.pi / 6) * 78.5)  # three flat cells
    (words,) = structure.left_aside
    assert "1 SHELL SECTION OFFSET" in words


def test_cells_in_two_groups_of_gmsh_2_count_once(folder):
    mesh = read_mesh(folder / "overlap22.msh")
    assert mesh.cells().tolist() == [[1, 2, 3, 4], [2, 5, 6, 3]]
    assert len(mesh.cells("plate")) == 2
    assert mesh.cells("patch").tolist() == [[2, 5, 6, 3]]
    assert load_study(folder / "ov.toml").structure.mass_of() == pytest.approx(157.0)


def test_cells_of_other_entities_at_the_same_nodes_stay_two(folder):
    text = (folder / "overlap22.msh").read_text().replace("3 3 2 2 2 2 5 6 3", "3 3 2 2 9 2 5 6 3")
    (folder / "overlap22.msh").write_text(text)
    assert len(read_mesh(folder / "overlap22.msh").cells()) == 3


def test_what_a_deck_has_beside_its_cells_is_listed_with_its_mass(folder):
    structure = load_study(folder / "masses.toml").structure
    assert structure.mass_of() == pytest.approx(157.0)
    (words,) = structure.left_aside
    for part in ("1 CONM2 (500 kg)", "1 CELAS2", "1 RBE2", "1 CBUSH [its property is not in the deck]"):
        assert part in words
    assert 'take = ["CONM2", "CELAS2", "RBE2"]' in words
    assert structure.file_notes == ("masses.bdf: its SPC1 are not read: supports are those of the study",)


def test_what_a_study_takes_of_a_deck_is_in_the_structure(folder):
    structure = study_with(folder, "masses.toml", take='["conm2", "RBE2", "CELAS2"]', total_mass=657.0).structure
    assert structure.mass_of() == pytest.approx(657.0)
    assert [element.name for element in structure.elements] == ["skin", "conm2", "celas2"]
    spring = structure.elements[2]
    assert (str(spring.first[0]), spring.second, spring.stiffness.tolist()) == ("1Z+", None, [1000.0])
    assert structure.ties[0].main == 5
    assert structure.ties[0].dependents == (6,)
    (words,) = structure.left_aside
    assert "CONM2" not in words
    assert "1 CBUSH" in words


def test_leave_out_keeps_a_kind_quiet(folder):
    structure = study_with(folder, "masses.toml", take='"all"', leave_out='["CBUSH"]').structure
    assert structure.left_aside == ()
    assert structure.mass_of() == pytest.approx(657.0)


@pytest.mark.parametrize(
    "keys, words",
    [
        ({"total_mass": 657.0}, "the model leaves aside what masses.bdf has beside its cells: 1 CONM2 (500 kg)"),
        ({"take": '["CBUSH"]'}, "1 CBUSH of masses.bdf cannot be taken: its property is not in the deck"),
        ({"take": '["CONM1"]'}, "masses.bdf has no 'CONM1' beside its cells; the nearest is 'CONM2'"),
        ({"force_unit": '"kg"'}, "force_unit"),
    ],
)
def test_what_cannot_be_taken_is_said(folder, keys, words):
    with pytest.raises(InputError) as error:
        _ = study_with(folder, "masses.toml", **keys).structure
    assert words in str(error.value)


def test_units_of_a_deck_in_mm_and_newton_make_tonnes(folder):
    text = (folder / "masses.bdf").read_text().replace("CONM2,10,6,,500.", "CONM2,10,6,,0.5\n,2.")
    (folder / "masses.bdf").write_text(text)
    mesh = read_mesh(folder / "masses.bdf", "mm", "N")
    [mass] = part_of(mesh, "CONM2").masses
    assert part_of(mesh, "CONM2").mass == pytest.approx(500.0)
    assert mass.matrix[3, 3] == pytest.approx(2e-3)  # t mm^2 in kg m^2
    assert part_of(mesh, "CELAS2").springs[0].stiffness == pytest.approx(1e6)  # N/mm in N/m
    (folder / "masses.bdf").write_text(text.replace("SPC1,", "PARAM,WTMASS,0.5\nSPC1,"))
    assert part_of(read_mesh(folder / "masses.bdf", "mm"), "CONM2").mass == pytest.approx(250.0)


def test_offsets_of_bars_are_listed(folder):
    (words,) = load_study(folder / "bars.toml").structure.left_aside
    assert "2 CBAR offset" in words


def test_masses_springs_and_equations_of_abaqus_are_listed_and_taken(folder):
    (words,) = load_study(folder / "shsp.toml").structure.left_aside
    for part in ("1 MASS (500 kg)", "1 SPRING", "1 EQUATION", "1 SHELL SECTION OFFSET"):
        assert part in words
    structure = study_with(folder, "shsp.toml", take='"all"').structure
    assert structure.mass_of() == pytest.approx(657.0)
    mesh = read_mesh(folder / "a_shellspring.inp")
    [spring] = part_of(mesh, "SPRING").springs
    along = np.array([2.0, 1.0, 0.0]) / np.sqrt(5)
    assert [spring.weights[6, d] for d in "XY"] == pytest.approx(along[:2])
    assert [spring.weights[1, d] for d in "XY"] == pytest.approx(-along[:2])
    assert spring.stiffness == 1000.0
    [tie] = part_of(mesh, "EQUATION").ties
    assert (str(tie.dependent), [(str(dof), factor) for dof, factor in tie.depends_on]) == ("5Z+", [("6Z+", 1.0)])


def test_replicated_cards_are_written_out(folder):
    mesh = read_mesh(folder / "repl.bdf")
    assert mesh.labels.tolist() == [1, 2, 3, 4, 5, 6, 11, 12, 13, 14, 15, 16]
    assert mesh.nodes[16] == pytest.approx([5.0, 1.0, 0.0])
    assert mesh.cells("1").tolist()[-1] == [5, 6, 16, 15]
    assert load_study(folder / "repl.toml").structure.mass_of() == pytest.approx(5 * 78.5)


@pytest.mark.parametrize(
    "lines, words",
    [
        ("=4\n", "repeats a card that is not there"),
        ("GRID,1,,0.,0.,0.\n=4\n", "has no card with steps before it"),
        ("CBAR,1,1,1,2,0.,0.,1.\n,,,0.,0.,.25\n=,*1,==\n", "repeats a card that goes on over several lines"),
        ("CROD,A,1,1,2\n=,*1,==\n", "a step of 1 on 'A', which is no number"),
    ],
)
def test_replication_that_cannot_be_followed_is_refused_with_its_line(tmp_path, lines, words):
    path = tmp_path / "a.bdf"
    path.write_text("BEGIN BULK\n" + lines)
    with pytest.raises(FileError) as error:
        read_mesh(path)
    assert words in str(error.value)
    assert f"a.bdf, line {lines.count(chr(10)) + 1}" in str(error.value)


def test_includes_are_found_from_the_folder_of_the_deck(folder, monkeypatch):
    assert len(read_mesh(folder / "inc" / "main.bdf").labels) == 4
    deck = folder / "inc" / "symbol.bdf"
    deck.write_text("BEGIN BULK\nINCLUDE 'MESHES:grids.bdf'\nCQUAD4,1,1,1,2,3,4\nENDDATA\n")
    with pytest.raises(FileError, match=r"line 2: .* MESHES is a logical symbol .* set an environment variable MESHES"):
        read_mesh(deck)
    monkeypatch.setenv("MESHES", str(folder / "inc" / "parts"))
    assert len(read_mesh(deck).labels) == 4


def test_errors_in_included_files_name_them_and_their_line(folder):
    (folder / "inc" / "parts" / "grids.bdf").write_text("GRID,1,,0.,0.,0.\nGRID,2,,x,0.,0.\n")
    with pytest.raises(FileError, match=r"grids.bdf, line 2: field 4 must be a real number, got 'X'"):
        read_mesh(folder / "inc" / "main.bdf")


def test_bulk_data_without_begin_or_end_are_read_and_said(folder):
    mesh = read_mesh(folder / "nobegin.bdf")
    assert len(mesh.labels) == 4
    assert mesh.notes == ()
    text = (folder / "nobegin.bdf").read_text().replace("ENDDATA\n", "")
    (folder / "nobegin.bdf").write_text(text)
    (note,) = read_mesh(folder / "nobegin.bdf").notes
    assert note.startswith("there is no ENDDATA")


@pytest.mark.parametrize("line", ["BEGIN SUPER=3", "BEGIN BULK SUPER = 3", "begin super 3"])
def test_superelements_are_refused_by_name(folder, line):
    text = (folder / "masses.bdf").read_text().replace("CONM2", f"{line}\nCONM2")
    (folder / "masses.bdf").write_text(text)
    with pytest.raises(FileError, match=r"line 12: .* begins the bulk data of super 3; decks of several sections"):
        read_mesh(folder / "masses.bdf")


def test_parts_of_an_assembly_stand_where_their_instances_are(folder):
    mesh = require_sound(read_mesh(folder / "a_parts.inp"), duplicates="keep")
    assert mesh.nodes[11] == pytest.approx([1.0, 0.0, 0.0])
    assert mesh.cells("PLATE-2.SKIN").tolist() == [[11, 12, 13, 14]]
    assert len(mesh.cells("SKIN")) == 2
    assert part_of(mesh, "TIE").obstacle == "line 17 cannot be read: there is no surface 'S1'"
    assert "PLATE-2 +10" in mesh.notes[0]


def test_quadratic_cells_without_some_middle_nodes_have_straight_sides_there(tmp_path):
    path = tmp_path / "a.bdf"
    path.write_text(
        "BEGIN BULK\n"
        + "".join(
            f"GRID,{n},,{x},{y},0.\n"
            for n, x, y in [
                (1, 0.0, 0.0),
                (2, 2.0, 0.0),
                (3, 2.0, 2.0),
                (4, 0.0, 2.0),
                (5, 1.0, 0.0),
                (7, 1.0, 2.0),
                (8, 0.0, 1.0),
            ]
        )
        + "CQUAD8,1,1,1,2,3,4,5,0\n,7,8\nENDDATA\n"
    )
    mesh = require_sound(read_mesh(path))
    assert mesh.cells().tolist() == [[1, 2, 3, 4, 5, 9, 7, 8]]
    assert mesh.nodes[9] == pytest.approx([2.0, 1.0, 0.0])
    study = tmp_path / "a.toml"
    study.write_text(
        'title = "a"\n[structure]\nmesh = "a.bdf"\nactive = ["X", "Y"]\n[[structure.support]]\nx = 0.0\n'
        '[[structure.plane]]\nname = "skin"\nyoungs_modulus = 1.0\ndensity = 1.0\nthickness = 1.0\npoisson = 0.3\n'
        '[[unknown]]\nproperty = "youngs_modulus"\nelements = "skin"\n[record]\npath = "m.csv"\n[record.modes]\nshape_std = 0.1\n'
    )
    (tmp_path / "m.csv").write_text((FILES / "modes3.csv").read_text().replace("5Z", "2X").replace("6Z", "3X"))
    structure = load_study(study).structure
    row = structure.selection([Dof(9, "Y")]).toarray().ravel()
    names = [str(dof.unsigned) for dof in structure.dofs]
    assert {names[k]: row[k] for k in np.flatnonzero(row)} == {"2Y+": 0.5, "3Y+": 0.5}
    assert structure.mass_of(direction="X") == pytest.approx(4.0 - structure_held_mass(structure))
    assert structure.left_aside == ()


def structure_held_mass(structure):
    """Mass at held nodes that rigid translation of the free ones does not see."""
    whole = type(structure)(structure.nodes, structure.elements, [], structure.ties, structure.active)
    return whole.mass_of(direction="X") - structure.mass_of(direction="X")


VTK = """# vtk DataFile Version 3.0
a wedge
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 15 double
{points}
CELLS 1 16
15 {nodes}
CELL_TYPES 1
26
"""
VTU = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="15" NumberOfCells="1">
<Points><DataArray type="Float64" Name="Points" NumberOfComponents="3" format="ascii">{points}</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">{nodes}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">15</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">26</DataArray></Cells>
</Piece></UnstructuredGrid></VTKFile>
"""


@pytest.mark.parametrize("suffix", ["vtk", "vtu"])
@pytest.mark.parametrize("flipped", [False, True])
def test_wedges_of_vtk_stand_upright_whichever_way_their_triangles_run(tmp_path, suffix, flipped):
    pytest.importorskip("meshio")
    corners = CELLS["wedge15"].corners
    order = [0, 2, 1, 3, 5, 4, 8, 7, 6, 11, 10, 9, 12, 14, 13] if flipped else list(range(15))
    path = tmp_path / f"a.{suffix}"
    text = {"vtk": VTK, "vtu": VTU}[suffix]
    points = "\n".join(" ".join(map(str, row)) for row in corners.tolist())
    path.write_text(text.format(points=points, nodes=" ".join(map(str, order))))
    mesh = read_mesh(path)
    assert np.array([mesh.nodes[n] for n in mesh.blocks[0].nodes[0]]) == pytest.approx(corners)


def test_bars_of_a_deck_of_plates_that_no_set_takes_are_listed(folder):
    text = (folder / "nobegin.bdf").read_text().replace("ENDDATA", "CBAR,9,2,1,2,0.,0.,1.\nENDDATA")
    (folder / "masses.bdf").write_text(text)
    record = (folder / "modes3.csv").read_text().replace("5Z", "2Z").replace("6Z", "3Z")
    (folder / "modes3.csv").write_text(record)
    (words,) = load_study(folder / "masses.toml").structure.left_aside
    assert "1 cells (line), in group 2 of masses.bdf, belong to no element set" in words
    assert study_with(folder, "masses.toml", leave_out='["2"]').structure.left_aside == ()


def test_lines_that_go_on_from_another_card_are_refused(tmp_path):
    head = "CORD2R  7               0.      0.      0.      0.      0.      1.      "
    lines = [
        "BEGIN BULK",
        head + "+AB1",
        "+AB1    1.      0.      0.",
        "GRID    1       7       1.      2.      3.",
        "CROD,1,1,1,1",
    ]
    path = tmp_path / "a.bdf"
    path.write_text("\n".join(lines))
    assert read_mesh(path).nodes[1] == pytest.approx([1.0, 2.0, 3.0])
    path.write_text("\n".join(lines).replace("+AB1    1.", "+AB2    1."))
    with pytest.raises(FileError, match=r"a\.bdf, line 3: goes on with mark 'AB2' where the line before ends in 'AB1'"):
        read_mesh(path)

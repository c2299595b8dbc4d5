"""Studies of one more table or key: joints and channels under other names, found again from exact records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import structid as sid
from structid.modal.formats.files import write_modes
from structid.records import write_record
from structid.report.drawing.drawing import structure_picture
from structid.report.identification_tables import element_table
from structid.study.schema.records.record import load_histories, load_record
from structid.workbench.work.scene import _describe_set
from study_cases import CHAIN

#: The records are simulated with the elements as drawn.
AS_SIMULATED = ("[structure]", "[structure]\nsubdivide = 1")
GIRDER = """
[structure]
fixed = ["1 X Y", "5Y"]
[structure.nodes]
1 = [0.0, 0.0]
2 = [0.5, 0.0]
3 = [1.0, 0.0]
4 = [1.5, 0.0]
5 = [2.0, 0.0]
[[structure.beam]]
name = "girder"
nodes = [[1, 2], [2, 3], [3, 4], [4, 5]]
mass = 5.0
bending_stiffness = 900.0
axial_stiffness = 1e6
loss_factor = 0.01
[[structure.joint]]
name = "joint 1"
element = "girder:2"
at = "3RZ"
stiffness = 2000.0
loss_factor = 0.05
[[unknown]]
property = "bending_stiffness"
elements = "girder:1-2"
name = "left"
[[unknown]]
property = "stiffness"
elements = "joint 1"
[record]
path = "frf.npz"
[record.noise]
relative = 0.01
[method]
restarts = 0
"""
SENSORS = ("2Y", "3Y", "4Y")


def replaced(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def written(folder: Path, text: str, name: str = "study.toml") -> sid.Study:
    (folder / name).write_text(text, encoding="utf-8")
    if not (folder / "frf.npz").exists():
        write_record(folder / "frf.npz", record(np.ones((1, 3, 1)), np.array([1.0])))
    return sid.load_study(folder / name)


def record(values: np.ndarray, frequency: np.ndarray, outputs=SENSORS) -> sid.FrfRecord:
    return sid.FrfRecord(frequency, values, outputs, ("2Y",), "accelerance")


def simulated(study: sid.Study, frequency: np.ndarray) -> sid.FrfRecord:
    """Exact accelerances of the study's structure at its initial values."""
    empty = record(np.ones((len(frequency), 3, 1)), frequency)
    return sid.simulated_record(study.structure, study.parameters, empty)


FREQUENCY = np.arange(2.0, 60.0, 0.25)


def test_the_stiffness_of_a_joint_is_found(tmp_path):
    true = written(tmp_path, replaced(GIRDER, ("stiffness = 2000.0", "stiffness = 300.0")), "true.toml")
    write_record(tmp_path / "frf.npz", simulated(true, FREQUENCY))
    study = written(tmp_path, replaced(GIRDER, AS_SIMULATED))
    found = sid.run_study(study).identification.estimate
    assert found.names == ("bending_stiffness[left]", "stiffness[joint 1]")
    assert found.values == pytest.approx([900.0, 300.0], rel=1e-5)
    assert found.units[1] == "N m/rad"
    picture = structure_picture(study.structure, [], [])
    assert [mark.label for mark in picture.marks if mark.element == "joint 1"] == ["joint 1"]
    row = next(row for row in element_table(study.structure).rows if row[0] == "joint 1")
    assert row[1:3] == ("joint", "1")


def test_a_joint_may_be_there_in_one_record_only(tmp_path):
    joint = GIRDER[GIRDER.index("[[structure.joint]]") : GIRDER.index("[[unknown]]")]
    bare = GIRDER.replace(joint, "").replace("[record]", "[[record]]")
    later = joint.replace("structure.joint", "record.structure.joint")
    second = f'[[record]]\nname = "later"\npath = "frf.npz"\n[record.noise]\nrelative = 0.01\n{later}[method]'
    study = written(tmp_path, bare.replace("[method]", second))
    first, last = (setup.structure for setup in study.setups)
    assert (first.n_dofs + 1, len(first.elements) + 1) == (last.n_dofs, len(last.elements))
    assert study.setups[1].parameters.names == ("bending_stiffness[left]", "stiffness[joint 1]")
    without = GIRDER.replace("[record.noise]", '[record.structure]\nwithout = "joint 1"\n[record.noise]')
    with pytest.raises(sid.InputError, match="no element set"):
        written(tmp_path, without)


RELABEL = ("[record]", '[record]\nrelabel = { "2Y" = "4Y", "4Y" = "2Y" }')


def test_swapped_sensors_are_fitted_under_their_true_names(tmp_path):
    plain = written(tmp_path, GIRDER)
    true = simulated(plain, FREQUENCY)
    write_record(tmp_path / "frf.npz", record(true.values, FREQUENCY, ("4Y", "3Y", "2Y")))
    study = written(tmp_path, replaced(GIRDER, RELABEL, AS_SIMULATED))
    loaded = load_record(study.record)
    assert [str(dof) for dof in (*loaded.outputs, *loaded.inputs)] == ["2Y+", "3Y+", "4Y+", "2Y+"]
    found = sid.run_study(study).identification.estimate
    assert found.values == pytest.approx([900.0, 2000.0], rel=1e-6)
    used = written(tmp_path, replaced(GIRDER, RELABEL, ("[record.noise]", 'channels_used = "4Y"\n[record.noise]')))
    assert load_record(used.record).values == pytest.approx(true.values[:, 2:])


def test_time_histories_and_modes_are_relabelled_before_they_are_chosen(tmp_path):
    values = np.random.default_rng(0).standard_normal((400, 3))
    quantities = ("force", "acceleration", "acceleration")
    write_record(tmp_path / "time.npz", sid.TimeRecord(100.0, values, ("2Y", "2Y-", "4Y"), quantities))
    timed = replaced(
        GIRDER,
        RELABEL,
        ('path = "frf.npz"\n[record.noise]\nrelative = 0.01', 'path = "time.npz"\nchannels_used = "4Y"'),
        ("[method]", "[record.time]\nnoise = 0.1\n[method]"),
    )
    study = written(tmp_path, timed)
    loaded = load_histories(study.record, study.record.time)
    assert [str(dof) for dof in loaded.channels] == ["2Y+", "4Y-"]
    assert loaded.values == pytest.approx(values[:, :2])
    shapes = np.array([[1.0, 1.0], [2.0, -1.0]])
    write_modes(tmp_path / "modes.json", sid.ModalRecord([3.0, 8.0], [0.01, 0.02], shapes, ("2Y", "4Y")))
    modal = replaced(
        GIRDER,
        RELABEL,
        ('path = "frf.npz"\n[record.noise]\nrelative = 0.01', 'path = "modes.json"\nchannels_used = ["2Y", "4Y"]'),
        ("[method]", "[record.modes]\nfrequency_error = 0.01\n[method]"),
    )
    assert written(tmp_path, modal).record.modes.load().mode_shapes == pytest.approx(shapes[::-1])


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ('{ "7Y" = "4Y" }', r"line \d+: \[record\] relabel: there is no channel 7Y; the record has 2Y\+, 3Y\+, 4Y\+"),
        ('{ "2Y" = "4Y" }', r"\[record\] relabel: 2Y and 4Y would both be called 4Y"),
        ('{ "2Y" = 4 }', r"relabel: must be a table of names of channels, as in .*, got \{'2Y': 4\}"),
        ("{}", "relabel: must be a table of names"),
        ('"2Y"', "relabel: must be a table of names"),
    ],
)
def test_channels_that_cannot_be_relabelled_are_told_at_the_key(tmp_path, names, words):
    with pytest.raises(sid.InputError, match=words):
        load_record(written(tmp_path, replaced(GIRDER, ("[record]", f"[record]\nrelabel = {names}"))).record)


def test_elements_in_pieces_keep_their_numbers_parameters_and_joints(tmp_path):
    study = written(
        tmp_path, replaced(GIRDER, ("[structure]", "[structure]\nsubdivide = 3"), ("girder:1-2", "girder:3"))
    )
    by_hand = replaced(
        GIRDER,
        ("3 = [1.0, 0.0]", "3 = [1.0, 0.0]\n" + "\n".join(f"{9 + k} = [{k / 6}, 0.0]" for k in range(12) if k % 3)),
        (
            "[[1, 2], [2, 3], [3, 4], [4, 5]]",
            "[[1, 10], [10, 11], [11, 2], [2, 13], [13, 14], [14, 3], [3, 16], [16, 17], [17, 4], [4, 19], [19, 20], [20, 5]]",
        ),
        ("girder:2", "girder:6"),
        ("girder:1-2", "girder:7-9"),
    )
    finer = written(tmp_path, by_hand, "by hand.toml")
    assert study.parameters.names == finer.parameters.names
    assert study.structure.n_dofs == finer.structure.n_dofs == 4 * 3 * 3 + 1
    assert len(study.structure.elements[0].nodes) == 4
    physical = np.array([500.0, 300.0])
    for law in ("mass", "stiffness", "structural_damping"):
        found, made = (
            np.linalg.eigvalsh(s.structure.matrix(law, s.parameters.values(physical)).toarray()) for s in (study, finer)
        )
        assert found == pytest.approx(made, rel=1e-9, abs=1e-13 * made.max())
    assert simulated(study, FREQUENCY).values == pytest.approx(simulated(finer, FREQUENCY).values, rel=1e-8)


@pytest.mark.parametrize("pieces", ["0", "101", "1.5", "true", '"2"'])
def test_pieces_are_a_whole_number(tmp_path, pieces):
    with pytest.raises(sid.InputError, match=r"\[structure\] subdivide: must be a whole number of at least 1"):
        written(tmp_path, replaced(GIRDER, ("[structure]", f"[structure]\nsubdivide = {pieces}")))


def test_a_structure_without_lines_cannot_be_cut(tmp_path):
    text = CHAIN.replace("[structure]", "[structure]\nsubdivide = 2", 1)
    with pytest.raises(
        sid.InputError, match=r"line 4: \[structure\] subdivide: .* cuts bars, beams and space beams only"
    ):
        written(tmp_path, text)


@pytest.mark.parametrize(("kind", "given"), [("bar", "axial_stiffness = 9e3"), ("beam", "bending_stiffness = 9.0")])
def test_pieces_of_one_set_are_refused_with_what_cuts_it(tmp_path, kind, given):
    strut = f'[[structure.{kind}]]\nname = "strut"\nnodes = [[1, 2]]\nmass = 1.0\n{given}\nsubdivide = 2\n[record]'
    words = r'line \d+: \[\[structure\..*"strut" subdivide: is no key of one set; write it in \[structure\].* bars .* stay whole'
    with pytest.raises(sid.InputError, match=words):
        written(tmp_path, replaced(GIRDER, ("[record]", strut)))


def test_shear_and_bending_stiffness_are_found_together(tmp_path):
    shears = replaced(
        GIRDER,
        ("loss_factor = 0.01", "loss_factor = 0.01\nshear_stiffness = 6e3"),
        ("[record]", '[[unknown]]\nproperty = "shear_stiffness"\nelements = "girder"\n[record]'),
    )
    true = written(tmp_path, replaced(shears, ("6e3", "2.5e3"), ("= 900.0", "= 800.0")), "true.toml")
    write_record(tmp_path / "frf.npz", simulated(true, FREQUENCY))
    start = replaced(
        shears, ("[[unknown]]", '[[unknown]]\nproperty = "bending_stiffness"\nelements = "girder:3-4"\n[[unknown]]')
    )
    found = sid.run_study(written(tmp_path, start)).identification.estimate
    assert found.names[-1] == "shear_stiffness[girder]"
    assert found.values == pytest.approx([800.0, 800.0, 2000.0, 2500.0], rel=1e-4)


@pytest.mark.parametrize("given", ["0.0", "-1.0", "[1.0, 2.0]"])
def test_a_shear_stiffness_is_positive_and_one_an_element(tmp_path, given):
    with pytest.raises(sid.InputError, match=r'"girder".*shear_stiffness'):
        written(tmp_path, replaced(GIRDER, ("loss_factor = 0.01", f"shear_stiffness = {given}")))


def test_a_factor_of_lengths_is_no_nominal_property():
    bars = sid.Bar("bars", [[1, 2]], 1.0, 1e3, tolerance={"length": 0.01})
    structure = sid.Structure({1: 0.0, 2: 1.0}, [bars], ["1X"])
    assert "length[bars]" in [f"{p.term.property}[{p.element}]" for p in structure.properties]
    assert "length" not in element_table(structure).rows[0][3]
    assert "length" not in [entry["name"] for entry in _describe_set(bars, structure, np.asarray)["properties"]]

"""Templates give studies that can be read and planned, from the command line as from the page."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from app_cases import ROOT
from scipy import sparse
from typer.testing import CliRunner

from structid.cli.app import app
from structid.core.errors import FileError, InputError
from structid.identification.record_fit import structure_modes
from structid.study.schema.plan import load_plan
from structid.study.templates import TEMPLATES, asked_of, template_with, write_study

RUN = CliRunner()


def write_inputs(folder):
    size = 4
    stiffness = sparse.csr_array(1e4 * (2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)))
    sparse.save_npz(folder / "M.npz", sparse.csr_array(2.0 * np.eye(size)))
    sparse.save_npz(folder / "K.npz", stiffness)
    (folder / "dofs.txt").write_text("1X 2X 3X 4X\n", encoding="utf-8")
    shutil.copy(ROOT / "examples" / "plate_from_mesh" / "plate.msh", folder / "mesh.msh")


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_template_can_be_planned(name, tmp_path):
    write_inputs(tmp_path)
    path = tmp_path / "study.toml"
    held = ["--set", "held=clamp"] if name == "mesh" else []
    done = RUN.invoke(app, ["init", name, str(path), *held])
    assert done.exit_code == 0, done.output
    plan = load_plan(path)
    assert plan.parameters.n_params >= 1
    assert structure_modes(plan.structure, plan.parameters.values(plan.parameters.start), 2).frequency[0] > 0


@pytest.mark.parametrize("support, factor", [("clamped", 1.8751), ("simple", np.pi), ("free", 4.7300)])
def test_the_first_frequency_of_a_beam_is_the_textbook_one(support, factor, tmp_path):
    """Of a uniform beam: f = (beta L)^2 / (2 pi L^2) sqrt(EI / m); Blevins (1979), table 8-1."""
    given = {"support": support, "elements": 16, "length": 2.0, "mass": 3.0, "bending_stiffness": 700.0}
    plan = load_plan(write_study(template_with(TEMPLATES["beam"], given), tmp_path / "beam.toml"))
    found = structure_modes(plan.structure, plan.parameters.values(plan.parameters.start), 4).frequency
    flexible = found[found > 1e-3 * found.max()]
    assert flexible[0] == pytest.approx(factor**2 / (2 * np.pi * 4.0) * np.sqrt(700.0 / 3.0), rel=1e-4)


def test_the_shear_building_sways_as_the_textbook_says(tmp_path):
    """f_1 = 2 sqrt(k / m) sin(pi / (2 (2 n + 1))) / (2 pi) of n equal storeys."""
    plan = load_plan(write_study(template_with(TEMPLATES["shear-building"], {}), tmp_path / "s.toml"))
    first = structure_modes(plan.structure, plan.parameters.values(plan.parameters.start), 1).frequency[0]
    assert first == pytest.approx(2 * np.sqrt(1.6e6 / 5000.0) * np.sin(np.pi / 18) / (2 * np.pi), rel=1e-6)


def test_a_mesh_becomes_the_study_that_the_example_has_by_hand(tmp_path):
    """A clamped plate of two groups in mm, of one thickness: the frequencies of the example with that thickness."""
    example = ROOT / "examples" / "plate_from_mesh" / "study.toml"
    shutil.copy(example.parent / "plate.msh", tmp_path / "plate.msh")
    text = example.read_text(encoding="utf-8").replace("thickness = 4e-3", "thickness = 3e-3")
    (tmp_path / "hand.toml").write_text(text[: text.index("[record]")], encoding="utf-8")
    given = {"path": "plate.msh", "length_unit": "mm", "held": "clamp", "youngs_modulus": 72e9}
    made = write_study(template_with(TEMPLATES["mesh"], given), tmp_path / "made.toml")
    plans = [load_plan(path) for path in (tmp_path / "hand.toml", made)]
    found = [structure_modes(p.structure, p.parameters.values(p.parameters.start), 5).frequency for p in plans]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)
    assert {element.name for element in plans[1].structure.elements} == {"skin", "strip"}


def test_a_mesh_that_nothing_holds_names_its_groups(tmp_path):
    shutil.copy(ROOT / "examples" / "plate_from_mesh" / "plate.msh", tmp_path / "mesh.msh")
    text = write_study(template_with(TEMPLATES["mesh"], {}), tmp_path / "made.toml").read_text(encoding="utf-8")
    assert '# [[structure.support]]\n# group = "clamp"\n# directions = ["Z", "RX", "RY"]' in text
    with pytest.raises(InputError, match=r"there is no group 'clam'.*nearest is 'clamp'"):
        write_study(template_with(TEMPLATES["mesh"], {"held": "clam"}), tmp_path / "other.toml")
    assert not (tmp_path / "other.toml").exists()


SOLID = """*HEADING
*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0., 1., 0.
5, 0., 0., 1.
6, 1., 0., 1.
7, 1., 1., 1.
8, 0., 1., 1.
9, 0., 0., 2.
10, 1., 0., 2.
11, 1., 1., 2.
12, 0., 1., 2.
99, 7., 7., 7.
*ELEMENT, TYPE=C3D8
1, 1, 2, 3, 4, 5, 6, 7, 8
2, 5, 6, 7, 8, 9, 10, 11, 12
*ELSET, ELSET={}
1
*ELSET, ELSET=UPPER
2
*ELSET, ELSET=BOTH
1, 2
*NSET, NSET=FOOT
1, 2, 3, 4
"""


@pytest.mark.parametrize("lower, sets", [("LOWER", ["LOWER", "UPPER"]), ("UPPER", ["all"])])
def test_solids_have_a_set_a_group_or_one_where_groups_leave_cells_out(lower, sets, tmp_path):
    (tmp_path / "block.inp").write_text(SOLID.format(lower).replace("*ELSET, ELSET=UPPER\n1\n", ""), encoding="utf-8")
    given = {"path": "block.inp", "held": "FOOT"}
    made = write_study(template_with(TEMPLATES["mesh"], given), tmp_path / "made.toml")
    assert [one["name"] for one in tomllib.loads(made.read_text(encoding="utf-8"))["structure"]["solid"]] == sets
    plan = load_plan(made)  # the node without a cell is left out
    assert plan.structure.n_dofs == 24
    assert structure_modes(plan.structure, plan.parameters.values(plan.parameters.start), 1).frequency[0] > 0


@pytest.mark.parametrize(
    "words",
    [
        ["--set", "length=none"],
        ["--set", "length=-1"],
        ["--set", "elements=2.5"],
        ["--set", "wide=1"],
        ["--set", "length"],
        ["--set", "support=glued"],
        ["--set", "elements=99999"],
        ["--set", "elements=inf"],
        ["--set", "elements=1e999"],
        ["--set", "elements=nan"],
        ["--set", "length=inf"],
    ],
)
def test_what_cannot_be_used_is_told_and_nothing_is_written(words, tmp_path):
    done = RUN.invoke(app, ["init", "beam", str(tmp_path / "b.toml"), *words])
    assert done.exit_code == 2
    assert "error: " in done.stderr
    assert not (tmp_path / "b.toml").exists()


def test_no_file_is_replaced(tmp_path):
    (tmp_path / "b.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match="is there already"):
        write_study(template_with(TEMPLATES["beam"], {}), tmp_path / "b.toml")
    assert (tmp_path / "b.toml").read_text(encoding="utf-8") == "mine"


def test_a_study_without_a_suffix_gets_that_of_studies(tmp_path):
    done = RUN.invoke(app, ["init", "beam", str(tmp_path / "shelf.v2")])
    assert done.exit_code == 0
    assert [one.name for one in tmp_path.iterdir()] == ["shelf.v2.toml"]


@pytest.mark.skipif(os.name != "posix", reason="terminals are made so on POSIX only")
def test_each_answer_is_judged_where_it_is_asked(tmp_path):
    ours, theirs = os.openpty()
    os.write(ours, b"abc\n1,5\n1.5\n0\n4\n\n\nglued\nfree\n")
    words = [sys.executable, "-m", "structid", "init", "beam", str(tmp_path / "b.toml")]
    done = subprocess.run(words, stdin=theirs, capture_output=True, text=True, check=True)
    os.close(ours), os.close(theirs)
    assert done.stdout.count("Error: ") + done.stderr.count("Error: ") == 4
    assert "support must be one of clamped, simple, free, got 'glued'" in done.stdout + done.stderr
    made = tomllib.loads((tmp_path / "b.toml").read_text(encoding="utf-8"))
    assert made["title"] == "Beam free"
    assert made["structure"]["nodes"]["5"] == [1.5]


def test_an_unknown_template_is_told():
    done = RUN.invoke(app, ["init", "tower"])
    assert done.exit_code == 2
    assert "shear-building" in done.stderr


def test_texts_cannot_leave_their_quotes():
    with pytest.raises(InputError, match="without quotes"):
        template_with(TEMPLATES["own-matrices"], {"mass": 'M.npz"\n[x'})


def test_defaults_are_what_is_asked_for():
    for kind in TEMPLATES.values():
        assert template_with(kind, {one.name: one.default for one in asked_of(kind)}) == template_with(kind, {})

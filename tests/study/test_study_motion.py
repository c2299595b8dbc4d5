"""`structid motion`: a study identified from motion on disk, from the command line."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from structid import Beam, Structure, TimeRecord, write_record
from structid.cli.app import app

STUDY = """
title = "Three beams"

[structure]
active = ["Y", "RZ"]
fixed = ["0Y", "0RZ"]

[structure.nodes]
0 = 0.0
1 = 1.0
2 = 2.0
3 = 3.0

[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2], [2, 3]]
mass = 1.0
bending_stiffness = 1.0

[[unknown]]
property = "mass"
elements = "beam"
each = true

[[unknown]]
property = "bending_stiffness"
elements = "beam"
each = true

[record]
path = "motion.h5"
"""
MASS, STIFFNESS = np.array([1.2, 0.9, 1.1]), np.array([0.8, 1.0, 1.3])


def written(folder, noise=0.01, text=STUDY, n=50, still=False):
    """The study with a record of random motion of the actual beam; its path."""
    nodes = {i: float(i) for i in range(4)}
    beam = Beam("beam", [[0, 1], [1, 2], [2, 3]], MASS, STIFFNESS)
    structure = Structure(nodes, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
    rng = np.random.default_rng(0)
    acceleration, displacement = rng.standard_normal((2, n, structure.n_dofs))
    if still:
        displacement[:] = 0
    mass, stiffness = (structure.matrix(law).toarray() for law in ("mass", "stiffness"))
    force = acceleration @ mass + displacement @ stiffness
    force += noise * rng.standard_normal(force.shape)
    values = np.concatenate([acceleration, displacement, force], axis=1)
    kinds = np.repeat(["acceleration", "displacement", "force"], structure.n_dofs)
    write_record(folder / "motion.h5", TimeRecord(100.0, values, structure.dofs * 3, tuple(kinds.tolist())))
    (folder / "beams.toml").write_text(text)
    return folder / "beams.toml"


def act(*words):
    return CliRunner().invoke(app, ["motion", *map(str, words)])


def test_study_is_identified_and_its_cost_is_told(tmp_path):
    study, out, state = written(tmp_path), tmp_path / "out", tmp_path / "state.npz"
    done = act(study, "--out", out, "--chunk", 7, "--checkpoint", state, "--engine", "numpy")
    assert done.exit_code == 0, done.output
    assert "6 of 6 parameters identified" in done.output
    assert "wall time: study" in done.output
    assert "rows reduced by NumPy, solved by banded orthogonal sweep" in done.output
    with (out / "parameters.csv").open() as stream:
        table = list(csv.DictReader(stream))
    values = np.array([float(row["value"]) for row in table])
    std = np.array([float(row["standard_deviation"]) for row in table])
    assert [row["name"] for row in table][:2] == ["mass[beam:1]", "mass[beam:2]"]
    assert (np.abs(values - np.concatenate([MASS, STIFFNESS])) <= 4 * std).all()
    assert std.max() < 0.01
    summary = json.loads((out / "motion.json").read_text())
    assert (summary["samples"], summary["parameters"], summary["identified"]) == (50, 6, 6)
    assert summary["residual_rms"] == pytest.approx(0.01, rel=0.15)
    assert (out / "study.toml").read_text() == STUDY
    again = act(study, "--out", tmp_path / "again", "--checkpoint", state, "--engine", "numpy")
    assert again.exit_code == 0
    assert (tmp_path / "again" / "parameters.csv").read_text() == (out / "parameters.csv").read_text()


def test_parameters_that_the_motion_does_not_show_end_with_code_1(tmp_path):
    done = act(written(tmp_path, still=True), "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "not seen: bending_stiffness[beam:1]" in done.output
    summary = json.loads((tmp_path / "out" / "motion.json").read_text())
    assert (summary["identified"], summary["condition"]) == (3, None)


BAD = {
    "noise": (STUDY + "[record.noise]\nrelative = 0.01\n", "identification from motion does not use it; leave it out"),
    "relabel": (STUDY + "relabel = {'2X' = '1X'}\n", "identification from motion does not use it; leave it out"),
    "start": (STUDY + "start = 1.0\n", "does not use start"),
    "engine": (STUDY, "--engine must be 'auto', 'numba' or 'numpy'"),
}


@pytest.mark.parametrize("case", BAD)
def test_studies_that_do_not_fit_are_refused_with_nothing_written(tmp_path, case):
    text, words = BAD[case]
    done = act(
        written(tmp_path, text=text), "--out", tmp_path / "out", *(["--engine", "c"] if case == "engine" else [])
    )
    assert done.exit_code == 2
    assert words in done.output
    assert not (tmp_path / "out").exists()

"""Every example script runs, and gives its pinned number."""

import csv
import json
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid import read_record
from structid.cli.app import app
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    ("script", "name", "value", "deviations"),
    [
        ("added_mass.py", "mass[outer]", 1.2, 4.0),
        ("cantilever.py", "bending_stiffness[beam:4]", 8.0, 4.0),
        ("own_matrices.py", "stiffness[upper]", 0.9, 4.0),
    ],
)
def test_example_finds_its_truth(script, name, value, deviations):
    found = runpy.run_path(str(EXAMPLES / script))["main"]().estimate
    estimated, std = found[name]
    assert abs(estimated - value) <= deviations * std
    assert std <= 0.02 * value
    assert found.covariance_basis == "noise"


def test_every_script_is_tried():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {"added_mass.py", "cantilever.py", "own_matrices.py"}


def test_the_motion_of_a_frame_gives_every_floor(tmp_path):
    folder = EXAMPLES / "motion_of_a_frame"
    done = CliRunner().invoke(app, ["motion", str(folder / "study.toml"), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    made = runpy.run_path(str(folder / "make_motion.py"))
    truth = np.concatenate([made["MASS"], made["STIFFNESS"], made["DAMPING"]])
    with (tmp_path / "parameters.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    value, std = (np.array([float(row[key]) for row in rows]) for key in ("value", "standard_deviation"))
    assert np.abs((value - truth) / std).max() <= 4.0
    assert (std / truth).max() <= 0.01
    record = read_record(folder / "motion.h5")
    parts = made["motion"](made["true_structure"](), np.random.default_rng(3))
    assert np.asarray(record.values)[:, 12:18] == pytest.approx(parts[0], rel=1e-5, abs=1e-9)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed (apt-get install calculix-ccx)")
@pytest.mark.parametrize("study", ["study", "by_differences"])
def test_the_plate_in_calculix_gives_both_moduli(tmp_path, study):
    """The simulated model is exact: deviations are those of the noise."""
    folder = tmp_path / "plate"
    shutil.copytree(EXAMPLES / "plate_in_calculix", folder)
    done = CliRunner().invoke(
        app, ["identify", str(folder / f"{study}.toml"), "--out", str(tmp_path / "out"), "--no-report"]
    )
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "estimate.json").read_text())
    made = runpy.run_path(str(folder / "make_record.py"))
    for one in found["parameters"]:
        truth = made["TRUTH"][one["property"]]
        assert abs(one["value"] - truth) <= 4 * one["std_noise"]
        assert one["std_noise"] <= 0.01 * truth
    assert found["solver"]["largest_difference"] < 1e-6


@pytest.mark.long
def test_the_measured_frame_is_approximate():
    """What `make demo` says of it: one value of some sixteen differs between parts of the data, and is named."""
    ready = prepare_study(load_study(EXAMPLES / "three_storey_frame" / "study.toml"))
    result, _ = diagnose_study(ready, run_prepared(ready), explain=False)
    judgement = result.diagnosis.judgement
    assert judgement.verdict == "approximate"
    assert "Do not rely on stiffness[yaw guide]" in judgement.words

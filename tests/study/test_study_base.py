"""Supports that drive a structure, from a study file: histories, transmissibilities, ratios, and what is refused."""

import json
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid import read_record, write_record
from structid.cli.app import app
from structid.study.run.check import check_study
from structid.study.run.run import run_study
from structid.study.schema.records.record import load_record
from structid.study.schema.study import load_study

EXAMPLE = Path(__file__).parents[2] / "examples" / "shaken_building"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "study")
    return tmp_path / "study"


def changed(folder: Path, *pairs: tuple[str, str]) -> Path:
    path = folder / "study.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_shaken_building_gives_every_storey(tmp_path):
    """The simulated model is exact: deviations are those of the noise."""
    made = runpy.run_path(str(EXAMPLE / "make_record.py"))
    found = run_study(load_study(EXAMPLE / "study.toml")).identification.estimate
    truth = np.concatenate([made["STIFFNESS"], made["DAMPING"]])
    assert found.status.value == "converged"
    assert np.abs((found.values - truth) / found.std_noise).max() < 4
    assert (found.std_noise / truth).max() < 0.01
    assert found.chi_square_per_dof == pytest.approx(1.0, abs=0.05)


def test_the_total_mass_of_weighed_floors_is_known_as_well_as_they_are():
    """Floors that differ err by 1 % each, as one scale or each alone: T^2 (I + (1 - 1/n) 11'); at the start and at the end."""
    study = load_study(EXAMPLE / "study.toml")
    expected = 0.01 * np.sqrt(820.0**2 + 820.0**2 + 640.0**2 + (1 - 1 / 3) * 2280.0**2)
    assert check_study(study).total_mass_std == pytest.approx(expected, rel=1e-9)
    assert run_study(study).identification.mass.std == pytest.approx(expected, rel=1e-9)


FRF = (
    "[record.time]                   # fitted as it is: it begins and ends in motion\nnoise = 0.01                    # m/s^2\n",
    "[record.frf]\nsegment_length = 1000\n",
)


def test_transmissibilities_of_averaged_spectra_come_near(folder):
    """Leakage of four segments biases damping, not the size of stiffness."""
    path = changed(folder, FRF)
    made = runpy.run_path(str(EXAMPLE / "make_record.py"))
    study = load_study(path)
    assert load_record(study.setups[0].record).kind == "transmissibility"
    found = run_study(study).identification.estimate
    assert found.values[:3] == pytest.approx(made["STIFFNESS"], rel=0.02)


@pytest.mark.parametrize("name", ["frf.npz", "frf.csv", "frf.uff", "frf.h5"])
def test_files_keep_transmissibilities(folder, name):
    record = load_record(load_study(changed(folder, FRF)).setups[0].record)
    write_record(folder / name, record)
    again = read_record(folder / name)
    assert again.kind == "transmissibility"
    assert again.values == pytest.approx(record.values, rel=1e-6)
    assert again.unit == "1"


def test_unknown_masses_are_given_as_ratios(folder):
    every = '\n[[unknown]]\nproperty = "mass"\nelements = "floor"\neach = true\n\n[record]\n'
    path = changed(folder, ("\n[record]\n", every))
    done = run("identify", path, "--out", folder / "out", "--no-report", "--no-explain")
    assert done.exit_code == 1
    result = json.loads((folder / "out" / "estimate.json").read_text())
    assert any("ratios of stiffness to mass, not kilograms" in words for words in result["warnings"])
    made = runpy.run_path(str(EXAMPLE / "make_record.py"))
    ratios = run_study(load_study(path)).identification.mass.ratios
    assert ratios.names[0] == "stiffness[storey:1]"
    truth = np.concatenate([made["STIFFNESS"], made["DAMPING"], made["MASS"][1:]]) / made["MASS"][0]
    assert np.abs((ratios.values - truth) / ratios.std).max() < 4
    assert run("check", path).exit_code == 1


def test_check_tells_what_moves(folder):
    done = run("check", folder / "study.toml")
    assert done.exit_code == 0
    assert "moves 0X (base table)" in done.stdout


BASE = 'supports = ["0X"]'


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        (((BASE, 'supports = ["1X"]'),), ("[[structure.base]]", "no support 1X", "add it to `fixed`")),
        (((BASE, 'supports = ["9X"]'),), ("[[structure.base]]", "supports", "node 9 does not exist")),
        (((BASE, "supports = []"),), ("[[structure.base]]", "supports", "must be a text or a list of texts")),
        ((("[[structure.base]]", "[[structure.bases]]"),), ("bases", "base")),
        (
            (("[record.time] ", '[record.time]\nfit = "weak"\n#'),),
            ("'weak' takes no motion of supports", "'output_error'"),
        ),
        (
            (("[record.time] ", '[record.time]\nfit = "output_error"\n#'),),
            ("at most 1000 noisy samples of a support's motion", "got 3000; take spectra, shorten the record"),
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_place(folder, pairs, words):
    done = run("identify", changed(folder, *pairs), "--out", folder / "out")
    assert done.exit_code == 2
    told = " ".join(done.stderr.split())
    assert all(word in told for word in words), told
    assert "Traceback" not in told


def test_a_shaken_support_that_is_no_base_is_named(folder):
    text = (folder / "study.toml").read_text(encoding="utf-8")
    first, last = text.index("[[structure.base]]"), text.index("[structure.nodes]")
    (folder / "study.toml").write_text(text[:first] + text[last:], encoding="utf-8")
    done = run("identify", folder / "study.toml", "--out", folder / "out")
    assert done.exit_code == 2
    assert "[[structure.base]]" in done.stderr

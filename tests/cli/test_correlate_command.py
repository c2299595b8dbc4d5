"""The command `structid correlate`: what it prints, writes and returns."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.modal.formats.files import read_modes
from study_cases import write_chain

sys.path.insert(0, str(Path(__file__).parents[1] / "compare"))
import mast

RUN = CliRunner()


def invoke(*arguments: object):
    return RUN.invoke(cli.app, ["correlate", *(str(argument) for argument in arguments)])


def test_modes_are_printed_and_written_with_a_page(tmp_path):
    done = invoke(mast.written(tmp_path), "--out", tmp_path / "out")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[:2] == ["Mast", "Model at the start values of the study"]
    assert lines[2].startswith("4 of 4 measured modes paired: frequencies within 8.71")
    assert lines[-1] == str(tmp_path / "out" / "correlation.html")
    told = json.loads((tmp_path / "out" / "correlation.json").read_text())
    assert [row["model_mode"] for row in told["modal_records"][0]["modes"]] == [2, 1, 4, 3]
    assert np.shape(told["modal_records"][0]["self_orthogonality"]) == (4, 4)
    assert read_modes(tmp_path / "out" / "expanded_modes.csv").n_modes == 4
    page = (tmp_path / "out" / "correlation.html").read_text(encoding="utf-8")
    assert "Shapes side by side" in page
    assert str(tmp_path) not in page


def test_responses_are_printed_without_a_page(tmp_path):
    done = invoke(write_chain(tmp_path), "--out", tmp_path / "out", "--no-report")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "FRAC from" in done.stdout
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["correlation.json"]


def test_nothing_to_pair_exits_1_with_results(tmp_path):
    study = mast.written(tmp_path)
    record = read_modes(tmp_path / "modes.csv")
    lines = (tmp_path / "modes.csv").read_text().splitlines()
    wild = np.random.default_rng(8).standard_normal(record.mode_shapes.shape)
    head = lines[0].split(",")
    rows = [line.split(",") for line in lines[1:]]
    for mode, row in enumerate(rows):
        for c, dof in enumerate(record.channels):
            row[head.index(str(dof))] = repr(float(wild[c, mode]))
    (tmp_path / "modes.csv").write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    done = invoke(study, "--out", tmp_path / "out", "--least-mac", "0.99")
    assert done.exit_code == 1
    assert "no measured mode matches one of the model" in done.stderr
    assert (tmp_path / "out" / "correlation.json").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--at", "nowhere"), "holds no estimate.h5"),
        (("--reduction", "none"), "--reduction must be one of"),
        (("--model-error", "-1"), "--model-error must be at least 0"),
        (("--png", "--no-report"), "--png writes the figures"),
    ],
)
def test_what_cannot_be_used_exits_2(tmp_path, flags, words):
    done = invoke(mast.written(tmp_path), *flags)
    assert done.exit_code == 2
    assert words in done.stderr

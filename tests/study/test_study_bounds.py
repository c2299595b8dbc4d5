"""A parameter at its bound in what a study leaves: estimate.json, console and page."""

import json

import pytest
from typer.testing import CliRunner

from structid.cli import app as cli
from study_cases import CHAIN, write_chain

OPEN = '[[unknown]]\nproperty = "stiffness"\nelements = "ground"\n'


def test_a_bound_that_excludes_the_truth_is_in_all_that_is_written(tmp_path):
    """The truth is 1000 N/m, the bound 1050."""
    study = write_chain(tmp_path, CHAIN.replace(OPEN, OPEN + "bounds = [1050.0, 2000.0]\n"))
    out = tmp_path / "out"
    shown = CliRunner().invoke(cli.app, ["identify", str(study), "--out", str(out), "--no-explain", "--verbose"])
    summary = json.loads((out / "estimate.json").read_text())
    entries = {entry["name"]: entry for entry in summary["parameters"]}
    bound = entries["stiffness[ground]"]["at_bound"]
    assert (bound["side"], bound["limit"]) == ("lower", 1050.0)
    assert bound["multiplier"] > 0
    assert bound["push"] > 3
    assert bound["chi_square_gain_per_std"] == pytest.approx(
        2 * bound["multiplier"] * bound["std_without_bound"] - 1, rel=1e-9
    )
    assert entries["stiffness[ground]"]["value"] == pytest.approx(1050.0, rel=1e-12)
    assert entries["stiffness[ground]"]["std"] is None
    assert all(entry["at_bound"] is None for name, entry in entries.items() if name != "stiffness[ground]")
    assert not any(entry["ran_away"] for entry in entries.values())
    assert (summary["rank"], summary["n_parameters"], summary["n_free_parameters"]) == (7, 8, 7)
    assert summary["status"] == "converged"
    assert summary["verdict"] == "wrong_model"
    assert "stiffness[ground] is at its lower bound 1050 N/m; the data push below it" in summary["verdict_text"]
    assert "at its lower bound" in shown.output
    assert "Rank: 7 of 7 free" in shown.output
    page = (out / "report.html").read_text()
    assert "at its lower bound" in page
    assert "7 of 7 free ones" in page

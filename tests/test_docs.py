"""What the site says is so: the list of names is that of the package, and the first structure goes as told."""

import json
import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import structid
from structid.cli.app import app

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "api.md"
RUN = CliRunner()


def test_every_public_name_is_on_the_page_of_names_once():
    listed = re.findall(r"^   (\w+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(set(structid.__all__) - {"__version__"})


def test_help_lists_the_names_under_the_nouns_of_the_page():
    page = {
        noun: re.findall(r"^   (\w+)$", names, re.MULTILINE)
        for noun, names in re.findall(r"## (.+?)\n(.*?)(?=\n## |\Z)", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    }
    told = re.sub(r"\n    ", " ", structid.__doc__.split("noun:\n\n")[1]).strip().splitlines()
    assert dict(line.split(": ") for line in told) == {noun: ", ".join(names) for noun, names in page.items()}


@pytest.mark.long
def test_first_structure_goes_as_the_page_says(tmp_path):
    for name in ("study.toml", "record.csv"):
        shutil.copy(ROOT / "examples" / "first_structure" / name, tmp_path)
    first = RUN.invoke(app, ["identify", str(tmp_path / "study.toml"), "--out", str(tmp_path / "first")])
    assert first.exit_code == 3, first.output
    told = first.stdout.splitlines()[0].partition(";")[0]
    assert "the mesh is too coarse for the highest frequencies" in told
    assert told in (ROOT / "docs" / "first-structure.md").read_text(encoding="utf-8")
    better = tmp_path / "first" / "suggestions" / "1-mesh-all-lines.toml"
    second = RUN.invoke(app, ["identify", str(better), "--out", str(tmp_path / "second"), "--no-report"])
    assert second.exit_code == 0, second.output
    values = json.loads((tmp_path / "second" / "estimate.json").read_text())["parameters"]
    assert [one["value"] for one in values] == pytest.approx([28.0, 0.12, 0.012], rel=3e-3)


@pytest.mark.long
def test_every_step_of_the_first_bridge_goes_as_the_page_says(tmp_path, monkeypatch):
    """Causes are left out here: they take a minute and find none."""
    folder, page = (
        ROOT / "examples" / "two_span_bridge",
        (ROOT / "docs" / "first-bridge.md").read_text(encoding="utf-8"),
    )
    for one in (*folder.glob("*.csv"), folder / "study.toml"):
        shutil.copy(one, tmp_path)
    monkeypatch.chdir(tmp_path)
    steps = [shlex.split(line) for line in re.findall(r"```sh\nstructid (.*)\n```", page)]
    assert [words[0] for words in steps] == ["modes", "modes", "check", "identify"]
    shorter = {"modes": ["--no-report"], "check": [], "identify": ["--no-explain", "--no-report"]}
    told = {}
    for words in steps:
        done = RUN.invoke(app, [*words, *shorter[words[0]]])
        assert done.exit_code == 0, done.output
        told[words[1]] = done.output
    assert "decimal commas, names in line 2, units in line 3; Aufnehmer 1 is 2Y+" in told["ambient.csv"]
    assert "gives 7.291, 11.018, 25.049, 31.225 and 50.233 Hz" in page
    modes = json.loads((tmp_path / "hammer_modes" / "modes.json").read_text())
    assert modes["frequency_hz"] == pytest.approx([7.291, 11.018, 25.049, 31.225, 50.233], abs=1e-3)
    found = json.loads((tmp_path / "found" / "estimate.json").read_text())
    assert found["verdict_text"].partition(" No change of model or record was tried")[0] in " ".join(page.split())
    truth = runpy.run_path(str(folder / "make_records.py"))["TRUTH"]
    assert {one["name"] for one in found["parameters"]} == set(truth)
    for one in found["parameters"]:
        low, high = one["interval_95"]
        assert low < truth[one["name"]] < high
        assert one["std_noise"] < 0.004 * one["value"]
    rows = re.findall(r"^(\S+)  +(\S+) ± \S+ +(\S.*?)  +\S+ to \S+ ", page, re.MULTILINE)
    values = {name: float(value) * (1000.0 if unit.startswith("kN") else 1.0) for name, value, unit in rows}
    assert set(values) == set(truth)
    for one in found["parameters"]:
        assert values[one["name"]] == pytest.approx(one["value"], abs=0.06 * one["std"])


def test_the_mesh_of_the_first_bridge_is_said_to_be_coarse(tmp_path):
    folder = ROOT / "examples" / "two_span_bridge"
    shutil.copy(folder / "hammer.csv", tmp_path)
    text = (folder / "study.toml").read_text(encoding="utf-8").replace("subdivide = 3", "subdivide = 1")
    (tmp_path / "study.toml").write_text(text.partition('[[record]]\nname = "ambient"')[0], encoding="utf-8")
    done = RUN.invoke(app, ["check", str(tmp_path / "study.toml")])
    assert "`subdivide = 3` in [structure] brings every mode" in done.output.splitlines()[1]

"""What the site says is so: the list of names is that of the package, and the first structure goes as told."""

import json
import re
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


def test_first_structure_goes_as_the_page_says(tmp_path):
    for name in ("study.toml", "record.csv"):
        shutil.copy(ROOT / "examples" / "first_structure" / name, tmp_path)
    first = RUN.invoke(app, ["identify", str(tmp_path / "study.toml"), "--out", str(tmp_path / "first")])
    assert first.exit_code == 3, first.output
    assert "elements are too long for the highest frequencies" in first.stdout.splitlines()[0]
    better = tmp_path / "first" / "suggestions" / "1-mesh-all-lines.toml"
    second = RUN.invoke(app, ["identify", str(better), "--out", str(tmp_path / "second"), "--no-report"])
    assert second.exit_code == 0, second.output
    values = json.loads((tmp_path / "second" / "estimate.json").read_text())["parameters"]
    assert [one["value"] for one in values] == pytest.approx([28.0, 0.12, 0.012], rel=3e-3)

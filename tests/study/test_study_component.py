"""Components in a study file: read, identified, told of, and what is refused with its place."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from structid import FrfRecord, Unknown, parameters, simulated_record, with_declared_noise
from structid.cli.app import app
from structid.core.errors import InputError
from structid.records import write_record
from structid.study.results.folder import estimate_summary
from structid.study.run.check import check_study
from structid.study.run.run import run_study
from structid.study.schema.study import load_study

N = 5
CELLS = [[k, k + 1, k + N + 2, k + N + 1] for k in (1 + i + j * (N + 1) for j in range(N) for i in range(N))]
NODES = "\n".join(f"{1 + i + j * (N + 1)} = [{0.2 * i}, {0.15 * j}, 0.0]" for j in range(N + 1) for i in range(N + 1))
STUDY = f"""
title = "A panel on springs"
[structure]
active = ["Z", "RX", "RY"]
[structure.nodes]
{NODES}
[[structure.plate]]
name = "skin"
nodes = {CELLS}
youngs_modulus = 70e9
density = 2700.0
thickness = 4e-3
poisson = 0.3
loss_factor = 0.02
[[structure.spring]]
name = "mount"
first = ["1Z", "6Z", "31Z", "36Z"]
stiffness = 2.4e4
loss_factor = 0.02

[[structure.component]]
name = "panel"
elements = "skin"
up_to = 300.0
interface = "15Z"

[[unknown]]
property = "stiffness"
elements = "mount"
each = true

[record]
path = "frf.npz"
[record.noise]
relative = 0.01
[method]
band = [2.0, 60.0]
restarts = 0
"""
COMPONENT = STUDY[STUDY.index("[[structure.component]]") : STUDY.index("[[unknown]]")]
TRUE = np.array([2e4, 3e4, 1.5e4, 2.5e4])


@pytest.fixture
def study(tmp_path):
    """Writes the study with changes; the record is of the whole model."""
    path = tmp_path / "study.toml"

    def written(*changes: tuple[str, str]):
        text = STUDY
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
        return path

    (tmp_path / "frf.npz").write_bytes(b"x")
    whole = load_study(written((COMPONENT, ""))).structure
    unknown = parameters(whole, [Unknown("stiffness", "mount", each=True)]).started_at(TRUE)
    lines = np.linspace(2.0, 60.0, 80)
    like = FrfRecord(lines, np.ones((80, 3, 1)), ["15Z", "22Z", "8Z"], ["15Z"], "accelerance")
    record = simulated_record(whole, unknown, like, relative_noise=0.01, rng=np.random.default_rng(5))
    write_record(tmp_path / "frf.npz", with_declared_noise(record, 0.01))
    return written


def test_a_study_with_a_component_gives_the_answer_of_the_whole(study):
    found = run_study(load_study(study()))
    whole = run_study(load_study(study(("up_to = 300.0", "whole = true")))).identification.estimate
    estimate = found.identification.estimate
    assert estimate.status.value == "converged"
    assert estimate.values == pytest.approx(whole.values, rel=1e-4)
    assert np.abs((estimate.values - TRUE) / estimate.std).max() < 4
    told = estimate_summary(found)["reduction"]
    assert "component panel: 108 degrees of freedom reduced to 5 of its interface" in told["components"][0]
    assert "changes the model's FRFs" in told["changes"][0]
    assert not any("reduction" in words for words in found.identification.warnings)


def test_modes_are_kept_up_to_three_times_the_band_by_default(study):
    [part] = load_study(study(("up_to = 300.0\n", ""))).structure.components
    assert part.up_to == 180.0


def test_what_reduction_changes_is_told_before_and_after(study):
    path = study(("up_to = 300.0\n", "up_to = 65.0\n"), ('interface = "15Z"\n', ""))
    checked = check_study(load_study(path))
    assert any("raise `up_to` of the component" in words for words in checked.warnings)
    assert any(fact.startswith("component panel") for fact in checked.beside[0].facts)
    done = CliRunner().invoke(app, ["identify", str(path), "--out", str(path.parent / "out")])
    assert "Wrong model: reduction changes the model's FRFs" in done.stdout
    assert "raise `up_to` of the component" in " ".join(done.stdout.split())
    written = json.loads((path.parent / "out" / "estimate.json").read_text())
    assert "changes the model's FRFs by up to" in written["reduction"]["changes"][0]
    page = (path.parent / "out" / "report.html").read_text()
    assert "Error of reduction" in page
    assert "reduced to 4 of its interface" in page


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('elements = "skin"\nup', 'elements = "skim"\nup', "there is no element set 'skim'; the nearest is 'skin'"),
        ("band = [2.0, 60.0]", "", "`up_to` is missing; add `up_to = ...`, Hz, such as three times"),
        ("up_to = 300.0", "up_to = 0.0", "must be a frequency above 0, Hz"),
        ('"15Z"', '"99Z"', "node 99 does not exist"),
        ('"15Z"', '"15X"', "15X of `interface` is no degree of freedom of it; the nearest is 15Z"),
        ("up_to = 300.0", "upto = 300.0", "unknown key; the nearest is `up_to`"),
        ('name = "panel"', 'name = "mount"', "two parts of the structure are called 'mount'"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(study, old, new, words):
    given = [("up_to = 300.0\n", "")] if "band" in old else []
    done = CliRunner().invoke(app, ["check", str(study(*given, (old, new)))])
    text = " ".join(done.output.split())
    assert done.exit_code == 2
    assert words in text
    assert "[[structure." in text


def test_a_band_that_is_no_range_is_told_with_its_own_place(study):
    given = ("up_to = 300.0\n", ""), ("band = [2.0, 60.0]", "band = 60.0")
    with pytest.raises(InputError, match=r"\[method\] band: must be two increasing numbers"):
        load_study(study(*given))


def test_an_unknown_inside_is_refused_with_its_place(study):
    path = study(('property = "stiffness"\nelements = "mount"', 'property = "youngs_modulus"\nelements = "skin"'))
    done = CliRunner().invoke(app, ["check", str(path)])
    text = " ".join(done.output.split())
    assert done.exit_code == 2
    assert "[[unknown]]" in text
    assert "element set 'skin' is in component 'panel', which is reduced once" in text


def test_the_whole_component_may_be_unknown(study):
    path = study(('property = "stiffness"\nelements = "mount"\neach = true', 'property = "mass"\nelements = "panel"'))
    assert load_study(path).parameters.names == ("mass[panel]",)

"""The step *Use* of the workbench: predictions beside what was measured, changes asked about, files for other programs."""

import base64
import json
import re
import shutil

import meshio
import numpy as np
import pytest
from app_cases import require_workbench, served, write_beam_record
from browser_cases import accessible, shown, step

import structid as sid
from structid.prediction.linear_response import movable_supports, support_base
from structid.study.results.folder import write_results
from structid.study.results.stored_model import stored_model, stored_study
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from structid.study.templates import TEMPLATES, template_with, write_study
from structid.workbench.folder import EXPORTS, OpenFolder
from structid.workbench.work.functions import answer_json
from study_cases import write_chain

require_workbench()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the chain's study and its results."""
    folder = tmp_path_factory.mktemp("used")
    result = run_study(load_study(write_chain(folder)))
    (folder / "chain_results").mkdir()
    write_results(result, folder / "chain_results")
    return folder


def ask(folder, name, **given):
    return json.loads(answer_json(name, str(folder), given))


def curve(text):
    return np.frombuffer(base64.b64decode(text), np.float32)


def test_what_can_be_asked_is_told(folder):
    facts = ask(folder, "use", results="chain_results")
    assert (facts["dofs"], facts["nodes"]) == (["1X+", "2X+", "3X+"], [1, 2, 3])
    assert (facts["outputs"], facts["inputs"], facts["kind"]) == (["1X+", "3X+"], ["3X+"], "accelerance")
    assert facts["band"] == [0.5, 12.0]
    assert (facts["supports"], facts["element_outputs"]) == ([], [])  # springs to the ground have neither
    assert "stiffness[upper]" in facts["properties"]
    offers = {one["kind"]: one for one in facts["offers"]}
    assert ".vtu" in offers["mesh"]["suffixes"]
    assert "deck" in offers["deck"]["obstacle"]


def test_the_identified_structure_has_the_colours_of_its_changes_and_the_shapes_of_its_modes(folder):
    told = ask(folder, "identified", results="chain_results")
    estimate = json.loads((folder / "chain_results" / "estimate.json").read_text(encoding="utf-8"))
    values = {one["name"]: one for one in estimate["parameters"]}
    shading = next(one for one in told["shadings"] if one["title"] == "Change of stiffness parameters")
    part = shading["sets"]["upper"]
    spring = values["stiffness[upper:1]"]
    low, high = spring["interval_95"]
    assert not low < spring["initial"] < high  # so that it has a colour
    colours = [part["colours"][k] for k in np.frombuffer(base64.b64decode(part["index"]), np.uint8)]
    assert len(colours) == next(one["count"] for one in told["sets"] if one["name"] == "upper")
    is_stiffer = spring["value"] > spring["initial"]
    red, _, blue = bytes.fromhex(colours[0].lstrip("#"))
    assert (blue > red) == is_stiffer  # purple for more, orange for less
    assert len(shading["legend"]["ticks"]) == 5
    shape = curve(told["modes"][0]["moves"]).reshape(-1, 3)
    np.testing.assert_allclose(shape[:, 1:], 0.0)  # a chain along X
    assert np.all(np.diff(np.abs(shape[:, 0])) > 0)  # its first mode grows from the ground up
    assert told["modes"][0]["name"].startswith("mode 1: ")


@pytest.mark.parametrize("parameters", [5, [], [{"name": "mass[mass 1]"}], [[]]])
def test_an_estimate_that_lists_no_parameters_is_refused_in_words(folder, parameters):
    damaged = folder / "damaged"
    shutil.copytree(folder / "chain_results", damaged, dirs_exist_ok=True)
    estimate = json.loads((damaged / "estimate.json").read_text(encoding="utf-8"))
    (damaged / "estimate.json").write_text(json.dumps({**estimate, "parameters": parameters}), encoding="utf-8")
    told = ask(folder, "identified", results="damaged")
    assert told["error"] == "damaged/estimate.json: its parameters cannot be used; run the study again"


def test_a_prediction_has_the_band_around_the_value(folder):
    options = {"sensor": "2X", "load": "3X", "kind": "accelerance", "band": [1, 10]}
    told = ask(folder, "predict", results="chain_results", options=options, changes=[])
    part = told["frf"]["parts"]["value"]
    low, value, high = (curve(part[key]) for key in ("low", "value", "high"))
    assert (len(low), told["changes"]) == (400, [])
    assert ((low < value) & (value < high)).mean() > 0.95
    identified = json.loads((folder / "chain_results" / "estimate.json").read_text())["modes"]
    for mode, own in zip(told["modes"], identified, strict=False):
        assert mode["frequency_hz"]["value"]["value"] == pytest.approx(own["frequency_hz"])


def test_a_history_under_a_file_of_loads_has_its_band_and_its_largest_value(folder):
    force = np.sin(np.arange(9000) / 15.0)[:, None]
    sid.write_record(folder / "push.h5", sid.TimeRecord(200.0, force, ["3X"], ["force"]))
    options = {"sensor": "2X,1X", "load": "3X", "band": [1, 10], "history": "push.h5", "motion": "displacement"}
    told = ask(folder, "predict", results="chain_results", options=options, changes=[])
    model = stored_model(folder / "chain_results", stored_study(folder / "chain_results"))
    exact = sid.predict(model, sid.History(["2X"], ["3X"], force, 200.0, "displacement"), n_draws=50).values[:, 0]
    low, value, high = (curve(told["history"]["parts"]["value"][key]) for key in ("low", "value", "high"))
    bins = exact.reshape(1800, 5)  # of 9000 samples, drawn with 4000 points at most
    np.testing.assert_allclose(value[::2], bins.min(axis=1), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(value[1::2], bins.max(axis=1), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(
        np.frombuffer(base64.b64decode(told["history"]["time"])), np.repeat(np.arange(0, 9000, 5) / 200.0, 2)
    )
    assert (told["history"]["output"], told["history"]["thinned"]) == ("2X+", True)
    assert (told["frf"]["output"], told["frf"]["input"]) == ("2X+", "3X+")
    assert ((low <= value) & (value <= high)).mean() > 0.95
    largest, least, most = told["history"]["largest"]["value"]
    assert largest == pytest.approx(np.abs(exact).max())
    assert least < largest < most
    assert told["history"]["words"] == "loads of push.h5, in straight lines between samples"
    assert "frf" in told
    options |= {"history": "../push.h5"}
    assert "error" in ask(folder, "predict", results="chain_results", options=options, changes=[])


def test_without_a_load_the_response_is_to_the_first_of_the_record(folder):
    told = ask(folder, "predict", results="chain_results", options={"sensor": "2X", "band": [1, 10]}, changes=[])
    assert (told["frf"]["output"], told["frf"]["input"]) == ("2X+", "3X+")


def test_changes_are_compared_with_the_model_as_it_is(folder):
    changes = [
        {"kind": "mass", "node": "2", "mass": 1.0},
        {"kind": "scale", "label": "stiffness[ground]", "factor": 1.5},
    ]
    told = ask(folder, "predict", results="chain_results", options={}, changes=changes)
    assert told["changes"] == ["1 kg added at node 2", "stiffness[ground] times 1.5"]
    first = told["modes"][0]["frequency_hz"]
    assert first["difference"]["value"] == pytest.approx(first["after"]["value"] - first["before"]["value"])
    assert "frf" not in told


@pytest.fixture(scope="module")
def cantilever(tmp_path_factory):
    """A folder with a beam's study, clamped at node 1, and its results."""
    folder = tmp_path_factory.mktemp("cantilever")
    study = write_study(template_with(TEMPLATES["beam"], {"elements": 2}), folder / "beam.toml")
    write_beam_record(study, folder / "hammer.npz", ("2Y+", "3Y+"), ("2Y+", "3Y+"))
    study.write_text(study.read_text(encoding="utf-8") + '\n[record]\npath = "hammer.npz"\n', encoding="utf-8")
    (folder / "beam_results").mkdir()
    write_results(run_study(load_study(study)), folder / "beam_results")
    return folder


def test_forces_of_elements_and_supports_that_move_can_be_asked_about(cantilever):
    facts = ask(cantilever, "use", results="beam_results")
    assert facts["supports"] == ["1Y"]
    names = facts["element_outputs"]
    assert {"V[beam:1@1]", "M[beam:2@3]"} <= set(names)
    for sensor in {name.split("[")[0]: name for name in names}.values():  # one of each kind
        options = {"sensor": sensor, "load": "3Y", "kind": "accelerance", "band": [0.1, 0.2]}
        assert "frf" in ask(cantilever, "predict", results="beam_results", options=options, changes=[]), sensor
    options = {"sensor": "M[beam:1@1]", "load": "3Y", "kind": "accelerance", "band": [0.1, 0.2]}
    told = ask(cantilever, "predict", results="beam_results", options=options, changes=[])
    length = 0.6
    assert told["frf"]["unit"] == "(N m)/(N)"
    np.testing.assert_allclose(
        curve(told["frf"]["parts"]["value"]["value"]), length, rtol=1e-2
    )  # statics: force times arm
    assert (told["frf"]["kind"], told["frf"]["moved"]) == ("accelerance", [])
    options = {
        "sensor": "3Y",
        "load": "1y",
        "kind": "receptance",
        "band": [0.1, 0.2],
    }  # of a force; here a support moves
    told = ask(cantilever, "predict", results="beam_results", options=options, changes=[])
    np.testing.assert_allclose(
        curve(told["frf"]["parts"]["value"]["value"]), 1.0, rtol=1e-2
    )  # it goes with its support
    assert (told["frf"]["kind"], told["frf"]["moved"]) == ("transmissibility", ["1Y"])
    options = {"sensor": "strain[beam:1@2]", "load": "3Y", "kind": "accelerance", "band": [0.1, 0.2]}
    told = ask(cantilever, "predict", results="beam_results", options=options, changes=[])
    assert "give y: at the neutral axis the strain is 0" in told["error"]


def test_supports_that_nothing_holds_to_are_not_offered():
    parts = [sid.Bar("bars", [[1, 2], [2, 3], [1, 3]], mass=1.0, axial_stiffness=1e5)]
    nodes = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (0.0, 1.0)}
    structure = sid.Structure(nodes, parts, fixed=["1X", "1Y", "1Z", "3X"])
    assert [dof.place for dof in movable_supports(structure)] == ["1X", "1Y", "3X"]
    with pytest.raises(sid.InputError, match=r"1Z.* cannot be moved: .* such supports are 1X, 1Y, 3X"):
        support_base(structure, sid.parse_dof("1Z"))


def test_a_damper_is_tuned_where_the_page_asks_for_it(folder):
    change = {"kind": "tune", "dof": "3X", "mass": 0.1}
    options = {"sensor": "3X", "load": "3X", "kind": "receptance", "band": [1, 10]}
    told = ask(folder, "predict", results="chain_results", options=options, changes=[change])
    before, after = (curve(told["frf"]["parts"][name]["value"]).max() for name in ("before", "after"))
    assert after < 0.5 * before
    assert "0.1 kg" in told["changes"][0]
    twice = ask(folder, "predict", results="chain_results", options=options, changes=[change, change])
    assert "one damper is tuned at a time" in twice["error"]


def test_a_damper_is_tuned_to_the_structure_with_the_other_changes(folder):
    softer = {"kind": "scale", "label": "stiffness[ground]", "factor": 0.25}
    asked = {"results": "chain_results", "options": {}}
    [_, before] = tuned_damper_words(
        ask(folder, "predict", **asked, changes=[{"kind": "tune", "dof": "3X", "mass": 0.1}])
    )
    told = ask(folder, "predict", **asked, changes=[{"kind": "tune", "dof": "3X", "mass": 0.1}, softer])
    words, tuned = tuned_damper_words(told)
    assert tuned < 0.85 * before, words
    assert told["changes"][0] == "stiffness[ground] times 0.25"  # made before it is tuned


def tuned_damper_words(told):
    """Words of the damper among the changes, and the frequency in them, Hz."""
    words = next(one for one in told["changes"] if "damper" in one)
    return words, float(re.search(r"([\d.]+) Hz", words)[1])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([{"kind": "tune", "dof": "3X"}], "tune: `mass` must be given"),
        ([{"kind": "paint"}], "a change must be one of mass, scale"),
        ([{"kind": "mass", "node": 2}], "mass: `mass` must be given"),
        ([{"kind": "mass", "node": "two", "mass": 1.0}], "`node` must be a number of a node, got 'two'"),
        ([{"kind": "mass", "node": "²", "mass": 1.0}], "`node` must be a number of a node, got '²'"),
        ([{"kind": "mass", "node": 7, "mass": 1.0}], "no node 7"),
        ([{"kind": "support", "dof": "9X"}], "9X"),
        ([{"kind": "remove", "name": "deck"}], "no element set 'deck'"),
    ],
)
def test_a_change_of_what_is_not_there_is_named(folder, changes, words):
    assert words in ask(folder, "predict", results="chain_results", options={}, changes=changes)["error"]


def test_files_are_written_beside_the_results(folder):
    told = ask(folder, "exports", results="chain_results", kind="mesh", suffix=".vtu", options={"modes": 2})
    assert told["paths"] == [f"chain_results{EXPORTS}/chain_results_mesh.vtu"]
    assert len(meshio.read(folder / told["paths"][0]).points) == 3
    told = ask(folder, "exports", results="chain_results", kind="matrices", suffix=".npz", options={})
    assert {path.split("_")[-1] for path in told["paths"]} >= {"MAA.npz", "KAA.npz", "matrices.dofs.txt"}
    listed = OpenFolder(folder).listing()
    assert not [one for kind in ("records", "models") for one in listed[kind] if EXPORTS in one["path"]]
    for kind, suffix in (("mesh", ".exe"), ("deck", ".bdf"), ("../x", ".vtu")):
        told = ask(folder, "exports", results="chain_results", kind=kind, suffix=suffix, options={})
        assert "is no file of these results" in told["error"]


@pytest.mark.long
def test_an_answer_is_used_in_the_browser(page, screens, tmp_path):
    study = write_study(template_with(TEMPLATES["beam"], {"elements": 4}), tmp_path / "beam.toml")
    write_beam_record(study, tmp_path / "hammer.npz", ("3Y+", "5Y+"), ("3Y+", "5Y+"))
    study.write_text(study.read_text(encoding="utf-8") + '\n[record]\npath = "hammer.npz"\n', encoding="utf-8")
    (tmp_path / "beam_results").mkdir()
    write_results(run_study(load_study(study)), tmp_path / "beam_results")
    force = np.sin(np.arange(600) / 9.0)[:, None]
    sid.write_record(tmp_path / "push.csv", sid.TimeRecord(200.0, force, ["5Y"], ["force"]))
    with served(tmp_path) as bench:
        page.goto(bench.address + "#results/beam.toml")
        step(page, "Use")
        page.get_by_role("heading", name="Predict").wait_for()
        assert page.get_by_label("Sensor, force or strain").input_value() == "3Y+"
        page.get_by_label("band from, Hz").fill("5")
        page.get_by_label("to, Hz").fill("120")
        page.get_by_role("button", name="Predict").press("Enter")  # by the keyboard
        page.locator("#predicted-frf .main-svg").first.wait_for()
        page.get_by_text("measured in the record").wait_for()
        shown(page, screens, "31_predicted")
        accessible(page, "predicted")
        page.get_by_label("Loads of the file").select_option("push.csv")
        page.get_by_label("Sensor, force or strain").fill("5Y, 3Y")
        page.get_by_role("button", name="Predict").click()
        page.locator("#predicted-history .main-svg").first.wait_for()
        page.get_by_text("Under loads of push.csv").wait_for()
        page.get_by_role("heading", name="Motion at 5Y+ over time").wait_for()
        shown(page, screens, "31_predicted_history")
        accessible(page, "predicted history")
        page.get_by_label("Sensor, force or strain").fill("2Y")
        page.get_by_label("A change").select_option("damper")
        for label, text in (("Where", "5Y"), ("kg", "0.2"), ("Hz", "11,5"), ("Damping ratio", "0.1")):
            page.get_by_label(label, exact=True).fill(text)
        page.get_by_role("button", name="Add the change").click()
        page.get_by_text("11,5 is no number; write 11.5").wait_for()
        page.get_by_label("Hz", exact=True).fill("11.5")
        page.get_by_role("button", name="Add the change").click()
        page.get_by_role("button", name="Take back: a tuned mass damper").wait_for()
        page.get_by_role("button", name="Predict").click()
        page.get_by_text("Modes before and after: ").wait_for()
        page.get_by_text("no sensor of the record is there").wait_for()
        page.get_by_role("cell", name="change", exact=True).wait_for()
        page.locator("#predicted-frf .main-svg").first.wait_for()
        shown(page, screens, "32_what_if")
        accessible(page, "what if")
        page.locator("[data-offer=mesh]").get_by_role("button", name="Write mesh").click()
        with page.expect_download() as waiting:
            page.get_by_role("link", name="beam_results_exports/beam_results_mesh.vtu").click()
        assert len(meshio.read(waiting.value.path(), "vtu").points) == 5  # of the identified model, without the damper
        shown(page, screens, "33_exports")
        accessible(page, "exports")

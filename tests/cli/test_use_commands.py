"""The commands `predict`, `sense` and `export`: what they print and write, and what they refuse."""

import csv
import json
import shutil

import h5py
import numpy as np
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.fem.importers import read_matrices
from structid.modal.formats.files import read_modes
from structid.study.results.stored_model import stored_model, stored_study
from study_cases import RIGID, rigid_record, write_chain

RUN = CliRunner()


def invoke(*arguments: object):
    return RUN.invoke(cli.app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("use")
    study = write_chain(folder)
    done = invoke("identify", study, "--out", folder / "out", "--no-report")
    assert done.exit_code == 0, done.stderr
    return folder / "out"


def test_predict_writes_bands_and_a_page(results, tmp_path):
    done = invoke(
        "predict", results, "--sensors", "2X,3X", "--lines", 30, "--draws", 60, "--modes", 3, "--participation", "X",
        "--out", tmp_path / "p",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0].startswith("FRFs and modes predicted from")
    told = json.loads((tmp_path / "p" / "prediction.json").read_text())
    identified = json.loads((results / "estimate.json").read_text())
    for mode, own in zip(told["modes"], identified["modes"], strict=False):
        value = mode["frequency_hz"]["value"]
        assert value["value"] == pytest.approx(own["frequency_hz"])
        assert value["interval_95"][0] < value["value"] < value["interval_95"][1]
    parts = [mode["part_of_mass"]["value"]["value"] for mode in told["participation"]["X"]]
    assert (len(parts), sum(parts)) == (3, pytest.approx(1.0))
    assert "Along X (kg)" in done.stdout
    table = np.genfromtxt(tmp_path / "p" / "frf.csv", delimiter=",", names=True)
    assert len(table) == 30
    page = (tmp_path / "p" / "prediction.html").read_text(encoding="utf-8")
    assert "95 % band" in page
    assert "Effective mass of each mode" in page


def test_predict_tells_what_a_change_does(results, tmp_path):
    done = invoke(
        "predict", results, "--mass", "1@2", "--draws", 60, "--modes", 2, "--participation", "X", "--out", tmp_path / "p",
        "--no-report",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    assert "1 kg added at node 2" in done.stdout
    first = json.loads((tmp_path / "p" / "prediction.json").read_text())["modes"][0]["frequency_hz"]
    assert first["after"]["value"] < first["before"]["value"]
    assert first["difference"]["value"] == pytest.approx(first["after"]["value"] - first["before"]["value"])
    mass = json.loads((tmp_path / "p" / "prediction.json").read_text())["participation"]["X"][0]["effective_mass_kg"]
    assert mass["after"]["value"] > mass["before"]["value"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--mass", "one@2"], "--mass must hold numbers"),
        (["--mass", "5"], "a mass and a node, as 5@12"),
        (["--mass", "5@²"], "a mass and a node, as 5@12, got '5@²'"),
        (["--mass", "5@99"], "no node 99"),
        (["--scale", "stiffness"], "a property and a factor"),
        (["--damper", "5@2X"], "kg, Hz, damping ratio and a place"),
        (["--sensors", "9X"], "9X"),
        (["--participation", "RX"], "--participation must name axes"),
        (["--participation", "X,Y"], "--participation Y: no mass moves along Y: ask for another direction"),
        (["--sensors", "2X", "--kind", "inertance"], "--kind must be one of"),
        (["--history", "push.csv"], "--sensors must name where the motion"),
    ],
)
def test_predict_names_what_cannot_be(results, tmp_path, arguments, words):
    done = invoke("predict", results, *arguments, "--out", tmp_path / "p")
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "p").exists()


def test_an_axis_without_mass_is_told_before_anything_is_drawn(results, tmp_path, monkeypatch):
    monkeypatch.setattr("structid.study.run.predicting.predict_together", lambda *_, **__: pytest.fail("drawn"))
    done = invoke("predict", results, "--sensors", "2X", "--participation", "Y", "--out", tmp_path / "p")
    assert (done.exit_code, "no mass moves along Y" in done.stderr) == (2, True)


def test_results_of_another_study_are_refused(results, tmp_path):
    study = (results / "study.toml").read_text()
    other = write_chain(tmp_path, study + "\n# changed since\n")
    done = invoke("predict", results, "--study", other)
    assert done.exit_code == 2
    assert "chain.toml has changed since" in done.stderr
    done = invoke("predict", tmp_path, "--sensors", "2X")
    assert done.exit_code == 2
    assert "holds no estimate.json" in done.stderr


def test_a_model_that_does_not_explain_its_record_is_doubted(results, tmp_path):
    shutil.copytree(results, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "estimate.json").read_text())
    (tmp_path / "out" / "estimate.json").write_text(json.dumps(told | {"verdict": "wrong_model"}), encoding="utf-8")
    study = results.parent / "chain.toml"
    done = invoke("predict", tmp_path / "out", "--study", study, "--draws", 60, "--out", tmp_path / "p")
    assert (done.exit_code, "note: the verdict on this model" in done.stdout) == (0, True), done.stderr
    assert json.loads((tmp_path / "p" / "prediction.json").read_text())["warnings"]
    assert "Do not rely on this yet" in (tmp_path / "p" / "prediction.html").read_text(encoding="utf-8")


def test_export_writes_state_equations_and_matrices(results, tmp_path):
    equations, matrices = tmp_path / "chain.mat", tmp_path / "chain.op4"
    done = invoke(
        "export", results, "--state-space", equations, "--matrices", matrices, "--sensors", "2X", "--loads", "1X", "--band", 1, 30,
        "--motion", "displacement", "--draws", 2,
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    content = loadmat(equations)
    assert content["a_draws"].shape == (2, *content["a"].shape)
    assert "largest error of FRFs" in done.stdout
    found = {item.name: item.matrix for item in read_matrices(matrices).values()}
    assert found["MAA"].shape == found["KAA"].shape
    assert (tmp_path / "chain.dofs.txt").read_text().splitlines()[0] == "1 1"
    for rest, words in (
        (["--sampling-rate", 50], "more than twice the highest frequency"),
        (["--error", "two"], "as 1% or 0.01, got 'two'"),
    ):
        done = invoke(
            "export",
            results,
            "--state-space",
            tmp_path / "no.mat",
            "--sensors",
            "2X",
            "--loads",
            "1X",
            "--band",
            1,
            30,
            *rest,
        )
        assert (done.exit_code, words in done.stderr) == (2, True), done.stderr
    done = invoke("export", results, "--matrices", matrices)
    assert (done.exit_code, "exists already" in done.stderr) == (2, True)
    done = invoke("export", results)
    assert (done.exit_code, done.stdout.count(".op4")) == (0, 1)


def test_two_contents_do_not_go_into_one_file(results, tmp_path):
    done = invoke("export", results, "--mode-shapes", tmp_path / "a.pch", "--matrices", tmp_path / "a.pch", "--force")
    assert (done.exit_code, "give each a file of its own" in done.stderr) == (2, True)
    assert not list(tmp_path.iterdir())


def test_export_writes_elements_and_modes(results, tmp_path):
    files = [tmp_path / name for name in ("chain.csv", "chain.uff")]
    done = invoke("export", results, "--mesh", files[0], "--mode-shapes", files[1], "--modes", 2)
    assert (done.exit_code, done.stderr) == (0, "")
    identified = json.loads((results / "estimate.json").read_text())
    with files[0].open() as stream:
        rows = {f"{row['property']}[{row['element set']}]": row for row in csv.DictReader(stream)}
    for parameter in identified["parameters"]:
        if (row := rows.get(parameter["name"])) is not None:
            assert float(row["value"]) == pytest.approx(parameter["value"])
            assert float(row["deviation"]) == pytest.approx(parameter["std"])
            assert float(row["initial"]) == pytest.approx(parameter["initial"])
    np.testing.assert_allclose(
        read_modes(files[1]).frequency, [mode["frequency_hz"] for mode in identified["modes"][:2]], rtol=1e-5
    )


def test_results_of_another_version_are_refused_by_every_command(results, tmp_path):
    shutil.copytree(results.parent, tmp_path / "v")
    folder = tmp_path / "v" / results.name
    calls = (["export"], ["export", "--mesh", tmp_path / "m.vtu"], ["predict", "--out", tmp_path / "p"])
    for damage, words in (
        (
            lambda file: file.attrs.__setitem__("format", "structid estimate 2"),
            "another version of structid (structid estimate 2",
        ),
        (lambda file: file.attrs.__delitem__("format"), "another version of structid (none"),
    ):
        with h5py.File(folder / "estimate.h5", "a") as file:
            damage(file)
        for name, *rest in calls:
            done = invoke(name, folder, *rest)
            assert (done.exit_code, words in done.stderr) == (2, True), done.stderr
    shutil.copy(results / "estimate.h5", folder)
    with h5py.File(folder / "estimate.h5", "a") as file:
        del file["parameters/initial"]
    done = invoke("export", folder, "--mesh", tmp_path / "m.vtu")
    assert (done.exit_code, "holds no initial values; identify again" in done.stderr) == (2, True)
    assert not (tmp_path / "m.vtu").exists()


def test_a_model_that_the_data_do_not_determine_is_refused(tmp_path):
    study = write_chain(tmp_path, RIGID, rigid_record())
    assert invoke("identify", study, "--out", tmp_path / "out", "--no-report").exit_code == 1
    for arguments in (
        ["export"],
        ["export", "--matrices", tmp_path / "m.op4"],
        ["predict", "--out", tmp_path / "p"],
        ["sense", tmp_path / "frf.npz", "--wanted", "1X", "--out", tmp_path / "s"],
    ):
        name, *rest = arguments
        done = invoke(name, tmp_path / "out", *rest)
        assert (done.exit_code, "do not determine mass[mass 2], mass[mass 3]" in done.stderr) == (1, True), done.stderr
    assert not list(tmp_path.glob("m.*"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--support", "1X", "--support", "2X", "--support", "3X"], "nothing of the changed structure can move"),
        (["--remove", "mass 1", "--remove", "mass 2", "--remove", "mass 3"], "has no mass (mass 1 removed"),
        (["--support", "9X"], "9X"),
        (["--remove", "deck"], "no element set 'deck'"),
        (["--sensors", "2X", "--loads", "1Y"], "1Y+ is not part of the structure"),
    ],
)
def test_a_change_that_leaves_nothing_is_named(results, tmp_path, arguments, words):
    done = invoke("predict", results, *arguments, "--out", tmp_path / "p")
    assert (done.exit_code, words in done.stderr) == (2, True), done.stderr


def test_modes_are_compared_where_a_mass_is_taken_out(results, tmp_path):
    done = invoke("predict", results, "--remove", "mass 3", "--draws", 60, "--out", tmp_path / "p", "--no-report")
    assert (done.exit_code, done.stderr) == (0, "")
    assert len(json.loads((tmp_path / "p" / "prediction.json").read_text())["modes"]) == 2


@pytest.mark.parametrize("is_of_the_model", [True, False])
def test_sense_writes_motion_and_forces(results, tmp_path, is_of_the_model):
    rng = np.random.default_rng(0)
    force = np.cumsum(rng.standard_normal((300, 2)), axis=0)
    force -= force.mean(axis=0)
    values = force
    if is_of_the_model:
        model = stored_model(results, stored_study(results))
        values = sid.predict(model, sid.History(["1X", "3X"], ["2X"], force[:, :1], 200.0), n_draws=50).values
        values = values + 0.01 * values.std(axis=0) * rng.standard_normal(values.shape)
    record = sid.TimeRecord(200.0, values, ["1X", "3X"], ["acceleration", "acceleration"])
    sid.write_record(tmp_path / "record.h5", record)
    done = invoke(
        "sense", results, tmp_path / "record.h5", "--wanted", "2X", "--unknown", "2X", "--correlation-time", 0.1, "--draws", 0,
        "--out", tmp_path / "s",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0 if is_of_the_model else 3, "")
    assert ("the model does not explain the record" in done.stdout) != is_of_the_model
    told = json.loads((tmp_path / "s" / "sensed.json").read_text())
    assert (told["verdict"], bool(told["contradiction"])) == (
        ("explained", False) if is_of_the_model else ("wrong_model", True)
    )
    table = np.genfromtxt(tmp_path / "s" / "sensed.csv", delimiter=",", skip_header=1)
    assert table.shape == (300, 5)
    assert np.isfinite(table).all()
    assert json.loads((tmp_path / "s" / "sensed.json").read_text())["outputs"][0]["where"] == "2X+"
    assert "correlation time 0.1" in done.stdout
    page = (tmp_path / "s" / "sensed.html").read_text(encoding="utf-8")
    assert ("Do not rely on this: the record contradicts the model" in page) != is_of_the_model
    assert ("Sensors that were left out" in page, "Unknown forces" in page) == (False, True)
    done = invoke("sense", results, tmp_path / "record.h5", "--wanted", "2X", "--out", tmp_path / "t")
    assert (done.exit_code, "holds no force and none is named as unknown" in done.stderr) == (2, True)


def test_predict_under_a_pulse_and_under_noise(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # files are named as seen from the folder of the call
    done = invoke(
        "predict", results, "--sensors", "2X", "--half-sine", "5,0.05@3X", "--duration", 2, "--sampling-rate", 200, "--draws", 60,
        "--modes", 2, "--lines", 10, "--motion", "displacement", "--out", tmp_path / "a",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    assert "half-sine of 0.05 s, 5 N, at 3X+" in done.stdout
    told = json.loads((tmp_path / "a" / "prediction.json").read_text())
    [largest] = told["maxima"]
    assert largest["unit"] == "m"
    quantiles = list(largest["value"]["quantiles"].values())
    assert quantiles == sorted(quantiles)
    assert quantiles[0] < largest["value"]["value"] < quantiles[-1]
    (tmp_path / "wind.csv").write_text("Hz,N^2/Hz\n0.5,2.0\n12,1.0\n", encoding="utf-8")
    done = invoke(
        "predict", results, "--sensors", "2X", "--noise", "wind.csv@3X", "--duration", 60, "--draws", 60, "--modes", 2,
        "--lines", 400, "--sampling-rate", 50, "--out", tmp_path / "b",
    )  # fmt: skip
    assert (done.exit_code, done.stderr) == (0, "")
    told = json.loads((tmp_path / "b" / "prediction.json").read_text())
    [mean], [most] = told["root_mean_square"], told["largest"]
    assert 2.5 < most["value"]["value"] / mean["value"]["value"] < 4.5
    assert len(np.genfromtxt(tmp_path / "b" / "spectrum.csv", delimiter=",", names=True)) == 400
    sample = np.genfromtxt(tmp_path / "b" / "history.csv", delimiter=",", skip_header=1)
    assert sample.shape == (3000, 4)
    assert sample[1500:, 1].std() == pytest.approx(mean["value"]["value"], rel=0.35)
    done = invoke(
        "predict", results, "--sensors", "2X", "--noise", f"{tmp_path}/wind.csv@3X", "--half-sine", "5,0.05@3X", "--duration", 2,
        "--sampling-rate", 200, "--draws", 60, "--modes", 2, "--lines", 10, "--motion", "displacement", "--out", tmp_path / "c",
    )  # fmt: skip
    assert (done.exit_code, done.stderr, "one sample" in done.stdout) == (0, "", False)
    pulse, both = (np.genfromtxt(tmp_path / name / "history.csv", delimiter=",", skip_header=1)[:, :2] for name in "ac")
    np.testing.assert_allclose(both, pulse)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--half-sine", "5,0.05@3X"], "--duration must be given with --half-sine"),
        (["--half-sine", "5@3X", "--duration", 1, "--sampling-rate", 100], "--half-sine must be size, width and a place"),
        (["--sine", "5,40@3X", "--duration", 1, "--sampling-rate", 100], "--sampling-rate must be at least 320 Hz"),
        (["--noise", "3X", "--duration", 1], "--noise must be a table and a place"),
        (["--noise", "none.csv@3X", "--duration", 1], "none.csv"),
        (["--sine", "5,1@3X", "--history", "a.csv", "--duration", 1], "give one of --history, --half-sine and --sine"),
        (["--sensors", "M[mass 1:1@1]"], "no set of bars or beams"),
        (["--half-sine", "5,0.1@3X", "--duration", 1, "--sampling-rate", 100, "--relative"], "no input is a base"),
    ],
)  # fmt: skip
def test_predict_names_loads_that_cannot_be(results, tmp_path, arguments, words):
    sensors = [] if "--sensors" in arguments else ["--sensors", "2X"]
    done = invoke("predict", results, *sensors, *arguments, "--draws", 50, "--out", tmp_path / "p")
    assert (done.exit_code, words in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "p").exists()


def test_predict_tunes_a_damper(results, tmp_path):
    done = invoke("predict", results, "--tune-damper", "0.2@3X", "--draws", 60, "--modes", 2, "--out", tmp_path / "p")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "tuned mass damper of 0.2 kg" in done.stdout
    told = json.loads((tmp_path / "p" / "prediction.json").read_text())["tuned_damper"]
    assert told["largest_receptance"] < told["largest_receptance_before"]
    done = invoke("predict", results, "--tune-damper", "3X", "--out", tmp_path / "q")
    assert (done.exit_code, "--tune-damper must be a mass in kg and a place" in done.stderr) == (2, True)

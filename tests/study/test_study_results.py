"""The results folder: complete, strict, the same bytes for the same input, and whole or not at all."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from structid.core.errors import FileError
from structid.core.json_types import json_text
from structid.files import digest
from structid.study.results.folder import require_results_folder, staged_folder, write_results
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from study_cases import CHAIN, TRUE, chain_record, write_chain


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_study(load_study(write_chain(tmp_path_factory.mktemp("study"))))


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    target = tmp_path_factory.mktemp("results") / "out"
    written(result, target)
    return target


def written(result, target: Path) -> None:
    with staged_folder(target, "estimate.json", "report.html") as staged:
        write_results(result, staged)


def strict(text: str):
    """JSON without NaN and Infinity."""

    def refuse(word):
        raise ValueError(word)

    return json.loads(text, parse_constant=refuse)


def test_the_summary_has_every_field_with_its_value(result, folder):
    summary = strict((folder / "estimate.json").read_text())
    found = result.identification.estimate
    assert (summary["status"], summary["rank"], summary["n_parameters"]) == ("converged", 8, 8)
    assert summary["chi_square_per_dof"] == found.goodness.chi_square / found.goodness.degrees_of_freedom
    assert summary["degrees_of_freedom"] == 2 * 230 * 2 - 8
    assert summary["covariance_basis"] == "noise"
    assert summary["total_mass"]["unit"] == "kg"
    assert summary["total_mass"]["value"] == pytest.approx(6.0, rel=0.01)
    kinds = {entry["name"]: entry["kind"] for entry in summary["parameters"]}
    assert kinds["mass[mass 1]"] == "mass"
    assert kinds["stiffness[upper:1]"] == "stiffness"
    assert kinds["loss_factor[springs]"] == "loss_factor"
    assert kinds["viscous_damping[damper]"] == "viscous_damping"
    for i, entry in enumerate(summary["parameters"]):
        assert entry["value"] == found.values[i]
        assert entry["std"] == found.std[i] == pytest.approx(np.hypot(entry["std_noise"], entry["std_tolerances"]))
        assert entry["std_noise"] == found.std_noise[i]
        assert entry["std_model_error"] == found.spread.std_model_error[i] >= entry["std_noise"] * (1 - 1e-9)
        assert entry["identified"] is True
        assert entry["prior_mean"] is entry["prior_std"] is None
    assert summary["assumption"] == "± includes 1 % of the calibration"
    assert [(one["name"], one["tolerance"]) for one in summary["tolerances"]] == [("calibration[record 1]", 0.01)]
    assert any(entry["std_model_error"] > 1.001 * entry["std_noise"] for entry in summary["parameters"])
    by_name = {entry["name"]: entry for entry in summary["parameters"]}
    assert by_name["stiffness[ground]"]["initial"] == 1200.0
    assert by_name["loss_factor[springs]"]["elements"] == ["ground", "upper"]
    assert by_name["loss_factor[springs]"]["property"] == "loss_factor"
    assert by_name["viscous_damping[damper]"]["unit"] == "N s/m"
    assert summary["unidentifiable_directions"] == []
    assert np.diag(summary["correlation"]) == pytest.approx(np.ones(8))
    assert len(summary["fit"]["channels"]) == 2
    error = result.identification.relative_error
    assert summary["fit"]["median_relative_error"] == np.median(error)
    assert summary["fit"]["channels"][1]["median_relative_error"] == np.median(error[:, 1, 0])
    assert summary["modes"][0]["frequency_hz"] == pytest.approx(1.645, abs=2e-3)
    assert {
        "status_text", "message", "condition", "chi_square_probability", "residual_correlation_lines", "n_iterations",
        "n_starts", "n_agreeing_starts", "resonances",
        "warnings",
    } <= set(summary)  # fmt: skip


def test_provenance_gives_digests_versions_and_settings_and_no_path(result, folder):
    text = (folder / "estimate.json").read_text()
    provenance = strict(text)["provenance"]
    source = result.study.path.parent
    assert provenance["inputs"] == {name: digest(source / name) for name in ("chain.toml", "frf.npz")}
    assert provenance["numpy"] == np.__version__
    assert provenance["seed"] == result.study.options.seed
    assert provenance["settings"]["band"] == [0.5, 12.0]
    assert provenance["settings"]["search"]["type"] == "LevenbergMarquardt"
    assert str(source) not in text
    assert str(Path.home()) not in text


def test_the_arrays_agree_with_the_identification(result, folder):
    found, record = result.identification, result.identification.problem.record
    with h5py.File(folder / "estimate.h5") as file:
        names = [name.decode() for name in file["parameters/names"]]
        assert set(names) == set(TRUE)
        np.testing.assert_array_equal(file["parameters/values"], found.estimate.values)
        np.testing.assert_array_equal(file["parameters/covariance_noise"], found.estimate.spread.covariance_noise)
        np.testing.assert_array_equal(
            file["parameters/covariance_model_error"], found.estimate.spread.covariance_model_error
        )
        np.testing.assert_array_equal(file["parameters/history"], found.estimate.search.history)
        np.testing.assert_array_equal(file["frf/measured"], record.values)
        np.testing.assert_array_equal(file["frf/residual"], found.fits[0].predicted - record.values)
        np.testing.assert_array_equal(file["frf/predicted_initial"], found.fits[0].predicted_initial)
        np.testing.assert_array_equal(file["modes/mode_shapes"], found.modes.mode_shapes)
        assert [dof.decode() for dof in file["modes/dofs"]] == ["1X+", "2X+", "3X+"]
        assert file["frf/frequency"].attrs["unit"] == "Hz"
        assert file["frf/measured"].attrs["unit"] == "(m/s^2)/N"


def test_the_study_is_copied_word_for_word(tmp_path):
    path = write_chain(tmp_path)
    path.write_bytes(("# äöü\r\n" + CHAIN.replace("\n", "\r\n")).encode())
    written(run_study(load_study(path)), tmp_path / "out")
    assert (tmp_path / "out" / "study.toml").read_bytes() == path.read_bytes()


def test_the_same_input_gives_the_same_bytes_in_another_folder(folder, tmp_path):
    path = write_chain(tmp_path / "elsewhere")
    written(run_study(load_study(path)), tmp_path / "out")
    for name in ("estimate.json", "estimate.h5", "study.toml"):
        assert (tmp_path / "out" / name).read_bytes() == (folder / name).read_bytes(), name


def test_other_noise_gives_other_numbers(folder, tmp_path):
    path = write_chain(tmp_path, record=chain_record(seed=1))
    written(run_study(load_study(path)), tmp_path / "out")
    assert (tmp_path / "out" / "estimate.json").read_bytes() != (folder / "estimate.json").read_bytes()


def test_what_is_not_finite_becomes_null():
    text = json_text({"a": np.nan, "b": [np.float64(np.inf), np.int64(3)], "c": np.array([1.0, -np.inf]), "d": None})
    assert strict(text) == {"a": None, "b": [None, 3], "c": [1.0, None], "d": None}


def full_disk(*_args, **_kwargs):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("method", ["write_bytes", "write_text", "rename", "mkdir"])
def test_a_full_disk_leaves_nothing(result, tmp_path, monkeypatch, method):
    with monkeypatch.context() as patch:
        patch.setattr(Path, method, full_disk)
        with pytest.raises(FileError, match=r"out: .*No space left.*free disk space"):
            written(result, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_earlier_results_as_they_were(result, folder, tmp_path, monkeypatch):
    earlier = tmp_path / "out"
    earlier.mkdir()
    (earlier / "estimate.json").write_text("earlier")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full_disk)
        with pytest.raises(FileError, match="No space left"):
            written(result, earlier)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert {path.name: path.read_text() for path in earlier.iterdir()} == {"estimate.json": "earlier"}


def test_a_later_run_replaces_its_own_files_and_keeps_others(result, folder, tmp_path):
    target = tmp_path / "out"
    (target / "figures").mkdir(parents=True)
    for name in ("estimate.json", "notes.txt", "report.html", "figures/mine.png"):
        (target / name).write_text("earlier")
    with staged_folder(target, "estimate.json", "report.html") as staged:
        write_results(result, staged)
        (staged / "figures").mkdir()
        (staged / "figures" / "new.png").write_text("new")
    assert (target / "estimate.json").read_bytes() == (folder / "estimate.json").read_bytes()
    assert (target / "notes.txt").read_text() == "earlier"
    assert (target / "figures" / "new.png").read_text() == "new"
    assert (target / "figures" / "mine.png").read_text() == "earlier"
    assert not (target / "report.html").exists(), "a report of an earlier run would contradict the estimate"


def test_a_page_that_is_of_no_earlier_results_stays(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("mine")
    with staged_folder(tmp_path / "out", "estimate.json", "report.html") as staged:
        (staged / "estimate.json").write_text("{}")
    assert (tmp_path / "out" / "report.html").read_text() == "mine"


def test_an_interruption_while_files_are_moved_leaves_a_folder_known_as_results(result, tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    moved = []

    def interrupted_later(path, target):
        if moved:
            raise KeyboardInterrupt
        moved.append(path.rename(target))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", interrupted_later)
        with pytest.raises(KeyboardInterrupt):
            written(result, tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["estimate.json"]
    require_results_folder(tmp_path / "out", "estimate.json", "estimate.h5", "study.toml")
    written(result, tmp_path / "out")


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "out").write_text("mine")
    with (
        pytest.raises(FileError, match=r"out: is a file; give another folder"),
        staged_folder(tmp_path / "out", "estimate.json"),
    ):
        pass
    assert (tmp_path / "out").read_text() == "mine"


def interrupted(target: Path) -> None:
    with staged_folder(target, "estimate.json", "report.html") as staged:
        (staged / "half").write_text("half")
        raise KeyboardInterrupt


def test_an_interruption_while_writing_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_the_fit_is_judged_on_the_evaluation_band(tmp_path):
    text = CHAIN.replace("band = [0.5, 12.0]", "band = [2.0, 8.0]\nevaluation_band = [1.0, 11.0]\nrestarts = 0")
    result = run_study(load_study(write_chain(tmp_path, text)))
    written(result, tmp_path / "out")
    summary = strict((tmp_path / "out" / "estimate.json").read_text())
    record = chain_record()
    judged = (record.frequency >= 1.0) & (record.frequency <= 11.0)
    assert summary["fit"]["n_lines"] == judged.sum()
    assert summary["fit"]["n_lines_fitted"] == ((record.frequency >= 2.0) & (record.frequency <= 8.0)).sum()
    assert summary["fit"]["band_fitted_hz"][0] == pytest.approx(2.0)
    assert summary["provenance"]["seed"] is None
    with h5py.File(tmp_path / "out" / "estimate.h5") as file:
        np.testing.assert_array_equal(file["evaluation/frequency"], record.frequency[judged])
        np.testing.assert_array_equal(file["evaluation/measured"], record.values[judged])
        np.testing.assert_array_equal(file["evaluation/relative_error"], result.identification.relative_error)

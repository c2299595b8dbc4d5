"""A study with a parameter for every element: searched for without a Jacobian, from the command line to the page."""

from __future__ import annotations

import argparse
import csv
import importlib.util
import json
import signal
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_checkpoint import RUN, command, signalled_when

import structid as sid
from structid.cli import app as cli
from structid.core.errors import InputError
from structid.identification import search
from structid.inversion.fixed_values import FixedValueInfluence
from structid.inversion.posterior_draws import solved_influence
from structid.inversion.search import least_squares
from structid.report.rendering import png
from structid.study.run import check
from structid.study.run.check import check_study
from structid.study.run.long_run import checkpoint_folder
from structid.study.run.run import is_matrix_free, run_study
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from study_cases import complaints

ROOT = Path(__file__).parents[2]


def case():
    spec = importlib.util.spec_from_file_location("plate_damage", ROOT / "benchmarks" / "plate_damage.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def made(folder, shape=(10, 5), lines=12, sensors=8):
    folder.mkdir(parents=True, exist_ok=True)
    given = argparse.Namespace(out=folder, shape=shape, lines=lines, sensors=sensors, noise=0.01, seed=0, rough=None)
    return case().made(given)


def changed(folder, *pairs):
    path = folder / "study.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plate")
    truth, middle = made(folder)
    with pytest.MonkeyPatch.context() as patch:  # a matrix of all parameters would not fit into memory
        patch.setattr(FixedValueInfluence, "covariance", property(lambda _: pytest.fail("a matrix is formed")))
        write = png.write_pngs  # the map alone: the other pictures are those of any study
        patch.setattr(png, "write_pngs", lambda figures, out: write({"map_1": figures["map_1"]}, out))
        done = RUN.invoke(cli.app, ["identify", str(folder / "study.toml"), "--out", str(folder / "results"), "--png"])
    return folder, truth, middle, done


def test_damage_is_found_from_the_command_line(plate):
    folder, truth, middle, done = plate
    assert done.exit_code == 0, done.output
    assert "chosen by marginal likelihood" in done.output
    with (folder / "results" / "parameters.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    ratio, std = (np.array([float(row[key]) / 70e9 for row in rows]) for key in ("value", "std"))
    assert len(rows) == 50
    lowest = int(ratio.argmin())
    assert np.linalg.norm(middle[lowest] - case().SPOT) < 0.08
    assert abs(ratio[lowest] - truth[lowest]) < 3 * std[lowest] < 0.2
    assert np.sqrt((((ratio - truth) / std) ** 2).mean()) < 1.2
    answer = json.loads((folder / "results" / "estimate.json").read_text(encoding="utf-8"))
    assert answer["status"] == "converged"
    assert answer["covariance_basis"] == "noise"
    assert answer["chi_square_per_dof"] == pytest.approx(1.0, abs=5 * np.sqrt(2 / 150))
    assert answer["largest_changes"][0]["name"] in {f"youngs_modulus[skin:{k + 1}]" for k in np.argsort(truth)[:8]}
    assert 5 < answer["n_determined"] < 50
    assert answer["regularization"][0]["rule"] == "marginal_likelihood"
    assert answer["provenance"]["settings"]["matrix_free"] is True


def test_page_figures_and_arrays_are_there(plate):
    folder, *_ = plate
    page = (folder / "results" / "report.html").read_text(encoding="utf-8").split("<script")[0]
    for words in ("youngs modulus of skin", "Parameters that moved most", 'id="figure-map_1"', "Combinations"):
        assert words in page
    assert (folder / "results" / "figures" / "map_1.png").stat().st_size > 20_000
    with h5py.File(folder / "results" / "estimate.h5") as file:
        draws, std = file["parameters/draws"][()], file["parameters/std"][()]
        assert draws.shape == (32, 50)
        # what draws owe to noise and to fixed values is uncorrelated to a part of 1 / sqrt(32), which `std` knows to be 0
        assert np.sqrt((draws**2).mean(axis=0)) == pytest.approx(std, rel=0.12)
        assert file["frf/predicted"].shape == (12, 8, 1)


def test_answer_is_that_of_the_dense_search_at_the_same_strength(plate, tmp_path):
    folder, *_ = plate
    for name in ("plate.msh", "frf.npz", "study.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    given = ('elements = "skin"\n\n[record]', 'elements = "skin"\nstrength = 150.0\n\n[record]')
    free = run_study(load_study(changed(tmp_path, given))).identification
    dense = run_study(
        load_study(changed(tmp_path, ('search = "matrix_free"', 'search = "levenberg_marquardt"')))
    ).identification
    assert np.abs(free.estimate.values - dense.estimate.values).max() < 0.01 * dense.estimate.std.min()
    off = free.estimate.std_noise / dense.estimate.std_noise - 1
    assert np.abs(off).max() < 4.5 / np.sqrt(64)
    assert free.estimate.fixed.changes == pytest.approx(dense.estimate.fixed.changes, rel=0.01, abs=1e6)
    assert free.assumption == dense.assumption
    assert np.abs(off.mean()) < 0.06
    assert free.priors.regularizations[0].rule == "given"
    assert np.isnan(free.priors.regularizations[0].determined)
    assert free.mass.total == pytest.approx(dense.mass.total)
    assert free.mass.std == pytest.approx(dense.mass.std)


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([('kind = "smoothness"', 'kind = "sparsity"')], "smoothness as the only regularization"),
        ([('elements = "skin"\n\n[record]', 'elements = "skin"\nstrength = "l_curve"\n\n[record]')], "l_curve"),
        ([("n_modes = 6", 'n_modes = 6\nintervals = "profile"')], "intervals 'laplace'"),
    ],
)  # fmt: skip
def test_what_it_cannot_do_is_named(plate, tmp_path, pairs, words):
    folder, *_ = plate
    for name in ("plate.msh", "frf.npz", "study.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    path = changed(tmp_path, *pairs)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "r")])
    assert done.exit_code == 2
    assert words in done.output
    assert "study.toml" in done.output
    assert not (tmp_path / "r").exists()


def test_it_comes_by_itself_where_a_dense_search_would_not_fit(plate, tmp_path, monkeypatch):
    folder, *_ = plate
    for name in ("plate.msh", "frf.npz", "study.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    ready = prepare_study(load_study(changed(tmp_path, ('search = "matrix_free"\n', ""))))
    assert not is_matrix_free(ready)
    small = lambda n_params, n_data: least_squares.dense_search_fits(n_params, n_data, 1e5)  # noqa: E731
    monkeypatch.setattr(search, "dense_search_fits", small)
    assert is_matrix_free(ready)
    dense = prepare_study(load_study(changed(tmp_path, ("n_modes = 6", 'n_modes = 6\nsearch = "levenberg_marquardt"'))))
    assert not is_matrix_free(dense)


def test_an_estimate_without_a_covariance_matrix_says_so(plate):
    folder, *_ = plate
    found = run_study(load_study(folder / "study.toml")).identification
    with pytest.raises(InputError, match="no covariance matrix of its 50 parameters"):
        _ = found.estimate.covariance
    assert found.priors.variance_fraction is None
    assert found.estimate.interval().shape == (50, 2)
    assert (found.intervals.ends[:, 0] < found.estimate.values).all()
    assert found.estimate.goodness.residual_tests.series[0].name == str(found.sensors[0])


@pytest.mark.long
def test_killed_search_resumes_to_the_same_digits(plate, tmp_path):
    folder, *_ = plate
    answers = []
    for name, killed in (("whole", False), ("killed", True)):
        (tmp_path / name / "study").mkdir(parents=True)
        for file in ("plate.msh", "frf.npz"):
            (tmp_path / name / "study" / file).write_bytes((folder / file).read_bytes())
        (tmp_path / name / "study" / "chain.toml").write_bytes((folder / "study.toml").read_bytes())
        kept = checkpoint_folder(tmp_path / name / "chain_results")
        if killed:
            first = command(tmp_path / name, "--checkpoint", "0")
            signalled_when(first, kept / "done-00002.npz", signal.SIGKILL)
            assert first.returncode == -signal.SIGKILL
        run = command(tmp_path / name, *(["--resume"] if killed else []))
        _, errors = run.communicate(timeout=600)
        assert (run.returncode, complaints(errors)) == (0, [])
        assert not kept.exists()
        answers.append((tmp_path / name / "chain_results" / "parameters.csv").read_text(encoding="utf-8"))
    assert answers[0] == answers[1]


def test_check_predicts_without_a_jacobian(plate):
    folder, *_ = plate
    done = RUN.invoke(cli.app, ["check", str(folder / "study.toml")])
    assert done.exit_code == 0, done.output
    assert "for one that `identify` will choose by the data" in done.output
    assert "50 parameters, of which the data determine about" in done.output
    assert "not at all" not in done.output
    assert "± includes 1 % of fixed" in done.output


def test_check_says_which_fixed_values_it_takes_as_exact(plate, monkeypatch):
    folder, *_ = plate
    lost = []

    def unsolved(problem, theta, at, fixed, precondition=None):
        lost.append(fixed.names[0])
        return solved_influence(problem, theta, at, fixed.only(range(1, len(fixed.names))), precondition)

    monkeypatch.setattr(check, "solved_influence", unsolved)
    monkeypatch.setattr(check, "checked_mesh", lambda *_: "not checked here")  # most of the time of a check
    found = check_study(load_study(folder / "study.toml"))
    assert found.fixed.names
    assert found.assumption == (
        f"± includes {found.fixed.words}; fixed {lost[0]} taken as exact, without the tolerance"
    )


@pytest.mark.long
def test_check_counts_smoothness_of_given_strength(plate, tmp_path):
    folder, *_ = plate
    for name in ("plate.msh", "frf.npz", "study.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    given = ('elements = "skin"\n\n[record]', 'elements = "skin"\nstrength = 150.0\n\n[record]')
    free = check_study(load_study(changed(tmp_path, given)))
    assert not free.covariance.has_matrix
    assert 5 < free.identifiability.rank < 50
    dense = check_study(
        load_study(changed(tmp_path, ('search = "matrix_free"', 'search = "levenberg_marquardt"\nrestarts = 0')))
    )
    assert dense.covariance.has_matrix
    off = free.of_data.std / dense.of_data.std - 1
    assert np.abs(off).max() < 4.5 / np.sqrt(32)
    assert np.abs(off.mean()) < 0.1
    assert free.assumption == dense.assumption
    assert free.fixed.changes[:, :-1] == pytest.approx(dense.fixed.changes[:, :-1], rel=0.01, abs=1e6)
    unheld = check_study(load_study(changed(tmp_path, ("strength = 150.0", 'strength = "discrepancy"'))))
    assert (unheld.std > 1.05 * dense.std).any()
    assert any("predicted without the smoothness" in words for words in unheld.warnings)


@pytest.mark.long
def test_two_records_give_the_answer_of_one_with_all_sensors(plate, tmp_path):
    folder, *_ = plate
    for name in ("plate.msh", "frf.npz", "study.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    given = ('elements = "skin"\n\n[record]', 'elements = "skin"\nstrength = 150.0\n\n[record]')
    whole = run_study(load_study(changed(tmp_path, given))).identification
    record = whole.measured
    for name, part in (("a", slice(0, 3)), ("b", slice(3, None))):
        own = replace(
            record, values=record.values[:, part], variance=record.variance[:, part], outputs=record.outputs[part]
        )
        sid.write_record(tmp_path / f"{name}.npz", own)
    path = changed(tmp_path, ('[record]\npath = "frf.npz"', '[[record]]\npath = "a.npz"\n\n[[record]]\npath = "b.npz"'))
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "r")])
    assert done.exit_code == 0, done.output
    with (tmp_path / "r" / "parameters.csv").open(encoding="utf-8") as stream:
        values = np.array([float(row["value"]) for row in csv.DictReader(stream)])
    np.testing.assert_allclose(values, whole.estimate.values, rtol=1e-3)
    assert "record 2" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8").split("<script")[0]


def test_compare_says_that_there_is_no_covariance(plate):
    folder, *_ = plate
    for state in (folder / "results", folder / "study.toml"):
        done = RUN.invoke(cli.app, ["compare", str(state), str(state), "--out", str(folder / "c")])
        assert done.exit_code == 2
        assert "matrix_free" in done.output
        assert "no covariance matrix" in done.output
        assert "cannot be used" not in done.output

"""Studies with a solver of a few lines: answers, runs that are kept, faults that are survived, and bad input."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain_solver import chain
from solver_cases import TRUE, chain_study, parameter
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.errors import InputError, StudyError
from structid.external import outputs
from structid.prediction.changes import AddMass
from structid.prediction.participation import ModalParticipation
from structid.prediction.predict import predict, predict_changes
from structid.prediction.quantities import Frf, History, NaturalModes
from structid.records import FrfRecord
from structid.records.formats import write_record
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from structid.workbench.work.functions import answer_json

RUN = CliRunner()


def identified(path: Path, *flags: str):
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(path.parent / "out"), "--no-report", *flags])
    assert done.exit_code == 0, done.stderr + done.stdout
    return answer(path.parent / "out"), done


def answer(folder: Path) -> dict:
    return json.loads((folder / "estimate.json").read_text())


def values(found: dict) -> dict[str, float]:
    return {one["property"]: one["value"] for one in found["parameters"]}


def finished(folder: Path) -> dict[str, float]:
    """Runs that are done, with the time at which each was."""
    return {one.parent.name: one.stat().st_mtime_ns for one in folder.glob("study.runs/*/run.json")}


def test_matrices_are_asked_for_once_and_give_the_exact_answer(tmp_path):
    found, _ = identified(chain_study(tmp_path, "matrices", "--log {study}/log"))
    assert values(found) == pytest.approx(TRUE, rel=1e-6)
    assert (tmp_path / "log").read_text().count(
        "\n"
    ) == 7  # nominal, two a parameter, one of both, and the updated deck
    updated = (tmp_path / "out" / "updated" / "chain.txt").read_text()
    np.testing.assert_allclose([float(line.split("=")[1]) for line in updated.splitlines()], [1200, 800], rtol=1e-6)
    assert found["solver"]["runs_made"] == 6
    assert found["solver"]["largest_difference"] < 1e-12
    assert "linear in k1, linear in k2" in found["solver"]["facts"][0]
    assert found["parameters"][0]["unit"] == "N/m"
    assert found["parameters"][0]["initial"] == 1000.0
    identified(tmp_path / "study.toml")
    assert (tmp_path / "log").read_text().count("\n") == 7
    done = RUN.invoke(cli.app, ["predict", str(tmp_path / "out")])
    assert (done.exit_code, "its model comes from a solver" in done.stderr) == (2, True)


def test_entries_that_cancel_in_some_runs_only_are_rounding(tmp_path):
    found, _ = identified(chain_study(tmp_path, "matrices", "--cancelling"))
    assert values(found) == pytest.approx(TRUE, rel=1e-6)
    assert found["solver"]["largest_difference"] < 1e-12


def test_a_sensor_at_a_node_that_the_solver_does_not_write_is_told_with_what_its_nodes_are(tmp_path):
    path = chain_study(tmp_path, "matrices")
    record = tmp_path / "measured.csv"
    record.write_text(record.read_text().replace("6X+", "60X+"))
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 2
    words = " ".join(done.stderr.split())
    assert (
        "60X+ is at node 60, which the structure does not have (nearest: 6); nodes are those that the solver" in words
    )


def test_differences_of_modes_give_the_answer_of_the_matrices(tmp_path):
    path = chain_study(tmp_path, "modes", "--log {study}/log")
    found, _ = identified(path)
    assert values(found) == pytest.approx(TRUE, rel=1e-6)
    assert found["parameters"][0]["initial"] == 1000.0
    assert found["solver"]["largest_difference"] < 1e-6
    assert len(found["modes"]) == 4  # those of the solver, and none of what holds their changes
    other = tmp_path / "matrices"
    other.mkdir()
    exact, _ = identified(chain_study(other, "matrices"))
    for own, true in zip(found["parameters"], exact["parameters"], strict=True):
        assert own["std"] == pytest.approx(true["std"], rel=1e-3)  # slopes are right to 1e-3
    again, _ = identified(path)
    assert values(again) == values(found)
    lines = (tmp_path / "log").read_text().splitlines()
    assert len(lines) == len(set(lines)) == len(finished(tmp_path))  # nothing ran twice


def test_thickness_is_found_cubic_and_as_a_product(tmp_path):
    parameters = parameter("k1", 1000.0) + parameter("t", 0.9)
    path = chain_study(tmp_path, "matrices", parameters=parameters)
    (tmp_path / "chain.txt").write_text("k1 = {{k1}}\nk2 = 800.\nt = {{t}}\n")
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stdout.split())
    assert "linear in k1, cubic in t, with products of k1 and t" in words, done.stderr + words
    found, _ = identified(path)
    assert values(found) == pytest.approx({"k1": 1200.0, "t": 1.0}, rel=1e-5)


def test_workers_evaluate_differences(tmp_path):
    path = chain_study(tmp_path)
    found, _ = identified(path, "--workers", "2")
    assert values(found) == pytest.approx(TRUE, rel=1e-6)


def test_a_run_of_another_process_that_ends_while_old_ones_are_swept_is_no_error(tmp_path, monkeypatch):
    path = chain_study(tmp_path)
    running = tmp_path / "study.runs" / ".0123456789ab.01234567"
    running.mkdir(parents=True)
    is_dir = Path.is_dir

    def ends_behind(folder: Path) -> bool:
        was_there = is_dir(folder)
        if folder == running and was_there:
            folder.rename(folder.with_name("done"))
        return was_there

    monkeypatch.setattr(Path, "is_dir", ends_behind)
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "study.runs" / "done").exists()


@pytest.mark.long
def test_faults_and_kills_change_nothing_and_no_finished_run_is_repeated(tmp_path):
    plain = tmp_path / "plain"
    plain.mkdir()
    parameters = parameter("k1", 1000.0) + parameter("k2", 1000.0) + parameter("s", 1.0) + parameter("t", 0.9)
    deck = "k1 = {{k1}}\nk2 = {{k2}}\ns = {{s}}\nt = {{t}}\n"
    prior = {"s": 1.0, "t": 1.0}

    def study(folder: Path, options: str) -> Path:
        path = chain_study(folder, "modes", options, "retries = 12", parameters)
        (folder / "chain.txt").write_text(deck)
        text = path.read_text()
        for name, mean in prior.items():
            text = text.replace(
                f'property = "{name}"\n', f'property = "{name}"\nprior = {{ mean = {mean}, std = 0.001 }}\n'
            )
        path.write_text(text)
        return path

    expected, _ = identified(study(plain, "--log {study}/log"))
    assert (plain / "log").read_text().count("\n") >= 20
    broken = tmp_path / "broken"
    broken.mkdir()
    path = study(broken, "--log {study}/log --fail 0.2 --sleep 0.1")
    command = [sys.executable, "-m", "structid", "identify", str(path), "--out", str(broken / "out"), "--no-report"]
    done_before: dict[str, float] = {}
    for enough in (5, 12):
        process = subprocess.Popen([*command, "--workers", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while len(finished(broken)) < enough and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert len(finished(broken)) >= enough
        time.sleep(0.5)  # orphans of the killed run end
        done_before = finished(broken)
        n_lines = len((broken / "log").read_text().splitlines())
    last = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    if last.returncode == 2:  # killed before the first checkpoint
        last = subprocess.run(command, capture_output=True, text=True, check=False)
    assert last.returncode == 0, last.stderr
    assert values(answer(broken / "out")) == values(expected)
    after = finished(broken)
    assert {key: after[key] for key in done_before} == done_before
    kept = {(broken / "study.runs" / key / "chain.txt").read_text().replace("\n", ";") for key in done_before}
    assert not kept & set((broken / "log").read_text().splitlines()[n_lines:])
    assert len(after) == len(finished(plain))
    names = {one.name for one in (broken / "study.runs" / next(iter(after))).iterdir()}
    assert names == {"chain.txt", "chain.csv", "run.json", "solver.log"}  # no scratch


def test_a_step_that_fails_is_made_smaller(tmp_path):
    found, _ = identified(chain_study(tmp_path, "modes", "--fail-above 1206", "retries = 0"))
    assert values(found) == pytest.approx(TRUE, rel=1e-5)


@pytest.mark.parametrize(
    "options, more, message",
    [
        (
            "--fail 1",
            "",
            r"the solver failed 3 times at k1 = 1000, k2 = 1000: it ended with code 3; its last words: license",
        ),
        ("--hang", "timeout = 0.5\nretries = 0", r"still running after 0.5 s \(`timeout`\)"),
        ("--half", "retries = 0", r"chain.csv"),
    ],
)
def test_a_solver_that_fails_is_told_with_what_it_said(tmp_path, options, more, message):
    path = chain_study(tmp_path, "modes", options, more)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    words = " ".join(done.stderr.split())
    assert re.search(message, words), words
    assert "[structure.solver]" in words
    assert "Traceback" not in words
    assert (tmp_path / "study.runs" / "failed" / "chain.txt").is_file()


def test_only_folders_that_runs_left_are_removed_from_where_runs_are_kept(tmp_path):
    path = chain_study(tmp_path, "modes", "--fail 1", 'retries = 0\nruns = "."')
    foreign = [".venv.old", ".0123456789ab.0123456x", ".0123456789ab.01234567.zip"]
    trial = ".0123456789ab.01234567"
    for name in (*foreign, trial):
        (tmp_path / name).mkdir()
        (tmp_path / name / "work.txt").write_text("work")
        os.utime(tmp_path / name, (0, 0))
    for _ in range(2):  # the second replaces the first
        assert RUN.invoke(cli.app, ["check", str(path)]).exit_code == 2
        assert (tmp_path / "failed" / "chain.txt").is_file()
    assert not (tmp_path / trial).exists()
    assert all((tmp_path / name / "work.txt").is_file() for name in foreign)
    assert sorted(one.name for one in tmp_path.glob(".*")) == sorted(foreign)


@pytest.mark.parametrize("mark", [None, "{}", '{"layout": "another 1"}'])
def test_a_folder_where_failed_runs_go_is_left_if_it_is_not_of_one(tmp_path, mark):
    path = chain_study(tmp_path, "modes", "--fail 1", 'retries = 0\nruns = "."')
    (tmp_path / "failed").mkdir()
    (tmp_path / "failed" / "work.txt").write_text("work")
    if mark is not None:
        (tmp_path / "failed" / "failed_run.json").write_text(mark)
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 2
    assert "failed: is none that a failed run of the solver left" in " ".join(done.stderr.split())
    assert (tmp_path / "failed" / "work.txt").read_text() == "work"


def test_half_a_matrix_is_refused_and_finished_runs_are_kept(tmp_path):
    path = chain_study(tmp_path, "matrices", "--half", "retries = 0")
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code == 2
    assert "chain_k.mtx" in done.stderr
    path = chain_study(tmp_path, "matrices", "--fail-above 1100", "retries = 0")
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert "3 finished runs are kept" in words, words
    assert len(finished(tmp_path)) == 3


@pytest.mark.parametrize("gives, message", [
    ("matrices", "rows, that of the first run 6, or others; keep mesh"),
    ("modes", "have 7 degrees of freedom, those of the nominal run 6"),
])  # fmt: skip
def test_a_mesh_that_changes_between_runs_is_refused(tmp_path, gives, message):
    path = chain_study(tmp_path, gives, "--grow", "retries = 0")
    if gives == "matrices":
        path.write_text(path.read_text().replace('dofs = ["1X", "2X", "3X", "4X", "5X", "6X"]', 'dofs = "dofs.txt"'))
        script = tmp_path / "chain_solver.py"
        script.write_text(
            script.read_text().replace(
                '    Path("scratch.tmp")',
                '    Path("dofs.txt").write_text(" ".join(f"{i + 1}X" for i in range(n)))\n    Path("scratch.tmp")',
            )
        )
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert message in words, words


@pytest.mark.parametrize("gives", ["matrices", "modes"])
def test_a_parameter_without_effect_is_refused(tmp_path, gives):
    path = chain_study(tmp_path, gives)
    (tmp_path / "chain.txt").write_text("k1 = {{k1}}\nk2 = 800.\nunused = {{k2}}\n")
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert "parameter 'k2' has no effect" in words, words


def without(text: str, line: str) -> str:
    assert line in text
    return text.replace(line, "")


@pytest.mark.parametrize(
    "edit, message",
    [
        (lambda t: t.replace(sys.executable, "no-such-solver"), "the solver 'no-such-solver' is not there"),
        (lambda t: t.replace("chain.txt", "other.txt"), "other.txt"),
        (lambda t: t.replace('name = "k2"', 'name = "k3"'), r"chain.txt, line 2: {{ k2 }} has no parameter"),
        (lambda t: without(t, 'modes = "{stem}.csv"'), "`modes` is missing"),
        (lambda t: t.replace('modes = "{stem}.csv"', 'modes = "{deck}.csv"'), "may hold {stem} only"),
        (lambda t: t.replace('modes = "{stem}.csv"', 'modes = "../{stem}.csv"'), "must be the name of a file"),
        (
            lambda t: t.replace('modes = "{stem}.csv"', 'modes = "{stem}.dat2"'),
            "it wrote no chain.dat2, only chain.csv",
        ),
        (lambda t: t.replace('modes = "{stem}.csv"', 'modes = "{stem}.csv"\nmass = "x.mtx"'), "belongs to `gives"),
        (lambda t: t.replace("{deck}", "{dekc}"), "may hold {deck}, {stem} and {study}"),
        (
            lambda t: t.replace("timeout = 60", "timeout = 0"),
            "timeout: must be a number greater than 0, got 0; leave it out for one hour",
        ),
        (lambda t: t.replace('property = "k1"', 'property = "k9"'), "has no property 'k9'; it has k1, k2"),
        (lambda t: t.replace('gives = "modes"', 'gives = "matrices"'), "belongs to `gives"),
        (lambda t: t.replace('unit = "N/m"\n', 'unit = "N/m"\nbounds = [1.0, 2.0]\n'), "must lie within `bounds`"),
    ],
)
def test_bad_input_is_told_with_file_place_and_remedy(tmp_path, edit, message):
    path = chain_study(tmp_path, more="retries = 0\ntimeout = 60")
    path.write_text(edit(path.read_text()))
    done = RUN.invoke(cli.app, ["check", str(path)])
    words = " ".join(done.stderr.split())
    assert done.exit_code == 2, words
    assert message in words, words
    assert "study.toml" in words, words


def test_a_solver_is_not_needed_where_its_runs_are_kept(tmp_path):
    path = chain_study(tmp_path)
    assert RUN.invoke(cli.app, ["check", str(path)]).exit_code in (0, 1)
    (tmp_path / "chain_solver.py").unlink()
    done = RUN.invoke(cli.app, ["check", str(path)])
    assert done.exit_code in (0, 1)
    assert "5 of them kept" in " ".join(done.stdout.split())


def test_bounds_hold_for_every_run(tmp_path):
    own = parameter("k1", 1000.0, "bounds = [999.0, 1199.0]") + parameter("k2", 1000.0)
    path = chain_study(tmp_path, "modes", "--log {study}/log", parameters=own)
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report"])
    asked = [float(re.search(r"k1 = ([^;]*);", line)[1]) for line in (tmp_path / "log").read_text().splitlines()]
    assert done.exit_code in (0, 1, 3), done.stderr
    assert min(asked) >= 999.0
    assert max(asked[:-1]) <= 1199.0


@pytest.mark.parametrize("gives", ["matrices", "modes"])
def test_responses_are_fitted_too(tmp_path, gives):
    path = chain_study(tmp_path, gives)
    mass, stiffness = (np.array(table) for table in chain(TRUE, 6))
    frequency = np.linspace(0.3, 4.0, 150)
    omega = 2 * np.pi * frequency
    dynamic = stiffness * (1 + 0.04j) - omega[:, None, None] ** 2 * mass
    frf = np.linalg.inv(dynamic)[:, [0, 2, 5]][:, :, [2]]
    clean = np.random.default_rng(4).standard_normal((2, *frf.shape))
    frf = frf + 1e-4 * np.abs(frf).max() * (clean[0] + 1j * clean[1])
    variance = np.full(frf.shape, 2e-8 * np.abs(frf).max() ** 2)
    record = FrfRecord(frequency, frf, ("1X", "3X", "6X"), ("3X",), "receptance", variance=variance)
    write_record(tmp_path / "frf.npz", record)
    text = path.read_text()
    damping = '[[unknown]]\nproperty = "loss_factor"\nelements = "model"\nstart = 0.02\n'
    path.write_text(text[: text.index("[record]")] + damping + '[record]\npath = "frf.npz"\n')
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report", "--no-explain"])
    assert done.exit_code == 0, done.output
    worst = 1e-4 if gives == "matrices" else 1e-3  # of six modes the solver gives four
    assert values(answer(tmp_path / "out")) == pytest.approx(TRUE | {"loss_factor": 0.04}, rel=worst)


def test_modes_without_modal_masses_are_fitted_to_modes_alone(tmp_path):
    path = chain_study(tmp_path, "modes", "--largest")
    done = RUN.invoke(cli.app, ["identify", str(path), "--out", str(tmp_path / "out"), "--no-report", "--no-explain"])
    assert done.exit_code == 0, done.output
    assert values(answer(tmp_path / "out")) == pytest.approx(TRUE, rel=1e-3)
    frequency = np.linspace(0.3, 4.0, 20)
    record = FrfRecord(frequency, np.ones((20, 1, 1), complex), ("1X",), ("3X",), "receptance")
    write_record(tmp_path / "frf.npz", record)
    text = path.read_text()
    path.write_text(text[: text.index("[record]")] + '[record]\npath = "frf.npz"\nnoise.relative = 0.01\n')
    words = "made of modes without modal masses, so that their scale is free and FRFs cannot be computed; let the solver print"
    with pytest.raises(StudyError, match=words):
        run_study(load_study(path))
    spring = '[[structure.spring]]\nname = "foot"\nfirst = "1X"\nstiffness = 10.0\n\n[[unknown]]'
    path.write_text(text.replace("[[unknown]]", spring, 1))
    with pytest.raises(StudyError, match="foot beside them cannot be computed"):
        load_study(path)


def test_sizes_are_not_predicted_from_modes_without_modal_masses(tmp_path):
    found = run_study(load_study(chain_study(tmp_path, "modes", "--largest"))).identification
    histories = History(["3X"], ["1X"], np.ones((20, 1)), 10.0)
    for quantity in (Frf(["3X"], ["1X"], [0.5, 1.0, 3.0], kind="receptance"), histories, ModalParticipation("X", 2)):
        with pytest.raises(InputError, match="modes without modal masses, so that their scale is free"):
            predict(found, quantity)
    with pytest.raises(InputError, match="without modal masses"):
        predict_changes(found, [NaturalModes(2)], [AddMass(1, 0.1)])
    assert predict(found, NaturalModes(2)).values.shape == (2, 2)


def test_what_a_file_of_modes_leaves_open_is_a_fact(tmp_path, monkeypatch):
    read = outputs.read_shapes
    monkeypatch.setattr(outputs, "read_shapes", lambda *given: replace(read(*given), notes=("axes taken as basic",)))
    assert "axes taken as basic" in load_study(chain_study(tmp_path)).solved.facts


def test_looking_at_a_study_in_the_workbench_runs_no_program_but_reads_what_is_kept(tmp_path):
    path = chain_study(tmp_path, "matrices", "--log {study}/log")

    def looked(name: str) -> dict:
        return json.loads(answer_json(name, str(tmp_path), {"study": path.name}))

    for name in ("check", "scene", "line"):
        assert re.search(r"names a program that has yet to run .* looking at a study runs none", looked(name)["error"])
    assert not (tmp_path / "log").exists()
    identified(path)
    ran = (tmp_path / "log").read_text()
    assert looked("check")["determined"]
    assert (tmp_path / "log").read_text() == ran

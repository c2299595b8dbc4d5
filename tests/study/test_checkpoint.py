"""Long runs: what a killed or interrupted run has done is not done again, and the digits are the same."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli import app as cli
from structid.core.errors import FileError
from structid.inversion import (
    DataRows,
    FreeUnknowns,
    GaussNewton,
    LevenbergMarquardt,
    Linearization,
    Problem,
    minimize,
)
from structid.records.formats import write_record
from structid.study.run.long_run import Checkpoint, LongRun, checkpoint_folder, fingerprint
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study, study_problems
from structid.study.schema.study import load_study
from study_cases import CHAIN, chain_record, complaints, write_chain

RUN = CliRunner()
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
OWNER = {"layout": "structid checkpoint 2", "versions": {}, "inputs": {}}
SEVERAL = CHAIN + "uniqueness_starts = 2\n"


def command(folder: Path, *arguments: str) -> subprocess.Popen:
    words = [sys.executable, "-m", "structid", "identify", "study/chain.toml", "--no-report", *arguments]
    return subprocess.Popen(
        words,
        cwd=folder,
        env=ENVIRONMENT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def signalled_when(process: subprocess.Popen, wanted: Path, number: signal.Signals) -> str:
    """What the process says after the signal, sent as soon as the file `wanted` is there."""
    while not wanted.exists() and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(number)
    return process.communicate(timeout=600)[1]


def numbers(folder: Path) -> dict:
    return json.loads((folder / "estimate.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("whole")
    write_chain(folder / "study", SEVERAL)
    done = RUN.invoke(
        cli.app, ["identify", str(folder / "study" / "chain.toml"), "--no-report", "--out", str(folder / "r")]
    )
    assert done.exit_code == 0
    assert sorted(path.name for path in folder.iterdir()) == ["r", "study"]
    return numbers(folder / "r")


def test_a_killed_run_resumes_to_the_same_digits(tmp_path, uninterrupted):
    """Killed after its first searches, and resumed."""
    write_chain(tmp_path / "study", SEVERAL)
    kept = checkpoint_folder(tmp_path / "chain_results")
    first = command(tmp_path, "--checkpoint", "0")
    signalled_when(first, kept / "done-00002.npz", signal.SIGKILL)
    assert first.returncode == -signal.SIGKILL
    assert not (tmp_path / "chain_results").exists()
    second = command(tmp_path, "--resume")
    _, errors = second.communicate(timeout=600)
    assert (second.returncode, complaints(errors)) == (0, [])
    assert numbers(tmp_path / "chain_results") == uninterrupted
    assert not kept.exists()


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.long), signal.SIGTERM])
def test_an_interrupted_run_tells_what_it_reached_and_how_to_go_on(tmp_path, number, uninterrupted):
    write_chain(tmp_path / "study", SEVERAL)
    process = command(tmp_path, "--checkpoint", "0")
    kept = checkpoint_folder(tmp_path / "chain_results")
    said = signalled_when(process, kept / "search.npz", number)
    assert (process.returncode, "Traceback" in said) == (130, False), said
    assert "interrupted in " in said
    assert "go on with: structid identify study/chain.toml --no-report --resume" in said
    reached = json.loads((kept / "so_far.json").read_text(encoding="utf-8"))
    assert reached["status"] == "interrupted"
    assert [entry["name"] for entry in reached["parameters"]] == [p["name"] for p in uninterrupted["parameters"]]
    assert all(entry["value"] > 0 for entry in reached["parameters"])


def test_an_interruption_among_tasks_says_how_many_are_done(tmp_path):
    run = LongRun(checkpoint=Checkpoint(tmp_path / "c", OWNER, seconds=0.0))

    def task(shared, item, tools):
        if item == 2:
            raise KeyboardInterrupt
        return item

    with pytest.raises(KeyboardInterrupt):
        run.map("bootstrap replicates", task, None, [0, 1, 2, 3])
    assert run.reached.words == "bootstrap replicates, 2 of 4 done"
    assert run.so_far()["tasks"] == run.reached.words
    assert run.so_far()["finished_searches_and_tasks"] == 2
    assert run.map("others", task, None, [5]) == [5]
    assert run.reached.tasks == ""


class Stopped(Exception):
    pass


class Stopping(Checkpoint):
    """A checkpoint that ends the run after so many things that it took, all of them written."""

    def __init__(self, *arguments, after: int, **options) -> None:
        super().__init__(*arguments, **options)
        self.after = after

    def _write_if_due(self) -> None:
        super()._write_if_due()
        self.after -= 1
        if self.after == 0:
            raise Stopped


SMOOTH = '[[regularization]]\nkind = "smoothness"\nproperty = "stiffness"\nelements = "upper"\nstrength = 4.0\n'


@pytest.mark.parametrize("options", ["restarts = 1", "pole_free_start = false\n" + SMOOTH])
def test_a_run_stopped_anywhere_resumes_to_the_same_bits(tmp_path, options):
    """Stopped every few iterations or tasks, over and over, at another place each time; misfit makes it restart."""
    record = chain_record()
    bent = record.values * (1 + 0.05 * np.sin(record.frequency))[:, None, None]
    if "regularization" in options:
        bent = record.values
    write_chain(tmp_path, CHAIN + options + "\n", chain_record(values=bent))
    study = load_study(tmp_path / "chain.toml")
    whole = run_study(study).identification
    owner, folder = fingerprint(study), tmp_path / "r.checkpoint"
    stops = 0
    for after in [2, 9, 30, 1000]:
        try:
            kept = Stopping(folder, owner, resume=stops > 0, seconds=0.0, after=after)
            found = run_study(study, None, LongRun(checkpoint=kept)).identification
            break
        except Stopped:
            stops += 1
    assert stops >= 2
    assert np.array_equal(found.estimate.search.history, whole.estimate.search.history)
    for name in ("theta", "covariance"):
        assert np.array_equal(getattr(found.estimate, name), getattr(whole.estimate, name)), name
    assert found.estimate.goodness.chi_square == whole.estimate.goodness.chi_square
    assert found.estimate.search.n_iterations == whole.estimate.search.n_iterations
    assert np.array_equal(found.intervals.ends, whole.intervals.ends, equal_nan=True)


WIDE = LevenbergMarquardt(initial_damping=1e-9, largest_step=5.0, acceleration=0.0, max_iterations=30)


@pytest.mark.parametrize(("method", "distance"), [(LevenbergMarquardt(), 0.1), (WIDE, 1.0), (GaussNewton(), 0.1)])
def test_every_iteration_is_a_place_to_go_on_from(tmp_path, method, distance):
    """The search begun anew from each of its own states ends at the same bits; the wide one has steps rejected in a row."""
    problem = prepare_study(load_study(write_chain(tmp_path))).problems[0]
    near = problem.theta_start + distance * np.log([2, 3, 1, 1.2, 0.9, 1.1, 0.8, 1.3])

    class Kept:
        def __init__(self, state=None):
            self.state, self.states = state, []

        def keep(self, iteration, cost, state):
            self.states.append(state())

    first = Kept()
    whole = minimize(problem, method, near, keeper=first)
    assert len(first.states) >= 4
    if method is WIDE:
        rejected = (np.diff(whole.costs) == 0).tolist()
        assert [True, True] in [rejected[k : k + 2] for k in range(len(rejected))]
    for state in first.states[:: 1 if len(first.states) < 12 else 2]:
        again = minimize(problem, method, near, keeper=Kept(state))
        assert np.array_equal(again.theta, whole.theta)
        assert np.array_equal(again.history, whole.history)
        assert np.array_equal(again.costs, whole.costs)
        assert (again.message, again.converged) == (whole.message, whole.converged)


class Cubes(Problem):
    """p^3 = 0.001 and q^3 + p = 0.1, from 10 and 8: the columns of the Jacobian and the sizes shrink a thousandfold."""

    unknowns = FreeUnknowns(("p", "q"), np.array([10.0, 8.0]))
    rows = DataRows(np.arange(2), np.zeros(2, dtype=int))

    def residual(self, theta):
        return np.array([theta[0] ** 3 - 0.001, theta[1] ** 3 + theta[0] - 0.1])

    def linearize(self, theta):
        return Linearization(self.residual(theta), np.array([[3 * theta[0] ** 2, 0.0], [1.0, 3 * theta[1] ** 2]]))


def test_the_memory_of_the_scales_goes_on_too():
    """Damping and limits of the steps carry the largest column and size so far."""
    states: list[dict] = []

    class Kept:
        state = None

        def keep(self, iteration, cost, state):
            states.append(state())

    whole = minimize(Cubes(), LevenbergMarquardt(), keeper=Kept())
    assert len(states) > 8
    for state in tuple(states):
        again = Kept()
        again.state = state
        assert np.array_equal(minimize(Cubes(), LevenbergMarquardt(), keeper=again).history, whole.history)


def test_a_checkpoint_of_other_files_is_refused_by_name(tmp_path):
    path = write_chain(tmp_path)
    folder = tmp_path / "r.checkpoint"
    Checkpoint(folder, fingerprint(load_study(path))).write()
    write_record(tmp_path / "frf.npz", chain_record(seed=1))
    with pytest.raises(FileError, match=r"frf\.npz has changed since .* run without --resume"):
        Checkpoint(folder, fingerprint(load_study(path)), resume=True)
    path.write_text(CHAIN + "seed = 3\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"chain\.toml has changed since"):
        Checkpoint(folder, fingerprint(load_study(path)), resume=True)


def test_a_checkpoint_of_another_version_is_refused_by_name(tmp_path):
    owner = fingerprint(load_study(write_chain(tmp_path)))
    other = {**owner, "versions": {**owner["versions"], "numpy": "1.0"}}
    Checkpoint(tmp_path / "c", other).write()
    with pytest.raises(FileError, match=r"written with numpy 1\.0, this is"):
        Checkpoint(tmp_path / "c", owner, resume=True)


@pytest.mark.parametrize(
    ("layout", "words"),
    [
        ("structid checkpoint 1", "c: was written by another version of structid; run without --resume to begin anew"),
        ("something else", "c: is no checkpoint of this program; put it back, or run without --resume"),
        (None, "c: is no checkpoint of this program; put it back, or run without --resume"),
    ],
)
def test_a_checkpoint_of_another_layout_is_refused_with_the_remedy(tmp_path, layout, words):
    owner = fingerprint(load_study(write_chain(tmp_path)))
    Checkpoint(tmp_path / "c", {**owner, "layout": layout}).write()
    with pytest.raises(FileError, match=words):
        Checkpoint(tmp_path / "c", owner, resume=True)


def test_a_damaged_or_missing_checkpoint_is_refused(tmp_path):
    with pytest.raises(FileError, match="no checkpoint to go on from; run without --resume"):
        Checkpoint(tmp_path / "c", OWNER, resume=True)
    kept = Checkpoint(tmp_path / "c", OWNER, seconds=0.0)
    kept.finished("a", {"x": np.arange(3.0)})
    part = tmp_path / "c" / "done-00001.npz"
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(FileError, match=r"done-00001\.npz: is not a whole checkpoint"):
        Checkpoint(tmp_path / "c", OWNER, resume=True)


def test_a_folder_that_is_no_checkpoint_is_left_alone(tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thesis.txt").write_text("mine")
    with pytest.raises(FileError, match=r"thesis\.txt, which is no checkpoint"):
        Checkpoint(tmp_path / "c", {})
    assert (tmp_path / "c" / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize("foreign", ["done-list.txt", "done-thesis", "search.npz.old"])
def test_names_that_begin_as_those_of_a_checkpoint_are_left_alone(tmp_path, foreign):
    (tmp_path / "c" / foreign).mkdir(parents=True)
    with pytest.raises(FileError, match=f"{foreign}, which is no checkpoint"):
        Checkpoint(tmp_path / "c", OWNER)
    assert (tmp_path / "c" / foreign).is_dir()


def test_files_of_others_outlive_the_checkpoint_they_lie_in(tmp_path):
    """Also hidden ones, and those that came while the run was under way; what a killed run left half written does not."""
    folder = tmp_path / "c"
    Checkpoint(folder, OWNER).write({"a": 1})
    (folder / ".git").mkdir()
    (folder / ".notes").write_text("mine")
    (folder / ".search.structid-0123456789ab.npz").write_text("half")
    resumed = Checkpoint(folder, OWNER, resume=True)
    assert sorted(path.name for path in folder.iterdir()) == [".git", ".notes", "run.json", "so_far.json"]
    resumed.close()
    anew = Checkpoint(folder, OWNER)
    assert sorted(path.name for path in folder.iterdir()) == [".git", ".notes"]
    anew.finished("a", [1.0])
    (folder / "thesis.txt").write_text("mine")
    anew.remove()
    assert sorted(path.name for path in folder.iterdir()) == [".git", ".notes", "thesis.txt"]


def test_what_is_kept_comes_back_bit_for_bit_however_many_files(tmp_path):
    random = np.random.default_rng(0)
    trees = {
        f"task {k}": {
            "a": random.standard_normal((2, k)),
            "b": [float(random.standard_normal()), "words", None, True, 3],
        }
        for k in range(150)
    }
    trees["odd"] = [np.nan, np.inf, np.array([np.nan, -0.0, 5e-324]), {"deep": (1, 2)}, "two\nlines"]
    kept = Checkpoint(tmp_path / "c", OWNER, seconds=0.0)
    for name, tree in trees.items():
        kept.finished(name, tree)
    assert len(list((tmp_path / "c").glob("done-*"))) <= 64
    again = Checkpoint(tmp_path / "c", OWNER, resume=True)
    assert list(again.entries) == list(trees)
    for name in trees:
        assert repr(again.entries[name]) == repr(trees[name]).replace("(1, 2)", "[1, 2]")
    odd = again.entries["odd"][2]
    assert odd.tobytes() == trees["odd"][2].tobytes()


def test_a_new_run_replaces_the_checkpoint_of_an_old_one(tmp_path):
    Checkpoint(tmp_path / "c", OWNER, seconds=0.0).finished("a", 1)
    assert Checkpoint(tmp_path / "c", OWNER).entries == {}
    assert not (tmp_path / "c").exists()


def test_what_was_reached_is_told_of_a_search_that_is_taken_from_a_checkpoint_and_json_has_no_nan(tmp_path):
    [problem] = study_problems(load_study(write_chain(tmp_path / "study", SEVERAL)))
    first = LongRun(checkpoint=Checkpoint(tmp_path / "c", OWNER, seconds=0.0))
    minimum = first.minimize(problem, LevenbergMarquardt(max_iterations=3))
    again = Checkpoint(tmp_path / "c", OWNER, resume=True, seconds=0.0)
    run = LongRun(checkpoint=again)
    again.write(run.so_far())
    text = (tmp_path / "c" / "so_far.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=pytest.fail)["sum_of_squares"] is None
    run.minimize(problem, LevenbergMarquardt(max_iterations=3))
    values = [entry["value"] for entry in run.so_far()["parameters"]]
    assert values == pytest.approx(problem.physical(minimum.theta).tolist())

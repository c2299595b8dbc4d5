"""Runs that are killed, run out of disk or meet another run: the same digits afterwards, and nothing half written."""

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
from structid.study.results.folder import staged_folder
from study_cases import CHAIN, complaints, write_chain

ROOT = Path(__file__).parent.parent.parent
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
RUN = CliRunner()


def run(*words: str, folder: Path = ROOT, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=ENVIRONMENT, text=True, capture_output=True, check=False, **options
    )


@pytest.mark.long
def test_ended_at_random_moments_and_run_again(tmp_path):
    """`python -m fuzz.killed` with 100 moments is the whole of it."""
    done = run("-m", "fuzz.killed", "--count", "4", "--seed", "11", timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 of 4" in done.stdout


def test_two_runs_in_one_place(tmp_path):
    """The second is refused with the number of the first, which goes on to its end."""
    write_chain(tmp_path, CHAIN + "uniqueness_starts = 4\n")
    words = ("-m", "structid", "identify", "chain.toml", "--no-report", "--checkpoint", "0")
    first = subprocess.Popen([sys.executable, *words], cwd=tmp_path, env=ENVIRONMENT, stdout=-1, stderr=-1, text=True)
    for _ in range(120_000):
        if (tmp_path / "chain_results.checkpoint" / "run.json").exists() or first.poll() is not None:
            break
        time.sleep(0.005)
    first.send_signal(signal.SIGSTOP)  # it cannot end while the second comes
    try:
        kept = {path.name for path in (tmp_path / "chain_results.checkpoint").glob("done-*")}
        for further in ((), ("--resume",)):
            second = run(*words, *further, folder=tmp_path)
            assert second.returncode == 2, second.stderr
            assert f"process {first.pid} on " in second.stderr
            assert "wait until it has ended" in second.stderr
        assert kept <= {path.name for path in (tmp_path / "chain_results.checkpoint").glob("done-*")}
    finally:
        first.send_signal(signal.SIGCONT)
    _, said = first.communicate(timeout=600)
    assert (first.returncode, complaints(said)) == (0, [])
    assert json.loads((tmp_path / "chain_results" / "estimate.json").read_text())["status"] == "converged"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chain.toml", "chain_results", "frf.npz"]


#: Commands while no file may grow beyond a size, as on a disk that is nearly full; what a run prints, and what is left.
FULL = """
import json, os, resource, signal, sys
from pathlib import Path
from typer.testing import CliRunner
from structid.cli import app
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sizes, words, left = [int(size) for size in sys.argv[1].split(",")], sys.argv[2:], []
before = {p for p in Path(".").rglob("*")}
for size in sizes:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    done = CliRunner().invoke(app.app, words)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    now = {p for p in Path(".").rglob("*") if "checkpoint" not in p.parts[0]} - before
    error = "" if done.exception is None or isinstance(done.exception, SystemExit) else repr(done.exception)
    left.append([size, done.exit_code, done.stderr, sorted(map(str, now)), error])
    if done.exit_code in (0, 1):
        break
print(json.dumps(left))
"""
WAYS = {
    "identify": ("identify", "chain.toml", "--out", "out", "--no-report"),
    "identify with its report": ("identify", "chain.toml", "--out", "out"),
    "plan": ("plan", "chain.toml", "--sensors", "1", "--out", "out", "--no-report"),
    "modes": ("modes", "frf.npz", "--out", "out", "--no-report"),
    "compare": ("compare", "chain.toml", "chain.toml", "--out", "out", "--no-report"),
    **{f"convert{suffix}": ("convert", "frf.npz", f"b{suffix}") for suffix in (".h5", ".mat", ".csv", ".uff", ".npz")},
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="limits of file size are of POSIX")
@pytest.mark.parametrize(
    "way",
    [
        pytest.param(way, marks=[pytest.mark.long] if way in ("identify with its report", "compare") else [])
        for way in WAYS
    ],
)
def test_a_disk_that_fills_leaves_nothing(tmp_path, way):
    write_chain(tmp_path)
    n_sizes = {"identify": 8, "identify with its report": 4, "modes": 8, "compare": 8, "plan": 8}.get(way, 20)
    sizes = [0, *np.geomspace(300, 1e7, n_sizes).astype(int)]
    done = run("-c", FULL, ",".join(map(str, sizes)), *WAYS[way], folder=tmp_path)
    assert done.returncode == 0, done.stderr
    left = json.loads(done.stdout.splitlines()[-1])
    assert len(left) >= 3
    for size, code, said, files, error in left[:-1]:
        assert (code, files, error) == (2, [], ""), (size, said)
        assert "disk" in said, said
    assert left[-1][1] in (0, 1)


def test_what_is_in_the_way_is_found_before_anything_is_written(tmp_path):
    write_chain(tmp_path)
    (tmp_path / "out" / "estimate.json").mkdir(parents=True)
    (tmp_path / "out" / "estimate.h5").write_text("earlier")
    done = RUN.invoke(
        cli.app, ["identify", str(tmp_path / "chain.toml"), "--no-report", "--out", str(tmp_path / "out")]
    )
    assert done.exit_code == 2
    assert "estimate.json: is in the way of a result of this name" in done.stderr
    assert (tmp_path / "out" / "estimate.h5").read_text() == "earlier"


def test_interrupted_while_it_writes_a_run_says_how_to_go_on(tmp_path, monkeypatch):
    write_chain(tmp_path)

    def interrupted(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr("structid.cli.commands.identify._write", interrupted)
    words = ["identify", str(tmp_path / "chain.toml"), "--no-report", "--out", str(tmp_path / "out")]
    done = RUN.invoke(cli.app, words)
    assert done.exit_code == 130
    assert "nothing was written" not in done.stderr
    assert "--resume" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chain.toml", "frf.npz", "out.checkpoint"]
    monkeypatch.undo()
    assert RUN.invoke(cli.app, [*words, "--resume"]).exit_code == 0


def test_a_folder_that_a_killed_run_left_is_swept(tmp_path):
    (tmp_path / ".out.structid-0123456789ab").mkdir()
    with staged_folder(tmp_path / "out", "estimate.json") as staged:
        (staged / "a").write_text("b")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]

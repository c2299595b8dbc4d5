"""One process at a time in one place; a killed one is no obstacle, and what it left is removed."""

import os
import signal
import subprocess
import sys

import pytest

from structid.core.errors import FileError
from structid.files import atomic_write, claim, claim_path, release

HOLD = "import sys, time; from pathlib import Path; from structid.files import claim; claim(Path(sys.argv[1])); print('held', flush=True); time.sleep(600)"  # noqa: E501


@pytest.fixture
def other(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_place_that_another_process_holds_is_refused_with_its_number(tmp_path, other):
    with pytest.raises(FileError, match=rf"out: process {other.pid} on .* writes there; wait"):
        claim(tmp_path / "out")
    with claim_path(tmp_path / "another"):
        pass
    other.send_signal(signal.SIGKILL)
    other.wait()
    with claim_path(tmp_path / "out"):
        assert f"process {os.getpid()} " in (tmp_path / ".out.lock").read_text()
    assert list(tmp_path.iterdir()) == []


def test_a_process_may_claim_twice_and_lets_go_once(tmp_path):
    claim(tmp_path / "out")
    with claim_path(tmp_path / "out"), claim_path(tmp_path / "out"):
        pass
    assert (tmp_path / ".out.lock").exists()
    release(tmp_path / "out")
    release(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path):
    (tmp_path / ".out.0123456789ab" / "figures").mkdir(parents=True)
    (tmp_path / ".out.0123456789ab" / "estimate.json").write_text("half")
    for name in (".state.0123456789ab.npz", ".state.npz", ".outer.0123456789ab", ".out.0123456789ax", ".out.012.json"):
        (tmp_path / name).write_text("x")
    with claim_path(tmp_path / "out"), claim_path(tmp_path / "state.npz"):
        left = sorted(path.name for path in tmp_path.iterdir())
    assert left == [
        ".out.012.json",
        ".out.0123456789ax",
        ".out.lock",
        ".outer.0123456789ab",
        ".state.npz",
        ".state.npz.lock",
    ]
    with claim_path(tmp_path / "state.npz"), atomic_write(tmp_path / "state.npz") as temporary:
        temporary.write_text("new")  # its own temporary file is not swept
    assert (tmp_path / "state.npz").read_text() == "new"


def test_a_place_that_cannot_be_written_is_told_at_once(tmp_path):
    with pytest.raises(FileError, match="does not exist; create it first"):
        claim(tmp_path / "none" / "out")

"""One process at a time in one place; a killed one is no obstacle, and what it left is removed."""

import errno
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
        assert f"process {os.getpid()} " in (tmp_path / ".out.structid-lock").read_text()
    assert list(tmp_path.iterdir()) == []


def test_a_process_may_claim_twice_and_lets_go_once(tmp_path):
    claim(tmp_path / "out")
    with claim_path(tmp_path / "out"), claim_path(tmp_path / "out"):
        pass
    assert (tmp_path / ".out.structid-lock").exists()
    release(tmp_path / "out")
    release(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path):
    (tmp_path / ".out.structid-0123456789ab" / "figures").mkdir(parents=True)
    (tmp_path / ".out.structid-0123456789ab" / "estimate.json").write_text("half")
    foreign = [
        ".out.012.json",
        ".out.202611281200",
        ".out.lock",
        ".out.structid-0123456789ax",
        ".outer.structid-0123456789ab",
        ".state.npz",
        ".state.202611281200.npz",
        ".state.npz.lock",
    ]
    for name in (".state.structid-0123456789ab.npz", *foreign):
        (tmp_path / name).write_text("x")
    with claim_path(tmp_path / "out"), claim_path(tmp_path / "state.npz"):
        left = sorted(path.name for path in tmp_path.iterdir())
    assert left == sorted([*foreign, ".out.structid-lock", ".state.npz.structid-lock"])
    assert all((tmp_path / name).read_text() == "x" for name in foreign)
    with claim_path(tmp_path / "state.npz"), atomic_write(tmp_path / "state.npz") as temporary:
        temporary.write_text("new")  # its own temporary file is not swept
    assert (tmp_path / "state.npz").read_text() == "new"


def test_a_place_that_cannot_be_written_is_told_at_once(tmp_path):
    with pytest.raises(FileError, match="does not exist; create it first"):
        claim(tmp_path / "none" / "out")


def test_a_child_process_neither_has_nor_ends_the_claim_of_its_parent(tmp_path):
    """A fork copies what the parent holds; the child lets go of its own claims and of those only."""
    script = """
import os, sys, time
from pathlib import Path
from structid.core.errors import FileError
from structid.files import claim, claim_path, release

place = Path(sys.argv[1])
claim(place)
child = os.fork()
if child == 0:
    try:
        with claim_path(place):
            os._exit(1)
    except FileError:
        pass
    while (place.parent / "held").exists():
        time.sleep(0.01)
    with claim_path(place):
        pass
    os._exit(3 if place in __import__("structid.files").files._held else 0)
try:
    time.sleep(0.5)
    with claim_path(place):
        pass
finally:
    release(place)
    (place.parent / "held").unlink()
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    (tmp_path / "held").touch()
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path / "out")], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0\n", "")
    assert list(tmp_path.iterdir()) == []


def test_without_links_a_new_file_replaces_none_that_came_meanwhile(tmp_path, monkeypatch):
    def no_link(*_):
        raise OSError(errno.EPERM, "no links on this file system")

    monkeypatch.setattr(os, "link", no_link)
    with atomic_write(tmp_path / "a.txt", is_new=True) as temporary:
        temporary.write_text("first")
    with (
        pytest.raises(FileError, match="is there already"),
        atomic_write(tmp_path / "a.txt", is_new=True) as temporary,
    ):
        temporary.write_text("second")
    assert (tmp_path / "a.txt").read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]

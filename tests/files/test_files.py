"""Files are written whole or not at all, and missing ones are named with the nearest name."""

import errno
import hashlib
import os

import pytest

from structid.core.errors import FileError
from structid.files import atomic_write, damage_told, digest, require_readable


def test_atomic_write_replaces(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with atomic_write(path) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize(
    "failure", [OSError(errno.ENOSPC, "No space left on device"), RuntimeError("bug"), KeyboardInterrupt()]
)
def test_atomic_write_failure_keeps_old_file(tmp_path, failure):
    path = tmp_path / "a.txt"
    path.write_text("old")
    expected = FileError if isinstance(failure, OSError) else type(failure)

    def write_half():
        with atomic_write(path) as temporary:
            temporary.write_text("half")
            raise failure

    with pytest.raises(expected) as caught:
        write_half()
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
    if expected is FileError:
        assert str(caught.value).startswith(f"{path}: cannot be written (No space left")
        assert "free disk space" in str(caught.value)


def test_atomic_write_without_folder(tmp_path):
    with pytest.raises(FileError, match="create it first"), atomic_write(tmp_path / "no" / "a.txt"):
        pytest.fail("must not get here")
    with pytest.raises(FileError, match="is a folder"), atomic_write(tmp_path):
        pytest.fail("must not get here")


def test_a_study_is_suggested_for_the_name_of_a_study_alone(tmp_path):
    (tmp_path / "chain.toml").write_text("x")
    with pytest.raises(FileError, match=r"no such file; check the name and the folder"):
        require_readable(tmp_path / "chain.csv")
    for name in ("chian.toml", "chain"):
        with pytest.raises(FileError, match=r"did you mean chain\.toml"):
            require_readable(tmp_path / name)


def test_require_readable_names_the_nearest(tmp_path):
    (tmp_path / "measured.uff").write_text("x")
    with pytest.raises(FileError, match=r"mesured.uff: there is no such file; did you mean measured\.uff"):
        require_readable(tmp_path / "mesured.uff")
    with pytest.raises(FileError, match="is a folder"):
        require_readable(tmp_path)
    (tmp_path / "empty.uff").touch()
    with pytest.raises(FileError, match="is empty"):
        require_readable(tmp_path / "empty.uff")
    with pytest.raises(FileError, match="does not exist either"):
        require_readable(tmp_path / "no" / "a")
    assert require_readable(str(tmp_path / "measured.uff")) == tmp_path / "measured.uff"


def test_digest_is_sha256(tmp_path):
    (tmp_path / "a").write_bytes(b"structid")
    assert digest(tmp_path / "a") == hashlib.sha256(b"structid").hexdigest()


def test_pipes_devices_loops_and_odd_names_are_told(tmp_path):
    """A pipe would wait for ever, a device fill memory, a loop suggest its own name."""
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "loop.h5").symlink_to(tmp_path / "loop.h5")
    (tmp_path / "device.npy").symlink_to("/dev/zero")
    for name, words in (
        ("pipe.toml", "is a pipe or a device"),
        ("device.npy", "is a pipe or a device"),
        ("loop.h5", "is a broken link"),
        ("a\0b.npz", r"a\\x00b.npz': a name cannot hold a null"),
    ):
        with pytest.raises(FileError, match=words):
            require_readable(tmp_path / name)
        with pytest.raises(FileError, match=words):
            digest(tmp_path / name)


def test_damage_is_told_once_with_the_path(tmp_path):
    path = tmp_path / "a.x"
    for raised, words in (
        (RecursionError("deep"), "is not a thing (deep); mend it"),
        (OverflowError(), "is not a thing (OverflowError); mend it"),
        (ValueError("1" * 5000), "1..."),
        (FileError("no entry"), f"{path}: no entry"),
        (FileError(f"{path}, line 3: no entry"), f"{path}, line 3: no entry"),
        (MemoryError("Unable to allocate 9 TiB"), "does not fit in memory (Unable to allocate 9 TiB)"),
    ):
        with pytest.raises(FileError) as caught, damage_told(path, "a thing", "mend it"):
            raise raised
        assert words in str(caught.value)
        assert str(caught.value).count(str(path)) == 1
        assert len(str(caught.value)) < 500
    with pytest.raises(TypeError), damage_told(path, "a thing"):  # of the program, not of the file
        raise TypeError

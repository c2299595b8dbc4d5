"""Files are written whole or not at all, and missing ones are named with the nearest name."""

import errno
import hashlib

import pytest

from structid.errors import FileError
from structid.files import atomic_write, digest, require_readable


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

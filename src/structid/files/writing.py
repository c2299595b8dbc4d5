"""Files written whole or not at all."""

from __future__ import annotations

import csv
import io
import os
import secrets
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from structid.core.errors import FileError


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV text: `header`, then `rows`, with lines that end in a line feed."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


@contextmanager
def atomic_write(path: str | Path, is_new: bool = False) -> Iterator[Path]:
    """Context manager: a temporary path in the folder of `path`, renamed to `path` if the block ends without an error.

    On any error the temporary file is removed and a file already at `path` stays as it was. A file that is replaced hands on
    its permissions.

    Parameters
    ----------
    path : str or Path
    is_new : bool, optional
        True if a file that exists at `path` at the end of the block is an error.

    Raises
    ------
    FileError
        If writing fails (disk full, no permission, no folder).

    Examples
    --------
    >>> with atomic_write("/tmp/structid-example.txt") as temporary:
    ...     _ = temporary.write_text("whole or not at all")
    """
    path = Path(path)
    if path.is_dir():
        raise FileError(f"{path}: is a folder; give the path of a file to write")
    if not path.parent.is_dir():
        raise FileError(f"{path}: its folder {path.parent} does not exist; create it first")
    temporary = path.parent / f".{path.stem[:100]}.{secrets.token_hex(6)}{path.suffix}"
    try:
        yield temporary
        _keep_permissions(path, temporary)
        _flush_to_disk(temporary)
        if not is_new:
            temporary.replace(path)
        elif not _link_new(temporary, path):
            raise FileError(f"{path}: is there already; give another name, or remove it")
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); free disk space, check the permissions of "
            f"{path.parent}, or write to another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def replace_unchanged(path: Path, content: bytes, is_expected: Callable[[bytes | None], bool]) -> bool:
    """Write `content` to `path` in one step if its present content satisfies `is_expected`; else change nothing.

    Other programs may write `path` at any time: where the system can exchange two names (Linux), what was replaced is looked
    at once more afterwards, and is put back where it is not as expected.

    Parameters
    ----------
    path : Path
        A file, or the name of a new one in a folder that is there.
    content : bytes
    is_expected : callable
        Returns True for a content (None without a file) that may be replaced.

    Returns
    -------
    bool
        True if the content was written.

    Raises
    ------
    FileError
        If writing fails.
    """
    temporary = path.parent / f".{path.stem[:100]}.{secrets.token_hex(6)}{path.suffix}"
    try:
        temporary.write_bytes(content)
        _keep_permissions(path, temporary)
        _flush_to_disk(temporary)
        before = path.read_bytes() if path.exists() else None
        if not is_expected(before):
            return False
        if before is None:
            return _link_new(temporary, path)
        if not _exchange_names(temporary, path):  # another system: the moment between is left
            temporary.replace(path)
            return True
        if is_expected(temporary.read_bytes()):
            return True
        _exchange_names(temporary, path)
        if temporary.read_bytes() != content:  # written once more meanwhile: the newest stays
            _exchange_names(temporary, path)
        return False
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); free disk space, check the permissions of "
            f"{path.parent}, or write to another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _link_new(temporary: Path, path: Path) -> bool:
    """Give the temporary file the name `path` unless that exists; True if it did, False if there is such a file."""
    try:
        os.link(temporary, path)
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        temporary.replace(path)
    return True


def _exchange_names(first: Path, second: Path) -> bool:
    """Exchange the names of the files `first` and `second` in one step (renameat2); False if the system cannot, or it failed."""
    if sys.platform != "linux":
        return False
    import ctypes

    exchange = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    here = -100  # AT_FDCWD
    return exchange is not None and exchange(here, os.fsencode(first), here, os.fsencode(second), 2) == 0


def _keep_permissions(path: Path, temporary: Path) -> None:
    """Give `temporary` the permissions of the file that it is to replace."""
    with suppress(OSError):
        temporary.chmod(stat.S_IMODE(path.stat().st_mode))


def _flush_to_disk(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def require_no_file(folder: Path) -> None:
    """Raise `FileError` if a file stands in the way of creating `folder`."""
    there = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if there.exists() and not there.is_dir():
        raise FileError(f"{there}: is a file; give another folder for the results with --out")


def make_folder(path: Path) -> Path:
    """The folder `path`, created with its parents if it does not exist.

    Raises
    ------
    FileError
        If it is a file, or cannot be made.
    """
    if path.exists() and not path.is_dir():
        raise FileError(f"{path}: is a file; give another folder for the results")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{path}: cannot be made ({error.strerror or error}); choose another folder") from error
    return path

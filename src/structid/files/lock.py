"""One process at a time writes to a place; the system lets it go when that process ends, however it ends."""

from __future__ import annotations

import atexit
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from structid.core.errors import FileError

try:
    import fcntl
except ImportError:  # Windows: two runs in one place are not told
    fcntl = None  # type: ignore[assignment]

_WAIT_SECONDS = 0.01
#: Places that this process holds, and the descriptors of their locks.
_held: dict[Path, tuple[int, int]] = {}


@contextmanager
def claim_path(path: Path, patience: float = 0.0) -> Iterator[None]:
    """Context manager in which this process alone may write to `path`, a file or folder that may not exist yet.

    It may claim a path repeatedly. Another process that writes there is waited for up to `patience` seconds; then
    `FileError`.
    """
    path = path.absolute()
    before = path in _held
    claim(path, patience)
    try:
        yield
    finally:
        if not before:
            release(path)


def claim(path: Path, patience: float = 0.0) -> None:
    """Lock `path` for this process until `release`, and remove files that a killed run left half written beside it.

    Another process that holds the lock is waited for up to `patience` seconds.

    Raises
    ------
    FileError
        If another process holds it, or nothing can be written beside it.
    """
    path = path.absolute()
    if path in _held and _held[path][1] == os.getpid():
        return
    if not path.parent.is_dir():
        raise FileError(f"{path}: its folder {path.parent} does not exist; create it first")
    lock = _lock_file(path)
    try:
        _held[path] = _open_locked(path, lock, patience), os.getpid()
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); check the permissions of {path.parent}, or write to"
            " another folder"
        ) from error
    _remove_leftovers(path)


def release(path: Path) -> None:
    """Give up this process's lock on `path` and remove the lock file."""
    path = path.absolute()
    descriptor, owner = _held.pop(path, (-1, 0))
    if owner == os.getpid():
        with suppress(OSError):
            _lock_file(path).unlink(missing_ok=True)
        os.close(descriptor)


def _lock_file(path: Path) -> Path:
    return path.parent / f".{path.name[:200]}.lock"


def _open_locked(path: Path, lock: Path, patience: float) -> int:
    """Descriptor of the lock file `lock` of `path`, opened and locked.

    Waits up to `patience` seconds for another process, then raises `FileError`.
    """
    end = time.monotonic() + patience
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            words = os.pread(descriptor, 200, 0).decode("utf-8", "replace").strip() or "another process"
            os.close(descriptor)
            if time.monotonic() < end:
                time.sleep(_WAIT_SECONDS)
                continue
            raise FileError(
                f"{path}: {words} writes there; wait until it has ended, or write to another place"
            ) from error
        except OSError:  # a file system without locks
            pass
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), lock.stat()):
                with suppress(OSError):  # a full disk: the lock holds without a name
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
                return descriptor
        os.close(descriptor)  # the one who held it has just removed it


def _remove_leftovers(path: Path) -> None:
    """Remove temporary files and folders that an interrupted write of `path` left beside it; the caller holds the lock."""
    mark = r"\.[0-9a-f]{12}"
    names = f"{re.escape('.' + path.name)}{mark}|{re.escape('.' + path.stem[:100])}{mark}{re.escape(path.suffix)}"
    for leftover in path.parent.glob(".*"):
        if re.fullmatch(names, leftover.name):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)


@atexit.register
def _release_all() -> None:
    for path in list(_held):
        release(path)

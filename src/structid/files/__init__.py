"""Files: read with a clear word when something is wrong with them, and written whole or not at all by one process at a time.

The system releases a claimed path when the process that claimed it ends, however it ends.
"""

from __future__ import annotations

import atexit
import csv
import difflib
import errno
import hashlib
import io
import os
import re
import secrets
import shutil
import socket
import stat
import struct
import sys
import time
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from structid.core.errors import FileError, InputError

try:
    import fcntl
except ImportError:  # Windows: two runs in one place are not told
    fcntl = None  # type: ignore[assignment]

#: What Python, NumPy and SciPy raise on content that is not as its format says.
DAMAGE = (
    ValueError, ArithmeticError, LookupError, OSError, EOFError, RecursionError, NotImplementedError, SyntaxError,
    tokenize.TokenError, struct.error, zlib.error, zipfile.BadZipFile,
)  # fmt: skip
_WAIT_SECONDS = 0.01
#: What the names of locks and of temporary files and folders hold, which nobody else's have.
_LOCK, _MARK = ".structid-lock", ".structid-"
#: Places that this process holds, and the descriptors of their locks.
_held: dict[Path, int] = {}


def require_readable(path: str | Path) -> Path:
    """`path` as a `Path`, after a check that it is an ordinary, readable file that is not empty.

    Raises
    ------
    FileError
        If it is missing (the nearest name in its folder is suggested), a folder, a pipe or device, empty or not
        permitted.
    """
    path = Path(path)
    if "\0" in str(path):
        raise FileError(f"{str(path)!r}: a name cannot hold a null character; correct the name")
    try:
        if path.is_dir():
            raise FileError(f"{path}: is a folder; give the path of a file in it")
        if not path.exists():
            raise FileError(f"{path}: {_why_missing(path)}")
        if not path.is_file():
            raise FileError(f"{path}: is a pipe or a device, which has no size; copy what it gives to a file")
        with path.open("rb") as stream:
            if not stream.read(1):
                raise FileError(f"{path}: the file is empty; write or copy it again")
    except (OSError, ValueError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{path}: cannot be opened ({error}); check the path and its permissions") from error
    return path


def read_part(path: Path, begin: int, most: int) -> bytes:
    """Up to `most` bytes from byte `begin` of an ordinary file that is no link; raises as `read_start` does."""
    return read_start(path, most, follow=False, begin=begin)


def read_start(path: Path, most: int, follow: bool = True, begin: int = 0) -> bytes:
    """Up to `most` bytes of an ordinary file from byte `begin` on; a pipe or a device is not waited for.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Bytes at most.
    follow : bool, optional
        False to refuse a link, where the system can.
    begin : int, optional
        Byte from which on it is read.

    Raises
    ------
    OSError
        If it cannot be opened or is no ordinary file.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags | (0 if follow else getattr(os, "O_NOFOLLOW", 0)))
    with os.fdopen(descriptor, "rb") as stream:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "is a pipe or a device, and no file", str(path))
        if begin:
            stream.seek(begin)
        return stream.read(most)


def _why_missing(path: Path) -> str:
    """The reason why there is no file at `path`, with the nearest name in its folder as a suggestion.

    A study is suggested only for a name that ends as studies do, or has no suffix: no record or mesh is a study.
    """
    if path.is_symlink():
        return "is a broken link; mend it, or give the file itself"
    folder = path.parent
    if not folder.is_dir():
        return f"there is no such file; its folder {folder} does not exist either"
    may_be_study = path.suffix.lower() in ("", ".toml")
    names = [entry.name for entry in folder.iterdir() if may_be_study or entry.suffix.lower() != ".toml"]
    close_names = difflib.get_close_matches(path.name, names, n=1, cutoff=0.5)
    return "there is no such file; " + (
        f"did you mean {close_names[0]}?" if close_names else "check the name and the folder"
    )


def digest(path: str | Path) -> str:
    """SHA-256 of the file at `path`, in hexadecimal.

    Raises
    ------
    FileError
        If the file cannot be read.
    """
    path = require_readable(path)
    with damage_told(path, "a readable file"), path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def damage_told(path: Path, kind: str, remedy: str = "copy or write it again") -> Iterator[None]:
    """Context manager that turns exceptions of damaged content in a reader into a `FileError` that begins with `path`.

    Such exceptions are `ValueError`, `LookupError`, `ArithmeticError`, `OSError` and others in `DAMAGE`. An
    `InputError` whose message begins with `path` is raised as it is; any other becomes a `FileError` with `path` in
    front. A `MemoryError` becomes a `FileError` that says so.

    Parameters
    ----------
    path : Path
        The file that is read.
    kind : str
        The kind of file that is expected, with its article, as in "a whole NPZ archive".
    remedy : str
        End of the message: an instruction to the user.
    """
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise FileError(f"{path}: {error}", error.option) from error
    except MemoryError as error:
        raise FileError(
            f"{path}: does not fit in memory ({error or 'no more is to be had'}); free some, read a part of it, or take a"
            " machine with more"
        ) from error
    except DAMAGE as error:
        raise FileError(f"{path}: is not {kind} ({_short(error)}); {remedy}") from error


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."


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

    On any error the temporary file is removed and a file already at `path` stays as it was. A file that is replaced
    hands on its permissions.

    Parameters
    ----------
    path : str or Path
        The file to be written.
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
    with _temporary_beside(path) as temporary:
        yield temporary
        _keep_permissions(path, temporary)
        _flush_to_disk(temporary)
        if not is_new:
            temporary.replace(path)
        elif not _link_new(temporary, path):
            raise FileError(f"{path}: is there already; give another name, or remove it")


def replace_unchanged(path: Path, content: bytes, is_expected: Callable[[bytes | None], bool]) -> bool:
    """Write `content` to `path` in one step if its present content satisfies `is_expected`; else change nothing.

    Other programs may write `path` at any time: where the system can exchange two names (Linux), what was replaced is
    looked at once more afterwards, and is put back where it is not as expected.

    Parameters
    ----------
    path : Path
        A file, or the name of a new one in a folder that is there.
    content : bytes
        New content.
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
    with _temporary_beside(path) as temporary:
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


def temporary_path(path: Path) -> Path:
    """A new hidden name beside `path` for a file or folder that is renamed to it when it is whole; `claim` removes old ones."""
    return path.parent / f".{path.stem[:100]}{_MARK}{secrets.token_hex(6)}{path.suffix}"


@contextmanager
def _temporary_beside(path: Path) -> Iterator[Path]:
    """Context manager that gives a new name beside `path`, removes the file of this name at the end, and tells failures.

    An `OSError` becomes a `FileError` that says that `path` cannot be written.
    """
    temporary = temporary_path(path)
    try:
        yield temporary
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); free disk space, check the permissions of "
            f"{path.parent}, or write to another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _link_new(temporary: Path, path: Path) -> bool:
    """Give the temporary file the name `path` unless that exists; True if it did, False if there is such a file.

    On a file system without links an empty file takes the name first, which only one process can make.
    """
    try:
        os.link(temporary, path)
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            return False
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


@contextmanager
def claim_path(path: Path, patience: float = 0.0) -> Iterator[None]:
    """Context manager in which this process alone may write to `path`, a file or folder that may not exist yet.

    A claim within a claim of this process is allowed; the outer one ends it. Another process that writes there is
    waited for up to `patience` seconds; then `FileError`.
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

    Another process that holds the lock is waited for up to `patience` seconds. Nothing is done if this process has it.

    Raises
    ------
    FileError
        If another process holds it, its folder does not exist, or nothing can be written beside it.
    """
    path = path.absolute()
    if path in _held:
        return
    if not path.parent.is_dir():
        raise FileError(f"{path}: its folder {path.parent} does not exist; create it first")
    lock = _lock_file(path)
    try:
        _held[path] = _open_locked(path, lock, patience)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); check the permissions of {path.parent}, or write to"
            " another folder"
        ) from error
    _remove_leftovers(path)


def release(path: Path) -> None:
    """Give up this process's lock on `path` and remove the lock file; nothing happens if this process holds none."""
    path = path.absolute()
    if path in _held:
        with suppress(OSError):
            _lock_file(path).unlink(missing_ok=True)
        os.close(_held.pop(path))


def _lock_file(path: Path) -> Path:
    return path.parent / f".{path.name[:200]}{_LOCK}"


def _open_locked(path: Path, lock: Path, patience: float) -> int:
    """Descriptor of the lock file `lock` of `path`, opened and locked.

    This process and host are written into the file. Waits up to `patience` seconds for another process, then raises
    `FileError`. A file system without locks is taken as locked.
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
    """Remove temporary files and folders that an interrupted write of `path` left beside it.

    They have names of `temporary_path`. Call it with the lock on `path` held.
    """
    names = f"{re.escape(f'.{path.stem[:100]}{_MARK}')}[0-9a-f]{{12}}{re.escape(path.suffix)}"
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


def _forget_claims_of_parent() -> None:
    """Forget what this process, a copy of its parent, has not claimed itself; the parent's locks stay."""
    for descriptor in _held.values():
        os.close(descriptor)
    _held.clear()


if hasattr(os, "register_at_fork"):  # Windows has no copies of processes
    os.register_at_fork(after_in_child=_forget_claims_of_parent)

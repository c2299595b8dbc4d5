"""Files that are read: a clear word where one is not there, damaged, or larger than memory."""

from __future__ import annotations

import difflib
import errno
import hashlib
import os
import stat
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from structid.core.errors import FileError, InputError

#: What Python, NumPy and SciPy raise on content that is not as its format says.
DAMAGE = (
    ValueError, ArithmeticError, LookupError, OSError, EOFError, RecursionError, NotImplementedError, SyntaxError,
    tokenize.TokenError, struct.error, zlib.error, zipfile.BadZipFile,
)  # fmt: skip


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

    An `InputError` whose message begins with `path` is raised as it is.

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

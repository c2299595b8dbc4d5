"""Files written whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from structid.core.errors import FileError


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """A temporary path in the folder of `path`, which becomes `path` when the block ends without an error.

    On any error the temporary file is removed and a file already at `path` stays as it was.

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
        _flush_to_disk(temporary)
        temporary.replace(path)
    except OSError as error:
        raise FileError(
            f"{path}: cannot be written ({error.strerror or error}); free disk space, check the permissions of "
            f"{path.parent}, or write to another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def _flush_to_disk(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def require_no_file(folder: Path) -> None:
    """Raise `FileError` where a file stands in the way of `folder`."""
    there = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if there.exists() and not there.is_dir():
        raise FileError(f"{there}: is a file; give another folder for the results with --out")


def made_folder(path: Path) -> Path:
    """`path` as a folder, made with its parents where it does not exist.

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

"""Files that compiled libraries read in a process beside this one, with limits of memory and time: HDF5, and MAT files of MATLAB.

Libraries in C trust a file's own sizes and offsets: a changed byte can end the process. The readers of
`structid.files.worker` therefore run in a child, which is started with the first such file, serves those that follow, and is
replaced when it fails. Of a MAT file, numbers, texts, cells of texts, structs and sparse matrices are read; objects, functions,
arrays of structs and cells of other things are passed over.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.core.isolation import import_paths, kill_child, python_arguments, start_child
from structid.core.json_types import JsonValue
from structid.files import damage_told, require_readable
from structid.files.sparse import checked_sparse_matrix
from structid.files.worker import SLIP, fill_tree
from structid.files.worker import __file__ as _SCRIPT

T = TypeVar("T")

_SECONDS, _BYTES_A_SECOND = 15.0, 1e6  # a slow network drive
_START_SECONDS = 120.0
#: A dataset as read: numbers, a text, or a list of texts.
Field = np.ndarray | str | tuple[str, ...]
#: A variable: numbers, a text, or a list of texts.
Variable: TypeAlias = np.ndarray | sparse.csc_array | str | tuple[str, ...]

_REMEDY = "copy or save it again"
_HDF5_START = b"\x89HDF\r\n\x1a\n"


class ReaderError(Exception):
    """Exception of a reader in the child process: `kind` is its class name."""

    def __init__(self, kind: str, words: str) -> None:
        super().__init__(words or kind)
        self.kind = kind


class _LostError(Exception):
    """The child ended, or did not answer in time: then it `is_late`."""

    def __init__(self, words: str, is_late: bool = False) -> None:
        super().__init__(words)
        self.is_late = is_late


class _Answer(NamedTuple):
    """Answer of the child process: a tree with numbers in place of its arrays, and the arrays; or its exception."""

    tree: JsonValue = None
    arrays: tuple[np.ndarray, ...] = ()
    error: ReaderError | None = None


class _Child:
    """A running `worker.py`."""

    def __init__(self) -> None:
        """Start a Python process that runs `worker.py`, and wait up to 120 s until it is ready.

        It works in the folder of the Python installation. `_LostError` if it ends before, or is killed since it took
        longer.
        """
        paths = os.pathsep.join(import_paths(sys.path, Path.cwd()))
        self.owner, self.served = os.getpid(), 0
        self.process = start_child(
            python_arguments(_SCRIPT), stdin=subprocess.PIPE, output=subprocess.PIPE,
            changes={"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        self._timed(_START_SECONDS, lambda stream: stream.readline())

    def ask(self, request: Mapping[str, JsonValue], seconds: float) -> _Answer:
        """Send one request (reader, path, options, seconds) and return the child's answer, which may be an error.

        `seconds` is the time after which the child is late and is killed; `_LostError` then, or if it ends.
        """
        assert self.process.stdin is not None
        self.served += 1
        try:
            self.process.stdin.write(json.dumps(request).encode("ascii") + b"\n")
            self.process.stdin.flush()
        except OSError as error:
            raise _LostError("ended") from error
        return self._timed(seconds, _read_answer)

    def _timed(self, seconds: float, read: Callable[[IO[bytes]], T | None]) -> T:
        """Result of `read(stream)` on the child's output.

        Raises `_LostError` if the result is empty, as when the child ends or is killed because it took more than
        `seconds`.
        """
        assert self.process.stdout is not None
        timer = threading.Timer(seconds, kill_child, [self.process])
        timer.daemon = True
        timer.start()
        try:
            answer = read(self.process.stdout)
        finally:
            is_late = not timer.is_alive()
            timer.cancel()
        if not answer:
            raise _LostError(f"took more than {seconds:.0f} s" if is_late else "ended", is_late)
        return answer

    def close(self) -> None:
        """Kill the child process and close its pipes; in a process that did not start it, close the pipes only."""
        if self.owner == os.getpid():
            kill_child(self.process)
            self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with suppress(OSError):  # a request that it never took
                    stream.close()


def _read_answer(stream: IO[bytes]) -> _Answer | None:
    """One answer of the child from `stream`: a tree of JSON with its arrays, or the error of the reader.

    None if the stream ends before the answer is complete.
    """
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    answer = json.loads(line)
    if "error" in answer:
        return _Answer(error=ReaderError(answer["error"], answer["words"]))
    arrays = []
    for form, shape in answer["arrays"]:
        array = np.empty(math.prod(shape) * np.dtype(form).itemsize, np.uint8)
        if stream.readinto(array.data) != array.size:  # type: ignore[attr-defined]  # it is a buffered reader
            return None
        arrays.append(array.view(form).reshape(shape))
    return _Answer(answer["tree"], tuple(arrays))


_lock = threading.Lock()
_running: list[_Child] = []


def read_in_child(path: Path, reader: str, seconds: float | None = None, **options: JsonValue) -> Any:
    """Run the reader `reader` of `structid.files.worker` on `path` in a child process and return what it returns.

    `seconds` limits the time (15 by default), with one second more for each MB of the file; `options` go to the reader.
    One child serves all requests, one after another.

    Raises
    ------
    ReaderError
        If the reader raised; the child is ended then.
    RuntimeError
        If it raised for a mistake of this package, which no file explains.
    FileError
        If the library crashed on the file, or did not come to an end; the message begins with `path`.
    """
    seconds = (_SECONDS if seconds is None else seconds) + path.stat().st_size / _BYTES_A_SECOND
    request: dict[str, JsonValue] = {
        "reader": reader,
        "path": str(path.resolve()),
        "options": options,
        "seconds": seconds,
    }
    with _lock:
        answer = _ask_child(path, request, seconds)
        if answer.error is not None:
            end()  # damage may have left it in a state that the next file should not meet
            if answer.error.kind == SLIP:
                raise RuntimeError(f"the reader of {path} has a mistake: {answer.error}")
            raise answer.error
    return fill_tree(answer.tree, answer.arrays.__getitem__)


def _ask_child(path: Path, request: Mapping[str, JsonValue], seconds: float) -> _Answer:
    """The answer to `request` of the running child, or of a new one if the child that served earlier requests has ended.

    Raises `FileError`, which names `path`, if a new child ends on the file, or if any child takes longer than `seconds`.
    """
    while True:
        if not _running or _running[0].owner != os.getpid():
            _running[:] = [_Child()]
        child = _running[0]
        is_new = child.served == 0
        try:
            return child.ask(request, seconds)
        except _LostError as error:
            end()
            if is_new or error.is_late:
                raise FileError(
                    f"{path}: cannot be read: the library that reads such files {error} on it, so that it is damaged; copy"
                    " or write it again"
                ) from error
        except BaseException:  # interrupted while it answers: what comes would be taken for the next answer
            end()
            raise


def end() -> None:
    """End the child process; the next file starts a new one."""
    while _running:
        _running.pop().close()


atexit.register(end)


class Dataset(NamedTuple):
    """Shape and type of a dataset, and the byte of the file where its values begin: None where they lie in pieces."""

    shape: tuple[int, ...]
    dtype: np.dtype
    offset: int | None


def hdf5_datasets(path: Path) -> dict[str, Dataset]:
    """Shape, type and position of every dataset of the file at `path`, by its path without the leading slash.

    The position is the byte at which its values begin, or None where they do not lie in one piece as they are. Texts have the
    type of objects, references and lists that of void.

    Raises
    ------
    FileError
        If the file is not HDF5, is damaged, or has links to other files.
    """
    with _hdf5_errors(path):
        declared = read_in_child(path, "hdf5_shapes")
    return {
        name: Dataset(tuple(shape), np.dtype(object) if form == "text" else np.dtype(form), offset)
        for name, (shape, form, offset) in declared.items()
    }


def hdf5_attributes(path: Path) -> dict[str, np.ndarray | tuple[str, ...]]:
    """Attributes that are texts or up to 4096 numbers, by ``path@name``; the path of the file itself is empty.

    They belong to datasets, groups and the file. Values are tuples of texts or one-dimensional arrays.
    """
    with _hdf5_errors(path):
        entries = read_in_child(path, "hdf5_attributes")
    return {name: value if isinstance(value, np.ndarray) else tuple(map(str, value)) for name, value in entries.items()}


def hdf5_fields(path: Path, names: Iterable[str]) -> dict[str, Field]:
    """Values of those datasets called `names` that the file has, by name: an array, a text, or a tuple of texts.

    Raises
    ------
    FileError
        If the file is damaged, or the values of a dataset lie in other files or were never written.
    """
    with _hdf5_errors(path):
        return _fields(read_in_child(path, "hdf5_fields", names=list(names)))


def hdf5_part(path: Path, name: str, begin: int, stop: int, axis: int) -> np.ndarray:
    """Entries `begin` to `stop` (exclusive) along `axis` 0 or 1 of the two-dimensional dataset `name`."""
    with _hdf5_errors(path):
        part: np.ndarray = read_in_child(path, "hdf5_part", name=name, begin=begin, stop=stop, axis=axis)
    return part


def matlab_73_fields(path: Path) -> dict[str, Field]:
    """Every variable of numbers or texts of a MAT file of version 7.3, by name."""
    with _hdf5_errors(path):
        return _fields(read_in_child(path, "matlab_73"))


def texts_of(field: Field) -> tuple[str, ...]:
    """The texts of a field as a tuple: one text, or a list of them."""
    return (field,) if isinstance(field, str) else tuple(map(str, field))


def _fields(fields: Mapping[str, Field | list[str]]) -> dict[str, Field]:
    return {name: tuple(field) if isinstance(field, list) else field for name, field in fields.items()}


@contextmanager
def _hdf5_errors(path: Path) -> Iterator[None]:
    """Context manager that turns a `ReaderError` of its block into `FileError` with `path`, the cause and the remedy.

    `FileError` also before the block, if `path` is no readable file.
    """
    require_readable(path)
    try:
        yield
    except ReaderError as error:
        if error.kind == "UnusableError":
            raise FileError(f"{path}: {error}") from error
        if error.kind == "MemoryError":
            raise FileError(
                f"{path}: does not fit in memory; read a part of it, or write it again if it is damaged"
            ) from error
        raise FileError(f"{path}: is damaged, cut short or not HDF5 ({error}); copy or write it again") from error


def matlab_variables(path: Path) -> dict[str, Variable]:
    """Variables in the MAT file at `path` by name: arrays, sparse matrices, texts and tuples of texts.

    Fields of a struct are named ``name.field``. Variables of other kinds are passed over.

    Raises
    ------
    FileError
        If the file is not a MAT file, or is damaged.
    """
    path = require_readable(path)
    if _is_73(path):
        return dict(matlab_73_fields(path))
    with damage_told(path, "a whole MAT file", _REMEDY):
        try:
            variables = read_in_child(path, "matlab")
        except ReaderError as error:
            raise FileError(f"{path}: is not a whole MAT file ({error}); {_REMEDY}") from error
        return {name: _to_variable(value) for name, value in variables.items()}


def _is_73(path: Path) -> bool:
    """True if the MAT file at `path` is of version 7.3, which is HDF5."""
    with path.open("rb") as stream:
        head = stream.read(520)
    return head.startswith((b"MATLAB 7.3", _HDF5_START)) or head[512:] == _HDF5_START


def _to_variable(value: np.ndarray | str | list[str] | dict[str, np.ndarray]) -> Variable:
    """The variable of `value` as the child process sent it: a list as a tuple, a mapping as a sparse matrix.

    The mapping has the matrix's shape, column starts, rows and values. Arrays and texts stay.
    """
    if isinstance(value, dict):
        n_rows, n_columns = value["shape"].tolist()
        return checked_sparse_matrix((n_rows, n_columns), value["starts"], value["rows"], value["values"])
    return tuple(value) if isinstance(value, list) else value

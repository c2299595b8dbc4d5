"""Reading through compiled libraries in a process beside this one, with limits of memory and time.

Libraries in C trust a file's own sizes and offsets: a changed byte can end the process. The readers of
`structid.files.worker` therefore run in a child, which is started with the first such file, serves those that follow, and is
replaced when it fails.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

import numpy as np

from structid.core.errors import FileError
from structid.core.isolation import import_paths, kill_child, python_arguments, start_child
from structid.core.json_types import JsonValue
from structid.files.worker import __file__ as _SCRIPT
from structid.files.worker import fill_tree

T = TypeVar("T")

_SECONDS, _BYTES_A_SECOND = 15.0, 1e6  # a slow network drive
_START_SECONDS = 120.0


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
        """Start a Python process that runs `worker.py` in the neutral folder, and wait up to 120 s until it is ready.

        `_LostError` if it ends before, or is killed since it took longer.
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

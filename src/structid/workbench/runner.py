"""One run of `structid identify` in a process of its own, whose end is written down however it comes.

Called as ``python -m structid.workbench.runner FOLDER WORDS...``; it imports nothing that takes time or memory. Of all runs of a
user `AT_ONCE` compute, the others wait in the order in which they were started.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from structid.core.isolation import python_arguments, start_child
from structid.workbench.user_state import state_folder

try:
    import fcntl
except ImportError:  # Windows: runs do not wait
    fcntl = None  # type: ignore[assignment]

#: Runs of a user that compute at the same time.
AT_ONCE = 2
#: Letters that are kept free for how the run ends, so that a full disk does not swallow it.
_ENDED = 80
#: Bytes below which a disk is full.
_FULL = 1_000_000
_WAIT_SECONDS, _STOPPED = 0.2, 130


def main() -> None:
    """Run a structid command as a child process, in its turn, and write how it ended to ``ended.json``.

    ``sys.argv`` holds the folder of the run and the words of the command. ``ended.json`` holds the exit code (130 if stopped
    before its turn) and ``disk_full``, True if less than 1 MB is free.
    """
    folder, words = Path(sys.argv[1]), sys.argv[2:]
    (folder / "ended.json").write_text(" " * _ENDED, encoding="utf-8")
    for number in (signal.SIGINT, signal.SIGTERM):  # sent to the whole group: this process waits for the other's end
        signal.signal(number, lambda *_: None)
    with _turn(folder) as has_turn:
        code = _run_command(folder, words) if has_turn else _STOPPED
    ended = {"code": code, "disk_full": shutil.disk_usage(folder).free < _FULL}
    with (folder / "ended.json").open("r+", encoding="utf-8") as stream:
        stream.write(json.dumps(ended).ljust(_ENDED))


def _run_command(folder: Path, arguments: list[str]) -> int:
    """Exit code of the structid command `arguments`, run to its end with all output appended to ``log.txt`` in `folder`.

    Its process id is written to ``child.json`` there.
    """
    with (folder / "log.txt").open("ab") as log:
        child = start_child(python_arguments("-m", "structid", *arguments), output=log, errors=log, has_group=False)
        (folder / "child.json").write_text(json.dumps({"pid": child.pid}), encoding="utf-8")
        return child.wait()


@contextmanager
def _turn(folder: Path) -> Iterator[bool]:
    """Context that waits until fewer than two runs of the user compute; yields True then, or False after a stop.

    `folder` is that of the run, which holds the file ``queued`` while it waits; a file ``stop`` there asks it to stop.
    Runs wait in the order in which they came. Without file locks, or a folder to wait in, there is no waiting.
    """
    try:
        queue = state_folder() / "runs"
        queue.mkdir(exist_ok=True)
        ticket = _take_ticket(queue / f"{time.time_ns():020}-{os.getpid()}")
    except OSError:  # nowhere to wait
        ticket = None
    if ticket is None:
        yield True
        return
    waiting = folder / "queued"
    try:
        while not (folder / "stop").exists():
            if _position(queue, ticket[1]) < AT_ONCE:
                waiting.unlink(missing_ok=True)
                yield True
                return
            waiting.touch()
            time.sleep(_WAIT_SECONDS)
        yield False
    finally:
        ticket[1].unlink(missing_ok=True)
        os.close(ticket[0])


def _take_ticket(path: Path) -> tuple[int, Path] | None:
    """File descriptor and path of a new queue ticket, locked as long as this process lives; None without file locks."""
    if fcntl is None:
        return None
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return descriptor, path


def _position(queue: Path, ticket: Path) -> int:
    """Number of live runs with a ticket older than `ticket` in the folder `queue`; tickets of dead runs are removed."""
    count = 0
    for path in sorted(queue.glob("[0-9]*-[0-9]*")):
        if path.name >= ticket.name:
            break
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDWR)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink(missing_ok=True)  # its run was killed
            except BlockingIOError:
                count += 1
            finally:
                os.close(descriptor)
    return count


if __name__ == "__main__":
    main()

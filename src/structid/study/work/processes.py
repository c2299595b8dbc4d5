"""Tasks on processes of this machine."""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from structid.errors import InputError
from structid.estimation.search.work import Task, Tools
from structid.study.work.parts import Package, StudyPlace, is_known, packed
from structid.study.work.tasks import Batch, WorkersLostError, in_batches, run_batch

_MOST_LOSSES = 5


class Processes:
    """A pool of processes, each of which unpacks what tasks share once.

    Parameters
    ----------
    n_workers : int
    place : StudyPlace, optional
        Where they find the study.
    parts : sequence of object
        What of it they make themselves.

    Raises
    ------
    InputError
        If `n_workers` is less than 1.
    """

    def __init__(self, n_workers: int, place: StudyPlace | None = None, parts: Sequence[object] = ()) -> None:
        if n_workers < 1:
            raise InputError(f"`workers` must be at least 1, got {n_workers}; one for each core is usual")
        self.n_workers = n_workers
        self.words = f"{n_workers} processes of this machine"
        self.place, self.parts = place, parts
        self._pool: ProcessPoolExecutor | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._last: tuple[Any, str, Package] | None = None

    def known(self, parts: Sequence[object]) -> None:
        """Name the parts of the study that workers make themselves."""
        self.parts, self._last = parts, None

    def completed(
        self, task: Task, shared: Any, items: Mapping[int, Any], tools: Callable[[int], Tools]
    ) -> Iterator[tuple[int, Any]]:
        path, light = self._written(shared)
        missing, losses = dict(items), 0
        while missing:
            pool = self._started()

            def submit(what: Task, batch: Batch, pool: ProcessPoolExecutor = pool) -> Future[Any]:
                return pool.submit(_run_from_file, path, light, what, batch)

            try:
                for number, result in in_batches(submit, self.n_workers, task, missing):
                    yield number, result
                    del missing[number]
            except BrokenProcessPool as error:
                self._end()
                losses += 1
                if losses > _MOST_LOSSES:
                    raise WorkersLostError(
                        f"worker processes ended {losses} times without an answer, most likely for want of memory;"
                        f" use fewer than {self.n_workers} workers"
                    ) from error

    def _written(self, shared: Any) -> tuple[str, Package]:
        """The file with the package of `shared`, and the package without its content; made once for the same object."""
        if self._last is None or self._last[0] is not shared:
            if self._folder is None:
                self._folder = tempfile.TemporaryDirectory(prefix="structid-")
            package = packed(shared, self.place, self.parts)
            path = Path(self._folder.name) / f"{package.digest}.package"
            path.write_bytes(package.content)
            light = Package(b"", package.digest, package.place, package.version)
            self._last = shared, str(path), light
        return self._last[1:]

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self.n_workers, get_context("spawn"), _quiet)
        return self._pool

    def close(self) -> None:
        """End the processes; tasks that have not begun are dropped."""
        self._end()
        self._last = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _quiet() -> None:
    """Ctrl-C is for the process that sends the tasks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_from_file(path: str, light: Package, task: Task, batch: Batch) -> tuple[list[tuple[int, Any]], float]:
    return run_batch(_from_file(path, light), task, batch)


def _from_file(path: str, light: Package) -> Package:
    """The package with its content, which is read once."""
    content = b"" if is_known(light.digest) else Path(path).read_bytes()
    return Package(content, light.digest, light.place, light.version)

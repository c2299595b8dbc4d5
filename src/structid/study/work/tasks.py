"""Repeated tasks on this process, on processes of this machine, or on a Dask cluster: the same answer from each.

A task is a function of a module, what all tasks share, and a small item. Tasks are sent in batches that take about
a quarter of a second; a task whose worker is lost runs again; results are put in the order of the items. Every task
runs on one thread, wherever it runs, so that sums are taken in the same order.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Protocol

from structid.errors import StructidError
from structid.estimation.search.work import PLAIN_TOOLS, Task, Tools
from structid.study.work.parts import Package, unpacked

#: Wall time of a batch, s: an answer costs some milliseconds on its way.
BATCH_SECONDS = 0.25
#: Messages under way for each worker, and the work that they should hold, s: an answer's way is then no wait.
_LEAST_AHEAD, _MOST_AHEAD, _COVERED_SECONDS = 2, 8, 0.05
_PATIENCE = 5.0
_POOLS_SECONDS = 1.0

Batch = tuple[tuple[int, Any], ...]
#: Sends a batch of tasks; its result is the numbered results and the seconds that they took.
Submit = Callable[[Task, Batch], "Future[tuple[list[tuple[int, Any]], float]]"]


class WorkersLostError(StructidError):
    """Workers ended again and again without an answer, or cannot be reached any more; what was done is kept."""


class Executor(Protocol):
    """Where tasks run."""

    @property
    def n_workers(self) -> int: ...

    @property
    def words(self) -> str:
        """What it is, as reports say it."""
        ...

    def known(self, parts: Sequence[object]) -> None:
        """Name the parts of the study that workers make themselves."""
        ...

    def completed(
        self, task: Task, shared: Any, items: Mapping[int, Any], tools: Callable[[int], Tools]
    ) -> Iterator[tuple[int, Any]]:
        """Number and result of each item, as they come.

        Parameters
        ----------
        task : Task
        shared : object
        items : mapping of int to object
        tools : callable
            Of a task that runs in this process, by its number.

        Raises
        ------
        WorkersLostError
        """
        ...

    def close(self) -> None: ...


class InProcess:
    """Tasks one after another in this process."""

    n_workers = 1
    words = "this process"

    def known(self, parts: Sequence[object]) -> None:
        """Nothing is sent."""

    def completed(
        self, task: Task, shared: Any, items: Mapping[int, Any], tools: Callable[[int], Tools]
    ) -> Iterator[tuple[int, Any]]:
        for number, item in items.items():
            with one_thread():
                result = task(shared, item, tools(number))
            yield number, result

    def close(self) -> None:
        """Nothing to close."""


@contextmanager
def one_thread() -> Iterator[None]:
    """BLAS, MKL, OpenMP, numba and the factorizers with one thread."""
    from structid.dynamics.factorization import THREADS_VARIABLE

    numba = sys.modules.get("numba")
    before, variable = numba.get_num_threads() if numba else 1, os.environ.get(THREADS_VARIABLE)
    os.environ[THREADS_VARIABLE] = "1"
    try:
        if numba:
            numba.set_num_threads(1)
        with _pools(len(sys.modules), int(time.monotonic() / _POOLS_SECONDS)).limit(limits=1):
            yield
    finally:
        if numba:
            numba.set_num_threads(before)
        if variable is None:
            os.environ.pop(THREADS_VARIABLE, None)
        else:
            os.environ[THREADS_VARIABLE] = variable


@lru_cache(maxsize=1)
def _pools(n_modules: int, second: int) -> Any:
    """The controller of the libraries loaded now; to find them takes 1.5 ms, so it is kept for a second or a module."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def run_batch(package: Package, task: Task, batch: Batch) -> tuple[list[tuple[int, Any]], float]:
    """The results of a batch on a worker, numbered, and the seconds that the tasks took."""
    shared, results = unpacked(package), []
    begun = time.perf_counter()
    with one_thread():
        for number, item in batch:
            results.append((number, task(shared, item, PLAIN_TOOLS)))
    return results, time.perf_counter() - begun


def in_batches(
    submit: Submit,
    n_workers: int,
    task: Task,
    items: Mapping[int, Any],
    require_alive: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Any]]:
    """Number and result of each item as batches come back; a batch takes about `BATCH_SECONDS`.

    The first batches are single tasks, one a worker, which show how long a task takes; so many are then under way that
    no worker waits for the next. `require_alive` is asked where nothing comes for some seconds.
    """
    waiting = iter(tuple(items.items()))
    pending: set[Future[tuple[list[tuple[int, Any]], float]]] = set()
    left, seconds, count, size = len(items), 0.0, 0, 1

    def send() -> None:
        batch = tuple(entry for _, entry in zip(range(size), waiting, strict=False))
        if batch:
            pending.add(submit(task, batch))

    for _ in range(n_workers):
        send()
    try:
        while pending:
            done, pending = wait(pending, timeout=_PATIENCE, return_when=FIRST_COMPLETED)
            if not done:
                require_alive()
                continue
            for future in done:
                results, taken = future.result()
                seconds, count, left = seconds + taken, count + len(results), left - len(results)
                yield from results
            each = max(seconds, 1e-9) / count
            fair = -(-left // (_LEAST_AHEAD * n_workers))
            size = max(1, min(int(BATCH_SECONDS / each), fair))
            ahead = min(max(_LEAST_AHEAD, int(_COVERED_SECONDS / (size * each))), _MOST_AHEAD)
            while len(pending) < ahead * n_workers:
                before = len(pending)
                send()
                if len(pending) == before:
                    break
    finally:
        for future in pending:
            future.cancel()

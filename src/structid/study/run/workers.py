"""Repeated tasks on this process, on processes of this machine, or on a Dask cluster: the same digits from each.

A task is a function of a module, what all tasks share, and a small item. What is shared goes to each worker once; tasks
follow in batches that take about a quarter of a second; a task whose worker is lost runs again. Every task runs on one
thread, wherever it runs, so that sums are taken in the same order.
"""

from __future__ import annotations

import os
import pickle
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from threadpoolctl import ThreadpoolController, threadpool_limits

from structid.core.errors import InputError, StructidError
from structid.dynamics.factorization import THREADS_VARIABLE
from structid.inversion import Problem
from structid.inversion.search.work import PLAIN_CONTEXT, Item, Shared, Task, TaskContext, TaskResult
from structid.study.run.piped import PipedProcesses, ProcessLostError

#: Wall time of a batch, s: an answer costs some milliseconds on its way.
BATCH_SECONDS = 0.25
#: Batches under way for each worker, so that none waits for the next.
AHEAD = 4
#: How many shared objects workers keep, and how often workers may be lost.
KEPT, MOST_LOSSES = 4, 5
_PATIENCE = 5.0
#: Entries of a Jacobian up to which a second thread costs more than it gains.
SMALL_JACOBIAN = 500_000

#: Numbered items or results.
Batch = list[tuple[int, Item]]
#: Numbered results and the seconds that they took.
Answer = tuple[Batch[TaskResult], float]
ToolsOf = Callable[[int], TaskContext]


class WorkersLostError(StructidError):
    """Workers ended again and again without an answer, or cannot be reached any more; what was done is kept."""


def no_tools(number: int) -> TaskContext:
    """Tools of tasks that make no search."""
    return PLAIN_CONTEXT


class Workers(ABC):
    """Executor of tasks: in this process, in processes, or on a cluster.

    Attributes
    ----------
    n_workers : int
        How many tasks run at once.
    words : str
        What it is, as reports say it.
    """

    n_workers: int
    words: str

    @abstractmethod
    def completed(
        self, task: Task[Shared, Item, TaskResult], shared: Shared, items: Mapping[int, Item], tools: ToolsOf = no_tools
    ) -> Iterator[tuple[int, TaskResult]]:
        """Number and result of each item, in the order in which they are ready.

        Parameters
        ----------
        task : Task
            Function called with `shared`, an item and its tools.
        shared : object
            First argument of all calls, sent to each worker once.
        items : mapping of int to object
            The items by their numbers.
        tools : callable
            Gives the tools of a task, by the number of its item; used only for tasks in this process.

        Raises
        ------
        WorkersLostError
            If the workers ended again and again, or cannot be reached.
        """

    def asked(self, question: Callable[[Shared], str], argument: Shared) -> Mapping[str, str]:
        """The answer of each worker on other machines to `question(argument)`, by the name of the worker.

        `question` must be a function of a module; {} without such workers.
        """
        return {}

    @abstractmethod
    def close(self) -> None:
        """End the processes or connections that these workers started."""


class InProcess(Workers):
    """Tasks one after another in this process."""

    n_workers = 1
    words = "this process"

    def completed(
        self, task: Task[Shared, Item, TaskResult], shared: Shared, items: Mapping[int, Item], tools: ToolsOf = no_tools
    ) -> Iterator[tuple[int, TaskResult]]:
        """Number and result of each item, computed one after another in this process, each on one thread.

        A result is `task(shared, item, tools(number))`. `items` are by number; `shared` is what all tasks need;
        `tools(number)` is the context of a task, with its minimizer and progress.
        """
        pools = ThreadpoolController()
        for count, (number, item) in enumerate(items.items()):
            if count == 1:
                pools = ThreadpoolController()  # with the libraries that the first task loaded
            with one_thread(pools):
                result = task(shared, item, tools(number))
            yield number, result

    def close(self) -> None:
        """Do nothing, since tasks in this process start no other."""


class RemoteWorkers(Workers):
    """Tasks on a `concurrent.futures.Executor`, whose workers are given what tasks share under a name.

    Attributes
    ----------
    losses : tuple of exception types
        What a lost worker shows as.
    """

    losses: tuple[type[BaseException], ...]

    def __init__(self) -> None:
        self._given: dict[str, object] = {}

    @staticmethod
    @abstractmethod
    def answer(name: str, task: Task[Shared, Item, TaskResult], batch: Batch[Item]) -> Answer[TaskResult]:
        """Result of a batch from a worker, which looks up by its name the data that its tasks share."""

    @abstractmethod
    def executor(self) -> Executor: ...

    @abstractmethod
    def give(self, content: bytes) -> str:
        """Let all workers have `content`, also those that come later; its name."""

    @abstractmethod
    def forget(self, name: str) -> None:
        """Release the shared data of this name, which no task asks for any more."""

    @abstractmethod
    def lost(self, error: BaseException, is_last: bool) -> None:
        """Make workers ready again after `error`, by which some of them were lost.

        Raises
        ------
        WorkersLostError
            If `is_last`, as no further loss is allowed, or the workers cannot be made ready.
        """

    def require_alive(self) -> None:
        """Refuse to wait for workers that are gone; asked where nothing comes for some seconds."""

    def completed(
        self, task: Task[Shared, Item, TaskResult], shared: Shared, items: Mapping[int, Item], tools: ToolsOf = no_tools
    ) -> Iterator[tuple[int, TaskResult]]:
        """Number and result of each item, computed on the workers, in the order in which they come back.

        A result is `task(shared, item, context)`. `items` are by number; `shared` is what all tasks need. `tools` is
        not used: workers have a plain context. Items of lost workers are sent again; `WorkersLostError` if workers are
        lost more than five times.
        """
        missing, name, losses = dict(items), self._name_of_shared(shared), 0
        while missing:
            try:
                send = partial(self._sent, name, task)
                for number, result in in_batches(send, self.n_workers, missing, self.require_alive):
                    yield number, result
                    del missing[number]
            except self.losses as error:
                losses += 1
                self.lost(error, losses > MOST_LOSSES)

    def _sent(self, name: str, task: Task[Shared, Item, TaskResult], batch: Batch[Item]) -> Future[Answer[TaskResult]]:
        return self.executor().submit(self.answer, name, task, batch)

    def _name_of_shared(self, shared: object) -> str:
        """The name under which workers have the object `shared`, which is pickled and sent to them if it is new.

        An object is known by its identity. The last four are kept; workers forget the oldest.
        """
        for name, sent in self._given.items():
            if sent is shared:
                return name
        while len(self._given) >= KEPT:
            oldest = next(iter(self._given))
            del self._given[oldest]
            self.forget(oldest)
        name = self.give(pickle.dumps(shared, protocol=5))
        self._given[name] = shared
        return name


class Processes(RemoteWorkers):
    """Processes of this machine.

    Parameters
    ----------
    n_workers : int

    Raises
    ------
    InputError
        If `n_workers` is less than 1.
    """

    losses = (ProcessLostError,)

    def __init__(self, n_workers: int) -> None:
        """A pool of `n_workers` processes of this machine, started when first needed; `InputError` without any."""
        super().__init__()
        if n_workers < 1:
            raise InputError(f"`workers` must be at least 1, got {n_workers}; one for each core is usual")
        self.n_workers, self.words = n_workers, f"{n_workers} processes of this machine"
        self._pool: PipedProcesses | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="structid-")

    @staticmethod
    def answer(name: str, task: Task[Shared, Item, TaskResult], batch: Batch[Item]) -> Answer[TaskResult]:
        return results(_read(name), task, batch)

    def executor(self) -> Executor:
        if self._pool is None:
            self._pool = PipedProcesses(self.n_workers, _use_one_thread)
        return self._pool

    def give(self, content: bytes) -> str:
        path = Path(self._folder.name) / uuid4().hex
        path.write_bytes(content)
        return str(path)

    def forget(self, name: str) -> None:
        Path(name).unlink()

    def lost(self, error: BaseException, is_last: bool) -> None:
        self._end()
        if is_last:
            raise WorkersLostError(
                f"worker processes ended {MOST_LOSSES + 1} times without an answer, most likely for want of memory;"
                f" use fewer than {self.n_workers} workers"
            ) from error

    def close(self) -> None:
        """End the processes and remove their temporary files; tasks that have not begun are dropped."""
        self._end()
        self._given.clear()
        self._folder.cleanup()

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


def _use_one_thread() -> None:
    """Keep this process of tasks to one thread, with the libraries that it has loaded and those that it loads later."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", THREADS_VARIABLE):
        os.environ[name] = "1"  # of libraries that come later
    threadpool_limits(1)


@lru_cache(maxsize=KEPT)
def _read(path: str) -> Any:
    """Unpickled content of a file, read once a process, which so keeps analyses from task to task."""
    return pickle.loads(Path(path).read_bytes())


def results(shared: Shared, task: Task[Shared, Item, TaskResult], batch: Batch[Item]) -> Answer[TaskResult]:
    """Number and result of each item of a batch, computed without tools, and the seconds that the batch took."""
    begun = time.perf_counter()
    outcomes = [(number, task(shared, item, PLAIN_CONTEXT)) for number, item in batch]
    return outcomes, time.perf_counter() - begun


@contextmanager
def one_thread(pools: ThreadpoolController) -> Iterator[None]:
    """Context manager: BLAS, MKL, OpenMP, numba and the factorizers use one thread each.

    `pools` controls the thread pools of the libraries that are loaded. The former numbers are restored at the end.
    """
    variable = os.environ.get(THREADS_VARIABLE)
    os.environ[THREADS_VARIABLE] = "1"
    try:
        with _limit_library_threads(pools):
            yield
    finally:
        if variable is None:
            os.environ.pop(THREADS_VARIABLE, None)
        else:
            os.environ[THREADS_VARIABLE] = variable


@contextmanager
def _limit_library_threads(pools: ThreadpoolController) -> Iterator[None]:
    """Context manager: numba and the thread pools of numerical libraries use one thread each, until the block ends.

    `pools` controls the libraries' pools; the former numbers of threads are restored.
    """
    numba = sys.modules.get("numba")
    before = numba.get_num_threads() if numba else 1
    try:
        if numba:
            numba.set_num_threads(1)
        with pools.limit(limits=1):
            yield
    finally:
        if numba:
            numba.set_num_threads(before)


def threads_for(problems: Sequence[Problem]) -> AbstractContextManager[None]:
    """Context manager: products with Jacobians use one thread if they are small, as more bring nothing."""
    size = sum(problem.n_data * len(problem.names) for problem in problems)
    return _limit_library_threads(ThreadpoolController()) if size <= SMALL_JACOBIAN else nullcontext()


def in_batches(
    send: Callable[[Batch[Item]], Future[Answer[TaskResult]]],
    n_workers: int,
    items: Mapping[int, Item],
    require_alive: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, TaskResult]]:
    """Number and result of each item of `items`, which are by number, in the order in which batches come back.

    The first batches are single items, which show how long one takes; later ones take about 0.25 s. `send` sends a
    batch to one of `n_workers` workers and returns its future; `require_alive` is called while nothing comes back, and
    raises if the workers are lost. Batches under way are cancelled at the end.
    """
    waiting, n_waiting = iter(tuple(items.items())), len(items)
    pending: set[Future[Answer[TaskResult]]] = set()
    seconds, count, size = 0.0, 0, 1
    try:
        while n_waiting or pending:
            while n_waiting and len(pending) < AHEAD * n_workers:
                batch = list(islice(waiting, size))
                n_waiting -= len(batch)
                pending.add(send(batch))
            done, pending = wait(pending, timeout=_PATIENCE, return_when=FIRST_COMPLETED)
            if not done:
                require_alive()
            for future in done:
                results, batch_seconds = future.result()
                seconds, count = seconds + batch_seconds, count + len(results)
                yield from results
            if count:
                fair = -(-n_waiting // (AHEAD * n_workers))
                size = max(1, min(int(BATCH_SECONDS * count / max(seconds, 1e-9)), fair))
    finally:
        for future in pending:
            future.cancel()

"""Tasks on an existing Dask cluster; needs the extra ``cluster``."""

from __future__ import annotations

import asyncio
import logging
import pickle
import socket
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Executor
from typing import Any
from uuid import uuid4

from distributed import Client, KilledWorker, Worker, WorkerPlugin, get_worker
from distributed.core import rpc
from threadpoolctl import ThreadpoolController

from structid.core.errors import InputError
from structid.inversion.search.work import Item, Shared, Task, TaskResult
from structid.study.run.workers import (
    Answer,
    Batch,
    RemoteWorkers,
    WorkersLostError,
    one_thread,
    results,
)

#: How long a scheduler may take to answer, and workers to be there, s.
ANSWER_SECONDS = 10.0
_GONE_SECONDS = 120.0


class Cluster(RemoteWorkers):
    """The workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        Of the scheduler, as in ``tcp://10.0.0.5:8786``.
    answer_seconds : float
        How long the scheduler may take to answer.

    Raises
    ------
    InputError
        If no scheduler or no worker answers in time, or a worker has no structid, another version of it, or of Python,
        NumPy or SciPy.
    """

    losses = (KilledWorker, CancelledError, OSError)

    def __init__(self, address: str, answer_seconds: float = ANSWER_SECONDS) -> None:
        """Connect to the Dask scheduler at `address`, such as ``tcp://10.0.0.5:8786``, and check its workers.

        The scheduler must answer within `answer_seconds`, and then have a worker within `answer_seconds` more.

        Raises
        ------
        InputError
            If no scheduler answers, it has no workers, or a worker has other versions than here of structid, Python,
            NumPy or SciPy.
        """
        super().__init__()
        self.address = address
        self._client = _connect(address, answer_seconds)
        try:
            _require_workers(self._client, address, answer_seconds)
        except BaseException:
            self.close()
            raise
        self.n_workers = sum(self._client.nthreads().values())
        self.words = f"{self.n_workers} workers of the Dask scheduler {address}"

    @staticmethod
    def answer(name: str, task: Task[Shared, Item, TaskResult], batch: Batch[Item]) -> Answer[TaskResult]:
        """Results of a batch of (number, item), with the numbers, and the seconds taken, on one thread of this worker.

        `task` is called with the shared object, which was sent to the worker under `name`, and each item.
        """
        plugin = get_worker().plugins[name]
        assert isinstance(plugin, _Shared)
        shared, pools = plugin.content_here()
        with one_thread(pools):
            return results(shared, task, batch)

    def executor(self) -> Executor:
        return self._client.get_executor(pure=False, retries=0)

    def give(self, content: bytes) -> str:
        name = f"structid-{uuid4().hex}"
        self._client.register_plugin(_Shared(content), name)
        return name

    def forget(self, name: str) -> None:
        self._client.unregister_worker_plugin(name)

    def asked(self, question: Callable[[Shared], str], argument: Shared) -> Mapping[str, str]:
        answers: dict[str, str] = self._client.run(question, argument)
        return {f"worker {worker}": answer for worker, answer in answers.items()}

    def lost(self, error: BaseException, is_last: bool) -> None:
        self.require_alive()
        if is_last or isinstance(error, KilledWorker):
            raise WorkersLostError(
                f"scheduler {self.address}: workers were lost again and again while they ran a task, most likely"
                f" for want of memory ({error}); give workers more memory, or fewer threads each"
            ) from error

    def require_alive(self) -> None:
        """Wait until the scheduler has a worker, at most 120 s.

        Raises
        ------
        WorkersLostError
            If the connection to the scheduler is lost, or no worker comes in this time.
        """
        if self._client.status != "running":
            raise WorkersLostError(
                f"scheduler {self.address}: the connection was lost; what was done is kept: start the scheduler again"
                " and go on with --resume"
            )
        start = time.monotonic()
        while not self._client.nthreads():
            if time.monotonic() - start > _GONE_SECONDS:
                raise WorkersLostError(
                    f"scheduler {self.address}: has had no worker for {_GONE_SECONDS:g} s; what was done is kept: start"
                    " workers and go on with --resume"
                )
            time.sleep(0.5)

    def close(self) -> None:
        """Disconnect from the cluster, which keeps running without this process.

        Its workers forget the shared objects that were sent to them.
        """
        logger = logging.getLogger("distributed")
        level = logger.level
        logger.setLevel(logging.CRITICAL)  # a scheduler that is gone is told in our words, not by its traceback as well
        try:
            if self._client.status == "running":
                for name in self._given:
                    self.forget(name)
            self._given.clear()
            self._client.close(timeout=2)
        finally:
            logger.setLevel(level)


class _Shared(WorkerPlugin):
    """Pickled data that tasks share on every worker; each thread unpickles a copy, since factorizations are not shared.

    Parameters
    ----------
    content : bytes
    """

    def __init__(self, content: bytes) -> None:
        self.content = content

    def setup(self, worker: Worker) -> None:
        self.here = threading.local()

    def content_here(self) -> tuple[Any, ThreadpoolController]:
        """The shared object, unpickled once for each thread, and a controller of the thread pools that were loaded with it."""
        if not hasattr(self.here, "made"):
            self.here.made = pickle.loads(self.content), ThreadpoolController()
        content: tuple[Any, ThreadpoolController] = self.here.made
        return content


def _connect(address: str, seconds: float) -> Client:
    """A client of the scheduler at `address`; `InputError` if nothing, or something else, answers within `seconds`."""
    remedy = "check the address, the port and the firewall, and that `dask scheduler` runs there"
    try:
        kind = asyncio.run(asyncio.wait_for(_kind(address), seconds))
        if kind == "Scheduler":
            return Client(address, timeout=seconds, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = str(error).splitlines()[0] if str(error) else _why_silent(address)
        raise InputError(f"scheduler {address}: does not answer within {seconds:g} s ({why}); {remedy}") from error
    raise InputError(f"scheduler {address}: is a {kind.lower()}, not a scheduler; give the scheduler's address")


async def _kind(address: str) -> str:
    """Kind of process that answers at the address: Scheduler, Worker or Nanny."""
    async with rpc(address) as there:
        return str((await there.identity())["type"])


def _why_silent(address: str) -> str:
    """The reason, as text, why an address did not answer in time: nothing listens there, or it is no scheduler."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=2.0):
            return "it is there, but does not speak as one"
    except (OSError, ValueError) as error:
        return f"nobody is there: {error}"


def _require_workers(client: Client, address: str, seconds: float) -> None:
    """Raise `InputError` if the scheduler has no worker after `seconds`, or workers with other versions of the packages.

    `address` is that of the scheduler, for the message. Equal versions keep the digits of results equal.
    """
    try:
        client.wait_for_workers(1, timeout=seconds)
    except TimeoutError as error:
        raise InputError(
            f"scheduler {address}: has no worker after {seconds:g} s; start some with `dask worker {address}`"
        ) from error
    versions: Any = client.get_versions(packages=["structid", "scipy"])
    here = _versions(versions["client"])
    for worker, on_worker in versions["workers"].items():
        for name, version in _versions(on_worker).items():
            if version is None:
                raise InputError(
                    f"scheduler {address}: worker {worker} has no {name}; install {name} {here[name]} there"
                )
            if version != here[name]:
                raise InputError(
                    f"scheduler {address}: worker {worker} has {name} {version}, here it is {here[name]}; install the"
                    " same versions, so that the digits are the same"
                )


def _versions(versions_of: Mapping[str, Mapping[str, str]]) -> dict[str, str | None]:
    """Versions of Python and of the packages that decide about the digits of a result, by name; None if not installed."""
    python = ".".join(versions_of["host"]["python"].split(".")[:2])
    return {"Python": python, **{name: versions_of["packages"].get(name) for name in ("structid", "numpy", "scipy")}}

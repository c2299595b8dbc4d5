"""Tasks on an existing Dask cluster; needs the extra ``cluster``."""

from __future__ import annotations

import asyncio
import logging
import platform
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from structid._version import __version__
from structid.errors import FileError, InputError
from structid.estimation.search.work import Task, Tools
from structid.files import digest
from structid.study.work.parts import Package, PackageMissingError, StudyPlace, given, packed
from structid.study.work.tasks import Batch, WorkersLostError, in_batches, run_batch

#: How long a scheduler may take to answer, and workers to be there, s.
ANSWER_SECONDS = 10.0
_GONE_SECONDS = 120.0
_MOST_LOSSES = 5
_SMALL_BYTES = 200_000


class Cluster:
    """The workers of a Dask scheduler.

    A worker finds the study by its path where it sees the same files there, and gets the arrays otherwise.

    Parameters
    ----------
    address : str
        Of the scheduler, as in ``tcp://10.0.0.5:8786``.
    place : StudyPlace, optional
        Where workers find the study.
    parts : sequence of object
        What of it they make themselves.
    answer_seconds : float
        How long the scheduler may take to answer.

    Raises
    ------
    InputError
        If Dask is not installed, no scheduler or no worker answers in time, or a worker has no structid, another
        version of it, or of Python, NumPy or SciPy.
    """

    def __init__(
        self,
        address: str,
        place: StudyPlace | None = None,
        parts: Sequence[object] = (),
        answer_seconds: float = ANSWER_SECONDS,
    ) -> None:
        self.address, self.parts = address, parts
        self._last: tuple[Any, Package] | None = None
        self._client = _connected(address, answer_seconds)
        try:
            _require_workers(self._client, address, answer_seconds)
            _require_versions(self._client, address)
            missing = {} if place is None else self.asked(missing_input, place)
        except BaseException:
            self.close()
            raise
        unseen = {worker: what for worker, what in missing.items() if what}
        self.place = None if unseen else place
        self.n_workers = sum(self._client.nthreads().values())
        self.words = f"{self.n_workers} workers of the Dask scheduler {address}"
        if unseen:
            worker, what = next(iter(unseen.items()))
            self.words += f", which get the record sent ({what} on {worker})"

    def known(self, parts: Sequence[object]) -> None:
        """Name the parts of the study that workers make themselves."""
        self.parts, self._last = parts, None

    def asked(self, question: Callable[[Any], str], argument: Any) -> dict[str, str]:
        """The answer of a function of a module on every worker, by its address."""
        found: dict[str, str] = self._client.run(question, argument)
        return found

    def completed(
        self, task: Task, shared: Any, items: Mapping[int, Any], tools: Callable[[int], Tools]
    ) -> Iterator[tuple[int, Any]]:
        from distributed import KilledWorker

        missing, losses = dict(items), 0
        executor = self._client.get_executor(pure=False, retries=0)
        while missing:
            try:
                package = self._sent(shared)

                def submit(what: Task, batch: Batch, package: Package = package) -> Future[Any]:
                    found: Future[Any] = executor.submit(run_batch, package, what, batch)
                    return found

                for number, result in in_batches(submit, self.n_workers, task, missing, self._require_alive):
                    yield number, result
                    del missing[number]
            except PackageMissingError as error:
                losses, self._last = losses + 1, None
                if losses > _MOST_LOSSES:
                    raise WorkersLostError(
                        f"scheduler {self.address}: workers come and go faster than they get the study ({error}); start"
                        " them first, and go on with --resume"
                    ) from error
            except (KilledWorker, CancelledError, OSError) as error:
                losses, self._last = losses + 1, None
                self._require_alive()
                if losses > _MOST_LOSSES or isinstance(error, KilledWorker):
                    raise WorkersLostError(
                        f"scheduler {self.address}: workers were lost again and again while they ran a task, most likely"
                        f" for want of memory ({error}); give workers more memory, or fewer threads each"
                    ) from error

    def _sent(self, shared: Any) -> Package:
        """The package of `shared`, without its content if it is large, which all workers then have; made once.

        It does not travel as a result of Dask, which would keep one copy and run all tasks where that is.
        """
        if self._last is None or self._last[0] is not shared:
            package = packed(shared, self.place, self.parts)
            if len(package.content) > _SMALL_BYTES:
                self.asked(given, package)
                package = replace(package, content=b"")
            self._last = shared, package
        return self._last[1]

    def _require_alive(self) -> None:
        """Refuse to wait for a scheduler or for workers that are gone."""
        if self._client.status != "running":
            raise WorkersLostError(
                f"scheduler {self.address}: the connection was lost; what was done is kept: start the scheduler again"
                " and go on with --resume"
            )
        begun = time.monotonic()
        while not self._client.nthreads():
            if time.monotonic() - begun > _GONE_SECONDS:
                raise WorkersLostError(
                    f"scheduler {self.address}: has had no worker for {_GONE_SECONDS:g} s; what was done is kept: start"
                    " workers and go on with --resume"
                )
            time.sleep(0.5)

    def close(self) -> None:
        """Leave the cluster; it goes on without this process."""
        self._last = None
        told = logging.getLogger("distributed")
        before = told.level
        told.setLevel(logging.CRITICAL)  # a scheduler that is gone is told in our words, not by its traceback as well
        try:
            self._client.close(timeout=2)
        finally:
            told.setLevel(before)


def _connected(address: str, seconds: float) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            f"scheduler {address}: Dask is not installed ({error}); install it with `pip install structid[cluster]`"
        ) from error
    remedy = "check the address, the port and the firewall, and that `dask scheduler` runs there"
    try:
        kind = asyncio.run(asyncio.wait_for(_kind(address, seconds), seconds))
        if kind != "Scheduler":
            raise InputError(f"scheduler {address}: is a {kind.lower()}, not a scheduler; give the scheduler's address")
        return Client(address, timeout=seconds, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        why = str(error).splitlines()[0] if str(error) else _silence(address)
        raise InputError(f"scheduler {address}: does not answer within {seconds:g} s ({why}); {remedy}") from error


def _silence(address: str) -> str:
    """Why an address did not answer in time: nobody is there, or somebody who does not speak as a scheduler."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=2.0):
            return "it is there, but does not speak as one"
    except (OSError, ValueError) as error:
        return f"nobody is there: {error}"


async def _kind(address: str, seconds: float) -> str:
    """What answers at the address: Scheduler, Worker, Nanny. A client would wait for ever for what is none of these."""
    from distributed.comm import connect
    from distributed.security import Security

    comm = await connect(address, timeout=seconds, **Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        told = await comm.read()
    finally:
        comm.abort()
    return str(told["type"]) if isinstance(told, dict) and "type" in told else "stranger"


def _require_workers(client: Any, address: str, seconds: float) -> None:
    try:
        client.wait_for_workers(1, timeout=seconds)
    except TimeoutError as error:
        raise InputError(
            f"scheduler {address}: has no worker after {seconds:g} s; start some with `dask worker {address}`"
        ) from error


def _require_versions(client: Any, address: str) -> None:
    """Refuse workers whose digits may differ."""
    found = client.get_versions(packages=["structid"])["workers"]
    for worker, told in found.items():
        if told["packages"].get("structid") is None:
            raise InputError(
                f"scheduler {address}: worker {worker} has no structid; install structid {__version__} there"
            )
    own = versions()
    for worker, told in client.run(versions).items():
        for name, version in own.items():
            if told.get(name) != version:
                raise InputError(
                    f"scheduler {address}: worker {worker} has {name} {told.get(name)}, here it is {version}; install the"
                    " same versions, so that the digits are the same"
                )


def versions() -> dict[str, str]:
    """What decides about digits, by name: run here and on every worker."""
    return {
        "structid": __version__,
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "NumPy": np.__version__,
        "SciPy": scipy.__version__,
    }


def missing_input(place: StudyPlace) -> str:
    """Why this worker cannot take the study from its path; empty where it can."""
    from structid.study.schema.study import load_study

    try:
        path = Path(place.path)
        if dict(place.inputs).get(path.name) != digest(path):
            return f"{path} is another file"
        found = load_study(path).digests
    except FileError as error:
        return str(error).split(";")[0]
    except InputError as error:
        return str(error)
    other = [name for name, value in place.inputs if found.get(name) != value]
    return f"{other[0]} is another file" if other else ""

"""Worker processes: one that looks (scenes, records), one that thinks (checks, modes); begun when asked, ended when idle."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from typing import Any

from structid.study.run.piped import PipedProcesses, ProcessLostError
from structid.workbench.work.functions import answer_keeping_records

#: Workers idle for so long are ended, s.
IDLE_SECONDS = 120.0
_KEPT = 24
#: Part of the free memory that a worker may take.
_FREE_PART = 0.75
_THINKING = {
    "check",
    "modelled",
    "needs",
    "plan",
    "survey",
    "pick",
    "merge",
    "beside",
    "overview",
    "use",
    "predict",
    "exports",
}
_LOST = '{"error":"the process that worked on this was ended, by lack of memory or by hand; try again"}'


def limit_memory() -> None:
    """Limit the address space of this process to its present size and 75 % of the free memory; no effect on Windows.

    A file that needs more then raises `MemoryError`, which is reported.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    import psutil

    wanted = psutil.Process().memory_info().vms + int(_FREE_PART * psutil.virtual_memory().available)
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most))


class Workers:
    """Calls of `answer_keeping_records` in processes; the last answers are kept by the content that they belong to."""

    def __init__(self, root: str) -> None:
        """Worker processes for the folder at the path `root`; each is started at its first call."""
        self.root = root
        self._pools: dict[str, PipedProcesses] = {}
        self._used: dict[str, float] = {}
        self._busy: dict[str, int] = {"look": 0, "think": 0}
        self._answers: OrderedDict[tuple[str, ...], str] = OrderedDict()
        self._running: dict[tuple[str, ...], asyncio.Task[str]] = {}

    async def __call__(self, name: str, arguments: dict[str, Any], version: str = "") -> str:
        """JSON text that the worker function `name` answers to `arguments` (by name, without the folder).

        Equal calls that run at the same time are computed once. With a `version`, which stands for the content of the
        input files, answers without error are cached: the last 24, or 30 million characters.
        """
        key = (name, repr(sorted(arguments.items())), version)
        if version and key in self._answers:
            self._answers.move_to_end(key)
            return self._answers[key]
        if key not in self._running:
            self._running[key] = asyncio.create_task(self._called(name, arguments))
            self._running[key].add_done_callback(lambda _: self._running.pop(key, None))
        answer = await asyncio.shield(self._running[key])
        if version and not answer.startswith('{"error"'):
            self._answers[key] = answer
            while len(self._answers) > _KEPT or sum(map(len, self._answers.values())) > 30_000_000:
                self._answers.popitem(last=False)
        return answer

    async def _called(self, name: str, arguments: dict[str, Any]) -> str:
        """JSON text that the worker function `name` answers to `arguments` (by name), computed in its process.

        There is one process for functions that take long and one for all others. If the process is lost, an error as
        JSON; the next call starts a new process.
        """
        kind = "think" if name in _THINKING else "look"
        if kind not in self._pools:
            self._pools[kind] = PipedProcesses(1, limit_memory)
        pool = self._pools[kind]
        self._busy[kind] += 1
        try:
            return await asyncio.wrap_future(pool.submit(answer_keeping_records, name, self.root, arguments))
        except (ProcessLostError, asyncio.CancelledError):  # ended while it worked, or before its turn
            if self._pools.get(kind) is pool:
                self._pools.pop(kind).shutdown()
            return _LOST
        finally:
            self._busy[kind] -= 1
            self._used[kind] = time.monotonic()

    async def warm(self) -> None:
        """Start the worker process for scenes and records and its imports, unless it runs already."""
        if "look" not in self._pools:
            await self._called("warm", {})

    def end_idle(self) -> None:
        """End worker processes that have been idle for more than two minutes."""
        for kind in list(self._pools):
            if not self._busy[kind] and time.monotonic() - self._used.get(kind, 0.0) > IDLE_SECONDS:
                self._pools.pop(kind).shutdown()

    def close(self) -> None:
        """End all worker processes."""
        while self._pools:
            self._pools.popitem()[1].shutdown()

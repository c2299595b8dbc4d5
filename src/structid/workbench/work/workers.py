"""Worker processes: one that looks (scenes, records), one that thinks (checks, modes); begun when asked, ended when idle."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from typing import Any

from structid.study.run.piped import PipedProcesses, ProcessLostError
from structid.workbench.work.called import called_again

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
    """Let this process take most of the memory that is free now, so that a file that asks for more is refused in words."""
    try:
        import resource
    except ImportError:  # Windows
        return
    import psutil

    wanted = psutil.Process().memory_info().vms + int(_FREE_PART * psutil.virtual_memory().available)
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (wanted if most == resource.RLIM_INFINITY else min(wanted, most), most))


class Workers:
    """Calls of `called_again` in processes; the last answers are kept by the content that they belong to."""

    def __init__(self, root: str) -> None:
        """Worker processes for the folder `root`, started with the first question."""
        self.root = root
        self._pools: dict[str, PipedProcesses] = {}
        self._used: dict[str, float] = {}
        self._busy: dict[str, int] = {"look": 0, "think": 0}
        self._answers: OrderedDict[tuple[str, ...], str] = OrderedDict()
        self._running: dict[tuple[str, ...], asyncio.Task[str]] = {}

    async def __call__(self, name: str, arguments: dict[str, Any], version: str = "") -> str:
        """Answer of the worker function `name` as JSON; with a `version` of its input files, cached.

        `arguments` are those of the function by name.
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
        """Answer of the worker function `name` from its process; an error message if that process was lost.

        `arguments` are those of the function by name.
        """
        kind = "think" if name in _THINKING else "look"
        if kind not in self._pools:
            self._pools[kind] = PipedProcesses(1, limit_memory)
        pool = self._pools[kind]
        self._busy[kind] += 1
        try:
            return await asyncio.wrap_future(pool.submit(called_again, name, self.root, arguments))
        except (ProcessLostError, asyncio.CancelledError):  # ended while it worked, or before its turn
            if self._pools.get(kind) is pool:
                self._pools.pop(kind).shutdown()
            return _LOST
        finally:
            self._busy[kind] -= 1
            self._used[kind] = time.monotonic()

    async def warm(self) -> None:
        """Begin the worker that looks before it is asked, as its imports take longest."""
        if "look" not in self._pools:
            await self._called("warm", {})

    def end_idle(self) -> None:
        """End workers that nothing was asked of for a while."""
        for kind in list(self._pools):
            if not self._busy[kind] and time.monotonic() - self._used.get(kind, 0.0) > IDLE_SECONDS:
                self._pools.pop(kind).shutdown()

    def close(self) -> None:
        """End all worker processes."""
        while self._pools:
            self._pools.popitem()[1].shutdown()

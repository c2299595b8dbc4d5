"""How the workbench reads studies: without running the program that one of somebody else's may name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from structid.errors import InputError
from structid.estimation.search.work import Alone, StageProgress, Task
from structid.solver.runs import Solver


class Looking(Alone):
    """Work that refuses to run solvers; runs that are kept are read all the same."""

    def map(
        self,
        name: str,
        task: Task,
        shared: Any,
        items: Sequence[Any],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[Any]:
        """As `Work.map`, except for runs of a solver."""
        if isinstance(shared, Solver):
            raise InputError(
                f"[structure.solver] names a program that has yet to run {len(items)} times ({shared.command}), and looking at a"
                " study runs none: where you trust the study, start a run, or `structid check` in a terminal; both keep what"
                " the program gives"
            )
        return super().map(name, task, shared, items, progress, first)


LOOKING = Looking()

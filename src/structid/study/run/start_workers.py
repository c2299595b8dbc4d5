"""The workers that the options of a command ask for."""

from __future__ import annotations

from structid.core.errors import InputError
from structid.study.run.workers import InProcess, Processes, Workers


def start_workers(workers: int | None, scheduler: str | None) -> Workers | None:
    """The workers that the options ask for: a Dask cluster, processes of this machine, or this process for a single worker.

    `workers` is their number, `scheduler` the address of a Dask scheduler; None is returned where both are None.

    Raises
    ------
    InputError
        If both are given, the scheduler or its workers cannot be used, or there are less than one worker.
    """
    if scheduler is not None and workers is not None:
        raise InputError("`workers` must be left out with a scheduler, got both; give --workers or --scheduler")
    if scheduler is not None:
        try:
            from structid.study.run.cluster import Cluster
        except ImportError as error:
            raise InputError(
                f"scheduler {scheduler}: Dask is not installed ({error}); install it with `pip install structid[cluster]`"
            ) from error
        return Cluster(scheduler)
    if workers is None:
        return None
    return InProcess() if workers == 1 else Processes(workers)

"""Tasks on a Dask cluster of two processes on this machine, and on a pool of two, against one thread.

``python benchmarks/cluster.py``: lines of a 3-D solid and Monte-Carlo repeats, warm, wall times (medians), the overhead
of a task, and 400 repeats with one worker killed half-way, which must have the digits of one process.
``--repeats N`` and ``--size N`` make it smaller. Ratios need an idle machine: the load is printed beside them.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("STRUCTID_THREADS", "1")

import numpy as np

import structid as sid
from structid.estimation import Bootstrap, bootstrap
from structid.estimation.work import Tools
from structid.observation import response
from structid.study import tasks
from structid.study.long_run import LongRun
from structid.study.run import load_study, started
from structid.study.search import shared_parts
from structid.study.spread import SpreadLines
from structid.study.task_parts import StudyPlace
from structid.study.tasks import Executor, one_thread
from structid.study.tasks_cluster import Cluster
from structid.study.tasks_processes import Processes

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "study"))
from study_cases import write_chain

from mesh_cases import empty_record, group_unknowns, solid


def nothing(shared: None, item: int, tools: Tools) -> int:
    """The smallest task."""
    return item


def main() -> None:
    """Print the figures beside their bars."""
    from distributed import LocalCluster

    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--repeats", type=int, default=400, help="Monte-Carlo repeats")
    words.add_argument(
        "--size", type=int, default=7, help="elements along the short edges of the solid, which is three times as long"
    )
    words.add_argument("--lines", type=int, default=24)
    words.add_argument("--medians", type=int, default=5, help="runs behind each wall time")
    given = words.parse_args()
    begun = time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as folder,
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as made,
    ):
        path = write_chain(Path(folder))
        study = load_study(path)
        place = StudyPlace(str(path.resolve()), tuple(sorted(study.digests.items())))
        cluster, pool = Cluster(made.scheduler_address, place), Processes(2, place)
        print(f"two workers ready after {time.perf_counter() - begun:.1f} s; load {os.getloadavg()[0]:.1f}")
        overheads({"Dask": cluster, "pool": pool})
        lines(given.size, given.lines, given.medians, {"Dask": cluster, "pool": pool})
        problem = started(study).problems[0]
        repeats(problem, given.repeats, {"Dask": cluster, "pool": pool}, lambda: worker_ids(made))
        cluster.close()
        pool.close()


def worker_ids(made: object) -> list[int]:
    """Process numbers of the workers of this cluster."""
    return [worker.pid for worker in made.workers.values()]  # type: ignore[attr-defined]


def overheads(executors: dict[str, Executor]) -> None:
    """Wall time of the smallest task, one a message, with two workers that wait for it."""
    before, tasks.BATCH_SECONDS = tasks.BATCH_SECONDS, 0.0
    for name, executor in executors.items():
        for count in (20, 400):  # the first are to warm up
            begun, processor = time.perf_counter(), time.process_time()
            found = dict(executor.completed(nothing, None, dict(enumerate(range(count))), lambda _: Tools(None, None)))
            each, own = (time.perf_counter() - begun) / count, (time.process_time() - processor) / count
            assert len(found) == count
        words = f"{1e3 * own:.2f} ms of processor time here, the scheduler's included"
        print(f"{name}: overhead {1e3 * each:.2f} ms a task, wall time (bar: 5 ms); {words}")
    tasks.BATCH_SECONDS = before


def lines(size: int, n_lines: int, n_medians: int, executors: dict[str, Executor]) -> None:
    """Residual and Jacobian of a solid at some lines, in one thread and on two workers."""
    structure = solid((3 * size, size, size), (3.0, 1.0, 1.0), groups=8)
    unknown = sid.parameters(structure, group_unknowns(structure))
    record = empty_record(structure, np.linspace(10.0, 400.0, n_lines), 20)
    values = response(structure, unknown, record).values_at(unknown.start)
    problem = sid.FrfProblem(structure, unknown, replace(record, values=values), model_error=0.01)
    theta = problem.theta_start + 0.01
    print(f"solid: {structure.n_dofs} degrees of freedom, {n_lines} lines, {len(theta)} parameters")

    def alone() -> np.ndarray:
        with one_thread():
            return problem.linearize(theta).jacobian

    alone_seconds, jacobian = timed(alone, n_medians)
    print(f"  one thread: {alone_seconds:.2f} s")
    for name, executor in executors.items():
        known = executor.place, executor.parts  # type: ignore[attr-defined]
        executor.place = None  # type: ignore[attr-defined]
        executor.known(())
        spread = SpreadLines(problem, executor)
        spread.linearize(theta)
        seconds, found = timed(lambda spread=spread: spread.linearize(theta).jacobian, n_medians)  # type: ignore[misc]
        executor.place = known[0]  # type: ignore[attr-defined]
        same = "same digits" if np.array_equal(found, jacobian) else "OTHER DIGITS"
        print(f"  {name}, two workers: {seconds:.2f} s, {alone_seconds / seconds:.2f} times (bar: 1.4), {same}")


def repeats(
    problem: sid.FrfProblem, count: int, executors: dict[str, Executor], workers: Callable[[], list[int]]
) -> None:
    """Monte-Carlo repeats in one thread, on two workers, and on two of which one is killed half-way."""
    found = sid.estimate(problem)

    def run(work: LongRun) -> Bootstrap:
        work.known(shared_parts([problem]))
        return bootstrap(problem, found, "noise", count, np.random.default_rng(1), work)

    begun = time.perf_counter()
    alone = run(LongRun())
    alone_seconds = time.perf_counter() - begun
    print(f"{count} Monte-Carlo repeats, {len(alone.failures)} failed; one thread: {alone_seconds:.2f} s")
    for name, executor in executors.items():
        run(LongRun(executor))
        begun = time.perf_counter()
        there = run(LongRun(executor))
        seconds = time.perf_counter() - begun
        print(
            f"  {name}, two workers: {seconds:.2f} s, {alone_seconds / seconds:.2f} times (bar: 1.4), {same(alone, there)}"
        )
    killed: list[int] = []

    def kill(name: str, done: int, total: int) -> None:
        if done >= total // 2 and not killed:
            killed.append(workers()[0])
            os.kill(killed[0], signal.SIGKILL)

    begun = time.perf_counter()
    there = run(LongRun(executors["Dask"], progress=kill))
    seconds = time.perf_counter() - begun
    print(f"  Dask, one worker killed half-way: {seconds:.2f} s, {len(killed)} killed, {same(alone, there)}")
    print(f"load at the end {os.getloadavg()[0]:.1f}")


def same(one: Bootstrap, two: Bootstrap) -> str:
    return "same digits" if np.array_equal(one.values, two.values) else "OTHER DIGITS"


def timed(run: Callable[[], np.ndarray], times: int) -> tuple[float, np.ndarray]:
    """Median wall time of some runs, and the last result."""
    taken = []
    for _ in range(times):
        begun = time.perf_counter()
        result = run()
        taken.append(time.perf_counter() - begun)
    return median(taken), result


if __name__ == "__main__":
    main()

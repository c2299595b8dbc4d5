"""Tasks on a Dask cluster of two processes on this machine, and on a pool of two, against one thread.

``python benchmarks/cluster.py``: the overhead of a task, lines of a 3-D solid, Monte-Carlo repeats and stretches of a
record on disk, warm, wall times interleaved (medians), and repeats with one worker killed half-way; each must have the
digits of one process. ``--repeats N``, ``--size N`` and ``--quick`` make it smaller, ``--json PATH`` writes the table.
Ratios need an idle machine: the load is printed beside them. `cluster_end_to_end.py` is the same from the command line.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("STRUCTID_THREADS", "1")

import numpy as np
import psutil
from threadpoolctl import ThreadpoolController

import structid as sid
from structid.forward.frf.response import response
from structid.forward.motion.fit import RecursiveMotionFit, motion_fit
from structid.forward.motion.stream import motion_solution
from structid.inversion.intervals.bootstrap import Bootstrap, bootstrap
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.inversion.search.work import TaskContext
from structid.records.on_disk import open_record
from structid.study.run import workers as workers_module
from structid.study.run.cluster import Cluster
from structid.study.run.long_run import LongRun, SpreadLines
from structid.study.run.motion import MotionTaskData, reduced_alone, reduced_on
from structid.study.run.start import prepare_study
from structid.study.run.workers import InProcess, Processes, Workers, one_thread
from structid.study.schema.study import load_study

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "study"))
from mesh_cases import empty_record, group_unknowns, solid
from study_cases import write_chain
from time_domain_chain import written as write_motion_study

OVERHEAD, GAIN = 5.0, 1.4  # ms a task at most, times one thread at least
WAITING = 0.06  # s of a task that only waits
Row = dict[str, Any]


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    repeats: int = 400
    size: int = 7
    lines: int = 24
    medians: int = 5
    tasks: int = 400
    gigabytes: float = 1.0


QUICK = Sizes(repeats=120, size=6, lines=16, medians=3, tasks=100, gigabytes=0.3)


def nothing(shared: None, item: int, tools: TaskContext) -> int:
    """The smallest task."""
    return item


def waiting(shared: float, item: int, tools: TaskContext) -> int:
    """A task that takes its time and no processor."""
    time.sleep(shared)
    return item


def rows(quick: bool = False, sizes: Sizes | None = None) -> list[Row]:
    """The figures as rows of a table: what, bar, figure, met, detail."""
    from distributed import LocalCluster

    chosen = sizes or (QUICK if quick else Sizes())
    with (
        tempfile.TemporaryDirectory() as name,
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as made,
    ):
        folder = Path(name)
        path = write_chain(folder / "chain")
        study = load_study(path)
        executors = {"Dask": Cluster(made.scheduler_address), "pool": Processes(2)}
        try:
            found = overheads(executors, chosen.tasks)
            found += lines(chosen, executors)
            problem = prepare_study(study).problems[0]
            found += repeats(problem, chosen, executors)
            found += stretches(folder / "motion", chosen, executors)
            found += lost_worker(problem, chosen.repeats, executors["Dask"], lambda: worker_ids(made))
        finally:
            for executor in executors.values():
                executor.close()
    return found


def worker_ids(made: object) -> list[int]:
    """Process numbers of the workers of this cluster."""
    return [worker.pid for worker in made.workers.values()]  # type: ignore[attr-defined]


def row(what: str, bar: str, figure: str, met: bool, detail: str = "") -> Row:
    return {"what": what, "bar": bar, "figure": figure, "met": met, "detail": f"{detail}load {os.getloadavg()[0]:.1f}"}


def overheads(executors: Mapping[str, Workers], count: int) -> list[Row]:
    """Wall time of the smallest task, one a message, and what a task that waits takes more than its wait."""
    before, workers_module.BATCH_SECONDS = workers_module.BATCH_SECONDS, 0.0
    found = []
    for name, executor in executors.items():
        small, long = [], []
        for _ in range(4):  # the first to warm up
            small.append(1e3 * run_tasks(executor, nothing, None, count) / count)
            seconds = run_tasks(executor, waiting, WAITING, count // 5)
            long.append(1e3 * (executor.n_workers * seconds / (count // 5) - WAITING))
        for what, values in (("the smallest", small), (f"one of {1e3 * WAITING:.0f} ms", long)):
            figure = median(values[1:])
            bar = f"<= {OVERHEAD:g} ms"
            found.append(row(f"{name}: overhead of a task, {what}", bar, f"{figure:.2f} ms", figure <= OVERHEAD))
    workers_module.BATCH_SECONDS = before
    return found


def run_tasks(executor: Workers, task: Any, shared: Any, count: int) -> float:
    """Wall time of so many tasks."""
    begun = time.perf_counter()
    found = dict(executor.completed(task, shared, dict(enumerate(range(count)))))
    assert len(found) == count
    return time.perf_counter() - begun


def process_number(_: None) -> int:
    """Of the process that runs this."""
    return os.getpid()


def processes_of(executor: Workers) -> list[int]:
    """Process numbers of the workers."""
    remote = executor.asked(process_number, None).values()  # type: ignore[arg-type]
    if remote:
        return [int(number) for number in remote]
    run_tasks(executor, nothing, None, 4)
    return [child.pid or 0 for child in multiprocessing.active_children()]


def processor_seconds(numbers: Sequence[int]) -> np.ndarray:
    """Processor time of processes so far; 0 of one that ended."""
    found = []
    for number in numbers:
        try:
            times = psutil.Process(number).cpu_times()
            found.append(times.user + times.system)
        except psutil.NoSuchProcess:
            found.append(0.0)
    return np.array(found)


def gains(
    what: str,
    alone: Callable[[], Any],
    others: Mapping[str, Callable[[], Any]],
    same: Callable[[Any, Any], str],
    sizes: Sizes,
    executors: Mapping[str, Workers],
) -> list[Row]:
    """Wall time of one thread by that of two workers, in turn after one to warm up, the median of the ratios.

    Beside it the processor time of one thread by that of the busiest worker: the gain if nothing else ran.
    """
    numbers = {
        name: [os.getpid()] if name not in executors else processes_of(executors[name]) for name in ("", *others)
    }
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in numbers}
    answers: dict[str, Any] = {}
    for _ in range(sizes.medians + 1):
        for name, run in {"": alone, **others}.items():
            begun, before = time.perf_counter(), processor_seconds(numbers[name])
            answers[name] = run()
            busiest = float((processor_seconds(numbers[name]) - before).max())
            seconds[name].append((time.perf_counter() - begun, busiest))
    found = []
    for name in others:
        pairs = list(zip(seconds[""][1:], seconds[name][1:], strict=True))
        gain = median(one[0] / two[0] for one, two in pairs)
        busy = median(one[1] / two[1] if two[1] else float("nan") for one, two in pairs)
        walls = [median(entry[0] for entry in side) for side in zip(*pairs, strict=True)]
        said = same(answers[""], answers[name])
        detail = f"{busy:.2f} by processor time, {walls[0]:.2f} s and {walls[1]:.2f} s, {said}, "
        met = gain >= GAIN and said.startswith("same")
        found.append(row(f"{name}: {what}, two workers", f">= {GAIN:g}", f"{gain:.2f}", met, detail))
    return found


def lines(sizes: Sizes, executors: Mapping[str, Workers]) -> list[Row]:
    """Residual and Jacobian of a solid at some lines."""
    size = sizes.size
    structure = solid((3 * size, size, size), (3.0, 1.0, 1.0), groups=8)
    unknown = sid.parameters(structure, group_unknowns(structure))
    record = empty_record(structure, np.linspace(10.0, 400.0, sizes.lines), 20)
    values = response(structure, unknown, record).values_at(unknown.start)
    problem = sid.FrfProblem(structure, unknown, replace(record, values=values), model_error=0.01)
    theta = problem.theta_start + 0.01

    def alone() -> np.ndarray:
        with one_thread(ThreadpoolController()):
            return problem.linearize(theta).jacobian

    others = {}
    for name, executor in executors.items():
        spread = SpreadLines(problem, executor)
        others[name] = lambda own=spread: own.linearize(theta).jacobian
    what = f"{sizes.lines} lines of a solid of {structure.n_dofs} degrees of freedom"
    return gains(what, alone, others, same_digits, sizes, executors)


def refits(problem: sid.FrfProblem, count: int) -> Callable[[LongRun], Bootstrap]:
    found = sid.estimate(problem)

    def run(work: LongRun) -> Bootstrap:
        return bootstrap(problem, found, "noise", count, np.random.default_rng(1), work)

    return run


def repeats(problem: sid.FrfProblem, sizes: Sizes, executors: Mapping[str, Workers]) -> list[Row]:
    """Monte-Carlo repeats of a chain of three masses."""
    run = refits(problem, sizes.repeats)
    others = {name: (lambda own=executor: run(LongRun(own))) for name, executor in executors.items()}
    what = f"{sizes.repeats} Monte-Carlo repeats of a small chain"
    same = lambda one, two: same_digits(one.values, two.values)  # noqa: E731
    return gains(what, lambda: run(LongRun()), others, same, sizes, executors)


def stretches(folder: Path, sizes: Sizes, executors: Mapping[str, Workers]) -> list[Row]:
    """A record on disk reduced in one pass, and by stretches on workers."""
    folder.mkdir()
    write_motion_study(folder, 400, sizes.gigabytes, 0.01, 0)
    study = load_study(folder / "beam.toml")
    work = FoldingKernels("auto")
    whole = MotionTaskData(study.structure, study.parameters, (open_record(folder / "motion.h5"),), work, None)
    start = motion_fit(study.structure, study.parameters)

    def on(executor: Workers) -> RecursiveMotionFit:
        return reduced_on(executor, start, whole)

    reference = on(InProcess())

    def same(plain: RecursiveMotionFit, found: RecursiveMotionFit) -> str:
        one, two = (motion_solution(fit).values for fit in (plain, found))
        digits = same_digits(reference.state.triangles, found.state.triangles)
        return f"{digits} as one worker, {np.abs(two / one - 1).max():.0e} from one pass"

    others = {name: (lambda own=executor: on(own)) for name, executor in executors.items()}
    what = f"pass over {sizes.gigabytes:g} GB of motion of {study.structure.n_dofs} degrees of freedom"
    return gains(what, lambda: reduced_alone(start, whole), others, same, sizes, executors)


def lost_worker(problem: sid.FrfProblem, count: int, executor: Workers, workers: Callable[[], list[int]]) -> list[Row]:
    """Repeats on two workers of which one is killed half-way."""
    run, killed = refits(problem, count), []

    def kill(name: str, done: int, total: int) -> None:
        if done >= total // 2 and not killed:
            killed.append(workers()[0])
            os.kill(killed[0], signal.SIGKILL)

    alone = run(LongRun())
    begun = time.perf_counter()
    there = run(LongRun(executor, progress=kill))
    detail = f"{time.perf_counter() - begun:.1f} s, {len(killed)} killed, {len(alone.failures)} failed, "
    said = same_digits(alone.values, there.values)
    what = f"Dask: {count} repeats, one of two workers killed half-way"
    return [row(what, "same digits", said, said == "same digits" and bool(killed), detail)]


def same_digits(one: np.ndarray, two: np.ndarray) -> str:
    return "same digits" if np.array_equal(one, two) else "OTHER DIGITS"


def main() -> None:
    """Print the figures beside their bars."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--quick", action="store_true", help="small sizes")
    words.add_argument("--repeats", type=int, help="Monte-Carlo repeats")
    words.add_argument("--size", type=int, help="elements along the short edges of the solid, three times as long")
    words.add_argument("--lines", type=int)
    words.add_argument("--medians", type=int, help="runs behind each wall time")
    words.add_argument("--gigabytes", type=float, help="of motion")
    words.add_argument("--json", type=Path, metavar="PATH")
    given = vars(words.parse_args())
    base, path = (QUICK if given.pop("quick") else Sizes()), given.pop("json")
    found = rows(sizes=replace(base, **{name: value for name, value in given.items() if value is not None}))
    for entry in found:
        verdict = "met" if entry["met"] else "MISSED"
        print(f"{entry['what']}: {entry['figure']} (bar {entry['bar']}: {verdict}); {entry['detail']}")
    if path is not None:
        path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""A run that may take hours: its tasks on the workers that are asked for, its state in a checkpoint.

A checkpoint is a folder beside the results. Its files are written by renaming, so that it is whole at any instant: ``run.json``
(what it belongs to), ``done-*.npz`` (finished searches and tasks), ``search.npz`` (the running search after its last iteration)
and, after an interruption, ``so_far.json`` (the values reached, to read).
"""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal, NotRequired, TypedDict, cast

import numpy as np

from structid._version import __version__
from structid.core.arrays import FloatArray
from structid.core.errors import FileError, InputError
from structid.core.json_types import JsonValue, StoredEntry, json_text
from structid.files import atomic_write, claim, damage_told, make_folder, release
from structid.files.npy import npz_arrays
from structid.files.worker import fill_tree, plain
from structid.forward import FrfProblem
from structid.inversion import JointProblem, Linearization, Minimum, Problem, minimize
from structid.inversion.composed_problems import Wrapped
from structid.inversion.search.least_squares import Method, Progress, SearchStateStore, State
from structid.inversion.search.work import (
    Item,
    Shared,
    StageProgress,
    Task,
    TaskContext,
    TaskResult,
    restored_minimum,
    stored_minimum,
)
from structid.study.run.workers import InProcess, Processes, Workers
from structid.study.schema.study import Study

_LAYOUTS = "structid checkpoint "
_LAYOUT = f"{_LAYOUTS}2"
_RUN, _SEARCH, _SO_FAR = "run.json", "search.npz", "so_far.json"
_WHOLE, _ANEW = "a whole checkpoint", "run without --resume to begin anew"
_MOST_FILES = 64
#: Files of a checkpoint, and those that a killed run left half written.
_OWN = re.compile(r"(run\.json|search\.npz|so_far\.json|done-\d+\.npz)")
_HALF = re.compile(r"\.(run|search|so_far|done-\d+)\.structid-[0-9a-f]{12}\.(json|npz)")


class RunIdentity(TypedDict):
    """Layout of the checkpoint, versions of packages and digests of input files, the latter two by name.

    They decide about every digit of a run.
    """

    layout: str
    versions: dict[str, str]
    inputs: dict[str, str]


def checkpoint_folder(results: Path) -> Path:
    """Folder of the checkpoint of a run whose results go to the folder `results`."""
    return results.parent / f"{results.name}.checkpoint"


def fingerprint(study: Study) -> RunIdentity:
    """Description of the run of a study by which its checkpoint is recognized: layout, versions and digests of input files."""
    import scipy

    versions = {"structid": __version__, "numpy": np.__version__, "scipy": scipy.__version__}
    return {"layout": _LAYOUT, "versions": versions, "inputs": dict(study.digests)}


class Checkpoint:
    """Finished searches and tasks of a run by name, and the state of the search that runs.

    Parameters
    ----------
    folder : Path
    owner : RunIdentity
        The `fingerprint` of the study.
    resume : bool
        True to go on from what is there; otherwise it is removed.
    seconds : float
        At most one file in that time: what a killed run may have to do again. 0 writes every iteration and every task.

    Raises
    ------
    FileError
        If there is nothing to resume, it is damaged, it belongs to other input files or versions, or another process
        writes to it.
    """

    def __init__(self, folder: Path, owner: RunIdentity, resume: bool = False, seconds: float = 0.0) -> None:
        """Claim `folder` for the run that `owner` describes; read its entries with `resume`, else remove an old checkpoint.

        The checkpoint is written at most once in `seconds`.

        Raises
        ------
        FileError
            If another run has claimed the folder, it holds other files, or there is no checkpoint of this run to resume.
        """
        self.folder, self.owner, self.seconds = folder, owner, seconds
        self.entries: dict[str, Any] = {}
        self._search: tuple[str, State] | None = None
        self._latest: tuple[str, Callable[[], State]] | None = None
        self._unwritten: list[str] = []
        self._written = time.monotonic()
        self._files = 0
        self._is_made = False
        make_folder(folder.parent)
        claim(folder)
        try:
            if resume:
                self._read()
            elif folder.exists():
                _require_checkpoint(folder)
                _remove_own(folder)
        except BaseException:
            self.close()
            raise

    @property
    def n_found(self) -> int:
        """Number of finished searches and tasks."""
        return len(self.entries)

    def state_of(self, name: str) -> State | None:
        """State of the search `name` when the previous run ended; None where it had not begun or was finished."""
        return self._search[1] if self._search is not None and self._search[0] == name else None

    def finished(self, name: str, result: object) -> None:
        """Store the result of the search or task `name`, drop the state of a search under way, and write if due.

        Writing is due if `seconds` of this checkpoint have passed since the last time.
        """
        self.entries[name] = result
        self._unwritten.append(name)
        self._latest = None
        self._write_if_due()

    def running(self, name: str, state: Callable[[], State]) -> None:
        """Take note of the running search `name` and of `state`, which makes its state when called; write if it is due."""
        self._latest = name, state
        self._write_if_due()

    def write(self, so_far: Mapping[str, StoredEntry] | None = None) -> None:
        """Write all entries that are not written yet, and the state of the search under way.

        Entries go into a new file; after 64 files, all go into one. `so_far` are the values reached so far, by name; if
        given, they are written as JSON for people to read.

        Raises
        ------
        FileError
            If the disk is full, or the folder cannot be written.
        """
        self._make_folder()
        if self._unwritten:
            if self._files >= _MOST_FILES:
                self._write_all()
            else:
                self._files += 1
                _save(_part(self.folder, self._files), {name: self.entries[name] for name in self._unwritten})
            self._unwritten.clear()
        if self._latest is not None:
            name, state = self._latest
            _save(self.folder / _SEARCH, {"name": name, "state": dict(state())})
            self._latest = None
        if so_far is not None:
            _write_json(self.folder / _SO_FAR, so_far)
        self._written = time.monotonic()

    def close(self) -> None:
        """Give up the claim of this run on the folder, so that another run may have it; its files stay."""
        release(self.folder)

    def remove(self) -> None:
        """Remove the checkpoint and release its folder, after the run is complete; files of others in the folder stay."""
        with suppress(OSError):
            _remove_own(self.folder)
        self.close()

    def _write_if_due(self) -> None:
        if time.monotonic() - self._written >= self.seconds:
            self.write()

    def _make_folder(self) -> None:
        """Create the folder with the description of its run, unless this object has done so."""
        if not self._is_made:
            make_folder(self.folder)
            _write_json(self.folder / _RUN, cast(Mapping[str, StoredEntry], self.owner))
            self._is_made = True

    def _write_all(self) -> None:
        """Write all entries to one file, and remove the other files, which it replaces.

        The first file holds all entries before the others are removed, so that nothing is lost if the process ends between.
        """
        _save(_part(self.folder, 1), self.entries)
        for number in range(2, self._files + 1):
            _part(self.folder, number).unlink(missing_ok=True)
        self._files = 1

    def _read(self) -> None:
        """Read the entries and the state of an unfinished search that an earlier run wrote.

        Raises `FileError` if there are none, they are damaged, or they belong to another run.
        """
        if not (self.folder / _RUN).is_file():
            raise FileError(f"{self.folder}: there is no checkpoint to go on from; run without --resume")
        with damage_told(self.folder / _RUN, _WHOLE, _ANEW):
            owner = json.loads((self.folder / _RUN).read_text(encoding="utf-8"))
        _require_same_run(self.folder, self.owner, owner)
        for half in filter(lambda path: _HALF.fullmatch(path.name), list(self.folder.iterdir())):
            half.unlink(missing_ok=True)
        for path in sorted(self.folder.glob("done-*.npz")):
            self.entries.update(_load(path))
            self._files = int(path.stem.split("-")[1])
        if (self.folder / _SEARCH).is_file():
            search = _load(self.folder / _SEARCH)
            name, state = search.get("name"), search.get("state")
            if not isinstance(name, str) or not isinstance(state, dict):
                raise FileError(f"{self.folder / _SEARCH}: is not {_WHOLE} (no name and state); {_ANEW}")
            self._search = name, state


def _part(folder: Path, number: int) -> Path:
    return folder / f"done-{number:05d}.npz"


def _require_same_run(folder: Path, this_run: RunIdentity, owner: JsonValue) -> None:
    """Raise `FileError` if the checkpoint in `folder` is of another run, and name what differs: layout, an input or a version.

    `this_run` describes the present run, `owner` is the description read from the checkpoint.
    """
    anew = f"put it back, or {_ANEW}"
    layout = owner.get("layout") if isinstance(owner, dict) else None
    if not isinstance(owner, dict) or not isinstance(layout, str) or not layout.startswith(_LAYOUTS):
        raise FileError(f"{folder}: is no checkpoint of this program; {anew}")
    if layout != _LAYOUT:
        raise FileError(f"{folder}: was written by another version of structid; {_ANEW}")
    inputs, versions = owner.get("inputs"), owner.get("versions")
    if not isinstance(inputs, dict) or not isinstance(versions, dict):
        raise FileError(f"{folder / _RUN}: is not {_WHOLE} (no inputs and versions); {_ANEW}")
    for name in sorted({*inputs, *this_run["inputs"]}):
        if inputs.get(name) != this_run["inputs"].get(name):
            raise FileError(f"{folder}: {name} has changed since this checkpoint was written; {anew}")
    for name, version in this_run["versions"].items():
        if versions.get(name) != version:
            raise FileError(
                f"{folder}: was written with {name} {versions.get(name)}, this is {version}, whose digits may"
                f" differ; install that version, or {_ANEW}"
            )


def _require_checkpoint(folder: Path) -> None:
    """Raise `FileError` if `folder` is a file, or holds any file that no checkpoint has and is not hidden."""
    if not folder.is_dir():
        raise FileError(f"{folder}: is a file where the checkpoint goes; move it, or give another --out")
    foreign = [p.name for p in folder.iterdir() if not _OWN.fullmatch(p.name) and not p.name.startswith(".")]
    if foreign:
        raise FileError(f"{folder}: holds {foreign[0]}, which is no checkpoint; move it, or give another --out")


def _remove_own(folder: Path) -> None:
    """Remove the files of the checkpoint in `folder`, if it exists, and the folder if nothing else is in it."""
    if not folder.is_dir():
        return
    for path in list(folder.iterdir()):
        if _OWN.fullmatch(path.name) or _HALF.fullmatch(path.name):
            path.unlink(missing_ok=True)
    with suppress(OSError):  # it holds files of others
        folder.rmdir()


def _write_json(path: Path, value: Mapping[str, StoredEntry]) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")


def _save(path: Path, tree: Mapping[str, StoredEntry]) -> None:
    """Write nested mappings and lists of numbers, texts and arrays to an NPZ file: the tree as JSON, arrays bit for bit."""
    arrays: list[np.ndarray] = []
    text = json.dumps(plain(tree, arrays))
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        named: dict[str, Any] = {f"a{k}": array for k, array in enumerate(arrays)}
        np.savez(stream, tree=np.array(text), **named)


def _load(path: Path) -> dict[str, StoredEntry]:
    """Nested mappings and lists of numbers, texts and arrays from the NPZ file at `path`, a part of a checkpoint.

    `FileError` if the file is damaged.
    """
    arrays = npz_arrays(path, _WHOLE, _ANEW)
    with damage_told(path, _WHOLE, _ANEW):
        entries = fill_tree(json.loads(str(arrays["tree"])), lambda number: arrays[f"a{number}"])
        if not isinstance(entries, dict):
            raise ValueError("it holds no entries by name")
        return entries


#: Called with what the tasks are, how many are done, and how many there are.
TaskProgress = Callable[[str, int, int], None]
#: Degrees of freedom times lines from which a sweep takes so long (about half a second) that it is worth sending.
WORTH_SENDING = 500_000
_MOST_BYTES = 256_000_000
_SEGMENTS_A_WORKER = 2


@dataclass
class Reached:
    """Name, iteration, sum of squares and free variables (n_params,) of the running search, for an interruption.

    `tasks` are words on the tasks in work, "" if there are none. Before the first iteration `cost` is NaN, and
    `problem` and `theta` are None.
    """

    search: str = ""
    iteration: int = 0
    cost: float = float("nan")
    problem: Problem | None = None
    theta: FloatArray | None = None
    tasks: str = ""

    @property
    def words(self) -> str:
        """Words on the state of the run: the tasks in work, or the search."""
        if self.tasks:
            return self.tasks
        return f"{self.search}, iteration {self.iteration}, sum of squares {self.cost:.5g}"

    def take(self, name: str, problem: Problem, minimum: Minimum) -> None:
        """Take over the end of the search `name` of `problem`, which has just finished or was stored before an interruption."""
        self.search, self.iteration, self.cost = name, len(minimum.costs) - 1, float(minimum.costs[-1])
        self.problem, self.theta = problem, minimum.theta

    def summary(self) -> dict[str, StoredEntry]:
        """The values reached so far, without uncertainty, as plain values for JSON.

        The keys are ``status``, ``search``, ``iteration``, ``sum_of_squares``, ``tasks`` while tasks run, and
        ``parameters`` (name, unit, value of each) from the first iteration on.
        """
        summary: dict[str, StoredEntry] = {"status": "interrupted", "search": self.search, "iteration": self.iteration}
        summary["sum_of_squares"] = self.cost
        if self.tasks:
            summary["tasks"] = self.tasks
        if self.problem is None or self.theta is None:
            return summary
        values = self.problem.physical(self.theta)
        rows = zip(self.problem.names, self.problem.unknowns.units, values.tolist(), strict=True)
        summary["parameters"] = [{"name": name, "unit": unit, "value": value} for name, unit, value in rows]
        return summary


class LongRun:
    """The `TaskExecutor` of a study: numbered searches and tasks, those done before an interruption taken from the checkpoint.

    Searches and tasks follow from the study alone, so that the n-th of a resumed run is the n-th of the one before.

    Parameters
    ----------
    workers : Workers, optional
        Where tasks run; in this process by default.
    checkpoint : Checkpoint, optional
        Keeps what is done.
    progress : callable, optional
        Called with the name of the tasks, how many are done, and how many there are.
    """

    def __init__(
        self,
        workers: Workers | None = None,
        checkpoint: Checkpoint | None = None,
        progress: TaskProgress | None = None,
    ) -> None:
        """A run on `workers` (by default in this process), with an optional checkpoint and a callback for finished tasks."""
        self.workers: Workers = workers or InProcess()
        self.checkpoint, self.progress = checkpoint, progress
        self.reached = Reached()
        self._searches: Counter[str] = Counter()
        self._keeper: _Keeper | None = None
        self._calls: Counter[str] = Counter()

    @property
    def n_workers(self) -> int:
        return self.workers.n_workers

    def minimize(
        self,
        problem: Problem,
        method: Method,
        theta: FloatArray | None = None,
        progress: Progress | None = None,
        scope: str = "",
    ) -> Minimum:
        """Minimum of a problem by the search `method`, continued from the checkpoint if it holds this search.

        A search that the checkpoint holds as finished is not repeated. Workers evaluate the lines of a large problem;
        within a task, whose name is `scope`, this process does. `theta` (n_params,) are the free variables at the
        start, by default the problem's.
        """
        self._searches[scope] += 1
        name = f"{scope}search {self._searches[scope]}"
        spread_problem = problem if scope else spread(problem, self.workers)
        checkpoint = self.checkpoint
        if checkpoint is None:
            return minimize(spread_problem, method, theta, progress, _Keeper(name, problem, self.reached, None))
        if name in checkpoint.entries:
            minimum = restored_minimum(problem, method, checkpoint.entries[name])
            self.reached.take(name, problem, minimum)
            return minimum
        minimum = minimize(spread_problem, method, theta, progress, _Keeper(name, problem, self.reached, checkpoint))
        self.reached.take(name, problem, minimum)
        checkpoint.finished(name, stored_minimum(minimum))
        return minimum

    def keeper(self, problem: Problem) -> SearchStateStore:
        """The store for the state of a new search of `problem` in this process.

        Searches are numbered in the order of calls. The search of the previous call counts as finished in the
        checkpoint.
        """
        checkpoint = self.checkpoint
        if self._keeper is not None and self._keeper.latest is not None and checkpoint is not None:
            checkpoint.finished(self._keeper.name, dict(self._keeper.latest()))
        self._searches[""] += 1
        self._keeper = _Keeper(f"search {self._searches['']}", problem, self.reached, checkpoint)
        return self._keeper

    def map(
        self,
        name: str,
        task: Task[Shared, Item, TaskResult],
        shared: Shared,
        items: Sequence[Item],
        progress: StageProgress | None = None,
        first: int = 0,
    ) -> list[TaskResult]:
        """Results of `task` for every item, in the order of `items`.

        Results that the checkpoint holds are not computed again. `task` is called with `shared`, an item, and a context
        for searches and progress. `name` says what the tasks are, and `first` is the index of `items[0]` if the items
        continue an earlier call.
        """
        self._calls[name] += first == 0
        call = f"{name} {self._calls[name]}"
        names = [f"{call}, {first + number + 1}" for number in range(len(items))]
        done = {} if self.checkpoint is None else self.checkpoint.entries
        results: dict[int, TaskResult] = {number: done[own] for number, own in enumerate(names) if own in done}
        missing = {number: item for number, item in enumerate(items) if number not in results}

        def tools(number: int) -> TaskContext:
            return TaskContext(partial(self.minimize, scope=f"{names[number]}, "), progress)

        self._tell(name, len(results), len(items))
        if missing:
            for number, result in self.workers.completed(task, shared, missing, tools):
                results[number] = result
                if self.checkpoint is not None:
                    self.checkpoint.finished(names[number], result)
                self._tell(name, len(results), len(items))
        self.reached.tasks = ""
        return [results[number] for number in range(len(items))]

    def _tell(self, name: str, done: int, total: int) -> None:
        self.reached.tasks = f"{name}, {done} of {total} done"
        if self.progress is not None and total > 1:
            self.progress(name, done, total)

    def so_far(self) -> dict[str, StoredEntry]:
        """Content of ``so_far.json``: the keys of `Reached.summary`, and ``finished_searches_and_tasks``, their number."""
        done = 0 if self.checkpoint is None else self.checkpoint.n_found
        return {**self.reached.summary(), "finished_searches_and_tasks": done}

    def close(self) -> None:
        """End the processes or the connection of the workers of this run."""
        self.workers.close()


@dataclass(eq=False)
class _Keeper:
    """The `SearchStateStore` of one search."""

    name: str
    problem: Problem
    reached: Reached
    checkpoint: Checkpoint | None
    latest: Callable[[], State] | None = None

    @property
    def state(self) -> State | None:
        """State from which the search of this store continues; None to start anew.

        It is the last state if the search has finished, else the one stored while it was under way.
        """
        if self.checkpoint is None:
            return None
        ended: State | None = self.checkpoint.entries.get(self.name)
        return ended if ended is not None else self.checkpoint.state_of(self.name)

    def keep(self, iteration: int, cost: float, state: Callable[[], State]) -> None:
        """Record the iteration, sum of squares `cost` and state that the search has reached, for reports and the checkpoint.

        `state` makes the state when called; its entry ``theta`` holds the free variables.
        """
        self.latest = state
        reached = self.reached
        reached.search, reached.iteration, reached.cost, reached.problem = self.name, iteration, cost, self.problem
        reached.theta = state()["theta"]
        if self.checkpoint is not None:
            self.checkpoint.running(self.name, state)


@dataclass(frozen=True, eq=False)
class LineSegments:
    """Problems on segments of the lines of `problem`, each made when it is first asked for and kept in `made`."""

    problem: FrfProblem
    made: dict[tuple[int, int], FrfProblem] = field(default_factory=dict)

    def at(self, first: int, last: int) -> FrfProblem:
        if (first, last) not in self.made:
            self.made[first, last] = self.problem.with_lines(np.arange(first, last))
        return self.made[first, last]


@dataclass(frozen=True, eq=False)
class SpreadLines(Wrapped):
    """Problem with the residual and Jacobian of `problem`, computed by workers.

    Parameters
    ----------
    problem : FrfProblem
    workers : Workers
    """

    problem: FrfProblem
    workers: Workers

    @cached_property
    def segments(self) -> LineSegments:
        return LineSegments(self.problem)

    def residual(self, theta: FloatArray) -> FloatArray:
        return _join_parts("residual", self._evaluate_parts(theta, False))

    def linearize(self, theta: FloatArray) -> Linearization:
        parts = self._evaluate_parts(theta, True)
        return Linearization(_join_parts("residual", parts), _join_parts("jacobian", parts))

    def _evaluate_parts(self, theta: FloatArray, with_jacobian: bool) -> list[_Lines]:
        """Residual, and Jacobian if `with_jacobian`, of each segment of adjacent lines, evaluated on workers.

        The list is in the order of frequency. `theta` (n_params,) are the free variables. A residual is (n,), a
        Jacobian (n, n_params).
        """
        n_lines = len(self.problem.record.frequency)
        count = min(n_lines, _SEGMENTS_A_WORKER * self.workers.n_workers)
        ends = np.linspace(0, n_lines, count + 1).astype(int).tolist()
        items = {k: (ends[k], ends[k + 1], theta, with_jacobian) for k in range(count)}
        part_of = dict(self.workers.completed(evaluate_segment, self.segments, items))
        return [part_of[k] for k in range(count)]


class _Lines(TypedDict):
    """Residual (n,), and Jacobian (n, n_params) where it is wanted, of some lines; the first `n_data` rows are data."""

    residual: FloatArray
    jacobian: NotRequired[FloatArray]
    n_data: int


def _join_parts(name: Literal["residual", "jacobian"], segment_results: list[_Lines]) -> FloatArray:
    """Residual (n_data,) or Jacobian (n_data, n_params) of all lines, joined from those of segments in frequency order.

    The rows are real parts of all segments, imaginary parts of all segments, then the rows of the priors, taken from
    the last one.
    """
    real, imaginary = [], []
    for segment_result in segment_results:
        rows, half = segment_result[name], segment_result["n_data"] // 2
        real.append(rows[:half])
        imaginary.append(rows[half : 2 * half])
    return np.concatenate([*real, *imaginary, segment_results[-1][name][2 * half :]])


def evaluate_segment(segments: LineSegments, item: tuple[int, int, FloatArray, bool], _: TaskContext) -> _Lines:
    """Residual, and Jacobian if asked for, of one segment of lines, as a task for workers.

    `item` is (first line, line after the last, free variables, with_jacobian). The result has ``residual``, ``n_data`` (the
    rows that are data and not priors) and perhaps ``jacobian``.
    """
    first, last, theta, with_jacobian = item
    part = segments.at(first, last)
    if not with_jacobian:
        return {"residual": part.residual(theta), "n_data": part.n_data}
    linearization = part.linearize(theta)
    return {"residual": linearization.residual, "jacobian": linearization.jacobian, "n_data": part.n_data}


def spread(problem: Problem, workers: Workers) -> Problem:
    """The problem with the lines of its large FRF problems evaluated on workers; unchanged if that does not pay.

    It does not with one worker, a small model, degrees of freedom times lines below 500 000, or a Jacobian above 256
    MB.
    """
    if workers.n_workers < 2:
        return problem
    if isinstance(problem, JointProblem):
        members = tuple(spread(member, workers) for member in problem.problems)
        changed = any(new is not old for new, old in zip(members, problem.problems, strict=True))
        return replace(problem, problems=members) if changed else problem
    if not isinstance(problem, FrfProblem) or problem.structure.n_dofs * len(problem.record.frequency) < WORTH_SENDING:
        return problem
    if 8 * problem.n_data * len(problem.names) > _MOST_BYTES or not problem.model.is_large:
        return problem
    return SpreadLines(problem, workers)


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

"""A study identified from the motion of every degree of freedom, its record read from disk by chunks."""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry, json_text
from structid.fem import Structure
from structid.forward.motion.fit import RecursiveMotionFit, motion_fit
from structid.forward.motion.stream import (
    FitKeeper,
    MotionSolution,
    Progress,
    RecordRows,
    load_motion_fit,
    motion_solution,
    record_rows,
    reduced_by_chunks,
)
from structid.inversion import Status
from structid.inversion.regression.local_reduction import FoldingKernels, has_numba
from structid.inversion.search.work import TaskContext
from structid.records.on_disk import OnDiskRecord, open_record
from structid.study.run.long_run import start_workers
from structid.study.run.workers import Workers
from structid.study.schema.study import Study, load_study
from structid.unknowns import Parameters

#: The files of `write_motion`.
MOTION_SUMMARY, MOTION_TABLE = "motion.json", "parameters.csv"
#: A segment holds so many bytes at least, is so many times as large as what comes back, and there are at most so many.
SEGMENT_BYTES, _TIMES_THE_ANSWER, _MOST_SEGMENTS = 64_000_000, 5, 64

#: Number of a record, and the first and the last of its samples.
Segment = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MotionOptions:
    """Options of how `structid motion` works through the record.

    Parameters
    ----------
    work : FoldingKernels
    chunk : int, optional
        Samples a chunk.
    checkpoint : Path, optional
        Where the state is kept now and then, and taken up from.
    workers : int, optional
        Processes that reduce segments of the records; by default this one takes one chunk after the other.
    scheduler : str, optional
        Address of a Dask cluster that reduces them instead.
    """

    work: FoldingKernels = FoldingKernels()  # noqa: RUF009  frozen
    chunk: int | None = None
    checkpoint: Path | None = None
    workers: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True, eq=False)
class MotionResult:
    """Parameters that the motion of a study determines, with their uncertainty.

    Attributes
    ----------
    study : Study
    records : tuple of OnDiskRecord
    solution : MotionSolution
    seconds : mapping of str to float
        Wall time of reading the study, of the pass over the record, and of the solution.
    peak_memory : int
        Bytes of the whole process so far, without those of workers; 0 where the system does not tell.
    where : str
        What reduced the records.
    """

    study: Study
    records: tuple[OnDiskRecord, ...]
    solution: MotionSolution
    seconds: Mapping[str, float]
    peak_memory: int
    where: str = "this process"

    @property
    def record_bytes(self) -> int:
        """Size of the files of all records, in bytes."""
        return sum(record.path.stat().st_size for record in self.records)

    @property
    def is_determined(self) -> bool:
        return self.solution.status is Status.CONVERGED


def motion_of_study(path: Path, options: MotionOptions, progress: Progress | None = None) -> MotionResult:
    """Identify the parameters of the study at `path` from the motion of every degree of freedom.

    The result also has times (s), peak memory (bytes) and the workers. `progress`, if given, is called with the number
    of samples done and their total.

    Raises
    ------
    StudyError
        If the study has several records, or a key that is not used here, such as `modes` or `frf`; with the place in
        the file.
    InputError, FileError
        If the record lacks what the equations need, has gaps, or is cut off while it is read.
    """
    start = time.perf_counter()
    study = load_study(path)
    source = study.record
    if len(study.setups) > 1:
        raise source.section.error("identification from motion takes one [record]; name several files by `repeats`")
    for key in ("modes", "noise", "frf", "channel_error", "window_decay", "relabel", "channels_used"):
        if key in source.section.table:
            raise source.section.error("identification from motion does not use it; leave it out", key)
    with source.section.located("repeats" if len(source.paths) > 1 else "path"):
        records = tuple(open_record(path.resolve(), source.options) for path in source.paths)
        workers = start_workers(options.workers, options.scheduler)
        study_read = time.perf_counter()
        try:
            task_data = MotionTaskData(study.structure, study.parameters, records, options.work, options.chunk)
            fit = _reduce_records(task_data, workers, options.checkpoint, progress)
        finally:
            if workers is not None:
                workers.close()
        record_read = time.perf_counter()
        solution = motion_solution(fit, options.work)
    seconds = {
        "study": study_read - start,
        "record": record_read - study_read,
        "solution": time.perf_counter() - record_read,
    }
    where = "this process" if workers is None else workers.words
    return MotionResult(study, records, solution, seconds, peak_memory(), where)


def _reduce_records(
    task_data: MotionTaskData, workers: Workers | None, checkpoint: Path | None, progress: Progress | None
) -> RecursiveMotionFit:
    """The fit of all records, reduced on `workers` or, if None, in this process.

    It continues from the file `checkpoint` if that exists, and writes it as samples are done. `progress` takes the
    samples done and their total.
    """
    fit = motion_fit(task_data.structure, task_data.unknown)
    if checkpoint is not None and checkpoint.exists():
        fit = load_motion_fit(checkpoint, fit)
    if workers is None:
        return reduced_alone(fit, task_data, checkpoint, progress)
    return reduced_on(workers, fit, task_data, checkpoint, progress)


def peak_memory() -> int:
    """Largest resident memory of this process so far, in bytes; 0 on Windows."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def write_motion(result: MotionResult, folder: Path) -> None:
    """Write motion.json, the table of parameters (CSV) and study.toml into the existing `folder`."""
    (folder / MOTION_SUMMARY).write_text(json_text(motion_summary(result)), encoding="utf-8")
    (folder / "study.toml").write_bytes(result.study.text.encode("utf-8"))
    solution = result.solution
    with (folder / MOTION_TABLE).open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["name", "unit", "value", "standard_deviation", "identified"])
        rows = zip(
            solution.names, solution.unknown.units, solution.values, solution.std, solution.identified, strict=True
        )
        for name, unit, value, std, identified in rows:
            table.writerow([name, unit, _number(value), _number(std), "yes" if identified else "no"])


def _number(value: float) -> str:
    return repr(float(value)) if math.isfinite(value) else ""


def motion_summary(result: MotionResult) -> dict[str, StoredEntry]:
    """The content of motion.json: the fit and its cost (samples, seconds, memory).

    The keys are ``title``, ``status``, ``message``, ``parameters`` and ``identified`` (numbers of them),
    ``degrees_of_freedom_of_the_structure``, ``samples``, ``equations``, ``rank``, ``condition``, ``residual_rms``, ``engine``,
    ``solver``, ``records``, ``record_bytes``, ``reduced_by``, ``seconds``, ``peak_memory_bytes`` and ``inputs``.
    """
    found, fit = result.solution, result.solution.fit
    return {
        "title": result.study.title,
        "status": found.status.name.lower(),
        "message": found.message,
        "parameters": len(found.values),
        "identified": int(found.identified.sum()),
        "degrees_of_freedom_of_the_structure": result.study.structure.n_dofs,
        "samples": found.n_samples,
        "equations": found.n_rows,
        "rank": fit.rank,
        "condition": fit.condition,
        "residual_rms": float(np.sqrt(fit.residual_variance)),
        "engine": found.engine,
        "solver": fit.method,
        "records": len(result.records),
        "record_bytes": result.record_bytes,
        "reduced_by": result.where,
        "seconds": dict(result.seconds),
        "peak_memory_bytes": result.peak_memory,
        "inputs": dict(result.study.digests),
    }


@dataclass(frozen=True, eq=False)
class MotionTaskData:
    """Structure, unknowns, records and kernels that all segments of a motion share.

    Attributes
    ----------
    structure : Structure
    unknown : Parameters
    records : tuple of OnDiskRecord
        With absolute paths, which every worker must see.
    work : FoldingKernels
        The same on every worker.
    longest : int or None
        Samples a chunk; None leaves it to the size of the record.
    """

    structure: Structure
    unknown: Parameters
    records: tuple[OnDiskRecord, ...]
    work: FoldingKernels
    longest: int | None

    @cached_property
    def start(self) -> RecursiveMotionFit:
        """The fit of structure and unknowns before any sample is added."""
        return motion_fit(self.structure, self.unknown)

    @cached_property
    def rows(self) -> tuple[RecordRows, ...]:
        """Rows of the least-squares problem of each record."""
        return tuple(record_rows(self.start.equations, self.structure, record) for record in self.records)


def segments(records: Sequence[OnDiskRecord], answer_bytes: int, done: int = 0) -> list[Segment]:
    """Segments of nearly equal length within each record that cover the samples after the first `done`, in order.

    Parameters
    ----------
    records : sequence of OnDiskRecord
        Records in the order in which they are reduced.
    answer_bytes : int
        Size of the result of one segment, in bytes; a record is only divided into segments of at least five times as
        much, and of 64 MB.
    done : int
        Number of samples, counted over all records, that are already reduced.

    Returns
    -------
    list of tuple
        Record number (from 0), first sample, and sample after the last; at most 64 a record, and at least one of each
        that is not done.
    """
    segments: list[Segment] = []
    before = 0
    for number, record in enumerate(records):
        size = 8 * len(record.channels) * record.n_times
        count = size // max(SEGMENT_BYTES, _TIMES_THE_ANSWER * answer_bytes)
        edges = np.linspace(0, record.n_times, min(max(count, 1), _MOST_SEGMENTS) + 1).astype(int).tolist()
        for first, last in pairwise(edges):
            if before + last > done:
                segments.append((number, max(first, done - before), last))
        before += record.n_times
    return segments


class ReducedSegment(TypedDict):
    """Sums of the least-squares problem over one segment, with the keys that `reduced_segment` describes."""

    triangles: FloatArray
    energy: FloatArray
    n_rows: int
    n_samples: int


def reduced_segment(task_data: MotionTaskData, item: Segment, tools: TaskContext) -> ReducedSegment:
    """Sums of the least-squares problem over one segment of a record, as a task for workers; `tools` is not used.

    `item` is (record number, first sample, sample after the last), from 0. In the result, ``triangles`` are the
    triangular factors of ``n_rows`` rows; ``energy`` (4 n_dofs,) has sums of squares over ``n_samples``: acceleration,
    velocity, displacement, force, as upper bounds where one of them comes from several channels.
    """
    number, first, last = item
    fit = task_data.start
    for chunk in task_data.records[number].chunks(first, last, task_data.longest):
        fit = task_data.rows[number].reduced(fit, chunk, task_data.work)
        del chunk  # before the next one is read
    return {
        "triangles": fit.state.triangles,
        "energy": fit.energy,
        "n_rows": fit.state.n_rows,
        "n_samples": last - first,
    }


def reduced_on(
    workers: Workers,
    fit: RecursiveMotionFit,
    task_data: MotionTaskData,
    checkpoint: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RecursiveMotionFit:
    """The fit `fit` extended by all remaining samples of the records, which `workers` reduce.

    Parameters
    ----------
    workers : Workers
        Workers that see the records by the same paths.
    fit : RecursiveMotionFit
        Fit to continue; its number of samples says where.
    task_data : MotionTaskData
        Structure, unknowns, records and kernels.
    checkpoint : Path, optional
        File that keeps the fit of what was merged so far.
    progress : callable, optional
        Called with the number of samples done and their total.

    Raises
    ------
    InputError, FileError
        If a worker does not see the records as they are here, or one of them cannot be read.
    WorkersLostError
        If the workers are gone; the checkpoint holds what was merged.
    """
    work = task_data.work
    total = sum(record.n_times for record in task_data.records)
    compiled = work.compiled(total * len(fit.state.columns)) and len(fit.state.columns) == fit.equations.n_dofs
    task_data = replace(task_data, work=FoldingKernels("numba" if compiled else "numpy", work.threads))
    _require_records(workers, task_data)
    items = dict(enumerate(segments(task_data.records, fit.state.triangles.nbytes, fit.n_samples)))
    early: dict[int, ReducedSegment] = {}
    turn, keeper = 0, FitKeeper(checkpoint)
    try:
        for number, result in workers.completed(reduced_segment, task_data, items):
            early[number] = result
            while turn in early:
                fit, turn = _merge_fits(fit, early.pop(turn)), turn + 1
                keeper.offer(fit)
                if progress is not None:
                    progress(fit.n_samples, total)
    finally:
        keeper.close(fit)
    return fit


def reduced_alone(
    fit: RecursiveMotionFit, task_data: MotionTaskData, checkpoint: Path | None = None, progress: Progress | None = None
) -> RecursiveMotionFit:
    """The fit `fit` extended by all samples of the records that it lacks, reduced in this process, chunk after chunk.

    The fit is saved in the file `checkpoint` now and then and at any end, exceptions included; nothing is read from it.
    `progress` is called with the number of samples done, of all records, and their total.
    """
    ends = list(accumulate(record.n_times for record in task_data.records))

    def report(done: int, _: int) -> None:
        """Pass the number of samples done, and that of all records, to `progress` if there is one."""
        if progress is not None:
            progress(done, ends[-1])

    for record, end in zip(task_data.records, ends, strict=True):
        first = max(0, fit.n_samples - (end - record.n_times))
        if first < record.n_times:
            work, longest = task_data.work, task_data.longest
            fit = reduced_by_chunks(fit, task_data.structure, record, work, longest, checkpoint, report, first)
    return fit


def _merge_fits(fit: RecursiveMotionFit, part: ReducedSegment) -> RecursiveMotionFit:
    """The fit `fit` with the samples of one more segment; a fit without samples is replaced by that of the segment."""
    state = replace(fit.state, triangles=part["triangles"], n_rows=part["n_rows"])
    partial = replace(
        fit, state=state, energy=part["energy"], error=np.zeros_like(fit.error), n_samples=part["n_samples"]
    )
    return partial if fit.n_samples == 0 else fit.merged(partial)


def _require_records(workers: Workers, task_data: MotionTaskData) -> None:
    """Raise `InputError` if a worker does not see the records, or has another version of numba where numba is used."""
    wanted = tuple((str(record.path), record.path.stat().st_size) for record in task_data.records)
    for worker, trouble in workers.asked(unusable, (wanted, _numba_version(task_data.work.engine))).items():
        if trouble:
            raise InputError(f"{workers.words}: {worker}: {trouble}")


def unusable(wanted: tuple[tuple[tuple[str, int], ...], str]) -> str:
    """The reason why this worker cannot reduce the records; "" if it can.

    `wanted` is a tuple of (path, size in bytes) of each record as the main process sees it, then its version of numba, ""
    if numba is not used.
    """
    records, numba = wanted
    for name, size in records:
        path = Path(name)
        if not path.is_file():
            return f"{name}: there is no such file; put the record where all workers see it by the same path"
        if path.stat().st_size != size:
            return f"{name} has {path.stat().st_size} bytes there and {size} here; give workers the same file"
    if numba and numba != _numba_version("numba"):
        return (
            f"has numba {_numba_version('numba') or 'not installed'}, here it is {numba}; install the same there"
            " (structid[fast]), or take --engine numpy"
        )
    return ""


def _numba_version(engine: str) -> str:
    """Version of numba if `engine` is "numba" and it is installed, else ""."""
    if engine != "numba" or not has_numba():
        return ""
    from importlib.metadata import version

    return version("numba")

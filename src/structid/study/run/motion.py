"""A study identified from the motion of every degree of freedom, its record read from disk by chunks."""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.json_types import Entry, json_text
from structid.forward.motion.fit import RecursiveMotionFit, motion_fit
from structid.forward.motion.stream import MotionSolution, Progress, load_motion_fit, motion_solution
from structid.inversion import Status
from structid.inversion.regression.local_reduction import Kernels
from structid.records.on_disk import OnDiskRecord, open_record
from structid.study.run.motion_parts import Whole, reduced_alone, reduced_on
from structid.study.run.start_workers import start_workers
from structid.study.run.workers import Workers
from structid.study.schema.study import Study, load_study

#: The files of `write_motion`.
MOTION_SUMMARY, MOTION_TABLE = "motion.json", "parameters.csv"


@dataclass(frozen=True, eq=False)
class MotionOptions:
    """How `structid motion` goes through the record.

    Parameters
    ----------
    work : Kernels
    chunk : int, optional
        Samples a chunk.
    checkpoint : Path, optional
        Where the state is kept now and then, and taken up from.
    workers : int, optional
        Processes that reduce stretches of the records; by default this one takes one chunk after the other.
    scheduler : str, optional
        Address of the Dask cluster that does instead.
    """

    work: Kernels = Kernels()  # noqa: RUF009  frozen
    chunk: int | None = None
    checkpoint: Path | None = None
    workers: int | None = None
    scheduler: str | None = None


@dataclass(frozen=True, eq=False)
class MotionResult:
    """What a study's motion says.

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
        """Of all records on disk."""
        return sum(record.path.stat().st_size for record in self.records)

    @property
    def is_determined(self) -> bool:
        return self.solution.status is Status.CONVERGED


def motion_of_study(path: Path, options: MotionOptions, progress: Progress | None = None) -> MotionResult:
    """Parameters of the study at `path`, identified from the motion of every degree of freedom.

    Raises
    ------
    StudyError
        If the study cannot be used for it: several records, repeats, measured modes; with the place in the file.
    InputError, FileError
        If the record lacks what the equations need, has gaps, or shrinks.
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
            whole = Whole(study.structure, study.parameters, records, options.work, options.chunk)
            fit = _reduce_records(whole, workers, options.checkpoint, progress)
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
    whole: Whole, workers: Workers | None, checkpoint: Path | None, progress: Progress | None
) -> RecursiveMotionFit:
    """The fit of all records, reduced in this process or on workers, continued from the checkpoint if there is one."""
    fit = motion_fit(whole.structure, whole.unknown)
    if checkpoint is not None and checkpoint.exists():
        fit = load_motion_fit(checkpoint, fit)
    if workers is None:
        return reduced_alone(fit, whole, checkpoint, progress)
    return reduced_on(workers, fit, whole, checkpoint, progress)


def peak_memory() -> int:
    """Largest resident memory of this process so far, in bytes; 0 if the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def write_motion(result: MotionResult, folder: Path) -> None:
    """Write motion.json, parameters.csv and study.toml into the existing `folder`."""
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


def motion_summary(result: MotionResult) -> dict[str, Entry]:
    """What the pass found and what it cost, as plain values."""
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

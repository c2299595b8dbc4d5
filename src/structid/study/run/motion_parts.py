"""Stretches of records on disk reduced on several workers: paths and ranges go out, only triangles come back.

The stretches follow from the records alone and are merged in their order, so that every digit is the same for any
number of workers, whoever did what, and for a run that was ended and went on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.motion.fit import RecursiveMotionFit, motion_fit
from structid.forward.motion.stream import FitKeeper, Progress, RecordRows, record_rows, reduced_by_chunks
from structid.inversion.regression.local_reduction import Kernels, has_numba
from structid.inversion.search.work import Tools
from structid.records.on_disk import OnDiskRecord
from structid.study.run.workers import Workers
from structid.unknowns import Parameters

#: A stretch holds so many bytes at least, is so many times as large as what comes back, and there are at most so many.
STRETCH_BYTES, _TIMES_THE_ANSWER, _MOST_STRETCHES = 64_000_000, 5, 64

#: Number of a record, and the first and the last of its samples.
Stretch = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Whole:
    """What all stretches share.

    Attributes
    ----------
    structure : Structure
    unknown : Parameters
    records : tuple of OnDiskRecord
        With absolute paths, which every worker must see.
    work : Kernels
        The same on every worker.
    longest : int or None
        Samples a chunk.
    """

    structure: Structure
    unknown: Parameters
    records: tuple[OnDiskRecord, ...]
    work: Kernels
    longest: int | None

    @cached_property
    def start(self) -> RecursiveMotionFit:
        """The fit before any sample."""
        return motion_fit(self.structure, self.unknown)

    @cached_property
    def rows(self) -> tuple[RecordRows, ...]:
        """Of each record."""
        return tuple(record_rows(self.start.equations, self.structure, record) for record in self.records)


def stretches(records: Sequence[OnDiskRecord], answer_bytes: int, done: int = 0) -> list[Stretch]:
    """Stretches (record number, first and last sample) of nearly equal length that cover the samples after the first `done`.

    Parameters
    ----------
    records : sequence of OnDiskRecord
    answer_bytes : int
        Size of the result of one stretch, in bytes.
    done : int
    """
    found: list[Stretch] = []
    before = 0
    for number, record in enumerate(records):
        size = 8 * len(record.channels) * record.n_times
        count = size // max(STRETCH_BYTES, _TIMES_THE_ANSWER * answer_bytes)
        edges = np.linspace(0, record.n_times, min(max(count, 1), _MOST_STRETCHES) + 1).astype(int).tolist()
        for first, last in pairwise(edges):
            if before + last > done:
                found.append((number, max(first, done - before), last))
        before += record.n_times
    return found


class Reduced(TypedDict):
    """Triangles, energies and counts of one stretch."""

    triangles: FloatArray
    energy: FloatArray
    n_rows: int
    n_samples: int


def reduced_stretch(whole: Whole, item: Stretch, tools: Tools) -> Reduced:
    """Triangles, energies and counts of one stretch (record number, first and last sample), as a task for workers."""
    number, first, last = item
    fit = whole.start
    for chunk in whole.records[number].chunks(first, last, whole.longest):
        fit = whole.rows[number].reduced(fit, chunk, whole.work)
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
    whole: Whole,
    checkpoint: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RecursiveMotionFit:
    """`fit` after all remaining samples of the records were reduced on `workers`.

    Parameters
    ----------
    workers : Workers
    fit : RecursiveMotionFit
    whole : Whole
    checkpoint : Path, optional
        Keeps what is merged.
    progress : callable, optional

    Raises
    ------
    InputError, FileError
        If a worker does not see the records as they are here, or one of them cannot be read.
    WorkersLostError
        If the workers are gone; the checkpoint holds what was merged.
    """
    work = whole.work
    total = sum(record.n_times for record in whole.records)
    compiled = work.compiled(total * len(fit.state.columns)) and len(fit.state.columns) == fit.equations.n_dofs
    whole = replace(whole, work=Kernels("numba" if compiled else "numpy", work.threads))
    _require_records(workers, whole)
    items = dict(enumerate(stretches(whole.records, fit.state.triangles.nbytes, fit.n_samples)))
    early: dict[int, Reduced] = {}
    turn, keeper = 0, FitKeeper(checkpoint)
    try:
        for number, result in workers.completed(reduced_stretch, whole, items):
            early[number] = result
            while turn in early:
                fit, turn = _merged(fit, early.pop(turn)), turn + 1
                keeper.offer(fit)
                if progress is not None:
                    progress(fit.n_samples, total)
    finally:
        keeper.close(fit)
    return fit


def reduced_alone(
    fit: RecursiveMotionFit, whole: Whole, checkpoint: Path | None = None, progress: Progress | None = None
) -> RecursiveMotionFit:
    """`fit` after all records were reduced in this process, one chunk after the other."""
    ends = list(accumulate(record.n_times for record in whole.records))

    def report(done: int, _: int) -> None:
        """Pass the number of samples done, of all records, to `progress`."""
        if progress is not None:
            progress(done, ends[-1])

    for record, end in zip(whole.records, ends, strict=True):
        first = max(0, fit.n_samples - (end - record.n_times))
        if first < record.n_times:
            work, longest = whole.work, whole.longest
            fit = reduced_by_chunks(fit, whole.structure, record, work, longest, checkpoint, report, first)
    return fit


def _merged(fit: RecursiveMotionFit, part: Reduced) -> RecursiveMotionFit:
    """`fit` and the samples of one stretch; the first one is taken as it is."""
    state = replace(fit.state, triangles=part["triangles"], n_rows=part["n_rows"])
    own = replace(fit, state=state, energy=part["energy"], error=np.zeros_like(fit.error), n_samples=part["n_samples"])
    return own if fit.n_samples == 0 else fit.merged(own)


def _require_records(workers: Workers, whole: Whole) -> None:
    """Raise `InputError` if a worker does not see the records, or would reduce them with another engine."""
    wanted = tuple((str(record.path), record.path.stat().st_size) for record in whole.records)
    for worker, trouble in workers.asked(unusable, (wanted, _numba_version(whole.work.engine))).items():
        if trouble:
            raise InputError(f"{workers.words}: {worker}: {trouble}")


def unusable(wanted: tuple[tuple[tuple[str, int], ...], str]) -> str:
    """The reason why this worker cannot reduce records of these paths and sizes; "" if it can."""
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
    """Version of numba if the engine is numba and it is installed, else ""."""
    if engine != "numba" or not has_numba():
        return ""
    from importlib.metadata import version

    return version("numba")

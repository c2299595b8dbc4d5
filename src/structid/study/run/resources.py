"""Resources of a study before it is run: from its sizes, the measured time of a few lines, and a tried search."""

from __future__ import annotations

import subprocess
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from structid.core.errors import InputError, StructidError
from structid.core.isolation import python_arguments, start_child
from structid.diagnose.verdict import is_sound
from structid.forward import RecordProblem
from structid.forward.frf.products import STORED_BYTES
from structid.identification.identify import identify_together
from structid.identification.search import chosen_method
from structid.inversion import Method
from structid.records.formats import record_bytes
from structid.study.run.start import prepare_study
from structid.study.schema.study import Study

_MEASURED_LINES, _MEASURED_LINES_SMALL = 8, 4096
#: An evaluation that takes less is measured five times, for the shortest.
_QUICK_SECONDS = 0.5
#: Iterations that a search takes as a rule, its stages included.
USUAL_ITERATIONS = 40
#: For so long a search is tried, s.
_TRIED_SECONDS = 20.0
#: Start, checks and report of the examples take so many times what it takes to import all that a run needs.
_AROUND = 1.3
#: First ways to an answer that the search for causes of a misfit is worth, in the examples that have one; and iterations of one.
_REFITS, _WAY_ITERATIONS = 45, 25
_REFIT_ITERATIONS = 6
_REPLICATES = 400
_PROFILE_EVALUATIONS = 60
_DRAWS = 10_000
#: The Jacobian at the present point, what it is factored in, and the Jacobian at the next one.
_COPIES = 3
_GROUP = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Sizes:
    """Sizes of a study.

    Attributes
    ----------
    n_dofs, n_elements : int
        Free degrees of freedom and element matrices of the largest structure.
    n_lines, n_channels : int
        Lines in the band, and pairs of sensor and load, of the largest record; modes and sensors for modes.
    n_records, n_parameters, n_rows : int
        Rows are those of the residual of all records, real and imaginary parts each one.
    record_bytes : int
        Of the records in memory.
    """

    n_dofs: int
    n_elements: int
    n_lines: int
    n_channels: int
    n_records: int
    n_parameters: int
    n_rows: int
    record_bytes: int

    @property
    def jacobian_bytes(self) -> int:
        return 8 * self.n_rows * self.n_parameters

    @property
    def square_bytes(self) -> int:
        """Size of a square matrix of the parameters, such as the covariance."""
        return 8 * self.n_parameters**2

    @property
    def matrix_free_bytes(self) -> int:
        """Estimated memory of a matrix-free search, in bytes.

        It is three times the Jacobian if that is stored; else that of the response fields at all lines, a vector for
        each channel and one more.
        """
        data = 16 * self.n_lines * self.n_channels
        if data * self.n_parameters <= STORED_BYTES:
            return 3 * data * self.n_parameters
        return 16 * self.n_lines * (self.n_channels + 1) * self.n_dofs

    @property
    def least_bytes(self) -> int:
        """Least memory of a search with a Jacobian."""
        return self.record_bytes + _COPIES * (self.jacobian_bytes + self.square_bytes)


@dataclass(frozen=True)
class ResourceNeeds:
    """Memory and time that a study needs, from a few lines that were evaluated.

    Attributes
    ----------
    sizes : Sizes
    bytes_needed : int
        Peak, beyond what the process takes now.
    line_seconds : float
        Response and Jacobian of one line, on average over the records.
    analysis_seconds : float
        Once: the assembly, and the factorizer's look at the pattern.
    iteration_seconds : float
    search_seconds : float
        Of one search of `USUAL_ITERATIONS`.
    starts : int
        How many searches: the first, and those of the uniqueness test; restarts come only where a fit misses the noise.
    interval_seconds : float
        Of the intervals that ``[method]`` asks for.
    """

    sizes: Sizes
    bytes_needed: int
    line_seconds: float
    analysis_seconds: float
    iteration_seconds: float
    search_seconds: float
    starts: int
    interval_seconds: float

    def search_and_intervals(self, n_workers: int = 1) -> float:
        """Wall time in s of the first search, further searches and intervals, estimated from the time of single lines.

        Only further searches and intervals are spread over `n_workers`.
        """
        repeats = (self.starts - 1) * self.search_seconds + self.interval_seconds
        return self.analysis_seconds + self.search_seconds + repeats / n_workers


@dataclass(frozen=True)
class Duration:
    """Duration of a run of `structid identify`, s of wall time on this machine as it is now.

    Attributes
    ----------
    around : float
        The program's start, reading, checks, and the report.
    search : float
        With its restarts and the intervals.
    is_tried : bool
        Whether the search was carried out and came to its end; else its time is that of as many iterations as are usual.
    causes : float
        The search for causes of a misfit: 0 where the search that was tried explains the data; where it was not tried, nobody
        knows, and this stands for what it takes where it comes.
    """

    around: float
    search: float
    is_tried: bool
    causes: float

    @property
    def least(self) -> float:
        return self.around + self.search + (self.causes if self.is_tried else 0.0)

    @property
    def most(self) -> float:
        """Duration, s, with the search for causes, which may turn out not to be needed."""
        return self.around + self.search + self.causes


def sizes(problems: Sequence[RecordProblem]) -> Sizes:
    """The sizes of the problems of a study."""
    return Sizes(
        n_dofs=max(p.structure.n_dofs for p in problems),
        n_elements=max(sum(part.blocks.n_elements for part in p.structure.contributions) for p in problems),
        n_lines=max(len(p.frequency) for p in problems),
        n_channels=max(p.facts.n_channels for p in problems),
        n_records=len(problems),
        n_parameters=len({name for p in problems for name in p.names}),
        n_rows=sum(p.n_data for p in problems),
        record_bytes=sum(record_bytes(p.facts.record) for p in problems if p.facts.record is not None),
    )


def measured_needs(study: Study, problems: Sequence[RecordProblem]) -> ResourceNeeds:
    """Memory and time that a study needs, from timing response and Jacobian on some lines of each record.

    The times follow from usual numbers of iterations and refits; no search is made.

    Raises
    ------
    InputError
        If the matrices of a search, or the lines that are timed, do not fit in memory.
    """
    size, options = sizes(problems), study.options
    method = chosen_method(problems, options)
    if not method.is_matrix_free:
        require_room(study, problems)
    analysis = seconds = peak = 0.0
    before = resident_bytes()
    for problem in problems:
        try:
            analysis_once, per_line, scratch = _time_evaluation(problem, method)
        except MemoryError as error:
            raise InputError(
                f"{study.path}: {_MEASURED_LINES} lines of {problem.structure.n_dofs} degrees of freedom do not fit in"
                " the memory that is free; refine the mesh less, or take a machine with more memory"
            ) from error
        n_lines = len(problem.frequency)
        analysis, seconds, peak = analysis + analysis_once, seconds + per_line * n_lines, max(peak, scratch * n_lines)
    search = USUAL_ITERATIONS * seconds
    refits = {
        "laplace": 0,
        "bootstrap": _REPLICATES * _REFIT_ITERATIONS,
        "profile": size.n_parameters * _PROFILE_EVALUATIONS,
        "sampling": _DRAWS,
    }[options.intervals]
    grown = max(resident_bytes() - before, 0)
    dense = (_COPIES - 1) * size.jacobian_bytes + _COPIES * size.square_bytes
    fixed_bytes = grown + size.record_bytes + (size.matrix_free_bytes if method.is_matrix_free else dense)
    total = sum(len(p.frequency) for p in problems)
    return ResourceNeeds(
        sizes=size,
        bytes_needed=int(fixed_bytes + peak),
        line_seconds=seconds / total,
        analysis_seconds=analysis,
        iteration_seconds=seconds,
        search_seconds=search,
        starts=1 + options.uniqueness_starts,
        interval_seconds=refits * seconds,
    )


class _EnoughError(Exception):
    """A search that was tried takes longer than it is tried for."""


def expected(study: Study, n_workers: int = 1) -> tuple[ResourceNeeds, Duration]:
    """Memory that a study needs (bytes), and how long its identification takes with `n_workers` processes (s).

    The search is tried for up to 20 s, if an iteration should take less than 5 s. If it is not tried or does not end in
    this time, the timed lines of the record are taken with a usual number of iterations.

    Raises
    ------
    InputError
        If a record cannot be used, or it does not fit in memory.
    """
    start = time.perf_counter()
    ready = prepare_study(study)
    around = _AROUND * _start_seconds() + time.perf_counter() - start
    needs = measured_needs(study, ready.problems)
    untried = needs.search_and_intervals(n_workers)
    if needs.iteration_seconds + needs.analysis_seconds > _TRIED_SECONDS / 4:
        return needs, Duration(around, untried, False, _REFITS * _WAY_ITERATIONS * needs.iteration_seconds / n_workers)
    trial = _Tried(time.perf_counter())
    try:
        identification = identify_together(ready.setups, study.options, trial)
    except _EnoughError:
        seconds_each = max((time.perf_counter() - trial.begun) / trial.count, needs.iteration_seconds)
        search = max(untried, seconds_each * max(USUAL_ITERATIONS, 2 * trial.count))
        return needs, Duration(around, search, False, _REFITS * _WAY_ITERATIONS * seconds_each / n_workers)
    except (StructidError, np.linalg.LinAlgError):  # which the run will tell
        return needs, Duration(around, untried, False, 0.0)
    search = time.perf_counter() - trial.begun
    misses = (
        not is_sound(identification) and identification.estimate.chi_square_per_dof > 1 and study.structure.has_matrices
    )
    return needs, Duration(around, search, True, _REFITS * trial.first / n_workers if misses else 0.0)


class _Tried:
    """Watches a search that is tried: iterations, seconds of its first way to an answer, and when it is enough."""

    def __init__(self, begun: float) -> None:
        self.begun, self.count, self.first = begun, 0, 0.0
        self._in_first = True

    def __call__(self, name: str, _: int, __: float) -> None:
        """Count an iteration of the timed trial search; `name` is the stage of the search that reports it.

        The time at the end of the first search is kept. Raises `_EnoughError` when the time for trying is over.
        """
        now = time.perf_counter() - self.begun
        if now > _TRIED_SECONDS:
            raise _EnoughError
        self.count += 1
        self._in_first = self._in_first and not name.startswith("search 2")
        if self._in_first:
            self.first = now


def _start_seconds() -> float:
    """Seconds that a new Python process takes to start and import what a run uses, as measured now.

    `RuntimeError` if the process fails.
    """
    begun = time.perf_counter()
    words = "import structid.study.run.run, structid.report, structid.diagnose.verdict"
    child = start_child(python_arguments("-c", words), errors=subprocess.PIPE, has_group=False)
    errors = child.communicate()[1].decode(errors="replace").strip()
    if child.returncode:
        raise RuntimeError(f"Python ended with code {child.returncode} while it loaded structid: {errors}")
    return time.perf_counter() - begun


def _time_evaluation(problem: RecordProblem, method: Method) -> tuple[float, float, float]:
    """Cost of a response with its Jacobian: extra s of the first evaluation, s a line, and peak bytes a line.

    The lines evaluated are at most 8 lines of a large problem and 4096 of a small one, evenly chosen over the band.
    """
    most = _MEASURED_LINES if problem.is_large else _MEASURED_LINES_SMALL
    few = problem.with_lines(np.unique(np.linspace(0, len(problem.frequency) - 1, most).astype(int)))
    n_lines, theta = len(few.frequency), np.asarray(few.theta_start)
    linearize = few.linearize_operator if method.is_matrix_free else few.linearize
    first = _seconds(linearize, theta)
    again = min(_seconds(linearize, theta) for _ in range(5 if first < _QUICK_SECONDS else 1))
    tracemalloc.start()
    try:
        linearize(theta)
        scratch = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return max(first - again, 0.0), again / n_lines, scratch / n_lines


def _seconds(linearize: Callable[[np.ndarray], object], theta: np.ndarray) -> float:
    begun = time.perf_counter()
    linearize(theta)
    return time.perf_counter() - begun


def require_room(study: Study, problems: Sequence[RecordProblem], free: int | None = None) -> None:
    """Raise an error if the Jacobians of a study cannot fit in memory.

    Parameters
    ----------
    study : Study
        The study, which the message names.
    problems : sequence of RecordProblem
        Problem of each record.
    free : int, optional
        Free memory in bytes; by default as the system states it.

    Raises
    ------
    InputError
        If they do not fit, with the sizes and advice.
    """
    size, room = sizes(problems), available_bytes() if free is None else free
    if size.least_bytes > room:
        raise InputError(
            f"{study.path}: needs at least {gigabytes(size.least_bytes)} of memory and {gigabytes(room)} are free:"
            f" {_COPIES} arrays of {size.n_rows} rows x {size.n_parameters} parameters ({gigabytes(size.jacobian_bytes)}"
            f" each) and {_COPIES} of {size.n_parameters} x {size.n_parameters} ({gigabytes(size.square_bytes)}); take"
            " fewer lines ([method] band) or sensors, group the unknowns (leave out `each`), take a machine with more"
            ' memory, or search without a Jacobian ([method] search = "matrix_free")'
        )


def gigabytes(count: float) -> str:
    """The number of bytes `count` as text with three digits and a suitable decimal unit (kB to TB), such as ``1.5 GB``."""
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count / 1e3:.3g} kB"


def available_bytes() -> int:
    """Memory that this process may still take: free in the system, its control group and its own limit."""
    free = psutil.virtual_memory().available
    return min(value for value in (free, _group_free(), _limit_free()) if value is not None)


def resident_bytes() -> int:
    """Memory that this process has resident now, in bytes."""
    return int(psutil.Process().memory_info().rss)


def _group_free() -> int | None:
    """Free bytes of the control group (a container, a batch job), inactive file caches included; None without one or its limit."""
    for limit, used, cache in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "total_inactive_file"),
    ):
        try:
            most, now = ((_GROUP / name).read_text().strip() for name in (limit, used))
            rows = dict(line.split() for line in (_GROUP / limit).with_name("memory.stat").read_text().splitlines())
            return None if most == "max" else max(int(most) - int(now) + int(rows.get(cache, 0)), 0)
        except (OSError, ValueError):
            continue
    return None


def _limit_free() -> int | None:
    """Free bytes under the address-space limit of this process (``ulimit -v``); None without a limit, and on Windows."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    most = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if most == resource.RLIM_INFINITY else max(most - int(psutil.Process().memory_info().vms), 0)

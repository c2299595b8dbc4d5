"""The command `structid doctor`: what is installed, and what a study will need before it is run."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid._version import __version__
from structid.cli.base import UNUSABLE_INPUT, fail

if TYPE_CHECKING:
    from structid.study.run.resources import Duration, ResourceNeeds

#: Packages that are not required, and what they are for.
OPTIONAL = {
    "numba": "time histories in one pass (extra `fast`)",
    "mkl": "the PARDISO factorizer (extra `pardiso`)",
    "dask": "clusters (extra `cluster`)",
    "distributed": "clusters (extra `cluster`)",
    "meshio": "VTK mesh files (extra `mesh`)",
    "npTDMS": "TDMS files (extra `tdms`)",
    "asammdf": "MDF files (extra `mdf`)",
    "obspy": "miniSEED files (extra `miniseed`)",
    "pyarrow": "Parquet files (extra `parquet`)",
    "emcee": "sampling (extra `sampling`)",
    "ansys-mapdl-reader": "Ansys files (extra `ansys`)",
}
_REQUIRED = ("numpy", "scipy", "h5py", "matplotlib", "psutil", "threadpoolctl")

StudyPath = Annotated[
    Path | None, typer.Argument(metavar="[STUDY.toml]", help="Also say what this study will need.", show_default=False)
]
Workers = Annotated[int, typer.Option("--workers", metavar="N", min=1, help="Time with so many processes.")]


def doctor(study: StudyPath = None, workers: Workers = 1) -> None:
    """Say what is installed, and what a study will need: memory and time, from a few of its lines and a search that is tried.

    Exit code 2: the study cannot fit in memory; the numbers say why.

    \b
    Examples:
      structid doctor
      structid doctor frame.toml
      structid doctor plate.toml --workers 8
    """
    from structid.study.run.resources import available_bytes, expected, gigabytes  # the help needs none of these
    from structid.study.schema.study import load_study

    packages = installation()
    for line in installed_lines(packages):
        typer.echo(line)
    if study is None:
        return
    read = load_study(study)
    free = available_bytes()
    needs, duration = expected(read, workers)
    for line in needed_lines(needs, duration, free, workers):
        typer.echo(line)
    if needs.bytes_needed > free:
        fail(
            f"{study}: needs about {gigabytes(needs.bytes_needed)} of memory and {gigabytes(free)} are free; take"
            " fewer lines ([method] band) or sensors, group the unknowns (leave out `each`), or take a machine with"
            " more memory",
            UNUSABLE_INPUT,
        )


@dataclass(frozen=True)
class Installation:
    """State of the installation: versions, libraries and extras.

    Attributes
    ----------
    structid, python, system : str
    required, optional : mapping of str to str
        Version of each package; empty where an optional one is not installed.
    factorizers : tuple of str
        With their versions, the one in use first.
    blas : tuple of str
        Libraries of linear algebra with their threads.
    processors : int
        That this process may use.
    free_bytes : int
        Memory that it may still take.
    """

    structid: str
    python: str
    system: str
    required: dict[str, str]
    optional: dict[str, str]
    factorizers: tuple[str, ...]
    blas: tuple[str, ...]
    processors: int
    free_bytes: int


def installation() -> Installation:
    """Versions of Python and packages, factorizers, BLAS threads, processors and free memory (bytes) here.

    The factorizer that is used comes first; an optional package that is not there has no version. Processors are those
    that this process may use.
    """
    from threadpoolctl import threadpool_info

    from structid.core.display import plural
    from structid.dynamics.factorization import factorizer, installed_factorizers
    from structid.study.run.resources import available_bytes

    default = factorizer().name
    names = sorted(installed_factorizers(), key=lambda name: name != default)
    blas = tuple(
        f"{pool['internal_api']} {pool['version'] or ''}".strip() + f", {plural(pool['num_threads'], 'thread')}"
        for pool in threadpool_info()
    )
    allowed = getattr(os, "sched_getaffinity", None)
    return Installation(
        structid=__version__,
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        required={name: _version(name) for name in _REQUIRED},
        optional={name: _version(name) for name in OPTIONAL},
        factorizers=tuple(factorizer(name).words for name in names),
        blas=tuple(dict.fromkeys(blas)),
        processors=len(allowed(0)) if allowed is not None else os.cpu_count() or 1,
        free_bytes=available_bytes(),
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def installed_lines(installation: Installation) -> list[str]:
    """Lines to print on the installation: versions, packages, factorizers, threads and free memory."""
    from structid.study.run.resources import gigabytes

    required = ", ".join(f"{name} {version}" for name, version in installation.required.items())
    has = ", ".join(f"{name} {version}" for name, version in installation.optional.items() if version)
    lacks = [f"{name}: {OPTIONAL[name]}" for name, version in installation.optional.items() if not version]
    free = f"{gigabytes(installation.free_bytes)} free"
    return [
        f"structid {installation.structid}, Python {installation.python}, {installation.system}",
        f"packages: {required}",
        f"optional packages: {has or 'none'}",
        *(f"not installed: {line}" for line in lacks),
        f"factorizers: {', '.join(installation.factorizers)}; the first is used",
        f"threads: {installation.processors} processors; {'; '.join(installation.blas)}",
        f"memory: {free}",
    ]


def needed_lines(needs: ResourceNeeds, duration: Duration, free: int, workers: int) -> list[str]:
    """Lines to print on the size of a study, and the memory and time that it needs on `workers` processes.

    `free` is the free memory in bytes; `duration` is already that for so many workers. The first line is blank.
    """
    from structid.cli.console import clock
    from structid.study.run.resources import gigabytes

    size = needs.sizes
    records = f"{size.n_records} records, the largest with " if size.n_records > 1 else ""
    starts = f", {needs.starts} starts" if needs.starts > 1 else ""
    intervals = ", with its intervals" if needs.interval_seconds else ""
    room = f" of {gigabytes(free)} free"
    on = f" on {workers} workers" if workers > 1 else ""
    return [
        "",
        f"study: {size.n_dofs} degrees of freedom, {size.n_elements} element matrices, {size.n_parameters} parameters;"
        f" {records}{size.n_lines} lines, {size.n_channels} channels; {size.n_rows} residuals",
        f"memory: about {gigabytes(needs.bytes_needed)}{room} (records {gigabytes(size.record_bytes)}, one Jacobian"
        f" {gigabytes(size.jacobian_bytes)})",
        f"time: {clock(needs.line_seconds)} a line with its derivatives, {clock(needs.iteration_seconds)} an iteration;"
        f" the search{starts}{intervals} {clock(duration.search)}, the program's start and the report"
        f" {clock(duration.around)}",
        f"in all: about {_duration_words(duration)}{on}",
    ]


def _duration_words(duration: Duration) -> str:
    """Words on the duration of a run, and what part of it is a search for causes.

    They say if a trial of the search came to its end; without one, the duration with a search for causes is added.
    """
    from structid.cli.console import clock

    if duration.is_tried and duration.causes:
        return (
            f"{clock(duration.least)}, of which {clock(duration.causes)} to look for causes: the search was tried, and its fit"
            " misses the noise"
        )
    if duration.is_tried:
        return f"{clock(duration.least)}; the search was tried, and came to its end"
    more = f", {clock(duration.most)} where causes of a misfit are sought" if duration.causes else ""
    return f"{clock(duration.least)}{more}; the search takes too long to be tried"

"""Output of `structid doctor`: the installation, and what a study will need."""

from __future__ import annotations

from structid.cli.progress import clock
from structid.study.run.doctor import OPTIONAL, Installation
from structid.study.run.resources import Duration, ResourceNeeds, gigabytes


def installed_lines(installation: Installation) -> list[str]:
    """Lines to print on the installation: versions, packages, factorizers, threads and free memory."""
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

    `free` is the free memory in bytes; `duration` is already that for so many workers.
    """
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
    """Words on the duration of a run, the time to search for causes of a misfit, and whether the search was tried."""
    if duration.is_tried and duration.causes:
        return (
            f"{clock(duration.least)}, of which {clock(duration.causes)} to look for causes: the search was tried, and its fit"
            " misses the noise"
        )
    if duration.is_tried:
        return f"{clock(duration.least)}; the search was tried, and came to its end"
    more = f", {clock(duration.most)} where causes of a misfit are sought" if duration.causes else ""
    return f"{clock(duration.least)}{more}; the search takes too long to be tried"

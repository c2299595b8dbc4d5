"""The command `structid doctor`: what is installed, and what a study will need before it is run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import UNUSABLE_INPUT, fail
from structid.cli.progress import clock
from structid.study.run.doctor import OPTIONAL, Installation, installation
from structid.study.run.resources import Duration, Needs, available_bytes, expected, gigabytes
from structid.study.schema.study import load_study

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
    found = installation()
    for line in _installed(found):
        typer.echo(line)
    if study is None:
        return
    read = load_study(study)
    free = available_bytes()
    needs, duration = expected(read, workers)
    for line in _needed(needs, duration, free, workers):
        typer.echo(line)
    if needs.bytes_needed > free:
        fail(
            f"{study}: needs about {gigabytes(needs.bytes_needed)} of memory and {gigabytes(free)} are free; take"
            " fewer lines ([method] band) or sensors, group the unknowns (leave out `each`), or take a machine with"
            " more memory",
            UNUSABLE_INPUT,
        )


def _installed(found: Installation) -> list[str]:
    required = ", ".join(f"{name} {version}" for name, version in found.required.items())
    has = ", ".join(f"{name} {version}" for name, version in found.optional.items() if version)
    lacks = [f"{name}: {OPTIONAL[name]}" for name, version in found.optional.items() if not version]
    free = f"{gigabytes(found.free_bytes)} free"
    return [
        f"structid {found.structid}, Python {found.python}, {found.system}",
        f"packages: {required}",
        f"optional packages: {has or 'none'}",
        *(f"not installed: {line}" for line in lacks),
        f"factorizers: {', '.join(found.factorizers)}; the first is used",
        f"threads: {found.processors} processors; {'; '.join(found.blas)}",
        f"memory: {free}",
    ]


def _needed(needs: Needs, duration: Duration, free: int, workers: int) -> list[str]:
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
    if duration.is_tried and duration.causes:
        return (
            f"{clock(duration.least)}, of which {clock(duration.causes)} to look for causes: the search was tried, and its fit"
            " misses the noise"
        )
    if duration.is_tried:
        return f"{clock(duration.least)}; the search was tried, and came to its end"
    more = f", {clock(duration.most)} where causes of a misfit are sought" if duration.causes else ""
    return f"{clock(duration.least)}{more}; the search takes too long to be tried"

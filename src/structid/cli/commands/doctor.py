"""The command `structid doctor`: what is installed, and what a study will need before it is run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import UNUSABLE_INPUT, fail

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
    from structid.cli.doctor_summary import installed_lines, needed_lines  # the help needs none of these
    from structid.study.run.doctor import installation
    from structid.study.run.resources import available_bytes, expected, gigabytes
    from structid.study.schema.study import load_study

    found = installation()
    for line in installed_lines(found):
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

"""The command `structid motion`: every element's parameters from the motion of all degrees of freedom, in one pass."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from structid.cli.base import (
    INTERRUPTED,
    NOT_DETERMINED,
    Scheduler,
    StudyPath,
    Workers,
    beside_call,
    fail,
    results_folder,
    say,
)

if TYPE_CHECKING:
    from structid.study.run.motion import MotionResult


def motion(
    study: StudyPath,
    engine: Annotated[str, typer.Option(help="auto, numba or numpy.")] = "auto",
    threads: Annotated[int, typer.Option(help="Threads of the compiled kernels.")] = 1,
    chunk: Annotated[int | None, typer.Option(help="Samples read at a time [default: about 32 MB].")] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="FILE.npz", help="Keep the state here after each chunk; go on from it if it is there."),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, results_folder("<study name>_motion")] = None,
) -> None:
    """Identify a study from the measured motion of every degree of freedom, reading the record by chunks.

    The record (NPY or HDF5) may be far larger than memory, the structure as large as wished: time grows with samples
    times degrees of freedom, memory with degrees of freedom. Workers get paths and ranges and give back triangular factors,
    which are merged in order: the same digits for any number of them. Writes motion.json and parameters.csv. Exit code 1:
    the motion does not determine every parameter.

    \b
    Examples:
      structid motion bridge.toml
      structid motion bridge.toml --threads 2 --checkpoint bridge.npz
      structid motion bridge.toml --workers 4 --checkpoint bridge.npz
    """
    from structid.files import claim_path  # the help needs none of these
    from structid.inversion.regression.local_reduction import Engine, FoldingKernels
    from structid.study.results.folder import require_results_folder, staged_folder
    from structid.study.run.motion import MOTION_SUMMARY, MOTION_TABLE, MotionOptions, motion_of_study, write_motion

    work = FoldingKernels(cast(Engine, engine), threads)
    options = MotionOptions(work, chunk, checkpoint, workers, scheduler)
    folder = out if out is not None else beside_call(f"{study.stem}_motion")
    require_results_folder(folder, MOTION_SUMMARY, "study.toml", MOTION_TABLE)
    try:
        with claim_path(checkpoint) if checkpoint is not None else nullcontext():
            result = motion_of_study(study, options, _told)
    except KeyboardInterrupt:
        kept = f"; {checkpoint} holds what is done, the same command goes on from it" if checkpoint else ""
        fail(f"interrupted; no results were written{kept}", INTERRUPTED)
    with staged_folder(folder, MOTION_SUMMARY) as staged:
        write_motion(result, staged)
    typer.echo("", err=True)
    for line in motion_lines(result):
        typer.echo(line)
    say(folder / MOTION_SUMMARY)
    say(folder / MOTION_TABLE)
    if not result.is_determined:
        fail("the motion does not determine every parameter; see the message above", NOT_DETERMINED)


def _told(done: int, whole: int) -> None:
    typer.echo(f"\r{done} of {whole} samples", nl=False, err=True)


def motion_lines(result: MotionResult) -> list[str]:
    """Lines to print: size of the problem, number of identified parameters, message, wall times (s) and peak memory.

    The last line is left out where the memory is not known.
    """
    solution, structure = result.solution, result.study.structure
    lines = [
        f"{structure.n_dofs} degrees of freedom, {len(solution.values)} parameters, {solution.n_samples} samples"
        f" ({result.record_bytes / 1e6:.0f} MB on disk)",
        f"{int(solution.identified.sum())} of {len(solution.values)} parameters identified",
        f"{solution.message}, in {result.where}" if result.where != "this process" else solution.message,
        "wall time: " + ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.seconds.items()),
    ]
    if result.peak_memory:
        lines.append(f"peak memory: {result.peak_memory / 1e6:.0f} MB")
    return lines

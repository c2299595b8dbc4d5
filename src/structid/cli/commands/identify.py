"""The command `structid identify`: a study from its file to its results, however long it takes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.base import (
    CHECKPOINT_SECONDS,
    INTERRUPTED,
    NOT_DETERMINED,
    UNUSABLE_INPUT,
    WRONG_MODEL,
    Png,
    Report,
    Scheduler,
    StudyPath,
    Workers,
    beside_call,
    check_png,
    command_line,
    fail,
    results_folder,
    say,
)

if TYPE_CHECKING:
    from structid.diagnose.refits import FittedModel
    from structid.study.results.result import StudyResult
    from structid.study.run.long_run import Checkpoint, LongRun


def _least_time(seconds: float) -> float:
    """Value `seconds` unchanged; the command fails if it is negative or NaN."""
    if not seconds >= 0:
        fail(f"--checkpoint must be at least 0, got {seconds:g}; 0 writes every checkpoint", UNUSABLE_INPUT)
    return seconds


def _time_limit(seconds: float | None) -> float | None:
    """Time limit `seconds` unchanged, None (no limit) included.

    The command ends with exit code 2 if it is not positive.
    """
    if seconds is not None and not seconds > 0:
        remedy = "leave it out, or give --no-explain to `structid identify` for no search"
        fail(f"--seconds must be greater than 0, got {seconds:g}; {remedy}", UNUSABLE_INPUT)
    return seconds


Seconds = Annotated[
    float,
    typer.Option(
        "--checkpoint",
        metavar="SECONDS",
        callback=_least_time,
        help="Least time between checkpoints; 0: all.",
    ),
]

Explain = Annotated[
    bool | None,
    typer.Option("--explain/--no-explain", help="Look for causes of a misfit always, never [default: unless sound]."),
]
Watched = Annotated[
    Path | None,
    typer.Option("--progress", metavar="FILE", help="Add a JSON line on each step to FILE, for programs that watch."),
]
CauseSeconds = Annotated[
    float | None,
    typer.Option(
        "--seconds",
        metavar="SECONDS",
        callback=_time_limit,
        show_default=False,
        help="Processor time for the search for causes; one look and two fits are made in any case [default: the"
        " evaluations of three identifications and 8 s; of `structid explain`, no limit].",
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print warnings, statistics, causes and modes too.")]
#: The words of each choice.
_EXPLAIN: dict[bool | None, list[str]] = {None: [], True: ["--explain"], False: ["--no-explain"]}


def identify(
    study: StudyPath,
    out: Annotated[Path | None, results_folder("<study name>_results")] = None,
    report: Report = True,
    png: Png = False,
    explain: Explain = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from where an interrupted run was.")] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    checkpoint: Seconds = CHECKPOINT_SECONDS,
    progress_file: Watched = None,
    seconds: CauseSeconds = None,
    verbose: Verbose = False,
) -> None:
    """Identify the unknowns of a study and write estimate.json, estimate.h5, study.toml and report.html.

    The results are written before causes of a misfit are looked for, and again with the causes. What is done so far is
    kept in <FOLDER>.checkpoint until then; see docs/long-runs.md.

    \b
    Examples:
      structid identify frame.toml
      structid identify frame.toml --out results/frame
      structid identify frame.toml --resume
      structid identify frame.toml --workers 8 --png
    """
    from structid.cli.console import ProgressFile, run_progress, show
    from structid.cli.summaries import identification_summary  # the help needs none of these
    from structid.core.isolation import paths_as_called
    from structid.diagnose.diagnosis import budget_for_causes
    from structid.diagnose.search_budget import SearchBudget
    from structid.inversion.estimate import Status
    from structid.study.results.folder import (
        ESTIMATE,
        ESTIMATE_FILES,
        ESTIMATE_PAGE,
        require_results_folder,
        staged_folder,
    )
    from structid.study.run.diagnosis import diagnose_study, write_suggestions
    from structid.study.run.long_run import Checkpoint, LongRun, checkpoint_folder, fingerprint, start_workers
    from structid.study.run.run import confirm_result, relinearized_study, run_prepared
    from structid.study.run.workers import WorkersLostError
    from structid.study.schema.study import load_study

    check_png(report, png)
    folder = out if out is not None else beside_call(f"{study.stem}_results")
    require_results_folder(folder, ESTIMATE, *ESTIMATE_FILES)
    crew = start_workers(workers, scheduler)
    read = load_study(study, work=LongRun(crew))
    owner = fingerprint(read)
    is_answered = False

    def write(answer: StudyResult, fits: Sequence[FittedModel]) -> str:
        """Write results, and a study file for each of `fits`, into the results folder of the command.

        Return the name of the file to read first: the report, or estimate.json without one.
        """
        with staged_folder(folder, ESTIMATE, ESTIMATE_PAGE) as staged:
            page = _write(answer, staged, report, png)
            write_suggestions(answer, fits, staged, folder)
        return page

    def write_before_search(answer: StudyResult) -> None:
        nonlocal is_answered
        write(answer, ())
        is_answered = True

    with closing(Checkpoint(checkpoint_folder(folder), owner, resume, checkpoint)) as kept:
        run = LongRun(crew, kept)
        try:
            with run_progress(read.options.method.max_iterations) as progress:
                run.progress = progress.tasks
                if progress_file is not None:
                    progress.file = ProgressFile(progress_file, run.reached.summary)
                ready = relinearized_study(read, progress.search, run)
                result = run_prepared(ready, progress.search, run)
                ready, result = confirm_result(ready, result, progress.search, run)
                limited = budget_for_causes(result.identification) if seconds is None else SearchBudget(seconds=seconds)
                result, fits = diagnose_study(ready, result, explain, run, limited, write_before_search)
            name = write(result, fits)
        except KeyboardInterrupt:
            flags = ["--no-report"] * (not report) + ["--png"] * png + _EXPLAIN[explain]
            again = _resume_command(study, flags, out=out, workers=workers, scheduler=scheduler, seconds=seconds)
            words = _interruption_message(run, kept, again)
            if is_answered:
                words = f"the answer is in {folder}, without its causes: {words}"
            fail(words, INTERRUPTED)
        except WorkersLostError:
            kept.write(run.so_far())
            raise
        finally:
            run.close()
        kept.remove()
    show(identification_summary(result, verbose, paths_as_called(str(folder))))
    say(folder / name)
    estimate = result.identification.estimate
    verdict = result.diagnosis.judgement.verdict if result.diagnosis is not None else ""
    if verdict == "wrong_model":
        raise typer.Exit(WRONG_MODEL)
    if estimate.status is not Status.CONVERGED:
        fail(f"{estimate.status_words} ({estimate.message})", NOT_DETERMINED)
    if verdict in ("undetermined", "untested"):
        raise typer.Exit(NOT_DETERMINED)


def _write(result: StudyResult, folder: Path, report: bool, png: bool) -> str:
    """Write the results into `folder`, with a report if `report`, and return the name of the file to read first.

    It is the report, or else estimate.json. With `png` the figures of the report are written as PNG files too.
    """
    from structid.study.results.folder import write_results

    write_results(result, folder)
    if not report:
        return "estimate.json"
    if not result.identification.estimate.uncertainty.has_matrix:
        from structid.report.identification import free_page

        return free_page(result).write(folder, png).name
    from structid.report.identification import write_report

    return write_report(
        result.identification, folder, result.study.title, asdict(result.provenance), png, result.diagnosis
    ).name


def _interruption_message(run: LongRun, kept: Checkpoint, again: str) -> str:
    """Message on how far an interrupted run came and how to continue.

    The state reached is written to the checkpoint `kept`. `again` is the text that tells how to resume. Before the
    first iteration nothing is written, and the message says so.
    """
    if not run.reached.search and not kept.n_found:
        return "interrupted before the first iteration; nothing was written"
    kept.write(run.so_far())
    return f"interrupted in {run.reached.words}; the values reached are in {kept.folder / 'so_far.json'}; {again}"


def _resume_command(study: Path, flags: Sequence[str], **options: object) -> str:
    """Text with the command line that resumes the run; `options` with the value None are left out, `flags` are appended."""
    words = [word for name, value in options.items() if value is not None for word in (f"--{name}", str(value))]
    return f"go on with: {command_line('identify', study, *words, *flags, '--resume')}"

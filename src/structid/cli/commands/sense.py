"""The command `structid sense`: motion where no sensor is, and forces that nobody measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import WRONG_MODEL, Png, Report, beside_call, check_png, results_folder, say
from structid.prediction.options import SenseOptions
from structid.records import ReadOptions


def sense(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results folder of `structid identify`.")],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Time histories: motions, and forces where known.")],
    options: SenseOptions,
    read: ReadOptions,
    study: Annotated[
        Path | None, typer.Option("--study", metavar="STUDY.toml", help="The study, where it has moved since.")
    ] = None,
    out: Annotated[Path | None, results_folder("<results>_sensed")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Estimate motion at places without a sensor, and forces that nobody measured, from a record; write sensed.csv and a page.

    A Kalman smoother runs over the modes of the identified model. Every value has a standard deviation, which includes the noise of
    the sensors, the uncertainty of the model and what the unknown forces leave open.
    Where the record contradicts the model, the result is written and the exit code is 3.

    \b
    Examples:
      structid sense bridge_results traffic.csv --wanted 12Y,14Y --unknown 5Y,9Y
      structid sense tower_results wind.h5 --wanted 40X --unknown 10X,20X,30X --correlation-time 1 --leave-out 30X
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.core.json_types import json_text
    from structid.report.sensing import SENSING_PAGE, sensing_page, sensing_text
    from structid.study.results.folder import staged_folder
    from structid.study.run.sensing import sense_record, sensed_csv, sensed_summary

    check_png(report, png)
    found, title = sense_record(results, record, read, options, study)
    folder, name = out if out is not None else beside_call(f"{results.name}_sensed"), "sensed.csv"
    with staged_folder(folder, "sensed.json", SENSING_PAGE) as staged:
        (staged / "sensed.csv").write_text(sensed_csv(found), encoding="utf-8")
        (staged / "sensed.json").write_text(json_text(sensed_summary(found, results, record)), encoding="utf-8")
        if report:
            name = sensing_page(found, title, record.name).write(staged, png).name
    show(sensing_text(found))
    say(folder / name)
    if not found.is_explained:
        raise typer.Exit(WRONG_MODEL)

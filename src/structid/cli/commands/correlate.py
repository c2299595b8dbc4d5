"""The command `structid correlate`: test and model side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import NOT_DETERMINED, Png, Report, StudyPath, beside_call, check_png, fail, results_folder, say
from structid.compare.options import CorrelateOptions


def correlate(
    study: StudyPath,
    options: CorrelateOptions,
    at: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Results folder whose values the model has [default: start values]."),
    ] = None,
    out: Annotated[Path | None, results_folder("<study name>_correlation")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Put measured and modelled modes or FRFs side by side: pairs, MAC, COMAC, FRAC; write correlation.json and a page.

    Nothing is estimated: the model has the start values of the study, or those of an earlier run. Measured shapes carried
    on to the model are written as expanded_modes.csv. Exit code 1: no measured mode matches one of the model.

    \b
    Examples:
      structid correlate frame.toml
      structid correlate frame.toml --at frame_results --out after
      structid correlate wing.toml --expansion dynamic --model-error 0.01
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.compare.correlation import correlate as correlated
    from structid.compare.correlation import correlation_summary, expanded_record
    from structid.core.json_types import json_text
    from structid.modal.formats.files import write_modes
    from structid.report.correlation import CORRELATION_PAGE, correlation_page, correlation_text
    from structid.study.results.folder import staged_folder
    from structid.study.schema.study import load_study

    check_png(report, png)
    correlation = correlated(load_study(study), options, at)
    folder, name = out if out is not None else beside_call(f"{study.stem}_correlation"), "correlation.json"
    with staged_folder(folder, name, CORRELATION_PAGE) as staged:
        (staged / name).write_text(json_text(correlation_summary(correlation)), encoding="utf-8")
        for count, part in enumerate(correlation.modes, 1):
            expanded = expanded_record(part)
            if expanded is not None:
                write_modes(staged / f"expanded_modes{f'_{count}' if count > 1 else ''}.csv", expanded)
        if report:
            name = correlation_page(correlation).write(staged, png).name
    show(correlation_text(correlation))
    say(folder / name)
    if not correlation.is_paired:
        fail("no measured mode matches one of the model; check sensors, supports and units", NOT_DETERMINED)

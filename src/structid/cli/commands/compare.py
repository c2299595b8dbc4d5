"""The command `structid compare`: what changed between two states of a structure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import (
    NOT_DETERMINED,
    WRONG_MODEL,
    Png,
    Report,
    beside_call,
    check_png,
    fail,
    results_folder,
    say,
)
from structid.compare.options import CompareOptions


def compare(
    baseline: Annotated[Path, typer.Argument(metavar="BASELINE", help="Study file, or results folder of identify.")],
    later: Annotated[Path, typer.Argument(metavar="LATER", help="The same of the later state.")],
    options: CompareOptions,
    out: Annotated[Path | None, results_folder("<later>_comparison")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Say what changed between two states of a structure, where, and what could not have been seen; write compare.json.

    Every change is tested, corrected for their number. Exit code 1: a state is not determined; 3: its model does not
    explain its record, or what was named as unchanged changed (results are written).

    \b
    Examples:
      structid compare before.toml after.toml --unchanged mass
      structid compare before_results after_results --level 0.01
      structid compare before_results after.toml --unchanged mass --out damage
    """
    from structid.cli.console import run_progress, show  # the help needs none of these
    from structid.compare.states import COMPARE_PAGE, comparison_summary
    from structid.compare.states import compare as compare_states
    from structid.core.json_types import json_text
    from structid.report.comparison import comparison_page, comparison_text
    from structid.study.results.folder import staged_folder

    check_png(report, png)
    with run_progress(100) as progress:
        comparison = compare_states(baseline, later, options, progress.search)
    folder = out if out is not None else beside_call(f"{later.stem if later.is_file() else later.name}_comparison")
    name = "compare.json"
    with staged_folder(folder, name, COMPARE_PAGE) as staged:
        (staged / name).write_text(json_text(comparison_summary(comparison)), encoding="utf-8")
        if report:
            name = comparison_page(comparison).write(staged, png).name
    show(comparison_text(comparison))
    say(folder / name)
    if comparison.baseline.is_wrong or comparison.later.is_wrong:
        fail("the model of a state does not explain its record: what is declared changed is no finding", WRONG_MODEL)
    if comparison.is_contradicted:
        fail("what was named as unchanged changed: no declared change is to be used", WRONG_MODEL)
    if not comparison.comparison.is_complete:
        fail("the data do not determine every change; see the warnings", NOT_DETERMINED)

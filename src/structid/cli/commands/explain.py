"""The command `structid explain`: which single changes of model or record would explain a misfit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from structid.cli.base import CHECKPOINT_SECONDS, Png, Report, Scheduler, StudyPath, Workers, results_folder
from structid.cli.commands.identify import CauseSeconds, Seconds, identify


def explain(
    study: StudyPath,
    out: Annotated[Path | None, results_folder("<study name>_results")] = None,
    report: Report = True,
    png: Png = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    checkpoint: Seconds = CHECKPOINT_SECONDS,
    seconds: CauseSeconds = float("inf"),
) -> None:
    """Identify a study and say which single changes of model or record would explain its misfit.

    Supports, joints, masses, dampers, friction, calibration, cables and more are tried one by one, some hundred of them;
    those that explain most are refitted, ranked, and written as studies ready to run in the folder suggestions of the
    results. `structid identify` does the same where its answer is not sound.

    \b
    Examples:
      structid explain frame.toml
      structid identify frame_results/suggestions/1-support-70Y.toml
    """
    identify(study, out, report, png, True, False, workers, scheduler, checkpoint, None, seconds)

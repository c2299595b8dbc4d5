"""The command `structid plan`: sensors and loads of a test, and its expected accuracy, before it is run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from structid.cli.base import NOT_DETERMINED, Png, Report, StudyPath, beside_call, check_png, fail, results_folder, say


@dataclass(frozen=True)
class Wanted:
    """Options that take the place of [plan] in the study.

    Parameters
    ----------
    n_sensors : int, optional
        How many sensors to choose.
    n_loads : int, optional
        How many loads to choose.
    n_frequencies : int, optional
        How many lines to choose [default: all are used].
    criterion : str, optional
        d (determinant) or a (trace) [default: d].
    target : float, optional
        Wanted relative standard deviation, as in 0.02.
    """

    n_sensors: int | None = None
    n_loads: int | None = None
    n_frequencies: int | None = None
    criterion: str | None = None
    target: float | None = None


def plan(
    study: StudyPath,
    wanted: Wanted,
    out: Annotated[Path | None, results_folder("<study name>_plan")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Predict what a test will tell before it is run, and choose its sensors, loads and lines; write plan.json.

    Options left out come from [plan] in the study, or from its record; neither is needed. The exit code is 1 where
    even all candidates together do not determine every parameter.

    \b
    Examples:
      structid plan frame.toml --sensors 4
      structid plan frame.toml --sensors 4 --loads 1 --frequencies 24 --target 0.02 --out frame_plan
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.report.planning import plan_page, plan_text
    from structid.study.results.folder import require_results_folder, staged_folder
    from structid.study.results.plan import PLAN_PAGE, write_plan
    from structid.study.schema.plan import load_plan, planned

    check_png(report, png)
    folder, name = out if out is not None else beside_call(f"{study.stem}_plan"), "plan.json"
    require_results_folder(folder, name, "study.toml", PLAN_PAGE)
    read = load_plan(study, **{name: value for name, value in asdict(wanted).items() if value is not None})
    chosen = planned(read)
    with staged_folder(folder, name, PLAN_PAGE) as staged:
        write_plan(chosen, read, staged)
        if report:
            name = plan_page(chosen, read.title, read.notes).write(staged, png).name
    show(plan_text(chosen, read.title, read.notes))
    say(folder / name)
    if not chosen.determined:
        fail(f"even all candidates together do not determine {', '.join(chosen.undetermined[:6])}", NOT_DETERMINED)

"""The command `structid check`: what a study can determine, before anything is estimated."""

from __future__ import annotations

from structid.cli.base import NOT_DETERMINED, StudyPath, command_line, fail, say

_KEPT_BYTES = 500_000_000


def check(study: StudyPath) -> None:
    """Read all of a study and say what it can determine: units, sensors, coverage, rank, predicted accuracy.

    Nothing is estimated or written. The exit code is 1 where the data do not determine every parameter.

    \b
    Examples:
      structid check frame.toml
    """
    from structid.cli.console import show
    from structid.cli.summaries import check_summary  # the help needs none of these
    from structid.inversion.estimate import Status
    from structid.records.formats import keep_records
    from structid.study.run.check import check_study
    from structid.study.schema.study import load_study

    keep_records(_KEPT_BYTES)  # histories are looked at once more beside what is made of them
    try:
        result = check_study(load_study(study))
    finally:
        keep_records(0)
    show(check_summary(result))
    if not result.determined:
        fail(f"{Status.NOT_IDENTIFIABLE.words} (predicted at the initial values)", NOT_DETERMINED)
    first = "look at the warnings, then " if result.warnings else ""
    say(f"Next: {first}`{command_line('identify', study)}`")

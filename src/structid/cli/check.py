"""The command `structid check`: what a study can determine, before anything is estimated."""

from __future__ import annotations

import math
from statistics import median

from rich.console import RenderableType
from rich.text import Text

from structid.cli.base import NOT_DETERMINED, StudyPath, fail
from structid.cli.tables import groups, heading, new_table, number, show
from structid.estimation import Status
from structid.study.run.check import CheckResult, check_study
from structid.study.run.run import load_study


def check(study: StudyPath) -> None:
    """Read all of a study and say what it can determine: units, sensors, coverage, rank, predicted accuracy.

    Nothing is estimated or written. The exit code is 1 where the data do not determine every parameter.

    \b
    Examples:
      structid check frame.toml
    """
    result = check_study(load_study(study))
    show(_summary(result))
    if not result.determined:
        fail(f"{Status.NOT_IDENTIFIABLE.words} (predicted at the initial values)", NOT_DETERMINED)


def _summary(result: CheckResult) -> list[RenderableType]:
    """What `structid check` says: record, sensors, modes, rank and predicted accuracy."""
    study = result.study
    facts = [
        *(f"record: {words}" for words in result.records),
        f"structure: {study.structure.n_dofs} degrees of freedom, {len(study.structure.elements)} element sets, total mass"
        f" {number(result.total_mass)} kg at the start, predicted standard deviation {number(result.total_mass_std, 2)} kg",
    ]
    channels = new_table("channel", "role", "sees")
    for channel in result.channels:
        channels.add_row(channel.channel, channel.role, channel.seen)
    modes = new_table("mode", "frequency Hz", "damping ratio", "in band", "lines per half-power bandwidth")
    for i, mode in enumerate(result.modes):
        inside = "yes" if mode.in_band else "no"
        lines = number(mode.lines_per_bandwidth, 3) if mode.in_band else ""
        modes.add_row(str(i + 1), number(mode.frequency), number(mode.damping_ratio, 3), inside, lines)
    head = [*heading(study.title, result.warnings), *map(Text, facts), channels, modes]
    if not result.covariance.has_matrix:
        return [*head, Text(_prediction(result))]
    found = result.identifiability
    rank = f"rank {found.rank} of {len(result.names)} parameters from the data alone, condition" + (
        f" {number(found.condition, 3)}; predicted at the"
        " initial values, for a model that is right and errors that are independent from line to line:"
    )
    table = new_table("parameter", "unit", "initial", "predicted std", "relative")
    for name, unit, start, std in zip(result.names, result.units, result.start, result.std, strict=True):
        table.add_row(name, unit, number(start), number(std, 2), number(std / abs(start) if start else math.nan, 2))
    return [*head, Text(rank), table, *groups(found)]


def _prediction(result: CheckResult) -> str:
    """How well very many parameters would be known, in words."""
    relative = (result.std / result.sizes).tolist()
    known = sorted(value for value in relative if math.isfinite(value))
    lost = len(relative) - len(known)
    words = f"{len(relative)} parameters, of which the data determine about {result.identifiability.rank} combinations"
    if known:
        words += (
            f"; predicted standard deviations with the smoothness above: median {number(100 * median(known), 2)} %,"
            f" largest {number(100 * known[-1], 2)} %"
        )
    return words + (f"; {lost} that neither data nor smoothness see" if lost else "")

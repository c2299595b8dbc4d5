"""Output of `structid check`: record, sensors, modes, rank and predicted accuracy, in facts and tables."""

from __future__ import annotations

import math
from statistics import median

from rich.console import RenderableType
from rich.text import Text

from structid.cli.tables import groups, heading, new_table
from structid.core.display import format_number
from structid.core.quantities import unit_text
from structid.study.run.check import CheckResult

#: Warnings that stand first; the others come last.
_MOST_WARNINGS = 5


def check_summary(result: CheckResult) -> list[RenderableType]:
    """Texts and tables that `structid check` prints: record, sensors, modes, rank and predicted standard deviations.

    The first five warnings come after the title, the others last. Without a full covariance matrix, one sentence replaces the
    table of parameters.
    """
    study = result.study
    facts = [
        *(f"record: {words}" for words in result.records),
        f"structure: {study.structure.n_dofs} degrees of freedom, {len(study.structure.elements)} element sets, total mass"
        f" {format_number(result.total_mass)} kg at the start, predicted standard deviation"
        f" {format_number(result.total_mass_std, 2)} kg"
        if study.structure.has_matrices
        else "structure: FRFs of a solver alone, which tell no masses, modes or mesh",
    ]
    facts += study.structure.file_notes
    facts += [] if study.solved is None else list(study.solved.facts)
    facts += [f"{one.title}{fact}" for one in result.beside for fact in one.facts]
    facts += [result.mesh] if isinstance(result.mesh, str) and result.mesh else []
    channels = new_table("channel", "role", "sees")
    for channel in result.channels:
        channels.add_row(channel.channel, channel.role, channel.seen)
    head = [
        *heading(study.title, result.warnings[:_MOST_WARNINGS]),
        *map(Text, facts),
        channels,
        *([_modes(result)] if result.modes else []),
        *_resonances(result),
    ]
    more = [Text(f"also: {one}", style="yellow") for one in result.warnings[_MOST_WARNINGS:]]
    if not result.covariance.has_matrix:
        return [*head, Text(_prediction(result)), *more]
    found = result.identifiability
    rank = f"rank {found.rank} of {len(result.names)} parameters from the data alone, condition" + (
        f" {format_number(found.condition, 3)}; predicted at the"
        f" initial values, for a model that is right and errors that are independent from {_apart(result)}:"
    )
    table = new_table("parameter", "unit", "initial", "predicted std", "relative")
    for name, unit, start, std in zip(result.names, result.units, result.start, result.std, strict=True):
        table.add_row(
            name,
            unit_text(unit),
            format_number(start),
            format_number(std, 2),
            format_number(std / abs(start) if start else math.nan, 2),
        )
    held = [Text(result.assumption)] if result.assumption else []
    return [*head, Text(rank), table, *held, *groups(found), *more]


def _apart(result: CheckResult) -> str:
    """Data between which errors are taken as independent, in words: "line to line" or "mode to mode"."""
    has_lines = not result.modes or any(math.isfinite(mode.lines_per_bandwidth) for mode in result.modes)
    return "line to line" if has_lines else "mode to mode"


def _modes(result: CheckResult) -> RenderableType:
    """Table of the modes of the initial model, with their frequency errors due to the mesh (%) if these are known."""
    by_mesh = {} if isinstance(result.mesh, str) else dict(zip(result.mesh.number, result.mesh.error, strict=True))
    has_lines = any(math.isfinite(mode.lines_per_bandwidth) for mode in result.modes)
    of_lines = ("in band", "lines per half-power bandwidth") if has_lines else ()
    columns = ("mode", "frequency Hz", "damping ratio", *of_lines)
    table = new_table(*columns, *(("off by the mesh %",) if by_mesh else ()))
    for i, mode in enumerate(result.modes):
        lines = format_number(mode.lines_per_bandwidth, 3) if mode.in_band else ""
        off = ((f"{100 * by_mesh[i]:+.2g}" if i in by_mesh else "",)) if by_mesh else ()
        inside = ("yes" if mode.in_band else "no", lines) if has_lines else ()
        table.add_row(str(i + 1), format_number(mode.frequency), format_number(mode.damping_ratio, 3), *inside, *off)
    return table


def _resonances(result: CheckResult) -> list[RenderableType]:
    """Tables of measured resonances beside those of the initial model, one for each record that has any."""
    found: list[RenderableType] = []
    for one in result.beside:
        if not one.resonances:
            continue
        table = new_table(f"{one.title}measured Hz", "model Hz", "model above %", "in half widths", "MAC")
        for pair in one.resonances:
            above = 100 * (pair.model / pair.measured - 1)
            table.add_row(
                format_number(pair.measured) if math.isfinite(pair.measured) else "none",
                format_number(pair.model) if math.isfinite(pair.model) else "none",
                f"{above:+.2g}" if math.isfinite(above) else "",
                f"{pair.half_bandwidths:+.2g}" if math.isfinite(pair.half_bandwidths) else "",
                format_number(pair.mac, 2) if math.isfinite(pair.mac) else "",
            )
        found.append(table)
    return found


def _prediction(result: CheckResult) -> str:
    """Sentence on the predicted standard deviations of very many parameters: median, largest, and number without any."""
    relative = (result.std / result.sizes).tolist()
    known = sorted(value for value in relative if math.isfinite(value))
    lost = len(relative) - len(known)
    words = f"{len(relative)} parameters, of which the data determine about {result.identifiability.rank} combinations"
    if known:
        words += (
            f"; predicted standard deviations with the smoothness above: median {format_number(100 * median(known), 2)} %,"
            f" largest {format_number(100 * known[-1], 2)} %"
        )
    words += f"; {lost} that neither data nor smoothness see" if lost else ""
    return words + (f"; {result.assumption}" if result.assumption else "")

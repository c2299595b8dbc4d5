"""What the command line prints: summaries of an identification, a check and a record, as tables of rich."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from structid.estimation import Identifiability
from structid.estimation.intervals.intervals import span_digits
from structid.identification.identified import Identification
from structid.identification.record_fit import RecordFit
from structid.records import FrfRecord, Record
from structid.reproduce.item import Item
from structid.study.results.changes import PARAMETERS, largest_changes
from structid.study.results.result import StudyResult
from structid.study.run.check import CheckResult

_WIDTH_OF_FILES = 1000
_MOST_GROUPS = 3
_MOST_CHANGES = 10


def standard_output() -> Console:
    """The console of results: as wide as the terminal, and so wide that no line is broken where there is none."""
    console = Console(highlight=False, markup=False, emoji=False)
    return (
        console if console.is_terminal else Console(highlight=False, markup=False, emoji=False, width=_WIDTH_OF_FILES)
    )


def identification_summary(result: StudyResult) -> list[RenderableType]:
    """Warnings, status, parameters, total mass, fit and modes of an identification."""
    found = result.identification
    estimate = found.estimate
    if not estimate.uncertainty.has_matrix:
        return _changes_summary(result)
    table = _table("parameter", "unit", "initial", "value", "std", "95 % interval", "")
    ends = found.intervals.ends
    for i, name in enumerate(estimate.names):
        note = "" if estimate.identified[i] else "not identified"
        numbers = (number(estimate.initial[i]), number(estimate.values[i]), number(estimate.std[i], 2))
        span = " to ".join(number(end, digits) for end, digits in zip(ends[i], span_digits(*ends[i]), strict=True))
        table.add_row(name, estimate.units[i], *numbers, span, note)
    modes = _table("mode", "frequency Hz", "damping ratio")
    for i, (frequency, ratio) in enumerate(zip(found.modes.frequency, found.modes.damping_ratio, strict=True)):
        modes.add_row(str(i + 1), number(frequency), number(ratio, 3))
    peaks = _table("resonance measured Hz", "fitted model Hz")
    for peak in found.resonances:
        peaks.add_row(number(peak.measured), number(peak.predicted))
    identifiability = estimate.identifiability
    facts = [
        f"status: {estimate.status.value} ({estimate.message}, {estimate.n_iterations} iterations)",
        f"rank {identifiability.rank} of {len(estimate.names)} parameters, condition {number(identifiability.condition, 3)}"
        f"; chi-square per degree of freedom {number(estimate.chi_square_per_dof, 3)}"
        f"; standard deviations from {estimate.covariance_basis.replace('_', ' ')}"
        f"; intervals: {found.intervals.kind}",
        *_fit_facts(found.fits),
    ]
    facts += found.intervals.notes
    mass = f"total mass: {number(found.total_mass)} kg, standard deviation {number(found.total_mass_std, 2)} kg"
    shown = [*_pairs(found), *([modes, peaks] if found.resonances else [modes])]
    together = _groups(identifiability)
    return [*_heading(result.study.title, found.warnings), *map(Text, facts), table, *together, Text(mass), *shown]


def _changes_summary(result: StudyResult) -> list[RenderableType]:
    """Warnings, status, the parameters that moved most, total mass and fit of a matrix-free search."""
    found = result.identification
    estimate = found.estimate
    facts = [
        f"status: {estimate.status.value} ({estimate.message}, {estimate.n_iterations} iterations)",
        f"{len(estimate.names)} parameters, the data determine {number(estimate.determined, 3)} combinations of them;"
        f" chi-square per degree of freedom {number(estimate.chi_square_per_dof, 3)}; standard deviations from"
        f" {estimate.covariance_basis.replace('_', ' ')}",
        *_fit_facts(found.fits),
    ]
    table = _table("parameter that moved most", "unit", "initial", "value", "std")
    for i in largest_changes(estimate, _MOST_CHANGES):
        numbers = (number(estimate.initial[i]), number(estimate.values[i]), number(estimate.std[i], 2))
        table.add_row(estimate.names[i], estimate.units[i], *numbers)
    mass = f"total mass: {number(found.total_mass)} kg, standard deviation {number(found.total_mass_std, 2)} kg"
    rest = f"all of them in {PARAMETERS}"
    return [*_heading(result.study.title, found.warnings), *map(Text, facts), table, Text(rest), Text(mass)]


def _fit_facts(fits: Sequence[RecordFit]) -> list[str]:
    """How well responses are fitted."""
    errors = [number(_median(fit.relative_error.ravel().tolist()), 3) for fit in fits]
    if len(fits) == 1:
        judged, used = fits[0].evaluation, fits[0].problem.record
        return [
            f"median relative error of the fit {errors[0]} over {len(judged.frequency)} lines ({len(used.frequency)} of them"
            f" fitted), {len(judged.outputs)} outputs, {len(judged.inputs)} inputs"
        ]
    listed = ", ".join(f"{fit.name} {error}" for fit, error in zip(fits, errors, strict=True))
    return [f"median relative error of the fit: {listed}"] if listed else []


def _pairs(found: Identification) -> list[RenderableType]:
    """Measured modes beside those of the model, and the ratios that a free scale leaves."""
    shown = []
    for fit in found.modal_fits:
        table = _table("measured mode", "Hz", "std", "fitted model Hz", "MAC", "initial model Hz", "initial MAC")
        for i, mode in enumerate(fit.problem.data.measured.tolist()):
            table.add_row(
                str(mode + 1),
                number(fit.measured.frequency[mode]),
                number(fit.problem.data.frequency_std[i], 2),
                number(fit.fitted.frequency[i]),
                number(fit.fitted.mac[i], 3),
                number(fit.initial.frequency[i]),
                number(fit.initial.mac[i], 3),
            )
        shown.append(table)
    if found.ratios is not None:
        table = _table("ratio", "value", "std", "95 % interval")
        rows = zip(found.ratios.names, found.ratios.values, found.ratios.std, found.ratios.ends, strict=True)
        for name, value, std, ends in rows:
            span = f"{number(ends[0])} to {number(ends[1])}"
            table.add_row(f"{name} / {found.ratios.reference}", number(value), number(std, 2), span)
        shown.append(table)
    return [*shown]


def check_summary(result: CheckResult) -> list[RenderableType]:
    """What `structid check` says: record, sensors, modes, rank and predicted accuracy."""
    study = result.study
    facts = [
        *(f"record: {words}" for words in result.records),
        f"structure: {study.structure.n_dofs} degrees of freedom, {len(study.structure.elements)} element sets, total mass"
        f" {number(result.total_mass)} kg at the start, predicted standard deviation {number(result.total_mass_std, 2)} kg",
    ]
    channels = _table("channel", "role", "sees")
    for channel in result.channels:
        channels.add_row(channel.channel, channel.role, channel.seen)
    modes = _table("mode", "frequency Hz", "damping ratio", "in band", "lines per half-power bandwidth")
    for i, mode in enumerate(result.modes):
        inside = "yes" if mode.in_band else "no"
        lines = number(mode.lines_per_bandwidth, 3) if mode.in_band else ""
        modes.add_row(str(i + 1), number(mode.frequency), number(mode.damping_ratio, 3), inside, lines)
    head = [*_heading(study.title, result.warnings), *map(Text, facts), channels, modes]
    if not result.covariance.has_matrix:
        return [*head, Text(_prediction(result))]
    found = result.identifiability
    rank = f"rank {found.rank} of {len(result.names)} parameters from the data alone, condition" + (
        f" {number(found.condition, 3)}; predicted at the"
        " initial values, for a model that is right and errors that are independent from line to line:"
    )
    table = _table("parameter", "unit", "initial", "predicted std", "relative")
    for name, unit, start, std in zip(result.names, result.units, result.start, result.std, strict=True):
        table.add_row(name, unit, number(start), number(std, 2), number(std / abs(start) if start else math.nan, 2))
    return [*head, Text(rank), table, *_groups(found)]


def _prediction(result: CheckResult) -> str:
    """How well very many parameters would be known, in words."""
    relative = (result.std / result.sizes).tolist()
    known = sorted(value for value in relative if math.isfinite(value))
    lost = len(relative) - len(known)
    spread = (
        f"; predicted standard deviations with the smoothness above: median {number(100 * _median(known), 2)} %, largest"
        f" {number(100 * known[-1], 2)} %"
        if known
        else ""
    )
    unseen = f"; {lost} that neither data nor smoothness see" if lost else ""
    return (
        f"{len(relative)} parameters, of which the data determine about {result.identifiability.rank} combinations"
        f"{spread}{unseen}"
    )


def record_summary(record: Record, path: Path) -> str:
    """One line on a record that was written."""
    if isinstance(record, FrfRecord):
        size = (
            f"{record.kind}, {len(record.frequency)} lines, {len(record.outputs)} outputs, {len(record.inputs)} inputs"
        )
    else:
        size = f"time histories, {record.values.shape[0]} samples at {record.sampling_rate:g} Hz"
        size += f", {len(record.channels)} channels"
    return f"{path}: {size}"


def reproduction_summary(items: Iterable[Item]) -> list[RenderableType]:
    """Verdict and largest difference of every table and figure."""
    table = _table("item", "verdict", "largest difference", "title")
    for item in items:
        largest = item.max_abs_difference
        table.add_row(item.name, item.verdict.value, "-" if largest is None else number(largest, 2), item.title)
    return [table]


def number(value: float, digits: int = 5) -> str:
    """A number of `digits` significant digits; a dash where there is none."""
    return f"{value:.{digits}g}" if math.isfinite(value) else ("inf" if math.isinf(value) else "-")


def _heading(title: str, warnings: Iterable[str]) -> list[RenderableType]:
    return [Text(title, style="bold"), *(Text(f"warning: {warning}", style="yellow") for warning in warnings)]


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for i, column in enumerate(columns):
        table.add_column(column, overflow="fold" if i == 0 else "ellipsis")
    return table


def _groups(found: Identifiability) -> list[RenderableType]:
    """The groups of parameters that the data see together, the worst determined ones, in words."""
    return [Text(group.words) for group in found.groups[:_MOST_GROUPS]]


def _median(values: list[float]) -> float:
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2

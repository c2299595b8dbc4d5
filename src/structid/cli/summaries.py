"""Texts and tables that `structid identify` and `structid check` print."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from structid.cli.console import groups, heading, new_table
from structid.core.display import (
    NOTHING,
    exact,
    first_warnings,
    format_number,
    number,
    percent,
    plural,
    prefixed,
    span_text,
    with_std,
)
from structid.identification.alternatives import Alternatives
from structid.identification.identified import Identification
from structid.identification.ratios import ON_FORCE
from structid.study.results.result import UPDATED, StudyResult
from structid.study.results.view import MOST_ADVICE, PARAMETERS, ResultsView
from structid.study.run.diagnosis import FOLDER as SUGGESTIONS

if TYPE_CHECKING:
    from structid.study.run.check import CheckResult

#: Rows of parameters that are printed; those that are not determined come first where there are more.
_MOST_ROWS, _MOST_CHANGES, _MOST_CAUSES = 24, 10, 5
#: Sets of values that stand side by side.
_MOST_SETS = 8
_STYLES = {"sound": "bold green", "approximate": "bold yellow"}
#: Warnings that stand first; the others come last.
_MOST_WARNINGS = 5


def identification_summary(result: StudyResult, is_verbose: bool = False, folder: str = "") -> list[RenderableType]:
    """Texts and tables that `structid identify` prints: verdict, values and next step, with `is_verbose` statistics too.

    `folder` is the results folder, put before the paths of suggested studies; "" leaves these as they are.
    """
    view = result.view
    shown: list[RenderableType] = [
        Text(view.headline, style=_STYLES.get(view.verdict, "bold red")),
        *_values(view),
        *_alternatives(view.identification.alternatives),
        *([Text(view.identification.mesh)] if view.identification.mesh else []),
        Text(f"Next: {_from_here(view.next_step, folder)}"),
        *(Text(f"- {_from_here(words, folder)}") for words in view.advice[:MOST_ADVICE]),
    ]
    if result.solver is not None:
        shown.append(Text(f"{result.solver.check}; the updated deck is in {UPDATED}"))
    if is_verbose:
        return [*shown, *_details(view)]
    return shown


def _from_here(words: str, folder: str) -> str:
    """`words` with the paths of suggested studies from the folder of the call."""
    return words.replace(f"{SUGGESTIONS}/", f"{folder}/{SUGGESTIONS}/") if folder else words


def _values(view: ResultsView) -> list[RenderableType]:
    """List of a table of at most 24 identified values, and of a note on the others if it is cut.

    Undetermined parameters then come first. Without a covariance matrix, the ten parameters that changed most are
    tabled instead.
    """
    if not view.identification.estimate.uncertainty.has_matrix:
        return _changes(view)
    rows = view.listed
    left = len(rows) - _MOST_ROWS
    if left > 0:
        rows = tuple(sorted(rows, key=lambda parameter: parameter.is_determined))[:_MOST_ROWS]
    table = new_table("parameter", "value", "unit", "95 % interval", "state")
    for parameter in rows:
        table.add_row(
            parameter.name, parameter.value_text, parameter.unit_text, parameter.interval_text, parameter.state
        )
    return [table, *([Text(f"and {plural(left, 'more parameter')}: in estimate.json")] if left > 0 else [])]


def _changes(view: ResultsView) -> list[RenderableType]:
    """List of a table of the ten parameters that changed most, and of a note that names the file with all of them.

    It is shown for very many parameters, whose estimate has no covariance matrix.
    """
    table = new_table("parameter that moved most", "initial", "value", "unit")
    for parameter in view.parameters[:_MOST_CHANGES]:
        initial = number(parameter.scaled(parameter.initial))
        table.add_row(parameter.name, initial, parameter.value_text, parameter.unit_text)
    n_params = len(view.identification.estimate.names)
    return [table, Text(f"all {n_params} of them: in {PARAMETERS}")]


def _details(view: ResultsView) -> list[RenderableType]:
    """Texts and tables that follow the values with ``--verbose``, a blank line first.

    They are all warnings, statistics, notes, scatters, collinear groups, causes, standard deviations, modes and
    resonances.
    """
    identification = view.identification
    shown: list[RenderableType] = [
        Text(""),
        *map(Text, first_warnings(identification.warnings, len(identification.warnings))),
    ]
    shown += [Text(f"{label}: {text}") for label, text in view.statistics]
    shown += map(Text, view.notes)
    shown += [
        Text(words)
        for varied in identification.priors.varied
        for words in (f"{varied.words}; each record's value in the results", *varied.outlying_words)
    ]
    shown += [Text(ON_FORCE)] if identification.mass.scale_from_force else []
    return [
        *shown,
        *groups(identification.estimate.identifiability),
        *_causes(view),
        *_spreads(view),
        *_mode_and_ratio_tables(identification),
        *_identified_modes(identification),
    ]


def _alternatives(sets: Alternatives | None) -> list[RenderableType]:
    """A text on the searches, and a table of up to eight sets of values that fit equally well, one column each.

    If a further test could decide between the sets, its predictions are the last row. [] if `sets` is None.
    """
    if sets is None:
        return []
    count = min(len(sets), _MOST_SETS)
    table = new_table("parameter", "unit", *(f"set {k + 1}" for k in range(count)))
    for name, unit, values in zip(sets.names, sets.units, sets.values[:count].T.tolist(), strict=True):
        factor, prefixed_unit = prefixed(unit, *values)
        table.add_row(name, prefixed_unit, *(number(value / factor, 5) for value in values))
    if sets.deciding is not None:
        table.add_row(sets.deciding.name, sets.deciding.unit, *(number(v, 3) for v in sets.deciding.predicted[:count]))
    more = f"; {len(sets) - count} more are in the results" if len(sets) > count else ""
    return [Text(sets.search_words + more), table]


def _causes(view: ResultsView) -> list[RenderableType]:
    """Table of up to five changes of model or record that lower the misfit; [] if there are none."""
    causes = view.diagnosis.named
    if not causes:
        return []
    heading = "cause" if view.diagnosis.causes else "change that lowers the misfit but does not explain it"
    table = new_table(heading, "misfit removed", "chi-square per dof left", "study ready to run")
    for cause in causes[:_MOST_CAUSES]:
        alike = " (the data cannot distinguish it from the first)" if cause.is_alike and cause is not causes[0] else ""
        table.add_row(cause.line + alike, cause.share_text, number(cause.chi_square_per_dof, 3), cause.study)
    return [table]


def _spreads(view: ResultsView) -> list[RenderableType]:
    """Table of initial values and standard deviations, also from noise alone; [] without a covariance matrix."""
    if not view.identification.estimate.uncertainty.has_matrix:
        return []
    table = new_table("parameter", "unit", "initial", "std", "std from noise alone")
    for parameter in view.listed:
        numbers = (parameter.scaled(value) for value in (parameter.initial, parameter.std, parameter.std_noise))
        initial, std, std_noise = (number(value, digits) for value, digits in zip(numbers, (5, 2, 2), strict=True))
        table.add_row(parameter.name, parameter.unit_text or NOTHING, initial, std, std_noise)
    return [table]


def _identified_modes(identification: Identification) -> list[RenderableType]:
    """Tables of the identified model's modes and of its resonances (Hz) beside the measured ones.

    A table is left out if there are none; modes are numbered from 1.
    """
    shown: list[RenderableType] = []
    if len(identification.modes.frequency):
        table = new_table("mode", "frequency Hz", "damping ratio")
        pairs = zip(identification.modes.frequency.tolist(), identification.modes.damping_ratio.tolist(), strict=True)
        for i, (frequency, ratio) in enumerate(pairs, 1):
            table.add_row(str(i), number(frequency, 5), percent(ratio, 3, signed=False))
        shown.append(table)
    if identification.resonances:
        table = new_table("resonance measured Hz", "fitted model Hz")
        for peak in identification.resonances:
            table.add_row(number(peak.measured, 5), number(peak.predicted, 5))
        shown.append(table)
    return shown


def _mode_and_ratio_tables(identification: Identification) -> list[RenderableType]:
    """Tables of measured modes beside those of fitted and initial model, one for each modal record, and of parameter ratios.

    Ratios are shown if the data leave the scale of the parameters free.
    """
    shown: list[RenderableType] = []
    for fit in identification.modal_fits:
        table = new_table("measured mode", "Hz", "fitted model Hz", "MAC", "initial model Hz", "initial MAC")
        for i, mode in enumerate(fit.problem.data.measured.tolist()):
            table.add_row(
                str(mode + 1),
                with_std(float(fit.measured.frequency[mode]), float(fit.problem.data.frequency_std[i])),
                number(float(fit.fitted.frequency[i]), 5),
                number(float(fit.fitted.mac[i]), 3),
                number(float(fit.initial.frequency[i]), 5),
                number(float(fit.initial.mac[i]), 3),
            )
        shown.append(table)
    if identification.mass.ratios is not None:
        table = new_table("ratio", "value", "95 % interval")
        rows = zip(
            identification.mass.ratios.names,
            identification.mass.ratios.values,
            identification.mass.ratios.std,
            identification.mass.ratios.ends.tolist(),
            strict=True,
        )
        for name, value, std, ends in rows:
            table.add_row(
                f"{name} / {identification.mass.ratios.reference}", with_std(float(value), float(std)), span_text(*ends)
            )
        shown.append(table)
    return shown


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
    facts += [f"mesh: {result.division}"] if result.division else []
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
        *([_initial_modes(result)] if result.modes else []),
        *_resonances(result),
    ]
    more = [Text(f"also: {one}", style="yellow") for one in result.warnings[_MOST_WARNINGS:]]
    if not result.covariance.has_matrix:
        return [*head, Text(_prediction(result)), *more]
    identifiability = result.identifiability
    rank = (
        f"rank {identifiability.rank} of {len(result.names)} parameters from the data alone (condition number"
        f" {format_number(identifiability.condition, 3)}). Standard deviations (std) predicted at the initial values, if the model"
        f" is right and errors are independent from {_apart(result)}:"
    )
    table = new_table("parameter", "initial", "predicted std", "unit", "relative")
    for name, unit, start, std in zip(result.names, result.units, result.start, result.std, strict=True):
        factor, prefixed_unit = prefixed(unit, start)
        relative = percent(std / abs(start), 2, signed=False) if start else NOTHING
        table.add_row(name, exact(start / factor), number(std / factor, 2), prefixed_unit, relative)
    assumptions = [Text(result.assumption)] if result.assumption else []
    return [*head, Text(rank), table, *assumptions, *groups(identifiability), *more]


def _apart(result: CheckResult) -> str:
    """Data between which errors are taken as independent, in words: "line to line" or "mode to mode"."""
    has_lines = not result.modes or any(math.isfinite(mode.lines_per_bandwidth) for mode in result.modes)
    return "line to line" if has_lines else "mode to mode"


def _initial_modes(result: CheckResult) -> RenderableType:
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
    """Tables of measured resonances (Hz) beside those of the initial model, one for each record that has any.

    How far the model's lies above the measured one is in % and in half resonance widths; then follows the MAC. A
    frequency that is not finite is "none", another value that is not is left blank.
    """
    tables: list[RenderableType] = []
    for one in result.beside:
        if not one.resonances:
            continue
        table = new_table(f"{one.title}measured Hz", "model Hz", "model above %", "in half resonance widths", "MAC")
        for pair in one.resonances:
            above = 100 * (pair.model / pair.measured - 1)
            table.add_row(
                format_number(pair.measured) if math.isfinite(pair.measured) else "none",
                format_number(pair.model) if math.isfinite(pair.model) else "none",
                f"{above:+.2g}" if math.isfinite(above) else "",
                f"{pair.half_bandwidths:+.2g}" if math.isfinite(pair.half_bandwidths) else "",
                format_number(pair.mac, 2) if math.isfinite(pair.mac) else "",
            )
        tables.append(table)
    return tables


def _prediction(result: CheckResult) -> str:
    """Sentence on the predicted standard deviations of very many parameters: median, largest, and number without any."""
    relative = (result.std / result.sizes).tolist()
    finite = sorted(value for value in relative if math.isfinite(value))
    lost = len(relative) - len(finite)
    words = f"{len(relative)} parameters, of which the data determine about {result.identifiability.rank} combinations"
    if finite:
        words += (
            f"; predicted standard deviations with the smoothness above: median {format_number(100 * median(finite), 2)} %,"
            f" largest {format_number(100 * finite[-1], 2)} %"
        )
    words += f"; {lost} that neither data nor smoothness see" if lost else ""
    return words + (f"; {result.assumption}" if result.assumption else "")

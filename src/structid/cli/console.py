"""What `structid identify` prints: the answer in facts and tables."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from rich.console import RenderableType
from rich.text import Text

from structid.cli.tables import groups, heading, new_table
from structid.core.display import MOST_WARNINGS, format_number
from structid.diagnose.fixed_value_influence import resting_words
from structid.identification.alternatives import Alternatives
from structid.identification.fits.ratios import ON_FORCE
from structid.identification.fits.record_fit import RecordFit
from structid.identification.identified import Identification
from structid.inversion.intervals.intervals import span_digits
from structid.study.results.changes import PARAMETERS, largest_changes
from structid.study.results.result import StudyResult
from structid.study.results.solver import UPDATED

_MOST_CHANGES = 10
_MOST_CAUSES = 5
#: Sets of values that stand side by side.
_MOST_SETS = 8
#: Beside the verdict, which is the first of what is told.
_MOST_BESIDE = MOST_WARNINGS - 1


def identification_summary(result: StudyResult) -> list[RenderableType]:
    """Warnings, status, parameters, total mass, fit and modes of an identification."""
    found = result.identification
    estimate = found.estimate
    if not estimate.uncertainty.has_matrix:
        return _changes_summary(result)
    table = new_table("parameter", "unit", "initial", "value", "std", "noise alone", "95 % interval", "")
    ends = found.intervals.ends
    notes = {one.index: f"at its {one.side} bound" for one in estimate.at_bound}
    notes |= dict.fromkeys(found.ran_away, "ran away")
    for i in found.listed:
        name = estimate.names[i]
        note = notes.get(i) or ("" if estimate.identified[i] else "not identified")
        spreads = (format_number(estimate.std[i], 2), format_number(estimate.std_noise[i], 2))
        numbers = (format_number(estimate.initial[i]), format_number(estimate.values[i]), *spreads)
        span = " to ".join(
            format_number(end, digits) for end, digits in zip(ends[i], span_digits(*ends[i]), strict=True)
        )
        table.add_row(name, estimate.units[i], *numbers, span, note)
    modes = new_table("mode", "frequency Hz", "damping ratio")
    for i, (frequency, ratio) in enumerate(zip(found.modes.frequency, found.modes.damping_ratio, strict=True)):
        modes.add_row(str(i + 1), format_number(frequency), format_number(ratio, 3))
    peaks = new_table("resonance measured Hz", "fitted model Hz")
    for peak in found.resonances:
        peaks.add_row(format_number(peak.measured), format_number(peak.predicted))
    identifiability = estimate.identifiability
    facts = [
        f"status: {estimate.status.value} ({estimate.message}, {estimate.n_iterations} iterations)",
        f"rank {identifiability.rank} of {identifiability.n_free}{' free' if estimate.at_bound else ''} parameters, condition"
        f" {format_number(identifiability.condition, 3)}"
        f"; {estimate.misfit_words}"
        f"; standard deviations from {estimate.covariance_basis.replace('_', ' ')}"
        f"; intervals: {found.intervals.kind}",
        *_fit_facts(found.fits),
    ]
    facts += found.intervals.notes
    facts += [
        words
        for one in found.varied
        for words in (f"{one.words}; each record's own in the results", *one.outlying_words)
    ]
    mass = f"total mass: {format_number(found.total_mass)} kg, standard deviation {format_number(found.total_mass_std, 2)} kg"
    tables = ([modes] if modes.row_count else []) + ([peaks] if found.resonances else [])
    shown = [*_alternatives(found.alternatives), *_pairs(found), *tables]
    together = groups(identifiability)
    head = [*_verdict(result), *heading(result.study.title, found.warnings, _MOST_BESIDE)]
    after = [found.assumption, *([mass] if found.total_mass > 0 else [])]
    after += [ON_FORCE] if found.rests_on_force else []
    after += (
        [words] if (words := resting_words(() if result.diagnosis is None else result.diagnosis.sensitivities)) else []
    )
    if result.solver is not None:
        after.append(f"{result.solver.check}; the updated deck is in {UPDATED}")
    return [*head, *map(Text, facts), table, Text(after[0]), *together, *map(Text, after[1:]), *shown]


def _verdict(result: StudyResult) -> list[RenderableType]:
    """The verdict, and the causes of a misfit."""
    if result.diagnosis is None:
        return []
    judgement = result.diagnosis.judgement
    causes = result.diagnosis.named
    style = {"sound": "bold green", "approximate": "bold yellow"}.get(judgement.verdict, "bold red")
    shown: list[RenderableType] = [Text(judgement.words, style=style)]
    if causes:
        table = new_table(
            "cause" if result.diagnosis.causes else "change that lowers the misfit",
            "misfit removed",
            "chi-square per dof left",
            "study ready to run",
        )
        for cause in causes[:_MOST_CAUSES]:
            alike = " (cannot be told from the first)" if cause.is_alike and cause is not causes[0] else ""
            row = f"{100 * cause.share:.1f} %", format_number(cause.chi_square_per_dof, 3), cause.study
            table.add_row(cause.line + alike, *row)
        shown.append(table)
    return shown


def _alternatives(sets: Alternatives | None) -> list[RenderableType]:
    """Sets of values that fit the data equally well, one a column."""
    if sets is None:
        return []
    count = min(len(sets), _MOST_SETS)
    table = new_table("parameter", "unit", *(f"set {k + 1}" for k in range(count)))
    for name, unit, values in zip(sets.names, sets.units, sets.values[:count].T.tolist(), strict=True):
        table.add_row(name, unit, *(format_number(value) for value in values))
    if sets.deciding is not None:
        table.add_row(
            sets.deciding.name, sets.deciding.unit, *(format_number(v, 3) for v in sets.deciding.predicted[:count])
        )
    more = f"; {len(sets) - count} more are in the results" if len(sets) > count else ""
    return [Text(sets.search_words + more), table]


def _changes_summary(result: StudyResult) -> list[RenderableType]:
    """Warnings, status, the parameters that moved most, total mass and fit of a matrix-free search."""
    found = result.identification
    estimate = found.estimate
    facts = [
        f"status: {estimate.status.value} ({estimate.message}, {estimate.n_iterations} iterations)",
        f"{len(estimate.names)} parameters, the data determine {format_number(estimate.determined, 3)} combinations of them;"
        f" {estimate.misfit_words}; standard deviations from"
        f" {estimate.covariance_basis.replace('_', ' ')}",
        *_fit_facts(found.fits),
    ]
    table = new_table("parameter that moved most", "unit", "initial", "value", "std")
    for i in largest_changes(estimate, _MOST_CHANGES):
        numbers = (
            format_number(estimate.initial[i]),
            format_number(estimate.values[i]),
            format_number(estimate.std[i], 2),
        )
        table.add_row(estimate.names[i], estimate.units[i], *numbers)
    mass = f"total mass: {format_number(found.total_mass)} kg, standard deviation {format_number(found.total_mass_std, 2)} kg"
    rest = f"all of them in {PARAMETERS}"
    head = [*_verdict(result), *heading(result.study.title, found.warnings, _MOST_BESIDE)]
    return [*head, *map(Text, facts), table, Text(found.assumption), Text(rest), Text(mass)]


def _fit_facts(fits: Sequence[RecordFit]) -> list[str]:
    """How well responses are fitted."""
    errors = [format_number(median(fit.relative_error.ravel().tolist()), 3) for fit in fits]
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
        table = new_table("measured mode", "Hz", "std", "fitted model Hz", "MAC", "initial model Hz", "initial MAC")
        for i, mode in enumerate(fit.problem.data.measured.tolist()):
            table.add_row(
                str(mode + 1),
                format_number(fit.measured.frequency[mode]),
                format_number(fit.problem.data.frequency_std[i], 2),
                format_number(fit.fitted.frequency[i]),
                format_number(fit.fitted.mac[i], 3),
                format_number(fit.initial.frequency[i]),
                format_number(fit.initial.mac[i], 3),
            )
        shown.append(table)
    if found.ratios is not None:
        table = new_table("ratio", "value", "std", "95 % interval")
        rows = zip(found.ratios.names, found.ratios.values, found.ratios.std, found.ratios.ends, strict=True)
        for name, value, std, ends in rows:
            span = f"{format_number(ends[0])} to {format_number(ends[1])}"
            table.add_row(f"{name} / {found.ratios.reference}", format_number(value), format_number(std, 2), span)
        shown.append(table)
    return [*shown]

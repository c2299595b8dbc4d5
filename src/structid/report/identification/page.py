"""The report of an identification: one page that needs no network."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from structid.core.display import plural
from structid.core.quantities import NOTHING, number, percent, with_unit
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, resting
from structid.diagnose.verdict import Cause, Diagnosis
from structid.identification.identified import Identification
from structid.report.correlation import side_by_side_chapter
from structid.report.drawing.changes import shadings
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.modes import band_used, modal_fit_figure, mode_rows, modes_figure
from structid.report.figures.parameters import convergence_figure, correlation_figure, parameters_figure
from structid.report.figures.responses import (
    extremes_figure,
    residual_channels_figure,
    residual_map_figure,
    responses_figure,
)
from structid.report.figures.side_by_side import model_shapes_figure
from structid.report.figures.structure import structure_figure
from structid.report.identification import tables
from structid.report.identification.tables import modal_cards, modal_facts, modal_table, ratio_table
from structid.report.page import Page
from structid.report.rendering import plot
from structid.report.tables import Table, provenance_table
from structid.study.results.view import MOST_ADVICE, ResultsView, results_view

#: Endings that introduce a warning which repeats what the table of parameters says for each parameter.
_REPEATED = re.compile(r"is not identified: (at the initial values )?its standard deviation is larger than its value$")
_MOST_REPEATED, _MOST_GROUPS = 4, 8
_MARKS = {"sound": "good", "approximate": "doubt", "wrong_model": "bad", "undetermined": "bad", "untested": "bad"}
_FIXED_VALUE_COLUMNS = (
    "Fixed value",
    "Parameter that 1 % more of it moves most",
    "by",
    "in standard deviations",
    "The record would change it by",
)
#: Standard deviations by which 1 % of a fixed value moves a parameter from where on the page lists it.
_TELLING = 0.1
_HEADER = ("Cause", "Misfit removed", "Chi-square per degree of freedom left", "What it adds", "Value that moves most")


def write_report(
    identification: Identification,
    folder: Path,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    png: bool = False,
    diagnosis: Diagnosis | None = None,
) -> Path:
    """Write the report page of an identification, ``report.html``, into `folder`, and return its path.

    Parameters
    ----------
    identification : Identification
        Result to report; also if the search failed or the parameters are not determined.
    folder : Path
        Created if missing. Files of the same names are replaced, each whole or not at all.
    title : str
        Heading of the page.
    provenance : mapping, optional
        Versions, digests of input files, settings: shown as they are at the end.
    png : bool
        True to write the figures as PNG files too, into ``figures``.
    diagnosis : Diagnosis, optional
        Verdict and possible causes of a misfit; without it the verdict is made here.

    Returns
    -------
    Path
        The page. The same identification gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    return report_page(identification, title, provenance, diagnosis).write(folder, png)


def report_page(
    identification: Identification,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    diagnosis: Diagnosis | None = None,
) -> Page:
    """Report page of an identification, with its figures.

    `provenance` has versions, digests and settings for a table; without a diagnosis the verdict is made here, and no causes
    are shown. An empty `title` becomes "Structural identification".
    """
    view = results_view(identification, diagnosis, title or "Structural identification", provenance)
    found, structure = identification.estimate, identification.structure
    drawn = structure_picture(structure, identification.sensors, identification.loads)
    band = band_used(identification.fits[:1], identification.modal_fits)
    rows = mode_rows(identification)
    n_records = len(identification.fits) + len(identification.modal_fits)
    warnings, repeated = sorted_warnings(identification)
    side_by_side, beside_model = side_by_side_chapter(identification)
    figures = {
        **({"extremes": extremes_figure(identification.fits[0])} if identification.fits else {}),
        "parameters": parameters_figure(identification),
        "structure": structure_figure(drawn, shadings(identification)),
        **_record_figures(identification),
        **{f"modal_fit_{k}": modal_fit_figure(fit) for k, fit in enumerate(identification.modal_fits, 1)},
        **side_by_side,
        "correlation": correlation_figure(identification),
        **({"modes": modes_figure(rows, band)} if len(rows.frequency) else {}),
        "convergence": convergence_figure(identification),
    }
    shapes = model_shapes_figure(structure, identification.modes)
    figures |= {} if shapes is None else {"shapes": shapes}
    words = {
        "title": view.title,
        **verdict_words(view),
        "values": tables.value_table(view),
        "status": found.status.value,
        "status_words": _status_warning(identification),
        "warnings": warnings,
        "repeated": repeated,
        "directions": tables.direction_table(found),
        "groups": [group.words for group in found.identifiability.groups[:_MOST_GROUPS]],
        "summary": (*tables.summary_facts(identification), *modal_cards(identification)),
        "record": tables.record_facts(identification) if identification.fits else (),
        "modal": [_modal(identification, index) for index in range(len(identification.modal_fits))],
        "ratios": ratio_table(identification),
        "structure": (
            *tables.structure_facts(structure),
            *(("Error of reduction", one.words) for one in identification.truncations),
        ),
        "elements": tables.element_table(structure),
        "parameters": tables.parameter_table(view),
        "alternatives": None
        if identification.alternatives is None
        else (identification.alternatives.search_words, tables.alternatives_table(identification.alternatives)),
        "varied": [
            (one.words, one.outlying_words, tables.varied_table(identification, one))
            for one in identification.priors.varied
        ],
        "intervals": tables.interval_words(identification),
        "interval_notes": view.notes,
        "residual_tests": tables.residual_table(found),
        "residual_words": () if found.goodness.residual_tests is None else found.goodness.residual_tests.words,
        "modes": tables.mode_table(rows, band) if len(rows.frequency) else None,
        "resonances": tables.resonance_table(identification.resonances) if identification.resonances else None,
        "stages": tables.stage_table(found),
        "provenance": provenance_table(view.provenance),
        "has_responses": bool(identification.fits),
        "first": identification.fits[0].name if identification.fits and n_records > 1 else "",
        "others": [_other(identification, index) for index in range(1, len(identification.fits))],
        "notes": drawn.notes,
        "beside_model": beside_model,
    }
    return Page("report.html", "report.html.j2", figures, words)


def _record_figures(identification: Identification) -> dict[str, plot.Figure]:
    """Figures by name: responses and residuals of every record of responses, and a residual map of the first."""
    figures = {}
    for count, fit in enumerate(identification.fits, 1):
        prefix = f"record_{count}_" if count > 1 else ""
        figures[f"{prefix}frf"] = responses_figure(fit)
        figures[f"{prefix}residual_by_channel"] = residual_channels_figure(fit)
        if count == 1:
            figures["residual_map"] = residual_map_figure(fit)
    return figures


def _modal(identification: Identification, index: int) -> dict[str, object]:
    """Template values for record `index` (from 0) of the records of modes."""
    fit = identification.modal_fits[index]
    is_unknown = any(kind == "mass" for kind in fit.problem.unknowns.kinds)
    return {
        "number": index + 1,
        "title": fit.name,
        "facts": modal_facts(fit, is_unknown),
        "table": modal_table(fit),
        "passed_over": ", ".join(f"{f:.5g}" for f in fit.fitted.passed_over),
    }


def _other(identification: Identification, index: int) -> dict[str, object]:
    """Template values for record `index` (from 0) of the records of responses."""
    part = identification.seen_from(index)
    return {
        "number": index + 1,
        "title": part.fits[0].name,
        "facts": tables.record_facts(part),
        "resonances": tables.resonance_table(part.resonances) if part.resonances else None,
    }


def sorted_warnings(identification: Identification) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Warnings to be shown one by one, and those that repeat one message for many parameters, as two tuples.

    The status and the undetermined directions have places of their own and are in neither. A few repetitions stay in the first.
    """
    estimate = identification.estimate
    elsewhere = {f"the data determine {d.words}" for d in estimate.identifiability.directions}
    elsewhere.add(_status_warning(identification))
    rest = [w for w in identification.warnings if w not in elsewhere]
    repeated = [w for w in rest if _REPEATED.search(w)]
    if len(repeated) <= _MOST_REPEATED:
        return tuple(rest), ()
    return tuple(w for w in rest if w not in repeated), tuple(repeated)


def _status_warning(identification: Identification) -> str:
    estimate = identification.estimate
    return f"{estimate.status_words} ({estimate.message})"


def verdict_words(view: ResultsView) -> dict[str, object]:
    """Template values, by key, for the verdict, its reasons, possible causes, suggested studies and fixed values."""
    diagnosis = view.diagnosis
    causes = diagnosis.named
    table = Table(_HEADER, tuple(_row(cause, causes[0]) for cause in causes), (1, 2)) if causes else None
    telling = [one for one in diagnosis.sensitivities if abs(one.distance[one.most_moved]) >= _TELLING]
    return {
        "verdict": {
            "words": view.headline,
            "mark": _MARKS[view.verdict],
            "next_step": view.next_step,
            "advice": view.advice[:MOST_ADVICE],
            "more": view.advice[MOST_ADVICE:],
        },
        "reasons": diagnosis.judgement.reasons,
        "causes": table if diagnosis.causes else None,
        "lowering": None if diagnosis.causes else table,
        "studies": [(cause.line, cause.study, "\n".join(cause.lines)) for cause in causes if cause.study],
        "tried": f"{plural(diagnosis.n_tried, 'change')} of model and record tried" if diagnosis.n_tried else "",
        "held": fixed_value_table(telling) if telling else None,
        "held_left": plural(len(diagnosis.sensitivities) - len(telling), "fixed value")
        if len(telling) < len(diagnosis.sensitivities)
        else "",
    }


def fixed_value_table(sensitivities: Sequence[FixedValueSensitivity]) -> Table:
    """Sensitivity of the values to what the model fixes, that which moves a value farthest first."""
    return Table(_FIXED_VALUE_COLUMNS, tuple(_fixed_value_row(one) for one in resting(sensitivities)), (2, 3, 4))


def _fixed_value_row(sensitivity: FixedValueSensitivity) -> tuple[str, ...]:
    largest = sensitivity.most_moved
    pull = (
        f"{percent(sensitivity.pull, 2)} ± {percent(sensitivity.pull_std, 2, signed=False)}"
        if sensitivity.pull_std > 0
        else NOTHING
    )
    return (
        sensitivity.name,
        sensitivity.parameters[largest],
        percent(0.01 * sensitivity.influence[largest], 2),
        number(abs(sensitivity.distance[largest]), 2),
        pull,
    )


def _row(cause: Cause, first: Cause) -> tuple[str, ...]:
    """Table row of one possible cause: text, share of misfit explained, chi-square, added parameters, largest change.

    `first` is the first cause, to which `cause` may be alike.
    """
    alike = " (the data cannot distinguish it from the first)" if cause.is_alike and cause is not first else ""
    added = ", ".join(f"{name} = {with_unit(number(value), unit)}" for name, value, unit in cause.found)
    moved = ""
    if cause.moved:
        one = cause.moved[0]
        moved = f"{one.name}: {number(one.before)} to {with_unit(number(one.after), one.unit)}"
    return cause.line + alike, cause.share_text, number(cause.chi_square_per_dof, 3), added, moved

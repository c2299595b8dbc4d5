"""The report of an identification: one page that needs no network."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from structid.criticism.verdict import Criticism
from structid.estimation import Status
from structid.identification.identified import Identification
from structid.report.correlation import side_by_side_chapter
from structid.report.drawing.changes import shadings
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.modes import band_used, modal_fit_figure, mode_rows, modes_figure
from structid.report.figures.parameters import convergence_figure, correlation_figure, parameters_figure
from structid.report.figures.responses import residual_channels_figure, residual_map_figure, responses_figure
from structid.report.figures.structure import structure_figure
from structid.report.identification import tables
from structid.report.identification.modal_tables import modal_cards, modal_facts, modal_table, ratio_table
from structid.report.identification.verdict import verdict_words
from structid.report.page import Page
from structid.report.rendering import plot
from structid.report.tables import provenance_facts

#: Endings that introduce a warning which repeats what the table of parameters says for each parameter.
_REPEATED = re.compile(r"is not identified: (at the initial values )?its standard deviation is larger than its value$")
_MOST_REPEATED, _MOST_GROUPS = 4, 8


def write_report(
    identification: Identification,
    folder: Path,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    png: bool = False,
    criticism: Criticism | None = None,
) -> Path:
    """Path of ``report.html`` in `folder`.

    Parameters
    ----------
    identification : Identification
        What was identified; also one that failed or is not determined.
    folder : Path
        Made where it does not exist. Files of the same names are replaced, each whole or not at all.
    title : str
        Heading of the page.
    provenance : mapping, optional
        Versions, digests of input files, settings: shown as they are at the end.
    png : bool
        Whether the figures are written as PNG files too, in ``figures``.
    criticism : Criticism, optional
        Whether the answer is to be trusted, and what would explain a misfit.

    Returns
    -------
    Path
        The page. The same identification gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    return report_page(identification, title, provenance, criticism).write(folder, png)


def report_page(
    identification: Identification,
    title: str = "",
    provenance: Mapping[str, object] | None = None,
    criticism: Criticism | None = None,
) -> Page:
    """The page and its figures."""
    found, structure = identification.estimate, identification.structure
    drawn = structure_picture(structure, identification.sensors, identification.loads)
    band = band_used(identification.fits[:1], identification.modal_fits)
    rows = mode_rows(identification)
    n_records = len(identification.fits) + len(identification.modal_fits)
    warnings, repeated = sorted_warnings(identification)
    side_by_side, beside_model = side_by_side_chapter(identification)
    figures = {
        "parameters": parameters_figure(identification),
        "structure": structure_figure(drawn, shadings(identification)),
        **_record_figures(identification),
        **{f"modal_fit_{k}": modal_fit_figure(fit) for k, fit in enumerate(identification.modal_fits, 1)},
        **side_by_side,
        "correlation": correlation_figure(identification),
        **({"modes": modes_figure(rows, band)} if len(rows.frequency) else {}),
        "convergence": convergence_figure(identification),
    }
    words = {
        "title": title or "Structural identification",
        **verdict_words(criticism),
        "status": found.status.value,
        "status_words": _status_warning(identification),
        "is_good": found.status is Status.CONVERGED and not identification.warnings,
        "warnings": warnings,
        "repeated": repeated,
        "directions": tables.direction_table(found),
        "groups": [group.words for group in found.identifiability.groups[:_MOST_GROUPS]],
        "summary": (*tables.summary_facts(identification), *modal_cards(identification)),
        "record": tables.record_facts(identification) if identification.fits else (),
        "modal": [_modal(identification, number) for number in range(len(identification.modal_fits))],
        "ratios": ratio_table(identification),
        "structure": (
            *tables.structure_facts(structure),
            *(("Error of reduction", one.words) for one in identification.truncations),
        ),
        "elements": tables.element_table(structure),
        "parameters": tables.parameter_table(identification),
        "varied": [
            (one.words, one.outlying_words, tables.varied_table(identification, one)) for one in identification.varied
        ],
        "intervals": tables.interval_words(identification),
        "interval_notes": identification.intervals.notes,
        "residual_tests": tables.residual_table(found),
        "residual_words": () if found.residual_tests is None else found.residual_tests.words,
        "modes": tables.mode_table(rows, band) if len(rows.frequency) else None,
        "resonances": tables.resonance_table(identification.resonances) if identification.resonances else None,
        "provenance": provenance_facts(provenance),
        "has_responses": bool(identification.fits),
        "first": identification.fits[0].name if identification.fits and n_records > 1 else "",
        "others": [_other(identification, number) for number in range(1, len(identification.fits))],
        "notes": drawn.notes,
        "beside_model": beside_model,
    }
    return Page("report.html", "report.html.j2", figures, words)


def _record_figures(identification: Identification) -> dict[str, plot.Figure]:
    """Responses and residuals of every record, the map of the first."""
    figures = {}
    for number, fit in enumerate(identification.fits, 1):
        prefix = f"record_{number}_" if number > 1 else ""
        figures[f"{prefix}frf"] = responses_figure(fit)
        figures[f"{prefix}residual_by_channel"] = residual_channels_figure(fit)
        if number == 1:
            figures["residual_map"] = residual_map_figure(fit)
    return figures


def _modal(identification: Identification, number: int) -> dict[str, object]:
    """What the page shows of a record of modes."""
    fit = identification.modal_fits[number]
    is_unknown = any(kind == "mass" for kind in fit.problem.kinds)
    return {
        "number": number + 1,
        "title": fit.name,
        "facts": modal_facts(fit, is_unknown),
        "table": modal_table(fit),
        "passed_over": ", ".join(f"{f:.5g}" for f in fit.fitted.passed_over),
    }


def _other(identification: Identification, number: int) -> dict[str, object]:
    """What the page shows of a further record."""
    part = identification.seen_from(number)
    return {
        "number": number + 1,
        "title": part.fits[0].name,
        "facts": tables.record_facts(part),
        "resonances": tables.resonance_table(part.resonances) if part.resonances else None,
    }


def sorted_warnings(identification: Identification) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Warnings of `identification` that stand apart, and those that say the same of one parameter after another.

    The status and the undetermined directions have places of their own and are in neither.
    """
    found = identification.estimate
    elsewhere = {f"the data determine {d.words}" for d in found.identifiability.directions}
    elsewhere.add(_status_warning(identification))
    rest = [w for w in identification.warnings if w not in elsewhere]
    repeated = [w for w in rest if _REPEATED.search(w)]
    if len(repeated) <= _MOST_REPEATED:
        return tuple(rest), ()
    return tuple(w for w in rest if w not in repeated), tuple(repeated)


def _status_warning(identification: Identification) -> str:
    found = identification.estimate
    return f"{found.status_words} ({found.message})"

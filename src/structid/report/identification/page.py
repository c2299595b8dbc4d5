"""The report: one page that needs no network, and its figures as PNG files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from structid._version import __version__
from structid.estimation import Status
from structid.files import atomic_write, made_folder
from structid.identification.identified import Identification
from structid.report.drawing.drawing import picture
from structid.report.drawing.picture import Picture
from structid.report.figures.data import Responses, band_used, mode_rows, responses
from structid.report.figures.interactive import page_figures
from structid.report.figures.modal_data import modal_cards, modal_facts, modal_table, ratio_table
from structid.report.figures.png import write_figures
from structid.report.identification import tables
from structid.report.page_template import page_template

#: Endings that introduce a warning which repeats what the table of parameters says for each parameter.
_REPEATED = re.compile(r"is not identified: (at the initial values )?its standard deviation is larger than its value$")
_MOST_REPEATED, _MOST_GROUPS = 4, 8


def write_report(
    identification: Identification, folder: Path, title: str = "", provenance: Mapping[str, Any] | None = None
) -> Path:
    """Path of ``report.html`` in `folder`, written with the PNG figures in ``figures``.

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

    Returns
    -------
    Path
        The page. The same identification gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    folder = Path(folder)
    figures = made_folder(folder / "figures")
    drawn = picture(identification)
    data = responses(identification.fits[0]) if identification.fits else None
    write_figures(identification, data, drawn, figures)
    path = folder / "report.html"
    text = page(identification, data, drawn, title, provenance)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page(
    identification: Identification,
    data: Responses | None,
    drawn: Picture,
    title: str = "",
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """The page as text."""
    found, structure = identification.estimate, identification.structure
    rows = mode_rows(identification)
    n_records = len(identification.fits) + len(identification.modal_fits)
    figures = page_figures(identification, data, drawn)
    warnings, repeated = sorted_warnings(identification)
    return page_template("report.html.j2").render(
        title=title or "Structural identification",
        version=__version__,
        status=found.status.value,
        status_words=_status_warning(identification),
        is_good=found.status is Status.CONVERGED and not identification.warnings,
        warnings=warnings,
        repeated=repeated,
        directions=tables.direction_table(found),
        groups=[group.words for group in found.identifiability.groups[:_MOST_GROUPS]],
        summary=(*tables.summary_facts(identification), *modal_cards(identification)),
        record=tables.record_facts(identification) if data else (),
        modal=[_modal(identification, number) for number in range(len(identification.modal_fits))],
        ratios=ratio_table(identification),
        structure=tables.structure_facts(structure),
        elements=tables.element_table(structure),
        parameters=tables.parameter_table(identification),
        intervals=tables.interval_words(identification),
        interval_notes=identification.intervals.notes,
        residual_tests=tables.residual_table(found),
        residual_words=() if found.residual_tests is None else found.residual_tests.words,
        modes=tables.mode_table(rows, band_used(identification, data)),
        resonances=tables.resonance_table(identification.resonances) if identification.resonances else None,
        provenance=tables.provenance_facts(provenance),
        channels=[channel.label for channel in data.channels] if data else [],
        first=identification.fits[0].name if data and n_records > 1 else "",
        others=[_other(identification, number) for number in range(1, len(identification.fits))],
        notes=drawn.notes,
        figures=figures,
        structure_figures=[name for name in figures if name.startswith("structure")],
        is_wide=drawn.is_wide,
        is_long=tables.is_long,
        plotly=get_plotlyjs(),
        described=embedded({name: figure.described() for name, figure in figures.items()}),
    )


def _modal(identification: Identification, number: int) -> dict[str, Any]:
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


def _other(identification: Identification, number: int) -> dict[str, Any]:
    """What the page shows of a further record."""
    part = identification.seen_from(number)
    return {
        "number": number + 1,
        "title": part.fits[0].name,
        "facts": tables.record_facts(part),
        "channels": [channel.label for channel in responses(part.fits[0]).channels],
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


def embedded(value: Any) -> str:
    """`value` as JSON that cannot end a script element."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")

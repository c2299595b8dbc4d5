"""The page of a matrix-free search: what changed where on the mesh, how sure that is, and how the record is met."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from plotly.offline import get_plotlyjs

from structid._version import __version__
from structid.estimation import Status
from structid.files import atomic_write, made_folder
from structid.report.figures.data import mode_rows, responses
from structid.report.figures.field_maps import FieldMap, field_figure, field_maps
from structid.report.figures.interactive_responses import responses_figure
from structid.report.figures.png import write_pngs
from structid.report.figures.png_responses import magnitude_figure, phase_figure
from structid.report.identification.page import embedded, sorted_warnings
from structid.report.identification.tables import mode_table, provenance_facts
from structid.report.page_template import page_template
from structid.report.text import NOTHING, counted, number, percent, with_std, with_unit
from structid.study.results.changes import largest_changes, search_reason
from structid.study.results.result import StudyResult

_MOST_ROWS = 25
_HEADER = ("Parameter", "Initial", "Identified", "Change", "Change in standard deviations")


def write_free_report(result: StudyResult, folder: Path) -> Path:
    """Path of ``report.html`` in `folder`, written with its PNG files in ``figures``.

    The same result gives the same bytes.

    Raises
    ------
    FileError
        If a file cannot be written.
    """
    figures = made_folder(Path(folder) / "figures")
    found = result.identification
    maps = field_maps(found)
    named = {f"map_{k}": one for k, one in enumerate(maps, 1)}
    makers: dict[str, Callable[[], Figure | None]] = {
        name: partial(field_figure, found, one) for name, one in named.items()
    }
    for place, fit in enumerate(found.fits, 1):
        data, prefix = responses(fit), f"record_{place}_" if place > 1 else ""
        makers[f"{prefix}frf_magnitude"] = partial(magnitude_figure, data)
        makers[f"{prefix}frf_phase"] = partial(phase_figure, data)
    write_pngs(makers, figures)
    drawn = [
        (one.name, _caption(one), base64.b64encode((figures / f"{name}.png").read_bytes()).decode("ascii"))
        for name, one in named.items()
    ]
    path = Path(folder) / "report.html"
    text = _page(result, drawn)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _page(result: StudyResult, maps: list[tuple[str, str, str]]) -> str:
    found = result.identification
    estimate = found.estimate
    data = {f"responses-{place}": responses(fit) for place, fit in enumerate(found.fits, 1)}
    figures = {name: responses_figure(one) for name, one in data.items()}
    bands = [one.band for one in data.values()]
    return page_template("free.html.j2").render(
        title=result.study.title,
        version=__version__,
        status=estimate.status.value,
        status_words=f"{estimate.status_words} ({estimate.message})",
        is_good=estimate.status is Status.CONVERGED and estimate.covariance_basis == "noise",
        warnings=sorted_warnings(found)[0],
        cards=_cards(result),
        maps=maps,
        header=_HEADER,
        rows=[_row(result, i) for i in largest_changes(estimate, _MOST_ROWS)],
        std_words=_std_words(result),
        records=[
            (name, fit.name if len(data) > 1 else "", [channel.label for channel in one.channels])
            for fit, (name, one) in zip(found.fits, data.items(), strict=True)
        ],
        figures=figures,
        modes=mode_table(mode_rows(found.fits[0]), (min(b[0] for b in bands), max(b[1] for b in bands))),
        provenance=provenance_facts(asdict(result.provenance)),
        plotly=get_plotlyjs(),
        described=embedded({name: figure.described() for name, figure in figures.items()}),
    )


def _caption(shown: FieldMap) -> str:
    """The lowest element and what the colours are."""
    known = np.isfinite(shown.change)
    if not known.any():
        return ""
    lowest = int(np.nanargmin(shown.change))
    std = float(shown.std[lowest])
    doubt = "" if not np.isfinite(std) else f" with a standard deviation of {percent(std, 2, signed=False)}"
    grey = "" if known.all() else " Grey: no parameter of this map."
    return (
        f"Lowest at element {lowest + 1} of {shown.elements}: {percent(float(shown.change[lowest]))}{doubt}. A change is"
        f" to be believed where it is several times its standard deviation.{grey}"
    )


def _cards(result: StudyResult) -> tuple[tuple[str, str, str], ...]:
    found = result.identification
    estimate = found.estimate
    error, before = (
        percent(float(np.median(np.concatenate([part.ravel() for part in parts]))), 3, signed=False)
        for parts in ([f.relative_error for f in found.fits], [f.initial_relative_error for f in found.fits])
    )
    has_mass = np.isfinite(found.total_mass) and found.total_mass > 0
    mass = f"{with_std(found.total_mass, found.total_mass_std)} kg" if has_mass else NOTHING
    beyond, limit = estimate.beyond_chance()
    lower, higher = (int((beyond & (sense * estimate.distance > 0)).sum()) for sense in (-1, 1))
    basis = "from the residual" if estimate.covariance_basis == "model_error" else "from the noise"
    return (
        (
            "Parameters",
            f"{len(estimate.names)}",
            f"{int(estimate.identified.sum())} of them identified, priors included",
        ),
        ("Combinations that the data determine", number(estimate.determined, 3), "what is left is held by priors"),
        (
            "Changed beyond chance",
            f"{lower} lower, {higher} higher",
            f"more than {number(limit, 3)} standard deviations: 5 % risk of any by chance",
        ),
        ("Chi-square per degree of freedom", number(estimate.chi_square_per_dof, 3), f"{estimate.n_data} data"),
        ("Median relative FRF error", error, f"initial model {before}"),
        ("Total mass", mass, f"standard deviations {basis}"),
        ("Search", counted(estimate.n_iterations, "iteration"), search_reason(estimate)),
    )


def _row(result: StudyResult, i: int) -> tuple[str, ...]:
    found = result.identification.estimate
    initial, value, std = float(found.initial[i]), float(found.values[i]), float(found.std[i])
    return (
        found.names[i],
        with_unit(number(initial), found.units[i]),
        with_unit(with_std(value, std), found.units[i]),
        percent(value / initial - 1) if initial else NOTHING,
        number(float(found.distance[i]), 3),
    )


def _std_words(result: StudyResult) -> str:
    found = result.identification.estimate
    spread = found.uncertainty.std_error[np.isfinite(found.uncertainty.std_error)]
    if not spread.size:
        return "Standard deviations are not known."
    known = percent(float(spread.max()), 2, signed=False)
    return f"Standard deviations come from {len(found.uncertainty.draws)} draws, each known to {known}."

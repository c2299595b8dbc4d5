"""The page of a matrix-free search: what changed where on the mesh, how sure that is, and how the record is met."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from structid.core.display import plural
from structid.core.quantities import NOTHING, number, percent, with_std, with_unit
from structid.inversion import Status
from structid.report.correlation import side_by_side_chapter
from structid.report.figures.fields import field_figures
from structid.report.figures.modes import band_used, mode_rows
from structid.report.figures.responses import responses_figure
from structid.report.identification.page import sorted_warnings
from structid.report.identification.tables import mode_table
from structid.report.page import Page
from structid.report.tables import Table, provenance_table
from structid.study.results.changes import largest_changes, search_reason
from structid.study.results.result import StudyResult

_MOST_ROWS = 25
_HEADER = ("Parameter", "Initial", "Identified", "Change", "Change in standard deviations")


def free_page(result: StudyResult) -> Page:
    """Report page of an identification with too many parameters for a covariance matrix, with its figures."""
    identification = result.identification
    estimate = identification.estimate
    maps = field_figures(identification)
    responses = {f"record_{k}_frf" if k > 1 else "frf": fit for k, fit in enumerate(identification.fits, 1)}
    side_by_side, beside_model = side_by_side_chapter(identification)
    rows = tuple(_row(result, i) for i in largest_changes(estimate, _MOST_ROWS))
    words = {
        "title": result.study.title,
        "status": estimate.status.value,
        "status_words": f"{estimate.status_words} ({estimate.message})",
        "is_good": estimate.status is Status.CONVERGED and estimate.covariance_basis == "noise",
        "warnings": sorted_warnings(identification)[0],
        "summary": _cards(result),
        "maps": [(f"map_{k}", name) for k, name in enumerate(maps, 1)],
        "changes": Table(_HEADER, rows, (1, 2, 3, 4)),
        "std_words": _std_words(result),
        "records": [(name, fit.name if len(responses) > 1 else "") for name, fit in responses.items()],
        "modes": mode_table(mode_rows(identification.fits[0]), band_used(identification.fits)),
        "provenance": provenance_table(asdict(result.provenance)),
        "beside_model": beside_model,
    }
    figures = {
        **{f"map_{k}": figure for k, figure in enumerate(maps.values(), 1)},
        **{name: responses_figure(fit) for name, fit in responses.items()},
        **side_by_side,
    }
    return Page("report.html", "free.html.j2", figures, words)


def _cards(result: StudyResult) -> tuple[tuple[str, str, str], ...]:
    """Key figures of an identification with very many parameters, as (label, value, remark) for each."""
    identification = result.identification
    estimate = identification.estimate
    error, before = (
        percent(float(np.median(np.concatenate([part.ravel() for part in parts]))), 3, signed=False)
        for parts in (
            [f.relative_error for f in identification.fits],
            [f.initial_relative_error for f in identification.fits],
        )
    )
    has_mass = np.isfinite(identification.mass.total) and identification.mass.total > 0
    mass = f"{with_std(identification.mass.total, identification.mass.std)} kg" if has_mass else NOTHING
    beyond, limit = estimate.beyond_chance()
    lower, higher = (int((beyond & (sense * estimate.distance > 0)).sum()) for sense in (-1, 1))
    basis = "from the residual" if estimate.covariance_basis == "model_error" else "from the noise"
    return (
        (
            "Parameters",
            f"{len(estimate.names)}",
            f"{int(estimate.identified.sum())} of them identified, priors included",
        ),
        (
            "Combinations that the data determine",
            number(estimate.spread.determined, 3),
            "what is left is held by priors",
        ),
        (
            "Changed beyond chance",
            f"{lower} lower, {higher} higher",
            f"more than {number(limit, 3)} standard deviations: 5 % risk of any by chance",
        ),
        (
            "Misfit over what is expected",
            number(float(np.sqrt(estimate.goodness.misfit)), 3),
            f"{estimate.goodness.n_data} data",
        ),
        ("Median relative FRF error", error, f"initial model {before}"),
        ("Total mass", mass, f"standard deviations {basis}"),
        ("Search", plural(estimate.search.n_iterations, "iteration"), search_reason(estimate)),
    )


def _row(result: StudyResult, i: int) -> tuple[str, ...]:
    estimate = result.identification.estimate
    initial, value, std = float(estimate.initial[i]), float(estimate.values[i]), float(estimate.std[i])
    return (
        estimate.names[i],
        with_unit(number(initial), estimate.units[i]),
        with_unit(with_std(value, std), estimate.units[i]),
        percent(value / initial - 1) if initial else NOTHING,
        number(float(estimate.distance[i]), 3),
    )


def _std_words(result: StudyResult) -> str:
    """Sentence on the number of posterior draws behind the standard deviations, and how accurately these are known."""
    estimate = result.identification.estimate
    spread = estimate.uncertainty.std_error[np.isfinite(estimate.uncertainty.std_error)]
    if not spread.size:
        return "Standard deviations are not known."
    known = percent(float(spread.max()), 2, signed=False)
    return f"Standard deviations come from {len(estimate.uncertainty.draws)} draws, each known to {known}."

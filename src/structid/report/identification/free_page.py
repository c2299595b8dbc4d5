"""The page of a matrix-free search: what changed where on the mesh, how sure that is, and how the record is met."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.display import plural
from structid.core.quantities import NOTHING, number, percent, with_std, with_unit
from structid.identification.identified import Identification
from structid.inversion import Status
from structid.report.correlation import side_by_side_chapter
from structid.report.drawing import palette
from structid.report.drawing.changes import Change, Shading, round_limit, shading
from structid.report.drawing.drawing import structure_picture
from structid.report.drawing.picture import Picture
from structid.report.figures.modes import band_used, mode_rows
from structid.report.figures.responses import responses_figure
from structid.report.figures.structure import structure_figure
from structid.report.identification.page import sorted_warnings
from structid.report.identification.tables import mode_table
from structid.report.page import Page
from structid.report.rendering import plot
from structid.report.tables import Table, provenance_table
from structid.study.results.result import StudyResult
from structid.study.results.view import largest_changes, search_reason

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


def field_figures(identification: Identification) -> dict[str, plot.Figure]:
    """Figures of element properties over a mesh, by "<property> of <element set>"; only those with three parameters or more."""
    estimate, unknown, own = identification.estimate, identification.parameters, identification.own_index
    records = [fit.problem.record for fit in identification.fits]
    before, after = unknown.values(estimate.initial[own]), unknown.values(estimate.values[own])
    design = unknown.design.tocsr()
    sensors = tuple(dict.fromkeys(dof for record in records for dof in record.outputs))
    loads = tuple(dict.fromkeys(dof for record in records for dof in record.inputs))
    drawn = structure_picture(identification.structure, sensors, loads, is_field=True)
    figures = {}
    for item in identification.structure.properties:
        part = design[item.values.start : item.values.stop]
        if len(np.unique(part.indices)) < 3:
            continue
        size = np.where(np.diff(part.indptr) > 0, before[item.values], np.nan)
        wide = sparse.csr_array((part.data, own[part.indices], part.indptr), (part.shape[0], len(estimate.names)))
        std = np.sqrt(estimate.uncertainty.variance(wide))
        change = after[item.values] / size - 1
        name = f"{item.term.property.replace('_', ' ')} of {item.element}"
        figures[name] = _field_figure(
            drawn, (name, item.element), change, std / np.abs(size), estimate.beyond_chance()[1]
        )
    return figures


def _field_figure(
    picture: Picture, names: tuple[str, str], change: FloatArray, std: FloatArray, limit: float
) -> plot.Figure:
    """Figure of relative change beside its standard deviation, by element, with significant areas outlined.

    `names` are the title and the element set; `change` and `std` (n_elements,) are relative to the initial value, NaN without a
    parameter. A change is significant if it exceeds `limit` standard deviations.
    """
    name, elements = names
    texts = [f"{percent(c)} ± {percent(s, 2, signed=False)}" for c, s in zip(change, std, strict=True)]
    sides = [
        {(elements, k): Change(float(values[k]), True, texts[k]) for k in np.flatnonzero(np.isfinite(values)).tolist()}
        for values in (change, std)
    ]
    beyond = np.abs(np.nan_to_num(change)) > limit * np.where(np.isfinite(std), std, np.inf)
    sizes = np.abs([c.ratio for c in sides[0].values()])
    changed = shading(
        f"{name}: relative change", sides[0], round_limit(np.quantile(sizes, [0.999]) if sizes.size else (), 0.02)
    )
    changed = replace(changed, outlined=frozenset((elements, k) for k in np.flatnonzero(beyond).tolist()))
    known = std[np.isfinite(std)]
    top = (float(np.quantile(known, 0.99)) if known.size else 0.0) or 1.0
    ticks = tuple((part * top, percent(part * top, 2, signed=False)) for part in (0.0, 0.25, 0.5, 0.75, 1.0))
    label = "standard deviation of the change"
    scale = plot.ColourScale(palette.SEQUENTIAL, 0.0, top, label, ticks, is_exceeded=bool((known > top).any()))
    return structure_figure(
        picture, (changed, Shading(f"{name}: {label}", sides[1], scale)), caption=_caption(elements, change, std)
    )


def _caption(elements: str, change: FloatArray, std: FloatArray) -> str:
    """Caption with the element of the lowest change and the meaning of the colours; "" if no change is known.

    `change` and `std` (n_elements,) are relative; `elements` is the name of the element set.
    """
    if not np.isfinite(change).any():
        return ""
    lowest = int(np.nanargmin(change))
    doubt = f" with a standard deviation of {percent(std[lowest], 2, signed=False)}" if np.isfinite(std[lowest]) else ""
    grey = "" if np.isfinite(change).all() else " Grey: no parameter of this map."
    return (
        f"Lowest at element {lowest + 1} of {elements}: {percent(change[lowest])}{doubt}. A change is to be believed where it"
        f" is several times its standard deviation.{grey}"
    )

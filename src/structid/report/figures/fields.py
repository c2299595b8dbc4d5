"""Properties of very many elements as colours on the mesh: how much each changed, and how well that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.quantities import percent
from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.drawing.changes import Change, Shading, round_limit, shading
from structid.report.drawing.drawing import structure_picture
from structid.report.drawing.picture import Picture
from structid.report.figures.structure import structure_figure
from structid.report.rendering import plot


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

"""Properties of very many elements as colours on the mesh: how much each changed, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy import sparse

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.drawing.element_outlines import Outlines, outlines
from structid.report.figures.png_style import plain
from structid.structure import Structure


@dataclass(frozen=True, eq=False)
class FieldMap:
    """One property of one element set over its elements.

    Attributes
    ----------
    name : str
        Property and element set.
    elements : str
        Name of the element set.
    change : (n_elements,) float array
        Relative change from the initial value; NaN where no parameter acts.
    std : (n_elements,) float array
        Of that change; NaN where it is not known.
    limit_std : float
        Changes of more standard deviations are beyond chance anywhere among all parameters.
    """

    name: str
    elements: str
    change: FloatArray
    std: FloatArray
    limit_std: float

    @property
    def is_beyond(self) -> np.ndarray:
        """Elements whose change is beyond chance."""
        known = np.where(np.isfinite(self.std), self.std, np.inf)
        return np.asarray(np.abs(np.nan_to_num(self.change)) > self.limit_std * known)

    @property
    def limit(self) -> float:
        """A round number at the ends of the colour scale that few changes exceed."""
        size = np.abs(self.change[np.isfinite(self.change)])
        largest = float(np.quantile(size, 0.999)) if size.size else 0.0
        return next((step for step in (0.02, 0.05, 0.1, 0.2, 0.3, 0.5) if largest <= step), 1.0)


def field_maps(found: Identification) -> tuple[FieldMap, ...]:
    """One map for each property that has at least three different parameters over an element set."""
    unknown, estimate = found.parameters, found.estimate
    structure, own = found.structure, found.own_index
    before, after = unknown.values(estimate.initial[own]), unknown.values(estimate.values[own])
    design = unknown.design.tocsr()
    limit = estimate.beyond_chance()[1]
    maps = []
    for item in structure.properties:
        part = design[item.values.start : item.values.stop]
        acts = np.diff(part.indptr) > 0
        if len(np.unique(part.indices)) < 3:
            continue
        size = np.where(acts, before[item.values], np.nan)
        wide = sparse.csr_array((part.data, own[part.indices], part.indptr), (part.shape[0], len(estimate.names)))
        std = np.sqrt(estimate.uncertainty.variance(wide))
        name = f"{item.term.property.replace('_', ' ')} of {item.element}"
        maps.append(FieldMap(name, item.element, after[item.values] / size - 1, std / np.abs(size), limit))
    return tuple(maps)


def field_figure(found: Identification, shown: FieldMap) -> Figure:
    """The change beside its standard deviation, on the mesh."""
    structure = found.structure
    drawn = outlines(structure)
    low, high = drawn.bounds
    width, height = high - low
    is_wide = width > 1.8 * height
    panel = 9.5 if is_wide else 5.4
    rows, columns = (2, 1) if is_wide else (1, 2)
    tall = float(np.clip(panel * height / width, 1.6, 7.0)) + 0.7
    figure = Figure(figsize=(columns * (panel + 1.2), rows * tall + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    scale = Normalize(-shown.limit, shown.limit)
    _panel(figure, axes[0], drawn, shown, shown.change, scale, palette.DIVERGING, "relative change")
    _outlined(axes[0], drawn, shown)
    std = shown.std[np.isfinite(shown.std)]
    top = float(np.quantile(std, 0.99)) if std.size else 1.0
    known = Normalize(0.0, top if top > 0 else 1.0)
    _panel(figure, axes[1], drawn, shown, shown.std, known, palette.SEQUENTIAL, "standard deviation of the change")
    loads, sensors = (
        tuple(dof for fit in found.fits for dof in getattr(fit.problem.record, role)) for role in ("inputs", "outputs")
    )
    for panel_axes in axes:
        _points(panel_axes, structure, drawn, loads, "s", palette.LOAD, 10.0, "load")
        _points(panel_axes, structure, drawn, sensors, "o", palette.SENSOR, 5.5, "sensor")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _panel(
    figure: Figure,
    axes: Axes,
    drawn: Outlines,
    shown: FieldMap,
    values: FloatArray,
    scale: Normalize,
    colours: str,
    label: str,
) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    mapped = ScalarMappable(scale, colours)
    owner = np.array([values[i] if name == shown.elements else np.nan for name, i in drawn.owners])
    faces = np.where(np.isfinite(owner)[:, None], mapped.to_rgba(np.nan_to_num(owner)), (0.79, 0.79, 0.79, 1.0))
    areas = [k for k, path in enumerate(drawn.paths) if len(path) > 2]
    lines = [k for k, path in enumerate(drawn.paths) if len(path) == 2]
    edge = 0.3 if len(areas) < 3000 else 0.0
    own = faces[areas] if not edge else "#555555"
    axes.add_collection(
        PolyCollection([drawn.paths[k] for k in areas], facecolors=faces[areas], edgecolors=own, linewidths=edge or 0.2)
    )
    axes.add_collection(LineCollection([drawn.paths[k] for k in lines], colors=faces[lines], linewidths=3.0))
    low, high = drawn.bounds
    margin = 0.03 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_title(plain(f"{shown.name}: {label}"), loc="left")
    beyond = "both" if (np.abs(values[np.isfinite(values)]) > scale.vmax).any() and scale.vmin != 0 else "neither"
    bar = figure.colorbar(mapped, ax=axes, shrink=0.85, aspect=25, extend=beyond)
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.3g} %")
    bar.set_label(label)


def _outlined(axes: Axes, drawn: Outlines, shown: FieldMap) -> None:
    """A line round each region whose change is beyond chance."""
    beyond = shown.is_beyond
    sides: dict[tuple[tuple[float, ...], ...], list[bool]] = {}
    for path, (name, i) in zip(drawn.paths, drawn.owners, strict=True):
        inside = name == shown.elements and bool(beyond[i])
        ends = [tuple(np.round(corner, 12).tolist()) for corner in path]
        for first, second in zip(ends, [*ends[1:], ends[0]], strict=True):
            sides.setdefault((min(first, second), max(first, second)), []).append(inside)
    border = [side for side, inside in sides.items() if any(inside) and not (len(inside) > 1 and all(inside))]
    if border:
        axes.add_collection(LineCollection(border, colors=palette.INK, linewidths=1.3, zorder=4))
        axes.plot([], [], color=palette.INK, lw=1.3, label="round changes beyond chance")


def _points(
    axes: Axes,
    structure: Structure,
    drawn: Outlines,
    dofs: tuple[Dof, ...],
    mark: str,
    colour: str,
    size: float,
    label: str,
) -> None:
    nodes = list(dict.fromkeys(dof.node for dof in dofs))
    at = drawn.projected(np.array([structure.nodes[node] for node in nodes]))
    axes.plot(*at.T, ls="", marker=mark, ms=size, mfc=colour, mec="white", mew=0.8, label=label, zorder=5)

"""Single figures of the pages as pictures of Matplotlib: what the ``plot_...`` methods draw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from structid.core.dof import parse_dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.identification.identified import Identification
from structid.identification.record_fit import RecordFit
from structid.modal.survey.survey import ModesResult
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.parameters import (
    band_used,
    convergence_figure,
    correlation_figure,
    mode_rows,
    modes_figure,
    parameters_figure,
)
from structid.report.figures.responses import residual_map_figure, responses_figure, worst_channels
from structid.report.figures.side_by_side import model_shapes_figure
from structid.report.figures.structure import shadings, structure_figure
from structid.report.figures.survey import shapes_figure, stabilization_figure
from structid.report.rendering.plot import Figure
from structid.report.rendering.png import plotted

Where = Axes | Sequence[Axes] | None


def parameters(identification: Identification, axes: Where) -> Picture:
    return plotted(parameters_figure(identification), axes)


def correlation(identification: Identification, axes: Where) -> Picture:
    return plotted(correlation_figure(identification), axes)


def convergence(identification: Identification, axes: Where) -> Picture:
    return plotted(convergence_figure(identification), axes)


def modes(identification: Identification, axes: Where) -> Picture:
    """Picture of natural frequencies and damping ratios before and after identification, on `axes` or, if None, new ones.

    `InputError` if the modes of the model are not known.
    """
    rows = mode_rows(identification)
    if not len(rows.frequency):
        raise InputError("a solver gave the FRFs of this model alone, so that its modes are not known")
    return plotted(modes_figure(rows, band_used(identification.fits[:1], identification.modal_fits)), axes)


def model_shapes(identification: Identification, mode: int, axes: Where) -> Picture:
    """Picture of the identified model's shape of `mode` (from 1; 0 for several), on `axes` or, if None, new ones.

    `InputError` if the model has no shapes in space, or no mode of this number among the first 24.
    """
    whole = model_shapes_figure(identification.structure, identification.modes)
    if whole is None:
        raise InputError("the model has no modes with shapes in space; `plot_frequencies` shows its frequencies")
    if not 0 <= mode <= len(whole.panels):
        raise InputError(f"`mode` must be between 1 and {len(whole.panels)}, got {mode}")
    if mode == 0:
        return plotted(whole, axes)
    panel = whole.panels[mode - 1]
    alone = replace(whole, panels=(replace(panel, title=panel.name),), choice=None, size=(600.0, 420.0), columns=1)
    return plotted(alone, axes)


def changes(identification: Identification, axes: Where) -> Picture:
    drawn = structure_picture(identification.structure, identification.sensors, identification.loads)
    return plotted(structure_figure(drawn, shadings(identification)), axes)


def structure(shown: Structure, axes: Where) -> Picture:
    return plotted(structure_figure(structure_picture(shown, (), ())), axes)


def frf(identification: Identification, sensor: str, load: str, record: int, axes: Where) -> Picture:
    """Picture of a measured FRF with the models' at one sensor and load, on `axes` or, if None, new ones.

    If only one of `sensor` and `load` is named, the other is the first of the record; if both are "", the worst fitted
    FRF is drawn. `record` is the number, from 0, among the records of responses. `InputError` if there is no such
    channel.
    """
    fit = _fit(identification, record)
    outputs, inputs = fit.measured.outputs, fit.measured.inputs
    if sensor or load:
        indices = []
        for role, given, dofs in (("sensor", sensor, outputs), ("load", load, inputs)):
            texts = [dof.place for dof in dofs]
            wanted = parse_dof(given).place if given else texts[0]
            if wanted not in texts:
                raise InputError(f"`{role}` must be one of {', '.join(texts)}, got {given!r}")
            indices.append(texts.index(wanted))
        channel = indices[0] * len(inputs) + indices[1]
    else:
        [channel] = worst_channels(fit, 1)
    whole = responses_figure(fit)
    return plotted(replace(whole, panels=(whole.panels[channel],), choice=None), axes)


def residuals(identification: Identification, record: int, axes: Where) -> Picture:
    return plotted(residual_map_figure(_fit(identification, record)), axes)


def stabilization(result: ModesResult, axes: Where) -> Picture:
    return plotted(_drawable(stabilization_figure(result)), axes)


def shape(result: ModesResult, mode: int, axes: Where) -> Picture:
    """Picture of the shape of `mode` (from 1) of a modal survey, on `axes` or, if None, new ones.

    `InputError` if there is no such mode. A shape is drawn at rest and at two opposite phases.
    """
    whole = shapes_figure(result)
    if not 1 <= mode <= len(whole.panels):
        raise InputError(f"`mode` must be between 1 and {len(whole.panels)}, got {mode}")
    panel = whole.panels[mode - 1]
    alone = replace(whole, panels=(replace(panel, title=panel.name),), choice=None, size=(600.0, 420.0), columns=1)
    return plotted(alone, axes)


def _fit(identification: Identification, record: int) -> RecordFit:
    """Fit of record `record` of responses, from 0; `InputError` if there is no such record."""
    if not 0 <= record < len(identification.fits):
        raise InputError(
            f"`record` must be one of the {len(identification.fits)} records of responses, counted from 0, got {record};"
            " records of modes have none"
        )
    return identification.fits[record]


def _drawable(figure: Figure | None) -> Figure:
    """`figure`, or `InputError` if it is None, as without orders to choose among."""
    if figure is None:
        raise InputError("the method has no orders to choose among, so there is no stabilization diagram")
    return figure

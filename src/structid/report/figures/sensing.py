"""Sensed motion, sensors that were left out, and unknown forces, with their 95 % bands."""

from __future__ import annotations

from structid.core.arrays import FloatArray, thin_band, thin_curve
from structid.prediction.recovery import output_unit
from structid.prediction.sensing.result import SensedMotion
from structid.records.record import QUANTITY_UNITS
from structid.report.drawing import palette
from structid.report.figures.parameters import NORMAL_95
from structid.report.figures.prediction import MOST_POINTS, band, one_at_a_time, thinning_clause
from structid.report.rendering import plot


def sensed_figure(sensed: SensedMotion) -> plot.Figure:
    """Figure of sensed motion with its 95 % bands, one output at a time."""
    unit = QUANTITY_UNITS[sensed.motion][0]
    panels = []
    for output, value, std in zip(sensed.outputs, sensed.values.T, sensed.std.T, strict=True):
        of_output = output_unit(output)
        y = plot.Axis(str(output) if of_output else sensed.motion, of_output or unit)
        panels.append(_panel(sensed.time, value, std, y, str(output), palette.BLUE))
    return one_at_a_time(panels, "Where", _caption("value", sensed))


def left_out_figure(sensed: SensedMotion) -> plot.Figure:
    """Figure of sensors that were left out, one at a time: what they measured, and its 95 % band by what is sensed there."""
    panels = []
    for sensor in sensed.left_out:
        y = plot.Axis(sensor.motion, QUANTITY_UNITS[sensor.motion][0])
        measured = plot.Curve(
            *thin_curve(sensed.time, sensor.measured, MOST_POINTS),
            plot.Pen(palette.INK, 1.2, "dot"),
            label="measured",
            hover=plot.NUMBERS,
        )
        panels.append(_panel(sensed.time, sensor.sensed, sensor.std, y, str(sensor.dof), palette.BLUE, measured))
    return one_at_a_time(panels, "Sensor", _caption("measured value", sensed))


def forces_figure(sensed: SensedMotion) -> plot.Figure:
    """Figure of the unknown forces with their 95 % bands, one at a time."""
    panels = [
        _panel(
            sensed.time, value, std, plot.Axis("moment" if dof.is_rotation else "force", "N m" if dof.is_rotation else "N"),
            str(dof), palette.VERMILLION,
        )
        for dof, value, std in zip(sensed.force_dofs, sensed.forces.T, sensed.force_std.T, strict=True)
    ]  # fmt: skip
    return one_at_a_time(panels, "Force at", _caption("force", sensed))


def _panel(
    time: FloatArray, value: FloatArray, std: FloatArray, y: plot.Axis, title: str, colour: str, *others: plot.Trace
) -> plot.Panel:
    """Panel of a sensed history `value` (n_times,) with its 95 % band in `colour`, and the curves `others` above it."""
    half = NORMAL_95 * std
    return plot.panel(
        plot.Axis("time", "s"),
        y,
        band(*thin_band(time, value - half, value + half, MOST_POINTS), colour, "sensed"),
        plot.Curve(*thin_curve(time, value, MOST_POINTS), plot.Pen(colour, 1.4), label="sensed", hover=plot.NUMBERS),
        *others,
        title=title,
    )


def _caption(what: str, sensed: SensedMotion) -> str:
    """Caption on the band and on how long histories are drawn; `what` is the word for what the band holds.

    Where the model does not explain the record, it says that the band would hold the truth if the model were right.
    """
    drawn = thinning_clause(sensed.time)
    if not sensed.is_explained:
        return f"The shaded band would hold the true {what} with a probability of 95 % if the model were right.{drawn}"
    return f"The shaded band holds the true {what} at each instant with a probability of 95 %.{drawn}"

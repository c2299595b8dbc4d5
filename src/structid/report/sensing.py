"""Sensed motion as the terminal shows it, and its page."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from structid.core.arrays import FloatArray, thin_band, thin_curve
from structid.core.display import number
from structid.prediction.recovery import output_unit
from structid.prediction.sensing.sense import LARGEST_CHECK, SensedMotion
from structid.records.record import QUANTITY_UNITS
from structid.report.drawing import palette
from structid.report.figures.parameters import NORMAL_95
from structid.report.figures.prediction import MOST_POINTS, band, one_at_a_time, thinning_clause
from structid.report.page import Page, Table, printed
from structid.report.rendering import plot

SENSING_PAGE = "sensed.html"


def _motion_table(sensed: SensedMotion) -> Table:
    """Table with a row for each output, then each force: root mean square of its values and of their standard deviations."""
    shown = sensed.overview()
    return Table(tuple(shown.header), tuple(map(tuple, shown.rows)), (1, 2))


def left_out_table(sensed: SensedMotion) -> Table:
    """Table with a row for each sensor that was left out: error over stated deviation, and a verdict on it."""
    rows = tuple((str(dof), number(z, 2), _check_words(z)) for dof, z in sensed.checks)
    return Table(("Sensor, left out", "Error over stated deviation", "Verdict"), rows, (1,))


def _check_words(z: float) -> str:
    good = z < LARGEST_CHECK
    return "as it should be" if good else "more than it should be: the model or the forces are wrong there"


def _prior_words(sensed: SensedMotion) -> str:
    """Words on size (N), correlation time (s) and spectrum of the unknown forces before the record.

    "" where there are no unknown forces.
    """
    if not sensed.force_dofs:
        return ""
    size, time = number(sensed.prior_std, 3), number(sensed.correlation_time, 3)
    about = f" about {number(sensed.force_frequency, 3)} Hz" if sensed.force_frequency > 0 else ""
    about += f", spectrum falling with f^-{2 * sensed.force_order}" if sensed.force_order > 1 else ""
    return f"unknown forces before the record: standard deviation {size} N, correlation time {time} s{about}"


def sensing_text(sensed: SensedMotion) -> list[RenderableType]:
    """Terminal text of sensed motion and forces: heading, contradiction, table, checks of left-out sensors and remarks."""
    parts: list[RenderableType] = [Text(sensed.overview().words.partition(";")[0], style="bold")]
    if sensed.contradiction:
        parts.append(Text(sensed.contradiction, style="bold red"))
    parts.append(printed(_motion_table(sensed)))
    if sensed.force_dofs:
        parts.append(Text(_prior_words(sensed)))
    parts += [
        Text(f"{dof}, left out: error {number(z, 2)} times its stated deviation, {_check_words(z)}")
        for dof, z in sensed.checks
    ]
    parts += [Text(f"note: {words}") for words in sensed.words]
    return parts


def sensing_page(sensed: SensedMotion, title: str, record: str) -> Page:
    """Report page of sensed motion, with its figures; `title` is that of the study, `record` names the file."""
    figures = {"sensed_motion": sensed_figure(sensed)}
    if sensed.left_out:
        figures["sensed_left_out"] = left_out_figure(sensed)
    if sensed.force_dofs:
        figures["sensed_forces"] = forces_figure(sensed)
    table, n_outputs = _motion_table(sensed), len(sensed.outputs)
    header = ("Where", "Root mean square", "Standard deviation (rms)", "Unit")
    words = {
        "title": title or "Structure",
        "heading": f"{sensed.overview().words.partition(';')[0]}, from {record}",
        "is_explained": sensed.is_explained,
        "contradiction": sensed.contradiction,
        "notes": sensed.words,
        "outputs": Table(header, table.rows[:n_outputs], (1, 2)),
        "forces": Table(header, table.rows[n_outputs:], (1, 2)),
        "left_out": left_out_table(sensed),
        "largest_check": f"{LARGEST_CHECK:g}",
        "prior": _prior_words(sensed),
    }
    return Page(SENSING_PAGE, "sensing.html.j2", figures, words)


def sensed_figure(sensed: SensedMotion) -> plot.Figure:
    """Figure of sensed motion with its 95 % bands, one output at a time, each with its SI unit."""
    panels = []
    for output, value, std in zip(sensed.outputs, sensed.values.T, sensed.std.T, strict=True):
        y = plot.Axis(str(output) if output_unit(output) else sensed.motion, sensed.unit_of(output))
        panels.append(_panel(sensed.time, value, std, y, str(output), palette.BLUE))
    return one_at_a_time(panels, "Where", _caption("value", sensed))


def left_out_figure(sensed: SensedMotion) -> plot.Figure:
    """Figure of sensors that were left out, one at a time: what they measured, and the 95 % band sensed there."""
    panels = []
    for sensor in sensed.left_out:
        y = plot.Axis(sensor.motion, QUANTITY_UNITS[sensor.motion][sensor.dof.is_rotation])
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
            sensed.time, value, std, plot.Axis("moment" if dof.is_rotation else "force", QUANTITY_UNITS["force"][dof.is_rotation]),
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

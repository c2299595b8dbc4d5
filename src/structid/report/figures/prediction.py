"""Predicted responses with their 95 % bands, before and after changes."""

from __future__ import annotations

from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray, thin_band, thin_curve
from structid.prediction.predict import PredictedChange, Prediction
from structid.prediction.quantities import Frf, History
from structid.report.drawing import palette
from structid.report.rendering import plot

#: Points of a curve at most; a history beyond them is drawn by the extremes of bins.
MOST_POINTS = 3000
#: Panels that a picture shows.
_MOST_PANELS = 9
#: Orders of magnitude that an FRF shows below its largest value.
_DECADES = 1e-5


def frf_figure(prediction: Prediction | PredictedChange) -> plot.Figure:
    """Figure of predicted FRF magnitudes with 95 % bands, one channel at a time; of a change, before and after it."""
    parts = _shown(prediction)
    first = next(iter(parts.values()))
    axes = first.quantity.axes
    frequency = np.asarray(axes["frequency"], dtype=float)
    panels = []
    units = first.quantity.units
    is_driven = isinstance(first.quantity, Frf) and first.quantity.kind == "transmissibility"
    per = "motion of" if is_driven else "force at"
    for o, output in enumerate(axes["output"]):
        for i, load in enumerate(axes["input"]):
            traces: list[plot.Trace] = []
            largest = max(float(np.abs(part.values[:, o, i]).max()) for part in parts.values())
            for label, colour, part in _coloured(parts):
                low = np.maximum(part.low[:, o, i], _DECADES * largest)
                traces.append(band(frequency, low, part.high[:, o, i], colour, label))
                traces.append(
                    plot.Curve(
                        frequency, np.abs(part.values[:, o, i]), plot.Pen(colour, 1.8, _dash(label)), label=label,
                        hover=plot.NUMBERS,
                    )
                )  # fmt: skip
            x, y = plot.Axis("frequency", "Hz"), plot.Axis("magnitude", units[o], log=True)
            panels.append(plot.panel(x, y, *traces, title=f"{output} per {per} {load}"))
    return one_at_a_time(
        panels, "Channel", "The shaded band holds the true magnitude at each line with a probability of 95 %."
    )


def history_figure(prediction: Prediction | PredictedChange) -> plot.Figure:
    """Figure of predicted time histories with 95 % bands, one sensor at a time; of a change, before and after it.

    A history of more than 3000 samples is drawn by minimum and maximum of bins, and the caption says so.
    """
    parts = _shown(prediction)
    first = next(iter(parts.values()))
    axes = first.quantity.axes
    time = np.asarray(axes["time"], dtype=float)
    panels, units = [], first.quantity.units
    motion = first.quantity.motion if isinstance(first.quantity, History) else "motion"
    for o, output in enumerate(axes["output"]):
        traces: list[plot.Trace] = []
        for label, colour, part in _coloured(parts):
            traces.append(band(*thin_band(time, part.low[:, o], part.high[:, o], MOST_POINTS), colour, label))
            x, value = thin_curve(time, part.values[:, o].real, MOST_POINTS)
            traces.append(plot.Curve(x, value, plot.Pen(colour, 1.4, _dash(label)), label=label, hover=plot.NUMBERS))
        y = plot.Axis(str(output) if "[" in str(output) else motion, units[o])
        panels.append(plot.panel(plot.Axis("time", "s"), y, *traces, title=str(output)))
    caption = "The shaded band holds the true value at each instant with a probability of 95 %."
    return one_at_a_time(panels, "Sensor", caption + thinning_clause(time))


def thinning_clause(time: FloatArray) -> str:
    """Sentence of a caption on how a history over `time` is drawn; "" where all of its samples are."""
    return " Samples are drawn by minimum and maximum of short bins." if len(time) > MOST_POINTS else ""


def spectrum_figure(prediction: Prediction | PredictedChange) -> plot.Figure:
    """Figure of predicted power spectral densities with 95 % bands, one output at a time; of a change, before and after it."""
    parts = _shown(prediction)
    first = next(iter(parts.values()))
    frequency, units = np.asarray(first.quantity.axes["frequency"], dtype=float), first.quantity.units
    panels = []
    for o, output in enumerate(first.quantity.axes["output"]):
        traces: list[plot.Trace] = []
        least = _DECADES**2 * max(float(part.values[:, o].real.max()) for part in parts.values())
        for label, colour, part in _coloured(parts):
            low, high, value = (np.maximum(each[:, o].real, least) for each in (part.low, part.high, part.values))
            traces.append(band(frequency, low, high, colour, label))
            pen = plot.Pen(colour, 1.8, _dash(label))
            traces.append(plot.Curve(frequency, value, pen, label=label, hover=plot.NUMBERS))
        x, y = plot.Axis("frequency", "Hz"), plot.Axis("density", units[o], log=True)
        panels.append(plot.panel(x, y, *traces, title=str(output)))
    return one_at_a_time(
        panels, "Sensor", "The shaded band holds the true density at each line with a probability of 95 %."
    )


def one_at_a_time(panels: list[plot.Panel], label: str, caption: str) -> plot.Figure:
    """Figure with `caption` of one panel, or of several that the reader selects from a list with the heading `label`.

    At most nine are shown as small ones at first.
    """
    if len(panels) == 1:
        return plot.Figure(tuple(panels), (900.0, 420.0), caption=caption)
    shown = tuple(range(min(len(panels), _MOST_PANELS)))
    return plot.Figure(tuple(panels), (900.0, 420.0), caption=caption, choice=plot.Choice(label, shown, (420.0, 260.0)))


def _shown(prediction: Prediction | PredictedChange) -> dict[str, Prediction]:
    """Predictions by the words of their legend: before and after a change, or the only one."""
    if isinstance(prediction, PredictedChange):
        return {"before the change": prediction.before, "after the change": prediction.after}
    return {"predicted": prediction}


def _coloured(parts: dict[str, Prediction]) -> list[tuple[str, str, Prediction]]:
    colours = (palette.BLUE, palette.VERMILLION)
    return [(label, colour, part) for (label, part), colour in zip(parts.items(), colours, strict=False)]


def _dash(label: str) -> Literal["solid", "dash"]:
    return "dash" if label.startswith("before") else "solid"


def band(x: FloatArray, low: FloatArray, high: FloatArray, colour: str, label: str) -> plot.Area:
    outline = np.concatenate([x, x[::-1], x[:1]]), np.concatenate([high, low[::-1], high[:1]])
    return plot.Area(*outline, colour, 0.22, f"95 % band, {label}")

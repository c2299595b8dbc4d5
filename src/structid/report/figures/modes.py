"""Modes of the model before and after, and beside those that were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray
from structid.identification.identified import Identification, RecordFit
from structid.report.drawing import palette
from structid.report.figures.parameters import NORMAL_95
from structid.report.rendering import plot

if TYPE_CHECKING:
    from structid.identification.fits.modal_fit import ModalFit

_BEFORE = plot.Marker("square", 10.0, "", plot.Pen(palette.INITIAL, 2.0))
_AFTER = plot.Marker("circle", 8.0, palette.FITTED)
_SIZE = (525.0, 380.0)


@dataclass(frozen=True, eq=False)
class ModeRows:
    """Modes of the initial and of the identified model, by number.

    Attributes
    ----------
    initial_frequency, frequency, initial_damping, damping : (n_modes,) float arrays
    mac : (n_modes,) float array
        Modal assurance criterion between the initial and the identified shape of the same number.
    """

    initial_frequency: FloatArray
    frequency: FloatArray
    initial_damping: FloatArray
    damping: FloatArray
    mac: FloatArray


def mode_rows(fit: Identification | RecordFit) -> ModeRows:
    """Frequencies (Hz), damping ratios and MAC of the modes of initial and identified model, paired by their number.

    The shorter of the two lists counts. The MAC is of shapes at the degrees of freedom of the model, NaN for a shape of
    zeros.
    """
    before, after = fit.modes_initial, fit.modes
    n = min(len(before.frequency), len(after.frequency))
    x, y = before.mode_shapes[:, :n], after.mode_shapes[:, :n]
    size = (x**2).sum(axis=0) * (y**2).sum(axis=0)
    mac = np.divide((x * y).sum(axis=0) ** 2, size, out=np.full(n, np.nan), where=size > 0)
    return ModeRows(before.frequency[:n], after.frequency[:n], before.damping_ratio[:n], after.damping_ratio[:n], mac)


def band_used(fits: Sequence[RecordFit], modal_fits: Sequence[ModalFit] = ()) -> plot.Limits:
    """Lowest and highest frequency (Hz) of all lines used and measured modes."""
    used = [fit.problem.record.frequency for fit in fits]
    used += [fit.problem.data.frequency for fit in modal_fits]
    return min(float(lines.min()) for lines in used), max(float(lines.max()) for lines in used)


def modes_figure(rows: ModeRows, band: plot.Limits) -> plot.Figure:
    """Figure of natural frequencies (Hz) and damping ratios (%) by mode number, initial and identified.

    `rows` has these by mode. `band` (low, high) in Hz is marked in the panel of frequencies as the band used.
    """
    number = np.arange(1, len(rows.frequency) + 1)
    used = plot.boxes((0.4, len(number) + 0.6), band, palette.YELLOW, "band used", 0.25)
    panels = []
    for label, unit, before, after, below in (
        ("natural frequency", "Hz", rows.initial_frequency, rows.frequency, [used]),
        ("damping ratio", "%", 100 * rows.initial_damping, 100 * rows.damping, []),
    ):
        low, high = (float(end(np.concatenate([before, after, [0.0]]))) for end in (np.nanmin, np.nanmax))
        margin = 0.05 * (high - low or 1.0)
        y = plot.Axis(label, unit, (low - margin, high + margin))
        panels.append(plot.panel(_numbers(number), y, *below, *_pairs(number, before, after)))
    caption = "Natural frequencies and damping ratios of the initial and the identified model."
    return plot.Figure(tuple(panels), _SIZE, 2, caption)


def modal_fit_figure(fit: ModalFit) -> plot.Figure:
    """Figure of relative frequency differences from the measured modes (%) and MAC, of the initial and the fitted model."""
    problem = fit.problem
    number, measured = problem.data.measured + 1, problem.data.frequency
    before, after = (100 * (model.frequency / measured - 1) for model in (fit.initial, fit.fitted))
    half = 100 * NORMAL_95 * problem.data.frequency_std / measured
    x = _numbers(number, "measured mode")
    interval = plot.boxes(
        (number - 0.25, number + 0.25), (-half, half), palette.FAINT, "95 % interval of the measurement"
    )
    zero = plot.segments(x.limits or (0.0, 1.0), (0.0, 0.0), plot.Pen(palette.MUTED, 1.1))
    frequency = plot.Axis("model / measured frequency less 1", "%")
    mac = plot.Axis("MAC with the measured shape", "1", (0.0, 1.05))
    panels = (
        plot.panel(x, frequency, interval, zero, *_pairs(number, before, after)),
        plot.panel(x, mac, *_pairs(number, fit.initial.mac, fit.fitted.mac)),
    )
    caption = (
        "Frequencies of the model over those measured, with the 95 % interval of the measured frequency; MAC between measured"
        " and modelled shapes at the sensors."
    )
    return plot.Figure(panels, _SIZE, 2, caption)


def _numbers(number: np.ndarray, label: str = "mode number") -> plot.Axis:
    first, last = int(number.min()), int(number.max())
    return plot.Axis(label, limits=(first - 0.6, last + 0.6), ticks=plot.whole_ticks(first, last))


def _pairs(number: np.ndarray, before: FloatArray, after: FloatArray) -> tuple[plot.Trace, ...]:
    return (
        plot.segments((number, number), (before, after), plot.Pen(palette.MUTED, 1.2)),
        plot.Curve(number, before, None, _BEFORE, "initial", plot.NUMBERS),
        plot.Curve(number, after, None, _AFTER, "identified", plot.NUMBERS),
    )

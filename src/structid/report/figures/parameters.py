"""Parameters and modes of the answer beside their initial values, priors and measured ones, and how errors go together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import with_std
from structid.identification.identified import Identification, RecordFit
from structid.report.drawing import palette
from structid.report.rendering import plot
from structid.similarity import assign_pairs

if TYPE_CHECKING:
    from structid.identification.modal_fit import ModalFit


#: Half width of a 95 % interval in standard deviations.
NORMAL_95 = 1.959964
_BOTH = np.array([-1.0, 1.0])
#: Parameters whose course has a colour of its own.
_N_HIGHLIGHTED = 7


def parameters_figure(identification: Identification) -> plot.Figure:
    """Figure of all parameters with intervals and priors, divided by their initial values.

    The axis fits the identified parameters; values beyond it are drawn as triangles at its end. A parameter whose
    initial value is 0 has a row, but no mark.
    """
    estimate = identification.estimate
    scale = np.where(estimate.initial != 0, estimate.initial, np.nan)
    ratio, std, is_identified = estimate.values / scale, estimate.std / np.abs(scale), estimate.identified
    one_std, normal = (ratio[:, None] + reach * std[:, None] * _BOTH for reach in (1.0, NORMAL_95))
    given = np.sort(identification.intervals.ends / scale[:, None], axis=1)
    interval = np.where(np.isfinite(given), given, normal)
    prior = (identification.priors.mean / scale)[:, None] + (identification.priors.std / np.abs(scale))[:, None] * _BOTH
    low, high, log = _ratio_limits(ratio, interval, prior, is_identified)
    shown, below, above = np.clip(ratio, low, high), ratio < low, ratio > high
    floor = low / 10 if log else None
    one_std, interval, prior = (np.clip(ends, floor, None) for ends in (one_std, interval, prior))
    wild = ~np.isfinite(std) | (std > 3 * (high - low))  # unknown, or much wider than the axis
    notes = ("" if initial else " (initial value 0)" for initial in estimate.initial)
    names = [name + note for name, note in zip(estimate.names, notes, strict=True)]
    texts = [f"{name}: {with_std(r, s)}" for name, r, s in zip(names, ratio, std, strict=True)]
    positions, has_prior = np.arange(len(names), dtype=float), np.isfinite(prior).all(axis=1)
    rows, known = (positions, positions), ~wild
    traces: list[plot.Trace] = [
        plot.boxes(
            prior[has_prior].T,
            (positions[has_prior] - 0.36, positions[has_prior] + 0.36),
            palette.SKY,
            "prior ± 1 std",
            0.35,
        ),
        plot.segments((1.0, 1.0), (-0.6, len(names) - 0.4), plot.Pen(palette.INITIAL, 1.6), "initial value"),
        plot.segments(
            (low, high), (positions[wild], positions[wild]), plot.Pen(palette.MUTED, 1.4, "dash"), "not determined"
        ),
    ]
    for ends, width, label in ((interval, 1.4, "95 % interval"), (one_std, 4.2, "± 1 std")):
        lines = plot.segments(tuple(ends[known].T), [row[known] for row in rows], plot.Pen(palette.INK, width), label)
        traces.append(lines)
    hollow = plot.Pen(palette.FITTED, 2.0)
    for marker, which, label in (
        (
            plot.Marker("circle", 9.0, palette.FITTED, plot.Pen("white", 1.0)),
            is_identified & ~below & ~above,
            "identified",
        ),
        (plot.Marker("circle", 8.0, "white", hollow), ~is_identified & ~below & ~above, "not identified"),
        (plot.Marker("triangle-left", 8.0, "white", hollow), below, ""),
        (plot.Marker("triangle-right", 8.0, "white", hollow), above, ""),
    ):
        words = tuple(text for text, chosen in zip(texts, which, strict=True) if chosen)
        traces.append(plot.Curve(shown[which], positions[which], None, marker, label, words))
    caption = (
        "Identified parameters over their initial values. Thick bars: one standard deviation, thin bars: 95 % interval; the"
        " interval of parameters that are not determined runs across the whole axis, dashed; a triangle at the edge stands"
        " for a value beyond it."
    )
    x = _ratio_axis("identified value / initial value", (low, high), log, 0.015)
    return plot.Figure((plot.panel(x, plot.rows_axis(names), *traces),), plot.rows_size(len(names)), caption=caption)


def _ratio_limits(
    ratio: FloatArray, interval: FloatArray, prior: FloatArray, is_identified: np.ndarray
) -> tuple[float, float, bool]:
    """Axis limits (low, high) that hold identified parameters, intervals and priors, and True for a logarithmic axis.

    All are divided by initial values: identified values `ratio` (n_params,), ends of the 95 % intervals `interval` and
    of the priors `prior`, (n_params, 2) each. The mask `is_identified` (n_params,) is True for parameters that the data
    determine. The axis is logarithmic if all values of these, and 1, are positive and spread over more than a factor of
    4; its low end is then not far below the least value. Parameters that are not identified widen the limits if they
    are within a factor of 3 of them or, on a linear axis, within their distance.
    """
    ends = np.concatenate([[1.0], ratio[is_identified], interval[is_identified].ravel(), prior.ravel()])
    ends = ends[np.isfinite(ends)]
    centre = np.append(ratio[is_identified & np.isfinite(ratio)], 1.0)
    others = ratio[~is_identified & np.isfinite(ratio)]
    if (centre > 0).all() and centre.max() / centre.min() > 4:
        low, high = max(float(ends[ends > 0].min()), float(centre.min()) / 2), float(ends.max())
        near = np.concatenate([[low, high], others[(others > low / 3) & (others < 3 * high)]])
        return float(near.min()) / 1.15, float(near.max()) * 1.15, True
    low, high = float(ends.min()), float(ends.max())
    reach = max(high - low, 0.2)
    near = np.concatenate([[low, high], others[(others > low - reach) & (others < high + reach)]])
    low, high = float(near.min()), float(near.max())
    margin = max(0.06 * (high - low), 0.005)
    return low - margin, high + margin, False


def _ratio_axis(label: str, limits: plot.Limits, log: bool, room: float = 0.0) -> plot.Axis:
    """Axis `label` of relative values with these `limits`, extended at both ends by the fraction `room` of its length.

    It is logarithmic if `log`, then with plain numbers as tick labels.
    """
    low, high = limits
    if not log:
        return plot.Axis(label, limits=(low - room * (high - low), high + room * (high - low)))
    steps = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high / low < 15 else (1.0, 2.0, 5.0) if high / low < 300 else (1.0,)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    values = [step * 10.0**decade for decade in decades for step in steps]
    ticks = tuple((value, f"{value:g}") for value in values if low <= value <= high)
    return plot.Axis(label, limits=(low * (low / high) ** room, high * (high / low) ** room), log=True, ticks=ticks)


def correlation_figure(identification: Identification) -> plot.Figure:
    """Heat map of the correlation matrix of the parameters' errors; grey for undetermined standard deviations."""
    names = identification.estimate.names
    matrix = np.clip(identification.estimate.spread.correlation, -1.0, 1.0)
    scale = plot.ColourScale(palette.DIVERGING, -1.0, 1.0, "correlation (grey: not determined)")
    panel = plot.matrix_panel(matrix, names, "", scale)
    size = float(np.clip(200 + 26 * len(names) + 7 * max(len(name) for name in names), 550, 1100))
    caption = "Correlation between the errors of two parameters, from the adopted covariance. Grey: not determined."
    return plot.Figure((replace(panel, background="#D9D9D9"),), (size + 80, size), caption=caption)


def convergence_figure(identification: Identification) -> plot.Figure:
    """Figure of parameters divided by their initial values over the iterations of all stages of the search.

    The seven that changed most in ratio have a colour and a name, all further ones are grey.
    """
    estimate = identification.estimate
    courses = [stage.history for stage in estimate.search.stages] or [estimate.search.history]
    ratio = np.concatenate(courses) / np.where(estimate.initial != 0, estimate.initial, np.nan)
    begins = np.cumsum([0, *(len(course) - 1 for course in courses)])[:-1].tolist()
    change = np.nan_to_num(np.abs(np.log(np.where(ratio[-1] > 0, ratio[-1], np.nan))))
    highlighted = np.argsort(-change, kind="stable")[:_N_HIGHLIGHTED].tolist()
    others = [i for i in range(len(estimate.names)) if i not in highlighted]
    colours = dict(zip(highlighted, palette.CYCLE, strict=False))
    iteration = np.concatenate(
        [begin + np.arange(len(course), dtype=float) for begin, course in zip(begins, courses, strict=True)]
    )
    last = int(iteration[-1])
    finite = ratio[np.isfinite(ratio)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (1.0, 1.0)
    log = low > 0 and high / low > 8
    margin = max(0.06 * (high - low), 0.01)
    limits = (max(low, 1e-3) / 1.3, min(high, 1e3) * 1.3) if log else (low - margin, high + margin)
    traces: list[plot.Trace] = []
    if len(begins) > 1:
        grey = plot.Pen(palette.MUTED, 1.2, "dot")
        traces.append(plot.segments((begins[1:], begins[1:]), limits, grey, "a new stage begins"))
    for i in (*others, *highlighted):
        colour, named = colours.get(i, palette.FAINT), i in colours
        marker = plot.Marker(size=4.0, colour=colour) if named else None
        label = estimate.names[i] if named else f"{len(others)} others"
        traces.append(
            plot.Curve(iteration, ratio[:, i], plot.Pen(colour, 2.0 if named else 1.2), marker, label, plot.NUMBERS)
        )
    x = plot.Axis("iteration", limits=(-0.02 * last - 0.1, 1.02 * last + 0.1), ticks=plot.whole_ticks(0, last))
    caption = "Parameters along the search that led to the answer; those that changed most are named."
    caption += " Stages solve easier problems first, each from where the one before ended." if len(courses) > 1 else ""
    caption += f" Grey: the {len(others)} other parameters." if others else ""
    panel = plot.panel(x, _ratio_axis("value / initial value", limits, log), *traces)
    return plot.Figure((panel,), (950.0, 340.0), caption=caption)


_BEFORE = plot.Marker("square", 10.0, "", plot.Pen(palette.INITIAL, 2.0))
_AFTER = plot.Marker("circle", 8.0, palette.FITTED)
_SIZE = (525.0, 380.0)
#: MAC that a pair of modes of one number has the advantage of: close modes turn into each other without a meaning.
_SAME_NUMBER = 0.1
#: Part of the highest frequency below which a mode is that of a rigid body.
RIGID = 1e-4


@dataclass(frozen=True, eq=False)
class ModeRows:
    """Modes of the identified model by number, each beside the mode of the initial model with the likest shape.

    Attributes
    ----------
    initial_number : (n_modes,) int array
        Number of that mode in the initial model, from 1.
    initial_frequency, frequency, initial_damping, damping : (n_modes,) float arrays
    mac : (n_modes,) float array
        Modal assurance criterion between the initial and the identified shape.
    """

    initial_number: IntArray
    initial_frequency: FloatArray
    frequency: FloatArray
    initial_damping: FloatArray
    damping: FloatArray
    mac: FloatArray


def mode_rows(fit: Identification | RecordFit) -> ModeRows:
    """Frequencies (Hz), damping ratios and MAC of modes of the identified model and of their like in the initial one.

    Rows follow the identified modes, as many as both models have; the number of the initial mode counts from 1. Pairs
    have the largest sum of MACs, so that modes which change their order stay together; modes of one number are paired
    unless others are clearly more alike, rigid body modes always. The MAC is of shapes at the model's degrees of
    freedom, NaN for a shape of zeros.
    """
    before, after = fit.modes_initial, fit.modes
    n = min(len(before.frequency), len(after.frequency))
    x, y = after.mode_shapes[:, :n], before.mode_shapes
    size = np.outer((x**2).sum(axis=0), (y**2).sum(axis=0))
    mac = np.divide((x.T @ y) ** 2, size, out=np.full(size.shape, np.nan), where=size > 0)
    likeness = np.nan_to_num(mac) + _SAME_NUMBER * np.eye(*mac.shape)
    rigid = [shown < RIGID * shown.max(initial=0.0) for shown in (after.frequency[:n], before.frequency)]
    either = rigid[0][:, None] | rigid[1]
    partner = assign_pairs(np.where(either, np.eye(*mac.shape), likeness))[1]
    return ModeRows(
        partner + 1,
        before.frequency[partner],
        after.frequency[:n],
        before.damping_ratio[partner],
        after.damping_ratio[:n],
        mac[np.arange(n), partner],
    )


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
    caption = (
        "Natural frequencies and damping ratios of the identified model, and of the modes of the initial model with the likest"
        " shapes."
    )
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

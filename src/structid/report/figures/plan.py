"""A plan: where the sensors go, how well each parameter would be known, and which lines are measured."""

from __future__ import annotations

import numpy as np

from structid.core.display import plural
from structid.core.dof import Dof
from structid.inversion.diagnostics.collinearity import percent_text
from structid.planning.planned import Plan, PlannedTest
from structid.report.drawing import palette
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.structure import structure_figure
from structid.report.rendering import plot

_SYMBOLS = ("square", "circle", "diamond", "triangle-up")
_COLOURS = (palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.INK)
#: Beyond this relative standard deviation a mark stands at the edge of the drawing.
_OFF_SCALE = 1e3


def plan_figures(plan: Plan) -> dict[str, plot.Figure]:
    """Figures of a test plan by name: "plan_places" and "plan_std", and if available two more.

    "plan_effective_independence" if that method chose other sensors, "plan_lines" if frequency lines were chosen.
    """
    figures = {"plan_places": _places(plan, plan.chosen)}
    if plan.kammer is not None and set(plan.kammer.sensors) != set(plan.chosen.sensors):
        figures["plan_effective_independence"] = _places(plan, plan.kammer)
    figures["plan_std"] = std_figure(plan)
    if plan.frequencies is not None:
        figures["plan_lines"] = lines_figure(plan, plan.frequencies)
    return figures


def compared_tests(plan: Plan) -> tuple[PlannedTest, ...]:
    """Tests of a plan that are compared, without missing ones: installed, chosen, chosen lines, and everything measured."""
    tests = (plan.installed, plan.chosen, plan.frequencies, plan.everything)
    return tuple(test for test in tests if test is not None)


def _places(plan: Plan, test: PlannedTest) -> plot.Figure:
    worst = f"worst std {percent_text(test.worst_std)} ({plan.parameters.names[test.worst]})"
    title = f"{test.label}: {plural(len(test.sensors), 'sensor')}, {plural(len(test.loads), 'load')}; {worst}"
    return structure_figure(structure_picture(plan.structure, test.sensors, test.loads), title=title)


def std_figure(plan: Plan) -> plot.Figure:
    """Figure of the predicted relative standard deviation of every parameter, with one marker for each compared test.

    A line marks the target if there is one; values beyond the axis are drawn with an arrow at its end.
    """
    tests, target = compared_tests(plan), plan.options.target
    of_interest = zip(plan.parameters.names, plan.chosen.of_interest, strict=True)
    names = [name + ("" if counts else " (nuisance)") for name, counts in of_interest]
    shown = [np.where(np.isnan(test.std), np.inf, test.std) for test in tests]
    finite = [std[np.isfinite(std) & (std < _OFF_SCALE)] for std in shown]
    low, high = _limits(np.concatenate([*finite, [] if target is None else [target]]))
    if any((std >= _OFF_SCALE).any() for std in shown):
        high = max(high, 10.0)  # so that they stand beyond 100 %
    ends, edge, row = (-0.6, len(names) - 0.4), high * (low / high) ** 0.05, np.arange(len(names), dtype=float)
    traces: list[plot.Trace] = []
    if high > 1:
        traces.append(plot.boxes((1.0, high), ends, palette.GRID, "not determined (over 100 %)"))
    if target is not None:
        pen = plot.Pen(palette.GREEN, 1.7)
        traces.append(plot.segments((target, target), ends, pen, f"wanted: {percent_text(target)}"))
    for k, (test, std) in enumerate(zip(tests, shown, strict=True)):
        height, off = row + 0.5 * ((k + 0.5) / len(tests) - 0.5), std > high
        texts = tuple(f"{name}, {test.label}: {percent_text(float(s))}" for name, s in zip(names, std, strict=True))
        sign, arrow = plot.Marker(_SYMBOLS[k], 6.5, _COLOURS[k]), plot.Marker("triangle-right", 6.0, _COLOURS[k])
        traces.append(plot.Curve(np.where(off, edge, std), height, None, sign, test.label, texts))
        beyond = np.full(int(off.sum()), edge * (high / low) ** 0.025)  # an arrow to what lies beyond
        traces.append(plot.Curve(beyond, height[off], None, arrow))
    ticks = tuple((value, percent_text(value)) for value, _ in plot.decade_ticks(low, high))
    label = "predicted std over initial value"
    panel = plot.panel(plot.Axis(label, limits=(low, high), log=True, ticks=ticks), plot.rows_axis(names), *traces)
    return plot.Figure((panel,), plot.rows_size(len(names)))


def _limits(finite: np.ndarray) -> tuple[float, float]:
    """Logarithmic axis limits (low, high): powers of ten around the values `finite`; (0.1, 10) if it is empty."""
    if not finite.size:
        return 0.1, 10.0
    low = 10.0 ** np.floor(np.log10(finite.min() / 1.2))
    return float(low), float(max(10.0 ** np.ceil(np.log10(finite.max() * 1.2)), 10 * low))


def lines_figure(plan: Plan, chosen: PlannedTest) -> plot.Figure:
    """Figure of the frequency lines of the test `chosen` over the FRF of the initial model at the plan's sensors and loads."""
    frequency, magnitude = _response(plan, plan.chosen.sensors, plan.chosen.loads)
    at = np.interp(chosen.frequency, frequency, magnitude)
    spread = np.diff(np.log(np.maximum(frequency, np.finfo(float).tiny)))
    even = len(spread) > 1 and float(np.ptp(spread)) < 1e-6
    label = "initial model, RMS over chosen sensors and loads"
    dots = plot.Marker("circle", 6.5, palette.VERMILLION, plot.Pen("white", 0.7))
    panel = plot.panel(
        plot.Axis("frequency", "Hz", log=even),
        plot.Axis(f"{plan.options.kind} (SI units)", limits=plot.decade_limits(magnitude), log=True),
        plot.Curve(frequency, magnitude, plot.Pen(palette.INK, 1.6), label=label, hover=plot.NUMBERS),
        plot.Curve(np.asarray(chosen.frequency), at, None, dots, f"{len(at)} chosen lines", plot.NUMBERS),
    )
    return plot.Figure((panel,), (860.0, 360.0))


def _response(plan: Plan, sensors: tuple[Dof, ...], loads: tuple[Dof, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n_lines,) in Hz and RMS of the initial model's FRF magnitudes over these sensors and loads, (n_lines,)."""
    from structid.forward.frf.response import response
    from structid.records import FrfRecord

    frequency = np.asarray(plan.options.frequency)
    blank = np.zeros((len(frequency), len(sensors), len(loads)), dtype=np.complex128)
    record = FrfRecord(frequency, blank, sensors, loads, plan.options.kind)
    values = response(plan.structure, plan.parameters, record).values_at(plan.parameters.start)
    return frequency, np.sqrt(np.mean(np.abs(values) ** 2, axis=(1, 2)))

"""Report of a plan: words and tables for the terminal, and its page."""

from __future__ import annotations

import math

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.core.display import exact, join_words, plural, prefixed
from structid.core.dof import Dof
from structid.inversion.diagnostics.identifiability import percent_text
from structid.planning.planned import Plan, PlannedTest
from structid.records.record import FRF_UNITS
from structid.report.drawing import palette
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.structure import structure_figure
from structid.report.page import Page, Table, printed
from structid.report.rendering import plot
from structid.study.results.plan import PLAN_PAGE

_MOST_GROUPS, _MOST_PLACES, _MOST_LINES = 5, 12, 40
_HEADER = (
    "test",
    "sensors",
    "loads",
    "lines",
    "determined",
    "worst std",
    "worst parameter",
    "RMS std",
    "with tolerances",
)
_SYMBOLS = ("square", "circle", "diamond", "triangle-up")
_COLOURS = (palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.INK)
#: Beyond this relative standard deviation a mark stands at the edge of the drawing.
_OFF_SCALE = 1e3


def plan_text(plan: Plan, title: str, notes: tuple[str, ...]) -> list[RenderableType]:
    """Terminal text of a test plan: options, compared tests, next sensor, sufficient tests, parameters, collinear groups.

    `notes` are remarks on the study, put first. `title` is the heading.
    """
    parts: list[RenderableType] = [Text(title, style="bold"), *(Text(f"note: {note}") for note in notes)]
    parts.append(Text(options_text(plan)))
    parts.append(printed(test_table(plan)))
    parts += [Text(line) for line in (*tolerance_lines(plan), *_answer_lines(plan))]
    parts.append(printed(parameter_table(plan)))
    parts += [Text(f"the chosen test determines {d.words}") for d in plan.identifiability.directions]
    groups = plan.identifiability.groups
    parts += [Text(f"in the chosen test {group.words}") for group in groups[:_MOST_GROUPS]]
    if len(groups) > _MOST_GROUPS:
        parts.append(Text(f"and {len(groups) - _MOST_GROUPS} more groups, in plan.json"))
    return parts


def options_text(plan: Plan) -> str:
    """Sentence on the candidates (sensors, loads, lines), noise, criterion and assumptions of a test plan."""
    options = plan.options
    frequency = options.frequency
    interest = f", for {', '.join(options.of_interest)}" if options.of_interest else ""
    return (
        f"candidates: {plural(len(options.sensors), 'sensor')}, {plural(len(options.loads), 'load')},"
        f" {plural(len(frequency), 'line')} from"
        f" {frequency[0]:.4g} to {frequency[-1]:.4g} Hz, {options.kind}, noise {_noise_words(plan)};"
        f" {options.criterion.upper()}-optimal{interest}; standard deviations (std) are predicted, relative to the initial"
        " values"
    )


def _noise_words(plan: Plan) -> str:
    """Words on the noise that a test plan assumes, relative and absolute; "" if it assumes none."""
    options = plan.options
    noise = [f"{100 * options.relative_noise:.3g} % of each value"] if options.relative_noise else []
    noise += [f"{options.absolute_noise:.3g} {FRF_UNITS[options.kind]}"] if options.absolute_noise else []
    return " and ".join(noise)


def _answer_lines(plan: Plan) -> list[str]:
    """Lines on what was chosen, how much is enough, and what to add next; a doubt about a model without damping first."""
    return [*undamped_lines(plan), *choice_lines(plan), *enough_lines(plan), *next_lines(plan)]


def tolerance_lines(plan: Plan) -> list[str]:
    """At most one line on the errors that the deviations of the table include: noise, and tolerances in the last column."""
    if not plan.assumption:
        return []
    return [
        f"std include noise alone; the last column includes {plan.assumption} too, which more lines and averages do not reduce"
    ]


def undamped_lines(plan: Plan) -> list[str]:
    """At most one line, on a model without any damping."""
    if not plan.is_undamped:
        return []
    return [
        f"std assume noise of {_noise_words(plan)} and a model without any damping, whose resonances are infinitely high:"
        " a real structure will tell far less; give the model damping, such as `damping_ratio = 0.01` in [structure]",
    ]


def test_table(plan: Plan) -> Table:
    """Table with a row for each planned test: sensors, loads, lines, determined parameters, worst and rms deviations."""
    total = len(plan.parameters.names)
    rows = tuple(
        (
            test.label,
            str(len(test.sensors)),
            str(len(test.loads)),
            str(len(test.frequency)),
            f"{test.n_determined} of {total}",
            percent_text(test.worst_std),
            plan.parameters.names[test.worst],
            percent_text(test.rms_std),
            percent_text(test.worst_with_tolerances),
        )
        for test in plan.tests
    )
    return Table(_HEADER, rows, (1, 2, 3, 4, 5, 7, 8))


def parameter_table(plan: Plan) -> Table:
    """Table of the predicted relative standard deviation of each parameter, with one column for each compared test.

    Undetermined parameters have an infinite one; those not of interest are marked as nuisance.
    """
    tests = compared_tests(plan)
    header = ("parameter", "initial", "unit", *(f"std, {test.label}" for test in tests))
    rows = []
    for i, name in enumerate(plan.parameters.names):
        mark = "" if plan.chosen.of_interest[i] else " (nuisance)"
        shown = (percent_text(math.inf if math.isnan(test.std[i]) else float(test.std[i])) for test in tests)
        start = float(plan.parameters.start[i])
        factor, unit = prefixed(plan.parameters.units[i], start)
        rows.append((name + mark, exact(start / factor), unit, *shown))
    return Table(header, tuple(rows), (1, *range(3, len(header))))


def choice_lines(plan: Plan) -> list[str]:
    """Lines of text on the chosen sensors and loads and, if lines were chosen, on these; most informative first.

    A line on the sensors by effective independence is added where these were computed; at most 40 frequency lines are
    listed.
    """
    lines = [
        f"chosen sensors: {places(plan.chosen.sensors)}; loads: {places(plan.chosen.loads)}",
        *([] if plan.kammer is None else [f"effective independence would take: {places(plan.kammer.sensors)}"]),
    ]
    if plan.frequencies is not None:
        shown = [f"{f:.5g}" for f in plan.frequencies.frequency[:_MOST_LINES]]
        more = (
            f" and {len(plan.frequencies.frequency) - len(shown)} more"
            if len(shown) < len(plan.frequencies.frequency)
            else ""
        )
        lines.append(f"chosen lines, Hz: {', '.join(shown)}{more}")
    return lines


def enough_lines(plan: Plan) -> list[str]:
    """Two lines of text on how many sensors, lines and averages reach the wanted accuracy; [] if none was wanted.

    The first is on sensors at all lines, the second on lines with the chosen sensors.
    """
    enough = plan.enough
    if enough is None:
        return []
    wanted = percent_text(enough.target)
    if enough.sensors is None:
        most = percent_text(plan.everything.worst_std)
        first = f"all sensors at the chosen loads do not reach {wanted} (all candidates: {most})"
    else:
        first = f"{plural(len(enough.sensors.sensors), 'sensor')} at all lines reach {wanted}: {places(enough.sensors.sensors)}"
    if enough.frequencies is None:
        second = f"the chosen sensors do not reach {wanted} at all lines"
    else:
        second = f"{plural(len(enough.frequencies.frequency), 'line')} with the chosen sensors reach {wanted}"
    if math.isfinite(enough.averages) and enough.averages > 1:
        second += f"; {math.ceil(enough.averages)} times as many averages would"
    return [first, second]


def next_lines(plan: Plan) -> list[str]:
    """At most one line of text: the three best sensors to add next, and the worst standard deviation each would leave.

    They are added to the installed test, or to the chosen one if nothing is installed. [] if none was tried.
    """
    if not plan.next_sensors:
        return []
    base = plan.installed or plan.chosen
    listed = ", ".join(f"{test.sensors[-1]} ({percent_text(test.worst_std)})" for test in plan.next_sensors[:3])
    return [
        f"next best sensor beside the {base.label} ones, with the worst std that it would leave: {listed};"
        f" {percent_text(base.worst_std)} without it"
    ]


def places(dofs: tuple[Dof, ...]) -> str:
    """Names of the first twelve of `dofs`, joined by commas, and how many more there are."""
    return join_words(dofs, _MOST_PLACES)


def plan_page(plan: Plan, title: str = "", notes: tuple[str, ...] = ()) -> Page:
    """Report page of a test plan, with its figures; `notes` are remarks on the study. An empty `title` becomes "Structure"."""
    words = {
        "title": title or "Structure",
        "determined": plan.determined,
        "chosen_determines": plan.chosen.determined,
        "lines": _answer_lines(plan),
        "assumptions": [options_text(plan), *tolerance_lines(plan)],
        "remarks": [
            *notes,
            *(f"the chosen test determines {d.words}" for d in plan.identifiability.directions),
            *(f"in the chosen test {group.words}" for group in plan.identifiability.groups),
        ],
        "tests": test_table(plan),
        "parameters": parameter_table(plan),
    }
    return Page(PLAN_PAGE, "plan.html.j2", plan_figures(plan), words)


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
    """Figure of the structure with the sensors and loads of `test`; the title names the parameter of largest std."""
    worst = f"worst std {percent_text(test.worst_std)} ({plan.parameters.names[test.worst]})"
    title = f"{test.label}: {plural(len(test.sensors), 'sensor')}, {plural(len(test.loads), 'load')}; {worst}"
    return structure_figure(structure_picture(plan.structure, test.sensors, test.loads), title=title)


def std_figure(plan: Plan) -> plot.Figure:
    """Figure of the predicted relative standard deviation of every parameter, with one marker for each compared test.

    The range above 100 % is marked as not determined. A line marks the target if there is one; values beyond the axis
    are drawn with an arrow at its end.
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
    """Logarithmic axis limits (low, high): powers of ten just outside the values `finite`; (0.1, 10) if it is empty."""
    if not finite.size:
        return 0.1, 10.0
    low = 10.0 ** np.floor(np.log10(finite.min() / 1.2))
    return float(low), float(max(10.0 ** np.ceil(np.log10(finite.max() * 1.2)), 10 * low))


def lines_figure(plan: Plan, chosen: PlannedTest) -> plot.Figure:
    """Figure of the frequency lines of the test `chosen` over the FRF of the initial model at the plan's sensors and loads."""
    frequency, magnitude = _response(plan, plan.chosen.sensors, plan.chosen.loads)
    heights = np.interp(chosen.frequency, frequency, magnitude)
    spread = np.diff(np.log(np.maximum(frequency, np.finfo(float).tiny)))
    even = len(spread) > 1 and float(np.ptp(spread)) < 1e-6
    label = "initial model, RMS over chosen sensors and loads"
    dots = plot.Marker("circle", 6.5, palette.VERMILLION, plot.Pen("white", 0.7))
    panel = plot.panel(
        plot.Axis("frequency", "Hz", log=even),
        plot.Axis(f"{plan.options.kind} (SI units)", limits=plot.decade_limits(magnitude), log=True),
        plot.Curve(frequency, magnitude, plot.Pen(palette.INK, 1.6), label=label, hover=plot.NUMBERS),
        plot.Curve(np.asarray(chosen.frequency), heights, None, dots, f"{len(heights)} chosen lines", plot.NUMBERS),
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

"""Pictures of a plan: where the sensors go, and how well each parameter would be known."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from structid.dof import Dof
from structid.estimation.diagnostics.collinearity import percent_text
from structid.planning.planned import Plan, PlannedTest
from structid.report.drawing import palette
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.png_structure import structure_figure
from structid.report.figures.png_style import DPI, STYLE, plain
from structid.report.planning.text import compared
from structid.report.text import counted

_MARKERS = ("s", "o", "D", "^")
_COLOURS = (palette.BLUE, palette.VERMILLION, palette.PURPLE, palette.INK)
#: Beyond this relative standard deviation a mark stands at the edge of the drawing.
_OFF_SCALE = 1e3


def plan_pictures(found: Plan) -> dict[str, bytes]:
    """PNG files by name: the chosen places, those of effective independence, standard deviations, and lines."""
    makers: dict[str, Callable[[], Figure | None]] = {
        "plan_places": lambda: _places(found, found.chosen),
        "plan_effective_independence": lambda: _places(found, found.kammer) if _differs(found) else None,
        "plan_std": lambda: std_figure(found),
        "plan_lines": lambda: lines_figure(found),
    }
    pictures = {}
    with matplotlib.rc_context(STYLE):
        for name, make in makers.items():
            figure = make()
            if figure is not None:
                stream = BytesIO()
                figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
                pictures[name] = stream.getvalue()
    return pictures


def write_plan_pictures(pictures: dict[str, bytes], folder: Path) -> None:
    """Write them into the existing `folder`."""
    for name, content in pictures.items():
        (folder / f"{name}.png").write_bytes(content)


def _differs(found: Plan) -> bool:
    return set(found.kammer.sensors) != set(found.chosen.sensors)


def _places(found: Plan, test: PlannedTest) -> Figure:
    figure = structure_figure(structure_picture(found.structure, test.sensors, test.loads))
    worst = f"worst std {percent_text(test.worst_std)} ({found.parameters.names[test.worst]})"
    title = f"{test.label}: {counted(len(test.sensors), 'sensor')}, {counted(len(test.loads), 'load')}; {worst}"
    figure.suptitle(plain(title), fontsize=9.5)
    return figure


def std_figure(found: Plan) -> Figure:
    """Predicted relative standard deviation of every parameter, one mark a test, on a logarithmic axis."""
    tests = compared(found)
    names = found.parameters.names
    height = 1.3 + 0.24 * len(names) + 0.2 * len(tests)
    figure = Figure(figsize=(8.6, min(height, 60.0)), layout="constrained")
    axes = figure.subplots()
    row = np.arange(len(names))
    shown = [np.where(np.isnan(test.std), np.inf, test.std) for test in tests]
    finite = np.concatenate([std[np.isfinite(std) & (std < _OFF_SCALE)] for std in shown])
    wanted = [found.options.target] if found.options.target is not None else []
    low, high = _limits(np.append(finite, wanted))
    if any((std >= _OFF_SCALE).any() for std in shown):
        high = max(high, 10.0)  # so that they stand beyond 100 %
    if found.options.target is not None:
        axes.axvline(
            found.options.target, color=palette.GREEN, lw=1.2, label=f"wanted: {percent_text(found.options.target)}"
        )
    if high > 1:
        axes.axvspan(1.0, high, color=palette.GRID, lw=0, label="not determined (over 100 %)")
    edge = high * (low / high) ** 0.05  # what lies beyond stands here, with an arrow
    for k, (test, std) in enumerate(zip(tests, shown, strict=True)):
        offset = 0.5 * ((k + 0.5) / len(tests) - 0.5)
        place = np.where(std > high, edge, std)
        axes.plot(place, row + offset, _MARKERS[k], color=_COLOURS[k], ms=4.5, label=test.label)
        for i in np.flatnonzero(std > high):
            axes.annotate(
                "", (high, i + offset), (edge, i + offset), arrowprops={"arrowstyle": "->", "color": _COLOURS[k]}
            )
    _name_rows(axes, names, found.chosen.of_interest)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: percent_text(value)))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axes.set_xlabel("predicted standard deviation, relative to the initial value")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _name_rows(axes: Axes, names: tuple[str, ...], of_interest: np.ndarray) -> None:
    texts = [plain(name) + ("" if counts else " (nuisance)") for name, counts in zip(names, of_interest, strict=True)]
    axes.set_yticks(np.arange(len(names)), labels=texts)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=palette.GRID)
    for i in range(1, len(names)):
        axes.axhline(i - 0.5, color=palette.GRID, lw=0.5)


def _limits(finite: np.ndarray) -> tuple[float, float]:
    """Powers of ten around the marks, at least one decade."""
    if not finite.size:
        return 0.1, 10.0
    low = 10.0 ** np.floor(np.log10(finite.min() / 1.2))
    return float(low), float(max(10.0 ** np.ceil(np.log10(finite.max() * 1.2)), 10 * low))


def lines_figure(found: Plan) -> Figure | None:
    """The chosen lines over the response of the initial model at the chosen places; None where no number is asked for."""
    if found.frequencies is None:
        return None
    frequency, magnitude = _response(found, found.chosen.sensors, found.chosen.loads)
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(frequency, magnitude, color=palette.INK, lw=1.2, label="initial model, RMS over chosen sensors and loads")
    at = np.interp(found.frequencies.frequency, frequency, magnitude)
    label = f"{len(at)} chosen lines"
    axes.plot(found.frequencies.frequency, at, "o", color=palette.VERMILLION, ms=4.5, mec="white", mew=0.5, label=label)
    axes.set_yscale("log")
    spread = np.diff(np.log(np.maximum(found.options.frequency, np.finfo(float).tiny)))
    if len(spread) > 1 and np.ptp(spread) < 1e-6:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"{found.options.kind} (SI units)")
    axes.grid(color=palette.GRID)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _response(found: Plan, sensors: tuple[Dof, ...], loads: tuple[Dof, ...]) -> tuple[np.ndarray, np.ndarray]:
    from structid.observation.frf.response import response
    from structid.records import FrfRecord

    frequency = np.asarray(found.options.frequency)
    blank = np.zeros((len(frequency), len(sensors), len(loads)), dtype=np.complex128)
    record = FrfRecord(frequency, blank, sensors, loads, found.options.kind)
    values = response(found.structure, found.parameters, record).values_at(found.parameters.start)
    return frequency, np.sqrt(np.mean(np.abs(values) ** 2, axis=(1, 2)))

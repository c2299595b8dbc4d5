"""The figures as PNG files, drawn on `Figure` objects with no global state left behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from structid.files import atomic_write
from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.drawing.picture import Picture
from structid.report.figures.data import (
    History,
    ModeRows,
    ParameterRatios,
    Responses,
    band_used,
    correlation,
    history,
    mode_rows,
    parameter_ratios,
    ratio_ticks,
    responses,
)
from structid.report.figures.modal_data import modal_rows
from structid.report.figures.modal_fit import modal_fit_png
from structid.report.figures.png_residuals import residual_channels_figure, residual_map_figure
from structid.report.figures.png_responses import coherence_figure, magnitude_figure, phase_figure
from structid.report.figures.png_structure import structure_figure
from structid.report.figures.png_style import DPI, STYLE, plain, skipped
from structid.report.text import DASH, MINUS

_ROWS_A_COLUMN = 32


def write_figures(
    identification: Identification, data: Responses | None, drawn: Picture, folder: Path
) -> tuple[Path, ...]:
    """Paths of the PNG files written to `folder`."""
    makers: dict[str, Callable[[], Figure | None]] = {
        "parameters": lambda: parameters_figure(parameter_ratios(identification)),
        "structure": lambda: structure_figure(drawn),
        **_first_record(data),
        "correlation": lambda: correlation_figure(correlation(identification), identification.estimate.names),
        "modes": lambda: modes_figure(mode_rows(identification), band_used(identification, data)),
        "convergence": lambda: convergence_figure(history(identification)),
    }
    makers.update(further_records(identification))
    for number, fit in enumerate(identification.modal_fits, 1):
        makers[f"modal_fit_{number}"] = partial(modal_fit_png, modal_rows(fit))
    return write_pngs(makers, folder)


def write_pngs(makers: Mapping[str, Callable[[], Figure | None]], folder: Path) -> tuple[Path, ...]:
    """Paths of the PNG files written to `folder`, by name; no file where there is no figure."""
    written = []
    with matplotlib.rc_context(STYLE):
        for name, make in makers.items():
            figure = make()
            path = folder / f"{name}.png"
            if figure is None:
                path.unlink(missing_ok=True)
                continue
            with atomic_write(path) as temporary:
                figure.savefig(temporary, dpi=DPI, format="png", metadata={"Software": None})
            written.append(path)
    return tuple(written)


def _first_record(data: Responses | None) -> dict[str, Callable[[], Figure | None]]:
    """Responses and residuals of the first record; no files where all records are of modes."""
    draw: dict[str, Callable[[Responses], Figure | None]] = {
        "frf_magnitude": magnitude_figure,
        "frf_phase": phase_figure,
        "coherence": coherence_figure,
        "residual_by_channel": residual_channels_figure,
        "residual_map": residual_map_figure,
    }
    return {name: partial(_drawn, make, data) for name, make in draw.items()}


def _drawn(make: Callable[[Responses], Figure | None], data: Responses | None) -> Figure | None:
    return None if data is None else make(data)


def further_records(identification: Identification) -> dict[str, Callable[[], Figure | None]]:
    """Responses and residuals of every record but the first."""
    makers: dict[str, Callable[[], Figure | None]] = {}
    for number in range(1, len(identification.fits)):
        data = responses(identification.fits[number])
        for name, draw in (
            ("frf_magnitude", magnitude_figure),
            ("frf_phase", phase_figure),
            ("residual_by_channel", residual_channels_figure),
        ):
            makers[f"record_{number + 1}_{name}"] = partial(draw, data)
    return makers


def parameters_figure(rows: ParameterRatios) -> Figure:
    """A dot with its intervals for every parameter, over the initial value."""
    n = len(rows.names)
    n_columns = 1 if n <= _ROWS_A_COLUMN else 2
    per_column = -(-n // n_columns)
    figure = Figure(figsize=(10.5 if n_columns == 1 else 15, 1.7 + 0.27 * per_column), layout="constrained")
    grid = figure.subplots(1, n_columns, squeeze=False, sharex=True)[0]
    for column, axes in enumerate(grid):
        part = np.arange(column * per_column, min((column + 1) * per_column, n))
        _parameter_rows(axes, rows, part)
        axes.set_ylim(per_column - 0.4, -0.6)
    entries: dict[str, Any] = {}
    for axes in grid:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.legend(entries.values(), entries.keys(), loc="outside upper center", ncols=7 if n_columns > 1 else 4)
    return figure


def _parameter_rows(axes: matplotlib.axes.Axes, rows: ParameterRatios, part: np.ndarray) -> None:
    place = np.arange(len(part))
    low, high = rows.limits
    ratio, std, wild = rows.ratio[part], rows.std[part], rows.is_wild[part]
    axes.axvline(1.0, color=palette.INITIAL, lw=1.2, label="initial value", zorder=1)
    prior, half = rows.prior_mean[part], rows.prior_std[part]
    given = np.isfinite(half)
    if given.any():
        look: dict[str, Any] = {"height": 0.72, "color": palette.SKY, "alpha": 0.35, "zorder": 0}
        axes.barh(place[given], 2 * half[given], left=(prior - half)[given], label="prior ± 1 std", **look)
    if wild.any():
        look = {"color": palette.MUTED, "lw": 1.2, "ls": (0, (4, 3)), "zorder": 2}
        axes.hlines(place[wild], low, high, label="not determined", **look)
    known = ~wild
    ends = np.clip(rows.interval[part][known].T, low / 10 if rows.log else None, None)
    axes.hlines(place[known], *ends, color=palette.INK, lw=1.0, label="95 % interval", zorder=3)
    ends = np.clip([ratio[known] - std[known], ratio[known] + std[known]], low / 10 if rows.log else None, None)
    axes.hlines(place[known], *ends, color=palette.INK, lw=3.2, label="± 1 std", zorder=3)
    shown, sure, beyond = rows.shown[part], rows.identified[part], rows.is_beyond[part]
    filled: dict[str, Any] = {"color": palette.FITTED, "mec": "white", "mew": 0.7, "label": "identified"}
    hollow: dict[str, Any] = {"mfc": "white", "mec": palette.FITTED, "clip_on": False}
    groups = (
        ("o", sure & ~beyond, filled),
        ("o", ~sure & ~beyond, hollow | {"label": "not identified"}),
        ("<", ratio < low, hollow),
        (">", ratio > high, hollow),
    )
    for marker, which, look in groups:
        if which.any():
            axes.plot(shown[which], place[which], ls="", marker=marker, ms=6, zorder=5, **look)
    axes.set_yticks(place, [plain(rows.names[i]) for i in part])
    _ratio_axis(axes, rows.limits, rows.log, "x")
    axes.set_xlabel("identified value / initial value")
    axes.grid(axis="y", color=palette.GRID)


def _ratio_axis(axes: matplotlib.axes.Axes, limits: tuple[float, float], log: bool, which: str) -> None:
    """Limits and plain numbers on a ratio axis, logarithmic or not."""
    if log:
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    (axes.set_xlim if which == "x" else axes.set_ylim)(*limits)
    if log:
        ticks = ratio_ticks(limits)
        axis = axes.xaxis if which == "x" else axes.yaxis
        axis.set_ticks([value for value, _ in ticks], labels=[text for _, text in ticks])
        axis.set_minor_locator(NullLocator())


def correlation_figure(matrix: np.ndarray, names: tuple[str, ...]) -> Figure:
    """Heat map of the correlation matrix, names on both axes."""
    n = len(names)
    size = min(max(5.5, 0.32 * n + 3.2), 14.0)
    figure = Figure(figsize=(size + 0.8, size), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("#D9D9D9")
    image = axes.imshow(matrix, cmap=palette.DIVERGING, vmin=-1, vmax=1)
    ticks = skipped(n, 45)
    axes.set_xticks(ticks, [plain(names[i]) for i in ticks], rotation=90)
    axes.set_yticks(ticks, [plain(names[i]) for i in ticks])
    if n > 24:
        axes.tick_params(labelsize=7)
    if n <= 16:
        for (row, column), value in np.ndenumerate(matrix):
            text = f"{value:.2f}".replace("-", MINUS) if np.isfinite(value) else DASH
            axes.text(column, row, text, ha="center", va="center", fontsize=7, color=_on(value))
    bar = figure.colorbar(image, ax=axes, shrink=0.75, aspect=30)
    bar.set_label("correlation (grey: not determined)")
    return figure


def _on(value: float) -> str:
    """Colour of a text on the diverging colour of `value`."""
    return "white" if abs(value) > 0.6 else palette.INK


def modes_figure(rows: ModeRows, band: tuple[float, float]) -> Figure:
    """Natural frequencies and damping ratios before and after, by mode number."""
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    number = np.arange(1, len(rows.frequency) + 1)
    left.axhspan(*band, color=palette.YELLOW, alpha=0.25, lw=0, label="band used")
    pairs = ((left, rows.initial_frequency, rows.frequency), (right, 100 * rows.initial_damping, 100 * rows.damping))
    for axes, before, after in pairs:
        axes.vlines(number, before, after, color=palette.MUTED, lw=1.0)
        axes.plot(number, before, "s", mfc="white", mec=palette.INITIAL, ms=7, label="initial")
        axes.plot(number, after, "o", color=palette.FITTED, ms=6, label="identified")
        axes.set_xlabel("mode number")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylim(bottom=min(0.0, float(np.min([before, after]))))
    left.set_ylabel("natural frequency (Hz)")
    right.set_ylabel("damping ratio (%)")
    left.legend(loc="upper left")
    return figure


def convergence_figure(course: History) -> Figure:
    """Parameters over their initial values against the iteration; the largest changes in colour."""
    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    axes = figure.subplots()
    iteration = np.arange(len(course.ratio))
    others = [i for i in range(len(course.names)) if i not in course.highlighted]
    for i in others:
        axes.plot(iteration, course.ratio[:, i], color=palette.FAINT, lw=0.9)
    for i, colour in zip(course.highlighted, palette.CYCLE, strict=False):
        axes.plot(iteration, course.ratio[:, i], color=colour, lw=1.6, marker="o", ms=3, label=plain(course.names[i]))
    if others:
        axes.plot([], [], color=palette.FAINT, lw=0.9, label=f"{len(others)} others")
    _ratio_axis(axes, course.limits, course.log, "y")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("iteration of the last stage")
    axes.set_ylabel("value / initial value")
    axes.grid(color=palette.GRID)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure

"""The figures of modes as PNG files."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from structid.modal.survey.survey import ModesResult
from structid.report.drawing import palette
from structid.report.figures.png_style import DPI, STYLE, plain
from structid.report.modes.data import (
    ALONE,
    CHOSEN,
    CLUSTERED,
    KIND_NAMES,
    MOST_SHAPES,
    OUTSIDE,
    auto_mac,
    mode_labels,
    spectrum_label,
    spectrum_limits,
    sweep_poles,
    thinned_lines,
    turned_shapes,
    view,
)
from structid.report.modes.scene import Scene, flat, mode_scene
from structid.report.modes.text import mpc
from structid.report.text import number

#: Marker, size, face, edge of each kind of pole: told apart by shape as well as by colour.
_MARKS = {
    OUTSIDE: (".", 2.5, palette.FAINT, "none"),
    ALONE: ("x", 4.0, palette.MUTED, palette.MUTED),
    CLUSTERED: ("o", 4.2, "white", palette.BLUE),
    CHOSEN: ("D", 6.0, palette.VERMILLION, "white"),
}
_STYLES = ("-", "--", ":")
_COLUMNS = 4


def mode_pictures(result: ModesResult) -> dict[str, bytes]:
    """PNG files by name; those that the method cannot give are left out."""
    makers: dict[str, Callable[[], Figure | None]] = {
        "stabilization": lambda: stabilization_figure(result),
        "singular_values": lambda: spectra_figure(result),
        "damping": lambda: damping_figure(result),
        "automac": lambda: mac_figure(result),
        "complexity": lambda: complexity_figure(result),
        "mode_shapes": lambda: shapes_figure(result),
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


def stabilization_figure(result: ModesResult) -> Figure | None:
    """Poles of every order over the first singular value; None without orders."""
    poles = sweep_poles(result)
    if poles is None:
        return None
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.subplots()
    behind = axes.twinx()
    frequency, values = thinned_lines(result, 1)
    behind.semilogy(frequency, values[:, 0], color=palette.SKY, lw=1.0)
    behind.set_ylim(*spectrum_limits(result))
    behind.set_ylabel(f"first of the {plain(spectrum_label(result))}", color=palette.BLUE)
    behind.spines["right"].set_visible(True)
    axes.set_zorder(behind.get_zorder() + 1)
    axes.patch.set_visible(False)
    for kind, (marker, size, face, edge) in _MARKS.items():
        here = poles.kind == kind
        if here.any():
            axes.plot(
                poles.frequency[here], poles.order[here], marker, ms=size, mfc=face, mec=edge, mew=0.9, ls="none",
                label=KIND_NAMES[kind],
            )  # fmt: skip
    _mode_lines(axes, result)
    axes.set_xlim(*view(result))
    axes.set_ylim(0, poles.order.max() * 1.04 + 1)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("order of the model (states)")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def _mode_lines(axes: Axes, result: ModesResult) -> None:
    """A line at every mode, its number above."""
    for f in result.modes.frequency:
        axes.axvline(f, color=palette.VERMILLION, lw=0.7, alpha=0.6, zorder=0)
    for f, text in mode_labels(result):
        axes.annotate(
            text, (f, 1), (0, 2), xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=8, color=palette.VERMILLION,
        )  # fmt: skip


def spectra_figure(result: ModesResult) -> Figure:
    """The first three singular values with the modes marked."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    axes = figure.subplots()
    frequency, values = thinned_lines(result)
    names = ("first", "second", "third")
    for j in range(values.shape[1]):
        colour = (palette.INK, palette.BLUE, palette.PURPLE)[j]
        axes.semilogy(frequency, values[:, j], _STYLES[j], color=colour, lw=1.1, label=f"{names[j]} singular value")
    _mode_lines(axes, result)
    axes.set_xlim(*view(result))
    axes.set_ylim(*spectrum_limits(result))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(plain(spectrum_label(result)))
    axes.grid(color=palette.GRID)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def damping_figure(result: ModesResult) -> Figure | None:
    """Damping ratio over frequency with one standard deviation; None where the method gives no damping."""
    modes, n = result.modes, result.modes.n_modes
    known = np.isfinite(modes.damping_ratio)
    if not known.any():
        return None
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    std = np.nan_to_num(result.std)
    axes.errorbar(
        modes.frequency, 100 * modes.damping_ratio, 100 * std[n:], std[:n], "D", color=palette.VERMILLION, ms=5,
        ecolor=palette.INK, capsize=3, lw=1.0,
    )  # fmt: skip
    for k in np.flatnonzero(known):
        place = (modes.frequency[k], 100 * modes.damping_ratio[k])
        axes.annotate(str(k + 1), place, (6, 5), textcoords="offset points", fontsize=8, color=palette.VERMILLION)
    least, most = (modes.damping_ratio - std[n:])[known].min(), (modes.damping_ratio + std[n:])[known].max()
    axes.set_ylim(min(0.0, 110 * float(least)), max(112 * float(most), 0.1))
    axes.set_xlim(*view(result))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("damping ratio (%)")
    axes.grid(color=palette.GRID)
    return figure


def mac_figure(result: ModesResult) -> Figure:
    """MAC of the modes with each other."""
    matrix, n = auto_mac(result), result.modes.n_modes
    size = 2.6 + 0.34 * min(n, 30)
    figure = Figure(figsize=(size + 0.9, size), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(matrix, cmap=palette.SEQUENTIAL, vmin=0, vmax=1)
    if n <= 14:
        for i in range(n):
            for j in range(n):
                colour = "white" if matrix[i, j] < 0.6 else palette.INK
                axes.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=7.5, color=colour)
    step = -(-n // 20)
    texts = [f"{k + 1}" if k % step == 0 else "" for k in range(n)]
    axes.set_xticks(range(n), texts)
    axes.set_yticks(range(n), texts)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_xlabel("mode")
    axes.set_ylabel("mode")
    figure.colorbar(image, ax=axes, label="MAC", shrink=0.85)
    return figure


def complexity_figure(result: ModesResult) -> Figure:
    """Entries of every shape in the complex plane."""
    shapes, collinearity = turned_shapes(result), mpc(result)
    count = min(result.modes.n_modes, MOST_SHAPES)
    columns = min(count, _COLUMNS)
    rows = -(-count // columns)
    figure = Figure(figsize=(2.35 * columns + 0.3, 2.6 * rows + 0.1), layout="constrained")
    for k in range(count):
        axes = figure.add_subplot(rows, columns, k + 1, projection="polar")
        angle, size = np.angle(shapes[:, k]), np.abs(shapes[:, k])
        axes.plot(np.stack([angle, angle]), np.stack([0 * size, size]), color=palette.BLUE, lw=1.2)
        axes.plot(angle, size, "o", color=palette.VERMILLION, ms=3.5, mec="white", mew=0.5)
        axes.set_ylim(0, 1.08)
        axes.set_xticks(np.radians([0, 90, 180, 270]), ["0°", "90°", "180°", "270°"])
        axes.set_yticks([0.5, 1.0], ["", ""])
        axes.tick_params(labelsize=7, pad=-2)
        axes.grid(color=palette.GRID)
        axes.set_title(_mode_title(result, k) + f"\nMPC {collinearity[k]:.3f}", fontsize=8.5, pad=10)
    return figure


def _mode_title(result: ModesResult, k: int) -> str:
    return f"mode {k + 1}: {number(result.modes.frequency[k])} Hz"


def shapes_figure(result: ModesResult) -> Figure:
    """Every shape at two phases half a turn apart, over the structure at rest."""
    scene = mode_scene(result.modes, result.geometry)
    count = min(result.modes.n_modes, MOST_SHAPES)
    columns = min(count, 3 if scene.is_row else _COLUMNS)
    rows = -(-count // columns)
    wide, high = _panel(scene)
    figure = Figure(figsize=(wide * columns + 0.3, high * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=scene.is_row, sharex=scene.is_row).ravel()
    for k, axes in enumerate(panels):
        if k >= count:
            axes.set_axis_off()
            continue
        _shape(axes, scene, k)
        axes.set_title(_mode_title(result, k), fontsize=8.5)
    entries = {
        text: handle for axes in panels[:1] for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=4)
    return figure


def _panel(scene: Scene) -> tuple[float, float]:
    """Width and height of one panel, in."""
    if scene.is_row:
        return 3.0, 2.1
    spread = np.ptp(flat(np.concatenate([scene.at(0, 0.0), scene.at(0, np.pi), scene.rest])), axis=0)
    aspect = float(np.clip(spread[1] / spread[0] if spread[0] > 0 else 2.0, 0.35, 1.8))
    return 2.35, 2.35 * aspect + 0.3


def _shape(axes: Axes, scene: Scene, mode: int) -> None:
    symbols = ("o", "s", "^", "D", "v", "P")
    for number_, path in enumerate(scene.paths):
        symbol = symbols[number_ % len(symbols)] if scene.is_row else "o"
        for points, colour, style, name in (
            (scene.rest, palette.FAINT, "-", "at rest"),
            (scene.at(mode, np.pi), palette.BLUE, "--", "half a period later"),
            (scene.at(mode, 0.0), palette.VERMILLION, "-", "deflected"),
        ):
            line = _with_gaps(flat(points), path.points)
            if not path.is_measured:
                colour, style, name = palette.KNOWN, ":", "not between two sensors"
            shown = symbol if path.is_measured else "."
            extra = f", {path.name}" if scene.is_row and len(scene.paths) > 1 and name == "deflected" else ""
            axes.plot(*line.T, style, color=colour, lw=1.2, marker=shown, ms=3.2, label=name + extra)
    if scene.is_row:
        axes.set_ylim(-1.15, 1.15)
        step = -(-len(scene.ticks) // 8)
        axes.set_xticks(range(0, len(scene.ticks), step), scene.ticks[::step])
        axes.label_outer()
        axes.set_xlabel("node" if axes.get_subplotspec().is_last_row() else "")  # type: ignore[union-attr]
        axes.grid(axis="y", color=palette.GRID)
    else:
        axes.set_aspect("equal")
        axes.set_axis_off()


def _with_gaps(points: np.ndarray, chain: tuple[int, ...]) -> np.ndarray:
    """The points of `chain`, NaN where it has a gap."""
    indices = np.array(chain)
    line = points[indices]
    line[indices < 0] = np.nan
    return line

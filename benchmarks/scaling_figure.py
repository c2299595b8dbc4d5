"""The figure of `scaling.py`: time and memory of every law, with fitted and expected slopes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator

from structid.report.drawing import palette
from structid.report.rendering.png import DPI, STYLE

_ACROSS = 4
_KINDS = (("seconds", "time_slope", 1.0, "time, s", palette.BLUE, "o"),
          ("memory", "memory_slope", 1e6, "memory, MB", palette.VERMILLION, "s"))  # fmt: skip


def draw(results: list[dict[str, Any]], path: Path) -> None:
    """One panel a law for time, and one below it for memory.

    Parameters
    ----------
    results : list of dict
        As in `scaling.json`.
    path : Path
        PNG.
    """
    bands = -(-len(results) // _ACROSS)
    with matplotlib.rc_context(STYLE):
        figure, grid = plt.subplots(
            2 * bands, _ACROSS, figsize=(11.0, 4.6 * bands), layout="constrained", squeeze=False
        )
        for axes in grid.ravel():
            axes.set_visible(False)
        for i, law in enumerate(results):
            band, column = divmod(i, _ACROSS)
            for k, kind in enumerate(_KINDS):
                axes = grid[2 * band + k, column]
                axes.set_visible(True)
                _panel(axes, law, kind)
                if column == 0:
                    axes.set_ylabel(kind[3])
            grid[2 * band, column].set_title(law["title"], loc="left")
            grid[2 * band + 1, column].set_xlabel(law["axis"])
        figure.savefig(path, dpi=DPI)
        plt.close(figure)


def _panel(axes: Any, law: dict[str, Any], kind: tuple[str, str, float, str, str, str]) -> None:
    """Points, the line fitted to the last of them, and the expected slope through the last one."""
    key, expected, unit, _, colour, marker = kind
    size = np.array([point["size"] for point in law["points"]], dtype=float)
    value = np.array([max(point[key], 1e-9) for point in law["points"]]) / unit
    last = size[-3:]
    level = np.exp(np.log(value[-3:]).mean())
    axes.loglog(size, value, marker, color=colour, markersize=5)
    found = law["slopes"][key]
    if np.isfinite(found):
        fitted = level * (last / np.exp(np.log(last).mean())) ** found
        axes.loglog(last, fitted, "-", color=colour, linewidth=1.2, label=f"slope {found:.2f}")
    reference = value[-1] * (size / size[-1]) ** law[expected]
    axes.loglog(size, reference, "--", color=palette.MUTED, linewidth=1.0, label=f"expected {law[expected]:g}")
    low, high = value.min(), value.max()
    room = max(10.0 / (high / low), 1.0) ** 0.5  # at least a decade, so that what is flat looks flat
    axes.set_ylim(low / room / 1.6, high * room * 4.0)
    axes.grid(True, color=palette.GRID, linewidth=0.6)
    axes.minorticks_off()
    axes.set_xticks(size, [_short(n) for n in size])
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high / low < 300 else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(loc="upper left", handlelength=1.6, borderaxespad=0.2)


def _short(number: float) -> str:
    """A size in few letters: 30k, 1M."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if number >= unit:
            return f"{number / unit:.3g}{letter}"
    return f"{number:g}"

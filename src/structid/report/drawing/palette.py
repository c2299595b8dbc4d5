"""Colours that colour-blind readers can tell apart, shared by the PNG figures and the page.

References
----------
Okabe and Ito (2008), Color Universal Design; Nunez, Anderton and Renslow (2018), PLoS ONE 13, e0199239 (cividis).
"""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
from matplotlib.colors import to_hex

from structid.arrays import FloatArray, IntArray

ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILLION, PURPLE, BLACK = "#0072B2", "#D55E00", "#CC79A7", "#000000"
#: Colours for curves that belong to no role, in order.
CYCLE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK, YELLOW)

INK, MUTED, FAINT, GRID = "#222222", "#6B6B6B", "#B8B8B8", "#E3E3E3"
#: Roles that every figure shares.
MEASURED, FITTED, INITIAL, OUTSIDE = INK, VERMILLION, BLUE, FAINT
SENSOR, LOAD, SUPPORT, RIGID, KNOWN = GREEN, VERMILLION, "#444444", "#8A8A8A", "#C9C9C9"

DIVERGING, SEQUENTIAL = "PuOr", "cividis"
#: Number of colours of a map that the drawings of the structure use.
N_STEPS = 21


@cache
def colours(name: str, count: int = N_STEPS) -> tuple[str, ...]:
    """`count` evenly spaced colours of a matplotlib colour map, as hexadecimal text."""
    table = matplotlib.colormaps[name]
    return tuple(to_hex(table(x)) for x in np.linspace(0.0, 1.0, count))


def plotly_scale(name: str, count: int = N_STEPS) -> list[list[object]]:
    """The same colours as a Plotly colour scale."""
    return [[float(x), c] for x, c in zip(np.linspace(0.0, 1.0, count), colours(name, count), strict=True)]


def diverging_step(change: FloatArray, limit: float) -> IntArray:
    """Which of the `N_STEPS` diverging colours belongs to each change; the middle one is no change."""
    unit = np.clip(np.nan_to_num(np.asarray(change) / limit), -1.0, 1.0)
    return np.rint((unit + 1.0) / 2.0 * (N_STEPS - 1)).astype(np.int64)

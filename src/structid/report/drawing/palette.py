"""Colours that colour-blind readers can tell apart, shared by every figure.

References
----------
Okabe and Ito (2008), Color Universal Design; Nunez, Anderton and Renslow (2018), PLoS ONE 13, e0199239 (cividis);
Harrower and Brewer (2003), The Cartographic Journal 40, 27 (PuOr).
"""

from __future__ import annotations

from functools import cache

import numpy as np

ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILLION, PURPLE, BLACK = "#0072B2", "#D55E00", "#CC79A7", "#000000"
#: Colours for curves that belong to no role, in order.
CYCLE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK, YELLOW)

INK, MUTED, FAINT, GRID = "#222222", "#6B6B6B", "#B8B8B8", "#E3E3E3"
#: Roles that every figure shares.
MEASURED, FITTED, INITIAL, OUTSIDE = INK, VERMILLION, BLUE, FAINT
SENSOR, LOAD, SUPPORT, RIGID, KNOWN = GREEN, VERMILLION, "#444444", "#8A8A8A", "#C9C9C9"

DIVERGING, SEQUENTIAL = "PuOr", "cividis"
#: Colours at even distances, between which a scale is linear.
SCALES = {
    "PuOr": (
        "#7F3B08", "#B35806", "#E08214", "#FDB863", "#FEE0B6", "#F7F7F7", "#D8DAEB", "#B2ABD2", "#8073AC", "#542788",
        "#2D004B",
    ),
    "cividis": (
        "#00224E", "#0C3470", "#35456C", "#50576C", "#666970", "#7D7C78", "#948E77", "#AEA371", "#C8B866", "#E5CF52",
        "#FEE838",
    ),
}  # fmt: skip
#: Number of colours of a scale that drawings of the structure use.
N_STEPS = 41


@cache
def steps(name: str, count: int = N_STEPS) -> tuple[str, ...]:
    """Hexadecimal codes, such as "#0072B2", of `count` evenly spaced colours of the scale `name`, a key of `SCALES`."""
    anchors = np.array([[int(text[i : i + 2], 16) for i in (1, 3, 5)] for text in SCALES[name]])
    positions = np.linspace(0.0, len(anchors) - 1.0, count)
    channels = [np.rint(np.interp(positions, np.arange(len(anchors)), channel)).astype(int) for channel in anchors.T]
    return tuple(f"#{red:02X}{green:02X}{blue:02X}" for red, green, blue in zip(*channels, strict=True))

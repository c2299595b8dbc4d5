"""What all PNG figures share: style, resolution, plain text."""

from __future__ import annotations

from functools import cache
from typing import Any

from matplotlib.font_manager import findfont, get_font

from structid.report.drawing import palette

DPI = 150
#: Settings that hold while a figure is drawn, so that a user's own do not change the report.
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.edgecolor": palette.MUTED,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "hatch.linewidth": 0.8,
    "text.usetex": False,
    "path.simplify": True,
}


@cache
def _glyphs() -> frozenset[int]:
    return frozenset(get_font(findfont("DejaVu Sans")).get_charmap())


def plain(text: str) -> str:
    """`text` with no mathematics in it and a box for every character that the font lacks."""
    known = "".join(c if ord(c) in _glyphs() else "□" for c in text)
    return known.replace("$", r"\$")


def skipped(count: int, most: int) -> list[int]:
    """Indices of the labels to show where there is room for `most` of `count`: evenly spaced, the first among them."""
    return list(range(0, count, max(1, -(-count // most))))

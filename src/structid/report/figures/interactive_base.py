"""What all figures of the page share: layout, axes, numbers and text that is safe to show."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structid.report.drawing import palette


@dataclass(frozen=True)
class Figure:
    """Traces and layout of one Plotly figure, and the caption below it."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    caption: str
    extra: dict[str, Any] | None = None

    def described(self) -> dict[str, Any]:
        """What the page's script needs, ready for JSON."""
        return {"data": self.data, "layout": self.layout, **(self.extra or {})}


def numbers(values: ArrayLike, digits: int = 5) -> list[Any]:
    """`values` as a flat list with `digits` significant digits; None for what is not finite."""
    flat = np.asarray(values, dtype=np.float64).ravel().tolist()
    return [float(f"{v:.{digits - 1}e}") if np.isfinite(v) else None for v in flat]


def clean(text: str) -> str:
    """`text` with the characters escaped that Plotly would read as markup."""
    return html.escape(text, quote=False)


def base_layout(height: int, left: int | None = 70) -> dict[str, Any]:
    """Font, margins, legend and background; `left` None leaves the left margin to the labels."""
    margin = {"l": 20 if left is None else left, "r": 20, "t": 50, "b": 55}
    return {
        "height": height,
        "margin": margin,
        "font": {
            "family": "Segoe UI, Helvetica Neue, DejaVu Sans, Arial, sans-serif",
            "size": 13,
            "color": palette.INK,
        },
        "legend": {"orientation": "h", "x": 0, "y": 1.01, "yanchor": "bottom"},
        "plot_bgcolor": "white",
        "paper_bgcolor": "white",
        "hovermode": "closest",
    }


def axis(title: str) -> dict[str, Any]:
    """A light grid, outside ticks and the title."""
    return {
        "title": {"text": title, "font": {"size": 13}, "standoff": 8},
        "gridcolor": palette.GRID,
        "linecolor": palette.MUTED,
        "showline": True,
        "ticks": "outside",
        "zeroline": False,
    }

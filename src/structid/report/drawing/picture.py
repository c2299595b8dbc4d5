"""What a drawing of a structure consists of, in drawing units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from structid.arrays import FloatArray
from structid.report.rendering import plot


@dataclass(frozen=True, eq=False)
class Mark:
    """One element, or one face of it.

    Attributes
    ----------
    element, index, label : str, int, str
        Element set, which of its elements, and the name of that.
    path : (n, 2) float array
        What is drawn; NaN lifts the pen.
    filled : bool
        Whether it is an area.
    centre : (2,) float array
    nodes : tuple of int
        Of a face.
    outline : (n, 2) float array
        Of a face, from node to node.
    """

    element: str
    index: int
    label: str
    path: FloatArray
    filled: bool
    centre: FloatArray
    nodes: tuple[int, ...] = ()
    outline: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Picture:
    """A structure on paper: elements, what stands before and behind them, and what the reader should know (`notes`).

    `bounds` are left, right, bottom and top.
    """

    behind: tuple[plot.Trace, ...]
    marks: tuple[Mark, ...]
    before: tuple[plot.Trace, ...]
    bounds: tuple[float, float, float, float]
    notes: tuple[str, ...]

    @property
    def aspect(self) -> float:
        """Width over height."""
        left, right, bottom, top = self.bounds
        return (right - left) / (top - bottom)

    @property
    def is_wide(self) -> bool:
        """Whether panels belong below instead of beside each other."""
        return self.aspect > 1.6


def curve(path: FloatArray, pen: plot.Pen, label: str = "") -> plot.Curve:
    """A line along `path`, (n, 2)."""
    return plot.Curve(path[:, 0], path[:, 1], pen, label=label)


def points(places: FloatArray, texts: tuple[str, ...], marker: plot.Marker = plot.UNSEEN) -> plot.Curve:
    """Points at `places`, (n, 2), that answer to the mouse."""
    return plot.Curve(places[:, 0], places[:, 1], None, marker, hover=texts)

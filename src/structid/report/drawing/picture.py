"""What a drawing of a structure consists of, in drawing units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.report.drawing.labels import Placed


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
class Arrow:
    """A sensor or a load."""

    dof: Dof
    shaft: FloatArray
    heads: tuple[FloatArray, ...]
    tip: FloatArray


@dataclass(frozen=True, eq=False)
class Picture:
    """Shapes of the structure in drawing units.

    Attributes
    ----------
    marks : tuple of Mark
    grounds, links, supports : (n, 2) paths
        Walls of grounded connectors, rigid links and constraints, and triangles of supports.
    nodes : (n_nodes, 2) float array
    node_texts : tuple of str
        What each node is, for the reader who points at it.
    sensors, loads : tuple of Arrow
    axes : tuple of (str, path)
        Names and short lines of the global axes.
    labels : tuple of Placed
    bounds : (float, float, float, float)
        Left, right, bottom, top.
    notes : tuple of str
        What the reader should know about the drawing.
    """

    marks: tuple[Mark, ...]
    grounds: FloatArray
    links: FloatArray
    supports: tuple[FloatArray, ...]
    nodes: FloatArray
    node_texts: tuple[str, ...]
    sensors: tuple[Arrow, ...]
    loads: tuple[Arrow, ...]
    axes: tuple[tuple[str, FloatArray], ...]
    labels: tuple[Placed, ...]
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

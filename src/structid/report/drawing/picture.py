"""Parts of a drawing of a structure, in drawing units, and the projection of space to paper."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from structid.core.arrays import FloatArray
from structid.fem import Structure
from structid.report.rendering import plot

_AZIMUTH, _ELEVATION = np.radians(-62.0), np.radians(22.0)
#: Paper's directions of the global axes, one a row, of structures that fill space.
SPACE_AXES = np.array(
    [
        [-np.sin(_AZIMUTH), -np.sin(_ELEVATION) * np.cos(_AZIMUTH)],
        [np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH)],
        [0.0, np.cos(_ELEVATION)],
    ]
)
#: Of those that lie in the plane of X and Y.
PLANE_AXES = np.array([[1.0, 0.0], [0.0, 1.0], [-0.5, -0.5]])


@dataclass(frozen=True, eq=False)
class Mark:
    """Drawing of one element or of one of its faces.

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
        """True if panels belong below instead of beside each other."""
        return self.aspect > 1.6


def curve(path: FloatArray, pen: plot.Pen, label: str = "") -> plot.Curve:
    """Plot curve along `path` (n, 2), where NaN rows lift the pen."""
    return plot.Curve(path[:, 0], path[:, 1], pen, label=label)


def points(positions: FloatArray, texts: tuple[str, ...], marker: plot.Marker = plot.UNSEEN) -> plot.Curve:
    """Points at `positions` (n, 2) that show `texts` under the mouse; invisible by default."""
    return plot.Curve(positions[:, 0], positions[:, 1], None, marker, hover=texts)


def is_spatial(structure: Structure) -> bool:
    """True if the structure has three dimensions and nodes at different heights Z."""
    return structure.dimension == 3 and len({place[2] for place in structure.nodes.values()}) > 1


def paper_axes(structure: Structure) -> FloatArray:
    """Directions on paper of the global axes, (3, 2): a row for each of X, Y and Z."""
    return SPACE_AXES if is_spatial(structure) else PLANE_AXES


def sight(structure: Structure) -> FloatArray:
    """Unit vector towards the viewer in global axes, (dimension,); zero for structures in one or two dimensions."""
    if is_spatial(structure):
        return np.cross(*SPACE_AXES.T)
    return np.array([0.0, 0.0, 1.0])[: structure.dimension]

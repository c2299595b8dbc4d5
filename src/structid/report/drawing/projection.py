"""How space is laid on paper."""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray
from structid.structure import Structure

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


def is_spatial(structure: Structure) -> bool:
    """Whether nodes lie at different heights Z."""
    return structure.dimension == 3 and len({place[2] for place in structure.nodes.values()}) > 1


def paper_axes(structure: Structure) -> FloatArray:
    """The axes on which `structure` is drawn."""
    return SPACE_AXES if is_spatial(structure) else PLANE_AXES


def sight(structure: Structure) -> FloatArray:
    """Direction towards the eye."""
    if is_spatial(structure):
        return np.cross(*SPACE_AXES.T)
    return np.array([0.0, 0.0, 1.0])[: structure.dimension]

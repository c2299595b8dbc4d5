"""How space is laid on paper: rows are the paper's directions of the global axes."""

from __future__ import annotations

import numpy as np

_AZIMUTH, _ELEVATION = np.radians(-62.0), np.radians(22.0)
#: Of structures with three coordinates.
SPACE_AXES = np.array(
    [
        [-np.sin(_AZIMUTH), -np.sin(_ELEVATION) * np.cos(_AZIMUTH)],
        [np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH)],
        [0.0, np.cos(_ELEVATION)],
    ]
)
#: Of those with one or two.
PLANE_AXES = np.array([[1.0, 0.0], [0.0, 1.0], [-0.5, -0.5]])

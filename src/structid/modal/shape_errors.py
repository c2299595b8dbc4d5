"""Errors of mode shapes, freed from the scaling that hides one of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structid.arrays import FloatArray

_ROUNDING = 1e-9


def unscaled_shape_std(shapes: NDArray[np.inexact], std: FloatArray) -> FloatArray:
    """Standard deviations of shapes whose scale is free, from those of shapes with one entry held at 1.

    A shape psi = phi / phi_t has no error at its entry t, whose own error is in all others: to first order
    var(psi_i) = var(phi_i) + |psi_i|^2 var(phi_t), in parts of phi_t. With errors taken as equal and independent this
    gives var(phi_i) = var(psi_i) / (1 + |psi_i|^2), and for t their mean. Least squares with a free scale would take
    the missing error for certainty.

    Parameters
    ----------
    shapes : (n_channels, n_modes) array
        Largest entry of size 1.
    std : (n_channels, n_modes) float array
        0 (to rounding) at one entry of a column; columns without a 0, or without anything else, stay as they are. NaN
        where an entry is unknown.

    Returns
    -------
    (n_channels, n_modes) float array
    """
    freed = np.array(std, dtype=np.float64)
    held = std <= _ROUNDING * np.nan_to_num(std).max(axis=0, initial=0.0)
    for m in np.flatnonzero(held.any(axis=0) & (std > 0).any(axis=0)):
        free = ~held[:, m]
        freed[free, m] = std[free, m] / np.sqrt(1 + np.abs(shapes[free, m]) ** 2)
        freed[~free, m] = np.sqrt(np.nanmean(freed[free, m] ** 2))
    return freed

"""How alike two sets of mode shapes or response functions are: pure functions of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from structid.arrays import FloatArray, require_finite
from structid.errors import InputError


def mac(first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Modal assurance criterion |x_i^H y_j|^2 / (x_i^H x_i  y_j^H y_j) of every pair of columns.

    1 where two shapes agree up to a factor, real or complex; 0 where they are orthogonal.

    Parameters
    ----------
    first : (n_channels, n_first) array, real or complex
        Mode shapes; one shape may be given as (n_channels,).
    second : (n_channels, n_second) array, optional
        By default `first` against itself.

    Returns
    -------
    (n_first, n_second) float array

    Raises
    ------
    InputError
        If the channels differ in number, or a shape is zero throughout.

    References
    ----------
    Allemang and Brown (1982), A correlation coefficient for modal vector analysis, Proc. 1st IMAC.

    Examples
    --------
    >>> mac([1.0, 2.0], [2.0, 4.0]).item()
    1.0
    """
    x = _columns("first", first)
    y = x if second is None else _columns("second", second)
    _require_same_rows(x, y)
    cross = np.abs(x.conj().T @ y) ** 2
    return cross / np.outer(_energies("first", x), _energies("second", y))


def frac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Frequency response assurance criterion: `mac` along the frequency axis, function by function.

    Parameters
    ----------
    first, second : (n_frequencies, ...) arrays, real or complex
        Response functions at the same frequencies.

    Returns
    -------
    (...) float array
        From 0 to 1. A common factor of a whole function does not lower it, a shift of its peaks does.

    Raises
    ------
    InputError
        If the shapes differ, or a function is zero throughout.

    References
    ----------
    Heylen and Lammens (1996), FRAC: a consistent way of comparing frequency response functions.
    """
    x, y = np.asarray(first), np.asarray(second)
    if x.shape != y.shape or x.ndim == 0:
        raise InputError(f"`first` and `second` must have one shape, got {x.shape} and {y.shape}")
    require_finite("first", x)
    require_finite("second", y)
    x, y = x.reshape(len(x), -1), y.reshape(len(y), -1)
    cross = np.abs(np.sum(x.conj() * y, axis=0)) ** 2
    values = cross / (_energies("first", x) * _energies("second", y))
    return values.reshape(np.shape(first)[1:])


def subspace_angles(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Principal angles between the spans of two sets of shapes, rad, smallest first.

    The measure for close or repeated modes, whose single shapes are not determined though their span is.

    Parameters
    ----------
    first, second : (n_channels, n_first) and (n_channels, n_second) arrays, real or complex
        Columns span the two subspaces.

    Returns
    -------
    (min(n_first, n_second),) float array
        0 to pi/2; all zero where one span holds the other.

    References
    ----------
    Knyazev and Argentati (2002), SIAM J. Sci. Comput. 23(6), 2009-2041.
    """
    x, y = _columns("first", first), _columns("second", second)
    _require_same_rows(x, y)
    angles: FloatArray = linalg.subspace_angles(x, y)[::-1]
    return angles


def _columns(name: str, values: ArrayLike) -> NDArray[np.inexact]:
    array = np.asarray(values)
    if not np.issubdtype(array.dtype, np.inexact):
        array = array.astype(np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"`{name}` must be (n_channels, n_shapes), got shape {np.shape(values)}; one shape a column")
    require_finite(name, array)
    return array


def _require_same_rows(x: NDArray[np.inexact], y: NDArray[np.inexact]) -> None:
    if x.shape[0] != y.shape[0]:
        raise InputError(
            f"`first` and `second` must have the same channels, got {x.shape[0]} and {y.shape[0]}; "
            "bring them to common sensors first"
        )


def _energies(name: str, x: NDArray[np.inexact]) -> FloatArray:
    energies: FloatArray = np.sum(np.abs(x) ** 2, axis=0)
    if (energies == 0).any():
        raise InputError(f"`{name}` is zero throughout in column {int(np.argmin(energies)) + 1}; leave it out")
    return energies

"""Similarity of two sets of mode shapes: MAC, COMAC, ECOMAC, orthogonality and angles between their spans."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from structid.core.arrays import FloatArray, require_finite
from structid.core.errors import InputError
from structid.similarity.responses import energies


def mac(first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Modal assurance criterion |x_i^H y_j|^2 / (x_i^H x_i  y_j^H y_j) of every pair of columns.

    1 where two shapes agree up to a factor, real or complex; 0 where they are orthogonal.

    Parameters
    ----------
    first : (n_channels, n_first) array, real or complex
        Mode shapes; one shape may be given as (n_channels,). Entries that are unknown are NaN: a pair is held against each
        other where both are known.
    second : (n_channels, n_second) array, optional
        By default `first` against itself.

    Returns
    -------
    (n_first, n_second) float array
        NaN where two shapes have no known entry in common.

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
    x, y = _check_channels(first, second)
    known_x, known_y = (~np.isnan(z) for z in (x, y))
    x, y = np.where(known_x, x, 0.0), np.where(known_y, y, 0.0)
    for name, shapes, known in (("first", x, known_x), ("second", y, known_y)):
        energies(name, np.where(known.any(axis=0), shapes, 1.0))
    cross = np.abs(x.conj().T @ y) ** 2
    energy = ((np.abs(x) ** 2).T @ known_y) * (known_x.T @ (np.abs(y) ** 2))
    shared = known_x.T.astype(float) @ known_y
    return np.where(shared > 0, np.divide(cross, energy, out=np.zeros_like(cross), where=energy > 0), np.nan)


def comac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Coordinate modal assurance criterion (COMAC) of each channel: `mac` along the modes of paired shapes.

    COMAC_c = |sum_r x_cr^* y_cr|^2 / (sum_r |x_cr|^2  sum_r |y_cr|^2), each pair of shapes scaled to size 1 and y turned
    to the phase of x: 1 where a channel follows the other set in every mode. A channel that is only turned round keeps
    its COMAC; see `ecomac`.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Column r of one is paired with column r of the other. NaN where an entry is unknown: the others count.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel moves in no mode of one of the sets, or is unknown in all.

    Raises
    ------
    InputError
        If the shapes differ, or a column is zero throughout.

    References
    ----------
    Lieven and Ewins (1988), Spatial correlation of mode shapes, the COMAC, Proc. 6th IMAC; Allemang (2003), The modal
    assurance criterion: twenty years of use and abuse, Sound and Vibration 37(8), 14-23.
    """
    x, y, _ = _paired_columns(first, second)
    cross = np.abs(np.sum(x.conj() * y, axis=1)) ** 2
    energy = np.sum(np.abs(x) ** 2, axis=1) * np.sum(np.abs(y) ** 2, axis=1)
    return np.divide(cross, energy, out=np.full(len(x), np.nan), where=energy > 0)


def ecomac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Enhanced COMAC of each channel: mean distance of the paired shapes, sum_r |x_cr - y_cr| / (2 n_modes).

    Each pair of shapes is scaled to size 1 (in the mean over channels) and y turned to the phase of x: 0 where a channel
    agrees in every mode, large where its sense, its gain or its place is wrong.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Column r of one is paired with column r of the other. NaN where an entry is unknown: the others count.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel is unknown in all modes.

    References
    ----------
    Hunt (1992), Application of an enhanced coordinate modal assurance criterion, Proc. 10th IMAC; Allemang (2003).
    """
    x, y, known = _paired_columns(first, second)
    distance = np.sum(np.abs(x - y) * np.sqrt(known.sum(axis=0)), axis=1)
    count = 2.0 * known.sum(axis=1)
    return np.divide(distance, count, out=np.full(len(x), np.nan), where=count > 0)


def orthogonality(mass: ArrayLike, first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """|x_i^H M y_j| / sqrt(x_i^H M x_i  y_j^H M y_j) of every pair of columns: 1 for the same motion, 0 for orthogonal ones.

    Of one set (self-orthogonality, second left out) the off-diagonal entries of measured modes stay below 0.1 by the usual
    rule; of measured and modelled shapes (cross-orthogonality) those of pairs are above 0.9.

    Parameters
    ----------
    mass : (n_channels, n_channels) array
        Reduced to the channels; see `structid.compare.correlation.expansion`.
    first : (n_channels, n_first) array, real or complex
    second : (n_channels, n_second) array, optional
        By default `first` against itself.

    Returns
    -------
    (n_first, n_second) float array

    Raises
    ------
    InputError
        If sizes differ, or a shape has no mass.

    References
    ----------
    Ewins (2000), Modal Testing, 2nd ed., section 5.5; NASA-STD-5002 (1996) for the limits.
    """
    x, y = _require_complete(first, second)
    m = np.asarray(mass, dtype=np.float64)
    if m.shape != (len(x), len(x)):
        raise InputError(f"`mass` must be ({len(x)}, {len(x)}) like the channels, got shape {m.shape}")
    sizes = [np.einsum("cm,cd,dm->m", z.conj(), m, z).real for z in (x, y)]
    if min(size.min() for size in sizes) <= 0:
        raise InputError("a shape has no mass at the channels; leave it out, or measure places that have")
    return np.asarray(np.abs(x.conj().T @ m @ y) / np.sqrt(np.outer(*sizes)))


def most_real(shapes: ArrayLike) -> FloatArray:
    """Shapes turned to the phase in which they are as real as can be, and their real part, (n_channels, n_modes).

    Entries that are unknown (NaN) stay so.
    """
    given = np.asarray(shapes)
    return np.asarray((given * real_turn(given)).real if np.iscomplexobj(given) else given)


def real_turn(shapes: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """The factor of size 1 on each of (n_channels, n_modes) shapes that makes it as real as can be, (n_modes,)."""
    turn: NDArray[np.inexact] = np.exp(-0.5j * np.angle(np.nansum(shapes**2, axis=0)))
    return turn


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
    x, y = _require_complete(first, second)
    angles: FloatArray = linalg.subspace_angles(x, y)[::-1]
    return angles


def _as_columns(name: str, values: ArrayLike) -> NDArray[np.inexact]:
    """`values` as a float or complex array (n_channels, n_shapes), one shape a column; NaN is allowed, infinity is not."""
    array = np.asarray(values)
    if not np.issubdtype(array.dtype, np.inexact):
        array = array.astype(np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"`{name}` must be (n_channels, n_shapes), got shape {np.shape(values)}; one shape a column")
    require_finite(name, np.where(np.isnan(array), 0.0, array))
    return array


def _paired_columns(
    first: ArrayLike, second: ArrayLike
) -> tuple[NDArray[np.inexact], NDArray[np.inexact], NDArray[np.bool_]]:
    """Two sets of shapes with unit columns, the second in phase with the first, and a mask of entries that both have.

    Three arrays (n_channels, n_shapes). Entries that are NaN in either set become 0; so does a pair with no common
    entry.
    """
    x, y = _as_columns("first", first), _as_columns("second", second)
    if x.shape != y.shape:
        raise InputError(f"`first` and `second` must have one shape, got {x.shape} and {y.shape}; pair them first")
    known = ~(np.isnan(x) | np.isnan(y))
    x, y = np.where(known, x, 0.0), np.where(known, y, 0.0)
    shared = known.any(axis=0)
    x = x / np.sqrt(energies("first", np.where(shared, x, 1.0)))
    y = y / np.sqrt(energies("second", np.where(shared, y, 1.0)))
    product = np.sum(y.conj() * x, axis=0)
    size = np.abs(product)
    return x, y * np.where(size > 0, product / np.where(size > 0, size, 1.0), 1.0), known


def _check_channels(first: ArrayLike, second: ArrayLike | None) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """The sets of shapes `first` and `second` as columns at the same channels; `first` twice without a second."""
    x = _as_columns("first", first)
    y = x if second is None else _as_columns("second", second)
    if x.shape[0] != y.shape[0]:
        raise InputError(
            f"`first` and `second` must have the same channels, got {x.shape[0]} and {y.shape[0]}; "
            "bring them to common sensors first"
        )
    return x, y


def _require_complete(first: ArrayLike, second: ArrayLike | None) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """The sets of shapes `first` and `second` as columns; raises `InputError` if an entry is NaN."""
    x, y = _check_channels(first, second)
    hint = "leave out shapes, or channels, with unknown entries"
    require_finite("first", x, hint)
    require_finite("second", y, hint)
    return x, y

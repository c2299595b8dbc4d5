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
        Mode shapes as columns; a single shape may be (n_channels,). Unknown entries are NaN, and each pair is compared at
        the channels where both are known.
    second : (n_channels, n_second) array, optional
        Further mode shapes; by default `first` is compared with itself.

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

    COMAC_c = |sum_r x_cr^* y_cr|^2 / (sum_r |x_cr|^2  sum_r |y_cr|^2), after each shape is scaled to unit norm and y rotated to
    the phase of x: 1 for a channel that agrees in every mode up to a common factor. A channel with reversed sign keeps
    its COMAC; see `ecomac`.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Mode shapes; column r of `first` is paired with column r of `second`. Unknown entries are NaN and left out.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel moves in no mode of one of the sets, or is unknown in all.

    Raises
    ------
    InputError
        If the shapes differ in size, or a column is zero throughout.

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

    Each shape is scaled to a mean square of 1 over its known channels and y rotated to the phase of x: 0 for a channel that
    agrees in every mode, large if its sense, gain or position is wrong.

    Parameters
    ----------
    first, second : (n_channels, n_modes) arrays, real or complex
        Mode shapes; column r of `first` is paired with column r of `second`. Unknown entries are NaN and left out.

    Returns
    -------
    (n_channels,) float array
        NaN where a channel is unknown in all modes.

    Raises
    ------
    InputError
        If the shapes differ in size, or a column is zero throughout.

    References
    ----------
    Hunt (1992), Application of an enhanced coordinate modal assurance criterion, Proc. 10th IMAC; Allemang (2003).
    """
    x, y, known = _paired_columns(first, second)
    distance = np.sum(np.abs(x - y) * np.sqrt(known.sum(axis=0)), axis=1)
    count = 2.0 * known.sum(axis=1)
    return np.divide(distance, count, out=np.full(len(x), np.nan), where=count > 0)


def orthogonality(mass: ArrayLike, first: ArrayLike, second: ArrayLike | None = None) -> FloatArray:
    """Mass orthogonality |x_i^H M y_j| / sqrt(x_i^H M x_i  y_j^H M y_j) of every pair of columns: 0 if orthogonal, 1 if equal.

    By the usual rule, off-diagonal entries of a measured set with itself stay below 0.1 (self-orthogonality), and those of
    pairs of measured and modelled shapes are above 0.9 (cross-orthogonality).

    Parameters
    ----------
    mass : (n_channels, n_channels) array
        Mass matrix reduced to the channels; see `structid.compare.expansion`.
    first : (n_channels, n_first) array, real or complex
        Mode shapes as columns.
    second : (n_channels, n_second) array, optional
        Further mode shapes; by default `first` is compared with itself.

    Returns
    -------
    (n_first, n_second) float array

    Raises
    ------
    InputError
        If sizes differ, an entry is NaN, or a shape has no mass.

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
    """Real parts of complex shapes (n_channels, n_modes), each rotated first to the phase that makes it as real as possible.

    Unknown entries (NaN) stay NaN; real shapes are returned as they are.
    """
    given = np.asarray(shapes)
    return np.asarray((given * real_turn(given)).real if np.iscomplexobj(given) else given)


def real_turn(shapes: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Unit phase factor of each shape that makes it as real as possible, (n_modes,); `shapes` is (n_channels, n_modes)."""
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
    """`values` as a float or complex array (n_channels, n_shapes), from an array of this shape or (n_channels,).

    `InputError`, naming `name`, for other shapes, an empty array or infinite entries; NaN is allowed.
    """
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
    """Two sets of shapes with columns of unit norm, the second in phase with the first, and a mask of entries known in both.

    All are (n_channels, n_shapes). Entries that are NaN in either set become 0, also where a pair has no common entry.
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
    """Both sets of shapes as arrays (n_channels, n_shapes) after a check of their channels; `first` twice if `second` is None.

    `InputError` if the numbers of channels differ.
    """
    x = _as_columns("first", first)
    y = x if second is None else _as_columns("second", second)
    if x.shape[0] != y.shape[0]:
        raise InputError(
            f"`first` and `second` must have the same channels, got {x.shape[0]} and {y.shape[0]}; "
            "bring them to common sensors first"
        )
    return x, y


def _require_complete(first: ArrayLike, second: ArrayLike | None) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """Both sets of shapes as arrays (n_channels, n_shapes); `first` twice if `second` is None.

    `InputError` if an entry is NaN or infinite, or the numbers of channels differ.
    """
    x, y = _check_channels(first, second)
    hint = "leave out shapes, or channels, with unknown entries"
    require_finite("first", x, hint)
    require_finite("second", y, hint)
    return x, y

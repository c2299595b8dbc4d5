"""Similarity of two sets of response functions: FRAC and FDAC."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structid.core.arrays import FloatArray, require_finite
from structid.core.errors import InputError


def frac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Frequency response assurance criterion (FRAC) of each pair of functions: their `mac` along the frequency axis.

    Parameters
    ----------
    first, second : (n_frequencies, ...) arrays, real or complex
        Response functions at the same frequencies, paired by their position.

    Returns
    -------
    (...) float array
        From 0 to 1. A common factor of a whole function does not lower it, a shift of its peaks does.

    Raises
    ------
    InputError
        If the shapes differ, an entry is not finite, or a function is zero throughout.

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
    values = cross / (energies("first", x) * energies("second", y))
    return values.reshape(np.shape(first)[1:])


def fdac(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Frequency domain assurance criterion (FDAC): `mac` of the response shapes under each load at each pair of frequencies.

    FDAC(w, v)_i = |sum_o x_oi(w)^* y_oi(v)|^2 / (sum_o |x_oi(w)|^2  sum_o |y_oi(v)|^2). For a model that is too stiff
    throughout, the ridge of ones lies beside the diagonal.

    Parameters
    ----------
    first : (n_first, n_outputs, n_inputs) array, real or complex
        Response functions, such as measured FRFs.
    second : (n_second, n_outputs, n_inputs) array, real or complex
        Response functions of the same outputs and inputs; the frequencies may differ.

    Returns
    -------
    (n_inputs, n_first, n_second) float array
        From 0 to 1; NaN where nothing responds. For a single output it is 1 everywhere.

    Raises
    ------
    InputError
        If outputs or loads differ in number.

    References
    ----------
    Pascual, Golinval and Razeto (1997), A frequency domain correlation technique for model correlation and updating,
    Proc. 15th IMAC.
    """
    x, y = np.asarray(first), np.asarray(second)
    if x.ndim != 3 or y.ndim != 3 or x.shape[1:] != y.shape[1:]:
        raise InputError(
            "`first` and `second` must be (n_frequencies, n_outputs, n_inputs) with the same outputs and inputs, got"
            f" {x.shape} and {y.shape}"
        )
    require_finite("first", x)
    require_finite("second", y)
    cross = np.abs(np.moveaxis(x, 2, 0).conj() @ np.moveaxis(y, 2, 0).transpose(0, 2, 1)) ** 2
    energy = [np.sum(np.abs(z) ** 2, axis=1).T for z in (x, y)]
    size = energy[0][:, :, None] * energy[1][:, None, :]
    return np.divide(cross, size, out=np.full(size.shape, np.nan), where=size > 0)


def energies(name: str, x: NDArray[np.inexact]) -> FloatArray:
    """Sum of squared moduli of each column of `x` (n, n_columns), as (n_columns,); `name` is the argument named in errors.

    Raises
    ------
    InputError
        If a column is zero throughout.
    """
    sums: FloatArray = np.sum(np.abs(x) ** 2, axis=0)
    if (sums == 0).any():
        raise InputError(f"`{name}` is zero throughout in column {int(np.argmin(sums)) + 1}; leave it out")
    return sums

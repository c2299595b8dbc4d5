"""Array hygiene: locked copies, shape checks, complex numbers stacked as real ones, long histories by extremes."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from structid.core.errors import InputError

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.integer]
#: Real or complex.
NumberArray = NDArray[np.inexact]
#: Whatever a caller brings or a file holds.
AnyArray = NDArray[Any]

if TYPE_CHECKING:
    from scipy import sparse

Sparse = TypeVar("Sparse", "sparse.csr_array", "sparse.csc_matrix")

# The C library of Linux keeps from now on, instead of asking the system page by page each time, what arrays up to this size
# leave behind: it learns that from the largest one that was given back, 32 MB at most.
np.empty((32 << 20) - (64 << 10), dtype=np.uint8)


def locked(values: ArrayLike, dtype: DTypeLike | None = None) -> AnyArray:
    """Read-only copy of `values` for the fields of frozen objects."""
    array = np.array(values, dtype=dtype, copy=True)
    array.setflags(write=False)
    return array


def arrays_to_tuples(options: object, *names: str) -> None:
    """Make tuples of the fields `names` of a frozen dataclass that are arrays; rows of two dimensions become lists."""
    for name in names:
        value = getattr(options, name)
        if isinstance(value, np.ndarray):
            object.__setattr__(options, name, tuple(np.atleast_1d(value).tolist()))


def require_shape(name: str, array: AnyArray, shape: Sequence[int | None], hint: str = "") -> None:
    """Raise `InputError` unless `array.shape` matches `shape`, where None stands for any length.

    `name` is that of the argument in the message, which `hint` ends.
    """
    same_rank = array.ndim == len(shape)
    if same_rank and all(want is None or want == got for want, got in zip(shape, array.shape, strict=True)):
        return
    wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
    raise InputError(f"`{name}` must have shape {wanted}, got {array.shape}" + (f"; {hint}" if hint else ""))


def require_finite(name: str, array: AnyArray, hint: str = "remove or repair these entries") -> None:
    """Raise `InputError` if `array` has a NaN or infinite entry; the message names the first.

    `name` is that of the argument in the message, which `hint` ends with a remedy.
    """
    bad = ~np.isfinite(array)
    if not bad.any():
        return
    first = tuple(int(i) for i in np.argwhere(bad)[0])
    raise InputError(
        f"`{name}` must be finite, got {int(bad.sum())} NaN or infinite entries, the first at index {first}; {hint}"
    )


def evenly_spaced_indices(n: int, most: int) -> IntArray:
    """Indices from 0 to n - 1, evenly spaced and increasing: at most `most` of them, all n where n is smaller."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))


def bin_extremes(values: FloatArray, most: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Minimum and maximum (..., n_bins) of bins of `values` (..., n), and the first sample of each bin.

    There are at most `most` bins of equal length, of which the last may be shorter.
    """
    step = max(1, -(-values.shape[-1] // most))
    starts = np.arange(0, values.shape[-1], step)
    return np.minimum.reduceat(values, starts, axis=-1), np.maximum.reduceat(values, starts, axis=-1), starts


def thin_curve(x: FloatArray, y: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """At most `most` points (x, y) of a curve `y` over `x`, (n,): minimum, then maximum of each bin, at its first x.

    There are `most` // 2 bins of neighbouring points. A curve of no more than `most` points stays as it is.
    """
    if len(x) <= most:
        return x, y
    low, high, starts = bin_extremes(y, most // 2)
    return np.repeat(x[starts], 2), np.column_stack([low, high]).ravel()


def thin_band(x: FloatArray, low: FloatArray, high: FloatArray, most: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """At most `most` points (x, low, high) of a band over `x`: minimum of `low` and maximum of `high` in each bin.

    `x`, `low` and `high` are (n,). There are `most` // 2 bins of neighbouring points, and each gives the same point
    twice, at its first x. A band of no more than `most` points stays as it is.
    """
    if len(x) <= most:
        return x, low, high
    least, _, starts = bin_extremes(low, most // 2)
    _, largest, _ = bin_extremes(high, most // 2)
    return np.repeat(x[starts], 2), np.repeat(least, 2), np.repeat(largest, 2)


def stack_real(values: NumberArray) -> FloatArray:
    """Real numbers from complex ones along the first axis: all real parts, then all imaginary parts."""
    return np.concatenate([values.real, values.imag], axis=0)


def square_root(covariance: FloatArray) -> FloatArray:
    """A factor F (n, rank) with F F' = `covariance` (n, n), a symmetric matrix that may be singular.

    Negative eigenvalues, and those below rounding, of the matrix scaled to a unit diagonal are left out.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((covariance + covariance.T) / (2 * np.outer(scale, scale)))
    kept = values > len(size) * np.finfo(float).eps * max(float(values.max(initial=0.0)), 1.0)
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def with_entries(matrix: Sparse, entries: NumberArray) -> Sparse:
    """A compressed sparse matrix with the pattern of `matrix`, whose indices it shares, and other `entries`.

    Sizes and indices are not checked again, which takes longer than a product with a small matrix.
    """
    other = copy(matrix)
    other.data = entries
    return other

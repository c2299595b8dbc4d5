"""One mode shape from parts that were measured at different sensors, each in a scale of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.errors import InputError

_SWEEPS = 200


def merged_shape(
    parts: Sequence[ComplexArray], errors: Sequence[FloatArray], index: Sequence[IntArray], n_channels: int
) -> tuple[ComplexArray, FloatArray]:
    """The shape psi and factors c_s that make the sum of |part_s - c_s psi|^2 / error_s^2 least.

    Parameters
    ----------
    parts : sequence of (n_own,) complex arrays
    errors : sequence of (n_own,) float arrays
        Standard deviation of real and imaginary part of each entry.
    index : sequence of (n_own,) int arrays
        Which channel of all each entry is.
    n_channels : int

    Returns
    -------
    (n_channels,) complex array
        Largest entry 1.
    (n_channels,) float array
        Standard deviation of the real part of every entry, from the information matrix of shape and factors; 0 at the
        largest.

    Notes
    -----
    Alternating least squares, which the references drive: an entry of one part alone fits its part exactly.
    """
    factors = np.ones(len(parts), dtype=np.complex128)
    shape: ComplexArray = np.zeros(n_channels, dtype=np.complex128)
    done: list[int] = []
    for s in _order(index):  # a first shape: each part scaled to those before it
        own = np.isin(index[s], done)
        if own.any():
            there, weight = shape[index[s][own]], 1 / errors[s][own] ** 2
            factors[s] = np.sum(weight * there.conj() * parts[s][own]) / np.sum(weight * np.abs(there) ** 2)
        new = ~own
        shape[index[s][new]] = parts[s][new] / factors[s]
        done += index[s][new].tolist()
    for _ in range(_SWEEPS):
        before = shape
        shape = _best_shape(parts, errors, index, factors, n_channels)
        factors = np.array([_best_factor(p, e, shape[i]) for p, e, i in zip(parts, errors, index, strict=True)])
        if np.abs(shape - before).max() <= 1e-12 * np.abs(shape).max():
            break
    largest = int(np.abs(shape).argmax())
    std = _deviation(errors, index, shape, factors, largest)
    return shape / shape[largest], std


def _order(index: Sequence[IntArray]) -> list[int]:
    """Parts so that each has a channel in common with those before it."""
    order, seen, rest = [0], set(index[0].tolist()), list(range(1, len(index)))
    while rest:
        s = next((s for s in rest if seen & set(index[s].tolist())), None)
        if s is None:
            raise InputError("`setups` must be linked by common sensors, got parts that share none")
        rest.remove(s)
        order.append(s)
        seen |= set(index[s].tolist())
    return order


def _best_shape(
    parts: Sequence[ComplexArray],
    errors: Sequence[FloatArray],
    index: Sequence[IntArray],
    factors: ComplexArray,
    n_channels: int,
) -> ComplexArray:
    top, bottom = np.zeros(n_channels, dtype=np.complex128), np.zeros(n_channels)
    for part, error, own, factor in zip(parts, errors, index, factors, strict=True):
        np.add.at(top, own, factor.conj() * part / error**2)
        np.add.at(bottom, own, np.abs(factor) ** 2 / error**2)
    return np.asarray(top / bottom)


def _best_factor(part: ComplexArray, error: FloatArray, shape: ComplexArray) -> complex:
    weight = 1 / error**2
    return complex(np.sum(weight * shape.conj() * part) / np.sum(weight * np.abs(shape) ** 2))


def _deviation(
    errors: Sequence[FloatArray], index: Sequence[IntArray], shape: ComplexArray, factors: ComplexArray, largest: int
) -> FloatArray:
    """Of the real part of shape / shape[largest]: covariance by a real Jacobian, the first factor held.

    Errors of real and imaginary parts are alike, so that complex least squares does: J = d(c psi) has columns c (shape)
    and psi (factors), and (J^H W J)^-1 is the covariance of either part of the unknowns.
    """
    n, m = len(shape), len(factors)
    rows = []
    for s, (error, own) in enumerate(zip(errors, index, strict=True)):
        block = np.zeros((len(own), n + m), dtype=np.complex128)
        block[np.arange(len(own)), own] = factors[s]
        block[:, n + s] = shape[own]
        rows.append(block / error[:, None])
    jacobian = np.delete(np.concatenate(rows), n, axis=1)
    covariance = np.linalg.inv(jacobian.conj().T @ jacobian)[:n, :n]
    unit = shape / shape[largest]
    change = np.eye(n, dtype=np.complex128) / shape[largest]
    change[:, largest] -= unit / shape[largest]
    variance = np.einsum("ij,jk,ik->i", change, covariance, change.conj()).real
    variance[largest] = 0.0
    return np.sqrt(np.maximum(variance, 0.0))

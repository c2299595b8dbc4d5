"""FRF estimates H1, H2 and Hv from averaged spectra, with coherence and variance."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.errors import InputError

Estimator = Literal["H1", "H2", "Hv"]


class Spectra(NamedTuple):
    """Averaged spectra: inputs (F, I, I), outputs by inputs (F, O, I), outputs (F, O)."""

    inputs: ComplexArray
    cross: ComplexArray
    outputs: FloatArray


def estimated(
    spectra: Spectra, estimator: Estimator, averages: float
) -> tuple[ComplexArray, FloatArray, FloatArray | None]:
    """Values, coherence and variance (None with too few averages), each (F, O, I).

    The variance is (1 - g2) S_yy [S_xx^-1]_ii / (n - q) for n averages and q inputs; see `frf_from_time`.

    Raises
    ------
    InputError
        If the estimator is not known or cannot be formed from these spectra.
    """
    xx, yx, yy = spectra
    count = xx.shape[1]
    inverse = np.linalg.inv(xx)
    h1 = yx @ inverse
    explained = np.einsum("foi,foi->fo", h1, yx.conj()).real
    ratio = np.divide(explained, yy, out=np.zeros_like(yy), where=yy > 0)
    coherence = np.repeat(np.clip(ratio, 0.0, 1.0)[:, :, None], count, axis=2)
    values = _values(h1, spectra, estimator)
    variance = None
    if averages > count:
        gain = np.einsum("fii->fi", inverse).real[:, None, :]
        variance = (1 - coherence) * yy[:, :, None] * gain / (averages - count)
        if estimator != "H1":
            h1_power = np.abs(h1) ** 2
            relative = np.divide(variance, h1_power, out=np.zeros_like(variance), where=h1_power > 0)
            variance = np.where(h1_power > 0, relative * np.abs(values) ** 2, variance)
    return values, coherence, variance


def _values(h1: ComplexArray, spectra: Spectra, estimator: Estimator) -> ComplexArray:
    if estimator == "H1":
        return h1
    if estimator == "Hv":
        return _total_least_squares(spectra)
    if estimator != "H2":
        raise InputError(f"`estimator` must be H1, H2 or Hv, got {estimator!r}")
    if h1.shape[2] != 1:
        raise InputError(f"H2 takes one input, got {h1.shape[2]}; use H1 or Hv for several")
    xy = spectra.cross.conj()
    if (np.abs(xy) == 0).any():
        raise InputError("H2 divides by the cross spectrum, which is 0 at a line; use H1 or check that output")
    return spectra.outputs[:, :, None] / xy


def _total_least_squares(spectra: Spectra) -> ComplexArray:
    """Hv: from the smallest eigenvector of the spectra of inputs and one output, each scaled to unit power."""
    xx, yx, yy = spectra
    lines, outputs, inputs = yx.shape
    values = np.zeros_like(yx)
    for o in range(outputs):
        joint = np.empty((lines, inputs + 1, inputs + 1), dtype=np.complex128)
        joint[:, :inputs, :inputs] = xx
        joint[:, inputs, :inputs] = yx[:, o]
        joint[:, :inputs, inputs] = yx[:, o].conj()
        joint[:, inputs, inputs] = yy[:, o]
        scale = np.sqrt(np.einsum("fii->fi", joint).real)
        if (scale[:, inputs] == 0).any():
            raise InputError("Hv needs power on every output at every line; use H1 or check the silent output")
        vector = np.linalg.eigh(joint / (scale[:, :, None] * scale[:, None, :]))[1][:, :, 0]
        weight = vector.conj() / scale
        if (weight[:, inputs] == 0).any():
            raise InputError("Hv cannot be formed at a line where the output is not in the balance; use H1")
        values[:, o] = -weight[:, :inputs] / weight[:, inputs, None]
    return values

"""Forms of the residual between a modelled and a measured FRF, whitened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.forward.frf.products import Whitening

Form = Literal["output", "log", "pole_free", "equation"]
#: Values below so many deviations are compared as they are in ``log`` too: noise has no logarithm. Of the model's own values, what
#: part of a deviation is the least.
_IN_NOISE, _LEAST = 3.0, 1e-3


@dataclass(frozen=True, eq=False)
class WhitenedFrf:
    """Measured FRFs in one of the forms that `FrfProblem` names, but ``equation``, which needs the model.

    Parameters
    ----------
    form : Form
    measured : (n_frequencies, n_outputs, n_inputs) complex array
    deviation : (n_frequencies, n_outputs, n_inputs) float array
        Standard deviation of the real (and of the imaginary) part of every value.
    """

    form: Form
    measured: ComplexArray
    deviation: FloatArray

    def residual(self, h: ComplexArray) -> ComplexArray:
        """Weighted complex residual of the model's FRF `h` against the data, (..., n_lines, n_outputs, n_inputs)."""
        m, s = self.measured, self.deviation
        if self.form == "output":
            return (h - m) / s
        if self.form == "log":
            found = _log(h * self._inverse, _LEAST / np.maximum(self._weight, 1.0)) * self._weight
            return np.where(self._in_noise, (h - m) / s, found) if self._in_noise.any() else found
        return (h - m) / np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2)) * self._weight

    def whitening(self, h: ComplexArray, lines: slice = slice(None)) -> Whitening:
        """Derivative of the weighted residual by the model's response `h` at some frequency `lines`."""
        if self.form == "output":
            return Whitening((1 / self.deviation[lines]).astype(np.complex128))
        m, weight = self.measured[lines], self._weight[lines]
        if self.form == "log":
            s, size = self.deviation[lines], np.abs(h)
            of_log = np.divide(weight, h, out=np.zeros_like(h), where=size > _LEAST * s)
            return Whitening(np.where(self._in_noise[lines], 1 / s, of_log))
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        turn = (h - m) * weight / (4 * size**3)
        return Whitening(weight / size - turn * np.conj(h), -turn * h)

    @cached_property
    def _weight(self) -> FloatArray:
        """Weights of relative residuals."""
        return np.asarray(np.abs(self.measured) / self.deviation)

    @cached_property
    def _in_noise(self) -> np.ndarray:
        return np.asarray(np.abs(self.measured) < _IN_NOISE * self.deviation)

    @cached_property
    def _inverse(self) -> ComplexArray:
        return np.asarray(1 / np.where(self._in_noise, 1.0, self.measured))


def _log(z: ComplexArray, least: FloatArray) -> ComplexArray:
    """Principal logarithm of complex values whose magnitude is raised to `least` if smaller."""
    found = np.empty_like(z)
    size = np.abs(z)
    np.log(np.maximum(size, least, out=size), out=found.real)
    np.arctan2(z.imag, z.real, out=found.imag)
    return found

"""Forms of the residual between a modelled and a measured FRF, whitened."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.observation.frf.products import Whitening

Form = Literal["output", "log", "pole_free", "equation"]


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
        """Complex residual of the model's FRF `h`, (..., n_frequencies, n_outputs, n_inputs)."""
        m, s = self.measured, self.deviation
        if self.form == "output":
            return (h - m) / s
        if self.form == "log":
            return _log(h * self._inverse) * self._weight
        return (h - m) / np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2)) * self._weight

    def whitening(self, h: ComplexArray, lines: slice = slice(None)) -> Whitening:
        """How the residual at some lines changes with the response h there."""
        if self.form == "output":
            return Whitening((1 / self.deviation[lines]).astype(np.complex128))
        m, weight = self.measured[lines], self._weight[lines]
        if self.form == "log":
            return Whitening(weight / h)
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        turn = (h - m) * weight / (4 * size**3)
        return Whitening(weight / size - turn * np.conj(h), -turn * h)

    @cached_property
    def _weight(self) -> FloatArray:
        """What multiplies relative residuals."""
        return np.asarray(np.abs(self.measured) / self.deviation)

    @cached_property
    def _inverse(self) -> ComplexArray:
        return 1 / self.measured


def _log(z: ComplexArray) -> ComplexArray:
    """The principal logarithm: a complex one of NumPy's takes six times as long."""
    found = np.empty_like(z)
    found.real, found.imag = np.log(np.abs(z)), np.angle(z)
    return found

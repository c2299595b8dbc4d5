"""Forms of the residual between a modelled and a measured FRF, whitened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

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

    def residual(self, h: ComplexArray, dh: ComplexArray | None = None) -> tuple[NDArray[Any], NDArray[Any]]:
        """Complex residual of the model's FRF `h` and its derivative; `dh` None where only the residual is wanted."""
        m, s = self.measured, self.deviation
        change = np.zeros((*h.shape, 0), dtype=np.complex128) if dh is None else dh
        if self.form == "output":
            return (h - m) / s, change / s[..., None]
        relative = s / np.abs(m)
        if self.form == "log":
            return _log(h / m) / relative, change / (h * relative)[..., None]
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        growth = (np.conj(h)[..., None] * change).real / (2 * size**2)[..., None]
        data = (h - m) / size
        return data / relative, (change / size[..., None] - data[..., None] * growth) / relative[..., None]

    def whitening(self, h: ComplexArray, lines: slice) -> Whitening:
        """How the residual at some lines changes with the response h there."""
        m, s = self.measured[lines], self.deviation[lines]
        if self.form == "output":
            return Whitening((1 / s).astype(np.complex128), np.zeros_like(h))
        relative = s / np.abs(m)
        if self.form == "log":
            return Whitening(1 / (h * relative), np.zeros_like(h))
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        turn = (h - m) / (4 * size**3 * relative)
        return Whitening(1 / (size * relative) - turn * np.conj(h), -turn * h)


def _log(z: ComplexArray) -> ComplexArray:
    """The principal logarithm: a complex one of NumPy's takes six times as long."""
    found = np.empty_like(z)
    found.real, found.imag = np.log(np.abs(z)), np.angle(z)
    return found

"""What a model misses of measured responses beyond their noise, as an error of responses that were not measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import figures

#: Lines to each side over which squares are summed.
_REACH = 10


@dataclass(frozen=True, eq=False)
class ModelError:
    """Error of modelled FRFs as a part of their size, over frequency.

    Attributes
    ----------
    frequency : (n_frequencies,) float array
        Hz.
    part : (n_frequencies,) float array
        Root of E|error|^2 over that of E|FRF|^2 among neighbouring lines.
    """

    frequency: FloatArray
    part: FloatArray

    @classmethod
    def of_residuals(
        cls, frequency: FloatArray, measured: ComplexArray, fitted: ComplexArray, variance: FloatArray | None = None
    ) -> ModelError:
        """The error that residuals of all channels show beyond noise.

        Parameters
        ----------
        frequency : (n_frequencies,) float array
        measured, fitted : (n_frequencies, n_outputs, n_inputs) complex arrays
        variance : the same, float, optional
            E|noise|^2 of the measured values; 0 where it is not known, so that all residuals count as error of the model.
        """
        excess = (np.abs(measured - fitted) ** 2 - (0.0 if variance is None else variance)).sum(axis=(1, 2))
        size = (np.abs(fitted) ** 2).sum(axis=(1, 2))
        near, whole = _summed_nearby(excess), _summed_nearby(size)
        part = np.sqrt(np.divide(np.maximum(near, 0.0), whole, out=np.zeros_like(near), where=whole > 0))
        return cls(frequency, part)

    @property
    def words(self) -> str:
        """Such as ``what the fit missed beyond noise (median 2.1 % of the responses)``."""
        return f"what the fit missed beyond noise (median {figures(100 * float(np.median(self.part)), 2)} % of the responses)"

    def added_to(
        self, draws: ComplexArray, frequency: FloatArray, nominal: ComplexArray, rng: np.random.Generator
    ) -> ComplexArray:
        """FRFs (n_draws, n_frequencies, n_outputs, n_inputs) with random errors of this size added; `nominal` gives their size."""
        part = np.interp(frequency, self.frequency, self.part)
        size = np.sqrt(_summed_nearby(np.abs(nominal) ** 2) / _summed_nearby(np.ones(len(frequency)))[:, None, None])
        noise = rng.standard_normal(draws.shape) + 1j * rng.standard_normal(draws.shape)
        return np.asarray(draws + noise * (part[:, None, None] * size / np.sqrt(2)))


def _summed_nearby(values: FloatArray) -> FloatArray:
    """Sums over the lines up to `_REACH` away, along the first axis."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    n = len(values)
    first, last = np.maximum(np.arange(n) - _REACH, 0), np.minimum(np.arange(n) + _REACH + 1, n)
    return np.asarray(total[last] - total[first])

"""Model error of predicted responses, from the misfit of measured ones beyond their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import format_number
from structid.core.units import FrfKind
from structid.fem import Structure
from structid.forward.frf.response import response
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.unknowns import Parameters

#: Lines to each side over which squares are summed.
_REACH = 10
#: Least information of the other sensors, in parts of the most, by which a direction of the parameters moves.
_SEEN = 1e-6


@dataclass(frozen=True, eq=False)
class ModelError:
    """Error of modelled FRFs at a place without a sensor, over frequency.

    It is a part of the size of the response there, or of the mean size at the sensors where that is larger: a response that happens
    to be small is missed by as much as its neighbours.

    Attributes
    ----------
    frequency : (n_frequencies,) float array
        Hz.
    part : (n_frequencies,) float array
        Root of the mean square of errors over that of FRFs, all sensors and neighbouring lines together.
    size : (n_frequencies,) float array
        That root mean square of FRFs.
    kind : FrfKind
        Of the FRFs.
    """

    frequency: FloatArray
    part: FloatArray
    size: FloatArray
    kind: FrfKind

    @classmethod
    def of_fit(
        cls,
        structure: Structure,
        parameters: Parameters,
        physical: FloatArray,
        record: FrfRecord,
        predicted: ComplexArray,
    ) -> ModelError:
        """Error of modelled FRFs at each sensor when it is left out of the fit in turn, less noise, over all sensors.

        The result has, line by line, the root mean square of the errors as a part of that of the FRFs, and the latter
        in the unit of the record. To first order: without sensor s the parameters move by -(N - N_s)^-1 g_s, where N
        sums the information of all sensors and g_s is the gradient of s, so that the model of s is what the others
        alone make of it. Mean squares are taken over sensors, loads and 21 neighbouring lines; the error is 0 where it
        is less than the noise.

        Parameters
        ----------
        structure : Structure
        parameters : Parameters
            Of that structure.
        physical : (n_params,) float array
            Identified values.
        record : FrfRecord
            The FRFs that were fitted.
        predicted : (n_frequencies, n_outputs, n_inputs) complex array
            The responses of the fitted model.

        References
        ----------
        Cook and Weisberg (1982), Residuals and Influence in Regression, section 3.
        """
        slopes = response(structure, parameters, record).derivatives_at(physical)[1]
        left_out = _moved_without(record, slopes, predicted)
        noise = 0.0 if record.variance is None else record.variance
        excess = _sum_nearby((np.abs(record.values - left_out) ** 2 - noise).mean(axis=(1, 2)))
        square = _sum_nearby((np.abs(predicted) ** 2).mean(axis=(1, 2)))
        part = np.sqrt(np.divide(np.maximum(excess, 0.0), square, out=np.zeros_like(excess), where=square > 0))
        count = _sum_nearby(np.ones(len(square)))
        return cls(record.frequency, part, np.sqrt(square / count), record.kind)

    @property
    def words(self) -> str:
        """Such as ``what the fit misses at a sensor left out (median 2.1 % of the responses)``."""
        part = format_number(100 * float(np.median(self.part)), 2)
        return f"what the fit misses at a sensor left out (median {part} % of the responses)"

    def added_to(
        self,
        draws: ComplexArray,
        frequency: FloatArray,
        kind: FrfKind,
        is_motion: np.ndarray,
        nominal: ComplexArray,
        rng: np.random.Generator,
    ) -> ComplexArray:
        """FRFs `draws` (n_draws, n_frequencies, n_outputs, n_inputs) with random model errors added.

        The size of the errors follows from the `nominal` FRFs (n_frequencies, n_outputs, n_inputs) of `kind` at `frequency`
        (Hz), or from the mean size at the sensors if that is larger. Outputs that are no motion (mask `is_motion`,
        (n_outputs,)), such as stresses, have errors relative to themselves only.
        """
        part, size = (np.interp(frequency, self.frequency, each) for each in (self.part, self.size))
        size = size * (2 * np.pi * frequency) ** (DERIVATIVES[kind] - DERIVATIVES[self.kind])
        at_sensors = size[:, None, None] * is_motion[:, None]
        count = _sum_nearby(np.ones(len(frequency)))[:, None, None]
        own = np.sqrt(_sum_nearby(np.abs(nominal) ** 2) / count)
        std = part[:, None, None] * np.maximum(own, at_sensors)
        noise = rng.standard_normal(draws.shape) + 1j * rng.standard_normal(draws.shape)
        return np.asarray(draws + noise * (std / np.sqrt(2)))

    def added_to_histories(self, draws: FloatArray, sampling_rate: float, rng: np.random.Generator) -> FloatArray:
        """Histories `draws` (n_draws, n_times, n_outputs) with random model errors added, relative at each frequency.

        `sampling_rate` is in Hz; the result has the shape of `draws`.
        """
        n_draws, n_times, n_outputs = draws.shape
        padded = next_fast_len(2 * n_times, real=True)
        frequency = np.fft.rfftfreq(padded, 1 / sampling_rate)
        missed = np.empty_like(draws)
        for k in range(n_draws):
            relative = self._relative(frequency, n_outputs, rng)
            missed[k] = np.fft.irfft(np.fft.rfft(draws[k], padded, axis=0) * relative, padded, axis=0)[:n_times]
        return np.asarray(draws + missed)

    def added_to_spectra(self, draws: FloatArray, frequency: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Spectral densities `draws` (n_draws, n_frequencies, n_outputs) with random errors of their responses added.

        `frequency` (n_frequencies,) is in Hz.
        """
        relative = np.stack([self._relative(frequency, draws.shape[2], rng) for _ in draws])
        return np.asarray(draws * np.abs(1 + relative) ** 2)

    def _relative(self, frequency: FloatArray, n_outputs: int, rng: np.random.Generator) -> ComplexArray:
        """Random complex errors relative to responses, (n_frequencies, n_outputs), at `frequency` (Hz).

        They vary from one independent error to the next, one for each stretch of 21 lines over which `part` was summed.
        """
        knots = self.frequency[:: 2 * _REACH + 1]
        before = np.clip(np.searchsorted(knots, frequency, side="right") - 1, 0, max(len(knots) - 2, 0))
        after = np.minimum(before + 1, len(knots) - 1)
        span = np.where(after > before, knots[after] - knots[before], 1.0)
        way = np.clip((frequency - knots[before]) / span, 0.0, 1.0)[:, None]
        errors = rng.standard_normal((len(knots), n_outputs)) + 1j * rng.standard_normal((len(knots), n_outputs))
        mixed = ((1 - way) * errors[before] + way * errors[after]) / np.hypot(1 - way, way)
        return np.asarray(np.interp(frequency, self.frequency, self.part)[:, None] * mixed / np.sqrt(2))


def _moved_without(record: FrfRecord, slopes: ComplexArray, predicted: ComplexArray) -> ComplexArray:
    """Responses at each sensor by a model fitted to the other sensors, to first order, in the shape of `predicted`.

    `slopes` (n_frequencies, n_outputs, n_inputs, n_params) are the derivatives of `predicted` by the parameters. With a single
    sensor `predicted` is returned.
    """
    residual = record.values - predicted
    size = np.abs(predicted) if record.variance is None else np.sqrt(record.variance)
    weighted = slopes / size[..., None]
    information = np.einsum("foip,foiq->opq", np.conj(weighted), weighted).real
    gradient = np.einsum("foip,foi->op", np.conj(weighted), residual / size).real
    moved = np.array(predicted)
    if len(information) < 2:
        return moved
    whole = information.sum(axis=0)
    scale = 1 / np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
    for sensor, own in enumerate(gradient):
        rest = (whole - information[sensor]) * np.outer(scale, scale)
        moved[:, sensor] -= slopes[:, sensor] @ (scale * np.linalg.lstsq(rest, scale * own, rcond=_SEEN)[0])
    return moved


def _sum_nearby(values: FloatArray) -> FloatArray:
    """Sums of `values` (n_lines, ...) over the lines up to ten positions away, for each line."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    n = len(values)
    first, last = np.maximum(np.arange(n) - _REACH, 0), np.minimum(np.arange(n) + _REACH + 1, n)
    return np.asarray(total[last] - total[first])

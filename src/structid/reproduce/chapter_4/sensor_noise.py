"""Noise of sensors and excitation on the cantilever of chapter 4, and the bound that no unbiased estimate can beat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import FloatArray
from structid.records import FrfRecord
from structid.reproduce.chapter_4.cantilever import (
    N_ELEMENTS,
    Case,
    Reading,
    classical_errors,
    exact_record,
    relative_jacobian,
)


@dataclass(frozen=True)
class Noise:
    """Relative standard deviations of Gaussian errors.

    Attributes
    ----------
    sensors : float
        Of each sensor at each frequency, all independent.
    amplitude, frequency : float
        Of the excitation at each frequency; the identification is given the nominal ones.
    gain : float
        One error common to all sensors and frequencies.
    """

    sensors: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    gain: float = 0.0


def noisy_record(case: Case, reading: Reading, noise: Noise, rng: np.random.Generator) -> FrfRecord:
    """What sensors with `noise` show of the actual structure, taken to be at the nominal excitation."""
    nominal = np.array(reading.frequency)
    frequency = nominal * (1 + noise.frequency * rng.standard_normal(len(nominal)))
    amplitude = 1 + noise.amplitude * rng.standard_normal((len(nominal), 1, 1))
    gain = 1 + noise.gain * rng.standard_normal()
    record = exact_record(case.actual, replace(reading, frequency=tuple(frequency)))
    sensors = 1 + noise.sensors * rng.standard_normal(record.values.shape)
    return replace(record, frequency=nominal, values=record.values * (amplitude * gain * sensors))


def noisy_errors(case: Case, reading: Reading, noise: Noise, seeds: range, n_iterations: int = 5) -> FloatArray:
    """RMS errors along the classical iteration for each seed, (n_seeds, n_iterations + 1)."""
    return np.array(
        [
            classical_errors(case, noisy_record(case, reading, noise, np.random.default_rng(seed)), n_iterations)
            for seed in seeds
        ]
    )


def quantiles(errors: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """5 %, median and 95 % over seeds, each an error that occurred, so that diverged runs count as the largest."""
    low, middle, high = np.quantile(errors, [0.05, 0.5, 0.95], axis=0, method="inverted_cdf")
    return low, middle, high


def cramer_rao(case: Case, reading: Reading, noise: Noise) -> float:
    """Smallest RMS relative standard deviation of an unbiased estimate of all parameters.

    With J the relative Jacobian and S the covariance of the relative data, the root of the mean diagonal entry of
    (J' S^-1 J)^-1. Amplitude errors a of the excitation change all values of a line by 1 + a. Frequency errors f
    act as mass errors 2 f, since the structure has no damping: the columns of the masses give their effect.
    """
    jacobian = relative_jacobian(case, reading)
    n_data, n_params = jacobian.shape
    lines = np.repeat(np.eye(len(reading.frequency)), len(reading.outputs), axis=0)
    per_frequency = 2 * jacobian[:, :N_ELEMENTS].sum(axis=1)
    effects = np.hstack(
        [
            noise.sensors * np.eye(n_data),
            noise.amplitude * lines,
            noise.frequency * per_frequency[:, None] * lines,
            np.full((n_data, 1), noise.gain),
        ]
    )
    if n_data == n_params:  # the data determine the parameters one by one, whatever the rank of the noise
        spread = np.linalg.solve(jacobian, effects)
        return float(np.sqrt(np.sum(spread**2) / n_params))
    factor = np.linalg.cholesky(effects @ effects.T)
    whitened = np.linalg.solve(factor, jacobian)
    return float(np.sqrt(np.sum(np.linalg.pinv(whitened) ** 2) / n_params))

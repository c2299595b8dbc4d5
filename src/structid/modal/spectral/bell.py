"""Fit of one mode to a bell of the spectrum: a decaying cosine, as a windowed segment shows it.

The displacement of one mode under white noise has the correlation function exp(-zeta omega tau) (cos omega_d tau +
zeta / sqrt(1 - zeta^2) sin omega_d tau). Segments with window w show it times the correlation of w with itself, and the
mean of their spectra is the Fourier transform of the product, exactly where segments are padded with zeros to twice
their length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.modal.spectral.peaks import hann

_STEPS = 100
_TOLERANCE = 1e-9
_FLOOR = 1e-3  # part of the least value of the fit below which the flat part plays no role


@dataclass(frozen=True, eq=False)
class Bell:
    """Spectra of the segments of a record on the lines of a bell.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    spectra : (n_segments, n_lines) float array
        One-sided spectral density of every segment.
    segment : int
        Samples of a segment, without padding.
    sampling_rate : float
        Hz.
    peak : float
        Where the greatest value is, Hz.
    derivative : float
        0, 1 or 2 for displacement, velocity or acceleration, or between for a mixture.
    """

    frequency: FloatArray
    spectra: FloatArray
    segment: int
    sampling_rate: float
    peak: float
    derivative: float


@dataclass(frozen=True, eq=False)
class BellFit:
    """Mode of a bell.

    Attributes
    ----------
    frequency, damping_ratio : float
        Natural frequency in Hz, and damping ratio.
    changes : (n_segments, 2) float array
        What every segment adds to frequency (Hz) and damping ratio, to first order; sums to zero.
    converged : bool
        Whether the last step was of rounding size.
    """

    frequency: float
    damping_ratio: float
    changes: FloatArray
    converged: bool


def window_correlation(segment: int) -> FloatArray:
    """Correlation of the Hann window with itself at lags 0 .. segment - 1, 1 at lag 0."""
    power = np.abs(np.fft.rfft(hann(segment), 2 * segment)) ** 2
    found = np.fft.irfft(power)[:segment]
    return np.asarray(found / found[0])


def bell_spectrum(bell: Bell, frequency: float, ratio: float, window: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Expected spectrum of one mode on the lines of a bell, up to a factor, with its slopes.

    Parameters
    ----------
    window : (segment,) float array
        `window_correlation`.

    Returns
    -------
    (n_lines,) float array
        Spectrum, 1 for the lag 0 of the correlation times the sampling interval.
    (2, n_lines) float array
        Its derivatives to ln frequency and ln damping ratio.
    """
    tau = np.arange(bell.segment) / bell.sampling_rate
    omega, root = 2 * np.pi * frequency, np.sqrt(1 - ratio**2)
    pole = omega * (1j * root - ratio)
    weight = 1 - 1j * ratio / root
    motion = np.exp(pole * tau) * window
    parts = [
        weight * motion,
        weight * pole * tau * motion,
        ratio * (weight * omega * (-1 - 1j * ratio / root) * tau - 1j / root**3) * motion,
    ]
    lines = np.round(bell.frequency * 2 * bell.segment / bell.sampling_rate).astype(int)
    sides = np.array([2 * np.fft.rfft(part.real, 2 * bell.segment)[lines].real - part.real[0] for part in parts])
    sides *= (bell.frequency / frequency) ** (2 * bell.derivative)
    sides[1] -= 2 * bell.derivative * sides[0]
    return sides[0], sides[1:]


def bell_fit(bell: Bell) -> BellFit:
    """Iterated weighted least squares: every line has an error in proportion to its expected value.

    Unknown are ln f, ln zeta, ln of the factor, and ln of a flat part. The steps solve the normal equations of the
    relative errors, and are halved until sum(P / M + ln M) falls, whose minimum is the fit.
    """
    window, mean = window_correlation(bell.segment), bell.spectra.mean(axis=0)
    x = _start(bell, mean, window)
    converged, model, slopes = False, *_model(bell, x, window)
    value = float(np.sum(mean / model + np.log(model)))
    for _ in range(_STEPS):
        error = mean / model - 1
        used = _used(x, model)
        step = np.zeros(4)
        step[used] = np.linalg.lstsq(slopes[used].T, error, rcond=None)[0]
        step /= max(1.0, float(np.abs(step / [0.02, 1.0, 2.0, 2.0]).max()))
        while True:
            step[1] = min(step[1], np.log(0.9) - x[1])
            trial, slopes_there = _model(bell, x + step, window)
            there = float(np.sum(mean / trial + np.log(trial))) if (trial > 0).all() else np.inf
            if there <= value or np.abs(step).max() < _TOLERANCE:
                break
            step = 0.5 * step
        if there <= value:
            x, value, model, slopes = x + step, there, trial, slopes_there
        if np.abs(step[used]).max() < 1e-7:
            converged = True
            break
    used = _used(x, model)
    add = (bell.spectra - mean) / (model * len(bell.spectra))
    changes = np.linalg.lstsq(slopes[used].T, add.T, rcond=None)[0][:2].T * np.exp(x[:2])
    return BellFit(float(np.exp(x[0])), float(np.exp(x[1])), changes, converged)


def _used(x: FloatArray, model: FloatArray) -> list[int]:
    """All four unknowns, or three where the flat part has gone to nothing."""
    return [0, 1, 2, 3] if np.exp(x[3]) > _FLOOR * model.min() else [0, 1, 2]


def _model(bell: Bell, x: FloatArray, window: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Spectrum at unknowns x, and the relative slopes, (4, n_lines)."""
    mode, slopes = bell_spectrum(bell, float(np.exp(x[0])), float(np.exp(x[1])), window)
    factor, flat = np.exp(x[2]), np.exp(x[3])
    total = factor * mode + flat
    return total, np.stack([factor * slopes[0], factor * slopes[1], factor * mode, np.full_like(mode, flat)]) / total


def _start(bell: Bell, mean: FloatArray, window: FloatArray) -> FloatArray:
    """The best of a few damping ratios, with factor and flat part from the greatest and the least value."""
    best = np.zeros(4), np.inf
    for ratio in (0.002, 0.005, 0.01, 0.02, 0.05):
        mode = bell_spectrum(bell, bell.peak, ratio, window)[0]
        flat = max(0.5 * mean.min(), 1e-12 * mean.max())
        factor = (mean.max() - flat) / mode.max()
        x = np.log([bell.peak, ratio, factor, flat])
        total = factor * mode + flat
        value = float(np.sum(mean / total + np.log(total))) if (total > 0).all() else np.inf
        if value < best[1]:
            best = x, value
    return best[0]

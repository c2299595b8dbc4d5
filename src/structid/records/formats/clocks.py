"""Sample times as files have them: even, even but for rounding, or brought to an even raster where that is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError, InputError
from structid.records.formats.options import option_words

#: Unevenness of sample times allowed, as a part of the step.
_EVEN = 1e-6
#: Distance of a rounded time from the even one, as a part of its last digit.
_ROUNDED = 0.75
#: Relative error of a sampling rate from rounded times or steps that is let pass.
SURE = 1e-4
#: Steps, as parts of the usual one, between which an uneven clock is resampled: outside of them samples are missing.
_STEPS = (0.5, 1.5)
#: Frequencies, as parts of the sampling rate, at which the cost of resampling is told.
_TOLD = (1 / 16, 1 / 4)


class Rate(NamedTuple):
    """Sampling rate in Hz, its relative error, and the rounding of the times in s; the last two are 0 for exact times."""

    rate: float
    error: float
    digit: float


def even_rate(time: FloatArray, digits: FloatArray) -> Rate | None:
    """The sampling rate of evenly spaced times; None if they are uneven beyond the rounding of their last digits.

    Returns the rate in Hz, its relative uncertainty, and the largest rounding step in s; the last two are 0 where each
    step is the mean one to 1e-6 of it. A rate of rounded times becomes the nearest whole number if that lies within its
    uncertainty and this is below 0.1 Hz.

    Parameters
    ----------
    time : (n_times,) float array
        Times in s, increasing, two or more.
    digits : (n_times,) float array
        Size of the last written digit of each time, in s. Deviations up to 0.75 of it count as even, provided that
        there are three times or more and the step is longer than twice the largest digit.
    """
    step = float(time[-1] - time[0]) / (time.size - 1)
    rounding = 4 * np.finfo(float).eps * float(np.abs(time).max())
    if np.abs(np.diff(time) - step).max() <= _EVEN * step + rounding:
        return Rate(float(1 / step), 0.0, 0.0)
    coarsest = float(digits.max())
    if time.size < 3 or not step > 2 * coarsest > 0:
        return None
    order, weight = np.arange(time.size), (coarsest / np.maximum(digits, 1e-6 * coarsest)) ** 2
    middle, mean = np.average(order, weights=weight), np.average(time, weights=weight)
    slope = float(weight @ ((order - middle) * time) / (weight @ (order - middle) ** 2))
    if (np.abs(time - mean - slope * (order - middle)) > _ROUNDED * digits + rounding).any():
        return None
    rate, error = 1 / slope, coarsest / float(time[-1] - time[0])
    near = round(rate) if abs(rate - round(rate)) <= rate * error < 0.1 else rate
    return Rate(float(near), error, coarsest)


class Resampled(NamedTuple):
    """Values on an even raster, (n_times, n_channels), their rate in Hz, the time of the first in s, and what it cost, in words."""

    values: FloatArray
    rate: float
    start: float
    words: str


def resample(path: Path, time: FloatArray, values: FloatArray, stated: float | None) -> Resampled:
    """Samples at uneven times, interpolated by cubic splines at as many even times between the same ends.

    Returns samples, rate in Hz, first time in s and words on the error, which is measured by resampling sines of two
    frequencies from the same times.

    Parameters
    ----------
    path : Path
        File, named in errors.
    time : (n_times,) float array
        Times in s, at least four.
    values : (n_times, n_channels) float array
    stated : float or None
        The option `sampling_rate`, Hz, which the mean step must agree with to one step in the whole record.

    Raises
    ------
    FileError
        If there are fewer than four times, a step is below 0.5 or above 1.5 of the median step, or a value is NaN or infinite.
    InputError
        If the times contradict the stated rate.
    """
    from scipy.interpolate import CubicSpline

    steps = np.diff(time)
    usual = float(np.median(steps))
    if time.size < 4 or usual <= 0 or steps.min() < _STEPS[0] * usual or steps.max() > _STEPS[1] * usual:
        i = int(np.argmax(np.abs(steps - usual)))
        raise FileError(
            f"{path}: cannot be resampled: sample {i + 2} follows after {steps[i]:.6g} s where the usual step is {usual:.6g} s;"
            " cut the record there, or repair it"
        )
    if not np.isfinite(values).all():
        raise FileError(
            f"{path}: cannot be resampled, for samples are missing; repair the record, or leave these channels out"
        )
    even = np.linspace(time[0], time[-1], time.size)
    rate = float((time.size - 1) / (time[-1] - time[0]))
    if stated is not None and abs(stated / rate - 1) > 1 / (time.size - 1):
        raise InputError(
            f"{path}: the times hold {rate:.6g} samples a second, but `sampling_rate` {stated:g} was given; leave it out, or"
            " correct it",
            "sampling_rate",
        )
    splined = CubicSpline(time, values, axis=0)(even)
    inner = slice(2, -2)  # splines are worse at their ends
    costs = []
    for part in _TOLD:
        omega = 2 * np.pi * part * rate
        wave = np.stack([np.sin(omega * time), np.cos(omega * time)], axis=1)
        true = np.stack([np.sin(omega * even), np.cos(omega * even)], axis=1)
        error = np.abs(CubicSpline(time, wave, axis=0)(even) - true)[inner].max()
        costs.append(f"{100 * error:.1g} % of a sine at {part * rate:.4g} Hz")
    error = np.abs(time - even).max() * rate
    words = f"resampled: samples were up to {100 * error:.2g} % of a step off an even raster; errs by up to {' and '.join(costs)}"
    return Resampled(splined, rate, float(time[0]), words)


def resampling_remedy() -> str:
    """Advice for an error on uneven times: the option that resamples."""
    return f"bring the samples to an even raster with {option_words(resample='spline')}, which says what it costs"

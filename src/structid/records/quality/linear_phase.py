"""Linear-phase FIR filters without delay: anti-alias filters for decimation, and band filters.

A FIR filter multiplies a free decay z^t by its response at z, as long as all its taps lie on the decay: frequency and
damping stay exactly what they were. Only the samples within half a filter of either end, and of any impact within the
record, mix what was before and after.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError

#: Part of the new Nyquist frequency that passes a decimation unchanged.
PASS = 0.8
_DECIMATION_DB, _BAND_DB = 84.0, 66.0  # Kaiser: a few dB over the 80 and 60 promised, which it meets nearly only
_LARGEST_FACTOR = 1000


@dataclass(frozen=True, eq=False)
class Fir:
    """A filter of odd length, symmetric, at `rate` samples per second.

    Attributes
    ----------
    taps : (n_taps,) float array
    rate : float
        Hz.
    """

    taps: FloatArray
    rate: float

    @property
    def half(self) -> int:
        return len(self.taps) // 2

    @property
    def noise_gain(self) -> float:
        """Variance of white noise after the filter over that before."""
        return float(np.sum(self.taps**2))

    def crossing(self, near: float) -> float:
        """Frequency in Hz nearest to `near` at which the gain of the filter is -3 dB; `near` itself if there is none."""
        from scipy.signal import freqz

        n_lines = 1 << int(np.ceil(np.log2(64 * len(self.taps))))
        lines, response = freqz(self.taps, worN=n_lines, fs=self.rate)
        level = 20 * np.log10(np.maximum(np.abs(response), 1e-12)) + 3.0
        crossings = np.flatnonzero(level[1:] * level[:-1] <= 0)
        if not len(crossings):
            return float(near)
        k = crossings[np.abs(lines[crossings] - near).argmin()]
        return float(lines[k] - level[k] * (lines[k + 1] - lines[k]) / (level[k + 1] - level[k]))


def low_pass(passed: float, stopped: float, rate: float, decibel: float) -> FloatArray:
    """Taps (n_taps,) of a Kaiser-windowed low-pass FIR filter, an odd number of them.

    It leaves frequencies up to `passed` Hz as they are and reduces them by `decibel` from `stopped` Hz on; `rate` is the sampling
    rate in Hz.
    """
    from scipy.signal import firwin, kaiserord

    n_taps, beta = kaiserord(decibel, (stopped - passed) / (rate / 2))
    return np.asarray(firwin(n_taps | 1, (passed + stopped) / 2, window=("kaiser", beta), fs=rate))


def rate_ratio(rate: float, wanted: float) -> Fraction:
    """Ratio of sampling rates `wanted` / `rate`, both in Hz, as a fraction of whole numbers.

    Raises
    ------
    InputError
        If `wanted` is above `rate`, or the ratio needs numbers above 1000.
    """
    if not 0 < wanted <= rate * (1 + 1e-9):
        raise InputError(
            f"`sampling_rate` must be above 0 and at most {rate:g} Hz, the record's own, got {wanted:g} Hz; samples in "
            "between carry nothing new, leave it out"
        )
    ratio = Fraction(wanted / rate).limit_denominator(_LARGEST_FACTOR)
    if ratio == 0 or abs(float(ratio) * rate / wanted - 1) > 1e-9:
        near = max(float(ratio) * rate, rate / _LARGEST_FACTOR)
        raise InputError(
            f"`sampling_rate` must be a ratio of whole numbers up to {_LARGEST_FACTOR} to the record's {rate:g} Hz, got "
            f"{wanted:g} Hz; take {near:.9g} Hz"
        )
    return ratio


def decimation_filter(rate: float, ratio: Fraction) -> Fir:
    """Anti-alias filter for a change of sampling rate by `ratio` (new over old), at `rate` times the numerator, in Hz.

    The gain is 1 within 0.001 dB up to `PASS` of the new Nyquist frequency, and -80 dB from that frequency on.
    """
    nyquist = rate * float(ratio) / 2
    fine = rate * ratio.numerator
    return Fir(low_pass(PASS * nyquist, nyquist, fine, _DECIMATION_DB), fine)


def decimate(values: FloatArray, ratio: Fraction, fir: Fir, keep_edges: bool) -> tuple[FloatArray, int]:
    """`values` (n_times, n_channels) resampled by `ratio` (new rate over old), and the number of new samples dropped first.

    `fir` is the anti-alias filter. Samples at the ends, where the filter does not see the record on both sides, are dropped
    unless `keep_edges`.
    """
    from scipy.signal import resample_poly

    up, down = ratio.numerator, ratio.denominator
    new = np.asarray(resample_poly(values, up, down, axis=0, window=fir.taps))
    if keep_edges:
        return new, 0
    first = -(-fir.half // down)
    stop = ((len(values) - 1) * up - fir.half) // down + 1
    return new[first : max(stop, first)], first


def band_filter(low: float, high: float, rate: float) -> Fir:
    """FIR filter that passes `low` to `high` Hz within 0.01 dB; `low` 0 and `high` at half the `rate` leave that end open.

    The gain is -60 dB below half of `low`, and above 1.25 `high` or the middle between `high` and half the `rate`, whichever
    is lower. `rate` is the sampling rate in Hz.
    """
    taps: FloatArray = np.ones(1)
    if high < rate / 2:
        taps = low_pass(high, high + min(0.25 * high, 0.5 * (rate / 2 - high)), rate, _BAND_DB)
    if low > 0:
        below = -low_pass(0.5 * low, low, rate, _BAND_DB)
        below[len(below) // 2] += 1.0
        taps = np.convolve(taps, below)
    return Fir(taps, rate)


def filter_without_delay(values: FloatArray, fir: Fir, keep_edges: bool) -> tuple[FloatArray, int]:
    """`values` (n_times, n_channels) filtered without delay, and the number of samples dropped at the start.

    Samples at both ends, where the filter does not lie on the record, are dropped unless `keep_edges`.
    """
    from scipy.signal import oaconvolve

    mode, dropped = ("same", 0) if keep_edges else ("valid", fir.half)
    return np.asarray(oaconvolve(values, fir.taps[:, None], mode=mode, axes=0)), dropped

"""Check of averaged spectra for leakage at resonances, by the length of their segments and their window."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray
from structid.records.record import TimeRecord
from structid.records.transforms.spectra import Window, window_weights

#: Part of a peak that a window may take off; and part of the motion's power that segments may differ by, or end with.
_LOWERED, _DIFFERS, _AT_REST = 0.05, 0.02, 0.01
#: Points between two lines of a window's spectrum; times longer segments that are looked for; segments that averages need.
_FINE, _MOST, _SEGMENTS = 8, 1e4, 3
#: Part of a segment at either end that shows whether it is at rest there.
_END = 0.02


def leakage(record: TimeRecord, length: int, window: Window, frequency: FloatArray, damping_ratio: FloatArray) -> str:
    """A sentence on how much segments of `length` samples lower the peaks of modes; "" if they hardly do.

    Segments that repeat each other, or begin and end at rest, leak nothing under a flat window. Otherwise the
    power spectrum of a mode is smoothed by that of the window.

    Parameters
    ----------
    record : TimeRecord
    length : int
        Samples in a segment.
    window : str or tuple
        Window as for `frf_from_time`.
    frequency, damping_ratio : (n_modes,) float arrays
        Frequencies in Hz and damping ratios of the modes in the band.

    References
    ----------
    Bendat and Piersol (2010), Random Data, 4th ed., section 8.5.
    """
    weights = window_weights(window, length)
    is_flat = float(np.ptp(weights)) < 1e-9
    is_decay = isinstance(window, tuple) and window[0] == "exponential"
    if is_decay or not frequency.size:
        return ""
    if is_flat and (len(record.values) < 2 * length or _repeats(record, length) or _is_at_rest(record, length)):
        return ""
    lines = 2 * damping_ratio * frequency * length / record.sampling_rate
    worst = int(lines.argmin())
    power = np.abs(np.fft.rfft(weights, _FINE * length)) ** 2
    lowered = _peak_loss(power, float(lines[worst]))
    if lowered <= _LOWERED:
        return ""
    enough = next(
        k for k in 1.1 ** np.arange(200) if _peak_loss(power, float(lines[worst]) * k) <= _LOWERED or k > _MOST
    )
    needed = int(np.ceil(length * enough))
    remedy = (
        f"take segments of {needed} samples, or fit the histories by [record.time]"
        if _SEGMENTS * needed <= len(record.values)
        else f"fit the histories by [record.time], or record longer: {_SEGMENTS} segments of {needed} samples, and the record has"
        f" {len(record.values)}"
    )
    name = "no window, though segments neither repeat nor rest at their ends," if is_flat else f"window {window!r}"
    return (
        f"leakage: {name} at {lines[worst]:.2g} lines in the half-power bandwidth at {frequency[worst]:.4g} Hz lowers"
        f" that peak by about {100 * lowered:.2g} % and shows more damping; {remedy}"
    )


def _peak_loss(power: FloatArray, lines: float) -> float:
    """Fraction by which a window lowers the peak of a mode with `lines` spectral lines in its half-power bandwidth.

    `power` is the window's power spectrum, with `_FINE` points per line.
    """
    offset = np.arange(len(power)) / _FINE
    weight = np.where(offset > 0, 2.0, 1.0) * power
    peak = 1 / (1 + (2 * offset / max(lines, 1e-9)) ** 2)
    return float(1 - (weight * peak).sum() / weight.sum())


def _normalized_segments(record: TimeRecord, length: int) -> FloatArray:
    """Consecutive whole segments, (n_segments, length, n_channels), with mean and power of each channel of the record scaled.

    Over the whole record, each channel has mean 0 and mean square 1.
    """
    count = len(record.values) // length
    values = record.values - record.values.mean(axis=0)
    size = np.sqrt((values**2).mean(axis=0))
    scaled = values / np.where(size > 0, size, 1.0)
    segments: FloatArray = scaled[: count * length].reshape(count, length, -1)
    return segments


def _repeats(record: TimeRecord, length: int) -> bool:
    parts = _normalized_segments(record, length)
    return len(parts) > 1 and bool(np.median((np.diff(parts, axis=0) ** 2).mean(axis=1)) < 2 * _DIFFERS)


def _is_at_rest(record: TimeRecord, length: int) -> bool:
    """True if the motion is at rest both at the start and at the end of the segments, on average.

    `length` is the number of samples in a segment. False if the record is shorter than that.
    """
    parts = _normalized_segments(record, length)
    end = max(int(_END * length), 1)
    if not len(parts):
        return False
    level = [float((part[:, :end] ** 2).mean()) for part in (parts, parts[:, ::-1])]
    return max(level) < _AT_REST

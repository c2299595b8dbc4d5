"""Checks of the spectra of a record: too few periods, drift, aliasing, lines of the mains, leakage at resonances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.records.quality.findings import Finding, channel_name
from structid.records.record import TimeRecord
from structid.records.transforms.spectra import Window, window_weights

_FEW, _TOO_FEW = 20.0, 3.0  # periods in a record
_TOP = 0.9  # part of the Nyquist frequency above which an anti-alias filter leaves little
_TOP_SHARE = 0.05  # of the power, from which it is called suspicious there
_HARMONIC = 2.1  # kurtosis half way (by ratio) from 1.5 of a harmonic to 3 of a Gaussian process
_LINE = 0.125  # Hz, spacing of spectral lines wanted to see the mains
_SLOW, _BESIDE = 3, 20  # lines that a drift fills, and those above that it is held against
_DRIFT, _OVER = 0.02, 30.0  # part of the power that is a drift, and times the median line above that it must reach
_DECAY = 10.0  # times the power of the last quarter that the first has in a decay
_RARE = 1e-6  # probability at which a spectral line of a smooth spectrum is called a peak
#: Part of a peak that a window may take off; and part of the motion's power that segments may differ by, or end with.
_LOWERED, _DIFFERS, _AT_REST = 0.05, 0.02, 0.01
#: Points between two lines of a window's spectrum; times longer segments that are looked for; segments that averages need.
_FINE, _MOST, _SEGMENTS = 8, 1e4, 3
#: Part of a segment at either end that shows whether it is at rest there.
_END = 0.02


def spectral_checks(
    record: TimeRecord, sound: Sequence[int], band: tuple[float, float] | None = None
) -> tuple[Finding, ...]:
    """Findings on record length, aliasing and mains hum in the motion channels among `sound`, which are column indices.

    `band` (Hz) is the range of interest, whose lower end says how long the record has to be; without it the spectrum does. Empty
    if there is no such channel; a record too short for a spectrum has that finding alone.
    """
    n = len(record.values)
    motion = [i for i in sound if record.quantities[i] != "force"]
    if not motion:
        return ()
    if n < 64:
        words = f"the record has {n} samples, too few for a spectrum; measure longer"
        return (Finding("short", words, "unusable"),)
    return (*_short(record, motion, band), *_aliasing(record, motion), *_mains(record, motion))


def harmonic_indicator(record: TimeRecord, frequency: float, width: float | None = None) -> FloatArray:
    """Kurtosis of each channel in a narrow band, (n_channels,): 1.5 for a harmonic, 3 for a mode under random forces.

    Parameters
    ----------
    record : TimeRecord
    frequency : float
        Centre of the band in Hz.
    width : float, optional
        Width of the band in Hz; by default the greatest of 1 % of the frequency and 100 lines of the record, at
        most 40 % of the frequency. With B T = width times duration the estimate of a Gaussian channel has a standard
        deviation near 3 / sqrt(B T).

    Returns
    -------
    (n_channels,) float array
        NaN for a channel without motion in the band. Decaying motion gives values above 1.5 up to far above 3.

    Raises
    ------
    InputError
        If the band is not within 0 and the Nyquist frequency.

    References
    ----------
    Jacobsen, Andersen and Brincker (2007), Using EFDD as a robust technique for deterministic excitation in
    operational modal analysis, IOMAC 2.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(20000)[:, None] / 200
    >>> hum = TimeRecord(200.0, np.sin(2 * np.pi * 50.02 * t), ("1X",), ("velocity",))
    >>> harmonic_indicator(hum, 50.0).round(1).tolist()
    [1.5]
    """
    n, rate = record.values.shape[0], record.sampling_rate
    span = max(0.01 * frequency, min(100 * rate / n, 0.4 * frequency)) if width is None else width
    low, high = frequency - span / 2, frequency + span / 2
    if not (span > 0 and low > 0 and high < rate / 2):
        raise InputError(
            f"`frequency` must lie with its band of {span:g} Hz between 0 and {rate / 2:g} Hz, got {frequency:g} Hz; "
            "give a smaller `width`"
        )
    lines = np.fft.rfftfreq(n, 1 / rate)
    spectrum = np.fft.rfft(record.values - record.values.mean(axis=0), axis=0)
    spectrum[(lines < low) | (lines > high)] = 0
    edge = n // 20
    part = np.fft.irfft(spectrum, n, axis=0)[edge : n - edge]
    square = np.square(part)
    power = np.mean(square, axis=0)
    return np.divide(np.mean(np.square(square), axis=0), power**2, out=np.full(len(power), np.nan), where=power > 0)


def _short(record: TimeRecord, motion: list[int], band: tuple[float, float] | None) -> list[Finding]:
    """Finding if the record holds too few periods of the lowest frequency of `band`, or of its slow motion; else empty.

    `motion` are the indices of the motion channels. Too few are fewer than 20 periods of the lower end of the `band`,
    in Hz, or without a band 3 periods of the frequency below which half the power lies.
    """
    n = len(record.values)
    duration = n / record.sampling_rate
    if band is not None and band[0] > 0:
        low, what = band[0], f"the lowest frequency of the band, {band[0]:g} Hz"
        few = _FEW
    else:
        y = record.values[:, motion] - record.values[:, motion].mean(axis=0)
        power = np.abs(np.fft.rfft(y, axis=0)[1:]) ** 2
        fraction = np.mean(np.cumsum(power, axis=0) / power.sum(axis=0), axis=1)
        low = (1 + int(np.argmax(fraction >= 0.5))) / duration
        what, few = f"the half of the motion that is below {low:.3g} Hz (or drifts)", _TOO_FEW
    periods = low * duration
    if periods >= few:
        return []
    remedy = f"measure at least {_FEW / low:.3g} s"
    remedy += ", or take a drift off with `detrend`" if band is None else ", or raise the band"
    words = f"the record of {duration:.4g} s holds {periods:.3g} periods of {what}; {remedy}"
    return [Finding("short", words, "unusable" if band is not None and periods < _TOO_FEW else "warning")]


def drifts(record: TimeRecord) -> tuple[Finding, ...]:
    """Findings on motion channels with far more power in the first lines of the spectrum than next; not for decays.

    The first 3 lines above 0 Hz must hold over 2 % of the power, and over 30 times the median of the next 20. Under a
    measured force, such slow motion comes from the amplifier; ambient motion may be slow by itself. Empty for sound
    channels or too short a record.
    """
    motion = [
        i for i, quantity in enumerate(record.quantities) if quantity != "force" and np.ptp(record.values[:, i]) > 0
    ]
    if not motion or len(record.values) < 4 * (_SLOW + _BESIDE):
        return ()
    y = record.values[:, motion] - record.values[:, motion].mean(axis=0)
    power = np.abs(np.fft.rfft(y, axis=0)[1:]) ** 2
    slow = power[:_SLOW].sum(axis=0)
    fraction = slow / power.sum(axis=0)
    above = np.median(power[_SLOW : _SLOW + _BESIDE], axis=0)
    quarter = len(y) // 4
    decays = (y[:quarter] ** 2).sum(axis=0) > _DECAY * (y[-quarter:] ** 2).sum(axis=0)
    findings = []
    for k in np.flatnonzero((fraction > _DRIFT) & (slow > _OVER * above) & ~decays).tolist():
        name = channel_name(record, motion[k])
        words = (
            f"channel {name} drifts: {fraction[k]:.1%} of its power is slower than {_SLOW} periods a record, one of"
            f" {len(record.values) / record.sampling_rate / _SLOW:.3g} s; check the amplifier and its temperature, and take it"
            " off with `detrend` or a high-pass before use"
        )
        findings.append(Finding("drift", words, "warning", name))
    return tuple(findings)


def _power(record: TimeRecord, columns: list[int], segment: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies in Hz, (n_lines,), and auto-spectra by Welch's method, (n_lines, n_columns), both without the line at 0 Hz.

    `columns` are the indices of the channels, `segment` the samples in a segment.
    """
    from scipy.signal import welch

    lines, power = welch(record.values[:, columns], record.sampling_rate, nperseg=segment, axis=0)
    return lines[1:], power[1:]


def _aliasing(record: TimeRecord, motion: list[int]) -> list[Finding]:
    """Finding if a channel has over 5 % of its power above 0.9 times half the sampling rate; else empty.

    An anti-alias filter leaves little there. `motion` are the indices of the motion channels.
    """
    lines, power = _power(record, motion, min(512, len(record.values) // 2))
    nyquist = record.sampling_rate / 2
    fraction = power[lines > _TOP * nyquist].sum(axis=0) / power.sum(axis=0)
    doubtful = np.flatnonzero(fraction > _TOP_SHARE)
    if not len(doubtful):
        return []
    worst = int(fraction.argmax())
    words = (
        f"{fraction[worst]:.1%} of the power of channel {channel_name(record, motion[worst])} lies between "
        f"{_TOP * nyquist:g} and {nyquist:g} Hz, where an anti-alias filter would leave little ({len(doubtful)} of "
        f"{len(motion)} channels have more than {_TOP_SHARE:.0%} there): motion from above may appear folded down; measure "
        "faster or with an analogue filter, and decimate by `prepare`, never by leaving out samples"
    )
    return [Finding("aliasing", words, "warning")]


def _mains(record: TimeRecord, motion: list[int]) -> list[Finding]:
    """Findings on narrow lines of steady amplitude at multiples of 50 and 60 Hz.

    `motion` are the indices of the motion channels. Empty for records too short to resolve the lines, or sampled below 120 Hz.
    """
    rate, n = record.sampling_rate, len(record.values)
    segment = min(round(rate / _LINE), n // 5)
    spacing = rate / max(segment, 1)
    if segment < 64 or spacing > 1.0 or rate < 120:
        return []
    lines, power = _power(record, motion, segment)
    findings = []
    for base in (50.0, 60.0):
        for multiple in np.arange(base, 0.95 * rate / 2, base):
            if base == 60.0 and multiple % 50 == 0:
                continue
            hit = _harmonic_at(record, motion, lines, power, float(multiple))
            if hit:
                findings.append(hit)
    return findings


def _harmonic_at(
    record: TimeRecord, motion: list[int], lines: FloatArray, power: FloatArray, frequency: float
) -> Finding | None:
    """Finding on a line of steady amplitude near `frequency` Hz in any channel; None if there is none.

    `power` (n_lines, n_channels) belongs to `lines` in Hz; `motion` are the indices of the motion channels.
    """
    from scipy.stats import chi2

    spacing = lines[1] - lines[0]
    averages = 0.9 * 2 * len(record.values) / record.sampling_rate * spacing
    nearby = np.flatnonzero(np.abs(lines - frequency) <= max(0.1, 1.5 * spacing))
    around = (np.abs(lines - frequency) > 4 * spacing) & (np.abs(lines - frequency) < 30 * spacing)
    top = nearby[power[nearby].argmax(axis=0)], np.arange(len(motion))
    height = power[top] / np.median(power[around], axis=0)
    limit = chi2.isf(_RARE, 2 * averages) / chi2.isf(0.5, 2 * averages)
    skirt = np.stack([power[np.clip(top[0] + k, 0, len(lines) - 1), top[1]] for k in (-4, 4)]).mean(axis=0)
    peaks = (height > 2 * limit) & (skirt < 0.1 * power[top])
    if not peaks.any():
        return None
    steady = harmonic_indicator(record, frequency, min(max(0.5, 40 * record.sampling_rate / len(record.values)), 8.0))[
        motion
    ]
    hits = np.flatnonzero(peaks & (steady < _HARMONIC))
    if not len(hits):
        return None
    worst = int(hits[height[hits].argmax()])
    words = (
        f"{len(hits)} channels show a line of steady amplitude at {frequency:g} Hz, at most {10 * np.log10(height[worst]):.0f} dB "
        f"above the spectrum around it ({channel_name(record, motion[worst])}, kurtosis {steady[worst]:.2f} where 1.5 is a "
        "harmonic and 3 a mode): the mains, no mode; mend the grounding, or keep it out of the `band`"
    )
    return Finding("mains", words, "warning")


def leakage(record: TimeRecord, length: int, window: Window, frequency: FloatArray, damping_ratio: FloatArray) -> str:
    """A sentence on how much segments of `length` samples lower the peaks of modes; "" if by at most 5 %.

    Segments that repeat each other, or begin and end at rest, leak nothing under a flat window. Otherwise the
    power spectrum of a mode is smoothed by that of the window. Exponential windows are not judged. The mode with the fewest
    lines in its half-power bandwidth decides.

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
        else f"fit the histories by [record.time], or record for longer: {_SEGMENTS} segments of {needed} samples (the record has"
        f" {len(record.values)})"
    )
    name = "no window, though segments neither repeat nor rest at their ends," if is_flat else f"window {window!r}"
    return (
        f"leakage: {name} lowers the peak at {frequency[worst]:.4g} Hz by about {100 * lowered:.2g} % and makes its damping look"
        f" larger ({lines[worst]:.2g} lines in its half-power bandwidth); {remedy}"
    )


def _peak_loss(power: FloatArray, lines: float) -> float:
    """Fraction by which a window lowers the peak of a mode with `lines` spectral lines in its half-power bandwidth.

    `power` is the window's power spectrum from 0 on, with 8 points per line.
    """
    offset = np.arange(len(power)) / _FINE
    weight = np.where(offset > 0, 2.0, 1.0) * power
    peak = 1 / (1 + (2 * offset / max(lines, 1e-9)) ** 2)
    return float(1 - (weight * peak).sum() / weight.sum())


def _normalized_segments(record: TimeRecord, length: int) -> FloatArray:
    """Consecutive whole segments, (n_segments, length, n_channels), of channels with mean 0 and mean square 1.

    Mean and mean square are those over the whole record; a constant channel is 0. Samples that fill no segment are left
    out.
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

    It is at rest if the mean square over the first and over the last 2 % of a segment is below 1 % of that of the
    record. `length` is the number of samples in a segment. False if the record is shorter than that.
    """
    parts = _normalized_segments(record, length)
    end = max(int(_END * length), 1)
    if not len(parts):
        return False
    level = [float((part[:, :end] ** 2).mean()) for part in (parts, parts[:, ::-1])]
    return max(level) < _AT_REST

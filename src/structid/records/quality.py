"""Faults of records: findings on channels, samples, hammer blows, spectra and length, and the repair of samples.

Each test of samples is scaled by the data around it, so that quantized, smooth, quiet and impulsive signals keep their samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError, require_class
from structid.records.record import TimeRecord
from structid.records.spectra import Window, window_weights

Severity = Literal["note", "warning", "unusable"]
#: Kinds that say that one channel did not measure its motion.
CHANNEL_FAULTS = ("dead", "constant", "clipped", "drop_out", "spikes", "double_hit")
Flags = NDArray[np.bool_]

_BLOCK = 64  # samples of a block with one scale of the second difference
_NEAR = 50  # samples on either side that show how often values repeat
_FALSE_ALARMS = 1e-3  # expected number in a channel of independent Gaussian samples
_MARGIN = 1.6  # over the Gaussian quantile, for scales from 64 samples that depend on each other
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
_DEAD = 1e-9  # part of the median level of a quantity below which a channel holds no motion
_LEVEL = 100.0  # ratio to that median from which a level is doubtful
_MUCH = 0.05  # part of samples clipped or lost from which a channel is unusable
#: Force over its peak from which on it is a blow; part of the record beyond which the force is none of a hammer.
_BLOW, _MOST_OF_RECORD = 0.1, 0.1
#: Durations of contact within which a second blow belongs to the first: blows that are meant are farther apart.
_CLOSE = 50.0


@dataclass(frozen=True)
class Finding:
    """One thing to know before a record is used.

    Attributes
    ----------
    kind : str
        ``dead``, ``constant``, ``clipped``, ``double_hit``, ``drop_out``, ``late_start``, ``spikes``, ``level``, ``short``,
        ``aliasing``, ``mains`` or, from `prepare`, ``filter``, from `drifts`, ``drift``.
    words : str
        What was found where, with numbers, and the remedy.
    severity : {"note", "warning", "unusable"}
        ``unusable`` means that modes or parameters from this channel would be wrong.
    channel : str
        Degree of freedom and quantity; empty where the whole record is meant.
    """

    kind: str
    words: str
    severity: Severity = "warning"
    channel: str = ""

    def __str__(self) -> str:
        return f"{self.severity}: {self.words}"


def channel_name(record: TimeRecord, index: int) -> str:
    """Degree of freedom and quantity of channel number `index`, as in ``3Z+ velocity``."""
    return f"{record.channels[index]} {record.quantities[index]}"


def runs(values: NDArray[np.generic]) -> tuple[IntArray, IntArray]:
    """First index and length of each run of equal values, two arrays (n_runs,), in order."""
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


def flagged_runs(flags: Flags) -> list[tuple[int, int]]:
    """Runs of True in a mask (n_times,), as (first sample, sample after the last) each."""
    starts, lengths = runs(flags)
    return [(int(a), int(a + n)) for a, n in zip(starts, lengths, strict=True) if flags[a]]


def quantum(y: FloatArray) -> float:
    """Least difference between values of `y` (n,), rounding apart: the step of the converter, or nearly 0; 0 if all are equal."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * np.ptp(y)]
    return float(steps.min()) if steps.size else 0.0


def clipped_samples(y: FloatArray) -> Flags:
    """Mask (n_times,) of samples of `y` at its highest or lowest value because the converter or amplifier saturates.

    That value must lie half a standard deviation from the median, occur 2.5 times as often as the next two steps of the
    converter together and four times at least, and away from the ends three times in a row, or 20 times in all. A
    smooth crest in coarse steps gives at most 1.4 times (levels in the ratio 1 : 0.41 : 0.32). None are flagged where
    `y` has fewer than four values. Signals that were filtered or resampled after clipping are not recognised.
    """
    flags = np.zeros(len(y), dtype=bool)
    levels, counts = np.unique(y, return_counts=True)
    if len(levels) < 4:
        return flags
    middle, spread, step = np.median(y), y.std(), quantum(y)
    for level, count in ((levels[0], counts[0]), (levels[-1], counts[-1])):
        below = counts[(np.abs(levels - level) < 2.5 * step) & (levels != level)].sum()
        if abs(level - middle) > 0.5 * spread and count >= max(4, 2.5 * below):
            at_level = y == level
            inner = [stop - start for start, stop in flagged_runs(at_level) if start > 0 and stop < len(y)]
            if inner and (max(inner) >= 3 or count >= 20):
                flags |= at_level
    return flags


def drop_outs(y: FloatArray, besides: Flags | None = None) -> list[tuple[int, int]]:
    """Runs of a repeated value that the samples around do not explain, as (first sample, sample after the last) each.

    With p the fraction of repeats among 50 samples on either side, a run of length L is expected N p^(L - 1) times among N
    samples. A run is reported if that is below 0.001, it is longer than eight times the 98 % quantile
    of all run lengths (crests in coarse steps), or than four samples if that quantile is 1, and the signal before or after it
    moves by four steps of the converter or more (else a decay has died out). There are none in fewer than 16 samples or four
    runs.

    Parameters
    ----------
    y : (n_times,) float array
        Samples of a channel.
    besides : (n_times,) bool array, optional
        Samples that are known to repeat (clipped ones); runs of them are not reported.
    """
    starts, lengths = runs(y)
    n = len(y)
    if n < 16 or len(starts) < 4:
        return []
    total = np.concatenate([[0], np.cumsum(np.concatenate([[False], y[1:] == y[:-1]]))])
    stops = starts + lengths
    before, after = np.maximum(starts - _NEAR, 0), np.minimum(stops + _NEAR, n)
    repeats = total[starts] - total[before] + total[after] - total[np.minimum(stops + 1, n)]
    seen = (starts - before) + (after - stops)
    chance = (repeats + 1) / (seen + 2)
    rare = np.log(n) + (lengths - 1) * np.log(chance) < np.log(_FALSE_ALARMS)
    usual = np.quantile(lengths, 0.98)
    rare &= lengths > (8 * usual if usual > 1 else 4)
    least = 4 * quantum(y) if rare.any() else 0.0
    runs_found = []
    for i in np.flatnonzero(rare):
        start, stop = int(starts[i]), int(stops[i])
        if besides is not None and besides[start]:
            continue
        around = [part for part in (y[before[i] : start], y[stop : after[i]]) if len(part)]
        if max(np.ptp(part) for part in around) >= least:
            runs_found.append((start, stop))
    return runs_found


def spikes(y: FloatArray) -> Flags:
    """Mask (n_times,) of single samples of `y`, up to about three in a row, that lie off the motion around them.

    e_i = y_i - (y_(i-1) + y_(i+1)) / 2 is compared with the median of |e| in blocks of 64 samples, the greatest of a
    block and its neighbours; the limit is 1.6 times the Gaussian quantile for 0.001 false alarms per channel. A spike
    starts and ends on the motion (the sum of e and its first moment vanish over it) and leaves nothing behind: a step,
    a kink or a shock that rings is no spike. Records shorter than two blocks have none.
    """
    from scipy.stats import norm

    n = len(y)
    flags = np.zeros(n, dtype=bool)
    if n < 2 * _BLOCK:
        return flags
    e = np.zeros(n)
    e[1:-1] = y[1:-1] - (y[:-2] + y[2:]) / 2
    limit = _MARGIN * float(norm.isf(_FALSE_ALARMS / (2 * n))) * np.maximum(local_scale(e), 0.5 * quantum(y))
    hot = np.flatnonzero(np.abs(e) > limit)
    if not len(hot):
        return flags
    for group in np.split(hot, np.flatnonzero(np.diff(hot) > 3) + 1):
        first, last = int(group[0]) - 1, int(group[-1]) + 1
        if last - first <= 6 and _is_spike(e, first, last):
            line = np.interp(np.arange(first, last + 1), [first - 1, last + 1], y[[first - 1, min(last + 1, n - 1)]])
            distance = np.abs(y[first : last + 1] - line)
            flags[first : last + 1] |= distance > 0.5 * distance.max()
    return flags


def local_scale(e: FloatArray) -> FloatArray:
    """Standard deviation of `e` (n_times,) around each sample, (n_times,), by medians of |e| in blocks of 64 samples.

    The largest of a block and both neighbours counts; samples after the last whole block take that of it.
    """
    n_blocks = len(e) // _BLOCK
    medians = np.median(np.abs(e[: n_blocks * _BLOCK]).reshape(n_blocks, _BLOCK), axis=1) / 0.6745
    padded = np.concatenate([medians[:1], medians, medians[-1:]])
    greatest = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return np.asarray(greatest[np.minimum(np.arange(len(e)) // _BLOCK, n_blocks - 1)])


def _is_spike(e: FloatArray, first: int, last: int) -> bool:
    """True if the second differences `e` (n_times,) over samples `first` to `last` (included) are those of an isolated spike.

    They must sum to about 0, also weighted by time, and be small within the twelve samples on either side.
    """
    if first < 1 or last > len(e) - 2:
        return False
    in_spike = e[first : last + 1]
    offset = np.arange(len(in_spike)) - (len(in_spike) - 1) / 2
    if abs(in_spike.sum()) > 0.3 * np.abs(in_spike).sum() or abs(offset @ in_spike) > 0.3 * np.abs(offset) @ np.abs(
        in_spike
    ):
        return False
    outside = np.concatenate([e[max(first - 12, 0) : first], e[last + 1 : last + 13]])
    return bool(np.abs(outside).max(initial=0.0) < 0.2 * np.abs(in_spike).max())


def fill_missing(y: FloatArray, missing: Flags) -> FloatArray:
    """`y` (n_times,) with the samples in the mask `missing` replaced by the cubic through two kept samples on either side.

    With fewer kept samples on a side the polynomial is of lower degree; before the first and after the last kept sample its
    value is held.
    """
    result, kept = np.array(y, dtype=float), np.flatnonzero(~missing)
    for start, stop in flagged_runs(missing):
        index = int(np.searchsorted(kept, start))
        left, right = kept[max(index - 2, 0) : index], kept[index : index + 2]
        nodes = np.concatenate([left, right])
        if not len(left) or not len(right):
            result[start:stop] = y[left[-1]] if len(left) else y[right[0]]
            continue
        offset = (np.arange(start, stop)[:, None] - nodes) / (stop - start + 1.0)
        gaps = (nodes[:, None] - nodes) / (stop - start + 1.0)
        others = ~np.eye(len(nodes), dtype=bool)
        weights = [offset[:, others[k]].prod(axis=1) / gaps[k, others[k]].prod() for k in range(len(nodes))]
        result[start:stop] = np.stack(weights, axis=1) @ y[nodes]
    return result


def spectral_checks(
    record: TimeRecord, sound: Sequence[int], band: tuple[float, float] | None = None
) -> tuple[Finding, ...]:
    """Findings on record length, aliasing and mains hum in the motion channels among `sound`, which are column indices.

    `band` (Hz) is the range of interest, whose lower end says how long the record has to be; without it the spectrum
    does. Empty if there is no such channel; a record of fewer than 64 samples has a finding on that alone.
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
    """One finding if the record has too few periods of the lowest frequency of `band`, or of its slow motion; else [].

    `motion` are the indices of the motion channels. Too few are fewer than 20 periods of the lower end of the `band`,
    in Hz ("unusable" below 3, else a warning), or without a band 3 periods of the frequency below which half the power
    lies.
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
    channels or fewer than 92 samples.
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
    """One finding if a channel has over 5 % of its power above 0.9 times half the sampling rate; else an empty list.

    An anti-alias filter leaves little there. It names the worst channel. `motion` are the indices of the motion
    channels of `record`.
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
    """Findings on narrow lines of steady amplitude at multiples of 50 and 60 Hz, in a list.

    `motion` are the indices of the motion channels of `record`. Empty for records too short for lines 1 Hz apart in
    five segments, or sampled below 120 Hz.
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

    `power` (n_lines, n_channels) belongs to `lines` in Hz; `motion` are the indices of the motion channels of `record`.
    Near is within 0.1 Hz or 1.5 lines, whichever is more.
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


def signal_checks(record: TimeRecord, band: tuple[float, float] | None = None) -> tuple[Finding, ...]:
    """Findings on every channel and on the record as a whole; empty for a sound record.

    Looked for are dead and constant channels, double hits, clipping, drop-outs (runs of one value), spikes, levels far from
    those of the other channels, records of a few periods only, power up to the Nyquist frequency (aliasing), and lines of the
    mains.

    Parameters
    ----------
    record : TimeRecord
    band : (float, float), optional
        Frequency range of interest in Hz, whose lower end decides how long the record has to be; by default the spectrum
        does.

    Returns
    -------
    tuple of Finding
        Channels in order, then the record.

    Notes
    -----
    Clipping is seen in samples as the converter gave them, before any filter. Impacts are natural in force channels:
    these are not searched for spikes, and runs at rest are no drop-outs there. A time offset between channels is not
    looked for.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.random.default_rng(1).standard_normal((4000, 2)) * [1.0, 0.0]
    >>> record = TimeRecord(100.0, motion, ("1X", "2X"), ("velocity",) * 2)
    >>> signal_checks(record)[0].words
    'channel 2X+ velocity is 0 at every sample; check sensor and cable, or leave the channel out with `channels`'
    """
    require_class("record", record, TimeRecord, "make it by `read_record` or `TimeRecord`")
    findings = channel_checks(record)
    silent = {finding.channel for finding in findings if finding.kind in ("constant", "dead")}
    sound = [i for i in range(len(record.channels)) if channel_name(record, i) not in silent]
    return (*findings, *spectral_checks(record, sound, band))


def channel_checks(record: TimeRecord) -> tuple[Finding, ...]:
    """Findings on each channel of `record` in turn: constant or dead, else faults of samples and an unusual level.

    Faults are clipping, late starts, drop-outs, double hits of forces and spikes of motions. A level is unusual if it
    is 100 times the median of the channels of its quantity or more, or a hundredth or less. Empty for a record without
    faults; a constant or dead channel has no other finding.
    """
    level = record.values.std(axis=0)
    usual = _usual_level(record, level)
    findings: list[Finding] = []
    for i in range(len(record.channels)):
        silent = _silent(record, i, float(level[i]), float(usual[i]))
        if silent is not None:
            findings.append(silent)
            continue
        findings += _sample_findings(record, i)
        ratio = level[i] / usual[i]
        if not 1 / _LEVEL < ratio < _LEVEL:
            name = channel_name(record, i)
            words = (
                f"channel {name} has {ratio:.3g} times the level that is usual among the {record.quantities[i]} "
                "channels; check its sensitivity, unit and cable"
            )
            findings.append(Finding("level", words, "warning", name))
    return tuple(findings)


def _usual_level(record: TimeRecord, level: FloatArray) -> FloatArray:
    """Median level of the moving channels of each channel's kind, (n_channels,); 0 if none of them moves.

    Channels of one kind have the same quantity in `record`, and are both translations or both rotations. `level`
    (n_channels,) holds the standard deviation of each channel.
    """
    kinds = [(q, c.is_rotation) for q, c in zip(record.quantities, record.channels, strict=True)]
    moving = np.ptp(record.values, axis=0) > 0
    alike = [[j for j, k in enumerate(kinds) if k == kind and moving[j]] for kind in kinds]
    return np.array([np.median(level[members]) if members else 0.0 for members in alike])


def _silent(record: TimeRecord, i: int, level: float, usual: float) -> Finding | None:
    """Finding that channel `i` (from 0) is constant (to 1e-12) or dead (below 1e-9 of the `usual` level), or None.

    `level` is its standard deviation, in the unit of the channel as `usual`.
    """
    y, name = record.values[:, i], channel_name(record, i)
    remedy = "check sensor and cable, or leave the channel out with `channels`"
    if np.ptp(y) <= 1e-12 * np.abs(y).max():
        return Finding("constant", f"channel {name} is {y[0]:.6g} at every sample; {remedy}", "unusable", name)
    if level < _DEAD * usual:
        words = f"channel {name} is dead: it moves by {level:.3g}, where {usual:.3g} is usual; {remedy}"
        return Finding("dead", words, "unusable", name)
    return None


def _sample_findings(record: TimeRecord, i: int) -> list[Finding]:
    """Findings on clipping, late start, drop-outs, double hits (forces) and spikes (motions) in channel `i` (from 0)."""
    y, name, n = record.values[:, i], channel_name(record, i), len(record.values)
    unit = record.units[i]
    findings: list[Finding] = []
    clipped = clipped_samples(y)
    if clipped.any():
        fraction = clipped.mean()
        levels = " and ".join(f"{value:.4g}" for value in np.unique(y[clipped]))
        words = (
            f"channel {name} is clipped at {levels} {unit}: {clipped.sum()} of {n} samples ({fraction:.2%}) sit there, the "
            f"first at sample {np.argmax(clipped)}; lower the gain and measure again, or leave this part out by `start` and `stop`"
        )
        findings.append(Finding("clipped", words, "unusable" if fraction > _MUCH else "warning", name))
    findings += _drop_out_findings(record, i)
    twice = double_hit(record, i) if record.quantities[i] == "force" else None
    findings += [] if twice is None else [twice]
    thrown = spikes(y) if record.quantities[i] != "force" else np.zeros(n, dtype=bool)
    if thrown.any():
        words = (
            f"channel {name} has {thrown.sum()} samples thrown off the motion around them (spikes), the first at sample "
            f"{np.argmax(thrown)}; check plugs and grounding, or interpolate them in Python by "
            '`Preparation(outliers="replace")`'
        )
        findings.append(Finding("spikes", words, "warning", name))
    return findings


def _drop_out_findings(record: TimeRecord, i: int) -> list[Finding]:
    """Findings on a late start, a run of one value from the first sample on, and on drop-outs, in channel `i` (from 0).

    A force that rests at first has no late start.
    """
    y, name = record.values[:, i], channel_name(record, i)
    findings: list[Finding] = []
    runs_of_one = drop_outs(y, clipped_samples(y))
    if runs_of_one and runs_of_one[0][0] == 0 and record.quantities[i] != "force":
        stop = runs_of_one[0][1]
        words = (
            f"channel {name} stays at {y[0]:.4g} up to sample {stop} ({record.time[stop]:.4g} s): not yet moving or not "
            "yet switched on; leave that part out by `start` unless the start from rest is wanted"
        )
        findings.append(Finding("late_start", words, "note", name))
    lost = lost_samples(record, i)
    if lost:
        count, (start, stop) = sum(b - a for a, b in lost), max(lost, key=lambda part: part[1] - part[0])
        words = (
            f"channel {name} drops out {len(lost)} times, {count} samples in all: the longest run is {stop - start} samples "
            f"at {y[start]:.4g} from sample {start} ({record.time[start]:.4g} s) on; check the connection, interpolate "
            'short runs in Python by `Preparation(dropouts="replace")`, or leave them out by `start` and `stop`'
        )
        findings.append(Finding("drop_out", words, "unusable" if count > _MUCH * len(y) else "warning", name))
    return findings


def lost_samples(record: TimeRecord, i: int) -> list[tuple[int, int]]:
    """Drop-outs of the channel with index `i` as (first sample, sample after the last) each: runs of a repeated value.

    Runs that clipping or the motion around explains do not count, nor do a run from the first sample on (late start)
    and a force at rest, which is at its median.
    """
    y = record.values[:, i]
    runs = [part for part in drop_outs(y, clipped_samples(y)) if part[0] > 0]
    if record.quantities[i] == "force":
        rest_level = np.median(y)
        runs = [(start, stop) for start, stop in runs if y[start] != rest_level]
    return runs


def double_hit(record: TimeRecord, index: int) -> Finding | None:
    """Finding on the first blow of a force channel that another follows closely; None if there is none.

    Closely means within 50 times the longer contact of the two, from start to start.

    Parameters
    ----------
    record : TimeRecord
    index : int
        Column of the force channel, from 0.
    """
    force = np.abs(record.values[:, index])
    for (first, last), (second, end) in pairwise(_blows(force)):
        contact = max(last - first, end - second) + 1
        peaks = [start + int(np.argmax(force[start : stop + 1])) for start, stop in ((first, last), (second, end))]
        gap, sizes = (peaks[1] - peaks[0]) / record.sampling_rate, force[peaks].tolist()
        if second - first < _CLOSE * contact:
            name = channel_name(record, index)
            words = (
                f"channel {name} hits twice within {gap:.3g} s, at sample {first} and with {100 * sizes[1] / sizes[0]:.0f} % of"
                f" that force after it: its spectrum has gaps every {1 / gap:.3g} Hz, where FRFs are noise; leave this blow out"
            )
            return Finding("double_hit", words, "warning", name)
    return None


def _blows(force: FloatArray) -> list[tuple[int, int]]:
    """First and last sample of each hammer blow in `force` (n_times,), the magnitude of a force channel.

    A blow is above a tenth of the largest force; gaps of up to twice its length so far belong to it. Empty if the force
    is that large for more than a tenth of the record, as that of a shaker.
    """
    loud = np.flatnonzero(force > _BLOW * force.max())
    if not 0 < len(loud) <= _MOST_OF_RECORD * len(force):
        return []
    blows = [[int(loud[0]), int(loud[0])]]
    for sample in loud[1:].tolist():
        length = blows[-1][1] - blows[-1][0] + 1
        if sample - blows[-1][1] <= 2 * length:  # it rings, or dips in between
            blows[-1][1] = sample
        else:
            blows.append([sample, sample])
    return [(first, last) for first, last in blows]

"""Time records made ready for identification, with every step in words and numbers.

Filters are linear-phase FIR filters without delay: against aliasing before decimation, and for bands. A FIR filter multiplies a
free decay z^t by its response at z, as long as all its taps lie on the decay: frequency and damping stay exactly what they
were. Only the samples within half a filter of either end, and of any impact within the record, mix what was before and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, require_class
from structid.records.quality import Finding, channel_name, fill_missing, lost_samples, signal_checks, spikes
from structid.records.record import TimeRecord
from structid.records.tones import Tone, remove_tones

_Repair = Literal["report", "replace", "none"]
_LEAST = 16  # samples that must be left
#: Part of the new Nyquist frequency that passes a decimation unchanged.
_PASS = 0.8
_DECIMATION_DB, _BAND_DB = 84.0, 66.0  # Kaiser: a few dB over the 80 and 60 promised, which it meets nearly only
_LARGEST_FACTOR = 1000


@dataclass(frozen=True)
class Preparation:
    """Preparation of a time record before modes or parameters are identified; by default checks, and means removed.

    Parameters
    ----------
    detrend : {"mean", "linear", "none"} or int
        What is taken off each channel: its mean, a straight line, nothing, or a polynomial of that degree (1 to 10).
        To a free decay of a few periods this adds poles at 0 (one more than the degree), for which the order needs room.
    band : (float or None, float or None), optional
        Hz that pass unchanged; None for an open end.
    sampling_rate : float, optional
        Samples per second wanted, by decimation; 0.8 of its Nyquist frequency pass unchanged.
    interval : (float or None, float or None), optional
        Time in s, on the record's own axis, of the first and last sample kept; None for an open end.
    channels : sequence of str or Dof, optional
        Degrees of freedom kept, with all their quantities, in this order.
    outliers, dropouts : {"report", "replace", "none"}
        Spikes, and runs of a repeated value: named, replaced by cubic interpolation, or not looked for.
    longest_gap : int
        Samples of the longest drop-out that is replaced; longer ones stay and are named.
    edges : {"drop", "keep"}
        Samples within half a filter of either end, which hold the motion cut off there as if it were 0.
    remove_tones : sequence of float or "auto", optional
        Tones of machines that are taken off all motions (`remove_tones`): Hz, or those that stand out.

    Raises
    ------
    InputError
        If an entry is not one of these.
    """

    detrend: str | int = "mean"
    band: tuple[float | None, float | None] | None = None
    sampling_rate: float | None = None
    interval: tuple[float | None, float | None] | None = None
    channels: Sequence[str | Dof] | None = None
    outliers: _Repair = "report"
    dropouts: _Repair = "report"
    longest_gap: int = 10
    edges: Literal["drop", "keep"] = "drop"
    remove_tones: Sequence[float] | Literal["auto"] | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` on an unknown word, a range that does not increase, or a number out of range."""
        degree = self.detrend
        whole = isinstance(degree, int) and not isinstance(degree, bool) and 1 <= degree <= 10
        if degree not in ("mean", "linear", "none") and not whole:
            raise InputError(f"`detrend` must be mean, linear, none, or a degree from 1 to 10, got {degree!r}")
        for name in ("outliers", "dropouts"):
            if getattr(self, name) not in ("report", "replace", "none"):
                raise InputError(f"`{name}` must be report, replace or none, got {getattr(self, name)!r}")
        if self.edges not in ("drop", "keep"):
            raise InputError(f"`edges` must be drop or keep, got {self.edges!r}")
        for name in ("band", "interval"):
            ends = getattr(self, name)
            if ends is not None and (len(ends) != 2 or (None not in ends and not ends[0] < ends[1])):
                raise InputError(f"`{name}` must be two numbers that increase, None for an open end, got {ends!r}")
        if self.band is not None and any(f is not None and not f > 0 for f in self.band):
            raise InputError(f"`band` must be above 0 Hz, got {self.band!r}; write None for an open end")
        if self.longest_gap < 1:
            raise InputError(f"`longest_gap` must be at least 1 sample, got {self.longest_gap!r}")
        asked = self.remove_tones
        if asked is None or (isinstance(asked, str) and asked == "auto"):
            return
        if isinstance(asked, str) or np.ndim(asked) != 1:
            raise InputError(
                f'`remove_tones` must be a list of frequencies in Hz or "auto", got {asked!r}; write one as [50.0]'
            )
        if not all(np.isfinite(f) and f > 0 for f in asked):
            raise InputError(f"`remove_tones` must be greater than 0 Hz, got {list(asked)}")


@dataclass(frozen=True, eq=False)
class Prepared:
    """A record made ready, and how.

    Attributes
    ----------
    record : TimeRecord
    steps : tuple of str
        What was done, in order, in words with numbers.
    findings : tuple of Finding
        What was wrong with the record as given (after `interval` and `channels`), and what the filters do.
    tones : tuple of Tone
        What `remove_tones` took off.
    """

    record: TimeRecord
    steps: tuple[str, ...]
    findings: tuple[Finding, ...]
    tones: tuple[Tone, ...] = ()


def prepare(record: TimeRecord, preparation: Preparation | None = None) -> Prepared:
    """`record` cut, repaired, detrended, decimated, freed of tones and filtered, in this order.

    Parameters
    ----------
    record : TimeRecord
    preparation : Preparation, optional
        Steps to take; by default means are removed, and faults are searched for and reported, not repaired.

    Returns
    -------
    Prepared
        Record, sentences on the steps, findings, and the tones removed. Its noise variance is that of white noise after all
        steps, although a filter colours noise.

    Raises
    ------
    InputError
        If a channel is not there, the interval is empty, the sampling rate is too low for the band, the rates are in no
        ratio of whole numbers, or a filter is longer than the record or leaves fewer than 16 samples.

    Notes
    -----
    Filters are linear-phase FIR filters applied without delay (Kaiser window). The anti-alias filter is flat within
    0.001 dB to 0.8 of the new Nyquist frequency and down by 80 dB from it on. With ``edges="drop"`` the poles of a free
    decay are exactly those of the record, also its damping. A subspace method
    sees only what lies in the band.

    References
    ----------
    Kaiser (1974), Nonrecursive digital filter design using the I0-sinh window function, IEEE Int. Symp. Circuits Syst.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.random.default_rng(1).standard_normal((4000, 1)) + 3
    >>> prepare(TimeRecord(100.0, motion, ("1X",), ("velocity",)), Preparation(interval=(None, 30.0))).steps
    ('cut to 0-30 s, 3001 of 4000 samples', 'mean taken off each channel')
    """
    require_class("record", record, TimeRecord, "make it by `read_record` or `TimeRecord`")
    wanted = preparation or Preparation()
    steps: list[str] = []
    _require_rate(record, wanted)
    result = _cut_interval(_select_channels(record, wanted, steps), wanted, steps)
    low = None if wanted.band is None else wanted.band[0]
    findings = [*signal_checks(result, None if low is None else (low, np.inf))]
    off = {"spikes": wanted.outliers, "drop_out": wanted.dropouts, "late_start": wanted.dropouts}
    findings = [finding for finding in findings if off.get(finding.kind) != "none"]
    replaced = wanted.dropouts == "replace", wanted.outliers == "replace"
    result, repairs = _repair_samples(result, *replaced, longest_gap=wanted.longest_gap)
    steps += repairs
    result = _remove_trend(result, wanted.detrend, steps)
    result = _decimate(result, wanted, steps)
    result, tones = _remove_tones(result, wanted, steps, findings)
    result = _filter_band(result, wanted, steps, findings)
    return Prepared(result, tuple(steps), tuple(findings), tones)


def _require_rate(record: TimeRecord, wanted: Preparation) -> None:
    """Raise `InputError` if the record's sampling rate, or that after decimation, is too low for `wanted.band`.

    The band must end below half the record's rate and, where the record is decimated, at 0.8 of half the new rate at
    most.
    """
    if wanted.band is None:
        return
    high = max(f for f in (*wanted.band, 0.0) if f is not None)
    if high >= record.sampling_rate / 2:
        raise InputError(
            f"`band` must end below {record.sampling_rate / 2:g} Hz, half the record's sampling rate of "
            f"{record.sampling_rate:g} Hz, got {high:g} Hz; measure with more than {2.5 * high:g} Hz, or lower the band"
        )
    rate = wanted.sampling_rate
    if rate is not None and rate < record.sampling_rate and high > _PASS * rate / 2 * (1 + 1e-9):
        raise InputError(
            f"`sampling_rate` must be at least {2 * high / _PASS:g} Hz for a band up to {high:g} Hz, got {rate:g} Hz, which "
            f"passes up to {_PASS * rate / 2:g} Hz; raise it, or lower the band"
        )


def _select_channels(record: TimeRecord, wanted: Preparation, steps: list[str]) -> TimeRecord:
    """`record` with the channels in `wanted.channels` only, in that order, and a sentence appended to `steps`.

    It is returned as it is if they are None. Raises `InputError` if one of them is missing, or none is named.
    """
    if wanted.channels is None:
        return record
    dofs = parse_dofs(wanted.channels)
    missing = [str(dof) for dof in dofs if dof not in record.channels]
    if missing or not dofs:
        has = ", ".join(map(str, record.channels))
        raise InputError(
            f"`channels` must name channels of the record, got {', '.join(missing) or 'none'}; it has {has}"
        )
    keep = [i for dof in dict.fromkeys(dofs) for i, channel in enumerate(record.channels) if channel == dof]
    steps.append(f"kept {len(keep)} of {len(record.channels)} channels: {', '.join(map(str, dict.fromkeys(dofs)))}")
    return replace(
        record,
        values=record.values[:, keep],
        channels=tuple(record.channels[i] for i in keep),
        quantities=tuple(record.quantities[i] for i in keep),
        variance=None if record.variance is None else record.variance[keep],
    )


def _cut_interval(record: TimeRecord, wanted: Preparation, steps: list[str]) -> TimeRecord:
    """`record` cut to `wanted.interval` in s, the whole record if None. A sentence is appended to `steps`.

    Raises `InputError` if fewer than 16 samples are left.
    """
    if wanted.interval is None:
        return record
    time, (start, stop) = record.time, wanted.interval
    slack = 1e-6 / record.sampling_rate
    keep = np.flatnonzero(
        (time >= (-np.inf if start is None else start - slack)) & (time <= (np.inf if stop is None else stop + slack))
    )
    if len(keep) < _LEAST:
        raise InputError(
            f"`interval` must keep at least {_LEAST} samples of {time[0]:g}-{time[-1]:g} s at {record.sampling_rate:g} Hz, "
            f"got {wanted.interval!r} with {len(keep)}; widen it"
        )
    first, last = time[keep[0]], time[keep[-1]]
    steps.append(f"cut to {first:g}-{last:g} s, {len(keep)} of {len(time)} samples")
    return replace(record, values=record.values[keep], start=float(first))


def _repair_samples(
    record: TimeRecord, dropouts: bool, outliers: bool, longest_gap: int = 10
) -> tuple[TimeRecord, list[str]]:
    """The record with faulty samples replaced by cubic interpolation, and sentences on what was replaced.

    Parameters
    ----------
    record : TimeRecord
    dropouts : bool
        True to replace drop-outs of up to `longest_gap` samples.
    outliers : bool
        True to replace spikes; those in force channels stay, since impacts look alike.
    longest_gap : int
        Samples.

    Returns
    -------
    TimeRecord
        The record itself if nothing was found.
    list of str
        Also on drop-outs that are longer and stay.
    """
    values, steps = np.array(record.values), []
    for i in range(len(record.channels)):
        name, n = channel_name(record, i), len(values)
        if dropouts and np.ptp(values[:, i]):
            lost = lost_samples(record, i)
            flags = np.zeros(n, dtype=bool)
            for start, stop in lost:
                flags[start:stop] = stop - start <= longest_gap
            if flags.any():
                values[:, i] = fill_missing(values[:, i], flags)
                steps.append(
                    f"{flags.sum()} of {n} samples of channel {name} invented: drop-outs, by cubic interpolation"
                )
            long = [part for part in lost if part[1] - part[0] > longest_gap]
            if long:
                steps.append(
                    f"{len(long)} drop-outs of channel {name} left as they are, {sum(b - a for a, b in long)} samples: "
                    f"longer than {longest_gap} samples each; cut them with `interval`"
                )
        if outliers and record.quantities[i] != "force":
            flags = spikes(values[:, i])
            if flags.any():
                values[:, i] = fill_missing(values[:, i], flags)
                steps.append(f"{flags.sum()} of {n} samples of channel {name} invented: spikes, by cubic interpolation")
    return (replace(record, values=values) if steps else record), steps


def _remove_trend(record: TimeRecord, degree: str | int, steps: list[str]) -> TimeRecord:
    """`record` without its least-squares mean, straight line or polynomial in each channel. A sentence goes to `steps`.

    `degree` is "mean", "linear", "none" (unchanged) or the degree of the polynomial. The noise variance is lowered by
    the part of the samples that the fitted terms take. Raises `InputError` if the record has no more samples than the
    polynomial has terms.
    """
    if degree == "none":
        return record
    power = {"mean": 0, "linear": 1}.get(str(degree)) if isinstance(degree, str) else degree
    n, terms = len(record.values), 1 + int(power or 0)
    if n <= terms:
        raise InputError(f"`detrend` of degree {power} needs more than {terms} samples, got {n}")
    basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, n), terms - 1)
    q = np.linalg.qr(basis)[0]
    values = record.values - q @ (q.T @ record.values)
    words = {1: "mean", 2: "straight line"}.get(terms, f"polynomial of degree {power}")
    steps.append(f"{words} taken off each channel")
    variance = None if record.variance is None else record.variance * (n - terms) / n
    return replace(record, values=values, variance=variance)


def _decimate(record: TimeRecord, wanted: Preparation, steps: list[str]) -> TimeRecord:
    """`record` at `wanted.sampling_rate` in Hz, unchanged if None or equal; else a sentence is appended to `steps`.

    An anti-alias filter lowers the noise variance and costs half its length at either end, unless edges are kept.
    `InputError` if rates are in no ratio of whole numbers up to 1000, the new one is higher, the record too short.
    """
    if wanted.sampling_rate is None:
        return record
    ratio = rate_ratio(record.sampling_rate, wanted.sampling_rate)
    if ratio == 1:
        return record
    new_rate = record.sampling_rate * ratio.numerator / ratio.denominator
    fir = decimation_filter(record.sampling_rate, ratio)
    _require_longer(record, fir, new_rate, wanted)
    values, dropped = decimate(record.values, ratio, fir, wanted.edges == "keep")
    factor = f"{ratio.denominator}" + (f"/{ratio.numerator}" if ratio.numerator > 1 else "")
    steps.append(
        f"decimated by {factor} to {new_rate:g} Hz (FIR of {len(fir.taps)} taps, flat to {_PASS * new_rate / 2:g} Hz, -3 dB at "
        f"{fir.crossing(0.9 * new_rate / 2):.3g} Hz, -80 dB from {new_rate / 2:g} Hz on); {_edge_words(fir, wanted)}"
    )
    gain = fir.noise_gain * ratio.numerator
    variance = None if record.variance is None else record.variance * gain
    start = record.start + dropped / new_rate
    return replace(record, values=values, sampling_rate=new_rate, start=start, variance=variance)


def _remove_tones(
    record: TimeRecord, wanted: Preparation, steps: list[str], findings: list[Finding]
) -> tuple[TimeRecord, tuple[Tone, ...]]:
    """The record without the tones in `wanted.remove_tones`, and these tones; unchanged and () if None.

    Sentences are appended to `steps`, and a finding to `findings` for each named tone that is not there.
    """
    if wanted.remove_tones is None:
        return record, ()
    asked = wanted.remove_tones
    if not isinstance(asked, str) and wanted.sampling_rate is not None:
        beyond = [f for f in asked if f >= record.sampling_rate / 2]
        steps += [f"the tone at {f:g} Hz lies above half the sampling rate after decimation" for f in beyond]
        asked = [f for f in asked if f < record.sampling_rate / 2]
    result = remove_tones(record, asked)
    steps += [tone.words for tone in result.tones]
    if not result.tones and isinstance(asked, str):
        steps.append("no tone stands out: none is taken off")
    findings += [Finding("tone", words, "warning") for words in result.absent]
    return result.record, result.tones


def _filter_band(record: TimeRecord, wanted: Preparation, steps: list[str], findings: list[Finding]) -> TimeRecord:
    """`record` filtered to `wanted.band` in Hz, unchanged if None or open at both ends.

    A sentence is appended to `steps` and a note on damping and edges to `findings`. `InputError` if the record is too
    short for the filter.
    """
    if wanted.band is None or wanted.band == (None, None):
        return record
    low, high = wanted.band[0] or 0.0, wanted.band[1] or record.sampling_rate / 2
    fir = band_filter(low, high, record.sampling_rate)
    _require_longer(record, fir, record.sampling_rate, wanted)
    values, dropped = _filter_without_delay(record.values, fir, wanted.edges == "keep")
    ends = [f"{f:g}" for f in wanted.band if f is not None]
    what = "band-pass" if len(ends) == 2 else "high-pass" if wanted.band[0] is not None else "low-pass"
    cut = [
        fir.crossing(near) for f, near in ((wanted.band[0], 0.75 * low), (wanted.band[1], 1.1 * high)) if f is not None
    ]
    steps.append(
        f"{what} filtered, flat {'within' if len(ends) == 2 else 'from' if what == 'high-pass' else 'to'} {'-'.join(ends)} Hz "
        f"(FIR of {len(fir.taps)} taps without delay, -3 dB at {' and '.join(f'{f:.3g} Hz' for f in cut)}); "
        f"{_edge_words(fir, wanted)}"
    )
    half = fir.half / record.sampling_rate
    words = (
        f"the filter spreads what happens at an instant over {half:.3g} s before and after it: the damping of a free decay is "
        "right only from that time after an impact on"
    )
    words += (
        ", and not at the ends, which were kept"
        if wanted.edges == "keep"
        else "; begin `interval` at the impact or later"
    )
    words += f". A subspace method sees modes within {low:g}-{high:g} Hz only, and poles at the slopes are the filter's"
    findings.append(Finding("filter", words, "note"))
    variance = None if record.variance is None else record.variance * fir.noise_gain
    return replace(record, values=values, start=record.start + dropped / record.sampling_rate, variance=variance)


def _require_longer(record: TimeRecord, fir: _Fir, new_rate: float, wanted: Preparation) -> None:
    """Raise `InputError` if a filter is longer than the record, or leaves fewer than 16 samples at `new_rate`, in Hz.

    Edges that are kept count among what it leaves.
    """
    duration, span = (len(record.values) - 1) / record.sampling_rate, 2 * fir.half / fir.rate
    left = duration - (0.0 if wanted.edges == "keep" else span)
    if duration < span or left < _LEAST / new_rate:
        raise InputError(
            f"the record of {duration:.4g} s is too short for a filter of {len(fir.taps)} taps ({span:.4g} s) that leaves "
            f"{_LEAST} samples at {new_rate:g} Hz; measure longer, raise the lower end of `band` or leave it open "
            "(`detrend` takes off a drift), or raise `sampling_rate`"
        )


def _edge_words(fir: _Fir, wanted: Preparation) -> str:
    half = fir.half / fir.rate
    return (
        f"{half:.3g} s {'kept at either end, with edge effects' if wanted.edges == 'keep' else 'dropped at either end'}"
    )


@dataclass(frozen=True, eq=False)
class _Fir:
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


def _low_pass(passed: float, stopped: float, rate: float, decibel: float) -> FloatArray:
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


def decimation_filter(rate: float, ratio: Fraction) -> _Fir:
    """Anti-alias filter for a change of the sampling rate `rate` (Hz) by `ratio` (new over old).

    It runs at `rate` times the numerator of `ratio`. The gain is 1 within 0.001 dB up to the part `_PASS` of the new Nyquist
    frequency, and at most -80 dB from that frequency on.
    """
    nyquist = rate * float(ratio) / 2
    fine = rate * ratio.numerator
    return _Fir(_low_pass(_PASS * nyquist, nyquist, fine, _DECIMATION_DB), fine)


def decimate(values: FloatArray, ratio: Fraction, fir: _Fir, keep_edges: bool) -> tuple[FloatArray, int]:
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


def band_filter(low: float, high: float, rate: float) -> _Fir:
    """FIR filter that passes `low` to `high` Hz within 0.01 dB; `low` 0 and `high` at half the `rate` leave that end open.

    The gain is -60 dB below half of `low`, and above 1.25 `high` or the middle between `high` and half the `rate`, whichever
    is lower. `rate` is the sampling rate in Hz.
    """
    taps: FloatArray = np.ones(1)
    if high < rate / 2:
        taps = _low_pass(high, high + min(0.25 * high, 0.5 * (rate / 2 - high)), rate, _BAND_DB)
    if low > 0:
        below = -_low_pass(0.5 * low, low, rate, _BAND_DB)
        below[len(below) // 2] += 1.0
        taps = np.convolve(taps, below)
    return _Fir(taps, rate)


def _filter_without_delay(values: FloatArray, fir: _Fir, keep_edges: bool) -> tuple[FloatArray, int]:
    """`values` (n_times, n_channels) filtered without delay, and the number of samples dropped at the start.

    Samples at both ends, where the filter does not lie on the record, are dropped unless `keep_edges`.
    """
    from scipy.signal import oaconvolve

    mode, dropped = ("same", 0) if keep_edges else ("valid", fir.half)
    return np.asarray(oaconvolve(values, fir.taps[:, None], mode=mode, axes=0)), dropped

"""Tones of machines in time histories: told from modes under random forces, and taken off all channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import format_number
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.records.record import TimeRecord

#: Damping ratio of the least damped mode that is distinguished from a tone.
_LEAST_DAMPING = 1e-3
#: Greatest kurtosis of a tone whose frequency wanders: between 1.5 of a tone and 3 of a mode under random forces.
_MOST_KURTOSIS = 1.75
_BLOCK = 200  # periods of a tone under one Hann window
_QUARTERS = 4  # steps of a block from one window to the next
_FEWEST = 5.0  # time constants of the least damped mode that a record must hold
_RANGE = 0.006  # of a frequency, to either side of it, in which its tone is looked for
_SEARCHED_RISK, _ASKED_RISK = 1e-6, 1e-3  # that random motion passes for a tone looked for, or asked for
_LORENTZ = 1.6  # line at the top of a half-power bandwidth over the mean of the lines that are compared with it
_SPLINES = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # coefficients of a wandering phase that are tried
_STANDS_OUT, _PASSES, _MOST_TONES = 12.0, 3, 40
_MEDIAN_LINES = 64
_MULTIPLES = (2.0, 3.0, 4.0, 5.0, 6.0, 0.5, 1.5, 1 / 3, 2 / 3)
_DEGREES = (1, 2, 4, 8)  # of polynomials in time by which amplitudes may change
_LEAST_SEGMENTS = 12  # of a spectrum in which bands of steady motion are looked for
_PEAK = 2.0  # height of such a band over what lies around
_CHUNK = 1 << 17
_DOUBTFUL = -2.0  # log probability from which on a phase is not worth refining


@dataclass(frozen=True, eq=False)
class Tone:
    """A tone that was taken off a record.

    Attributes
    ----------
    channels : tuple of Dof
        Channels of the record.
    units : tuple of str
        SI unit of each channel.
    frequency : float
        Mean over the record, Hz.
    lowest, highest : float
        Limits of the tone's frequency in the course of the record, Hz; both `frequency` for a steady tone.
    amplitude : (n_channels,) float array
        Root of twice the mean square: the amplitude of a steady tone, SI.
    variance_fraction : (n_channels,) float array
        Part of the variance of each channel that the tone made.
    kurtosis : float
        Kurtosis of the motion in a narrow band at the tone before it was taken off: 1.5 for a tone alone, 3 for a mode under
        random forces.
    """

    channels: tuple[Dof, ...]
    units: tuple[str, ...]
    frequency: float
    lowest: float
    highest: float
    amplitude: FloatArray
    variance_fraction: FloatArray
    kurtosis: float

    @property
    def frequency_words(self) -> str:
        """Frequency of the tone in words, with its range if it wanders."""
        if not self.highest > self.lowest:
            return f"{format_number(self.frequency, 6)} Hz"
        return f"{format_number(self.lowest, 6)} to {format_number(self.highest, 6)} Hz"

    @property
    def words(self) -> str:
        """The tone in words: its frequency and its greatest part of a channel's variance."""
        most = int(self.variance_fraction.argmax())
        fraction = f"{100 * self.variance_fraction[most]:.3g} % of the variance of {self.channels[most]}"
        return f"tone at {self.frequency_words} taken off: {fraction}{', less of other channels' if len(self.channels) > 1 else ''}"


@dataclass(frozen=True, eq=False)
class TonesRemoved:
    """A record without its tones.

    Attributes
    ----------
    record : TimeRecord
    tones : tuple of Tone
        What was taken off, by frequency.
    absent : tuple of str
        Words on each frequency that was asked for and has no tone.
    """

    record: TimeRecord
    tones: tuple[Tone, ...]
    absent: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Phase:
    """Phase of a tone: 2 pi f t and a cubic spline of it over the record.

    Attributes
    ----------
    frequency : float
        f, Hz.
    duration : float
        Length of the record, s.
    coefficients : (n,) float array
        Coefficients of the spline, rad; empty for a steady tone.
    """

    frequency: float
    duration: float
    coefficients: FloatArray

    @property
    def wanders(self) -> bool:
        """True where the frequency changes in the course of the record."""
        return len(self.coefficients) > 0

    def spline(self, time: FloatArray, derivative: int = 0) -> FloatArray:
        """Phase in rad beside 2 pi f t at `time` (n_times,) in s, or its `derivative` of this order; 0 for a steady tone.

        Times before or after the record take the value at its start or end.
        """
        if not self.wanders:
            return np.zeros(len(time))
        from scipy.interpolate import BSpline

        curve = BSpline(_knots(len(self.coefficients), self.duration), self.coefficients, 3)
        return np.asarray(curve(np.clip(time, 0, self.duration), derivative))

    def at(self, time: FloatArray) -> FloatArray:
        """Phase at each time, rad."""
        return 2 * np.pi * self.frequency * time + self.spline(time)

    def course(self, time: FloatArray) -> FloatArray:
        """Frequency at each time, Hz."""
        return self.frequency + self.spline(time, 1) / (2 * np.pi)

    def with_coefficients(self, count: int) -> _Phase:
        """Copy of the phase as a spline with `count` coefficients."""
        time = np.linspace(0, self.duration, 8 * count)
        finer = replace(self, coefficients=np.zeros(count))
        return replace(finer, coefficients=np.linalg.lstsq(_basis(time, finer), self.spline(time), rcond=None)[0])

    def multiple(self, factor: float) -> _Phase:
        """Phase of a tone whose frequency is `factor` times that of this one throughout the record."""
        return _Phase(factor * self.frequency, self.duration, factor * self.coefficients)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Evidence that motion with a phase is one tone.

    Attributes
    ----------
    phase : _Phase
    log_probability : float
        Logarithm of the probability that random motion shows as strong a line.
    kurtosis : float
        1.5 for a tone alone, 3 for random motion.
    gain : float
        Log-likelihood that the tone adds for each channel, less what its fitted numbers cost (Schwarz's criterion).
    """

    phase: _Phase
    log_probability: float
    kurtosis: float
    gain: float


def remove_tones(record: TimeRecord, frequencies: Sequence[float] | Literal["auto"] = "auto") -> TonesRemoved:
    """The record without the tones of machines, whether their frequency is steady or wanders slowly, and these tones.

    Parameters
    ----------
    record : TimeRecord
        Record of motions; its forces stay as they are.
    frequencies : sequence of float or "auto"
        Frequencies of the tones in Hz, known to 0.6 % or better; ``"auto"`` searches for tones.

    Returns
    -------
    TonesRemoved
        The record, the tones that were subtracted, and sentences on frequencies without a tone.

    Raises
    ------
    InputError
        If a frequency is not between 0 and half the sampling rate.

    Notes
    -----
    The motion around a frequency is demodulated in all channels, in blocks of 200 periods under Hann windows. Its phase,
    common to all channels, is a straight line in time or a cubic spline whose number of coefficients is chosen by Schwarz's
    criterion; tones at multiples of another may share its phase. Sine and cosine of this phase, with amplitudes that change
    slowly or with the frequency where the criterion allows, are subtracted by least squares.

    Two tests distinguish a tone from a mode. A steady tone is a single line of the transform over the record: it must exceed
    the lines within the half-power bandwidth of a mode of 0.1 % damping, where the power of random motion is exponentially
    distributed. A free decay has such a bandwidth, too, if the record is longer than five time constants
    1 / (zeta omega). A tone that wanders must also have a steady amplitude: a kurtosis below 1.75.

    References
    ----------
    Jacobsen, Andersen and Brincker (2007), Using EFDD as a robust technique for deterministic excitation in operational modal
    analysis, IOMAC 2.

    Examples
    --------
    >>> rng, t = np.random.default_rng(1), np.arange(20000)[:, None] / 200
    >>> hum = TimeRecord(200.0, np.sin(2 * np.pi * 50.02 * t) + rng.standard_normal(t.shape), ("1X",), ("velocity",))
    >>> [round(tone.frequency, 2) for tone in remove_tones(hum).tones]
    [50.02]
    """
    swings = np.ptp(record.values, axis=0) > 0
    moving = [i for i, quantity in enumerate(record.quantities) if quantity != "force" and swings[i]]
    asked = _checked_frequencies(frequencies, record.sampling_rate)
    if not moving:
        return TonesRemoved(record, ())
    motion = np.asarray(record.values[:, moving], dtype=float)
    mean = motion.mean(axis=0)
    search = _Search(record.sampling_rate, motion - mean)
    absent: list[str] = []
    if asked is None:
        search.remove_all()
    else:
        absent = [words for frequency in asked if (words := search.remove(frequency, is_automatic=False))]
    if not search.taken:
        return TonesRemoved(record, (), tuple(absent))
    values = np.array(record.values, dtype=float)
    values[:, moving] = search.values + mean
    variance = record.values.var(axis=0)
    tones = []
    for evidence, power in sorted(search.taken, key=lambda pair: pair[0].phase.frequency):
        course = evidence.phase.course(np.linspace(0, search.duration, 512 if evidence.phase.wanders else 1))
        ends = float(course.mean()), float(course.min()), float(course.max())
        whole = np.zeros(len(variance))
        whole[moving] = power
        fraction = np.divide(whole, variance, out=np.zeros(len(variance)), where=variance > 0)
        tones.append(Tone(record.channels, record.units, *ends, np.sqrt(2 * whole), fraction, evidence.kurtosis))
    return TonesRemoved(replace(record, values=values), tuple(tones), tuple(absent))


def _checked_frequencies(frequencies: Sequence[float] | Literal["auto"], rate: float) -> list[float] | None:
    """`frequencies` of tones in Hz, sorted; None for "auto". `rate` is the sampling rate in Hz.

    Raises `InputError` if they are no list of numbers between 0 and half the rate.
    """
    if isinstance(frequencies, str) and frequencies == "auto":
        return None
    if isinstance(frequencies, str) or np.ndim(frequencies) != 1:
        raise InputError(f'`frequencies` must be a list of numbers in Hz or "auto", got {frequencies!r}')
    asked = sorted(float(f) for f in frequencies)
    for frequency in asked:
        if not 0 < frequency < rate / 2:
            raise InputError(
                f"`frequencies` of tones must lie between 0 and {rate / 2:g} Hz, half the sampling rate, got {frequency:g};"
                " leave it out"
            )
    return asked


class _Search:
    """Values from which tones are taken one after another, and what was taken: its evidence and its power by channel."""

    def __init__(self, rate: float, values: FloatArray) -> None:
        self.rate, self.values = rate, values
        self.taken: list[tuple[_Evidence, FloatArray]] = []

    @property
    def duration(self) -> float:
        return len(self.values) / self.rate

    def remove_all(self) -> None:
        """Find tones and subtract them from `values` until none stands out, or three passes are made or 40 tones taken.

        Of a tone that wanders, multiples and simple fractions of its frequency are tried too. Tones are appended to
        `taken`.
        """
        refused: list[float] = []
        for _ in range(_PASSES):
            before = len(self.taken)
            for frequency in _tone_candidates(self.values, self.rate):
                if len(self.taken) >= _MOST_TONES:
                    return
                if any(abs(frequency / other - 1) < _RANGE for other in refused):
                    continue
                if self.remove(frequency, is_automatic=True):
                    refused.append(frequency)
                elif self.taken[-1][0].phase.wanders:
                    fundamental = self.taken[-1][0].phase
                    for factor in _MULTIPLES:
                        self.remove_multiple(fundamental.multiple(factor))
            if len(self.taken) == before:
                return

    def remove(self, frequency: float, is_automatic: bool) -> str:
        """Subtract the tone near `frequency` (Hz) and return ""; without a tone there, return a sentence on the reason.

        `is_automatic` says that the search proposed the frequency, which needs stronger evidence than a user's: random
        motion must show as strong a line with a probability below 1e-6, else 1e-3. A tone that wanders needs 1e-6 in
        any case, and a kurtosis below 1.75. Of several phases that pass, multiples of other tones' among them, the one
        with the greatest gain is subtracted. No tone counts near half the sampling rate or in fewer than some 800
        periods.
        """
        if not self.is_inside(frequency):
            return f"no tone is taken off at {frequency:g} Hz, which is too near to half the sampling rate"
        if _count_time_constants(frequency, self.duration) < _FEWEST:
            seconds = _FEWEST / _count_time_constants(frequency, 1.0)
            return (
                f"no tone is taken off at {frequency:g} Hz: a record of {self.duration:.4g} s does not tell a tone from a mode of"
                f" little damping there; {seconds:.3g} s would"
            )
        surely = np.log(_SEARCHED_RISK)
        limit = surely if is_automatic else np.log(_ASKED_RISK)
        phases = [evidence.phase for evidence, _ in self.taken]
        shared = [phase.multiple(ratio) for phase in phases for ratio in _ratios(frequency / phase.frequency)]
        tried = [*(self.evidence(phase) for phase in shared), *self.fits(frequency)]
        good = [
            part
            for part in tried
            if part.log_probability < (surely if part.phase.wanders else limit)
            and (not part.phase.wanders or part.kurtosis < _MOST_KURTOSIS)
        ]
        if not good:
            kurtosis = min(tried, key=lambda part: part.log_probability).kurtosis
            return (
                f"no tone stands out at {frequency:g} Hz, and nothing is taken off there: the motion is random (kurtosis"
                f" {kurtosis:.2f}; a tone has 1.5, a mode 3)"
            )
        self.take_off(max(good, key=lambda part: part.gain))
        return ""

    def remove_multiple(self, phase: _Phase) -> None:
        """Subtract a tone with exactly this `phase`, a multiple of another tone's, if the evidence for it is strong.

        Random motion must show as strong a line with a probability below 1e-6. Nothing is done near half the sampling
        rate or in a record of fewer than about 800 periods.
        """
        if not self.is_inside(phase.frequency) or _count_time_constants(phase.frequency, self.duration) < _FEWEST:
            return
        evidence = self.evidence(phase)
        if evidence.log_probability < np.log(_SEARCHED_RISK):
            self.take_off(evidence)

    def is_inside(self, frequency: float) -> bool:
        """True if a frequency (Hz) and its surroundings lie below half the sampling rate."""
        return (1 + 4 / _BLOCK) * frequency < self.rate / 2

    def evidence(self, phase: _Phase) -> _Evidence:
        """Evidence of a tone with exactly this phase, none of whose coefficients was fitted to the motion."""
        _, blocks = _demodulated(self.values, self.rate, phase)
        return _judge_blocks(blocks, phase, 0, _line_noise(blocks))

    def fits(self, frequency: float) -> list[_Evidence]:
        """Evidence of a steady tone near `frequency` (Hz), then of one whose frequency wanders about it, as a list.

        The frequency is searched for within 0.6 %. Where the record is too short for a spline, both are evidence of a
        steady tone.
        """
        start = _Phase(frequency, self.duration, np.zeros(0))
        time, blocks = _demodulated(self.values, self.rate, start)
        frequency += np.clip(_mean_frequency_offset(time, blocks), -_RANGE * frequency, _RANGE * frequency)
        start = replace(start, frequency=frequency)
        time, blocks = _demodulated(self.values, self.rate, start)
        noise = _line_noise(blocks)
        track = _tracked_phase(blocks / np.sqrt(noise))
        noise = np.minimum(noise, _line_noise(_turned(blocks, track)))
        offset = _strongest_line(time, blocks / np.sqrt(noise), _RANGE * frequency)
        steady = replace(start, frequency=frequency + offset)
        tried = [_judge_blocks(_turned(blocks, 2 * np.pi * offset * time), steady, 1, noise)]
        for n in _SPLINES:
            if n > len(time) / 2.5:
                break
            phase = _fitted_spline(time, blocks / np.sqrt(noise), track, _Phase(frequency, self.duration, np.zeros(n)))
            tried.append(_judge_blocks(_turned(blocks, phase.spline(time)), phase, n, noise))
        best = max(tried[1:], key=lambda part: part.gain, default=tried[0])
        line, wandering = (self.improved(rough, noise) for rough in (tried[0], best))
        while wandering.phase.wanders and wandering.log_probability < _DOUBTFUL:
            more = [n for n in _SPLINES if len(wandering.phase.coefficients) < n <= len(time) / 2.5]
            if not more:
                break
            finer = self.improved(replace(wandering, phase=wandering.phase.with_coefficients(more[0])), noise)
            if finer.gain <= wandering.gain:
                break
            wandering = finer
        return [line, wandering]

    def improved(self, rough: _Evidence, noise: FloatArray) -> _Evidence:
        """Evidence with its phase refined, or `rough` itself if noise is as strong with a probability above exp(-2).

        `noise` (n_channels,) is the power of a line of random motion.
        """
        if rough.log_probability > _DOUBTFUL:
            return rough
        phase = self.refined(rough.phase)
        _, blocks = _demodulated(self.values, self.rate, phase)
        return _judge_blocks(blocks, phase, max(1, len(phase.coefficients)), noise)

    def refined(self, phase: _Phase) -> _Phase:
        """The `phase` after two Gauss-Newton steps: spline coefficients if it wanders, else frequency.

        The motion is demodulated anew for each step.
        """
        for _ in range(2):
            time, blocks = _demodulated(self.values, self.rate, phase)
            error = _phase_error(time, blocks / np.sqrt(_line_noise(blocks)), phase)
            if phase.wanders:
                phase = replace(phase, coefficients=phase.coefficients + error)
            else:
                phase = replace(phase, frequency=phase.frequency + error[1] / (2 * np.pi))
        return phase

    def take_off(self, evidence: _Evidence) -> None:
        """Subtract a tone from all channels of `values`, and append its evidence and power (n_channels,) to `taken`.

        The power is the mean square of the tone in the unit of `values`. Its amplitudes are fitted by least squares, as
        polynomials of time and frequency whose degrees Schwarz's criterion chooses.
        """
        phase = evidence.phase
        degrees = _amplitude_degrees(self, phase)
        chunks = [slice(first, first + _CHUNK) for first in range(0, len(self.values), _CHUNK)]
        gram, cross = np.zeros(()), np.zeros(())
        for chunk in chunks:
            columns = _tone_columns(np.arange(*chunk.indices(len(self.values))) / self.rate, phase, degrees)
            gram, cross = gram + columns.T @ columns, cross + columns.T @ self.values[chunk]
        amplitudes = np.linalg.lstsq(gram, cross, rcond=1e-12)[0]
        power, values = np.zeros(self.values.shape[1]), np.empty_like(self.values)
        for chunk in chunks:
            motion = _tone_columns(np.arange(*chunk.indices(len(self.values))) / self.rate, phase, degrees) @ amplitudes
            power += (motion**2).sum(axis=0) / len(values)
            values[chunk] = self.values[chunk] - motion
        self.values = values
        self.taken.append((evidence, power))


def _count_time_constants(frequency: float, duration: float) -> float:
    """Number of time constants 1 / (zeta omega) in `duration` (s) of a mode at `frequency` (Hz) with very low damping."""
    return 2 * np.pi * frequency * duration * _LEAST_DAMPING


def _ratios(ratio: float) -> list[float]:
    """Ratios m / n, n up to 4 and m up to 12, near `ratio` (relatively within half of `_RANGE`) and other than 1, ascending."""
    near = {m / n for n in (1, 2, 3, 4) for m in range(1, 13) if m != n and abs(ratio * n / m - 1) < _RANGE / 2}
    return sorted(near)


def _demodulated(values: FloatArray, rate: float, phase: _Phase) -> tuple[FloatArray, ComplexArray]:
    """Times in s of blocks of 200 periods, (n_blocks,), and complex amplitudes relative to the phase, (n_blocks, n_channels).

    `values` is (n_times, n_channels), `rate` in Hz. Blocks overlap by three quarters under Hann windows.
    """
    n = len(values)
    hop = max(1, round(rate * _BLOCK / _QUARTERS / phase.frequency))
    n_hops = -(-n // hop)
    window = np.sin(np.pi * (np.arange(_QUARTERS * hop) + 0.5) / (_QUARTERS * hop)) ** 2
    parts = window.reshape(_QUARTERS, 1, hop)
    time = np.arange(n_hops * hop) / rate
    angle = phase.at(time).reshape(n_hops, hop)
    turning = np.concatenate([parts * np.cos(angle), -parts * np.sin(angle)]).transpose(1, 0, 2)
    padded = np.concatenate([values, np.zeros((n_hops * hop - n, values.shape[1]))]).reshape(n_hops, hop, -1)
    sums = turning @ padded  # (n_hops, 8, n_channels)
    inside = (np.arange(n_hops * hop) < n).reshape(n_hops, hop)
    weight = (parts * inside).sum(axis=2).T[:, :, None]
    moment = (parts * (inside * time.reshape(n_hops, hop))).sum(axis=2).T[:, :, None]
    mass = _sum_quarters(weight)
    total = _sum_quarters(sums[:, :_QUARTERS]) + 1j * _sum_quarters(sums[:, _QUARTERS:])
    return np.asarray((_sum_quarters(moment) / mass)[:, 0]), np.asarray(2 * total / mass)


def _sum_quarters(quarters: FloatArray) -> FloatArray:
    """Sum over each window, (n_hops + 1, n_columns), from sums over its quarters, with partial windows at the ends.

    `quarters` is (n_hops, 4, n_columns): sums of a hop as the first to fourth quarter of the windows that cover it.
    Window i covers the hops i - 2 to i + 1; those before the first and after the last count as 0.
    """
    n, half = len(quarters), _QUARTERS // 2
    ends = np.zeros((half, *quarters.shape[1:]))
    padded = np.concatenate([ends, quarters, ends])
    return np.asarray(sum(padded[j : j + n + 1, j] for j in range(_QUARTERS)))


def _turned(blocks: ComplexArray, angle: FloatArray) -> ComplexArray:
    """Blocks (n_blocks, n_channels) with their phase reduced by `angle` (n_blocks,), rad."""
    return np.asarray(blocks * np.exp(-1j * angle)[:, None])


def _line_noise(blocks: ComplexArray) -> FloatArray:
    """Power of a spectral line of random motion in each channel, (n_channels,), from the median of lines near the tone.

    `blocks` (n_blocks, n_channels) are the complex amplitudes of `_demodulated`.
    """
    n = len(blocks)
    power = np.abs(np.fft.fft(blocks, axis=0)) ** 2 / n
    reach = max(2, n // 4)
    around = np.concatenate([power[:reach], power[-reach:]]) if 2 * reach < n else power
    return np.asarray(np.maximum(np.median(around, axis=0) / np.log(2), 1e-13 * power.sum(axis=0) + 1e-300))


def _judge_blocks(blocks: ComplexArray, phase: _Phase, n_fitted: int, noise: FloatArray) -> _Evidence:
    """Evidence for a tone in demodulated `blocks` (n_blocks, n_channels), against a mode of 0.1 % damping or more.

    It holds `phase`, the natural logarithm of the probability that random motion shows as strong a line, the kurtosis
    (1.5 for a tone alone, 3 for random motion), and the log-likelihood that the tone adds, as mean over the channels,
    less what `n_fitted` coefficients of the phase cost. `noise` (n_channels,) is the power of a line of random motion.
    """
    n = len(blocks)
    lines = np.fft.fft(blocks / np.sqrt(noise), axis=0) / np.sqrt(n)
    power = (np.abs(lines) ** 2).sum(axis=1)
    reach = max(2, int(np.ceil(_count_time_constants(phase.frequency, phase.duration) / 4)), n_fitted)
    reach = min(reach, (n - 1) // 2)
    beside = np.r_[1 : reach + 1, n - reach : n]
    count = 1 + len(beside)
    odds = power[0] / max(power[beside].mean(), 1e-300) / _LORENTZ
    ratio = odds / (odds + count - 1)
    freedom = count - 1 - n_fitted
    log_probability = float(np.log(count) + freedom * np.log1p(-ratio)) if freedom > 0 else 0.0
    kept = np.zeros_like(lines)
    kept[0], kept[beside] = lines[0], lines[beside]
    vector = np.linalg.svd(kept[[0, *beside]], full_matrices=False)[2][0].conj()
    envelope = np.abs(np.fft.ifft(kept @ vector)) ** 2
    kurtosis = float(1.5 * np.mean(envelope**2) / max(np.mean(envelope) ** 2, 1e-300))
    gain = float(power[0] / blocks.shape[1] - n_fitted * np.log(2 * n))
    return _Evidence(phase, log_probability, kurtosis, gain)


def _mean_frequency_offset(time: FloatArray, blocks: ComplexArray) -> float:
    """Mean frequency in Hz of demodulated motion, relative to the frequency removed, from the phase change between blocks.

    `time` (n_blocks,) is in s, `blocks` (n_blocks, n_channels) are complex amplitudes.
    """
    blocks = blocks / np.sqrt(_line_noise(blocks))
    return float(np.angle(np.vdot(blocks[:-1], blocks[1:])) / (2 * np.pi * np.median(np.diff(time))))


def _strongest_line(time: FloatArray, blocks: ComplexArray, reach: float) -> float:
    """Offset in Hz, within `reach` of 0, of the line with most power in the spectrum of `blocks` (n_blocks, n_channels).

    `time` (n_blocks,) holds the times of the blocks in s.
    """
    size = 4 * len(blocks)
    offset = np.fft.fftfreq(size, float(np.median(np.diff(time))))
    power = (np.abs(np.fft.fft(blocks, size, axis=0)) ** 2).sum(axis=1)
    power[np.abs(offset) > reach] = -1
    return float(offset[power.argmax()])


def _tracked_phase(blocks: ComplexArray) -> FloatArray:
    """Phase in rad common to all channels, (n_blocks,), followed from block to block and smoothed over a few blocks.

    `blocks` (n_blocks, n_channels) are demodulated at the tone's frequency and scaled to unit noise in each channel.
    The phase is continuous, not within -pi to pi.
    """
    turn = (blocks[:-2].conj() * blocks[2:]).sum(axis=1)
    step = 0.5 * np.angle(_smoothed(turn))
    track = np.concatenate([[0.0], np.cumsum(np.concatenate([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]]))])
    slow = _turned(blocks, track)
    vector = np.linalg.svd(slow, full_matrices=False)[2][0].conj()
    return np.asarray(track + np.unwrap(np.angle(_smoothed(slow @ vector))))


def _smoothed(series: ComplexArray) -> ComplexArray:
    """The values `series` (n_blocks,) under a Gaussian with a standard deviation of 1.5 blocks, of the same shape."""
    weights = np.exp(-0.5 * (np.arange(-4, 5) / 1.5) ** 2)
    return np.convolve(np.pad(series, 4, mode="edge"), weights / weights.sum(), mode="valid")


def _knots(n: int, duration: float) -> FloatArray:
    """Knots of a cubic spline of `n` coefficients over the record."""
    return np.concatenate([np.zeros(3), np.linspace(0, duration, n - 2), np.full(3, duration)])


def _basis(time: FloatArray, phase: _Phase) -> FloatArray:
    """Derivatives of the phase with respect to its parameters at `time` in s, (n_times, n_parameters).

    Parameters are the spline's coefficients, or for a steady tone the constant phase and the angular frequency.
    """
    if not phase.wanders:
        return np.stack([np.ones(len(time)), time], axis=1)
    from scipy.interpolate import BSpline

    knots = _knots(len(phase.coefficients), phase.duration)
    return np.asarray(BSpline.design_matrix(np.clip(time, 0, phase.duration), knots, 3).toarray())


def _phase_error(time: FloatArray, blocks: ComplexArray, phase: _Phase) -> FloatArray:
    """Gauss-Newton step of the parameters of `_basis`, (n_parameters,), from blocks whose phase was removed.

    `time` (n_blocks,) is in s; `blocks` (n_blocks, n_channels) are scaled to unit noise.
    """
    mean = blocks.mean(axis=0)
    motion = blocks @ mean.conj() / max(np.vdot(mean, mean).real, 1e-300)
    return np.asarray(np.linalg.lstsq(_basis(time, phase), motion.imag, rcond=None)[0])


def _fitted_spline(time: FloatArray, blocks: ComplexArray, track: FloatArray, phase: _Phase) -> _Phase:
    """The phase with spline coefficients fitted to `track`, then improved by three Gauss-Newton steps on the blocks.

    `track` (n_blocks,) is a phase in rad at `time` in s; `blocks` (n_blocks, n_channels) are scaled to unit noise.
    """
    phase = replace(phase, coefficients=np.linalg.lstsq(_basis(time, phase), track, rcond=None)[0])
    for _ in range(3):
        error = _phase_error(time, _turned(blocks, phase.spline(time)), phase)
        phase = replace(phase, coefficients=phase.coefficients + np.clip(error, -1, 1))
    return phase


def _amplitude_columns(time: FloatArray, phase: _Phase, degrees: tuple[int, int]) -> FloatArray:
    """Terms by which a tone's amplitude may change, (n_times, n_terms), at `time` (n_times,) in s.

    They are Legendre polynomials of time and of the tone's frequency, with `degrees` in this order. From degree 2 in
    frequency on, terms with its rate of change are added, since a structure answers with a delay. `phase` is that of
    the tone.
    """
    columns = np.polynomial.legendre.legvander(2 * time / phase.duration - 1, degrees[0])
    if not degrees[1]:
        return np.asarray(columns)
    course = phase.course(np.linspace(0, phase.duration, 512))
    middle, half = 0.5 * (course.max() + course.min()), 0.5 * (course.max() - course.min())
    away = (phase.course(time) - middle) / max(half, 1e-300)
    of_frequency = np.polynomial.legendre.legvander(away, degrees[1])
    rate = phase.spline(time, 2)[:, None]
    rate /= max(float(np.abs(phase.spline(np.linspace(0, phase.duration, 512), 2)).max()), 1e-300)
    return np.concatenate([columns, of_frequency[:, 1:], rate * of_frequency[:, : degrees[1] - 1]], axis=1)


def _tone_columns(time: FloatArray, phase: _Phase, degrees: tuple[int, int]) -> FloatArray:
    """Cosines of the phase times each polynomial of the amplitude, then sines so, (n_samples, n_columns).

    `time` (n_samples,) is in s; `degrees` are those of the polynomials in time and in frequency, see `_amplitude_degrees`.
    """
    angle, terms = phase.at(time)[:, None], _amplitude_columns(time, phase, degrees)
    return np.concatenate([np.cos(angle) * terms, np.sin(angle) * terms], axis=1)


def _amplitude_degrees(search: _Search, phase: _Phase) -> tuple[int, int]:
    """Degrees in time and in frequency of the amplitude's polynomials, for a tone with this `phase` in the motion of `search`.

    They have the best value of Schwarz's criterion; the second is 0 for a steady tone.
    """
    time, blocks = _demodulated(search.values, search.rate, phase)
    blocks = blocks / np.sqrt(_line_noise(blocks))
    of_frequency = (0, 1, 2, 3) if phase.wanders else (0,)
    best, most = (0, 0), -np.inf
    for in_time in (0, *_DEGREES):
        for in_frequency in of_frequency:
            terms = _amplitude_columns(time, phase, (in_time, in_frequency))
            if terms.shape[1] > len(time) / 6 and in_time + in_frequency:
                continue
            captured = float((np.abs(np.linalg.qr(terms)[0].T @ blocks) ** 2).sum()) / blocks.shape[1]
            gain = captured - terms.shape[1] * np.log(2 * len(time))
            if gain > most:
                best, most = (in_time, in_frequency), gain
    return best


def _tone_candidates(values: FloatArray, rate: float) -> list[float]:
    """Frequencies in Hz where a tone may be, the most prominent first; at most 40, over 0.6 % apart.

    They are lines 12 times above their surroundings, and narrow bands of steady motion, in `values` (n_times,
    n_channels) at `rate` in Hz.
    """
    lines, height = _whitened_lines(values, rate)
    tops = 1 + np.flatnonzero(
        (height[1:-1] > _STANDS_OUT) & (height[1:-1] >= height[:-2]) & (height[1:-1] > height[2:])
    )
    peaks = [(float(height[k]), float(lines[k])) for k in tops]
    chosen: list[float] = []
    for _, frequency in sorted([*peaks, *_steady_bands(values, rate)], reverse=True):
        if all(abs(frequency / other - 1) > _RANGE for other in chosen):
            chosen.append(frequency)
    return chosen[:_MOST_TONES]


def _whitened_lines(values: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies of the spectral lines in Hz, and their power relative to the lines around, (n_lines,) each.

    The power is averaged over the channels of `values` (n_times, n_channels), sampled at `rate` in Hz.
    """
    n = len(values)
    window = np.sin(np.pi * np.arange(n) / n) ** 2
    total = np.zeros(n // 2 + 1)
    for column in values.T:
        power = np.abs(np.fft.rfft(window * (column - column.mean()))) ** 2
        total += _over_surroundings(power)
    return np.fft.rfftfreq(n, 1 / rate), total / values.shape[1]


def _over_surroundings(power: FloatArray) -> FloatArray:
    """Power of each line over the median power of the lines around it, (n_lines,).

    Medians are those of blocks of neighbouring lines; the greatest of a line's block and both neighbours counts.
    """
    n = len(power)
    blocks = np.pad(power, (0, -n % _MEDIAN_LINES), mode="edge").reshape(-1, _MEDIAN_LINES)
    level = np.pad(np.median(blocks, axis=1), 1, mode="edge")
    level = np.maximum(np.maximum(level[:-2], level[1:-1]), level[2:])
    return np.asarray(power / np.maximum(np.repeat(level, _MEDIAN_LINES)[:n], 1e-300))


def _steady_bands(values: FloatArray, rate: float) -> list[tuple[float, float]]:
    """Height and frequency in Hz of each spectral peak whose power hardly changes from segment to segment.

    Heights are over the median of the lines around, 2 or more; the power of three lines has a kurtosis below 1.75.
    Segments have some 300 periods of the highest frequency of each octave. `values` is (n_times, n_channels), `rate` in
    Hz.
    """
    n, peaks = len(values), []
    top = rate / 2
    while _count_time_constants(top, n / rate) > _FEWEST:
        segment = round(1.5 * _BLOCK * rate / top)
        starts = range(0, n - segment + 1, segment // 2)
        if len(starts) < _LEAST_SEGMENTS:
            break  # longer segments are fewer still
        window = np.sin(np.pi * np.arange(segment) / segment) ** 2
        power = np.stack(
            [np.abs(np.fft.rfft(window[:, None] * values[k : k + segment], axis=0)) ** 2 for k in starts]
        )  # (n_segments, n_lines, n_channels)
        lines = np.fft.rfftfreq(segment, 1 / rate)
        level = power.mean(axis=0)
        height = np.stack([_over_surroundings(column) for column in level.T]).mean(axis=0)
        series = (power / np.maximum(level.mean(axis=0), 1e-300)).sum(axis=2)
        for k in np.flatnonzero((lines[:-2] >= top / 2) & (lines[:-2] < top)):
            if height[k] < max(_PEAK, height[k - 1], height[k + 1]):
                continue
            course = series[:, k - 1 : k + 2].sum(axis=1)
            if 1.5 * np.mean(course**2) / np.mean(course) ** 2 < _MOST_KURTOSIS:
                peaks.append((float(height[k]), float(lines[k])))
        top /= 2
    return peaks

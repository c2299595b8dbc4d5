"""Peaks of the singular spectra of ambient motion, the band of each, and how many modes a band holds.

Peaks are chosen by what the averaging of the spectrum allows to tell: K averages leave every line with a relative
standard deviation of K^(-1/2), and the greatest of n such errors in the logarithm is about sqrt(2 ln n / K). A peak
must rise above the higher of the valleys beside it by twice as much (a crest of errors over a trough of errors), and
the singular vectors of the lines next to it must resemble its own (modal coherence of 0.8 on one side at least,
after Brincker, Andersen and Jacobsen 2007, Automated frequency domain decomposition, Proc. 25th IMAC).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.errors import InputError, NoModesError
from structid.modal.correlations import ScaledMotion
from structid.modal.method import ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord

#: Modal coherence that a peak must have.
COHERENCE = 0.8
_DEPTH = np.log(30.0)  # a band ends where the first singular value is down by 30: 5.4 half-power half-widths
_TOP = np.log(5.0)  # two half-power half-widths
_MERGE = np.log(10.0)  # two peaks with a valley less deep than 10 share one band
_AVERAGES = 40
_PROMINENCE = 1.0  # decades of power by which a peak without a mode stands out


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Singular values and vectors of the spectral matrix of the channels.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    values : (n_lines, n_channels) float array
        Singular values, greatest first, 1/Hz.
    vectors : (n_lines, n_channels, n_channels) complex array
        Singular vectors in the columns.
    averages : float
        Independent averages behind each line.
    segment : int
        Samples of a segment.
    matrix : (n_lines, n_channels, n_references) complex array
        What the singular values are of; empty where it was not kept.
    """

    frequency: FloatArray
    values: FloatArray
    vectors: ComplexArray
    averages: float
    segment: int
    matrix: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), complex))

    @property
    def spacing(self) -> float:
        """Distance of the lines, Hz."""
        return float(self.frequency[1] - self.frequency[0])

    @property
    def error(self) -> float:
        """Greatest error expected over all lines in the natural logarithm of a line, sqrt(2 ln n_lines / averages)."""
        return float(np.sqrt(2 * np.log(len(self.frequency)) / self.averages))


@dataclass(frozen=True)
class Band:
    """A range of frequencies from `low` to `high` (Hz), and frequencies `peaks` (Hz) where its modes may be, one for each."""

    low: float
    high: float
    peaks: tuple[float, ...]

    @property
    def n_modes(self) -> int:
        return len(self.peaks)


def centred(data: ScaledMotion) -> ScaledMotion:
    """`data` without the mean of each record, which would leak into the low lines."""
    return replace(data, series=tuple(y - y.mean(axis=0) for y in data.series))


def hann(segment: int) -> FloatArray:
    """Periodic Hann window, (segment,)."""
    return np.asarray(np.sin(np.pi * np.arange(segment) / segment) ** 2)


def segments(data: ScaledMotion, segment: int) -> Iterator[FloatArray]:
    """Half-overlapping segments of `segment` samples, one record after another, (segment, n_channels) each.

    Samples at the end of a record that fill no segment are left out.

    Raises
    ------
    InputError
        If `segment` is below 8 or longer than the shortest record.
    """
    shortest = min(len(y) for y in data.series)
    if not 8 <= segment <= shortest:
        raise InputError(
            f"`segment` must lie from 8 to {shortest}, the samples of the shortest record, got {segment}; shorten it"
        )
    for y in data.series:
        for start in range(0, len(y) - segment + 1, segment // 2):
            yield y[start : start + segment]


def default_segment(data: ScaledMotion) -> int:
    """Number of samples in a segment: a power of two that leaves about 40 half-overlapping segments of all records, at least 8.

    It is not longer than the shortest record, unless that has fewer than 8 samples.
    """
    total, shortest = sum(len(y) for y in data.series), min(len(y) for y in data.series)
    return int(2 ** max(3, np.floor(np.log2(max(min(2 * total / (_AVERAGES + 1), shortest), 8)))))


def singular_spectrum(data: ScaledMotion, segment: int) -> Spectrum:
    """Singular value decomposition of the Welch spectral matrix of `data` at every line, Hann windows half overlapping.

    `segment` is the number of samples in a segment. The result has frequencies (Hz) from 0 to half the sampling rate,
    singular values (n_lines, n_channels) in 1/Hz (channels have a mean square of 1), greatest first, vectors in the
    columns of (n_lines, n_channels, n_channels), and the number of independent averages. The mean of each record is
    removed; `matrix` is empty.

    Raises
    ------
    InputError
        If `segment` is below 8 or longer than the shortest record.
    """
    data = centred(data)
    window = hann(segment)
    total, count = np.zeros((segment // 2 + 1, data.n_channels, data.n_channels), dtype=complex), 0
    for stretch in segments(data, segment):
        lines = np.fft.rfft(window[:, None] * stretch, axis=0)
        total += lines[:, :, None] * lines[:, None, :].conj()
        count += 1
    vectors, values, _ = np.linalg.svd(2 * total / (count * data.sampling_rate * np.sum(window**2)))
    frequency = np.fft.rfftfreq(segment, 1 / data.sampling_rate)
    overlap = np.sum(window[: -(segment // 2)] * window[segment // 2 :]) / np.sum(window**2)
    averages = count / (1 + 2 * overlap**2 * (count - 1) / count)  # Welch (1967), IEEE Trans. AU-15
    return Spectrum(frequency, values, vectors, float(averages), segment)


def coherence(spectrum: Spectrum, line: int) -> float:
    """Modal coherence (0 to 1) of the line with index `line`: mean MAC of the first singular vector with two lines'.

    The two lines before and the two after are tried, and the greater mean is taken, since the vector turns quickly
    between the peaks of close modes.
    """
    sides = []
    for near in ([line - 2, line - 1], [line + 1, line + 2]):
        kept = [k for k in near if 0 <= k < len(spectrum.frequency)]
        if kept:
            sides.append(np.mean(np.abs(spectrum.vectors[kept, :, 0].conj() @ spectrum.vectors[line, :, 0]) ** 2))
    return float(max(sides))


def automatic_peaks(spectrum: Spectrum, level: int = 0) -> IntArray:
    """Line indices (n_peaks,) of significant peaks of a singular value, lowest first, without two lines at either end.

    A peak is significant if it rises above the higher of the valleys beside it by twice the greatest error that is
    expected over all lines (`spectrum.error`, in the natural logarithm).

    Parameters
    ----------
    spectrum : Spectrum
    level : int
        Index of the singular value, 0 for the greatest. Only its peaks need a modal coherence of 0.8, since vectors of
        the second turn at a crossing.
    """
    from scipy.signal import find_peaks

    logs = np.log(np.maximum(spectrum.values[:, level], 1e-300))
    inner = logs[2:-2]  # lines where the window sees the mean, or the mirror image
    found = 2 + find_peaks(inner, prominence=2 * spectrum.error)[0]
    if level == 0:
        found = found[[coherence(spectrum, int(k)) >= COHERENCE for k in found]] if len(found) else found
    return np.asarray(found, dtype=int)


def peaks_by_hand(spectrum: Spectrum, frequencies: Sequence[float]) -> IntArray:
    """Line index of the highest peak of the first singular value near each of `frequencies` (Hz), lowest first.

    Near is within two lines or 2 %, whichever is more. The result is (n_peaks,), increasing.

    Raises
    ------
    InputError
        If a frequency lies outside the spectrum, near no peak, or two of them lead to one peak.
    """
    lines, first = spectrum.frequency, spectrum.values[:, 0]
    wanted = np.asarray(frequencies, dtype=float)
    if not len(wanted) or (wanted <= lines[0]).any() or (wanted >= lines[-1]).any():
        raise InputError(f"`frequencies` must lie between {lines[0]:g} and {lines[-1]:g} Hz, got {list(frequencies)}")
    peaks = 1 + np.flatnonzero((first[1:-1] >= first[:-2]) & (first[1:-1] > first[2:]))
    chosen = []
    for f in wanted:
        near = peaks[np.abs(lines[peaks] - f) <= max(2 * spectrum.spacing, 0.02 * f)]
        if not len(near):
            words = "it has no peak"
            if len(peaks):
                words = f"the nearest peak is at {lines[peaks[np.abs(lines[peaks] - f).argmin()]]:.4g} Hz"
            raise InputError(
                f"`frequencies` must be near peaks of the first singular value, got {f:g} Hz; {words}. Look at the singular"
                " values"
            )
        chosen.append(int(near[first[near].argmax()]))
    if len(set(chosen)) < len(chosen):
        raise InputError("`frequencies` must belong to different peaks; lengthen `segment`, or leave one out")
    return np.array(sorted(chosen), dtype=int)


def chosen_peaks(data: ScaledMotion, options: ModalOptions) -> tuple[Spectrum, IntArray]:
    """Singular spectrum of the records, and line indices of its peaks within the criteria, lowest first.

    Peaks are those near `options.frequencies`, or automatic ones.

    Raises
    ------
    InputError
        As `peaks_by_hand` does.
    NoModesError
        If no peak stands out.
    """
    spectrum = singular_spectrum(data, options.segment or default_segment(data))
    return spectrum, peaks_within(spectrum, options)


def stored_spectrum(record: SpectrumRecord | CorrelationRecord) -> tuple[ScaledMotion, Spectrum]:
    """Channels of a record of spectra (`ScaledMotion` without samples), scaled to equal power, and its singular spectrum.

    Where the references are not all channels, the singular vectors on the side of the channels are taken. Correlation functions
    are transformed under a Hann window of twice their length: with the lags before 0 where the references are all channels,
    else from lag 0 on alone.

    Raises
    ------
    InputError
        If the spectra of a channel are 0.
    """
    frequency, matrix = _stored_lines(record)
    power = np.sqrt((np.abs(matrix) ** 2).sum(axis=0))
    of_channel, of_reference = np.sqrt(power.max(axis=1)), np.sqrt(power.max(axis=0))
    if not (of_channel > 0).all():
        dead = record.channels[int(np.argmin(of_channel))]
        words = "spectra" if isinstance(record, SpectrumRecord) else "correlation functions"
        raise InputError(f"the {words} of channel {dead} are 0; leave this channel out, or repair the sensor")
    matrix = matrix / (of_channel[:, None] * of_reference)
    vectors, values, _ = np.linalg.svd(matrix, full_matrices=False)
    data = ScaledMotion((), of_channel, record.channels, record.quantities, np.inf)
    averages = np.nan if record.averages is None else float(record.averages)
    return data, Spectrum(frequency, values, vectors, averages, 0, matrix)


def _stored_lines(record: SpectrumRecord | CorrelationRecord) -> tuple[FloatArray, ComplexArray]:
    """Frequencies (Hz) and spectral matrices (n_lines, n_channels, n_references) of stored spectra or correlations.

    Spectra are returned as they are. Correlation functions are transformed under a Hann window of twice their length:
    with the lags before 0 where the references are all channels, else from lag 0 on alone; these matrices are not
    scaled to 1/Hz.
    """
    if isinstance(record, SpectrumRecord):
        return record.frequency, record.values
    n = len(record.values)
    window = np.cos(0.5 * np.pi * np.arange(n) / n) ** 2
    window[0] = 0.5
    lines = np.fft.rfft(record.values * window[:, None, None], 2 * n, axis=0)
    if set(record.references) == set(record.channels):  # lags before 0 are those of the reverse pairs
        order = [record.references.index(dof) for dof in record.channels]
        both = lines[:, :, order] + lines[:, :, order].conj().transpose(0, 2, 1)
        lines = both[:, :, np.argsort(order)]
    return np.fft.rfftfreq(2 * n, 1 / record.sampling_rate), lines


def peaks_within(spectrum: Spectrum, options: ModalOptions) -> IntArray:
    """Line indices (n_peaks,) of the peaks within the frequency limits of `options.criteria`, lowest first.

    They are the highest peaks near each of `options.frequencies` or, without these, all significant ones.

    Raises
    ------
    InputError
        If a frequency lies outside the spectrum, near no peak, or two of them lead to one peak; or if neither
        frequencies nor the number of averages are known.
    NoModesError
        If no peak is left.
    """
    by_hand = options.frequencies is not None
    if not by_hand and not np.isfinite(spectrum.averages):
        raise InputError(
            "`averages` must say how many averages are behind stored spectra, so that peaks can be told from errors, or"
            " `frequencies` where the peaks are; their file says neither",
            "averages",
        )
    lines = (
        peaks_by_hand(spectrum, options.frequencies) if options.frequencies is not None else automatic_peaks(spectrum)
    )
    low, high = options.criteria.frequency
    lines = lines[(spectrum.frequency[lines] >= low) & (spectrum.frequency[lines] <= high)]
    if not len(lines):
        raise NoModesError(
            "`records` show no peak of the first singular value that stands out of its errors and meets `criteria`; give "
            "`bands` or `frequencies`, or measure longer"
        )
    return lines


def peak_range(spectrum: Spectrum, line: int, others: Sequence[int] = ()) -> tuple[int, int]:
    """First and last line index of the frequency band of the peak at line index `line`.

    The band ends where the first singular value is down by a factor of 30, or at the errors of the background, or in
    the valley before another peak (`others`, line indices), or at three times the distance at which the steeper flank
    is down by a factor of 5 (six half-power half-widths). It has three lines on either side at least, the window's own
    width, without the first and last line of the spectrum.
    """
    logs = np.log(np.maximum(spectrum.values[:, 0], 1e-300))
    lower = max([0, *(k for k in others if k < line)])
    upper = min([len(logs) - 1, *(k for k in others if k > line)])
    before, after = logs[lower : line + 1], logs[line : upper + 1]
    floor = logs[line] - min(_DEPTH, float(logs[line] - max(before.min(), after.min())) - spectrum.error)
    below = np.flatnonzero(before[::-1] < floor)
    above = np.flatnonzero(after < floor)
    left = int(below[0]) if len(below) else len(before) - 1 - int(before.argmin())
    right = int(above[0]) if len(above) else int(after.argmin())
    top = [np.flatnonzero(side < logs[line] - _TOP) for side in (before[::-1], after)]
    widest = max(3, 3 * min((int(side[0]) for side in top if len(side)), default=max(left, right)))
    left, right = (min(max(width, 3), widest) for width in (left, right))
    return max(line - left, 1), min(line + right, len(logs) - 2)


def valley(spectrum: Spectrum, first: int, second: int) -> float:
    """Depth of the valley between peaks at line indices `first` < `second` below the lower peak, in natural logarithms."""
    logs = np.log(np.maximum(spectrum.values[first : second + 1, 0], 1e-300))
    return float(min(logs[0], logs[-1]) - logs.min())


def automatic_bands(spectrum: Spectrum, peaks: Sequence[int]) -> tuple[Band, ...]:
    """Frequency bands around spectral peaks (line indices), with the frequencies (Hz) of their modes, by frequency.

    Touching bands with a valley less deep than a factor of 10 are merged; () without peaks. The valley is that of the
    first singular value of `spectrum`.
    """
    lines = sorted(int(k) for k in peaks)
    ends = {k: peak_range(spectrum, k, [other for other in lines if other != k]) for k in lines}
    groups: list[list[int]] = []
    for k in lines:
        before = groups[-1][-1] if groups else k
        if groups and ends[before][1] >= ends[k][0] - 1 and valley(spectrum, before, k) < _MERGE:
            groups[-1].append(k)
        else:
            groups.append([k])
    bands = []
    for group in groups:
        low = float(spectrum.frequency[min(ends[k][0] for k in group)])
        high = float(spectrum.frequency[max(ends[k][1] for k in group)])
        bands.append(Band(low, high, mode_places(spectrum, low, high, group)))
    return tuple(bands)


def mode_places(spectrum: Spectrum, low: float, high: float, peaks: Sequence[int]) -> tuple[float, ...]:
    """Frequencies (Hz), sorted, where modes of a band may lie: peaks of the first singular value, crests of the second.

    Between two peaks of different shape the second singular value has one crest, where the modes change places. Modes
    that coincide show one peak and one crest. So there are as many modes as peaks, or one more than crests. Crests
    count only where the first singular value is above a fifth of that at the nearest peak, since lower ones lie in
    valleys between separate modes. `low` and `high` are the ends of the band, Hz, `peaks` the line indices of peaks. ()
    without a peak.
    """
    frequency = spectrum.frequency
    inside = [int(k) for k in peaks if low <= frequency[k] <= high]
    places = [float(frequency[k]) for k in inside]
    if spectrum.values.shape[1] > 1 and inside:
        first = spectrum.values[:, 0]
        crests = [
            int(k)
            for k in automatic_peaks(spectrum, 1)
            if low <= frequency[k] <= high
            and first[k] * np.exp(_TOP) > first[min(inside, key=lambda peak: abs(peak - int(k)))]
        ]
        crests.sort(key=lambda k: -spectrum.values[k, 1])
        missing = 1 + len(crests) - len(inside)
        places += [float(frequency[k]) for k in crests[: max(missing, 0)]]
    return tuple(sorted(places))


def unexplained_peaks(frequency: FloatArray, level: FloatArray, modes: ModalRecord) -> FloatArray:
    """Frequencies (Hz) of peaks that stand out by 10 dB or more and lie at none of `modes`, rising.

    Peaks are those of the logarithm of `level`, averaged over three lines; they stand out of the higher valley beside
    them.

    Parameters
    ----------
    frequency : (n_lines,) float array
        Hz.
    level : (n_lines,) float array
        First singular value of a spectral matrix, or of an FRF matrix squared.
    modes : ModalRecord
        A mode explains peaks within two half-power bandwidths, or three lines, of it.
    """
    from scipy.signal import find_peaks

    power = np.log10(np.maximum(level, 1e-300))
    smooth = np.convolve(np.pad(power, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    places, _ = find_peaks(smooth, prominence=_PROMINENCE)
    peaks = frequency[places]
    line = float(np.median(np.diff(frequency))) if len(frequency) > 1 else 0.0
    width = np.maximum(4 * np.nan_to_num(np.abs(modes.damping_ratio)) * modes.frequency, 3 * line)
    return np.asarray(peaks[(np.abs(peaks[:, None] - modes.frequency) > width).all(axis=1)])

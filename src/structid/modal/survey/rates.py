"""Modes far below the sampling rate: further looks at the decimated record, and all looks as one answer.

A block Hankel matrix of few delays at a high rate spans less than a period of a low mode, which it then hardly sees;
decimated, the same delays span it several times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray
from structid.modal.correlations import outputs
from structid.modal.method import ModalIdentification, by_rising_frequency
from structid.modal.modal_record import ModalRecord
from structid.modal.modal_record import joined as joined_modes
from structid.modal.poles.stabilization import LIKELY
from structid.modal.spectral.peaks import singular_spectrum
from structid.records import TimeRecord
from structid.similarity import mac

_FEW_SAMPLES = 20  # a period of a mode that the record shows and the model at its own rate hardly does
_SAMPLES = 12  # a period of the lowest mode after decimation, at least
_LEAST, _SEGMENTS = 2000, 8
_DECADES = 1.0  # by which a peak of the spectrum must stand out
_SPLIT = (0.30, 0.38)  # parts of the lower rate between which the two looks are joined
#: Part of the lower rate up to which the filter of the decimation is flat, and factor from one look to the next.
FLAT, _STEP = 0.4, 3.0
_ONE_SHAPE = 0.8  # MAC from which on two looks see one mode
_OF_TWO = "come from the record at two sampling rates"


def lower_rate(record: TimeRecord) -> float | None:
    """Lower sampling rate (Hz) that suits the lowest spectral peak; None if the record's own rate suits it.

    A peak counts if it stands out by a factor of 10 and has more than 20 samples per period. The new rate leaves 12
    samples or more per period of the lowest such peak, and at least about 2000 samples in all.
    """
    from scipy.signal import find_peaks

    n = len(record.values)
    segment = min(4096, 2 ** int(np.log2(max(n // _SEGMENTS, 8))))
    spectrum = singular_spectrum(outputs(record), segment)
    frequency, level = spectrum.frequency, np.log10(np.maximum(spectrum.values[:, 0], 1e-300))
    smooth = np.convolve(np.pad(level, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    peaks, _ = find_peaks(smooth, prominence=_DECADES)
    low = [frequency[i] for i in peaks if i >= 3 and frequency[i] < record.sampling_rate / _FEW_SAMPLES]
    if not low:
        return None
    factor = min(int(record.sampling_rate / (_SAMPLES * low[0])), n // _LEAST)
    return record.sampling_rate / factor if factor > 1 else None


def join_frequency(low: ModalRecord, high: ModalRecord, rate: float) -> float:
    """Frequency (Hz) at which to join a low-rate and a high-rate analysis, as far as possible from modes of both.

    It lies between 0.30 and 0.38 of `rate` (Hz), the lower sampling rate; at 0.30 if neither has modes.
    """
    places = np.linspace(*_SPLIT, 41) * rate
    modes = np.concatenate([low.frequency, high.frequency])
    if not len(modes):
        return float(places[0])
    return float(places[np.abs(places[:, None] - modes).min(axis=1).argmax()])


def look_rates(record: TimeRecord) -> tuple[float, ...]:
    """Additional sampling rates (Hz), decreasing, for analysing a record; () if its own rate suffices.

    The last leaves about 12 samples per period of the lowest spectral peak; each is about a third of the rate before.
    """
    lowest = lower_rate(record)
    if lowest is None:
        return ()
    factor = round(record.sampling_rate / lowest)
    steps = max(1, round(np.log(factor) / np.log(_STEP)))
    factors = sorted({round(factor ** ((k + 1) / steps)) for k in range(steps)})
    return tuple(record.sampling_rate / own for own in factors if own > 1)


def joined(
    low: ModalIdentification, high: ModalIdentification, frequency: float, greatest: float = np.inf
) -> ModalIdentification:
    """Modes of two analyses by rising frequency: of `low` below `frequency` (Hz) and of `high` from there on.

    Of a mode that both have, the one with the smaller standard deviation of frequency is taken; if these are equal or
    unknown, or the mode of `low` lies above `greatest`, its frequency there decides. A mode that only the other
    analysis has is taken as well where it is likely to be a mode (`mode_probability`) and, in `low`, lies below
    `greatest`.

    Parameters
    ----------
    low, high : ModalIdentification
        Of the decimated record, and of the record at a higher rate.
    frequency : float
        Hz.
    greatest : float
        Hz, from which on `low` is distorted by the filter of the decimation.

    Returns
    -------
    ModalIdentification
        The covariance between the two is left out: it is 0 in the result, and a warning says so.
    """
    take_low, take_high = low.modes.frequency < frequency, high.modes.frequency >= frequency
    for i, j in _same_modes(low.modes, high.modes):
        std = (part.frequency_std[k] for part, k in ((low.modes, i), (high.modes, j)))
        low_std, high_std = (float(np.nan_to_num(value, nan=np.inf)) for value in std)
        if low_std != high_std and low.modes.frequency[i] < greatest:
            take_low[i], take_high[j] = low_std < high_std, high_std < low_std
        else:
            take_low[i], take_high[j] = low.modes.frequency[i] < frequency, low.modes.frequency[i] >= frequency
    take_low |= _likely_alone(low, high.modes, take_high) & (low.modes.frequency < greatest)
    take_high |= _likely_alone(high, low.modes, take_low)
    spans = _frequency_spans(low, take_low), _frequency_spans(high, take_high)
    low, high = (
        _limited(low, take_low, 0.0, frequency, spans[1]),
        _limited(high, take_high, frequency, np.inf, spans[0]),
    )
    parts = [found.modes for found in (low, high)]
    warnings = [*dict.fromkeys(words for part in parts if part.n_modes for words in part.warnings)]
    if all(part.n_modes and part.covariance is not None for part in parts) and not any(map(_is_of_two, warnings)):
        warnings.append(
            f"modes below and above {frequency:.4g} Hz {_OF_TWO}: how their errors"
            " move together is left out; give a sampling rate (--rate) to look once"
        )
    source = f"below {frequency:.4g} Hz: {low.modes.source}; above: {high.modes.source}"
    later = [replace(cluster, number=cluster.number + len(low.sweep)) for cluster in high.clusters]
    order = np.argsort(np.concatenate([part.frequency for part in parts]), kind="stable").tolist()
    clusters = [*low.clusters, *later]
    return replace(
        high,
        modes=joined_modes(parts, warnings, source),
        sweep=(*low.sweep, *high.sweep),
        clusters=tuple(clusters[i] for i in order) if len(clusters) == len(order) else (),
        left_out=by_rising_frequency((*low.left_out, *high.left_out)),
        is_free_decay=low.is_free_decay or high.is_free_decay,
    )


def _is_of_two(words: str) -> bool:
    return _OF_TWO in words


def _same_modes(low: ModalRecord, high: ModalRecord) -> list[tuple[int, int]]:
    """Index pairs (in `low`, in `high`) of modes that both have: mutually nearest in frequency, MAC 0.8 or more.

    Frequencies may differ by three standard deviations of the difference or zeta f of the mode of `low`, whichever is
    larger; unknown ones count as 0. [] if an analysis has no mode.
    """
    if not (low.n_modes and high.n_modes):
        return []
    gap = np.abs(low.frequency[:, None] - high.frequency)
    variance = np.nan_to_num(low.frequency_std)[:, None] ** 2 + np.nan_to_num(high.frequency_std) ** 2
    width = np.maximum(3 * np.sqrt(variance), (np.nan_to_num(low.damping_ratio) * low.frequency)[:, None])
    away = np.where((gap <= width) & (mac(low.mode_shapes, high.mode_shapes) >= _ONE_SHAPE), gap, np.inf)
    pairs = ((int(i), int(away[i].argmin())) for i in range(low.n_modes) if np.isfinite(away[i]).any())
    return [(i, j) for i, j in pairs if away[:, j].argmin() == i]


def _likely_alone(
    identification: ModalIdentification, other: ModalRecord, taken: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Mask (n_modes,) of the likely modes of `identification` that the `other` analysis does not have.

    Likely is a probability of at least 0.8. `taken` is a mask over the modes of `other`; a mode within its half-power
    bandwidth plus three standard deviations of one of these in frequency is not alone.
    """
    modes = identification.modes
    gap = np.abs(modes.frequency[:, None] - other.frequency[taken])
    width = 2 * np.nan_to_num(modes.damping_ratio) * modes.frequency + 3 * np.nan_to_num(modes.frequency_std)
    return np.asarray((identification.probability >= LIKELY) & ~(gap <= width[:, None]).any(axis=1))


def _frequency_spans(identification: ModalIdentification, taken: NDArray[np.bool_]) -> FloatArray:
    """Frequency spans (Hz), lower and upper end, (n_taken, 2), of the modes in the mask `taken` (n_modes,).

    A span reaches from the lowest to the highest pole of the mode of `identification`, or lies at the mode where there
    are no clusters, and goes on by half its half-power bandwidth on either side.
    """
    modes = identification.modes
    width = np.nan_to_num(modes.damping_ratio) * modes.frequency
    spans = np.stack([modes.frequency, modes.frequency], axis=1)
    if len(identification.clusters) == modes.n_modes:
        spans = np.array([(c.frequency.min(), c.frequency.max()) for c in identification.clusters]).reshape(-1, 2)
    return np.asarray((spans + np.multiply.outer(np.abs(width), [-1.0, 1.0]))[taken])


def _limited(
    identification: ModalIdentification, keep_mode: NDArray[np.bool_], least: float, greatest: float, others: FloatArray
) -> ModalIdentification:
    """Identification with the modes marked in `keep_mode` (n_modes,), and other poles from `least` to below `greatest`.

    Both are in Hz. Poles that belong to a kept mode stay in `sweep` wherever they lie; indices in clusters follow.
    Other poles within `others` (n_others, 2), the frequency spans (Hz) of modes that the other analysis gives, are left
    out. Of `left_out` those between `least` and `greatest` are kept.
    """
    modes = identification.modes
    clusters = (
        [c for c, keep in zip(identification.clusters, keep_mode, strict=True) if keep]
        if identification.clusters
        else []
    )
    inside = [
        (poles.frequency >= least)
        & (poles.frequency < greatest)
        & ~((poles.frequency[:, None] >= others[:, 0]) & (poles.frequency[:, None] <= others[:, 1])).any(axis=1)
        for poles in identification.sweep
    ]
    for cluster in clusters:
        for number, i in zip(cluster.number.tolist(), cluster.index.tolist(), strict=True):
            inside[number][i] = True
    sweep = tuple(poles.select(keep) for poles, keep in zip(identification.sweep, inside, strict=True))
    moved = []
    for cluster in clusters:
        pairs = zip(cluster.number.tolist(), cluster.index.tolist(), strict=True)
        moved.append(replace(cluster, index=np.array([int(inside[number][:i].sum()) for number, i in pairs])))
    left_out = tuple(part for part in identification.left_out if least <= part.frequency < greatest)
    few = modes.some_modes(np.flatnonzero(keep_mode))
    return replace(identification, modes=few, sweep=sweep, clusters=tuple(moved), left_out=left_out)

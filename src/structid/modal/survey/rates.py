"""Modes far below the sampling rate: a second look at the decimated record, and both looks as one answer.

A block Hankel matrix of few delays at a high rate spans less than a period of a low mode, which it then hardly sees;
decimated, the same delays span it several times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.modal.correlations import outputs
from structid.modal.method import ModalIdentification
from structid.modal.modal_record import ModalRecord
from structid.modal.modal_record import joined as joined_modes
from structid.modal.spectral.peaks import singular_spectrum
from structid.records import TimeRecord

_FEW_SAMPLES = 20  # a period of a mode that the record shows and the model at its own rate hardly does
_SAMPLES = 12  # a period of the lowest mode after decimation, at least
_LEAST, _SEGMENTS = 2000, 8
_DECADES = 1.0  # by which a peak of the spectrum must stand out
_SPLIT = (0.30, 0.38)  # parts of the lower rate between which the two looks are joined


def lower_rate(record: TimeRecord) -> float | None:
    """The sampling rate, Hz, at which the lowest peak of the spectrum has samples enough; None where it has already."""
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
    """Where the two looks are joined, Hz: away from modes of both."""
    places = np.linspace(*_SPLIT, 41) * rate
    modes = np.concatenate([low.frequency, high.frequency])
    if not len(modes):
        return float(places[0])
    return float(places[np.abs(places[:, None] - modes).min(axis=1).argmax()])


def joined(low: ModalIdentification, high: ModalIdentification, frequency: float) -> ModalIdentification:
    """Everything of `low` below `frequency` (Hz) and of `high` from there on.

    The covariance between the two is left out: it is 0 in the result, and a warning says so.
    """
    low, high = _limited(low, 0.0, frequency), _limited(high, frequency, np.inf)
    parts = [found.modes for found in (low, high)]
    warnings = [*dict.fromkeys(words for part in parts if part.n_modes for words in part.warnings)]
    if all(part.n_modes and part.covariance is not None for part in parts):
        warnings.append(
            f"modes below and above {frequency:.4g} Hz come from the record at two sampling rates: how their errors"
            " move together is left out; give a sampling rate (--rate) to look once"
        )
    source = f"below {frequency:.4g} Hz: {low.modes.source}; above: {high.modes.source}"
    later = [replace(cluster, number=cluster.number + len(low.sweep)) for cluster in high.clusters]
    return replace(
        high,
        modes=joined_modes(parts, warnings, source),
        sweep=(*low.sweep, *high.sweep),
        clusters=(*low.clusters, *later),
    )


def _limited(found: ModalIdentification, least: float, greatest: float) -> ModalIdentification:
    """The modes, poles and clusters from `least` to below `greatest`, Hz."""
    inside = [(poles.frequency >= least) & (poles.frequency < greatest) for poles in found.sweep]
    sweep = tuple(poles.select(keep) for poles, keep in zip(found.sweep, inside, strict=True))
    clusters = []
    for cluster in found.clusters:
        if not least <= cluster.frequency[cluster.chosen] < greatest:
            continue
        keep = np.flatnonzero((cluster.frequency >= least) & (cluster.frequency < greatest))
        pairs = zip(cluster.number[keep].tolist(), cluster.index[keep].tolist(), strict=True)
        index = np.array([int(inside[number][:i].sum()) for number, i in pairs])
        chosen = int(np.flatnonzero(keep == cluster.chosen)[0])
        clusters.append(
            replace(
                cluster, number=cluster.number[keep], index=index, frequency=cluster.frequency[keep],
                damping_ratio=cluster.damping_ratio[keep], chosen=chosen,
            )
        )  # fmt: skip
    modes = found.modes
    own = np.flatnonzero((modes.frequency >= least) & (modes.frequency < greatest))
    return replace(found, modes=modes.some_modes(own), sweep=sweep, clusters=tuple(clusters))

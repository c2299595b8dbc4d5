"""Modes far below the sampling rate: a second look at the decimated record, and both looks as one answer.

A block Hankel matrix of few delays at a high rate spans less than a period of a low mode, which it then hardly sees;
decimated, the same delays span it several times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from structid.arrays import FloatArray, IntArray
from structid.modal import ModalIdentification, ModalRecord, Poles
from structid.modal.spectral.fdd import singular_spectra
from structid.modal.stabilization import Cluster
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
    frequency, values, _ = singular_spectra(record, segment)
    level = np.log10(np.maximum(values[:, 0], 1e-300))
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
    below, above = low.modes.frequency < frequency, high.modes.frequency >= frequency
    orders = sorted({p.order for p in low.sweep} | {p.order for p in high.sweep})
    sweep, shifts = [], {}
    for order in orders:
        first = _of_order(low, order, 0.0, frequency)
        second = _of_order(high, order, frequency, np.inf)
        parts = [poles for poles, _ in (first, second) if poles is not None]
        shifts[order] = (0 if first[0] is None else len(first[0].poles)) - second[1]
        sweep.append(
            Poles(np.concatenate([p.poles for p in parts]), np.concatenate([p.shapes for p in parts], axis=1), order)
        )
    found = [*_clusters(low, orders, 0.0, frequency, None), *_clusters(high, orders, frequency, np.inf, shifts)]
    modes = _joined_modes(low.modes, below, high.modes, above, frequency)
    return replace(high, modes=modes, sweep=tuple(sweep), clusters=tuple(found))


def _of_order(found: ModalIdentification, order: int, least: float, greatest: float) -> tuple[Poles | None, int]:
    """The poles of `order` in a range, and how many lie below it."""
    for poles in found.sweep:
        if poles.order == order:
            keep = (poles.frequency >= least) & (poles.frequency < greatest)
            return Poles(poles.poles[keep], poles.shapes[:, keep], order), int((poles.frequency < least).sum())
    return None, 0


def _clusters(
    found: ModalIdentification, orders: list[int], least: float, greatest: float, shifts: dict[int, int] | None
) -> list[Cluster]:
    """Clusters in a range, counted in the joined sweep."""
    kept = []
    for cluster in found.clusters:
        middle = cluster.frequency[cluster.chosen]
        if not least <= middle < greatest:
            continue
        keep = np.flatnonzero((cluster.frequency >= least) & (cluster.frequency < greatest))
        own = [found.sweep[number].order for number in cluster.number[keep]]
        number: IntArray = np.array([orders.index(order) for order in own])
        index = cluster.index[keep] + np.array([0 if shifts is None else shifts[order] for order in own])
        chosen = int(np.flatnonzero(keep == cluster.chosen)[0])
        kept.append(Cluster(number, index, cluster.frequency[keep], cluster.damping_ratio[keep], chosen))
    return kept


def _joined_modes(
    low: ModalRecord, below: NDArray[np.bool_], high: ModalRecord, above: NDArray[np.bool_], frequency: float
) -> ModalRecord:
    parts = ((low, np.flatnonzero(below)), (high, np.flatnonzero(above)))
    covariance = shape_std = None
    warnings = [*dict.fromkeys(w for part, keep in parts for w in part.warnings if len(keep))]
    if low.covariance is not None and high.covariance is not None:
        covariance = _joined_covariance(parts)
        if all(len(keep) for _, keep in parts):
            warnings.append(
                f"modes below and above {frequency:.4g} Hz come from the record at two sampling rates: how their errors"
                " move together is left out; give a sampling rate (--rate) to look once"
            )
    if low.shape_std is not None and high.shape_std is not None:
        shape_std = np.concatenate([part.shape_std[:, keep] for part, keep in parts], axis=1)  # type: ignore[index]
    return ModalRecord(
        np.concatenate([part.frequency[keep] for part, keep in parts]),
        np.concatenate([part.damping_ratio[keep] for part, keep in parts]),
        np.concatenate([part.mode_shapes[:, keep] for part, keep in parts], axis=1),
        low.channels, covariance=covariance, shape_std=shape_std, warnings=tuple(warnings),
        source=f"below {frequency:.4g} Hz: {low.source}; above: {high.source}",
    )  # fmt: skip


def _joined_covariance(parts: tuple[tuple[ModalRecord, IntArray], ...]) -> FloatArray:
    """Of frequencies, then damping ratios, each those of the first part before those of the second."""
    n = sum(len(keep) for _, keep in parts)
    covariance, start = np.zeros((2 * n, 2 * n)), 0
    for part, keep in parts:
        here = np.concatenate([start + np.arange(len(keep)), n + start + np.arange(len(keep))])
        own = np.concatenate([keep, part.n_modes + keep])
        covariance[np.ix_(here, here)] = np.asarray(part.covariance)[np.ix_(own, own)]
        start += len(keep)
    return covariance

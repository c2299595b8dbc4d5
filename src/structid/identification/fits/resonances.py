"""Resonances as an engineer reads them off: peaks of the imaginary part, measured beside predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.records import FrfRecord
from structid.records.record import FrfKind

#: Damping ratio that a resonance is taken to have at least where its half-bandwidth is a measure.
LEAST_DAMPING = 0.001
_PROMINENCE = np.log(3.0)
_FARTHEST = 0.15


@dataclass(frozen=True)
class Resonance:
    """A peak of the measured record and the nearest one of the model.

    Attributes
    ----------
    measured : float
        Hz.
    predicted : float
        Hz; NaN where the model has no peak within 15 %.
    """

    measured: float
    predicted: float


def resonances(record: FrfRecord, predicted: ComplexArray) -> tuple[Resonance, ...]:
    """Peaks of the measured FRFs, each with the nearest peak of the model within 15 % in frequency (Hz).

    NaN if there is none. A peak is a maximum of the sum over channels of abs(Im H) (abs(Re H) for mobility) that stands
    out by a factor of three and exceeds half of the sum of abs(H).

    Parameters
    ----------
    record : FrfRecord
        Measured FRFs.
    predicted : (n_frequencies, n_outputs, n_inputs) complex array
        FRFs of the model at the same lines.
    """
    measured, model = (peaks(record.frequency, h, record.kind) for h in (record.values, predicted))
    matched = []
    for peak in measured:
        near = model[np.abs(model - peak) <= _FARTHEST * peak]
        nearest = float(near[np.abs(near - peak).argmin()]) if near.size else float("nan")
        matched.append(Resonance(float(peak), nearest))
    return tuple(matched)


def peaks(frequency: FloatArray, values: ComplexArray, kind: FrfKind) -> FloatArray:
    """Frequencies (Hz) of the resonance peaks of FRFs, (n_peaks,), interpolated by a parabola through three logarithms.

    A peak is a maximum of the sum over channels of abs(Im H) (abs(Re H) for mobility) that stands out by a factor of
    three on both sides and exceeds half of the sum of abs(H). Empty for fewer than five lines.

    Parameters
    ----------
    frequency : (n_frequencies,) float array
        Lines, Hz.
    values : (n_frequencies, n_outputs, n_inputs) complex array
        FRFs H.
    kind : FrfKind
        Kind of the FRFs.
    """
    indicator = np.abs(values.real if kind == "mobility" else values.imag).sum(axis=(1, 2))
    size = np.abs(values).sum(axis=(1, 2))
    if len(indicator) < 5:
        return np.zeros(0)
    level = np.log(np.maximum(np.maximum(indicator, 0.5 * size), np.finfo(float).tiny))
    index = prominent(level, _PROMINENCE)
    index = index[indicator[index] > 0.5 * size[index]]
    before, here, after = level[index - 1], level[index], level[index + 1]
    bend = before - 2 * here + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    step = 0.5 * (frequency[index + 1] - frequency[index - 1])
    return frequency[index] + np.clip(shift, -0.5, 0.5) * step


def prominent(level: FloatArray, least: float) -> IntArray:
    """Indices of the maxima of `level` (n,) that exceed the minima on both sides by at least `least`."""
    peaks: list[int] = []
    top = low = float(level[0])
    index, rises = 0, False
    for i, value in enumerate(level.tolist()):
        if rises and value > top:
            top, index = value, i
        elif rises and top - value >= least:
            peaks.append(index)
            low, rises = value, False
        elif not rises and value < low:
            low = value
        elif not rises and value - low >= least:
            top, index, rises = value, i, True
    return np.array(peaks, dtype=np.int64)

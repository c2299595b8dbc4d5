"""Windowed, overlapping segments of time records, as averaged spectra take them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.errors import InputError
from structid.records.record import TimeRecord

Detrend = Literal["constant", "linear", "none"]


def effective_averages(weights: FloatArray, step: int, segments: Sequence[int]) -> float:
    """Number of independent segments with the same variance of a spectrum as the overlapping ones.

    For K segments: K / (1 + 2 sum_j (1 - j / K) r_j), r_j = (sum_k w_k w_(k + j step))^2 / (sum_k w_k^2)^2.

    Parameters
    ----------
    weights : (segment_length,) float array
        Window.
    step : int
        Samples between the starts of segments.
    segments : sequence of int
        Number of segments in each record; records are independent.

    References
    ----------
    Welch (1967), IEEE Trans. Audio Electroacoust. 15, 70-73.
    """
    lags = range(step, weights.size, step)
    shared = np.array([np.dot(weights[lag:], weights[:-lag]) for lag in lags]) / np.dot(weights, weights)
    total = 0.0
    for count in segments:
        j = np.arange(1, min(count, shared.size + 1))
        total += count / (1 + 2 * float(np.sum((1 - j / count) * shared[: j.size] ** 2)))
    return total


def require_alike(records: list[TimeRecord], segment_length: int | None) -> None:
    """Refuse repeats that differ in channels, rate, or (without a segment length) in length."""
    if not records:
        raise InputError("`records` must hold at least one time record, got none")
    first = records[0]
    for other in records[1:]:
        same_channels = other.channels == first.channels and other.quantities == first.quantities
        if not same_channels or other.sampling_rate != first.sampling_rate:
            raise InputError(f"repeated records must share channels and sampling rate; {other.source!r} differs")
    if segment_length is not None:
        return
    if len(records) == 1:
        raise InputError(
            "`segment_length` must be given for one record; choose it several times the decay of the response"
        )
    if any(record.values.shape != first.values.shape for record in records):
        raise InputError("`segment_length` must be given for records of different lengths")


def segment_step(length: int, overlap: float) -> int:
    """Samples from the start of a segment to that of the next."""
    if length < 2:
        raise InputError(f"`segment_length` must be at least 2 samples, got {length}")
    if not 0 <= overlap < 1:
        raise InputError(f"`overlap` must be from 0 to less than 1, got {overlap}")
    return max(length - int(overlap * length), 1)


def window_weights(window: str | tuple[Any, ...], length: int) -> FloatArray:
    """Window as `scipy.signal.get_window` knows it, (length,)."""
    from scipy.signal import get_window

    try:
        weights = np.asarray(get_window(window, length), dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"`window` must be one of scipy.signal.get_window, got {window!r} ({error})") from error
    return weights


def segment_count(record: TimeRecord, length: int, step: int) -> int:
    """Number of whole segments in `record`."""
    return max((record.values.shape[0] - length) // step + 1, 0)


def segment_transforms(
    records: list[TimeRecord], weights: FloatArray, step: int, detrend: Detrend
) -> Iterator[ComplexArray]:
    """Fourier transform (F, n_channels) of every windowed segment."""
    from scipy.signal import detrend as without_trend

    length = weights.size
    for record in records:
        for i in range(segment_count(record, length, step)):
            part = record.values[i * step : i * step + length]
            if detrend != "none":
                part = without_trend(part, axis=0, type=detrend)
            yield np.fft.rfft(part * weights[:, None], axis=0)

"""Frequency domain decomposition of ambient motion: peaks of the first singular value of the spectral matrix.

References
----------
Brincker, Zhang and Andersen (2001), Modal identification of output-only systems using frequency domain decomposition,
Smart Mater. Struct. 10, 441-445.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.errors import InputError
from structid.modal.correlations import displacement_rows, outputs
from structid.modal.modal_record import ModalRecord, unit_largest
from structid.records import TimeRecord


def singular_spectra(
    records: TimeRecord | Sequence[TimeRecord], segment: int = 2048
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Singular values and vectors of the spectral matrix of the channels, each scaled by its root mean square.

    Parameters
    ----------
    segment : int
        Samples of each segment, Hann-windowed, half of them overlapping.

    Returns
    -------
    (n_lines,) float array
        Frequency, Hz.
    (n_lines, n_channels) float array
        Singular values, greatest first, 1/Hz.
    (n_lines, n_channels, n_channels) complex array
        Singular vectors in the columns.
    """
    data = outputs(records)
    shortest = min(len(y) for y in data.series)
    if not 8 <= segment <= shortest:
        raise InputError(
            f"`segment` must lie from 8 to {shortest}, the samples of the shortest record, got {segment}; shorten it"
        )
    window = np.sin(np.pi * np.arange(segment) / segment) ** 2
    total, n_segments = np.zeros((segment // 2 + 1, data.n_channels, data.n_channels), dtype=complex), 0
    for y in data.series:
        for start in range(0, len(y) - segment + 1, segment // 2):
            lines = np.fft.rfft(window[:, None] * y[start : start + segment], axis=0)
            total += lines[:, :, None] * lines[:, None, :].conj()
            n_segments += 1
    spectrum = 2 * total / (n_segments * data.sampling_rate * np.sum(window**2))
    vectors, values, _ = np.linalg.svd(spectrum)
    return np.fft.rfftfreq(segment, 1 / data.sampling_rate), values, vectors


def fdd(records: TimeRecord | Sequence[TimeRecord], frequencies: Sequence[float], segment: int = 2048) -> ModalRecord:
    """Modes at the peaks of the first singular value nearest to `frequencies`: a first look, without damping.

    Parameters
    ----------
    frequencies : sequence of float
        Hz, one for each mode, read off a plot of `singular_spectra`.
    segment : int
        See `singular_spectra`. Frequencies come in steps of sampling rate over `segment`.

    Returns
    -------
    ModalRecord
        Damped frequencies of the peaks, complex shapes, damping ratios NaN, no covariance.

    Raises
    ------
    InputError
        If a frequency lies outside the spectrum or two of them lead to one peak.
    """
    data = outputs(records)
    lines, values, vectors = singular_spectra(records, segment)
    first = values[:, 0]
    peaks = 1 + np.flatnonzero((first[1:-1] >= first[:-2]) & (first[1:-1] > first[2:]))
    wanted = np.asarray(frequencies, dtype=float)
    if not len(wanted) or (wanted <= 0).any() or (wanted >= lines[-1]).any() or not len(peaks):
        raise InputError(f"`frequencies` must lie between 0 and {lines[-1]:g} Hz, got {list(frequencies)}")
    span = np.maximum(2 * lines[1], 0.02 * wanted)
    chosen = []
    for f, width in zip(wanted, span, strict=True):
        near = peaks[np.abs(lines[peaks] - f) <= width]
        chosen.append(int(near[first[near].argmax()] if len(near) else peaks[np.abs(lines[peaks] - f).argmin()]))
    if len(set(chosen)) < len(chosen):
        raise InputError("`frequencies` must belong to different peaks; lengthen `segment`, or leave one out")
    chosen.sort()
    s = 2j * np.pi * lines[chosen]
    dofs, merge = displacement_rows(data, s)
    shapes = np.einsum("cdm,dm->cm", merge, data.scale[:, None] * vectors[chosen, :, 0].T)
    source = f"frequency domain decomposition, lines of {lines[1]:.3g} Hz"
    return ModalRecord(lines[chosen], np.full(len(chosen), np.nan), unit_largest(shapes), dofs, source=source)

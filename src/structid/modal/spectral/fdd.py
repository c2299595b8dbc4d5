"""Frequency domain decomposition of ambient motion: peaks of the first singular value of the spectral matrix.

The enhanced method takes damping from stored spectra. Around each peak of the first singular value, the spectral matrix is seen
through the singular vectors of the peak. The lines where the first singular vector resembles that of the peak are the bell of
the mode. Their inverse transform is the mode's correlation function, whose logarithm falls by zeta omega and whose phase turns
by the damped frequency.

References
----------
Brincker, Zhang and Andersen (2001), Modal identification of output-only systems using frequency domain decomposition,
Smart Mater. Struct. 10, 441-445; Brincker, Ventura and Andersen (2001), Damping estimation by frequency domain decomposition,
Proc. 19th IMAC, 698-703.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.display import join_words
from structid.core.errors import InputError
from structid.modal.correlations import displacement_rows, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord, independent_errors, unit_largest
from structid.modal.spectral.peaks import COHERENCE, chosen_peaks, peaks_within, stored_spectrum
from structid.records import TimeRecord
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord

#: Parts of its start between which the decay is fitted.
_UPPER, _LOWER = 0.9, 0.2
_N_LAGS = 400
_FEWEST_LINES, _FEWEST_LAGS = 7, 6
_DRAWS = 200
#: Averages that are drawn at most; the scatter of more is that of so many, made smaller.
_DRAWN = 16
#: Half width of the Hann window's spectrum, lines.
_HANN = np.array([-0.5, 1.0, -0.5]) / np.sqrt(1.5)


def fdd(
    records: TimeRecord | Sequence[TimeRecord] | SpectrumRecord | CorrelationRecord, options: ModalOptions | None = None
) -> ModalIdentification:
    """Modes by frequency domain decomposition: peaks of the first singular value, without damping ratios.

    Parameters
    ----------
    records : TimeRecord, sequence of them, SpectrumRecord or CorrelationRecord
        Ambient motion, or its spectra or correlation functions as another program averaged them.
    options : ModalOptions, optional
        Used are `frequencies` (by hand; automatic peaks otherwise), `segment` (by default one that leaves about 40
        averages; frequencies come in steps of sampling rate over it) and the frequency range of `criteria`.

    Returns
    -------
    ModalIdentification
        Damped frequencies of the peaks, complex shapes, damping ratios NaN. No covariance: a peak moves in steps of a line,
        which a spread over pieces cannot show.

    Raises
    ------
    InputError
        If a frequency lies outside the spectrum, near no peak, or two of them lead to one peak.
    NoModesError
        If no peak stands out inside the criteria.
    """
    options = options or ModalOptions()
    if isinstance(records, SpectrumRecord | CorrelationRecord):
        data, spectrum = stored_spectrum(records)
        lines = peaks_within(spectrum, options)
    else:
        data = outputs(records)
        spectrum, lines = chosen_peaks(data, options)
    note = (
        f"frequencies are peaks on lines {spectrum.spacing:.3g} Hz apart, without damping ratios and without "
        "covariance, which peaks on lines cannot give; "
        + (
            "the time histories behind them would; efdd gives damping"
            if isinstance(records, SpectrumRecord | CorrelationRecord)
            else "bayesian_fft gives both"
        )
    )
    frequency = spectrum.frequency[lines]
    dofs, merge = displacement_rows(data, 2j * np.pi * frequency)
    shapes = np.einsum("cdm,dm->cm", merge, data.scale[:, None] * spectrum.vectors[lines, :, 0].T)
    source = f"frequency domain decomposition, lines of {spectrum.spacing:.3g} Hz"
    unknown = np.full(len(lines), np.nan)
    modes = ModalRecord(frequency, unknown, unit_largest(shapes), dofs, warnings=(note,), source=source)
    return ModalIdentification(modes, "fdd", options=options)


class _Bell(NamedTuple):
    """The part of a mode in the spectra: distance of its lines from the peak in Hz, and complex values there."""

    offset: FloatArray
    values: ComplexArray


class _Decay(NamedTuple):
    """Decay rate zeta omega and distance of the damped frequency from the peak, rad/s: (n_draws,) of each."""

    rate: FloatArray
    shift: FloatArray


def efdd(record: SpectrumRecord | CorrelationRecord, options: ModalOptions | None = None) -> ModalIdentification:
    """Modes of stored spectra or correlation functions, with damping ratios, by enhanced frequency domain decomposition.

    Parameters
    ----------
    record : SpectrumRecord or CorrelationRecord
        Of correlation functions, whose references must be all channels, the spectra under a Hann window are taken.
    options : ModalOptions, optional
        Used are `frequencies` (by hand; automatic peaks otherwise) and the frequency range of `criteria`.

    Returns
    -------
    ModalIdentification
        Frequencies, damping ratios and complex shapes. Standard deviations come from the scatter of as many averages as are
        behind the lines (Hann windows), and from what the window of the averages does to damping, which stored spectra do not
        say: the damping ratio lies halfway between that without a window and that under Hann windows. They are NaN where the
        number of averages is unknown, and of correlation functions. Modes whose bell has fewer than 7 lines have no damping
        ratio.

    Raises
    ------
    InputError
        If a frequency lies outside the spectrum, near no peak, or two of them lead to one peak; if averages are unknown and
        no frequencies are given; if correlation functions lack references.
    NoModesError
        If no peak stands out inside the criteria.
    """
    options = options or ModalOptions()
    if isinstance(record, CorrelationRecord) and set(record.references) != set(record.channels):
        missing = [dof for dof in record.channels if dof not in record.references]
        raise InputError(
            f"`method` efdd needs correlation functions with all channels as references, {join_words(missing)} too, for whole"
            " spectra; use ssi_cov"
        )
    data, spectrum = stored_spectrum(record)
    lines = peaks_within(spectrum, options)
    duration = 1 / spectrum.spacing
    is_spectrum = isinstance(record, SpectrumRecord)
    windows = (_no_window, _hann_window) if is_spectrum else (_half_hann_window,)
    values, n_draws = [], _DRAWS if is_spectrum and np.isfinite(spectrum.averages) else 0
    rng = np.random.default_rng(0)
    for line in lines.tolist():
        bell = _bell(spectrum.frequency, spectrum.vectors[:, :, 0], spectrum.matrix, line)
        values.append(_mode(bell, float(spectrum.frequency[line]), duration, windows, spectrum.averages, n_draws, rng))
    frequency, frequency_std, ratio, ratio_std = np.array(values).T
    notes = _notes(spectrum.frequency[lines], ratio, spectrum.spacing, is_spectrum, n_draws > 0)
    dofs, merge = displacement_rows(data, 2j * np.pi * spectrum.frequency[lines])
    shapes = np.einsum("cdm,dm->cm", merge, data.scale[:, None] * spectrum.vectors[lines, :, 0].T)
    order = np.argsort(frequency, kind="stable")
    modes = ModalRecord(
        frequency[order],
        ratio[order],
        unit_largest(shapes)[:, order],
        dofs,
        covariance=independent_errors(np.append(frequency_std[order], ratio_std[order])),
        warnings=notes,
        source=f"enhanced frequency domain decomposition, lines of {spectrum.spacing:.3g} Hz",
    )
    return ModalIdentification(modes, "efdd", options=options)


def _bell(frequency: FloatArray, vectors: ComplexArray, matrix: ComplexArray, line: int) -> _Bell:
    """Spectral bell of a mode: lines around a peak with a MAC of 0.8 or more of first singular vectors with the peak's.

    The result has the distance of the lines from the peak (Hz) and the spectrum there in the singular vectors of the
    peak. `frequency` (n_lines,), Hz, `vectors` (n_lines, n_channels), the first singular vectors, and `matrix`
    (n_lines, n_channels, n_references), the spectral matrices, are of all lines; `line` is the index of the peak.
    """
    left = vectors[line]
    right = matrix[line].conj().T @ left
    alike = np.abs(vectors.conj() @ left) ** 2 >= COHERENCE
    before = np.flatnonzero(~alike[:line])
    after = np.flatnonzero(~alike[line:])
    first = int(before[-1]) + 1 if len(before) else 0
    stop = line + int(after[0]) if len(after) else len(frequency)
    values = np.einsum("c,kcr,r->k", left.conj(), matrix[first:stop], right)
    return _Bell(frequency[first:stop] - frequency[line], values)


def _mode(
    bell: _Bell,
    peak: float,
    duration: float,
    windows: tuple[Callable[[FloatArray], FloatArray], ...],
    averages: float,
    n_draws: int,
    rng: np.random.Generator,
) -> tuple[float, float, float, float]:
    """Frequency (Hz) and its deviation, damping ratio and its deviation of one mode.

    All but the frequency, which is `peak` then, are NaN where the bell is too narrow or its decay too short or slow to
    fit.

    Parameters
    ----------
    bell : _Bell
        Spectral lines around the peak.
    peak : float
        Frequency of the peak, Hz.
    duration : float
        One over the spacing of the lines, s.
    windows : tuple of callable
        Windows that the averages may have had: factors on the correlation at lags that are parts of `duration`. The
        results of several are averaged, and their difference is in the deviation of the damping ratio.
    averages : float
        Number of averages behind each line.
    n_draws : int
        Number of random spectra for the deviations, which are NaN with 0.
    rng : numpy Generator
    """
    if len(bell.offset) < _FEWEST_LINES:
        return peak, np.nan, np.nan, np.nan
    values = bell.values[None]
    if n_draws:
        values = np.concatenate([values, bell.values * _scatter(len(bell.offset), averages, n_draws, rng)])
    decays = [_decay(bell.offset, values, duration, window) for window in windows]
    if any(decay is None for decay in decays):
        return peak, np.nan, np.nan, np.nan
    rates = np.array([decay.rate for decay in decays if decay is not None])
    shifts = np.array([decay.shift for decay in decays if decay is not None])
    damped = 2 * np.pi * peak + shifts.mean(axis=0)
    s = damped * 1j - rates.mean(axis=0)
    ratio, frequency = -s.real / np.abs(s), np.abs(s) / (2 * np.pi)
    if not n_draws:
        return float(frequency[0]), np.nan, float(ratio[0]), np.nan
    by_window = float(np.ptp(rates[:, 0])) / np.sqrt(12) / float(np.abs(s[0]))
    deviation = float(np.hypot(ratio[1:].std(), by_window))
    return float(frequency[0]), float(frequency[1:].std()), float(ratio[0]), deviation


def _scatter(n_lines: int, averages: float, n_draws: int, rng: np.random.Generator) -> FloatArray:
    """Random factors (n_draws, n_lines) with mean 1, by which a mean of `averages` spectra under Hann windows scatters.

    Neighbouring lines are correlated as the windows make them; `n_lines` is the number of lines, and `rng` draws the
    factors.
    """
    count = min(max(round(averages), 1), _DRAWN)
    parts = rng.standard_normal((2, n_draws, count, n_lines + 2))
    parts = sum(weight * parts[..., k : k + n_lines] for k, weight in enumerate(_HANN))
    factors = (parts**2).sum(axis=(0, 2)) / (2 * count)
    return np.asarray(1 + (factors - 1) * np.sqrt(count / averages))


def _decay(
    offset: FloatArray, values: ComplexArray, duration: float, window: Callable[[FloatArray], FloatArray]
) -> _Decay | None:
    """Decay of the correlation functions of spectra `values` (n_draws, n_lines); None if too short or slow to fit.

    The result has decay rates (1/s) and distances of the damped frequency from the peak (rad/s), (n_draws,) each. The
    first spectrum decides which lags serve: from 0.9 to 0.2 of its start. None if fewer than 6 of the 400 lags lie
    there, or it never falls below 0.2.

    Parameters
    ----------
    offset : (n_lines,) float array
        Hz, from the peak.
    values : (n_draws, n_lines) complex array
    duration : float
        s, one over the spacing of the lines.
    window : callable
        Factor on the correlation at lags that are parts (0 to 0.5) of `duration`.
    """
    part = np.arange(_N_LAGS) / (2 * _N_LAGS)
    turning = np.exp(2j * np.pi * np.outer(offset, part * duration))
    correlation = values @ turning / window(part)
    size = np.abs(correlation[0]) / np.abs(correlation[0, 0])
    start = int(np.argmax(size < _UPPER))
    stop = start + int(np.argmax(size[start:] < _LOWER))
    if stop - start < _FEWEST_LAGS or not size.min() < _LOWER:
        return None
    kept = correlation[:, start:stop]
    lag = part[start:stop] * duration
    weight = np.abs(kept[0]) ** 2
    centred = (lag - np.average(lag, weights=weight)) * weight
    scale = centred @ lag
    return _Decay(-np.log(np.abs(kept)) @ centred / scale, np.unwrap(np.angle(kept), axis=1) @ centred / scale)


def _no_window(part: FloatArray) -> FloatArray:
    return np.ones_like(part)


def _hann_window(part: FloatArray) -> FloatArray:
    """Correlation of a Hann window with itself at lags `part` (0 to 1) of its length; 1 at lag 0."""
    turn = 2 * np.pi * part
    return np.asarray((1 - part) * (2 / 3 + np.cos(turn) / 3) + np.sin(turn) / (2 * np.pi))


def _half_hann_window(part: FloatArray) -> FloatArray:
    """Window that `stored_spectrum` applies to correlation functions, cos^2(pi `part`), at lags `part` times `duration`.

    Lags of correlation functions reach half the duration (`part` 0.5), where the window is 0.
    """
    return np.asarray(np.cos(np.pi * part) ** 2)


def _notes(
    peaks: FloatArray, ratio: FloatArray, spacing: float, is_spectrum: bool, has_deviations: bool
) -> tuple[str, ...]:
    """Warnings on the assumptions behind damping ratios, and on modes at `peaks` (Hz) whose `ratio` is NaN.

    `spacing` is that of the lines, Hz; `is_spectrum` is False of correlation functions, `has_deviations` says that the
    number of averages is known. () if there is nothing to warn of.
    """
    notes = []
    if is_spectrum:
        notes.append(
            "stored spectra do not say the window of their averages, which adds damping: ratios lie halfway between those"
            " without a window and those under Hann windows, and the difference is in their deviations"
        )
    if not has_deviations:
        notes.append(
            "no standard deviations: the number of averages is not known (`averages`)"
            if is_spectrum
            else "no standard deviations by efdd of correlation functions; ssi_cov states them where `averages` are known"
        )
    narrow = [f"{f:.4g}" for f, z in zip(peaks, ratio, strict=True) if np.isnan(z)]
    if narrow:
        notes.append(
            f"no damping ratio at {join_words(narrow)} Hz, where too few lines of {spacing:.3g} Hz belong to the mode, or its"
            " decay is too slow or too short for them; export spectra of finer lines, or the time histories"
        )
    return tuple(notes)

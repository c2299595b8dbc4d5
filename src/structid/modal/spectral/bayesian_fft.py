"""Fast Bayesian FFT method: modes of ambient motion in bands of the spectrum, with their posterior covariance.

References
----------
Au (2011), J. Eng. Mech. 137(3), 214-226; Au (2012), Mech. Syst. Signal Process. 26, 60-75 and 76-90; Au (2017),
Operational Modal Analysis, Springer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError, NoModesError
from structid.modal.correlations import ScaledMotion, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord, by_frequency, joined
from structid.modal.spectral.bayesian_fft_likelihood import BandLines
from structid.modal.spectral.bayesian_fft_search import Posterior, posterior
from structid.modal.spectral.peaks import (
    Band,
    Spectrum,
    automatic_bands,
    automatic_peaks,
    centred,
    chosen_peaks,
    default_segment,
    mode_places,
    singular_spectrum,
)
from structid.records import TimeRecord

_FEW_LINES = 4.0  # half-power bandwidth in lines of the record below which leakage shows in the damping


def bayesian_fft(
    records: TimeRecord | Sequence[TimeRecord], options: ModalOptions | None = None
) -> ModalIdentification:
    """Most probable modes of ambient motion and their posterior covariance, band by band.

    In each band the Fourier lines of the whole record, without a window, are complex normal with the spectral density
    of a few modes under white modal forces (correlated with each other) and of noise that is equal in all channels.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Displacement, velocity or acceleration. Several records of the same channels are taken to have the same modal
        forces and noise; their log-likelihoods add up. Channels of various quantities are brought to the commonest one
        by powers of i omega, and averaged where they share a place.
    options : ModalOptions, optional
        Used are `bands`, `frequencies` (where the modes are, one each; in bands given, as a start for the search
        only), `segment` (of the singular spectra that bands are chosen from) and `criteria`. Without `bands`, these lie
        around the automatic peaks of the first singular value, and `warnings` names them.

    Returns
    -------
    ModalIdentification
        Real mode shapes. `covariance` and `shape_std` are those of a normal distribution about the most probable
        values; bands are independent of each other. NaN for a band whose data do not determine its modes.

    Raises
    ------
    InputError
        If a band lies outside the spectrum or has fewer lines than (m + 1)^2 for m modes, no band is found, a
        frequency is near no peak, or no mode meets `criteria`.

    Notes
    -----
    Assumes white forces and noise within a band, light damping and a record much longer than the memory of its modes,
    1 / (zeta omega): lines are then independent, and leakage is small. A warning says where the half-power bandwidth
    2 zeta f is less than four lines. Prior distributions are uniform. For one well separated mode and long data the
    variances are zeta / (2 pi N_c B_f) f^2 and zeta / (2 pi N_c B_zeta), with N_c periods in the record.

    Cost O(n_lines (n m + m^3)) an evaluation and n m evaluations for the Hessian, for n channels.

    References
    ----------
    Au (2012), Mech. Syst. Signal Process. 26, 60-75 and 76-90; Au (2014), Uncertainty law in ambient modal
    identification, Mech. Syst. Signal Process. 48, 15-33.
    """
    options = options or ModalOptions()
    data = centred(outputs(records))
    notes: list[str] = []
    bands = _bands(data, options, notes)
    found, places = [], None
    for number, band in enumerate(bands, 1):
        lines, places = band_lines(data, band.low, band.high)
        need = (band.n_modes + 1) ** 2
        if len(lines.frequency) < need:
            raise InputError(
                f"`bands` must hold at least {need} lines for {band.n_modes} modes, got {len(lines.frequency)} in "
                f"{band.low:.4g} to {band.high:.4g} Hz; widen the band, or measure longer"
            )
        found.append(posterior(lines, band.peaks))
        notes += _band_warnings(number, band, found[-1], data)
    assert places is not None
    modes = _modal_record(found, places, options, notes, f"Bayesian FFT, {len(bands)} bands, {data.duration:g} s")
    return ModalIdentification(modes, "bayesian_fft", options=options)


def band_lines(data: ScaledMotion, low: float, high: float) -> tuple[BandLines, tuple[Dof, ...]]:
    """Scaled Fourier lines of all records from `low` to `high` (Hz), and the degrees of freedom measured.

    All channels are brought to the commonest quantity by powers of i omega.

    Returns
    -------
    BandLines
        Lines of all records, one record after another, scaled so that their mean square is 1.
    tuple of Dof
        One for each column of the lines; channels of one place are averaged.
    """
    kinds = data.derivative
    kind = int(np.bincount(kinds).argmax())
    places = tuple(dict.fromkeys(data.channels))
    merge = np.array([[channel == place for place in places] for channel in data.channels], dtype=float)
    merge /= merge.sum(axis=0)
    frequency, lines = [], []
    for y in data.series:
        f = np.fft.rfftfreq(len(y), 1 / data.sampling_rate)
        keep = np.flatnonzero((f >= low) & (f <= high) & (f > 0) & (f < data.sampling_rate / 2))
        own = np.stack([np.fft.rfft(column)[keep] for column in y.T], axis=1) * data.scale
        own = own * np.sqrt(2 / (len(y) * data.sampling_rate))
        frequency.append(f[keep])
        lines.append(own * (2j * np.pi * f[keep, None]) ** (kind - kinds) @ merge)
    values = np.concatenate(lines)
    size = np.sqrt(np.mean(np.abs(values) ** 2)) if len(values) else 1.0
    return BandLines(np.concatenate(frequency), np.asarray(values / size, dtype=np.complex128), kind), places


def _bands(data: ScaledMotion, options: ModalOptions, notes: list[str]) -> tuple[Band, ...]:
    """Frequency bands given in `options`, or around automatic peaks, with the places (Hz) of their modes.

    A note that lists automatic bands is appended to `notes`.
    """
    if options.bands is not None:
        spectrum = singular_spectrum(data, options.segment or default_segment(data))
        return tuple(_given_band(spectrum, *band, options, notes) for band in options.separate_bands)
    spectrum, peaks = chosen_peaks(data, options)
    bands = automatic_bands(spectrum, peaks.tolist())
    listed = ", ".join(f"{b.low:.4g}-{b.high:.4g} Hz ({b.n_modes})" for b in bands)
    notes.append(f"bands (number of modes): {listed}; chosen from the singular spectra. Give `bands` to set them")
    return bands


def _given_band(spectrum: Spectrum, low: float, high: float, options: ModalOptions, notes: list[str]) -> Band:
    """Band from `low` to `high` (Hz), with the places (Hz) of its modes: `options.frequencies`, peaks, or the maximum.

    A note is appended to `notes` if no peak stands out. `InputError` if the band lies outside the spectrum, or none of the
    frequencies lies in it.
    """
    top = spectrum.frequency[-1]
    if high > top:
        raise InputError(f"`bands` must lie between 0 and {top:g} Hz, got ({low:g}, {high:g}); sample faster")
    if options.frequencies is not None:
        own = tuple(sorted(float(f) for f in options.frequencies if low <= f <= high))
        if not own:
            raise InputError(f"`frequencies` must name a mode in every band, got none in {low:g} to {high:g} Hz")
        return Band(low, high, own)
    places = mode_places(spectrum, low, high, [int(k) for k in automatic_peaks(spectrum)])
    if not places:
        middle = 0.5 * (low + high)
        inside = np.flatnonzero((spectrum.frequency >= low) & (spectrum.frequency <= high))
        places = (float(spectrum.frequency[inside[spectrum.values[inside, 0].argmax()]]) if len(inside) else middle,)
        notes.append(f"no peak stands out between {low:g} and {high:g} Hz; one mode is searched for anyway")
    return Band(low, high, places)


def _band_warnings(number: int, band: Band, posterior: Posterior, data: ScaledMotion) -> list[str]:
    """Warnings on a frequency band whose modes are doubtful; an empty list if none is.

    `number` (from 1) is that of the band in the words.
    """
    words, spacing = [], 1 / data.duration
    where = f"band {number}, {band.low:.4g} to {band.high:.4g} Hz"
    if not posterior.converged:
        words.append(f"{where}: the search for the most probable values has not converged; change the band")
    if not np.isfinite(posterior.covariance).all():
        words.append(
            f"{where}: the data do not determine all that {band.n_modes} modes need, so no covariance is given; widen "
            "the band, or look for fewer modes there"
        )
    for f, zeta in zip(posterior.modes.frequency, posterior.modes.damping_ratio, strict=True):
        if 2 * zeta * f < _FEW_LINES * spacing:
            words.append(
                f"{where}: the half-power bandwidth of the mode at {f:.4g} Hz is {2 * zeta * f / spacing:.2g} lines of "
                f"{spacing:.2g} Hz; leakage raises its damping ratio. Measure longer"
            )
        if not band.low < f < band.high:
            words.append(f"{where}: a mode was found at {f:.4g} Hz, outside the band; it fits a slope, not a peak")
    return words


def _modal_record(
    posteriors: Sequence[Posterior], places: tuple[Dof, ...], options: ModalOptions, notes: list[str], source: str
) -> ModalRecord:
    """Modal record of the modes of all bands that meet `options.criteria`, by increasing frequency.

    `posteriors` has one item per band, `places` are the channels. Modes left out are appended to `notes`, which become
    the warnings. `NoModesError` if none is left. `source` says where the record comes from.
    """
    parts = []
    for one in posteriors:
        unit, std = _unit_largest(one.modes.shapes, one.shape_covariance)
        parts.append(by_frequency(one.modes.frequency, one.modes.damping_ratio, unit, places, one.covariance, std))
    modes = joined(parts, (), source)
    good = options.criteria.meets(modes.frequency, modes.damping_ratio)
    if not good.any():
        raise NoModesError("`records` show no mode that meets `criteria`; widen them, or change `bands`")
    notes += [
        f"the mode at {modes.frequency[k]:.4g} Hz, damping ratio {modes.damping_ratio[k]:.3g}, does not meet `criteria`:"
        " left out"
        for k in np.flatnonzero(~good)
    ]
    return replace(modes.some_modes(np.flatnonzero(good)), warnings=tuple(notes))


def _unit_largest(shapes: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`shapes` (n_channels, n_modes) with largest entry 1, and the deviation of every entry, (n_channels, n_modes) each.

    `covariances` (n_modes, n_channels, n_channels) are those of each shape; the deviation of the largest entry is 0.
    """
    unit, std = np.empty_like(shapes), np.empty_like(shapes)
    for r, (shape, covariance) in enumerate(zip(shapes.T, covariances, strict=True)):
        top = int(np.abs(shape).argmax())
        unit[:, r] = shape / shape[top]
        change = np.eye(len(shape))
        change[:, top] -= unit[:, r]
        spread = change @ covariance @ change.T / shape[top] ** 2
        std[:, r] = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return unit, std

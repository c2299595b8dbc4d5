"""Frequency domain decomposition of ambient motion: peaks of the first singular value of the spectral matrix.

References
----------
Brincker, Zhang and Andersen (2001), Modal identification of output-only systems using frequency domain decomposition,
Smart Mater. Struct. 10, 441-445.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.errors import NoModesError
from structid.modal.correlations import Outputs, displacement_rows, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord, unit_largest
from structid.modal.spectral.peaks import (
    Spectrum,
    automatic_peaks,
    default_segment,
    peaks_by_hand,
    singular_spectra,
    singular_spectrum,
)
from structid.records import TimeRecord

__all__ = ["fdd", "fdd_modes", "singular_spectra"]


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
        If a frequency lies outside the spectrum, near no peak, or two of them lead to one peak.
    """
    return fdd_modes(records, ModalOptions(frequencies=frequencies, segment=segment)).modes


def fdd_modes(records: TimeRecord | Sequence[TimeRecord], options: ModalOptions | None = None) -> ModalIdentification:
    """As `fdd`, at the peaks that stand out by themselves (`automatic_peaks`) unless frequencies are given.

    Parameters
    ----------
    options : ModalOptions, optional
        Used are `frequencies`, `segment` (by default one that leaves about 40 averages) and the frequency range of
        `criteria`.

    Returns
    -------
    ModalIdentification
        Damping ratios NaN. No covariance: a peak moves in steps of a line, which a spread over pieces cannot show.

    Raises
    ------
    InputError
        If no peak stands out inside the criteria, or as `fdd` does.
    """
    options = options or ModalOptions()
    data = outputs(records)
    spectrum = singular_spectrum(data, options.segment or default_segment(data))
    by_hand = options.frequencies is not None
    lines = peaks_by_hand(spectrum, options.frequencies or ()) if by_hand else automatic_peaks(spectrum)
    low, high = options.criteria.frequency
    lines = lines[(spectrum.frequency[lines] >= low) & (spectrum.frequency[lines] <= high)]
    if not len(lines):
        raise NoModesError(
            "`records` show no peak of the first singular value that stands out of its errors and meets `criteria`; "
            "give `frequencies`, or measure longer"
        )
    note = (
        f"frequencies are peaks on lines {spectrum.frequency[1]:.3g} Hz apart, without damping ratios and without "
        "covariance, which peaks on lines cannot give; efdd and bayesian_fft give both"
    )
    return ModalIdentification(_at_lines(data, spectrum, lines, (note,)), "fdd", options=options)


def _at_lines(data: Outputs, spectrum: Spectrum, lines: IntArray, notes: tuple[str, ...]) -> ModalRecord:
    """First singular vectors of lines as modes."""
    frequency: FloatArray = spectrum.frequency[lines]
    dofs, merge = displacement_rows(data, 2j * np.pi * frequency)
    shapes = np.einsum("cdm,dm->cm", merge, data.scale[:, None] * spectrum.vectors[lines, :, 0].T)
    source = f"frequency domain decomposition, lines of {spectrum.frequency[1]:.3g} Hz"
    return ModalRecord(
        frequency, np.full(len(lines), np.nan), unit_largest(shapes), dofs, warnings=notes, source=source
    )

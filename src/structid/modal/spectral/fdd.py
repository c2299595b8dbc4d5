"""Frequency domain decomposition of ambient motion: peaks of the first singular value of the spectral matrix.

References
----------
Brincker, Zhang and Andersen (2001), Modal identification of output-only systems using frequency domain decomposition,
Smart Mater. Struct. 10, 441-445.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.modal.correlations import displacement_rows, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord, unit_largest
from structid.modal.spectral.peaks import chosen_peaks, peaks_within, stored_spectrum
from structid.records import TimeRecord
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord


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

"""What was measured, and how it is read, written and turned into frequency response functions."""

from structid.records.io import Geometry, ReadOptions, read_geometry, read_record, write_record
from structid.records.quality.findings import Finding
from structid.records.quality.preparation import Preparation, Prepared, prepare
from structid.records.quality.signal_checks import signal_checks
from structid.records.quality.spectral_checks import harmonic_indicator
from structid.records.record import (
    FrfRecord,
    Record,
    TimeRecord,
    coherence_variance,
    from_repeats,
    with_coherence_noise,
    with_declared_noise,
)
from structid.records.transforms.finite_spectra import FiniteSpectra, finite_spectra
from structid.records.transforms.half_plane import right_half_plane
from structid.records.transforms.laplace_transform import frf_from_rest
from structid.records.transforms.segments import effective_averages
from structid.records.transforms.spectra import frf_from_time
from structid.records.transforms.spectral_matrix import SpectralMatrix, spectral_matrix

__all__ = [
    "Finding",
    "FiniteSpectra",
    "FrfRecord",
    "Geometry",
    "Preparation",
    "Prepared",
    "ReadOptions",
    "Record",
    "SpectralMatrix",
    "TimeRecord",
    "coherence_variance",
    "effective_averages",
    "finite_spectra",
    "frf_from_rest",
    "frf_from_time",
    "from_repeats",
    "harmonic_indicator",
    "prepare",
    "read_geometry",
    "read_record",
    "right_half_plane",
    "signal_checks",
    "spectral_matrix",
    "with_coherence_noise",
    "with_declared_noise",
    "write_record",
]

"""What was measured, and how it is read, written and turned into frequency response functions."""

from structid.records.finite_spectra import FiniteSpectra, finite_spectra
from structid.records.half_plane import right_half_plane
from structid.records.io import Geometry, ReadOptions, read_geometry, read_record, write_record
from structid.records.laplace_transform import frf_from_rest
from structid.records.record import (
    FrfRecord,
    Record,
    TimeRecord,
    coherence_variance,
    from_repeats,
    with_coherence_noise,
    with_declared_noise,
)
from structid.records.spectra import effective_averages, frf_from_time

__all__ = [
    "FiniteSpectra",
    "FrfRecord",
    "Geometry",
    "ReadOptions",
    "Record",
    "TimeRecord",
    "coherence_variance",
    "effective_averages",
    "finite_spectra",
    "frf_from_rest",
    "frf_from_time",
    "from_repeats",
    "read_geometry",
    "read_record",
    "right_half_plane",
    "with_coherence_noise",
    "with_declared_noise",
    "write_record",
]

"""What was measured, and how it is read, written and turned into frequency response functions."""

from structid.records.io import Geometry, ReadOptions, read_geometry, read_record, write_record
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
    "FrfRecord",
    "Geometry",
    "ReadOptions",
    "Record",
    "TimeRecord",
    "coherence_variance",
    "effective_averages",
    "frf_from_time",
    "from_repeats",
    "read_geometry",
    "read_record",
    "with_coherence_noise",
    "with_declared_noise",
    "write_record",
]

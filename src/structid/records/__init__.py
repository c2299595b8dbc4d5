"""What was measured, and how it is read, written and turned into frequency response functions."""

from structid.records.record import (
    FrfRecord,
    Record,
    TimeRecord,
    coherence_variance,
    from_repeats,
    with_coherence_noise,
    with_declared_noise,
)

__all__ = [
    "FrfRecord",
    "Record",
    "TimeRecord",
    "coherence_variance",
    "from_repeats",
    "with_coherence_noise",
    "with_declared_noise",
]

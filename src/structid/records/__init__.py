"""Records of measurements: reading, writing and transforms to frequency response functions."""

from structid.lazy import lazy

_GONE = {
    "frf_from_rest": "frf_from_time with an exponential window, or structid.spectra_problem, which fits impacts",
    "spectral_matrix": "scipy.signal.csd, or `structid modes`, whose page shows its singular values",
}
__getattr__, __dir__, __all__ = lazy(__name__, __file__, _GONE)

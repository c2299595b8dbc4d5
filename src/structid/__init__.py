"""structid: mass, damping and stiffness of a structure from vibration measurements."""

from structid._version import __version__ as __version__
from structid.lazy import lazy

_GONE = {
    "frf_from_rest": "frf_from_time with an exponential window, or spectra_problem, which fits an impact as it is",
    "joint_modes": "merge_modes, which finds as many modes, and their shapes more exactly",
}
__getattr__, __dir__, __all__ = lazy(__name__, __file__, _GONE)

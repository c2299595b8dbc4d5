"""Modes from records: Record to ModalRecord, by any method of `identification`."""

from structid.lazy import lazy

_GONE = {
    "efdd": "bayesian_fft, whose errors and intervals are better, in close modes too",
    "joint_modes": "merge_modes, which finds as many modes, and their shapes more exactly",
    "natural_excitation": "identify_modes by pencil or ssi_cov, which take the same correlations",
}
__getattr__, __dir__, __all__ = lazy(__name__, __file__, _GONE)

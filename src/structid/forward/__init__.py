"""Parameters and a record become a least-squares problem: whitened residual and its derivatives."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

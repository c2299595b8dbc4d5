"""What was measured, and how it is read, written and turned into frequency response functions."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

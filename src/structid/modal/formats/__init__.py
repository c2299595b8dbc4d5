"""Modes written to files and read back."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

"""Sections that say what the structure is: in words, as a mesh, as matrices, by a solver."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

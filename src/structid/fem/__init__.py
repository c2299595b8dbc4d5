"""Structures: nodes, elements and supports; they give element matrices, never data."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

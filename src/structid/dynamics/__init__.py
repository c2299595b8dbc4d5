"""Modes and responses: pure functions of mass, damping and stiffness."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

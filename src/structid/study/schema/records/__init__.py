"""Sections that say what was measured: FRFs, histories, modes, their sensors and set-ups."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

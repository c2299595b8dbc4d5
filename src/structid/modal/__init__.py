"""Modes from records: one method a file, Record to ModalRecord."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

"""Estimators: they see a problem through its protocol only, and give an `Estimate`; intervals of its parameters."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

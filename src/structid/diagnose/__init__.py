"""Diagnosis: checks before a fit, the verdict on an answer, and the causes of a misfit."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

"""Matrices of other finite element codes, from files to groups of matrices on the degrees of freedom of a structure."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

"""A finite element solver in the loop: decks with marked numbers, runs that are kept, and models made of what they give."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

"""Element types, a file for each family: each type declares its properties, and gives the matrices that they weigh.

A new type is a class in a module here, a line in `ELEMENT_TYPES` (``element.py``) and one in ``__init__.pyi``.
"""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

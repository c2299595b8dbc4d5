"""Set-ups of records: each makes a problem of its record and shows the fit beside it; one file a kind of record."""

from structid.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)

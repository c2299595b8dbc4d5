"""The scatter of values that differ from record to record about a common value."""

from __future__ import annotations

from dataclasses import dataclass

#: Scatter, in parts, from which a choice by the data begins.
BEGUN = 0.05


@dataclass(frozen=True)
class Scatter:
    """Parameters that differ from record to record: log own = log common + std e, with e of unit variance.

    Parameters
    ----------
    name : str
        What reports call it: that of the declaration, such as ``stiffness[clamp]``.
    common : tuple of str
        Names of the common values.
    own : tuple of str
        Names of the values of one record, in the same order; () before `own_values`.
    given : float or None
        Standard deviation of the logarithms, where it is stated; None where the data choose it.
    std : float
        The same as it is used.
    """

    name: str
    common: tuple[str, ...]
    own: tuple[str, ...] = ()
    given: float | None = None
    std: float = BEGUN

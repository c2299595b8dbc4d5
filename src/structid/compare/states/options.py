"""How two states are compared, as the flags of the command say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class CompareOptions:
    """How two states are compared. Every field is a flag of the command; a list may be one text with commas.

    Parameters
    ----------
    unchanged : sequence of str
        What is the same in both states: names, kinds or patterns, as in mass or 'mass[beam:*],loss_factor'.
    level : float
        Accepted rate of false declarations.
    power : float
        Probability that belongs to the detection limit.
    correction : {"holm", "benjamini_hochberg"}
        holm (family-wise) or benjamini_hochberg.
    """

    unchanged: Sequence[str] = ()
    level: float = 0.05
    power: float = 0.9
    correction: Literal["holm", "benjamini_hochberg"] = "holm"

    def __post_init__(self) -> None:
        if isinstance(self.unchanged, str):
            names = tuple(name.strip() for name in self.unchanged.split(",") if name.strip())
            object.__setattr__(self, "unchanged", names)

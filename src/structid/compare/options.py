"""Options of the commands that compare two states, and a test with its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from structid.core.constraints import NotNegative, part_of_one, require_declared, split_commas
from structid.core.errors import InputError

Reduction: TypeAlias = Literal["guyan", "serep"]
Method: TypeAlias = Literal["serep", "dynamic"]


@dataclass(frozen=True)
class CompareOptions:
    """Options of `structid compare`. Every field is a flag of the command; a list may be one text with commas.

    Parameters
    ----------
    unchanged : sequence of str
        What is the same in both states: names, kinds or patterns, as in mass or 'mass[beam:*],loss_factor'.
    level : float
        Accepted rate of false declarations.
    power : float
        Probability that belongs to the detection limit.
    correction : {"holm", "benjamini_hochberg"}
        holm bounds the risk of any false declaration by `level`; benjamini_hochberg the share of false ones among those made.
    least : float or str
        Least change of interest, as a part or in per cent, as in 0.01 or 1%: only what is surely larger is declared.
    """

    unchanged: Sequence[str] = ()
    level: float = 0.05
    power: float = 0.9
    correction: Literal["holm", "benjamini_hochberg"] = "holm"
    least: float | str = 0.0

    def __post_init__(self) -> None:
        """Convert `least` to a fraction, and `unchanged` from text between commas to a tuple of names."""
        object.__setattr__(self, "least", least_part(self.least))
        if isinstance(self.unchanged, str):
            object.__setattr__(self, "unchanged", split_commas(self.unchanged))


def least_part(value: float | str) -> float:
    """The smallest change of interest as a fraction of the parameter, from a number such as 0.01 or a text such as ``1 %``.

    Raises
    ------
    InputError
        If it is no number of at least 0 and below 1.
    """
    part = part_of_one(value)
    if not 0 <= part < 1:
        raise InputError(f"`least` must be at least 0 and below 1, got {value!r}; 0.01 and 1% are one per cent")
    return part


@dataclass(frozen=True)
class CorrelateOptions:
    """Options of `structid correlate`. Every field is a flag of the command.

    Parameters
    ----------
    least_mac : float
        MAC (cos^2 of the largest angle of close modes) below which two modes are no pair.
    reduction : {"guyan", "serep"}
        How the mass is reduced to the sensors: guyan (static) or serep (by modes).
    expansion : {"serep", "dynamic"}
        How measured shapes are carried on to the model: serep (sums of its modes) or dynamic.
    model_error : float
        How far the model's stiffness errs between two of its modes, in parts of theirs, for the standard deviations of
        expanded shapes; 0.01 where many elements are off by tens of per cent, each on its own.
    """

    least_mac: NotNegative = 0.5
    reduction: Reduction = "guyan"
    expansion: Method = "serep"
    model_error: NotNegative = 0.0

    def __post_init__(self) -> None:
        require_declared(self)


DEFAULT = CorrelateOptions()

"""Options of the correlation of a measurement and a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from structid.core.constraints import NotNegative, require_declared

Reduction: TypeAlias = Literal["guyan", "serep"]
Method: TypeAlias = Literal["serep", "dynamic"]


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

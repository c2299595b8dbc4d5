"""Settings of fits of measured modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from structid.core.constraints import NotNegative, Positive

ModalForm = Literal["output", "dynamic"]
ShapeForm = Literal["entries", "mac"]


@dataclass(frozen=True)
class ModalSettings:
    """Quantities of measured modes that count in a fit, and their errors; see `ModalProblem` for the forms of the residual.

    Parameters
    ----------
    form : ModalForm
        Of the residual: ``output``, by paired modes; ``dynamic``, which needs no pairing, for poor starts.
    frequency_error, damping_error : float
        Standard deviation of each frequency and damping ratio as a part of its value, where the record has no
        covariance; added to it in quadrature where it has.
    shape_error : float
        Standard deviation of every shape entry in parts of the largest, where the record has none; added likewise.
    use_damping : bool
        Whether damping ratios count; those of modes in groups never do.
    closeness : float
        Relative distance of measured frequencies below which modes form a group; those that their standard deviations
        do not tell apart form one in any case.
    frequency_guard : float
        A model mode is worth half as much to the pairing at this logarithmic distance in frequency.
    shape_form : ShapeForm
        How shapes count: ``entries``, by the standard deviation of each; ``mac``, as (1 - MAC) / ``shape_error**2`` of each
        mode, for comparison with work that minimizes such sums. MACs have no noise model: intervals are those of the weight.
    """

    form: ModalForm = "output"
    frequency_error: NotNegative = 0.0
    damping_error: NotNegative = 0.0
    shape_error: NotNegative = 0.0
    use_damping: bool = False
    closeness: NotNegative = 0.02
    frequency_guard: Positive = 0.3
    shape_form: ShapeForm = "entries"

"""An identification with its diagnosis, and the diagnoses that need no search for causes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from structid.diagnose.fixed_value_influence import FixedValueSensitivity
from structid.diagnose.split_consistency import Disagreement
from structid.diagnose.verdict import Cause, Diagnosis, judged
from structid.identification.identified import Identification

if TYPE_CHECKING:
    from structid.diagnose.refits import FittedModel

#: Gives the parts of the data that do not agree.
SplitCheck = Callable[[], tuple[Disagreement, ...]]


@dataclass(frozen=True, eq=False)
class DiagnosedIdentification:
    """An identification with its diagnosis.

    Attributes
    ----------
    identification : Identification
        With intervals that hold whichever of the likely changes is the truth.
    diagnosis : Diagnosis
    fits : tuple of FittedModel
        The fits behind its causes, in their order; a cause without a fit of its own has none.
    """

    identification: Identification
    diagnosis: Diagnosis
    fits: tuple[FittedModel, ...] = ()


def without_causes(
    identification: Identification,
    why: str,
    find_disagreements: SplitCheck,
    sensitivities: tuple[FixedValueSensitivity, ...] = (),
) -> DiagnosedIdentification:
    """Diagnosis without a search for causes; `why` says in words why there was none, for the verdict.

    `find_disagreements` returns the parts of the data that do not agree, where they decide. `sensitivities` are those
    of the answer to fixed values, which may be doubted. The identification is returned as it is.
    """
    judgement = judged(identification, untried=why, sensitivities=sensitivities, find_disagreements=find_disagreements)
    return DiagnosedIdentification(identification, Diagnosis(judgement, sensitivities=sensitivities))


def noise_level(chi_square: float, ratio: float) -> Cause:
    """The cause that the noise has `ratio` times the standard deviation that was stated or assumed.

    `chi_square` is chi-square per degree of freedom with the stated noise. As the part of the misfit that it removes the cause
    gets all above 1.
    """
    words = f"the noise is {ratio:.3g} times what was stated or assumed"
    share = 1.0 - 1 / chi_square if chi_square > 1 else 0.0
    return Cause("noise_level", ("all records",), words, share, 1.0, has_fit=False)

"""The diagnosis of an identification: its verdict, and where that is not sound the changes that would explain why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from structid import diagnose
from structid.core.errors import InputError
from structid.diagnose.fixed_value_influence import FixedValueSensitivity, is_clear
from structid.diagnose.search_budget import UNLIMITED, SearchBudget, iteration_effort
from structid.diagnose.split_consistency import Disagreement
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.thresholds import IDENTIFICATIONS, SEARCH_EFFORT
from structid.diagnose.verdict import (
    NOT_TRIED,
    Cause,
    Diagnosis,
    data_disagreements,
    is_sound,
    is_untested,
    judged,
    noise_ratio,
)
from structid.forward.frf.solvers import NO_MATRICES
from structid.identification.identified import Identification
from structid.inversion.search.work import SERIAL, TaskExecutor

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


#: The verdict of an answer that is written while causes are still looked for.
_SEARCHING = "the search for causes had not ended when this was written"
_NO_MATRIX = "no change of model or record was tried: the search leaves no Jacobian to look for one with"
_NO_PLACES = "causes were not looked for: frequencies without any shape show no place"


def budget_for_causes(identification: Identification) -> SearchBudget:
    """Default budget of a search for causes: three times the effort of the identification, and 8 s in addition.

    The effort is that of all rows of data that its iterations evaluated; 0 without a target problem.
    """
    target, effort = identification.target, 0.0
    if target is not None:
        effort = identification.estimate.search.n_rows / target.n_data * iteration_effort(target)
    return SearchBudget(IDENTIFICATIONS * effort + SEARCH_EFFORT)


def explain(identification: Identification, seconds: float | None = None) -> Diagnosis:
    """The verdict on an identification, and the changes of model or record that would explain its misfit.

    Parameters
    ----------
    identification : Identification
        Result of `identify` or `identify_together`.
    seconds : float, optional
        Processor time in seconds after which the search for causes ends; without a limit by default.

    Returns
    -------
    Diagnosis
        Printed, it begins with the verdict and lists the causes, the likeliest first.

    Raises
    ------
    InputError
        If `seconds` is not greater than 0, or `identification` is no `Identification` or does not know its set-ups.
    """
    if seconds is not None and not (isinstance(seconds, Real) and seconds > 0):
        raise InputError(
            f"`seconds` must be greater than 0, got {seconds!r}; leave it out for a search without a limit"
        )
    if not isinstance(identification, Identification):
        raise InputError(
            f"`identification` must be what `identify` or `identify_together` gives, got {type(identification).__name__}"
        )
    if not identification.setups or identification.options is None:
        raise InputError("`identification` must be one of `identify` or `identify_together`, which keeps its set-ups")
    model = TestedModel(identification.setups, identification.options)
    budget = SearchBudget(seconds=np.inf if seconds is None else seconds)
    return diagnose_identification(model, identification, explain=True, budget=budget).diagnosis


def diagnose_identification(
    model: TestedModel,
    identification: Identification,
    explain: bool | None = None,
    work: TaskExecutor = SERIAL,
    budget: SearchBudget = UNLIMITED,
    before_search: Callable[[Diagnosis], None] | None = None,
) -> DiagnosedIdentification:
    """Diagnosis of an identification: its verdict, and where that is not sound the causes of the misfit.

    Parameters
    ----------
    model : TestedModel
        Set-ups and options of the identification.
    identification : Identification
        The answer.
    explain : bool, optional
        True to search for causes wherever that can be done, False for never. By default (None) only where the answer is
        not sound or a fixed value is clearly doubted, and nothing simpler (noise level, too few data) explains the
        misfit.
    work : TaskExecutor
        Runs the screening and the fits of candidates.
    budget : SearchBudget
        Effort of the search for causes from its beginning on; unlimited by default.
    before_search : callable, optional
        Called with the diagnosis without causes, just before the search for them, which may take long.

    Returns
    -------
    DiagnosedIdentification
        The identification, with wider intervals where other models are likely, and its diagnosis.
    """
    estimate = identification.estimate
    find_disagreements = cache(
        partial(data_disagreements, identification, work)
    )  # the verdict is given before the search and after
    sensitivities: tuple[FixedValueSensitivity, ...] = ()
    if is_sound(identification):
        sensitivities = diagnose.fixed_value_sensitivities(model, identification)
        if not explain and (explain is False or not is_clear(sensitivities)):
            return diagnose.diagnose_sound(
                model, identification, sensitivities, work, find_disagreements, may_test_changes=explain is None
            )
    if not explain and (any(one.warning for one in identification.truncations) or is_untested(identification)):
        return DiagnosedIdentification(
            identification, Diagnosis(judged(identification, find_disagreements=find_disagreements))
        )
    ratio = noise_ratio(identification)
    if ratio is not None and ratio != 1.0 and not explain:
        causes = (noise_level(estimate.goodness.least_per_dof, ratio),)
        return DiagnosedIdentification(
            identification, Diagnosis(judged(identification, causes, find_disagreements=find_disagreements), causes)
        )
    if estimate.goodness.least_per_dof <= 1 and not identification.missed and not explain and not sensitivities:
        return DiagnosedIdentification(
            identification, Diagnosis(judged(identification, find_disagreements=find_disagreements))
        )
    why_not = _why_not_searched(model, identification, explain)
    if why_not:
        return without_causes(identification, why_not, find_disagreements)
    if before_search is not None:
        before_search(without_causes(identification, _SEARCHING, find_disagreements).diagnosis)
    return diagnose.diagnose_by_search(model, identification, sensitivities, work, budget, find_disagreements)


def _why_not_searched(model: TestedModel, identification: Identification, explain: bool | None) -> str:
    """Reason why causes are not looked for, as a clause; "" where they can be.

    Reasons are that the user wants none, a search without a Jacobian, a model without matrices, and records that name
    no sensor. `explain` is False where the user asks for no search, True or None otherwise.
    """
    if explain is False:
        return NOT_TRIED
    if identification.target is None or not identification.estimate.uncertainty.has_matrix:
        return _NO_MATRIX
    if not model.setups[0].structure.has_matrices:
        return f"causes were not looked for: that {NO_MATRICES}"
    if any(role == "output" and not dofs for setup in model.setups for role, dofs in setup.channels):
        return _NO_PLACES
    return ""

"""Two states of one structure as one problem: what stayed the same is one unknown, and a test of whether the data allow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.display import format_number, join_words
from structid.core.errors import InputError
from structid.inversion.problem import Problem
from structid.inversion.problems.joint import JointProblem

#: What is added to the names of the later state's own parameters.
LATER = " (later)"
#: What stands before the name of a record in that of a value of its own; such values are of no state, so not compared.
OF_RECORD = " @ "
#: Probability of a larger sum of squares below which parameters are not the same in both states.
_CONTRADICTED = 1e-3
#: Parameters that the words name.
_MOST_NAMED = 4


def states_problem(baseline: Problem, later: Problem, shared: Sequence[str]) -> JointProblem:
    """Joint problem of the data of both states, with the `shared` parameters equal and all others free in each.

    The later state's own parameters are called ``<name> (later)``.

    Parameters
    ----------
    baseline, later : Problem
        From independent data.
    shared : sequence of str
        Names of parameters of both.

    Raises
    ------
    InputError
        If a shared parameter is missing in one of them, or differs in unit, transform, bounds or prior.
    """
    for name in shared:
        if name not in baseline.names or name not in later.names:
            raise InputError(f"`shared` must name parameters of both states, got {name!r}; identify it in both")
    names = tuple(name if name in shared else name + LATER for name in later.names)
    return JointProblem((baseline, later), labels=(baseline.names, names))


@dataclass(frozen=True)
class UnchangedTest:
    """A likelihood ratio test of parameters that two states have in common.

    Attributes
    ----------
    names : tuple of str
        The parameters that are the same.
    cost, separate_cost : float
        Sum of squares with them the same, and with them free in each state; what is held is free within its tolerances in both.
    degrees_of_freedom : float
        Of the data of both states, with everything free.
    freedom : int
        How many conditions the common parameters, and fixed values that both states share, make.
    differing : tuple of (str, float, float)
        Parameters among `names` that the states ask for differently: the relative change, and the same in standard deviations; the
        surest first.

    References
    ----------
    Wilks (1938), Ann. Math. Statist. 9, 60-62.
    """

    names: tuple[str, ...]
    cost: float
    separate_cost: float
    degrees_of_freedom: float
    freedom: int
    differing: tuple[tuple[str, float, float], ...]

    @property
    def statistic(self) -> float:
        """Increase of the sum of squares when the parameters are equal in both states, never below 0.

        It is divided by the chi-square per degree of freedom of the separate fit where that exceeds 1.
        """
        scale = max(1.0, self.separate_cost / self.degrees_of_freedom) if self.degrees_of_freedom > 0 else 1.0
        return max(self.cost - self.separate_cost, 0.0) / scale

    @property
    def probability(self) -> float:
        """Probability of a larger `statistic` if they are the same."""
        return float(special.gammaincc(self.freedom / 2, self.statistic / 2))

    @property
    def is_contradicted(self) -> bool:
        """True if the data of both states do not allow that they are the same."""
        return not np.isfinite(self.cost) or self.probability < _CONTRADICTED

    @property
    def words(self) -> str:
        """Result of the test for an unchanged structure, in one sentence."""
        kept = join_words(self.names, _MOST_NAMED)
        same, separate = format_number(self.cost, 3), format_number(self.separate_cost, 3)
        sums = f"chi-square is {same} with them the same, and {separate} with them free"
        if not self.is_contradicted:
            return f"the data allow that {kept} did not change: {sums}"
        most = [
            f"{name} ({100 * ratio:+.2g} %, {format_number(abs(z), 2)} deviations)" for name, ratio, z in self.differing
        ]
        which = f": {join_words(most, _MOST_NAMED)}" if most else ""
        return (
            f"the data contradict that {kept} did not change: {sums}. What changed was named as unchanged{which}; name less, as no"
            " declared change is to be used"
        )

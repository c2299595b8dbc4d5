"""Parameters that are taken as the same in two states: whether the data of both allow it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.display import format_number, join_words

#: Probability of a larger sum of squares below which parameters are not the same in both states.
_CONTRADICTED = 1e-3
#: Parameters that the words name.
_MOST_NAMED = 4


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
        How many conditions the common parameters, and held values that both states share, make.
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
        """What the common parameters add to the sum of squares, over chi-square per degree of freedom where that is more than 1."""
        scale = max(1.0, self.separate_cost / self.degrees_of_freedom) if self.degrees_of_freedom > 0 else 1.0
        return max(self.cost - self.separate_cost, 0.0) / scale

    @property
    def probability(self) -> float:
        """Probability of a larger `statistic` if they are the same."""
        return float(special.gammaincc(self.freedom / 2, self.statistic / 2))

    @property
    def is_contradicted(self) -> bool:
        """Whether the data of both states do not allow that they are the same."""
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

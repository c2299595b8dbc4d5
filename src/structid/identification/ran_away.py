"""Parameters that ran away from their starts in a search, where neither data nor fit say that they belong there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.estimation import Estimate
from structid.identification.together import by_name
from structid.observation import RecordProblem
from structid.unknowns.named_unknowns import MAY_VANISH

#: Times its start, or parts of it, from where on a value is no longer taken for an answer. Starts that were 50 times off
#: are found again, and what has no effect ends at the reach of the search, a million times the start.
_FAR = 1e3


def ran_away(found: Estimate, problems: Sequence[RecordProblem]) -> tuple[int, ...]:
    """Positions of the positive parameters without prior or bounds that ended a thousand times their start or more away.

    Those that the data determine in a fit to within the noise were only started far off, and a damping that goes to nothing
    is absent; these have not run away.
    """
    has_prior = by_name(found.names, problems, lambda part: part.priors.stated)
    positive = by_name(found.names, problems, lambda part: np.array(part.transforms.kinds, dtype=object) == "log")
    unsure = ~found.identified | (found.covariance_basis == "model_error")
    candidates = positive.astype(bool) & ~has_prior.astype(bool) & unsure & (found.initial > 0)
    ratio = np.divide(found.values, found.initial, out=np.ones(len(candidates)), where=candidates)
    absent = np.isin(found.kinds, MAY_VANISH)
    far = (ratio >= _FAR) | ((ratio <= 1 / _FAR) & ~absent)
    return tuple(np.flatnonzero(candidates & far).tolist())


def ran_away_words(found: Estimate, index: int) -> str:
    """Which parameter ran away, from where and to where."""
    unit = "" if found.units[index] == "1" else f" {found.units[index]}"
    return f"{found.names[index]} ran away (from {found.initial[index]:.3g} to {found.values[index]:.3g}{unit}): not an answer"

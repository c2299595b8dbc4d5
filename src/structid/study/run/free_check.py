"""What a study of very many parameters can be expected to give, without a Jacobian and before any search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray, locked
from structid.estimation import JointProblem
from structid.estimation.free_estimate import counted_draws
from structid.identification.regularizing import coupled
from structid.study.run.run import Start
from structid.unknowns import Smoothness, penalty, term_name

#: Strength that stands for one that the data will choose: neighbours within 10 %.
USUAL_STRENGTH = 100.0
_DRAWS = 16


@dataclass(frozen=True, eq=False)
class FreePrediction:
    """How well data and smoothness together would know each parameter if the initial values were true.

    Attributes
    ----------
    n_determined : float
        How many combinations of parameters the data determine.
    relative_std : (n_params,) float array
        Predicted standard deviation over the size of the parameter; NaN where nothing sees it.
    words : tuple of str
        The strengths that were taken.
    """

    n_determined: float
    relative_std: FloatArray
    words: tuple[str, ...]

    @property
    def determined(self) -> bool:
        """Whether every parameter is known to better than its own size."""
        return bool((self.relative_std <= 1).all())


def free_prediction(ready: Start) -> FreePrediction:
    """The prediction for a study that `is_free`."""
    first = ready.problems[0]
    terms = [term for term in ready.study.options.regularization if isinstance(term, Smoothness)]
    strengths = [USUAL_STRENGTH if isinstance(term.strength, str) else float(term.strength) for term in terms]
    rows = [penalty(first.structure, first.parameters, t).scaled(s) for t, s in zip(terms, strengths, strict=True)]
    whole = JointProblem(coupled(ready.problems, rows))
    theta = np.asarray(whole.theta_start)
    at = whole.linearize_free(theta)
    draws, determined, _ = counted_draws(at, _DRAWS, np.random.default_rng(ready.study.options.seed))
    std = np.sqrt((draws**2).mean(axis=0)) if len(draws) > 1 else np.full(at.n_params, np.nan)
    std[at.squares <= 0] = np.nan
    values = whole.physical(theta)
    relative = std * np.abs(whole.slope(theta)) / np.where(values != 0, np.abs(values), np.nan)
    return FreePrediction(determined, locked(relative), _words(terms, strengths))


def _words(terms: Sequence[Smoothness], strengths: Sequence[float]) -> tuple[str, ...]:
    return tuple(
        f"{term_name(term)}: strength {strength:.3g}"
        + (", as given" if not isinstance(term.strength, str) else ", for one that `identify` will choose by the data")
        for term, strength in zip(terms, strengths, strict=True)
    )

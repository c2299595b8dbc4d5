"""Frequency continuation: from the lowest lines of an FRF upwards, for records of few lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from structid.arrays import FloatArray
from structid.estimation.problem import Problem
from structid.estimation.search.multistart import Way
from structid.observation.frf.continuation import start_deviation
from structid.observation.frf.problem import FrfProblem

#: What the start is expected to be off by, in the logarithm.
START_ERROR = 0.3
#: Error of each value that the stages allow for.
STAGE_ERROR = 0.1
_MOST_STAGES = 12
_MOST_LINES = 60


def frequency_continuation(
    problem: FrfProblem,
    centre: FloatArray | None = None,
    start_error: float = START_ERROR,
    stage_error: float = STAGE_ERROR,
) -> tuple[tuple[str, FrfProblem], ...]:
    """Stages with more and more lines from the lowest on, then all of them by the pole-free residual alone.

    Below the first resonance an FRF changes smoothly with every parameter; with each line added the model is close
    enough for the next resonance. What few lines do not say is held by a Gaussian prior at the start, which the last
    stage goes without. Undamped and noise-free records are followed to their exact answer.

    Parameters
    ----------
    problem : FrfProblem
        In any form but ``equation``, which gives no stages.
    centre : (n_params,) float array, optional
        Free variables that the prior draws to; the problem's start by default.
    start_error : float
        Standard deviation of the prior, in the logarithm; for damping at least 1.
    stage_error : float
        Error of each value while lines are added, as a part of its magnitude.

    Returns
    -------
    tuple of (name, FrfProblem)
        At most thirteen stages, for `estimate`.
    """
    if problem.form == "equation" or (problem.record.values == 0).any():
        return ()
    order = np.argsort(problem.record.frequency, kind="stable")
    n_lines = len(order)
    counts = np.unique(np.ceil(np.linspace(0, n_lines, min(n_lines, _MOST_STAGES) + 1)[1:]).astype(int))
    prior = (problem.theta_start if centre is None else centre, start_deviation(problem, start_error))
    error = max(stage_error, problem.model_error)
    held = replace(problem, form="pole_free", model_error=error, start_prior=prior, measured_sliding=True)
    stages = []
    for count in counts:
        used = held.record.lines(np.sort(order[:count]))
        stages.append((f"pole-free, up to {used.frequency.max():g} Hz", replace(held, record=used)))
    return *stages, ("pole-free", replace(problem, form="pole_free"))


def few_line_plans(problem: Problem, plans: Sequence[Way]) -> tuple[Way, ...]:
    """The same ways to the answer, after frequency continuation where the problem is one FRF record of up to 60 lines.

    With so few, resonances hide between lines, and continuation from the right half-plane has nothing to smooth.
    """
    if not isinstance(problem, FrfProblem) or not 1 < len(problem.record.frequency) <= _MOST_LINES:
        return tuple(plans)
    return partial(frequency_continuation, problem), *plans

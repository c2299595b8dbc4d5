"""Intervals that hold whichever of the likely changes is the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from structid.estimation.intervals.intervals import Intervals
from structid.estimation.uncertainty import dense_uncertainty
from structid.explanation.explain import Fitted

_MISFIT = 1e-3

Ends = Mapping[str, tuple[float, float]]


def intervals_of(fitted: Fitted, level: float) -> Ends:
    """Normal intervals of the free variables of a fitted study, in physical units by name; see `Estimate.interval`."""
    target, theta = fitted.trial.target, fitted.theta
    found = dense_uncertainty(target, theta, target.linearize(theta), True, _MISFIT)
    std = (found.model_error if found.misfit else found.noise).std
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        half = float(special.ndtri(0.5 + level / 2)) * std / np.abs(target.slope(theta))
        low, high = (target.physical(theta + side * half) for side in (-1, 1))
    return {name: (min(a, b), max(a, b)) for name, a, b in zip(target.names, low.tolist(), high.tolist(), strict=True)}


def widened(own: Intervals, names: Sequence[str], others: Sequence[Ends]) -> Intervals:
    """The union of an answer's intervals and those of enlarged models that explain the misfit about as well.

    No weights: a misfit as large as that of a wrong model gives all of them to one of the enlarged models, which need
    not be the right one (Draper, 1995).

    Parameters
    ----------
    own : Intervals
        Of the parameters `names`.
    names : sequence of str
    others : sequence of mappings
        Of the enlarged models; ends that are not finite numbers widen nothing.
    """
    if not others:
        return own
    ends = own.ends.copy()
    for number, name in enumerate(names):
        for one in others:
            low, high = one.get(name, (np.nan, np.nan))
            ends[number] = np.fmin(ends[number, 0], low), np.fmax(ends[number, 1], high)
    many = "one change" if len(others) == 1 else f"{len(others)} changes"
    words = f"intervals hold with the model as it is and with {many} that would explain the misfit about as well"
    return replace(own, ends=ends, notes=(*own.notes, words))

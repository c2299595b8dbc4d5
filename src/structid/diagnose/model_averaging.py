"""Uncertainty that holds whichever of the likely changes is the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.core.display import join_words
from structid.diagnose.refits import FittedModel
from structid.identification.identified import Identification
from structid.identification.identify import total_mass
from structid.identification.warning_words import estimate_warnings
from structid.inversion.estimate import normal_intervals
from structid.inversion.uncertainty import DenseCovariance

IntervalsByName = dict[str, tuple[float, float]]


def intervals_of(fitted: FittedModel, level: float) -> IntervalsByName:
    """Normal intervals of the parameters of a fitted study at the probability `level`: (low, high) in SI units, by name."""
    std = np.sqrt(np.diag(fitted.covariance))
    ends = normal_intervals(fitted.parameters, std, fitted.identified, level)
    return dict(zip(fitted.parameters.names, ((low, high) for low, high in ends.tolist()), strict=True))


def widened(identification: Identification, likely: Sequence[FittedModel], direction: str | None) -> Identification:
    """Identification with intervals and standard deviations that cover likely changed models as well; values stay.

    Intervals are the union of those of all these models; the covariance is the mean over the models of covariance plus
    square of the distance from the identified values. A model where that is not finite is left out of the mean. Models
    have equal weight: with the misfits of wrong models, likelihood weights would favour one changed model alone, which
    need not be the right one. A parameter on which the models disagree by more than its value is not identified; notes
    and warnings say so, and the total mass has its wider deviation.

    Parameters
    ----------
    identification : Identification
    likely : sequence of FittedModel
        Fits of the likely changed models; without any the identification is returned as it is.
    direction : str, optional
        Direction of the translation for which the total mass is computed, such as ``X``.

    References
    ----------
    Draper (1995), J. R. Stat. Soc. B 57, Eq. (11), with equal weights and about the answer's own values.
    """
    if not likely or identification.target is None:
        return identification
    estimate, own = identification.estimate, identification.intervals
    ends, covariance = own.ends.copy(), estimate.covariance_of_data
    squares = [covariance]
    for fitted in likely:
        place = {name: number for number, name in enumerate(fitted.modified.target.names)}
        here = np.array([number for number, name in enumerate(estimate.names) if name in place], dtype=np.intp)
        there = np.array([place[estimate.names[number]] for number in here], dtype=np.intp)
        change = np.array(list(fitted.values.values()))[there] - estimate.values[here]
        square = covariance.copy()
        square[np.ix_(here, here)] = fitted.covariance_of_data[np.ix_(there, there)] + np.outer(change, change)
        if np.isfinite(square).all():
            squares.append(square)
        others = np.array(list(intervals_of(fitted, own.level).values()))[there]
        ends[here] = np.stack([np.fmin(ends[here, 0], others[:, 0]), np.fmax(ends[here, 1], others[:, 1])], axis=1)
    many = "one change" if len(likely) == 1 else f"{len(likely)} changes"
    words = f"intervals and deviations hold with the model as it is and with {many} that would explain the misfit about as well"
    union = DenseCovariance(np.mean(squares, axis=0))
    known = estimate.identified & ~(union.std > identification.target.unknowns.sizes(estimate.values))
    lost = [
        name for name, before, now in zip(estimate.names, estimate.identified, known, strict=True) if before and not now
    ]
    notes = (
        (words, f"these disagree by more than the value about {join_words(lost)}: not identified") if lost else (words,)
    )
    wider = replace(
        estimate,
        spread=replace(estimate.spread, model_error=union, covariance_basis="model_error", identified=known),
    )
    before, now = estimate_warnings(estimate), estimate_warnings(wider)
    kept = [one for one in identification.warnings if one in now or one not in before]
    _, std = total_mass(
        identification.problems[0], wider, direction, identification.freed[0] if identification.freed else None
    )
    return replace(
        identification,
        estimate=wider,
        warnings=(*(one for one in now if one not in kept), *kept),
        intervals=replace(own, ends=ends, notes=(*own.notes, *notes)),
        mass=replace(identification.mass, std=std),
    )

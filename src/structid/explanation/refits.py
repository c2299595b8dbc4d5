"""Fits of changed studies: near, and to the end; each a task of its own, wherever it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import StructidError
from structid.criticism.candidate import Candidate
from structid.criticism.data import DATA_KINDS, changed_rows, outlying, scaled_misfit, tones
from structid.explanation.time_budget import time_limit_callback
from structid.explanation.trial import FINAL, Trial
from structid.explanation.words import unit_of
from structid.forward import FrfProblem, SpectraProblem
from structid.identification.joint_problem import indices_of, joint_problem
from structid.inversion import Problem
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.minimum import Minimum
from structid.inversion.search.work import Task, Tools
from structid.inversion.uncertainty import dense_uncertainty

#: Probability of a misfit below which noise alone is not its cause.
MISFIT = 1e-3
_MOST_PASSES = 4
#: Chi-square per degree of freedom that a record of another state leaves at most with values of its own.
_OF_ITS_OWN = 2.0
#: Part of a misfit below which a difference is one of rounding.
_ALIKE = 1e-9
#: Factor by which a channel's calibration may be off.
_MOST_GAIN = 30.0
#: Factors on the strength of kinds whose strength is no parameter, or has far minima.
_OF_NUMBERS = (1.6, 1.25, 1.1, 1.04, 1.015)
_OTHER_STRENGTHS = {
    "direction": _OF_NUMBERS,
    "load_direction": _OF_NUMBERS,
    "between": _OF_NUMBERS,
    "load_between": _OF_NUMBERS,
    "offset": (*_OF_NUMBERS, 1.005, 1.002),
    "friction": (3.0, 2.0),
}


@dataclass(frozen=True, eq=False)
class Fitted:
    """A study with changes, fitted.

    Attributes
    ----------
    trial : Trial
    theta : (n_params,) float array
    cost : float
        Sum of squares.
    aside : float
        The part of it that data make which are left out, their errors larger by the likeliest factor.
    """

    trial: Trial
    theta: FloatArray
    cost: float
    aside: float = 0.0

    @property
    def values(self) -> dict[str, float]:
        """Physical values by name."""
        return self.trial.values(self.theta)

    @cached_property
    def covariance(self) -> FloatArray:
        """Of the physical values, (n_params, n_params): from noise, or where that is missed from model error."""
        target = self.trial.target
        return dense_uncertainty(target, self.theta, target.linearize(self.theta), True, MISFIT).spread.covariance


class Fit(TypedDict, total=False):
    """What a fit of a change gave, in numbers and texts: of `approached` free variables and misfit, of `refitted` all.

    Empty where there is no model with the change.
    """

    theta: FloatArray
    cost: float
    aside: float
    where: list[str]
    strength: float


#: A change and its strength.
Change = tuple[Candidate, float]
#: A change, its strength, and the misfit above which it is of no use.
Near = tuple[Candidate, float, float]
#: A change, its strength, and free variables to fit it from.
Item = tuple[Candidate, float, FloatArray]


def approached(base: Fitted, change: Near, tools: Tools) -> Fit:
    """Free variables and misfit of the anchored fit of a change; nothing where the study has no place for it.

    The misfit is only known to be above the one given where it would end there.
    """
    candidate, strength, above = change
    try:
        trial = base.trial.changed(candidate, strength)
        near = trial.approached(above - base.aside)
        cost = near.cost + base.aside + _left_out(base, trial, near.theta, is_near=True)
        return {"theta": near.theta, "cost": cost}
    except (StructidError, np.linalg.LinAlgError):
        return {}  # not a cause that could be offered


def refitted(base: Fitted, item: Item, tools: Tools) -> Fit:
    """The fit of a change as the study asks for, from `approached`; nothing where there is no model with it."""
    candidate, strength, theta = item
    try:
        if candidate.kind == "record" and not _fits_alone(base, candidate):
            return {}
        found = _finally(base, base.trial.changed(candidate, strength), theta)
        return {} if candidate.kind in ("sensor_gain", "load_gain") and _is_no_gain(base, found) else _stored(found)
    except (StructidError, np.linalg.LinAlgError):
        return {}


def _is_no_gain(base: Fitted, found: Fitted) -> bool:
    """Whether a factor is so far from 1 that it only leaves the channel out, and is that of no unit."""
    candidate = found.trial.changes[-1][0]
    added = [value for name, value in found.values.items() if name not in base.values and value > 0]
    return any(abs(np.log(value)) > np.log(_MOST_GAIN) and not unit_of(candidate, value) for value in added)


def likewise(base: Fitted, item: tuple[Task, Near | Item, Fit], tools: Tools) -> Fit:
    """What the fit of another change gave, where it has the same misfit with this one; else this one's own fit.

    At mirrored places of a symmetric structure changes answer alike.

    Parameters
    ----------
    base : Fitted
    item : (task, item, dict)
        `approached` or `refitted`, what it takes, and what it gave of the other change.
    tools : Tools
    """
    task, (candidate, strength, *_), first = item
    try:
        trial = base.trial.changed(candidate, first.get("strength", strength))
        residual = (trial.target if "strength" in first else trial.anchored()).residual(first["theta"])
        if abs(residual @ residual + base.aside - first["cost"]) <= _ALIKE * first["cost"]:
            return {**first, "where": list(candidate.where)}
    except (StructidError, np.linalg.LinAlgError, KeyError):
        pass
    found: Fit = task(base, item[1], tools)
    return found


def _fits_alone(base: Fitted, candidate: Candidate) -> bool:
    """Whether a record that is said to be of another state is one of the model at all, with values of its own.

    Without one of two records little is left to misfit, whatever is wrong with the model.
    """
    assert candidate.record is not None
    own = base.trial.problems[candidate.record]
    found = minimize(
        own,
        FINAL,
        base.theta[indices_of(base.trial.target.names, own.names)],
        time_limit_callback(base.trial.fit_seconds),
    )
    return float(found.costs[-1]) < _OF_ITS_OWN * max(own.n_data - len(own.names), 1)


def _stored(found: Fitted) -> Fit:
    """A fit of one change more in numbers and texts."""
    candidate, strength = found.trial.changes[-1]
    return {
        "where": list(candidate.where), "strength": float(strength), "theta": found.theta, "cost": found.cost,
        "aside": found.aside,
    }  # fmt: skip


def restored(base: Fitted, candidate: Candidate, stored: Fit) -> Fitted:
    """The fit that `refitted` gave of a candidate."""
    trial = base.trial.changed(replace(candidate, where=tuple(stored["where"])), float(stored["strength"]))
    return Fitted(trial, np.asarray(stored["theta"]), float(stored["cost"]), float(stored["aside"]))


def _finally(base: Fitted, trial: Trial, theta: FloatArray) -> Fitted:
    """The fit as the study asks for; of outlying lines those that stand out from it once more."""
    found = trial.fitted([theta, trial.theta_of(base.values)])
    trial, found = _stronger(base, trial, found)
    for _ in range(_MOST_PASSES):
        again = _other_lines(base, trial, found.theta)
        if again is None:
            break
        trial = again
        found = trial.fitted([trial.theta_of(base.values)])
    aside = base.aside + _left_out(base, trial, found.theta)
    return Fitted(trial, found.theta, float(found.costs[-1]) + aside, aside)


def _stronger(base: Fitted, trial: Trial, found: Minimum) -> tuple[Trial, Minimum]:
    """The best of some strengths, where the strength is no parameter of the changed study, or far starts of it matter."""
    candidate, strength = trial.changes[-1]
    factors = _OTHER_STRENGTHS.get(candidate.kind, ())
    for step in factors:
        for factor in (step, 1 / step):
            q = strength * factor
            if not candidate.bounds[0] < q < candidate.bounds[1]:
                continue
            try:
                other = base.trial.changed(candidate, q)
                again = other.fitted([other.theta_of({**base.values, **_values(trial, found.theta, base)})])
            except (StructidError, np.linalg.LinAlgError):
                continue
            if again.costs[-1] < found.costs[-1]:
                trial, found = other, again
        strength = trial.changes[-1][1]
    return trial, found


def _values(trial: Trial, theta: FloatArray, base: Fitted) -> dict[str, float]:
    """Of a trial's parameters those that the study has as it is."""
    return {name: value for name, value in trial.values(theta).items() if name in base.trial.target.names}


def _other_lines(base: Fitted, trial: Trial, theta: FloatArray) -> Trial | None:
    """The trial with all lines that stand out from its fit left out, or all tones; None where these are the ones."""
    candidate, strength = trial.changes[-1]
    if candidate.kind not in ("outlying_lines", "tone") or len(base.trial.problems) > 1:
        return None
    [problem], [changed] = base.trial.problems, trial.problems
    spans: tuple[str, ...] = ()
    if isinstance(problem, FrfProblem):
        spans = outlying(problem, _seen_from(base, trial, theta, base.trial.target)[: problem.n_data])
    elif isinstance(changed, SpectraProblem):
        more = tones(changed, changed.residual(theta)[: changed.n_data])
        spans = (*candidate.where, *more) if more else ()
    if not spans or spans == candidate.where:
        return None
    return base.trial.changed(replace(candidate, where=spans), strength)


def _seen_from(base: Fitted, trial: Trial, theta: FloatArray, of: Problem) -> FloatArray:
    """The residual of `of`, which has all data of `base`, at what a trial found."""
    return of.residual(base.trial.theta_of({**base.values, **trial.values(theta)}))


def _left_out(base: Fitted, trial: Trial, theta: FloatArray, is_near: bool = False) -> float:
    """What data that the last change leaves out add to the misfit, or to that of the anchored fit where `is_near`.

    Their errors are larger by the likeliest factor.
    """
    candidate = trial.changes[-1][0]
    if candidate.kind not in DATA_KINDS:
        return 0.0
    problems = base.trial.anchored_problems() if is_near else base.trial.problems
    rows = changed_rows(candidate, problems)
    residual = _seen_from(base, trial, theta, joint_problem(problems))[: len(rows)]
    return scaled_misfit(float(residual[rows] @ residual[rows]), int(rows.sum()))

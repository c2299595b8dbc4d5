"""Fits of modified models: near, and to the end; each a task of its own, wherever it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import StructidError
from structid.diagnose.causes import OutlyingLines, Tone, rows_left_out
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.gain import MOST_GAIN, LoadGain, SensorGain
from structid.diagnose.causes.record_left_out import OtherState
from structid.diagnose.data_rows import outlying_spans, scaled_misfit, tones
from structid.diagnose.modified_model import FINAL, ModifiedModel
from structid.diagnose.search_budget import counted
from structid.diagnose.thresholds import (
    MISFIT,
    MOST_PASSES,
    OTHER_STATE_MISFIT,
    SAME_MISFIT,
)
from structid.forward import FrfProblem, SpectraProblem
from structid.identification.joint_problem import indices_of, joint_problem
from structid.inversion import Problem
from structid.inversion.diagnostics.residual_tests import misfit_probability
from structid.inversion.estimate import ParameterValues, parameters_at
from structid.inversion.search.minimum import Minimum
from structid.inversion.search.work import Task, Tools
from structid.inversion.uncertainty import Uncertainty, dense_uncertainty


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model with changes, fitted.

    Attributes
    ----------
    modified : ModifiedModel
    theta : (n_params,) float array
    cost : float
        Sum of squares.
    aside : float
        The part of it that data make which are left out, their errors larger by the likeliest factor.
    least : float, optional
        The sum of squares with fixed values free within their tolerances, where noise alone does not explain `cost`.
    is_beyond : bool
        Whether noise and tolerances leave as much with less than the probability `MISFIT`; known where `least` is.
    """

    modified: ModifiedModel
    theta: FloatArray
    cost: float
    aside: float = 0.0
    least: float | None = None
    is_beyond: bool = True

    @property
    def misfit(self) -> float:
        """The sum of squares that noise and tolerances are to explain."""
        return self.cost if self.least is None else self.least

    @property
    def cause(self) -> Candidate:
        """The last change."""
        return self.modified.changes[-1].candidate

    @property
    def values(self) -> dict[str, float]:
        """Physical values by name."""
        return self.modified.values(self.theta)

    @property
    def parameters(self) -> ParameterValues:
        """All parameters, those of the changes among them, with their values."""
        return parameters_at(self.modified.target, self.theta)

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        target, values = self.modified.target, self.modified.fixed_values
        columns = None if values is None else values.sensitivities_at(target.names, self.theta, self.least is not None)
        return dense_uncertainty(target, self.theta, target.linearize(self.theta), True, MISFIT, columns)

    @property
    def covariance_of_data(self) -> FloatArray:
        """Covariance of the physical values, (n_params, n_params), from noise, or where that is missed from model error."""
        return self._uncertainty.spread.covariance_of_data

    @property
    def identified(self) -> np.ndarray:
        """Which parameters the data determine, (n_params,) bool."""
        return self._uncertainty.spread.identified

    @property
    def covariance(self) -> FloatArray:
        """`covariance_of_data` with the tolerances of the values that the model fixes added, (n_params, n_params)."""
        return self._uncertainty.spread.covariance


def fitted_at(modified: ModifiedModel, theta: FloatArray, cost: float, aside: float = 0.0) -> Fitted:
    """The fit at given free variables; where its misfit is beyond noise, with the misfit that tolerances leave."""
    fitted = Fitted(modified, theta, cost, aside)
    if modified.is_large or not is_beyond_noise(fitted) or modified.fixed_values is None:
        return fitted
    within = modified.fixed_values.refit(modified.target.names, theta, counted(modified.fixed_values.problem))
    return replace(fitted, least=within.chi_square + aside, is_beyond=within.misfits(MISFIT))


def is_beyond_noise(fitted: Fitted, counts_left_out: bool = False) -> bool:
    """True where a fit leaves more misfit than chance makes of noise, with fixed values as they are.

    Data that the fit leaves out count only where `counts_left_out`.
    """
    target = fitted.modified.target
    dof = target.n_data - n_parameters(fitted.modified)
    cost = fitted.cost if counts_left_out else fitted.cost - fitted.aside
    return dof > 0 and misfit_probability(target, cost, dof) < MISFIT


def n_parameters(modified: ModifiedModel) -> int:
    """Parameters of a modified model, and those that its changes have besides."""
    return len(modified.target.names) + sum(change.candidate.n_own for change in modified.changes)


class Fit(TypedDict, total=False):
    """What a fit of a change gave, in numbers and texts: of `fit_near` free variables and misfit, of `fit_fully` all.

    Empty where there is no model with the change.
    """

    theta: FloatArray
    cost: float
    aside: float
    least: float
    is_beyond: bool
    where: list[str]
    strength: float


#: A candidate and its strength.
Sized = tuple[Candidate, float]
#: A change, its strength, and the misfit above which it is of no use.
Near = tuple[Candidate, float, float]
#: A change, its strength, and free variables to fit it from.
Item = tuple[Candidate, float, FloatArray]


def fit_near(base: Fitted, change: Near, tools: Tools) -> Fit:
    """Free variables and misfit of a quick fit with a change, parameters held near their start; empty if impossible.

    The misfit is only known to be above the one given where it would end there.
    """
    candidate, strength, above = change
    try:
        modified = base.modified.changed(candidate, strength)
        near = modified.fit_near(above - base.aside)
        cost = near.cost + base.aside + _left_out(base, modified, near.theta, is_near=True)
        return {"theta": near.theta, "cost": cost}
    except (StructidError, np.linalg.LinAlgError):
        return {}  # not a cause that could be offered


def fit_fully(base: Fitted, item: Item, tools: Tools) -> Fit:
    """The fit of a change as the options ask for, started at its quick fit; empty where no model has the change."""
    candidate, strength, theta = item
    try:
        if isinstance(candidate, OtherState) and not _fits_alone(base, candidate):
            return {}
        fitted = _finally(base, base.modified.changed(candidate, strength), theta)
        return {} if isinstance(candidate, SensorGain | LoadGain) and _is_no_gain(base, fitted) else _stored(fitted)
    except (StructidError, np.linalg.LinAlgError):
        return {}


def _is_no_gain(base: Fitted, found: Fitted) -> bool:
    """True where the fitted gain is so far from 1 that it only leaves the channel out, and is that of no unit."""
    candidate = found.cause
    assert isinstance(candidate, SensorGain | LoadGain)
    added = [value for name, value in found.values.items() if name not in base.values and value > 0]
    return any(abs(np.log(value)) > np.log(MOST_GAIN) and not candidate.mistaken_unit(value) for value in added)


def reuse_equivalent_fit(base: Fitted, item: tuple[Task, Near | Item, Fit], tools: Tools) -> Fit:
    """The fit of a candidate, taken from an equivalent candidate if the misfit is the same there; else a fit of its own.

    Changes at mirrored positions of a symmetric structure have the same fit.

    Parameters
    ----------
    base : Fitted
    item : (task, item, dict)
        `fit_near` or `fit_fully`, its argument (candidate, strength), and its result for the equivalent candidate.
    tools : Tools
    """
    task, (candidate, strength, *_), first = item
    try:
        modified = base.modified.changed(candidate, first.get("strength", strength))
        residual = (modified.target if "strength" in first else modified.anchored()).residual(first["theta"])
        if abs(residual @ residual + base.aside - first["cost"]) <= SAME_MISFIT * first["cost"]:
            return {**first, "where": list(candidate.where)}
    except (StructidError, np.linalg.LinAlgError, KeyError):
        pass
    found: Fit = task(base, item[1], tools)
    return found


def _fits_alone(base: Fitted, candidate: Candidate) -> bool:
    """True where the model fits the candidate's record by itself, with values of its own, as another state.

    Without one of two records little is left to misfit, whatever is wrong with the model.
    """
    assert candidate.record is not None
    own = base.modified.problems[candidate.record]
    start = base.theta[indices_of(base.modified.target.names, own.names)]
    found = base.modified.minimize(own, FINAL, start)
    return float(found.costs[-1]) < OTHER_STATE_MISFIT * max(own.n_data - len(own.names), 1)


def _stored(found: Fitted) -> Fit:
    """A fit of one more change as numbers and texts."""
    candidate, strength, _ = found.modified.changes[-1]
    return {
        "where": list(candidate.where), "strength": float(strength), "theta": found.theta, "cost": found.cost,
        "aside": found.aside, "least": found.misfit, "is_beyond": found.is_beyond,
    }  # fmt: skip


def load_fit(base: Fitted, candidate: Candidate, stored: Fit) -> Fitted:
    """The fit of a candidate, made again from what `fit_fully` gave."""
    modified = base.modified.changed(replace(candidate, where=tuple(stored["where"])), float(stored["strength"]))
    return Fitted(
        modified, np.asarray(stored["theta"]), float(stored["cost"]), float(stored["aside"]),
        None if stored["least"] == stored["cost"] else float(stored["least"]), bool(stored["is_beyond"]),
    )  # fmt: skip


def _finally(base: Fitted, modified: ModifiedModel, theta: FloatArray) -> Fitted:
    """The fit of a changed model as the options ask for, from some starts; outlying lines and tones are found again."""
    starts = [theta, modified.theta_of(base.values)]
    if modified.changes[-1].candidate.begins_at_start:
        starts.append(np.asarray(modified.target.theta_start))
    found = modified.fitted(starts)
    modified, found = _stronger(base, modified, found)
    for _ in range(MOST_PASSES):
        again = _other_lines(base, modified, found.theta)
        if again is None:
            break
        modified = again
        found = modified.fitted([modified.theta_of(base.values)])
    aside = base.aside + _left_out(base, modified, found.theta)
    return fitted_at(modified, found.theta, float(found.costs[-1]) + aside, aside)


def _stronger(base: Fitted, modified: ModifiedModel, found: Minimum) -> tuple[ModifiedModel, Minimum]:
    """The best fit over several strengths, for candidates whose strength is no parameter or has far minima."""
    candidate, strength, _ = modified.changes[-1]
    for step in candidate.other_strengths:
        for factor in (step, 1 / step):
            q = strength * factor
            if not candidate.bounds[0] < q < candidate.bounds[1]:
                continue
            try:
                other = base.modified.changed(candidate, q)
                again = other.fitted([other.theta_of({**base.values, **_values(modified, found.theta, base)})])
            except (StructidError, np.linalg.LinAlgError):
                continue
            if again.costs[-1] < found.costs[-1]:
                modified, found = other, again
        strength = modified.changes[-1][1]
    return modified, found


def _values(modified: ModifiedModel, theta: FloatArray, base: Fitted) -> dict[str, float]:
    """Of a modified's parameters those that the study has as it is."""
    return {name: value for name, value in modified.values(theta).items() if name in base.modified.target.names}


def _other_lines(base: Fitted, modified: ModifiedModel, theta: FloatArray) -> ModifiedModel | None:
    """The model with the lines or tones that stand out from its fit; None where they are those of the candidate."""
    candidate, strength, _ = modified.changes[-1]
    if not isinstance(candidate, OutlyingLines | Tone) or len(base.modified.problems) > 1:
        return None
    [problem], [changed] = base.modified.problems, modified.problems
    spans: tuple[str, ...] = ()
    if isinstance(problem, FrfProblem):
        spans = outlying_spans(problem, _seen_from(base, modified, theta, base.modified.target)[: problem.n_data])
    elif isinstance(changed, SpectraProblem):
        more = tones(changed, changed.residual(theta)[: changed.n_data])
        spans = (*candidate.where, *more) if more else ()
    if not spans or spans == candidate.where:
        return None
    return base.modified.changed(replace(candidate, where=spans), strength)


def _seen_from(base: Fitted, modified: ModifiedModel, theta: FloatArray, of: Problem) -> FloatArray:
    """The residual of `of`, which has all data of `base`, at what a modified found."""
    return of.residual(base.modified.theta_of({**base.values, **modified.values(theta)}))


def _left_out(base: Fitted, modified: ModifiedModel, theta: FloatArray, is_near: bool = False) -> float:
    """Misfit of the data that the last change leaves out; with `is_near` in the form of the quick fit.

    Their errors are larger by the likeliest factor.
    """
    candidate = modified.changes[-1].candidate
    if not candidate.leaves_data_out:
        return 0.0
    problems = base.modified.anchored_problems() if is_near else base.modified.problems
    rows = rows_left_out(candidate, problems)
    residual = _seen_from(base, modified, theta, joint_problem(problems))[: len(rows)]
    return scaled_misfit(float(residual[rows] @ residual[rows]), int(rows.sum()))

"""Fits of changed models: quick ones near the start, and full ones; each is a task that may run in another process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import StructidError
from structid.diagnose.causes import OutlyingLines, Tone, rows_left_out
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.gain import MOST_GAIN, Gain
from structid.diagnose.causes.record_left_out import OtherState
from structid.diagnose.data_rows import outlying_spans, scaled_misfit, tones
from structid.diagnose.modified_model import FINAL, ModifiedModel, NearFit
from structid.diagnose.search_budget import SearchEndedError, count_effort
from structid.diagnose.thresholds import (
    MISFIT,
    MOST_PASSES,
    OTHER_STATE_MISFIT,
    SAME_MISFIT,
)
from structid.forward import FrfProblem
from structid.forward.time import compares_spectra
from structid.identification.joint_problem import indices_of, joint_problem
from structid.inversion import Problem
from structid.inversion.diagnostics.residual_tests import misfit_probability
from structid.inversion.estimate import ParameterValues, parameters_at
from structid.inversion.fixed_values import FitWithinTolerances
from structid.inversion.search.least_squares import Minimum
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import Task, TaskContext
from structid.inversion.uncertainty import Uncertainty, dense_uncertainty


@dataclass(frozen=True, eq=False)
class ToleranceTest:
    """Outcome of a fit with all fixed values free within their tolerances, where noise alone does not explain a misfit.

    Attributes
    ----------
    chi_square : float
        Sum of squares of the data and of the fixed values in tolerances.
    is_rejected : bool
        True where noise and tolerances leave as much with less than the probability `MISFIT`.
    theta : (n_params + n_fixed,) float array, optional
        Free variables of that fit, fixed values last, where they are known.
    """

    chi_square: float
    is_rejected: bool
    theta: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Fit of a model, unchanged or with changes.

    Attributes
    ----------
    modified : ModifiedModel
    theta : (n_params,) float array
    chi_square : float
        Sum of squares, fixed values as they are.
    left_out : float
        The part of `chi_square` that belongs to data which a change leaves out, with errors larger by the likeliest factor.
    tolerance_test : ToleranceTest, optional
        None where noise alone explains the misfit, or the model fixes nothing.
    """

    modified: ModifiedModel
    theta: FloatArray
    chi_square: float
    left_out: float = 0.0
    tolerance_test: ToleranceTest | None = None

    @property
    def misfit(self) -> float:
        """The sum of squares by which fits are compared: `chi_square`, or that of the tolerance test where there is one."""
        return self.chi_square if self.tolerance_test is None else self.tolerance_test.chi_square

    @property
    def is_misfit(self) -> bool:
        """True if the fit leaves more than noise and the tolerances of fixed values make by chance."""
        return is_beyond_noise(self) if self.tolerance_test is None else self.tolerance_test.is_rejected

    @property
    def cause(self) -> Candidate:
        """The candidate of the last change; there must be a change."""
        return self.modified.changes[-1].candidate

    @property
    def values(self) -> dict[str, float]:
        """Identified values in SI units by parameter name, at `theta`."""
        return self.modified.values(self.theta)

    @cached_property
    def near(self) -> NearFit | None:
        """The quick fit of the same model, all its stages, computed at the first call; None where it fails."""
        try:
            return self.modified.fit_near()
        except (StructidError, np.linalg.LinAlgError):
            return None

    @property
    def near_path(self) -> tuple[dict[str, float], ...]:
        """Physical values, by name, at the end of each stage of the quick fit of the same model; none where it fails."""
        return () if self.near is None else tuple(self.modified.values(theta) for theta in self.near.path)

    @property
    def near_theta(self) -> FloatArray:
        """Free variables (n_params,) at the end of the quick fit of the same model, or of the start where it fails."""
        return self.modified.theta_of(self.near_path[-1] if self.near_path else {})

    @property
    def parameters(self) -> ParameterValues:
        """All parameters, those of the changes among them, with their values."""
        return parameters_at(self.modified.target, self.theta)

    @cached_property
    def _uncertainty(self) -> Uncertainty:
        """Uncertainty of the fitted parameters: from noise or model error, and from tolerances of fixed values."""
        target, fixed_values, columns = self.modified.target, self.modified.fixed_values, None
        if fixed_values is not None:
            columns = fixed_values.sensitivities_at(target.names, self.theta, self._within_tolerances(fixed_values))
        return dense_uncertainty(target, self.theta, target.linearize(self.theta), True, MISFIT, columns)

    def _within_tolerances(self, fixed_values: FixedValues) -> FitWithinTolerances | None:
        """Fit with fixed values free within tolerances, behind the tolerance test of this fit; None without a test.

        It is computed again: at the free variables that the test has stored, or by a new search if it has none.
        `fixed_values` are those of the fitted model.
        """
        names, test = self.modified.target.names, self.tolerance_test
        if test is None:
            return None
        if test.theta is None:
            return fixed_values.refit(names, self.theta, self.chi_square - self.left_out)
        return fixed_values.fit_at(test.theta, names)

    @property
    def covariance_of_data(self) -> FloatArray:
        """Covariance of the physical values, (n_params, n_params), from noise, or from model error where noise is exceeded."""
        return self._uncertainty.spread.covariance_of_data

    @property
    def identified(self) -> np.ndarray:
        """Mask (n_params,) of the parameters that the data determine."""
        return self._uncertainty.spread.identified

    @property
    def covariance(self) -> FloatArray:
        """`covariance_of_data` with the tolerances of the values that the model fixes added, (n_params, n_params)."""
        return self._uncertainty.spread.covariance


def fitted_at(modified: ModifiedModel, theta: FloatArray, chi_square: float, left_out: float = 0.0) -> FittedModel:
    """`FittedModel` at free variables `theta` (n_params,), with a tolerance test if its misfit is beyond noise.

    `chi_square` is its sum of squares, in which `left_out`, the misfit of data that it leaves out, is included. The
    test fits once more with fixed values free within their tolerances, first on fewer lines. Models of more than 1200
    degrees of freedom, and those without fixed values, have none. `modified` is the fitted model.
    """
    fitted = FittedModel(modified, theta, chi_square, left_out)
    fixed_values = modified.fixed_values
    if modified.is_large or fixed_values is None or not is_beyond_noise(fitted):
        return fitted
    start, names, kept = None, modified.target.names, chi_square - left_out
    if modified.coarse is not modified and (coarse := modified.coarse.fixed_values) is not None:
        part = modified.coarse.target.n_data / modified.target.n_data
        start = coarse.refit(names, theta, part * kept, count_effort(coarse.problem)).theta
    within = fixed_values.refit(names, theta, kept, count_effort(fixed_values.problem), start)
    test = ToleranceTest(within.chi_square + left_out, within.misfits(MISFIT), within.theta)
    return replace(fitted, tolerance_test=test)


def is_beyond_noise(fitted: FittedModel, counts_left_out: bool = False) -> bool:
    """True if noise leaves so much misfit with a probability below 0.001, with fixed values as they are.

    Data that the fit leaves out count only with `counts_left_out`. False without degrees of freedom.
    """
    target = fitted.modified.target
    dof = target.n_data - n_parameters(fitted.modified)
    chi_square = fitted.chi_square if counts_left_out else fitted.chi_square - fitted.left_out
    return dof > 0 and misfit_probability(target, chi_square, dof) < MISFIT


def n_parameters(modified: ModifiedModel) -> int:
    """Number of parameters of a modified model: its unknowns, and those that its changes fit without an unknown."""
    return len(modified.target.names) + sum(change.candidate.n_own for change in modified.changes)


class StoredFit(TypedDict, total=False):
    """A fit of a change in numbers and texts, as it goes between processes and into checkpoints.

    Near fits have `theta`, `chi_square` and `costs` alone. It is empty where there is no model with the change, or its near
    fit was left for better ones.
    """

    theta: FloatArray
    chi_square: float
    #: Sum of squares at the end of each stage of a near fit, (n_stages,).
    costs: FloatArray
    left_out: float
    where: list[str]
    strength: float
    #: Of the tolerance test, where there is one.
    chi_square_within: float
    theta_within: FloatArray
    is_rejected: bool


#: A candidate and its strength.
CandidateOfStrength = tuple[Candidate, float]
#: A candidate, its strength, and the sums of squares of its stages from which on its near fit is of no use, if any.
NearFitTask = tuple[Candidate, float, tuple[float, ...]]
#: A candidate, its strength, and free variables to fit it from.
RefitTask = tuple[Candidate, float, FloatArray]


def fit_near(base: FittedModel, change: NearFitTask, tools: TaskContext) -> StoredFit:
    """Quick fit of a change to `base`, parameters kept near their start, as a dict; empty if no model has the change.

    `change` is the candidate, its strength, and the limit of the sum of squares for each stage (no limits if empty). A
    fit that would not get below its last limit ends early, and its sum of squares is then only known to be above that;
    the dict is empty too where an earlier stage ends above its limit. Keys are ``theta`` (free variables),
    ``chi_square`` (with the misfit of data left out) and ``costs`` (of the stages). `tools` is not used.
    """
    candidate, strength, limits = change
    try:
        modified = base.modified.changed(candidate, strength)
        near = modified.fit_near(limits, base.near_path)
        left_out = base.left_out + _misfit_left_out(base, modified, near.theta, is_near=True)
        return {"theta": near.theta, "chi_square": near.chi_square + left_out, "costs": np.array(near.costs)}
    except (StructidError, np.linalg.LinAlgError):
        return {}  # not a cause that could be offered


def fit_fully(base: FittedModel, item: RefitTask, tools: TaskContext) -> StoredFit:
    """Full fit of a change to `base`, as the options of the identification ask for; an empty dict where it fails.

    `item` is the candidate, its strength and the free variables of its quick fit, where the fit starts. Gains that only
    leave a channel out, and records of another state that the model does not fit alone, give an empty dict as well.
    `tools` is not used.
    """
    candidate, strength, theta = item
    try:
        if isinstance(candidate, OtherState) and not _fits_alone(base, candidate):
            return {}
        fitted = _fit_to_the_end(base, base.modified.changed(candidate, strength), theta)
        return {} if isinstance(candidate, Gain) and _is_no_gain(base, fitted) else _stored(fitted)
    except (StructidError, np.linalg.LinAlgError):
        return {}


def _is_no_gain(base: FittedModel, fitted: FittedModel) -> bool:
    """True if a fitted channel gain is above 30 or below 1/30, and is not the factor of a mistaken unit.

    Gains are the positive parameters that `fitted` has and `base` has not.
    """
    candidate = fitted.cause
    assert isinstance(candidate, Gain)
    added = [value for name, value in fitted.values.items() if name not in base.values and value > 0]
    return any(abs(np.log(value)) > np.log(MOST_GAIN) and not candidate.mistaken_unit(value) for value in added)


def fit_mirrored(
    base: FittedModel, item: tuple[Task, NearFitTask | RefitTask, StoredFit], tools: TaskContext
) -> StoredFit:
    """Fit of a change that may mirror another: the other's fit if the misfit there is equal, else a fit by the task.

    Changes at mirrored positions of a symmetric structure have equal fits, which one residual shows: the sums of
    squares must agree to a part of 1e-9; where the residual cannot be made, the task is run too. A dict as of the task.

    Parameters
    ----------
    base : FittedModel
    item : (task, item, StoredFit)
        `fit_near` or `fit_fully`, its argument, and the fit of the other change.
    tools : TaskContext
        Passed on to the task.
    """
    task, (candidate, strength, *_), other = item
    try:
        modified = base.modified.changed(candidate, other.get("strength", strength))
        target = modified.target if "strength" in other else modified.anchored()
        if len(other["theta"]) == len(target.names):  # the screen also takes changes of other parameters for alike
            residual = target.residual(other["theta"])
            if abs(residual @ residual + base.left_out - other["chi_square"]) <= SAME_MISFIT * other["chi_square"]:
                mirrored: StoredFit = {**other, "where": list(candidate.where)}
                mirrored.pop("theta_within", None)  # fixed values within tolerances are mirrored too
                return mirrored
    except (StructidError, np.linalg.LinAlgError, KeyError):
        pass
    own: StoredFit = task(base, item[1], tools)
    return own


def _fits_alone(base: FittedModel, candidate: Candidate) -> bool:
    """True if the model fits the candidate's record alone to a chi-square per degree of freedom below 2.

    The search starts from the values of `base`. The record then has values different from those of the other records,
    as of another state of the structure.
    """
    assert candidate.record is not None
    problem = base.modified.problems[candidate.record]
    start = base.theta[indices_of(base.modified.target.names, problem.names)]
    minimum = base.modified.minimize(problem, FINAL, start)
    return float(minimum.costs[-1]) < OTHER_STATE_MISFIT * max(problem.n_data - len(problem.names), 1)


def _stored(fitted: FittedModel) -> StoredFit:
    """Numbers and texts of a fit and its last change, for a checkpoint.

    Keys are ``where``, ``strength``, ``theta``, ``chi_square`` and ``left_out``; if the free variables of its tolerance
    test are known, also ``chi_square_within``, ``theta_within`` and ``is_rejected``.
    """
    candidate, strength, _ = fitted.modified.changes[-1]
    stored: StoredFit = {
        "where": list(candidate.where), "strength": float(strength), "theta": fitted.theta,
        "chi_square": fitted.chi_square, "left_out": fitted.left_out,
    }  # fmt: skip
    test = fitted.tolerance_test
    if test is not None and test.theta is not None:
        stored |= {"chi_square_within": test.chi_square, "theta_within": test.theta, "is_rejected": test.is_rejected}
    return stored


def restore_fit(base: FittedModel, candidate: Candidate, stored: StoredFit) -> FittedModel:
    """`FittedModel` of a candidate, its changed model included, from `stored`, what `fit_fully` returned.

    `stored` must not be empty. If it is of a mirrored position, its position counts instead of the candidate's. `base`
    is the fit before the change.
    """
    where = tuple(stored["where"])
    if where != candidate.where:  # the candidate itself has its model in the cache
        candidate = replace(candidate, where=where)
    modified = base.modified.changed(candidate, float(stored["strength"]))
    test = None
    if "chi_square_within" in stored:
        theta = np.asarray(stored["theta_within"]) if "theta_within" in stored else None
        test = ToleranceTest(float(stored["chi_square_within"]), bool(stored["is_rejected"]), theta)
    return FittedModel(
        modified, np.asarray(stored["theta"]), float(stored["chi_square"]), float(stored["left_out"]), test
    )


def _fit_to_the_end(base: FittedModel, modified: ModifiedModel, theta: FloatArray) -> FittedModel:
    """Full fit of a changed model: the best of those from `theta` (n_params,) and from the values of `base`.

    Candidates with `begins_at_start` are fitted from the start values too. Starts are compared on fewer lines, and so
    are other strengths where the kind of change asks for them; all starts count where the best cannot be evaluated on
    all lines. Outlying lines and tones are searched for again after the fit, up to four times. The misfit of data that
    the change leaves out is added. `modified` is that model, and `base` the fit without its last change.

    Raises
    ------
    StructidError
        If no start can be evaluated, or the limits of the fit are reached.
    """
    starts = [theta, modified.theta_of(base.values)]
    if modified.changes[-1].candidate.begins_at_start:
        starts.append(np.asarray(modified.target.theta_start))
    first = modified
    modified, coarse = _try_other_strengths(base, modified, modified.fitted_on_fewer_lines(starts))
    try:
        minimum = modified.fitted([coarse.theta])
    except StructidError as error:
        if isinstance(error.__cause__, SearchEndedError):
            raise
        minimum = modified.fitted(starts if modified is first else [modified.theta_of(base.values)])
    for _ in range(MOST_PASSES):
        again = _with_other_lines(base, modified, minimum.theta)
        if again is None:
            break
        modified = again
        minimum = modified.fitted([modified.theta_of(base.values)])
    left_out = base.left_out + _misfit_left_out(base, modified, minimum.theta)
    return fitted_at(modified, minimum.theta, float(minimum.costs[-1]) + left_out, left_out)


def _try_other_strengths(base: FittedModel, modified: ModifiedModel, minimum: Minimum) -> tuple[ModifiedModel, Minimum]:
    """Best fit on fewer lines over several strengths of the last change: the model with that strength, and its minimum.

    Each factor of the candidate's `other_strengths`, and its inverse, is tried on the best strength so far, within the
    bounds; those at which the model fails are skipped. `modified` and `minimum` themselves where none is better, and
    for candidates without `other_strengths`. `base` is the fit before the change, whose values are starts.
    """
    candidate, strength, _ = modified.changes[-1]
    for step in candidate.other_strengths:
        for factor in (step, 1 / step):
            q = strength * factor
            if not candidate.bounds[0] < q < candidate.bounds[1]:
                continue
            try:
                other = base.modified.changed(candidate, q)
                start = other.theta_of({**base.values, **_values_in_study(modified, minimum.theta, base)})
                again = other.fitted_on_fewer_lines([start])
            except (StructidError, np.linalg.LinAlgError):
                continue
            if again.costs[-1] < minimum.costs[-1]:
                modified, minimum = other, again
        strength = modified.changes[-1][1]
    return modified, minimum


def _values_in_study(modified: ModifiedModel, theta: FloatArray, base: FittedModel) -> dict[str, float]:
    """Values in SI units, by name, of the parameters that a changed model has in common with the model of `base`.

    `theta` (n_params,) are the free variables of the changed model `modified`.
    """
    return {name: value for name, value in modified.values(theta).items() if name in base.modified.target.names}


def _with_other_lines(base: FittedModel, modified: ModifiedModel, theta: FloatArray) -> ModifiedModel | None:
    """Model with the last change replaced by one for the outlying lines or tones that show after its fit at `theta`.

    Outlying lines replace those before; tones are added to them. None where these are the same as before or there are
    none, for every other kind of candidate, and for several records. `theta` is (n_params,). `modified` is the changed
    model, and `base` the fit without the change.
    """
    candidate, strength, _ = modified.changes[-1]
    if not isinstance(candidate, OutlyingLines | Tone) or len(base.modified.problems) > 1:
        return None
    [problem], [changed] = base.modified.problems, modified.problems
    spans: tuple[str, ...] = ()
    if isinstance(problem, FrfProblem):
        residual = _residual_of_all_data(base, modified, theta, base.modified.target)
        spans = outlying_spans(problem, residual[: problem.n_data])
    elif compares_spectra(changed):
        more = tones(changed, changed.residual(theta)[: changed.n_data])
        spans = (*candidate.where, *more) if more else ()
    if not spans or spans == candidate.where:
        return None
    return base.modified.changed(replace(candidate, where=spans), strength)


def _residual_of_all_data(
    base: FittedModel, modified: ModifiedModel, theta: FloatArray, problem: Problem
) -> FloatArray:
    """The residual (n_rows,) of `problem`, which has all data of `base`, at the values of a changed model's `theta`."""
    return problem.residual(base.modified.theta_of({**base.values, **modified.values(theta)}))


def _misfit_left_out(base: FittedModel, modified: ModifiedModel, theta: FloatArray, is_near: bool = False) -> float:
    """Misfit of the data that the last change leaves out, with errors larger by the likeliest factor.

    With the sum of squares S of n whitened residuals it is n (1 + ln(S / n)), or S if that is at most n. 0 if the
    change leaves none out. `theta` holds the free variables of the changed model `modified`. With `is_near` the misfit
    is that of the quick fit's problems. `base` is the fit before the change.
    """
    candidate = modified.changes[-1].candidate
    if not candidate.leaves_data_out:
        return 0.0
    problems = base.modified.anchored_problems() if is_near else base.modified.problems
    rows = rows_left_out(candidate, problems)
    residual = _residual_of_all_data(base, modified, theta, joint_problem(problems))[: len(rows)]
    return scaled_misfit(float(residual[rows] @ residual[rows]), int(rows.sum()))

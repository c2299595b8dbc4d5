"""Which single changes of model or record would explain a misfit: screened by the hundreds, refitted by the dozen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from structid.arrays import FloatArray
from structid.criticism.data import (
    DATA_KINDS,
    changed_rows,
    data_candidates,
    extra_modes,
    outlying,
    outlying_lines,
    scaled_misfit,
)
from structid.criticism.pool import pool
from structid.criticism.screen import Point, Screened, point_at
from structid.errors import StructidError
from structid.estimation import JointProblem
from structid.estimation.search.least_squares import minimize
from structid.estimation.search.minimum import Minimum
from structid.estimation.uncertainty import dense_uncertainty
from structid.explanation.by_study import study_candidates
from structid.explanation.trial import QUICK, Trial
from structid.identification.setups import titles
from structid.observation import FrfProblem

_FIRST, _OF_EACH_KIND, _REFITTED, _FINALISTS = 6, 2, 30, 8
_LEAST_DROP = 0.02
_MOST_PASSES = 4
#: Probability of a misfit below which noise alone is not its cause, and a second cause is looked for.
_MISFIT = 1e-3
#: Kinds that are always refitted to the end: smoothed data do not show them.
_ALWAYS = ("friction",)
#: Factors on the strength of kinds whose strength is no parameter, or has far minima.
_OTHER_STRENGTHS = {"direction": (1.6, 1.25, 1.1, 1.04, 1.015), "friction": (3.0, 2.0)}
#: Part of the misfit that a first cause leaves at most where one more is looked for.
_CLEAR = 0.5
#: Of the sum of squares, what another start must reach.
_CLEARLY_BETTER = 0.9
_SCREENED_LEVELS = (0.12, 0.06, 0.015)
#: Differences of the criterion below which two causes cannot be told apart.
ALIKE = 6.0
_LEAST_SHARE, _RISK = 0.10, 0.01

Told = Callable[[str, int, int], None]


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
        found = dense_uncertainty(target, self.theta, target.linearize(self.theta), True, _MISFIT)
        return (found.model_error if found.misfit else found.noise).matrix


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found.

    Attributes
    ----------
    base : Fitted
        The study as it is, or with the first cause.
    causes : tuple of Fitted
        Accepted changes, the likeliest first; those within `ALIKE` of the first cannot be told from it.
    criteria : tuple of float
        Of each cause: chi-square over its scale plus a price for each parameter.
    tried : int
        How many candidates there were.
    near : tuple of Fitted
        Changes, accepted or not, within `ALIKE` of the likeliest model, that as it is among them.
    further : Explanation, optional
        Of what the first cause leaves.
    better : Fitted, optional
        The study as it is, from another start, where that explains the record: the search ended in a wrong place.
    """

    base: Fitted
    causes: tuple[Fitted, ...]
    criteria: tuple[float, ...]
    tried: int
    near: tuple[Fitted, ...] = ()
    further: Explanation | None = None
    better: Fitted | None = None

    @property
    def likely(self) -> tuple[Fitted, ...]:
        """All changes that may be the truth, second ones beside a first among them."""
        return self.near if self.further is None else (*self.near, *self.further.near)


def explained(base: Fitted, told: Told | None = None) -> Explanation:
    """The changes that explain the misfit of a fitted study; and where the first leaves some, a second beside it."""
    other = _from_elsewhere(base)
    if other is not None and not _is_misfit(other):
        return Explanation(base, (), (), 0, better=other)
    base = other or base
    found = _once(base, told, "causes")
    if found.causes and found.causes[0].cost < _CLEAR * base.cost and _is_misfit(found.causes[0]):
        return replace(found, further=_once(found.causes[0], told, "second causes"))
    return found


def _from_elsewhere(base: Fitted) -> Fitted | None:
    """The study as it is from the way that candidates are refitted, where that is clearly better."""
    try:
        found = base.trial.fitted([base.trial.approached()[0], base.theta])
    except (StructidError, np.linalg.LinAlgError):
        return None
    cost = float(found.costs[-1])
    return Fitted(base.trial, found.theta, cost) if cost < _CLEARLY_BETTER * base.cost else None


def _is_misfit(fitted: Fitted) -> bool:
    dof = fitted.trial.target.n_data - n_parameters(fitted.trial)
    return dof > 0 and float(special.gammaincc(dof / 2, fitted.cost / 2)) < _MISFIT


def _once(base: Fitted, told: Told | None, stage: str) -> Explanation:
    shortlist, tried = shortlisted(screening_points(base), titles(base.trial.setups))
    problems = base.trial.problems
    residual = base.trial.target.residual(base.theta)[: base.trial.target.n_data]
    data = [*extra_modes(problems), *outlying_lines(problems, residual)]
    few = [*of_study(base), *(Screened(one, 1.0, base.cost) for one in data)]
    shortlist, tried = [*few, *shortlist], tried + len(few)
    approached: list[tuple[float, Trial, FloatArray]] = []
    steps = len(shortlist) + _FINALISTS
    for number, one in enumerate(shortlist):
        if told is not None:
            told(stage, number, steps)
        try:
            trial = base.trial.changed(one.candidate, one.strength)
            theta, cost = trial.approached()
        except (StructidError, np.linalg.LinAlgError):
            continue  # no place in this study, or no model with it: not a cause that could be offered
        approached.append((cost + base.aside + left_out(base, trial, theta), trial, theta))
    approached.sort(key=lambda one: one[0])
    always = [one for one in approached if one[1].changes[-1][0].kind in _ALWAYS][:_OF_EACH_KIND]
    finalists = [*always, *(one for one in approached if one[1].changes[-1][0].kind not in _ALWAYS)][:_FINALISTS]
    fits = []
    for number, (_, trial, theta) in enumerate(finalists):
        if told is not None:
            told(stage, len(shortlist) + number, steps)
        with suppress(StructidError):
            fits.append(_finally(base, trial, theta))
    if told is not None:
        told(stage, steps, steps)
    scale = _scale(base, fits)
    priced = sorted(((one, _criterion(base, one, scale)) for one in fits), key=lambda pair: pair[1])
    causes = [(one, criterion) for one, criterion in priced if _is_worth(base, one, scale, tried)]
    likeliest = min([_criterion(base, base, scale), *(criterion for _, criterion in priced)])
    near = tuple(one for one, criterion in priced if criterion - likeliest < ALIKE)
    return Explanation(base, tuple(one for one, _ in causes), tuple(c for _, c in causes), tried, near)


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
    aside = base.aside + left_out(base, trial, found.theta)
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
    """The trial with all lines that stand out from its fit left out; None where these are the ones."""
    candidate, strength = trial.changes[-1]
    if candidate.kind != "outlying_lines" or len(base.trial.problems) > 1:
        return None
    residual = _seen_from(base, trial, theta)
    [problem] = base.trial.problems
    spans = outlying(problem, residual[: problem.n_data]) if isinstance(problem, FrfProblem) else ()
    if not spans or spans == candidate.where:
        return None
    return base.trial.changed(replace(candidate, where=spans), strength)


def _seen_from(base: Fitted, trial: Trial, theta: FloatArray) -> FloatArray:
    """The residual of all data of `base` at what a trial found."""
    return base.trial.target.residual(base.trial.theta_of({**base.values, **trial.values(theta)}))


def of_study(base: Fitted) -> Iterator[Screened]:
    """Changes of sets and of the mesh that lower the misfit by one linear step at the fit or at the anchored fit."""
    for candidate in study_candidates(base.trial):
        strength = float(candidate.strengths[0])
        try:
            trial = base.trial.changed(candidate, strength)
            theta = trial.theta_of(base.values)
            at = trial.target.linearize(theta)
        except (StructidError, np.linalg.LinAlgError):
            continue
        basis = np.linalg.qr(at.jacobian)[0]
        left = float(at.residual @ at.residual - np.sum((basis.T @ at.residual) ** 2))
        if left < (1 - _LEAST_DROP) * base.cost or candidate.kind in ("mesh", "shear", "window"):
            yield Screened(candidate, strength, left)


def left_out(base: Fitted, trial: Trial, theta: FloatArray) -> float:
    """What data that the last change leaves out add to the misfit, their errors larger by the likeliest factor."""
    candidate = trial.changes[-1][0]
    if candidate.kind not in DATA_KINDS:
        return 0.0
    rows = changed_rows(candidate, base.trial.problems)
    residual = _seen_from(base, trial, theta)[: len(rows)]
    return scaled_misfit(float(residual[rows] @ residual[rows]), int(rows.sum()))


def screening_points(base: Fitted) -> list[Point]:
    """Where candidates are screened: on smoothed data, at the anchored fit, and at the fit."""
    trial, points = base.trial, []
    theta = np.asarray(trial.target.theta_start)
    for level, stage in trial.smoothed():
        theta = minimize(stage, QUICK, theta).theta
        if level in _SCREENED_LEVELS:
            points.append(point_at(_frfs(stage), theta))
    theta = minimize(trial.anchored(), QUICK, theta).theta
    points.append(point_at(trial.anchored_views(), theta))
    points.append(point_at(trial.views, base.theta))
    return points


def _frfs(stage: JointProblem) -> tuple[FrfProblem, ...]:
    return tuple(part for part in stage.problems if isinstance(part, FrfProblem))


def shortlisted(points: list[Point], names: Sequence[str]) -> tuple[list[Screened], int]:
    """Of every point the best candidates, and the best of each kind; each once, the most telling first."""
    best: dict[tuple[object, ...], tuple[float, Screened]] = {}
    tried = 0
    for point in points:
        candidates = pool(point.records)
        problems = [fields.problem for fields in point.records]
        data = list(data_candidates(problems, names))
        tried = max(tried, len(candidates) + len(data))
        base, kinds = point.left, dict[str, int]()
        rows = [point.screened(candidate) for candidate in candidates]
        rows += [Screened(one, 1.0, point.without(changed_rows(one, problems))) for one in data]
        rows.sort(key=lambda row: row.left)
        seen: set[tuple[object, ...]] = set()
        place = 0
        for row in rows:
            drop = 1 - row.left / base
            if drop <= _LEAST_DROP:
                break
            key = (row.candidate.kind, row.candidate.where, row.candidate.record, *row.candidate.others[:1])
            if key in seen:
                continue  # an appendage of another frequency at the same place
            seen.add(key)
            count = kinds.setdefault(row.candidate.kind, 0)
            is_early = place < _FIRST or count < _OF_EACH_KIND
            if is_early and (key not in best or drop > best[key][0]):
                best[key] = (drop, row)
            kinds[row.candidate.kind] += 1
            place += 1
    _with_friction(best)
    found = sorted(best.values(), key=lambda pair: -pair[0])
    return [row for _, row in found[:_REFITTED]], tried


def _with_friction(best: dict[tuple[object, ...], tuple[float, Screened]]) -> None:
    """Beside the best dampers, friction at the same places: smoothed data show one as the other."""
    dampers = [pair for key, pair in best.items() if key[0] == "dashpot" and len(pair[1].candidate.where) == 1]
    for drop, row in sorted(dampers, key=lambda pair: -pair[0])[:_OF_EACH_KIND]:
        where = row.candidate.where
        if ("friction", where, None) not in best and row.candidate.alike is not None:
            twin = row.candidate.alike
            best["friction", where, None] = (drop, Screened(twin, float(np.median(twin.strengths)), row.left))


def _scale(base: Fitted, fits: Sequence[Fitted]) -> float:
    """Misfit that the best model leaves, per degree of freedom, one at least."""
    n_data = base.trial.target.n_data
    return max(1.0, min(one.cost / max(n_data - len(one.trial.target.names), 1) for one in (base, *fits)))


def _criterion(base: Fitted, one: Fitted, scale: float) -> float:
    return one.cost / scale + n_parameters(one.trial) * float(np.log(base.trial.target.n_data))


def _is_worth(base: Fitted, one: Fitted, scale: float, tried: int) -> bool:
    """Whether a change lowers the misfit by more than chance among all that were tried, and by a part that matters."""
    more = max(n_parameters(one.trial) - len(base.trial.target.names), 1)
    drop = base.cost - one.cost
    probability = float(special.gammaincc(more / 2, drop / scale / 2)) if drop > 0 else 1.0
    return probability * max(tried, 1) < _RISK and drop >= _LEAST_SHARE * base.cost


def n_parameters(trial: Trial) -> int:
    """Parameters of a study and of what was left out of it."""
    own = [len(c.where) if c.kind == "outlying_lines" else 1 for c, _ in trial.changes if c.kind in DATA_KINDS]
    return len(trial.target.names) + sum(own)

"""Which single changes of model or record would explain a misfit: screened by the hundreds, refitted by the dozen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from structid.arrays import FloatArray
from structid.criticism.pool import pool
from structid.criticism.screen import Point, Screened, point_at
from structid.errors import StructidError
from structid.estimation import JointProblem
from structid.estimation.search.least_squares import minimize
from structid.explanation.trial import _QUICK, Trial
from structid.observation import FrfProblem

_FIRST, _OF_EACH_KIND, _REFITTED, _FINALISTS = 6, 2, 40, 10
_LEAST_DROP = 0.02
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
    """

    trial: Trial
    theta: FloatArray
    cost: float

    @property
    def values(self) -> dict[str, float]:
        return dict(zip(self.trial.target.names, self.trial.target.physical(self.theta).tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found.

    Attributes
    ----------
    base : Fitted
        The study as it is.
    causes : tuple of Fitted
        Accepted changes, the likeliest first; those within `ALIKE` of the first cannot be told from it.
    criteria : tuple of float
        Of each cause: chi-square over its scale plus a price for each parameter.
    tried : int
        How many candidates there were.
    rejected : tuple of (str, str)
        Candidates that could not be tried, and why.
    """

    base: Fitted
    causes: tuple[Fitted, ...]
    criteria: tuple[float, ...]
    tried: int
    rejected: tuple[tuple[str, str], ...] = ()
    ranked: tuple[Fitted, ...] = field(default=())


def explained(base: Fitted, told: Told | None = None) -> Explanation:
    """The changes that explain the misfit of a fitted study."""
    points = screening_points(base)
    shortlist, tried = shortlisted(points)
    rejected: list[tuple[str, str]] = []
    approached = []
    for number, one in enumerate(shortlist):
        if told is not None:
            told("refits", number, len(shortlist))
        try:
            trial = base.trial.changed(one.candidate, one.strength)
            theta, cost = trial.approached()
        except (StructidError, np.linalg.LinAlgError) as error:
            rejected.append((f"{one.candidate.kind} {' '.join(one.candidate.where)}", str(error)))
            continue
        approached.append((cost, trial, theta))
    approached.sort(key=lambda one: one[0])
    fits = []
    for number, (_, trial, theta) in enumerate(approached[:_FINALISTS]):
        if told is not None:
            told("fits", number, min(_FINALISTS, len(approached)))
        try:
            found = trial.fitted([theta, trial.theta_of(base.values)])
        except StructidError as error:
            rejected.append((str(trial.changes[-1][0].kind), str(error)))
            continue
        fits.append(Fitted(trial, found.theta, float(found.costs[-1])))
    fits.sort(key=lambda one: one.cost)
    causes, criteria = accepted(base, fits, tried)
    return Explanation(base, causes, criteria, tried, tuple(rejected), tuple(fits))


def screening_points(base: Fitted) -> list[Point]:
    """Where candidates are screened: on smoothed data, at the anchored fit, and at the fit."""
    trial, points = base.trial, []
    if not trial.frfs:
        return []
    theta = np.asarray(trial.target.theta_start)
    for level, stage in trial.smoothed():
        theta = minimize(stage, _QUICK, theta).theta
        if level in _SCREENED_LEVELS:
            points.append(point_at(_frfs(stage), theta))
    anchored = trial.anchored()
    theta = minimize(anchored, _QUICK, theta).theta
    points.append(point_at(_frfs(anchored), theta))
    points.append(point_at(trial.frfs, base.theta))
    return points


def _frfs(problem: object) -> tuple[FrfProblem, ...]:
    parts = problem.problems if isinstance(problem, JointProblem) else (problem,)
    return tuple(part for part in parts if isinstance(part, FrfProblem))


def shortlisted(points: list[Point]) -> tuple[list[Screened], int]:
    """Of every point the best candidates, and the best of each kind; each once, the most telling first."""
    best: dict[tuple[object, ...], tuple[float, Screened]] = {}
    tried = 0
    for point in points:
        candidates = pool(point.records)
        tried = max(tried, len(candidates))
        base, kinds = point.left, dict[str, int]()
        rows = sorted((point.screened(candidate) for candidate in candidates), key=lambda row: row.left)
        seen: set[tuple[object, ...]] = set()
        place = 0
        for row in rows:
            drop = 1 - row.left / base
            if drop <= _LEAST_DROP:
                break
            key = (row.candidate.kind, row.candidate.where, row.candidate.record)
            if key in seen:
                continue  # an appendage of another frequency at the same place
            seen.add(key)
            count = kinds.setdefault(row.candidate.kind, 0)
            if place < _FIRST or count < _OF_EACH_KIND:
                if key not in best or drop > best[key][0]:
                    best[key] = (drop, row)
            kinds[row.candidate.kind] += 1
            place += 1
    found = sorted(best.values(), key=lambda pair: -pair[0])
    return [row for _, row in found[:_REFITTED]], tried


def accepted(base: Fitted, fits: list[Fitted], tried: int) -> tuple[tuple[Fitted, ...], tuple[float, ...]]:
    """Fits whose change is worth its price, the likeliest first, with their criteria."""
    if not fits:
        return (), ()
    n_data = base.trial.target.n_data
    dof = [max(n_data - len(one.trial.target.names), 1) for one in fits]
    scale = max(1.0, min(one.cost / k for one, k in zip(fits, dof, strict=True)))
    found = []
    for one in fits:
        more = len(one.trial.target.names) - len(base.trial.target.names)
        drop = base.cost - one.cost
        probability = float(special.gammaincc(max(more, 1) / 2, drop / scale / 2)) if drop > 0 else 1.0
        if probability * max(tried, 1) < _RISK and drop >= _LEAST_SHARE * base.cost:
            found.append((one.cost / scale + len(one.trial.target.names) * np.log(n_data), one))
    found.sort(key=lambda pair: pair[0])
    return tuple(one for _, one in found), tuple(float(c) for c, _ in found)


def summary(found: Explanation) -> Mapping[str, object]:
    """For people who look at it in a terminal."""
    n = found.base.trial.target.n_data
    return {
        "base": found.base.cost / n, "tried": found.tried,
        "causes": [(one.trial.changes[-1][0].kind, one.trial.changes[-1][0].where, one.cost / n) for one in found.causes],
    }  # fmt: skip

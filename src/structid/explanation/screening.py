"""What is refitted: of hundreds of changes those that lower the misfit of a linear look most."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import parse_dof
from structid.core.errors import StructidError
from structid.criticism.candidate import Candidate, bare
from structid.criticism.data import changed_rows, data_candidates, scaled_misfit
from structid.criticism.pool import exchanges, pool
from structid.criticism.screen import Point, Screened
from structid.explanation.by_study import study_candidates
from structid.explanation.refits import Change, Fitted
from structid.explanation.time_budget import UNLIMITED, TimeBudget, TimeUpError, map_within_budget, time_limit_callback
from structid.explanation.trial import QUICK
from structid.forward import FrfProblem, ModalProblem
from structid.identification.setups.setup import titles
from structid.inversion import JointProblem
from structid.inversion.search.least_squares import minimize
from structid.inversion.search.work import Tools, Work

_FIRST, _OF_EACH_KIND, _REFITTED = 6, 2, 38
#: Of those that promise most at the fit so many are fitted to the end, however a fit with 10 % of model error sees them.
_AT_FIT = 2
_LEAST_DROP = 0.02
#: Supports at most that are let go in all rotations.
_FEET = 8
#: Part of the misfit that goes with a sensor from where on it may be elsewhere, or of the other sense.
_LOST = 0.3
#: Part of the misfit of the initial model that an exchange leaves at most where it is fitted whatever else is seen.
_TOLD = 0.5
_SCREENED_LEVELS = (0.12, 0.06, 0.015)

#: Kind, place and record of a change.
_Key: TypeAlias = tuple[str, tuple[str, ...], int | None]
#: By what tells candidates apart, the part of the misfit that a linear look promises to remove, and the look.
_Promises = dict[tuple[object, ...], tuple[float, Screened]]


def of_study(base: Fitted, work: Work, name: str, budget: TimeBudget = UNLIMITED) -> list[Screened]:
    """Changes of sets and of the mesh that lower the misfit by one linear step at the fit, each with its best strength."""
    candidates = list(study_candidates(base.trial))
    changes = [(candidate, float(strength)) for candidate in candidates for strength in candidate.strengths]
    left = iter(_left_by_step(base, changes, work, name, budget))
    found = []
    for candidate in candidates:
        least, strength = min((next(left), float(strength)) for strength in candidate.strengths)
        is_kept = least < (1 - _LEAST_DROP) * base.cost or candidate.kind in ("mesh", "shear", "window")
        if is_kept and np.isfinite(least):
            found.append(Screened(candidate, strength, least))
    return found


def _left_by_step(base: Fitted, changes: Sequence[Change], work: Work, name: str, budget: TimeBudget) -> list[float]:
    """The misfit that a linear step of each changed study leaves; infinite where there is no such study, or no time for it."""
    items = [(bare(candidate), strength) for candidate, strength in changes]
    steps = map_within_budget(budget, work, name, _stepped, base, items)
    return [np.inf if step is None else step["left"] for step in steps]


def _stepped(base: Fitted, change: Change, tools: Tools) -> dict[str, float]:
    try:
        trial = base.trial.changed(*change)
        at = trial.target.linearize(trial.theta_of(base.values))
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    rest = at.triangle()[at.n_params :, -1]
    return {"left": float(rest @ rest)}


def screening_points(base: Fitted) -> list[Point]:
    """Where candidates are screened: on smoothed data, at the anchored fit, and at the fit."""
    trial, points = base.trial, []
    if trial.is_large:  # every fit costs
        start = np.asarray(trial.target.theta_start)
        return [trial.looked_at(trial.anchored_views(), start), trial.looked_at(trial.seen, base.theta)]
    theta, stop = np.asarray(trial.target.theta_start), time_limit_callback(trial.fit_seconds)
    with suppress(TimeUpError):
        for level, stage in trial.smoothed():
            theta = minimize(stage, QUICK, theta, stop).theta
            if level in _SCREENED_LEVELS:
                points.append(trial.looked_at(_frfs(stage), theta))
        theta = minimize(trial.anchored(), QUICK, theta, stop).theta
    points.append(trial.looked_at(trial.anchored_views(), theta))
    points.append(trial.looked_at(trial.seen, base.theta))
    return points


def _frfs(stage: JointProblem) -> tuple[FrfProblem, ...]:
    return tuple(part for part in stage.problems if isinstance(part, FrfProblem))


class Shortlist(NamedTuple):
    """What came of the looks.

    `rows` are the best candidates of every point and the best of each kind, each once, the most telling first; `at_fit`
    those of them that promise most at the fit, and channels with faults of their own; `tried` is how many there were; `feet`
    are supports that give way in all rotations at once, which no linear look is taken at; `lost` are sensors without which a
    good part of the misfit is gone.
    """

    rows: list[Screened]
    at_fit: list[Screened]
    tried: int
    feet: list[Screened]
    lost: list[Screened]


def shortlisted(base: Fitted, work: Work, name: str, budget: TimeBudget = UNLIMITED) -> Shortlist:
    """The candidates that are worth a fit.

    Parameters
    ----------
    base : Fitted
    work : Work
    name : str
        What the points are called in progress and checkpoints.
    budget : TimeBudget
        Looks at the fit and at the anchored fit come first, those at smoothed data as long as there is time.
    """
    points = screening_points(base)
    names = titles(base.trial.setups)
    faulty = _faulty(base)
    told = faulty | _told(base, points)
    nearest_first = range(len(points))[::-1]
    answers = map_within_budget(budget, work, name, _looked, (tuple(points), names), nearest_first, least=1)[::-1]
    held = {dof.node for setup in base.trial.setups for dof in setup.structure.fixed}
    best, others, here = _Promises(), _Promises(), _Promises()
    tried, feet = 0, list[Screened]()
    for point, answer in zip(points, answers, strict=True):
        if answer is None:
            continue
        candidates = pool(point.records, names)
        feet = feet or _feet(candidates, base.cost)
        problems = [fields.problem for fields in point.records]
        data = list(data_candidates(problems, names))
        tried = max(tried, len(candidates) + len(data))
        whole, kinds = point.left, dict[str, int]()
        seen_left = zip(candidates, answer["strength"], answer["left"], strict=True)
        rows = [Screened(one, float(strength), float(left)) for one, strength, left in seen_left]
        rows += [Screened(one, 1.0, point.without(changed_rows(one, problems))) for one in data]
        rows.sort(key=lambda row: row.left)
        here = _Promises()
        for row in rows:
            drop = 1 - row.left / whole
            if drop <= _LEAST_DROP and not _is_told(row.candidate, told):
                continue
            key = (row.candidate.kind, row.candidate.where, row.candidate.record, *row.candidate.others[:1])
            if key in here:
                continue  # an appendage of another frequency at the same place
            kind = _family(row.candidate, held)
            count = kinds.setdefault(kind, 0)
            is_early = len(here) < _FIRST or count < _OF_EACH_KIND or _is_told(row.candidate, told)
            chosen = best if is_early else others
            here[key] = (drop, row)
            if key not in chosen or drop > chosen[key][0]:
                chosen[key] = (drop, row)
            kinds[kind] += 1
    _with_friction(best)
    found = sorted(best.values(), key=lambda pair: (not _is_told(pair[1].candidate, told), -pair[0]))
    rows = [row for _, row in found]
    if base.trial.is_of_modes:
        rows = _by_modes(base, rows + [others[key][1] for key in others if key not in best], work, name, budget)
    rows = rows[:_REFITTED]
    at_fit = [best[key][1] for key in here if key in best]
    sure = [row for row in rows if _key(row.candidate) in faulty]
    channels = [(drop, row) for drop, row in best.values() if row.candidate.kind == "channel"]
    lost = [row for drop, row in channels if drop > _LOST or row in sure or (base.trial.is_of_modes and row in rows)]
    at_fit = [*sure, *[row for row in at_fit if row in rows][:_AT_FIT]]
    return Shortlist(rows, at_fit, tried, feet, lost)


def _feet(candidates: Iterable[Candidate], left: float) -> list[Screened]:
    """Supports that hold rotations, giving way together: all of a node, as a loose bolt lets them, and all of a direction.

    Feet that are drawn clamped and turn are the commonest slip of all, and one foot of two explains half of it.
    """
    of_node: dict[int, list[Candidate]] = {}
    of_direction: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        dof = parse_dof(candidate.where[0]) if candidate.kind == "support" else None
        if dof is not None and dof.is_rotation and not candidate.driven:
            of_node.setdefault(dof.node, []).append(candidate)
            of_direction.setdefault(dof.direction, []).append(candidate)
    nodes = [group for group in of_node.values() if len(group) > 1][:_FEET]
    directions = [group for group in of_direction.values() if len(group) > 1]
    everywhere = [[candidate for group in directions for candidate in group]] if len(directions) > 1 else []
    return [
        Screened(
            replace(group[0], where=tuple(candidate.where[0] for candidate in group)),
            float(np.median(group[0].strengths)),
            left,
        )
        for group in [*directions, *everywhere, *nodes]
    ]


def _told(base: Fitted, points: Sequence[Point]) -> set[_Key]:
    """Channels that the initial model shows to be exchanged or turned: a model bent to them is far from the right one."""
    trial = base.trial
    if trial.is_of_modes:
        return set()
    # a large model is screened there first
    point = (
        points[0] if trial.is_large else trial.looked_at(trial.anchored_views(), np.asarray(trial.target.theta_start))
    )
    rows = point.screened(list(exchanges(point.records)))
    return {_key(row.candidate) for row in rows if row.left < _TOLD * point.left}


def _faulty(base: Fitted) -> set[_Key]:
    """Channels whose histories show, by themselves or by what the fit misses, that they did not measure their motion."""
    shown = {
        ("channel", (parse_dof(fault.channel.split()[0]).place,), number)
        for number, setup in enumerate(base.trial.setups)
        for fault in setup.faults
    }
    return shown | _outstanding(base)


def _outstanding(base: Fitted) -> set[_Key]:
    """Channels of histories that make a good part of the misfit: averaged FRFs hide drift and all else that no force makes."""
    problems, first, found = base.trial.problems, 0, set[_Key]()
    residual = base.trial.target.residual(base.theta)
    for number, (problem, view) in enumerate(zip(problems, base.trial.views, strict=True)):
        own = residual[first : first + problem.n_data]
        first += problem.n_data
        if isinstance(problem, FrfProblem | ModalProblem):
            continue
        for one in data_candidates([view.problem], [""]):
            rows = changed_rows(one, [problem])
            squares = float(own[rows] @ own[rows])
            if squares - scaled_misfit(squares, int(rows.sum())) > _LOST * base.cost:
                found.add(_key(replace(one, record=number)))
    return found


def _family(candidate: Candidate, held: Collection[int]) -> str:
    """Its kind; what holds one more direction of a node that is held is of a kind of its own: a pin may be a clamp."""
    is_at_support = candidate.kind == "spring" and parse_dof(candidate.where[0]).node in held
    return "clamp" if is_at_support else candidate.kind


def _key(candidate: Candidate) -> _Key:
    return candidate.kind, candidate.where, candidate.record


def _is_told(candidate: Candidate, told: Collection[_Key]) -> bool:
    """Whether a change is fitted whatever a linear look at a fit says."""
    return candidate.kind == "load_swap" or _key(candidate) in told


def _by_modes(base: Fitted, rows: Sequence[Screened], work: Work, name: str, budget: TimeBudget) -> list[Screened]:
    """Of changes that FRFs of the fit show, those that lower the misfit of the modes themselves most by a linear step.

    Modes weigh a change quite unlike the FRFs that they make up: where those promise a tenth, four fifths may go.
    """
    left = np.array(
        _left_by_step(base, [(row.candidate, row.strength) for row in rows], work, f"{name}, of modes", budget)
    )
    first = range(min(_FIRST, len(rows)))
    order = [k for k in np.argsort(left, kind="stable").tolist() if k >= len(first)]
    return [rows[k] for k in (*first, *order)]


def _looked(looks: tuple[Sequence[Point], Sequence[str]], number: int, tools: Tools) -> dict[str, FloatArray]:
    """The best strength of every candidate at a point of records with these names, and what it leaves."""
    points, names = looks
    point = points[number]
    rows = point.screened(pool(point.records, names))
    return {"strength": np.array([row.strength for row in rows]), "left": np.array([row.left for row in rows])}


def _with_friction(best: _Promises) -> None:
    """Beside the best dampers, friction at the same places: smoothed data show one as the other."""
    dampers = [pair for key, pair in best.items() if key[0] == "dashpot" and len(pair[1].candidate.where) == 1]
    for drop, row in sorted(dampers, key=lambda pair: -pair[0])[:_OF_EACH_KIND]:
        where = row.candidate.where
        if ("friction", where, None) not in best and row.candidate.alike is not None:
            twin = row.candidate.alike
            best["friction", where, None] = (drop, Screened(twin, float(np.median(twin.strengths)), row.left))

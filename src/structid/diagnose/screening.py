"""Selection of the changes to refit: of hundreds, those that lower the linearized misfit most."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import parse_dof
from structid.diagnose.causes import (
    Dashpot,
    DryFriction,
    FaultyChannel,
    SpringToGround,
    Support,
    SwappedLoads,
    data_candidates,
    exchanged_channels,
    rows_left_out,
)
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.friction import FORCES
from structid.diagnose.causes.gain import LoadGain
from structid.diagnose.data_rows import rows_of, scaled_misfit
from structid.diagnose.modified_model import QUICK
from structid.diagnose.refits import FittedModel
from structid.diagnose.score_test import Point, Screened
from structid.diagnose.search_budget import (
    UNLIMITED,
    SearchBudget,
    SearchEndedError,
    map_within_budget,
)
from structid.diagnose.set_screening import linearize_fit, screen_changes
from structid.diagnose.thresholds import (
    CERTAIN_AT_FIT,
    CHANNEL_PART,
    FIRST_OF_KIND,
    FIRST_OF_POINT,
    INITIAL_PART,
    LEAST_DROP,
    MOST_FEET,
    SCREENED_LEVELS,
    SHORTLIST,
)
from structid.forward import FrfProblem, ModalProblem
from structid.identification.setups.setup import titles
from structid.inversion import JointProblem
from structid.inversion.search.work import TaskContext, TaskExecutor

#: By the key of a candidate, the part of the misfit that a linear screening promises to remove, and the screening.
_Promises = dict[Hashable, tuple[float, Screened]]


def screening_points(base: FittedModel) -> list[Point]:
    """Linearized problems at which candidates are screened: on smoothed data, at the quick fit, and last at the fit.

    Of a large model only two, without further fits: at the start of the parameters, and at the fit. Smoothed levels after which
    a search ends at its limit are left out.
    """
    modified, points = base.modified, []
    if modified.is_large:  # every fit costs
        start = np.asarray(modified.target.theta_start)
        return [
            modified.point_at(modified.anchored_views(), start),
            modified.point_at(modified.shown_problems, base.theta),
        ]
    theta = np.asarray(modified.target.theta_start)
    with suppress(SearchEndedError):
        for level, stage in modified.smoothed():
            theta = modified.minimize(stage, QUICK, theta).theta
            if level in SCREENED_LEVELS:
                points.append(modified.point_at(_frfs(stage), theta))
        theta = modified.minimize(modified.anchored(), QUICK, theta).theta
    points.append(modified.point_at(modified.anchored_views(), theta))
    points.append(modified.point_at(modified.shown_problems, base.theta))
    return points


def _frfs(stage: JointProblem) -> tuple[FrfProblem, ...]:
    return tuple(part for part in stage.problems if isinstance(part, FrfProblem))


class Shortlist(NamedTuple):
    """Result of screening.

    `rows` are the best candidates of every point and the best of each kind, each once, the most telling first; `at_fit`
    those of them that promise most at the fit, and channels with faults of their own; `in_turn` are those that are
    certain, the best of the first point, of the second and so on, then the second best of each; `tried` is how many
    there were; `feet` are supports that give way in all rotations at once, and of modes rollers that do not roll, which no
    linear look is taken at; `lost` are sensors without which a good part of the misfit is gone.
    """

    rows: list[Screened]
    at_fit: list[Screened]
    in_turn: list[Screened]
    tried: int
    feet: list[Screened]
    lost: list[Screened]


def shortlist_candidates(
    base: FittedModel, work: TaskExecutor, name: str, budget: SearchBudget = UNLIMITED
) -> Shortlist:
    """The candidates that are worth a fit, screened at several points with parameters that follow linearly.

    Parameters
    ----------
    base : FittedModel
        Fit of the study before the change.
    work : TaskExecutor
        Runs the screening of each point.
    name : str
        Name of the stage in progress messages and checkpoints.
    budget : SearchBudget
        Points at the fit and at the anchored fit come first, those at smoothed data as long as there is time.
    """
    points = screening_points(base)
    names = titles(base.modified.setups)
    faulty = _faulty(base)
    certain = faulty | _exchanged(base, points)
    nearest_first = range(len(points))[::-1]
    answers = map_within_budget(budget, work, name, _screen_candidates, (tuple(points), names), nearest_first, least=1)[
        ::-1
    ]
    held_nodes = {dof.node for setup in base.modified.setups for dof in setup.structure.fixed}
    best, others, here = _Promises(), _Promises(), _Promises()
    tried, feet, of_points = 0, list[Screened](), list[list[Screened]]()
    for point, answer in zip(points, answers, strict=True):
        if answer is None:
            continue
        several = point.candidates(names)
        feet = feet or [*_feet(several, base.misfit), *_rollers(base, several, held_nodes)]
        problems = [receptances.problem for receptances in point.records]
        data = list(data_candidates(problems, names))
        tried = max(tried, len(several) + len(data))
        whole, kinds = point.left, dict[str, int]()
        seen_left = zip(several, answer["strength"], answer["left"], strict=True)
        rows = [Screened(one, float(strength), float(left)) for one, strength, left in seen_left]
        rows += [Screened(one, 1.0, point.without(rows_left_out(one, problems))) for one in data]
        rows.sort(key=lambda row: row.left)
        here = _Promises()
        for row in rows:
            drop = 1 - row.left / whole
            if drop <= LEAST_DROP and not _is_certain(row.candidate, certain):
                continue
            key = row.candidate.key
            if key in here:
                continue  # an appendage of another frequency at the same place
            kind = _family(row.candidate, held_nodes)
            count = kinds.setdefault(kind, 0)
            is_early = len(here) < FIRST_OF_POINT or count < FIRST_OF_KIND or _is_certain(row.candidate, certain)
            chosen = best if is_early else others
            here[key] = (drop, row)
            if key not in chosen or drop > chosen[key][0]:
                chosen[key] = (drop, row)
            kinds[kind] += 1
        of_points.append([row for _, row in here.values()])
    _with_friction(best, all(DryFriction.can_act(receptances) for receptances in points[-1].records[:1]))
    found = sorted(best.values(), key=lambda pair: (not _is_certain(pair[1].candidate, certain), -pair[0]))
    rows = [row for _, row in found]
    if base.modified.is_of_modes:
        rows = _by_modes(base, rows + [others[key][1] for key in others if key not in best], work, name, budget)
    rows = rows[:SHORTLIST]
    at_fit = [best[key][1] for key in here if key in best]
    sure = [row for row in rows if row.candidate.key in faulty]
    channels = [(drop, row) for drop, row in best.values() if isinstance(row.candidate, FaultyChannel)]
    lost = [
        row
        for drop, row in channels
        if drop > CHANNEL_PART or row in sure or (base.modified.is_of_modes and row in rows)
    ]
    at_fit = [*sure, *[row for row in at_fit if row in rows][:CERTAIN_AT_FIT]]
    in_turn = [row for of_rank in zip_longest(*of_points) for row in of_rank if row is not None]
    in_turn.sort(key=lambda row: not _is_certain(row.candidate, certain))
    return Shortlist(rows, at_fit, in_turn, tried, feet, lost)


def _feet(candidates: Iterable[Candidate], left: float) -> list[Screened]:
    """Candidates that several fixed rotations become flexible together: all of a direction, all, and all of a node.

    `candidates` are all changes, `left` is the misfit without them. Feet modelled as clamped that rotate are the commonest
    fault, and one foot of two explains half of it. At most eight nodes are taken.
    """
    of_node: dict[int, list[Support]] = {}
    of_direction: dict[str, list[Support]] = {}
    for candidate in candidates:
        if not isinstance(candidate, Support) or candidate.driven:
            continue
        dof = parse_dof(candidate.where[0])
        if dof.is_rotation:
            of_node.setdefault(dof.node, []).append(candidate)
            of_direction.setdefault(dof.direction, []).append(candidate)
    nodes = [group for group in of_node.values() if len(group) > 1][:MOST_FEET]
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


def _rollers(base: FittedModel, candidates: Iterable[Candidate], held_nodes: Collection[int]) -> list[Screened]:
    """Candidates that a free translation of a supported node is almost rigidly fixed: bearings that are stuck, at most eight.

    They are made for measured modes alone, where no linear step from a biased fit finds them; empty for other records.
    `held_nodes` are the supported nodes.
    """
    if not base.modified.is_of_modes:
        return []
    stuck = [
        candidate
        for candidate in candidates
        if isinstance(candidate, SpringToGround)
        and candidate.is_clamp(held_nodes)
        and not parse_dof(candidate.where[0]).is_rotation
    ]
    return [Screened(candidate, float(candidate.strengths.max()), base.misfit) for candidate in stuck[:MOST_FEET]]


def _exchanged(base: FittedModel, points: Sequence[Point]) -> set[Hashable]:
    """Keys of candidates by which the initial model shows channels to be exchanged, turned or of another gain.

    These leave less than half of the misfit of the initial model. `points` are the linearized problems of the screening; empty
    for modes.
    """
    modified = base.modified
    if modified.is_of_modes:
        return set()
    # a large model is screened there first
    point = (
        points[0]
        if modified.is_large
        else modified.point_at(modified.anchored_views(), np.asarray(modified.target.theta_start))
    )
    rows = point.screened([*exchanged_channels(point.records), *LoadGain.from_receptances(point.records, ("",))])
    return {row.candidate.key for row in rows if row.left < INITIAL_PART * point.left}


def _faulty(base: FittedModel) -> set[Hashable]:
    """Keys of candidate channels whose histories, or the fit's misfit, show that they did not measure the motion there."""
    shown = {
        FaultyChannel(where=(parse_dof(fault.channel.split()[0]).place,), record=number).key
        for number, setup in enumerate(base.modified.setups)
        for fault in setup.faults
        if not fault.channel.endswith("force")
    }
    return shown | _outstanding(base)


def _outstanding(base: FittedModel) -> set[Hashable]:
    """Keys of candidate channels of histories that cause more than 30 % of the misfit; empty for FRFs and modes."""
    problems, keys = base.modified.problems, set[Hashable]()
    residual = base.modified.target.residual(base.theta)
    of_records = zip(rows_of(problems, residual), base.modified.views, strict=True)
    for number, ((problem, own), view) in enumerate(of_records):
        if isinstance(problem, FrfProblem | ModalProblem):
            continue
        for channel in FaultyChannel.from_data([view.problem], [""]):
            rows = channel.rows_left_out(problem)
            squares = float(own[rows] @ own[rows])
            if squares - scaled_misfit(squares, int(rows.sum())) > CHANNEL_PART * base.chi_square:
                keys.add(replace(channel, record=number).key)
    return keys


def _family(candidate: Candidate, held_nodes: Collection[int]) -> str:
    """The family of a candidate, such as its kind; "clamp" for a spring that holds a further direction of a supported node."""
    is_clamp = isinstance(candidate, SpringToGround) and candidate.is_clamp(held_nodes)
    return "clamp" if is_clamp else candidate.family


def _is_certain(candidate: Candidate, certain: Collection[Hashable]) -> bool:
    """True if a change is fitted whatever a linear look promises: exchanged loads, and those with a key in `certain`."""
    return isinstance(candidate, SwappedLoads) or candidate.key in certain


def _by_modes(
    base: FittedModel, rows: Sequence[Screened], work: TaskExecutor, name: str, budget: SearchBudget
) -> list[Screened]:
    """Screened candidates sorted by the misfit of measured modes after one linear step; the first six keep their rank.

    A change that removes four fifths of the misfit of the modes may remove only a tenth of that of the FRFs that are computed
    from them. `name` is that of the stage in progress messages.
    """
    left = np.array(
        screen_changes(
            linearize_fit(base), [(row.candidate, row.strength) for row in rows], work, f"{name}, of modes", budget
        )
    )
    first = range(min(FIRST_OF_POINT, len(rows)))
    order = [k for k in np.argsort(left, kind="stable").tolist() if k >= len(first)]
    return [rows[k] for k in (*first, *order)]


def _screen_candidates(
    looks: tuple[Sequence[Point], Sequence[str]], number: int, tools: TaskContext
) -> dict[str, FloatArray]:
    """Arrays ``strength`` (the best) and ``left`` (misfit with it), (n_candidates,) each, of all candidates at one point.

    `looks` are all linearized problems and the names of the records, `number` is the position of the problem.
    """
    points, names = looks
    point = points[number]
    rows = point.screened(point.candidates(names))
    return {"strength": np.array([row.strength for row in rows]), "left": np.array([row.left for row in rows])}


def _with_friction(best: _Promises, can_rub: bool) -> None:
    """Add candidates of dry friction to `best`, in place, where the two best dampers to the ground are.

    Smoothed data do not distinguish the two. `can_rub` is False where friction cannot be modelled; nothing is added then.
    """
    dampers = [
        pair
        for pair in best.values()
        if isinstance(pair[1].candidate, Dashpot) and len(pair[1].candidate.where) == 1 and can_rub
    ]
    for drop, row in sorted(dampers, key=lambda pair: -pair[0])[:FIRST_OF_KIND]:
        twin = DryFriction(where=row.candidate.where, strengths=FORCES)
        best.setdefault(twin.key, (drop, Screened(twin, float(np.median(FORCES)), row.left)))

"""Selection of the changes to refit: the most promising ones by a linear step, others that follow from these, and pairs.

A change whose effect receptances do not give is judged by the misfit of the changed model after one linear step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dof
from structid.core.errors import InputError, StructidError
from structid.diagnose.causes import (
    CoarseMesh,
    Dashpot,
    DryFriction,
    ExponentialWindow,
    FaultyChannel,
    FixedValue,
    LoadPosition,
    SensorPolarity,
    SensorPosition,
    ShearFlexibility,
    SpringToGround,
    Support,
    SwappedLoads,
    data_candidates,
    exchanged_channels,
    rows_left_out,
    set_candidates,
)
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.clock import Clock
from structid.diagnose.causes.delay import SensorDelay
from structid.diagnose.causes.fixed_value import fixed_values
from structid.diagnose.causes.friction import FORCES
from structid.diagnose.causes.gain import LoadGain, RecordGain
from structid.diagnose.causes.offset import MassOffset
from structid.diagnose.causes.separate_element import DifferingElement
from structid.diagnose.data_rows import rows_of, scaled_misfit
from structid.diagnose.modified_model import QUICK
from structid.diagnose.refits import CandidateOfStrength, FittedModel, RefitTask
from structid.diagnose.score_test import Point, Screened, fixed_columns, tolerance_directions
from structid.diagnose.search_budget import (
    METER,
    UNLIMITED,
    SearchBudget,
    SearchEndedError,
    iteration_effort,
    map_within_budget,
)
from structid.diagnose.thresholds import (
    CERTAIN_AT_FIT,
    CHANNEL_PART,
    FIRST_OF_KIND,
    FIRST_OF_POINT,
    FIRST_OF_SET_KIND,
    INITIAL_PART,
    LEAST_DROP,
    MOST_FEET,
    MOST_NEIGHBOURS,
    OTHER_LEVERS,
    PAIR_LEFT,
    PAIR_LOOKS,
    PAIR_LOOKS_OF_KIND,
    SAME_DELAY,
    SCREENED_LEVELS,
    SHORTLIST,
)
from structid.fem import Structure
from structid.forward import FrfProblem
from structid.forward.modal import compares_modes
from structid.identification.setups.setup import titles
from structid.inversion import JointProblem
from structid.inversion.linearization import triangle_of
from structid.inversion.search.work import TaskContext, TaskExecutor


class LinearizedFit(NamedTuple):
    """A fit with its residual on the lines of `coarse`, and the ways in which fixed values change that within their tolerances.

    Attributes
    ----------
    fitted : FittedModel
    residual : (n_rows,) float array
        Whitened data rows, then priors.
    directions : (n_data, n_directions) float array
        Changes of the data rows, each by one tolerance; see `tolerance_directions`.
    names : tuple of str
        Fixed values, one for each of their columns in `triangle`, in its order.
    triangle : (n, n_columns) float array
        R of the QR factorization of the Jacobian, `directions`, the columns of the fixed values, and the residual; of n rows,
        as many as it has columns, or as there are data and priors where these are fewer.
    """

    fitted: FittedModel
    residual: FloatArray
    directions: FloatArray
    names: tuple[str, ...]
    triangle: FloatArray

    @property
    def misfit(self) -> float:
        """The misfit after one linear step, fixed values within their tolerances."""
        return self._misfit_with(np.zeros((len(self.triangle), 0)))

    def misfit_with_freed(self, names: Sequence[str]) -> float:
        """Weighted sum of squares after a linear step that also multiplies the fixed values `names` by one factor without prior."""
        first = self.triangle.shape[1] - len(self.names) - 1
        chosen = [first + self.names.index(name) for name in names]
        return self._misfit_with(self.triangle[:, chosen].sum(axis=1, keepdims=True))

    def _misfit_with(self, freed: FloatArray) -> float:
        """Misfit after one linear step of the fit with further unknowns, which have no prior.

        `freed` (n, n_freed) are their Jacobian columns, with the rows of `self.triangle`.
        """
        n_directions = self.directions.shape[1]
        n_params = self.triangle.shape[1] - len(self.names) - n_directions - 1
        columns = [self.triangle[:, : n_params + n_directions], freed, self.triangle[:, -1:]]
        return misfit_after_step(np.column_stack(columns), n_params, n_directions)


def misfit_after_step(augmented: FloatArray, n_params: int, n_directions: int) -> float:
    """The sum of squares of data, priors and tolerances that the best linear step leaves.

    Parameters
    ----------
    augmented : (n_rows, n_columns) float array
        In this order: the Jacobian of the parameters, changes by one tolerance each, columns of further unknowns without a
        prior, and the residual.
    n_params, n_directions : int
        Numbers of columns of parameters and of tolerances; each of the latter has a standard normal prior.
    """
    priors = np.zeros((n_directions, augmented.shape[1]))
    priors[:, n_params : n_params + n_directions] = np.eye(n_directions)
    rest = triangle_of(np.concatenate([augmented, priors]))[augmented.shape[1] - 1 :, -1]
    return float(rest @ rest)


def linearize_fit(fitted: FittedModel) -> LinearizedFit:
    """Fit on fewer lines, linearized at its free variables once for all changes that are compared with it.

    Fixed values are free within their tolerances; exact in models of more than 1200 degrees of freedom. The effort is
    counted. `fitted` is that fit.
    """
    modified, target = fitted.modified, fitted.modified.coarse.target
    METER.add(iteration_effort(target))
    at = target.linearize(fitted.theta)
    fixed_values = None if modified.is_large else modified.coarse.fixed_values
    names, columns, tolerance = fixed_columns(fixed_values, target.names, fitted.theta, len(at.residual))
    directions = tolerance_directions(at.jacobian, columns * tolerance)
    triangle = triangle_of(np.column_stack([at.jacobian, directions, columns, at.residual]))
    return LinearizedFit(fitted, at.residual, directions[: target.n_data], names, triangle)


def screen_sets(
    base: FittedModel, work: TaskExecutor, name: str, budget: SearchBudget = UNLIMITED
) -> tuple[list[Screened], int]:
    """Changes of sets, records and mesh that lower the misfit by one linear step, and the number of changes screened.

    Each has its best strength; the order is that of the candidates. The misfit must drop by more than 2 % of it, except
    for mesh, shear, window and clock, which need no drop. Of each family the four that leave least are returned, and
    every clock. Misfits are estimated on the lines of `coarse` of the changed models, and scaled to all data. `name` is
    that of the stage in progress messages. `base` is the fit of the study; `work` and `budget` run and limit the steps.
    """
    several = set_candidates(base.modified.model, base.modified.problems)
    sized = [(candidate, float(strength)) for candidate in several for strength in candidate.strengths]
    linearized = linearize_fit(base)
    left = iter(screen_changes(linearized, sized, work, name, budget))
    unchanged, screened, n_seen = linearized.misfit, list[Screened](), 0
    scale = base.modified.target.n_data / base.modified.coarse.target.n_data
    for candidate in several:
        least, strength = min((next(left), float(strength)) for strength in candidate.strengths)
        n_seen += int(np.isfinite(least))
        needs_no_drop = isinstance(candidate, CoarseMesh | ShearFlexibility | ExponentialWindow | Clock)
        if np.isfinite(least) and (needs_no_drop or least < (1 - LEAST_DROP) * unchanged):
            screened.append(Screened(candidate, strength, scale * least))
    order = sorted(range(len(screened)), key=lambda k: screened[k].left)
    few = first_of_each([screened[k].candidate.family for k in order], FIRST_OF_SET_KIND)
    telling = {order[k] for k in few} | {k for k in order if isinstance(screened[k].candidate, Clock)}
    return [screened[k] for k in sorted(telling)], n_seen


def first_of_each(kinds: Sequence[str], most: int) -> list[int]:
    """Indices, from 0 and rising, of the first `most` entries of each kind in `kinds`."""
    counts, kept = Counter[str](), list[int]()
    for k, kind in enumerate(kinds):
        counts[kind] += 1
        if counts[kind] <= most:
            kept.append(k)
    return kept


def screen_changes(
    linearized: LinearizedFit, sized: Sequence[CandidateOfStrength], work: TaskExecutor, name: str, budget: SearchBudget
) -> list[float]:
    """Misfit of each changed model after a linear step, in the order of `sized` (candidate, strength).

    Infinite where there is no such model, its step fails, there is no time for it, or a change without a parameter is
    too small to lower the misfit by 2 %. Fixed values that are columns of `linearized` need no changed model. `name` is
    that of the stage in progress messages. `work` and `budget` run and limit the steps.
    """
    known = {
        k: linearized.misfit_with_freed(one.where) for k, (one, _) in enumerate(sized) if _has_columns(linearized, one)
    }
    others = [item for k, item in enumerate(sized) if k not in known]
    steps = iter(map_within_budget(budget, work, name, _screen_change, linearized, others))
    return [known[k] if k in known else (next(steps) or {"left": np.inf})["left"] for k in range(len(sized))]


def _has_columns(linearized: LinearizedFit, candidate: Candidate) -> bool:
    """True of fixed values whose effects are columns of the linearized fit, so that no changed model is needed."""
    return isinstance(candidate, FixedValue) and set(candidate.where) <= set(linearized.names)


def _screen_change(linearized: LinearizedFit, change: CandidateOfStrength, tools: TaskContext) -> dict[str, float]:
    """Misfit, under the key ``left``, after one linear step of the changed model; infinite on failure.

    The step begins at the values of the fit, and at the initial ones too where the candidate asks for it; the lower
    misfit counts. `change` is the candidate and its strength. A change without a parameter that changes the residual by
    d lowers the misfit W after a step by no more than 2 sqrt(W) |d| to first order; infinite too where that is less
    than 2 % of W. `tools` is not used. `linearized` is the fit without the change.
    """
    base = linearized.fitted
    try:
        modified = base.modified.changed(*change)
        target, theta = modified.coarse.target, modified.theta_of(base.values)
        n_data, is_comparable = target.n_data, target.n_data == base.modified.coarse.target.n_data
        is_alike = is_comparable and target.names == base.modified.target.names
        if is_alike and not change[0].is_screened_at_start:
            difference = np.linalg.norm(target.residual(theta)[:n_data] - linearized.residual[:n_data])
            if 2 * difference < LEAST_DROP * np.sqrt(linearized.misfit):
                return {"left": np.inf}
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    starts = [np.asarray(theta)]
    if change[0].is_screened_at_start and not np.array_equal(theta, target.theta_start):
        starts.append(np.asarray(target.theta_start))
    left = [np.inf]
    for start in starts:
        METER.add(iteration_effort(target))
        try:
            at = target.linearize(start)
        except (StructidError, np.linalg.LinAlgError):
            continue
        directions = linearized.directions if is_comparable else np.zeros((n_data, 0))
        directions = np.pad(directions, ((0, len(at.residual) - n_data), (0, 0)))
        augmented = np.column_stack([at.jacobian, directions, at.residual])
        left.append(misfit_after_step(augmented, at.n_params, directions.shape[1]))
    return {"left": min(left)}


#: By the key of a candidate, the part of the misfit that a linear screening promises to remove, and the screening.
_Promises = dict[Hashable, tuple[float, Screened]]


def screening_points(base: FittedModel) -> list[Point]:
    """FRF problems linearized at fitted values for the screening of candidates: smoothed data, near the start, the fit.

    The quick fits to data smoothed at three levels come first, each at its own answer, then the quick fit to the
    measured lines, and last `base`. Where a quick fit ends at its limit, the later ones are left out, and the measured
    lines are taken at the last answer. Records of modes have no smoothed data. For a model of more than 1200 degrees of
    freedom nothing is fitted: there are two problems, at the start of the parameters and at `base`.
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
    there were; `feet` are supports that give way in all rotations at once, hinges that are all clamped, and of modes rollers that
    do not roll, which no linear look is taken at; `lost` are sensors without which a good part of the misfit is gone.
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
    """Candidates that are worth a fit, screened at several points with parameters that follow linearly.

    A candidate counts at a point if it lowers the misfit there by more than 2 %; exchanged channels and gains that the
    initial model shows, and channels with most of the misfit, count in any case. The best of each point and kind come
    first, by the largest part of the misfit that they remove at any point; others follow for modes alone (by `_by_modes`).
    At most 38 are taken.

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
        feet = feet or [
            *_feet(several, base.misfit),
            *_clamps(several, held_nodes, base.misfit),
            *_rollers(base, several, held_nodes),
        ]
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

    `candidates` are all changes, of which supports that no record drives count; `left` is the misfit without them,
    which each result states. Feet modelled as clamped that rotate are the commonest fault, and one foot of two explains
    half of it. At most eight nodes are taken; groups have two rotations or more.
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
        _together(group, float(np.median(group[0].strengths)), left) for group in [*directions, *everywhere, *nodes]
    ]


def _clamps(candidates: Iterable[Candidate], held_nodes: Collection[int], left: float) -> list[Screened]:
    """Candidates that supported nodes are held in a rotation too: one for each direction in which 2 to 8 rotate.

    Feet drawn as hinges may be clamped, and one foot of two explains half of the misfit. `candidates` are all changes,
    of which springs to the ground at `held_nodes`, the supported nodes, count. Each has its largest strength and
    `left`, the misfit without changes.
    """
    of_direction: dict[str, list[SpringToGround]] = {}
    for candidate in candidates:
        if isinstance(candidate, SpringToGround) and candidate.is_clamp(held_nodes):
            dof = parse_dof(candidate.where[0])
            if dof.is_rotation:
                of_direction.setdefault(dof.direction, []).append(candidate)
    return [
        _together(group, float(group[0].strengths.max()), left)
        for group in of_direction.values()
        if 1 < len(group) <= MOST_FEET
    ]


def _together(group: Sequence[Support] | Sequence[SpringToGround], strength: float, left: float) -> Screened:
    """The changes of a `group` as one at all its degrees of freedom, with a `strength`; `left` is the misfit without it."""
    return Screened(replace(group[0], where=tuple(candidate.where[0] for candidate in group)), strength, left)


def _rollers(base: FittedModel, candidates: Iterable[Candidate], held_nodes: Collection[int]) -> list[Screened]:
    """Candidates that a free translation of a supported node is almost rigidly fixed, as by a stuck bearing.

    They are springs to the ground among `candidates`, eight at most, with their largest strength, for measured modes
    alone, where no linear step from a biased fit finds them; empty for other records. `held_nodes` are the supported
    nodes. `base` is the fit of the study, whose misfit each result states.
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

    Each leaves, by a linear step at the start of the parameters, less than half of the misfit there. `points` are the
    linearized problems of the screening, of which the first, that at the start, is used for models of more than 1200
    degrees of freedom. The set is empty for measured modes. `base` is the fit of the study.
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
    names = titles(modified.setups)
    gains = [one for kind in (LoadGain, RecordGain) for one in kind.from_receptances(point.records, names)]
    rows = point.screened([*exchanged_channels(point.records), *gains])
    return {row.candidate.key for row in rows if row.left < INITIAL_PART * point.left}


def _faulty(base: FittedModel) -> set[Hashable]:
    """Keys of candidates that a sensor is faulty, where its history shows a fault or it causes over 30 % of the misfit.

    Faults of a history are those that the set-ups state, such as a dead or clipped channel; the misfit is that of a
    channel of a history (`_outstanding`).
    """
    shown = {
        FaultyChannel(where=(parse_dof(fault.channel.split()[0]).place,), record=number).key
        for number, setup in enumerate(base.modified.setups)
        for fault in setup.faults
        if not fault.channel.endswith("force")
    }
    return shown | _outstanding(base)


def _outstanding(base: FittedModel) -> set[Hashable]:
    """Keys of candidates that a channel of a history is faulty, where it causes more than 30 % of the misfit of `base`.

    It causes the misfit of its rows less that with errors larger by the likeliest factor. Empty for FRFs and modes.
    """
    problems, keys = base.modified.problems, set[Hashable]()
    residual = base.modified.target.residual(base.theta)
    of_records = zip(rows_of(problems, residual), base.modified.views, strict=True)
    for number, ((problem, own), view) in enumerate(of_records):
        if isinstance(problem, FrfProblem) or compares_modes(problem):
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
    """True if a change is fitted whatever its screening promises: exchanged loads, or a key that is in `certain`."""
    return isinstance(candidate, SwappedLoads) or candidate.key in certain


def _by_modes(
    base: FittedModel, rows: Sequence[Screened], work: TaskExecutor, name: str, budget: SearchBudget
) -> list[Screened]:
    """The first six of `rows` in their order, then the rest by rising misfit of measured modes after one linear step.

    A change that removes four fifths of the misfit of the modes may remove only a tenth of that of the FRFs that are
    computed from them. `rows` are screened candidates; `work` and `budget` run and limit the linear steps; `name` is
    that of the stage in progress messages. `base` is the fit of the study, from which the step is made.
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
    points_and_names: tuple[Sequence[Point], Sequence[str]], number: int, tools: TaskContext
) -> dict[str, FloatArray]:
    """Best strength and misfit with it of all candidates at one point, as arrays ``strength`` and ``left``.

    Both are (n_candidates,). `points_and_names` are the linearized models and the names of the records, `number` is the
    index of the model, from 0. `tools` is not used.
    """
    points, names = points_and_names
    point = points[number]
    rows = point.screened(point.candidates(names))
    return {"strength": np.array([row.strength for row in rows]), "left": np.array([row.left for row in rows])}


def _with_friction(best: _Promises, can_rub: bool) -> None:
    """Add candidates of dry friction to `best`, in place, at the positions of its two best dampers to the ground.

    `best` maps keys of candidates to pairs (part of the misfit removed, screened candidate). Smoothed data do not
    distinguish the two; each gets the part of its damper, unless `best` has this candidate already. `can_rub` is False
    where friction cannot be modelled; nothing is added then.
    """
    dampers = [
        pair
        for pair in best.values()
        if isinstance(pair[1].candidate, Dashpot) and len(pair[1].candidate.where) == 1 and can_rub
    ]
    for drop, row in sorted(dampers, key=lambda pair: -pair[0])[:FIRST_OF_KIND]:
        twin = DryFriction(where=row.candidate.where, strengths=FORCES)
        best.setdefault(twin.key, (drop, Screened(twin, float(np.median(FORCES)), row.left)))


def derived_candidates(base: FittedModel, shortlist: Shortlist) -> list[Screened]:
    """Further changes worth a fit, not screened themselves, that follow from the most promising screened ones.

    In this order: fixed values of sets one of whose elements seems to differ, sensors that are late together, other
    offsets of masses, sensors of opposite sense and at other nodes where they are better left out, loads at other
    nodes, and supports that become flexible in several rotations, or are held in one rotation more.
    """
    rows = shortlist.rows
    lost = shortlist.lost
    return [
        *_of_whole_sets(base, rows),
        *_of_one_card(rows),
        *_off_otherwise(rows),
        *_turned(rows, lost),
        *_misplaced(base, lost),
        *shortlist.feet,
    ]


def _of_whole_sets(base: FittedModel, rows: Sequence[Screened]) -> list[Screened]:
    """Candidates that a fixed property of a whole set is wrong, where `rows` have an element that differs in it.

    A linear step from a fit that is far off promises little of a fixed value, while elements are screened at other
    points too. Each has the strength 1 and the misfit of the first such element. `base` is the fit of the study.
    """
    setup = base.modified.setups[0]
    of_set = {value.where[0]: value for value in fixed_values(setup.structure, setup.parameters)}
    first: dict[str, Screened] = {}
    for row in rows:
        if isinstance(row.candidate, DifferingElement) and len(row.candidate.properties) == 1:
            differing = row.candidate.properties[0]
            first.setdefault(f"{differing.property}[{differing.element.rpartition(':')[0]}]", row)
    return [Screened(of_set[name], 1.0, row.left) for name, row in first.items() if name in of_set]


def _of_one_card(screened_rows: Sequence[Screened]) -> list[Screened]:
    """Candidate delays shared by sensors of one record that are late by about the same time, as on one card.

    `screened_rows` are the most promising first. Delays within a factor of 1.5 of the first one, in its record, count.
    One candidate is for the first two sensors, one for the first three, and so on, each with their median delay and the
    misfit that the first of all leaves; empty for fewer than two.
    """
    late = [row for row in screened_rows if isinstance(row.candidate, SensorDelay)]
    alike = [
        row
        for row in late
        if row.candidate.record == late[0].candidate.record
        and 1 / SAME_DELAY < row.strength / late[0].strength < SAME_DELAY
    ]
    screened = []
    for count in range(2, len(alike) + 1):
        places = tuple(row.candidate.where[0] for row in alike[:count])
        strength = float(np.median([row.strength for row in alike[:count]]))
        shared = replace(late[0].candidate, where=places)
        screened.append(Screened(shared, strength, late[0].left))
    return screened


def _turned(rows: Sequence[Screened], lost: Sequence[Screened]) -> list[Screened]:
    """Candidates that sensors which are better left out (`lost`) have the opposite sense, where `rows` do not have these."""
    known = {row.candidate.where for row in rows if isinstance(row.candidate, SensorPolarity)}
    return [
        Screened(SensorPolarity(where=row.candidate.where, record=row.candidate.record), 1.0, row.left)
        for row in lost
        if row.candidate.where not in known
    ]


def _misplaced(base: FittedModel, left_out: Sequence[Screened]) -> list[Screened]:
    """Candidate positions, at up to four of the nearest nodes, of all loads and of the sensors in `left_out`.

    `left_out` are screened changes that leave out a sensor. Motions of driven supports have no candidates. Degrees of
    freedom that the record measures already are no candidates. `base` is the fit of the study, whose misfit each result
    states.
    """
    screened = []
    better_out = {(row.candidate.record, row.candidate.where[0]) for row in left_out}
    for number, setup in enumerate(base.modified.setups):
        for role, dofs in setup.channels:
            is_load, measured = role == "input", {dof.unsigned for dof in dofs}
            if is_load and setup.structure.driven(dofs):
                continue
            for dof in dofs:
                if is_load or (number, dof.place) in better_out:
                    others = [one for one in _dofs_nearby(setup.structure, dof) if one not in measured]
                    kind = LoadPosition if is_load else SensorPosition
                    pairs = [(dof.place, one.place) for one in others]
                    screened += [Screened(kind(where=pair, record=number), 1.0, base.misfit) for pair in pairs]
    return screened


def _dofs_nearby(structure: Structure, dof: Dof) -> list[Dof]:
    """Degrees of freedom in the direction of `dof` at up to four other nodes that can move in it, the nearest first.

    They are searched for among the eight nearest nodes.
    """
    nodes = {label: np.asarray(position) for label, position in structure.nodes.items()}
    distance = {label: float(np.linalg.norm(x - nodes[dof.node])) for label, x in nodes.items() if label != dof.node}
    neighbours = []
    for label in sorted(distance, key=lambda label_of: distance[label_of])[: 2 * MOST_NEIGHBOURS]:
        with suppress(InputError):
            other = Dof(label, dof.direction)
            structure.require_dofs([other])
            neighbours.append(other)
    return neighbours[:MOST_NEIGHBOURS]


def _off_otherwise(rows: Sequence[Screened]) -> list[Screened]:
    """Masses off their nodes with other levers: each of the first three in `rows` with its strength times `OTHER_LEVERS`.

    Needed since the misfit depends on the lever and its square: it has minima to the other side, and at less.
    """
    off = [row for row in rows if isinstance(row.candidate, MassOffset)][:3]
    return [replace(row, strength=factor * row.strength) for row in off for factor in OTHER_LEVERS]


def promising_first_changes(
    base: FittedModel, items_begun: Sequence[RefitTask], work: TaskExecutor, name: str, budget: SearchBudget = UNLIMITED
) -> list[RefitTask]:
    """First changes with which a second one removes most of the misfit, sorted by what the best second leaves.

    A change is kept if the second leaves less than 30 % of the misfit without changes. Second changes are screened at
    quick fits of log-FRFs that stay near the start values: a full fit of one of two faults is bent towards the other.
    At most twelve first changes are tried, two of a kind.

    Parameters
    ----------
    base : FittedModel
        The fit before changes.
    items_begun : sequence of RefitTask
        Changes with their quick fits (candidate, strength, free variables), the likeliest first.
    work : TaskExecutor
        Runs the screening.
    name : str
        Name of the stage in progress messages and checkpoints.
    budget : SearchBudget
        Changes for which there is no time are left out.

    Returns
    -------
    list of RefitTask
        Those of `items_begun` that are kept; empty if there are none.
    """
    few = first_of_each([candidate.kind for candidate, _, _ in items_begun], PAIR_LOOKS_OF_KIND)
    items = [items_begun[k] for k in few[:PAIR_LOOKS]]
    modified = base.modified
    whole = modified.point_at(modified.anchored_views(), base.near_theta).left
    looks = map_within_budget(budget, work, name, _looked_beside, base, items)
    left = [np.inf if look is None else look["left"] for look in looks]
    order = np.argsort(left, kind="stable").tolist()
    return [items[k] for k in order if left[k] < PAIR_LEFT * whole]


def _looked_beside(base: FittedModel, item: RefitTask, tools: TaskContext) -> dict[str, float]:
    """Misfit, under the key ``left``, after a change and the best second change, by a linear step; infinite on failure.

    `item` is the first change, its strength and the free variables of its quick fit; `base` is the fit without it.
    `tools` is not used.
    """
    candidate, strength, theta = item
    try:
        modified = base.modified.changed(candidate, strength)
        point = modified.point_at(modified.anchored_views(), theta)
        rows = point.screened(point.candidates(titles(modified.setups)))
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    return {"left": min((row.left for row in rows), default=np.inf)}

"""Which single changes of model or record would explain a misfit: screened by the hundreds, refitted by the dozen."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.dof import parse_dof
from structid.core.errors import StructidError
from structid.diagnose.causes import residual_candidates
from structid.diagnose.causes.appendage import Appendage
from structid.diagnose.causes.candidate import Candidate
from structid.diagnose.causes.fixed_value import FixedValue
from structid.diagnose.causes.joint import FlexibleJoint
from structid.diagnose.causes.mass import Mass
from structid.diagnose.causes.mesh import CoarseMesh
from structid.diagnose.causes.outlying_lines import OutlyingLines
from structid.diagnose.causes.rotary_inertia import AddedRotaryInertia
from structid.diagnose.causes.spring import SpringToGround
from structid.diagnose.causes.support import Support
from structid.diagnose.modified_model import ModifiedModel
from structid.diagnose.refits import (
    CandidateOfStrength,
    FittedModel,
    RefitTask,
    StoredFit,
    fit_fully,
    fit_mirrored,
    fit_near,
    fitted_at,
    is_beyond_noise,
    n_parameters,
    restore_fit,
)
from structid.diagnose.score_test import RequestedChange, Screened
from structid.diagnose.screening import derived_candidates, promising_first_changes, screen_sets, shortlist_candidates
from structid.diagnose.search_budget import NOTHING, UNLIMITED, Expense, SearchBudget, map_within_budget
from structid.diagnose.thresholds import (
    ALIKE,
    CAUSE_RISK,
    CLEAR,
    CLEARLY_BETTER,
    FAR_BEHIND,
    FAR_BEYOND,
    FINALISTS,
    FIRST_CAUSE_TIME,
    LARGE_MODEL_REFITS,
    LEAST_DROP,
    LEAST_REFITS,
    LEAST_SHARE,
    MORE_PAIRS,
    MOST_REQUESTED,
    NEAR_FIT_TIME,
    NESTED_RISK,
    OUTLYING_RATIO,
    PAIR_DOFS,
    PROMISING_PAIRS,
    REQUEST_LINES,
    REQUEST_RISK,
    RESERVED_PLACES,
    RIGID_RATIO,
    SCREENING_TIME,
    SET_LEFT,
    SET_REFITS,
    SPRING_LOSS,
)
from structid.identification.setups.setup import titles
from structid.inversion.covariance import correlation_length
from structid.inversion.search.work import SERIAL, TaskExecutor


@dataclass(frozen=True, eq=False)
class Explanation:
    """The changes that explain a misfit, as a search gave them.

    Attributes
    ----------
    base : FittedModel
        The study as it is, or with the first cause.
    causes : tuple of FittedModel
        Accepted changes, the likeliest first; those within `ALIKE` of the first cannot be told from it.
    criteria : tuple of float
        Criterion of each cause: chi-square of its fit over a scale common to all, plus a price for each parameter.
    tried : int
        How many candidates there were.
    near : tuple of FittedModel
        Changes, accepted or not, within `ALIKE` of the likeliest model; the unchanged model may be that one.
    further : Explanation, optional
        Explanation, by second causes, of the misfit that the first cause leaves.
    better : FittedModel, optional
        The study as it is, from another start, where that explains the record: the search ended in a wrong place.
    spent : Expense
        Effort and processor seconds that it took.
    left_out : int
        How many changes a linear look promises something of, and were not fitted for want of time.
    is_single : bool
        Whether other pairs than the likeliest were not looked for for want of time.
    begun : tuple of RefitTask
        Changes of the model or its channels where their near fits ended, the likeliest first.
    """

    base: FittedModel
    causes: tuple[FittedModel, ...]
    criteria: tuple[float, ...]
    tried: int
    near: tuple[FittedModel, ...] = ()
    further: Explanation | None = None
    better: FittedModel | None = None
    spent: Expense = NOTHING
    left_out: int = 0
    is_single: bool = False
    begun: tuple[RefitTask, ...] = ()

    @property
    def likely(self) -> tuple[FittedModel, ...]:
        """Fits of all changes that may be the truth: first causes, then those with a second cause in addition."""
        return self.near if self.further is None else (*self.near, *self.further.near)


def search_causes(base: FittedModel, work: TaskExecutor = SERIAL, budget: SearchBudget = UNLIMITED) -> Explanation:
    """Search for the changes that explain the misfit of a fitted study; where the first leaves some, also for a second.

    Parameters
    ----------
    base : FittedModel
        Fit of the study as it is.
    work : TaskExecutor
        Runs the fits, in this process or in others.
    budget : SearchBudget
        Effort of the search, three quarters of it for the first causes and the rest for second ones. Other pairs are
        searched for as long as it suffices for one more.

    Returns
    -------
    Explanation
        Without causes, and with `better`, where another start of the unchanged study leaves only noise. Of large models
        only a few changes are fitted, and no second ones.
    """
    base = replace(base, modified=replace(base.modified, fit_limits=budget.fit_limits))
    if base.modified.is_large:
        return _of_large_model(base, work, budget)
    other = _from_elsewhere(base)
    if other is not None and not other.is_misfit:
        return Explanation(base, (), (), 0, better=other)
    base = other or base
    first = _search_once(base, work, "", budget.portion(FIRST_CAUSE_TIME))
    if _is_clear(first):
        return _paired(first, work, budget) if first.causes[0].is_misfit else first
    return _of_two(first, work, budget) if _is_far(base) else first


def _is_clear(explanation: Explanation) -> bool:
    """True if the first cause leaves less than half of the misfit; False without causes."""
    return bool(explanation.causes) and explanation.causes[0].misfit < CLEAR * explanation.base.misfit


def _is_far(fitted: FittedModel) -> bool:
    """True if chi-square per degree of freedom is above 9, more than intervals from the misfit may carry."""
    return fitted.misfit > FAR_BEYOND * max(fitted.modified.target.n_data - n_parameters(fitted.modified), 1)


def _of_two(
    explanation: Explanation, work: TaskExecutor, budget: SearchBudget, tried: Sequence[FittedModel] = ()
) -> Explanation:
    """Explanation by a pair of changes that leaves only noise, where each alone brings little; else `explanation`.

    Candidates for the first change are those in `explanation.begun`, except those at the positions of `tried`: a fit of
    one of two faults to all data is bent towards the other. Where the model has more than 200 degrees of freedom or the
    budget is used up, `is_single` is set. `work` and `budget` run and limit the fits.
    """
    n_dofs = max(setup.structure.n_dofs for setup in explanation.base.modified.setups)
    if not budget.allows(explanation.spent) or n_dofs > PAIR_DOFS:
        return replace(explanation, is_single=True)
    known = {one.cause.place for one in tried}
    begun = [item for item in explanation.begun if item[0].place not in known]
    promising = promising_first_changes(explanation.base, begun, work, "a second beside each change", budget)
    for item in promising[:PROMISING_PAIRS]:
        if not budget.allows(explanation.spent):
            break
        first = _first(explanation, item, work)
        further = None if first is None else _beside(first, work, "of two, second ", budget)
        if first is None or further is None:
            continue
        pair = _led_by(explanation, first, further)
        if pair is not None and pair.further is not None and not pair.further.causes[0].is_misfit:
            return pair
    return explanation


def _first(explanation: Explanation, item: RefitTask, work: TaskExecutor) -> FittedModel | None:
    """The full fit of a change, taken from the causes if it is there, else from the quick fit in `item`; None where it fails.

    `item` is the candidate, its strength and its free variables at the end of the quick fit.
    """
    known = [one for one in explanation.causes if one.cause.place == item[0].place]
    fits = known or _refits(explanation.base, [item], work, "a first of two causes")
    return fits[0] if fits else None


def _paired(explanation: Explanation, work: TaskExecutor, budget: SearchBudget) -> Explanation:
    """Explanation with a second change in addition to the first, or with another pair if that leaves more than noise.

    A finer mesh is tried first, whatever is left of the budget, unless a limit in seconds is used up; if it leaves only
    noise, nothing else is searched for.
    At most four other pairs are tried, and the best is taken. With the second given, another first is searched for: a
    change that only resembles the first of two faults loses its effect once the second is known. Where that brings
    nothing, a second is searched for with the next of the first causes. If the second explains as much alone, it is
    returned as the only cause. Where the budget ends the search, `is_single` is set. `explanation` has the first
    causes; `work` and `budget` run and limit the fits.
    """
    is_second_allowed = budget.allows(explanation.spent, 0.5)
    is_in_time = not np.isfinite(budget.seconds) or budget.is_left
    finer = _on_finer_mesh(explanation.causes[0], work) if is_in_time else None
    if finer is not None:
        pair = replace(explanation, further=finer)
        return _second_alone(explanation, pair, work) or pair
    if not is_second_allowed:
        return replace(explanation, is_single=True)
    second = _beside(explanation.causes[0], work, "second ", budget)
    pair = replace(explanation, further=second)
    if _is_far(second.causes[0] if second.causes else second.base):
        both = _of_two(explanation, work, budget, explanation.causes[:1])
        if both.further is not None:
            return both
        pair = replace(pair, is_single=both.is_single)
    others, is_from_second = list(explanation.causes[1:]), True
    for _ in range(MORE_PAIRS):
        second = pair.further or second
        if not second.causes or not is_beyond_noise(second.causes[0], counts_left_out=True):
            break  # a pair that leaves a channel out may look like one that explains it
        if not (is_from_second or others):
            break
        if not budget.allows(second.spent):
            pair = replace(pair, is_single=True)
            break
        better = (
            _from_second(explanation, second, work, budget)
            if is_from_second
            else _from_next(explanation, second, others.pop(0), work, budget)
        )
        pair, is_from_second = better or pair, better is not None
    return _second_alone(explanation, pair, work) or pair


def _on_finer_mesh(first: FittedModel, work: TaskExecutor) -> Explanation | None:
    """Explanation of what a first cause leaves by the mesh, where a finer one leaves only noise; None otherwise.

    None too where the mesh is the first cause. The mesh was made for the wrong model, only as fine as its misfit asked
    for: with the cause known, its error may be all that shows. `work` runs the fit.
    """
    if isinstance(first.cause, CoarseMesh):
        return None
    clock, changed = SearchBudget(), first.modified
    meshes = [(one, float(one.strengths[0])) for one in CoarseMesh.from_model(changed.model, changed.problems)]
    fits = _refits(first, _begun(changed, meshes, first.values), work, "the likeliest cause on a finer mesh")
    if not fits or fits[0].is_misfit:
        return None
    explanation = _weighed(first, fits, len(meshes))
    return replace(explanation, spent=clock.spent) if explanation.causes else None


def _second_alone(explanation: Explanation, pair: Explanation, work: TaskExecutor) -> Explanation | None:
    """Explanation with the second cause of `pair` as its first, if that cause alone leaves only noise; None otherwise.

    The causes of `explanation` follow it. None too if `pair` has no second cause that leaves only noise. `work` runs
    the fit.
    """
    if pair.further is None or not pair.further.causes or pair.further.causes[0].is_misfit:
        return None
    alone = _alone(explanation, pair.further.causes[0], work)
    if alone is None or alone.is_misfit:
        return None
    return _weighed(
        explanation.base, [alone, *(one for one in explanation.causes if one is not alone)], explanation.tried
    )


def _from_second(
    explanation: Explanation, second: Explanation, work: TaskExecutor, budget: SearchBudget
) -> Explanation | None:
    """Pair with another first cause, if its criterion is lower by over 6 than that with `second`; None otherwise.

    The likeliest cause of `second` is fitted alone, and a first cause is searched for in addition to it; then the
    causes of `second` are fitted again in addition to the new first cause. `explanation` has the causes that were found
    first. `work` and `budget` run and limit the fits.
    """
    alone = _alone(explanation, second.causes[0], work)
    again = None if alone is None else _beside(alone, work, "beside the second, first ", budget)
    if again is None or not _is_better(again, second):
        return None
    both = again.causes[0]
    first = _alone(explanation, both, work)
    if first is None:
        return None
    items = _begun(first.modified, [_last_change(one) for one in second.causes], both.values)
    return _led_by(
        explanation, first, _weighed(first, _refits(first, items, work, "second changes beside it"), again.tried)
    )


def _from_next(
    explanation: Explanation, second: Explanation, first: FittedModel, work: TaskExecutor, budget: SearchBudget
) -> Explanation | None:
    """Explanation by `first` and the best second causes after it, if their criterion is lower by over 6, or None.

    It is compared with that of `second`, the second causes after another first one. None also where `_led_by` gives
    none. `work` and `budget` run and limit the search for second causes.
    """
    further = _beside(first, work, "second changes after the next, ", budget)
    return _led_by(explanation, first, further) if _is_better(further, second) else None


def _is_better(explanation: Explanation, other: Explanation) -> bool:
    """True if the criterion of the first cause of `explanation` is lower than that of `other` by more than 6.

    False where `explanation` has no causes; `other` must have some.
    """
    if not explanation.causes:
        return False
    mine, theirs = explanation.causes[0], other.causes[0]
    scale = _scale(explanation.base, [mine, theirs])
    return _criterion(explanation.base, mine, scale) < _criterion(other.base, theirs, scale) - ALIKE


def _led_by(explanation: Explanation, first: FittedModel, further: Explanation) -> Explanation | None:
    """Explanation with `first` as its only first cause, and `further` as its second causes.

    The rest is that of `explanation`. None where `further` has no causes, and where `first` leaves more than half of
    the misfit and the pair more than noise.
    """
    if not further.causes or (first.misfit > CLEAR * explanation.base.misfit and further.causes[0].is_misfit):
        return None
    criterion = _criterion(explanation.base, first, _scale(explanation.base, [first]))
    return replace(explanation, causes=(first,), criteria=(criterion,), near=(first,), further=further)


def _last_change(fitted: FittedModel) -> CandidateOfStrength:
    candidate, strength, _ = fitted.modified.changes[-1]
    return candidate, strength


def _alone(explanation: Explanation, fitted: FittedModel, work: TaskExecutor) -> FittedModel | None:
    """Fit of the original model with only the last change of `fitted`; None if that does not lower the misfit.

    A cause of `explanation` at the same position is taken as it is; else the fit starts from the values of `fitted`.
    `work` runs the fit.
    """
    change = _last_change(fitted)
    for one in explanation.causes:
        if one.cause.place == change[0].place:
            return one
    alone = _refits(
        explanation.base, _begun(explanation.base.modified, [change], fitted.values), work, "a second cause alone"
    )
    return alone[0] if alone and alone[0].misfit < explanation.base.misfit else None


def _from_elsewhere(base: FittedModel) -> FittedModel | None:
    """Unchanged study fitted anew from the end of its quick fit and from its fit; None if that fails.

    None too if the study has no quick fit, or the new fit leaves 90 % of the chi-square or more. `base` is the fit of
    the study.
    """
    if not base.near_path:
        return None
    try:
        minimum = base.modified.fitted([base.near_theta, base.theta])
    except (StructidError, np.linalg.LinAlgError):
        return None
    cost = float(minimum.costs[-1])
    return fitted_at(base.modified, minimum.theta, cost) if cost < CLEARLY_BETTER * base.chi_square else None


def _search_once(base: FittedModel, work: TaskExecutor, which: str, budget: SearchBudget) -> Explanation:
    """Explanation of the misfit of `base` by single changes: screened, fitted quickly, the likeliest fitted fully.

    `which` is the prefix of stage names in progress messages, such as "second ". `further` of the result is None;
    `left_out` counts the changes for which there was no time, and `begun` has the quick fits. `work` and `budget` run
    and limit screening and fits.
    """
    clock, looks = SearchBudget(), budget.portion(SCREENING_TIME)
    shortlist = shortlist_candidates(base, work, f"{which}causes on a linear look", looks)
    problems = base.modified.problems
    residual = base.modified.target.residual(base.theta)[: base.modified.target.n_data]
    data = residual_candidates(problems, residual)
    of_sets, n_sets = screen_sets(base, work, f"{which}changes of the study", looks)
    few = [*of_sets, *(Screened(one, 1.0, base.misfit) for one in data)]
    tried = shortlist.tried + n_sets + len(data)
    screened_sets = {one.candidate.key for one in few}
    derived = [one for one in derived_candidates(base, shortlist) if one.candidate.key not in screened_sets]
    looked = [*few, *derived, *shortlist.rows]
    changes = [(one.candidate, one.strength) for one in looked]
    first = len(looked) - len(shortlist.rows)
    alike = [*range(first), *(first + k for k in _first_alike(shortlist.rows))]
    telling = sorted((one for one in few if one.left < SET_LEFT * base.misfit), key=lambda one: one.left)[:SET_REFITS]
    at_fit = [*shortlist.at_fit, *telling]
    kept = {k for k, one in enumerate(looked) if one.candidate.has_reserved_place or one in at_fit}
    rank = [
        *np.argsort(np.argsort([one.left for one in few], kind="stable")).tolist(),
        *_ranks_of_derived(looked[len(few) : first], shortlist.rows),
        *range(len(shortlist.rows)),
    ]
    approaches = _fit_near_all(base, changes, alike, rank, kept, work, f"{which}causes", budget)
    near = [one or StoredFit() for one in approaches]
    order = sorted((k for k, one in enumerate(near) if one), key=lambda k: float(near[k]["chi_square"]))
    finalists = _finalists(_within_reach(base, order, changes, near), [candidate for candidate, _ in changes])
    finalists += [k for k, one in enumerate(looked) if near[k] and one in at_fit and k not in finalists]
    items = [(*changes[k], near[k]["theta"]) for k in finalists]
    same = [next(i for i, other in enumerate(finalists) if alike[other] == alike[k]) for k in finalists]
    fits, n_ended = _refits_in_time(base, items, work, f"likeliest {which}causes", same, budget)
    known = {one.cause.place for one in fits}
    simpler = {item[0].place: item for one in fits for item in _simpler(base, one)}
    further = [item for place, item in simpler.items() if place not in known]
    further += [item for one in fits for item in _lossy(base, one)]
    if further:
        name = f"likeliest {which}causes, otherwise"
        more, n_more = _refits_in_time(base, further, work, name, None, budget, min(len(simpler), LEAST_REFITS))
        fits, n_ended = fits + more, n_ended + n_more - len(further)
    left_out = approaches.count(None) + len(items) - n_ended
    begun = [(*changes[k], near[k]["theta"]) for k in order if alike[k] == k and not changes[k][0].leaves_data_out]
    return replace(_weighed(base, fits, tried), spent=clock.spent, left_out=left_out, begun=tuple(begun))


def _within_reach(
    base: FittedModel, order: Sequence[int], changes: Sequence[CandidateOfStrength], near: Sequence[StoredFit]
) -> list[int]:
    """Positions, in `order`, of changes whose quick fits are not far behind the best, or that have a reserved place.

    Most quick fits were made before the best one was known. `changes` has the candidates, `near` their quick fits, and
    `base` is the fit without them.
    """
    fits = [(changes[k][0], near[k]) for k in order]
    far = _far_behind(base, fits)[-1] if base.near is not None else np.inf
    return [
        k
        for k, (candidate, fit) in zip(order, fits, strict=True)
        if candidate.has_reserved_place or fit["chi_square"] - base.left_out <= far
    ]


def _finalists(order: Sequence[int], several: Sequence[Candidate]) -> list[int]:
    """Positions of the candidates to refit, at most `FINALISTS`: the best near fits first, reserved places last.

    `order` holds positions in `several`, sorted by near fit. Up to `RESERVED_PLACES` are kept for candidates that smoothed data
    do not show; these come last, so that the best near fits are refitted before the time ends.
    """
    reserved = [k for k in order if several[k].has_reserved_place][:RESERVED_PLACES]
    others = [k for k in order if not several[k].has_reserved_place]
    return [*others[: FINALISTS - len(reserved)], *reserved]


def _ranks_of_derived(derived: Sequence[Screened], rows: Sequence[Screened]) -> list[int]:
    """Ranks for the quick fits of `derived` changes, which have no first-order test, one each; low ranks are fitted first.

    Supports that turn together have rank 0 if one of them is in `rows`, the screened changes, and they are at several
    nodes or at the node of the first support there; all others have ranks from 8, the number of finalists, in their
    order.
    """
    turning = [row.candidate.where[0] for row in rows if isinstance(row.candidate, Support)]

    def is_first(candidate: Candidate) -> bool:
        """True of supports that turn together, at least one of them in `turning` (supports in `rows`, by name).

        They must be at several nodes, or at the node of the first of `turning`.
        """
        if not isinstance(candidate, Support) or not set(turning).intersection(candidate.where):
            return False
        nodes = {parse_dof(place).node for place in candidate.where}
        return len(nodes) > 1 or nodes == {parse_dof(turning[0]).node}

    return [0 if is_first(one.candidate) else FINALISTS + k for k, one in enumerate(derived)]


def _beside(first: FittedModel, work: TaskExecutor, which: str, budget: SearchBudget) -> Explanation:
    """An explanation of what the study changed by `first` leaves; without causes where it cannot be evaluated or linearized.

    `which` is the prefix of stage names in progress messages.
    """
    try:
        return _search_once(first, work, which, budget)
    except (StructidError, np.linalg.LinAlgError):
        return Explanation(first, (), (), 0)


def _first_alike(rows: Sequence[Screened]) -> list[int]:
    """Index of the first row that has the same kind of candidate, strength and misfit, for each of `rows`.

    It is the row's own index if no row before it is alike. Strengths and misfits are compared with ten digits.
    """
    seen = [(one.candidate.place[0], f"{one.strength:.9e}", f"{one.left:.9e}") for one in rows]
    return [seen.index(key) for key in seen]


def _fit_near_all(
    base: FittedModel,
    changes: Sequence[CandidateOfStrength],
    alike: Sequence[int],
    rank: Sequence[int],
    kept: Collection[int],
    work: TaskExecutor,
    name: str,
    budget: SearchBudget,
) -> list[StoredFit | None]:
    """Quick fits (`fit_near`) of all `changes`, in their order; None where there is no time, empty where a fit fails.

    Changes of low `rank` are fitted first. A fit ends early where it can no longer be among the finalists, except for
    the indices in `kept`. `alike` gives, for each change, the index of the first one that may have the same fit (its
    own if none); `name` is the stage in progress messages. `base` is the fit before the change; `work` and `budget` run
    and limit the fits.
    """
    time = budget.portion(1.0, kept=1 - NEAR_FIT_TIME)
    originals = sorted((k for k, other in enumerate(alike) if other == k), key=lambda k: rank[k])
    first = [k for k in originals if rank[k] < FINALISTS]
    rest = sorted((k for k in originals if rank[k] >= FINALISTS), key=lambda k: (k not in kept, rank[k]))
    known: dict[int, StoredFit | None] = {}
    # computes `base.near` once, before it is sent to other processes
    limits, least = _near_limits(base, []), LEAST_REFITS
    for block in [first, *(rest[i : i + FINALISTS] for i in range(0, len(rest), FINALISTS))]:
        items = [(*changes[k], () if k in kept else limits) for k in block]
        what = name if known else f"most promising {name}"
        known.update(zip(block, map_within_budget(time, work, what, fit_near, base, items, least), strict=True))
        limits = _near_limits(base, [(changes[k][0], fit) for k, fit in known.items() if fit])
        least = 0
    twins = [k for k in range(len(changes)) if k not in known and known[alike[k]] is not None]
    asked = [(fit_near, (*changes[k], () if k in kept else limits), known[alike[k]] or StoredFit()) for k in twins]
    known.update(zip(twins, map_within_budget(time, work, f"{name}, alike", fit_mirrored, base, asked), strict=True))
    return [known.get(k) for k in range(len(changes))]


def _near_limits(base: FittedModel, fits: Sequence[tuple[Candidate, StoredFit]]) -> tuple[float, ...]:
    """Sums of squares, one for each stage of a quick fit, above which a change cannot be among the finalists.

    The limit of a stage is 4 times the sum of its least cost so far and the number of parameters; that of the last is
    the least of this, 98 % of the cost without a change, and the eighth least cost (without changes that have a
    reserved place). `fits` are the candidates fitted so far with their quick fits. Data that `base` leaves out do not
    count. Empty if the quick fit of `base` failed: then there is no limit.
    """
    if base.near is None:
        return ()
    far = _far_behind(base, fits)
    sizes = sorted(fit["chi_square"] - base.left_out for candidate, fit in fits if not candidate.has_reserved_place)
    nothing = (1 - LEAST_DROP) * base.near.chi_square
    return *far[:-1].tolist(), min(far[-1], nothing, *sizes[FINALISTS - 1 : FINALISTS])


def _far_behind(base: FittedModel, fits: Sequence[tuple[Candidate, StoredFit]]) -> FloatArray:
    """Sums of squares (n_stages,) above which a quick fit is far behind the best of `fits`, or that without a change.

    They are 4 times the sum of the least of each stage and the number of parameters. Fits that leave data out, and
    those of other stages, do not count. `base` is the fit without a change, and must have a quick fit.
    """
    assert base.near is not None
    costs = [base.near.costs, *(fit["costs"] for candidate, fit in fits if not candidate.leaves_data_out)]
    least = np.array([row for row in costs if len(row) == len(base.near.costs)]).min(axis=0)
    far: FloatArray = FAR_BEHIND * (least + n_parameters(base.modified))
    return far


def _refits(
    base: FittedModel,
    items: Sequence[RefitTask],
    work: TaskExecutor,
    name: str,
    alike: Sequence[int] | None = None,
    budget: SearchBudget = UNLIMITED,
) -> list[FittedModel]:
    """Full fits of changes, in the order of `items`, without those that fail or for which `budget` leaves no time.

    An item is a candidate, its strength and the free variables at which its fit starts. `alike` holds, for each item,
    the index of the first one that may have the same fit; None if all differ. `name` is the stage in messages.
    """
    return _refits_in_time(base, items, work, name, alike, budget)[0]


def _refits_in_time(
    base: FittedModel,
    items: Sequence[RefitTask],
    work: TaskExecutor,
    name: str,
    alike: Sequence[int] | None,
    budget: SearchBudget,
    least: int = LEAST_REFITS,
) -> tuple[list[FittedModel], int]:
    """Full fits of changes in the time there is, without those that fail; and the number of items that were tried.

    `items` are (candidate, strength, free variables at the start). At least `least` of them are fitted, whatever the
    budget. `alike` holds, for each item, the index of the first one that may have the same fit, whose fit it takes if
    one residual confirms it; None if all differ. `name` is the stage in messages. `base` is the fit before the change;
    `work` runs the fits.
    """
    alike = range(len(items)) if alike is None else alike
    originals = [k for k, other in enumerate(alike) if other == k]
    ends = map_within_budget(budget, work, name, fit_fully, base, [items[k] for k in originals], least)
    fits: dict[int, StoredFit | None] = dict(zip(originals, ends, strict=True))
    twins = [k for k in range(len(items)) if k not in fits and fits[alike[k]] is not None]
    asked = [(fit_fully, items[k], fits[alike[k]] or StoredFit()) for k in twins]
    fits.update(zip(twins, map_within_budget(budget, work, f"{name}, alike", fit_mirrored, base, asked), strict=True))
    ended = [(k, fit) for k, fit in sorted(fits.items()) if fit is not None]
    return [restore_fit(base, items[k][0], fit) for k, fit in ended if fit], len(ended)


def _simpler(base: FittedModel, fitted: FittedModel) -> list[RefitTask]:
    """Mass or spring to refit in place of a local resonance with a frequency above or below all lines; else empty.

    A list of one item: candidate, strength and free variables (n_params,) at which its fit starts. `base` is the fit
    without the resonance, `fitted` that with it.
    """
    limit = _limit_of(base, fitted, ratio=1.0)
    if limit is None:
        return []
    return _begun(base.modified, [(limit, float(limit.strengths[0]))], {**base.values, **fitted.values})


def _limit_of(base: FittedModel, fitted: FittedModel, ratio: float = RIGID_RATIO) -> Candidate | None:
    """Mass (or rotary inertia) or spring to ground that a fitted local resonance has as its limit; None if it has none.

    A mass if its frequency is above `ratio` times the highest line, a spring if it is below the lowest line over
    `ratio`, or if its mass is more than that of the structure. None too for changes that are no local resonance. `base`
    is the fit without the resonance, `fitted` that with it.
    """
    if not isinstance(fitted.cause, Appendage):
        return None
    added = _added_values(base, fitted)
    dof, lines = (
        parse_dof(fitted.cause.where[0]),
        np.concatenate([problem.frequency for problem in base.modified.problems]),
    )
    size = added["rotary_inertia" if dof.is_rotation else "mass"]
    frequency = np.sqrt(np.abs(added["stiffness"] * (1 + 1j * added["loss_factor"])) / size) / (2 * np.pi)
    if frequency > ratio * lines.max():
        if dof.is_rotation:
            return AddedRotaryInertia(where=(dof.place,), strengths=np.array([size]))
        return Mass(where=(str(dof.node),), strengths=np.array([size]))
    if frequency < lines[lines > 0].min() / ratio or _is_heavier(base, fitted):
        return SpringToGround(where=(dof.place,), strengths=np.array([added["stiffness"]]))
    return None


def _added_values(base: FittedModel, one: FittedModel) -> dict[str, float]:
    """Values in SI units of the parameters that a change adds to those of `base`, by property name, such as ``stiffness``."""
    return {name.partition("[")[0]: value for name, value in one.values.items() if name not in base.values}


def _is_heavier(base: FittedModel, fitted: FittedModel) -> bool:
    """True if the mass of a fitted local resonance is more than that of the whole structure; always False of rotations.

    False too if the structure's mass is not known (0). `base` has the identified values.
    """
    dof = parse_dof(fitted.cause.where[0])
    if dof.is_rotation:
        return False
    problem, values = base.modified.problems[0], base.values
    identified = problem.property_values(np.array([values[name] for name in problem.names]))
    return bool(0 < problem.structure.mass_of(identified) < _added_values(base, fitted)["mass"])


def _lossy(base: FittedModel, fitted: FittedModel) -> list[RefitTask]:
    """Last change of `fitted`, if a spring, support or joint, with a loss factor of 0.02 as further unknown.

    A list of one item to refit (candidate, strength, free variables at the start), or empty: for other changes, for
    modes, where the change leaves more than half of the misfit, and where it leaves only noise. `base` is the fit
    without the change.
    """
    candidate, strength = _last_change(fitted)
    if not isinstance(candidate, SpringToGround | Support | FlexibleJoint) or base.modified.is_of_modes:
        return []
    if fitted.misfit > CLEAR * base.misfit or not fitted.is_misfit:
        return []
    lossy = replace(candidate, loss_factor=SPRING_LOSS)
    return _begun(base.modified, [(lossy, strength)], {**base.values, **fitted.values})


def _begun(
    modified: ModifiedModel, changes: Sequence[CandidateOfStrength], known: Mapping[str, float]
) -> list[RefitTask]:
    """Items (candidate, strength, free variables at the start) of the `changes` that the model allows, in their order.

    `known` holds physical values by parameter name; parameters that are not in it start as the set-ups say. Changes
    that the model does not allow, or with which it cannot be computed, are left out. `modified` is the model before the changes.
    """
    items: list[RefitTask] = []
    for candidate, strength in changes:
        with suppress(StructidError, np.linalg.LinAlgError):
            items.append((candidate, strength, modified.changed(candidate, strength).theta_of(known)))
    return items


def _of_large_model(base: FittedModel, work: TaskExecutor, budget: SearchBudget) -> Explanation:
    """Explanation of the misfit of a large model by at most four refitted changes, without second causes.

    Large are more than 1200 degrees of freedom. The changes are outlying lines, then the best screened changes at the
    start and at the fit in turn: where a fit bends all values to a fault, linear steps from it see what it was bent to,
    and those from the start see the fault. `base` is its fit; `work` and `budget` run and limit screening and fits.
    """
    clock = SearchBudget()
    shortlist = shortlist_candidates(base, work, "causes on a linear look", budget.portion(SCREENING_TIME))
    residual = base.modified.target.residual(base.theta)[: base.modified.target.n_data]
    data = OutlyingLines.from_residual(base.modified.problems, residual)
    likeliest = dict[Hashable, Screened]()
    for row in (*shortlist.in_turn, *shortlist.rows):
        likeliest.setdefault(row.candidate.key, row)
    few = [*(Screened(one, 1.0, base.misfit) for one in data), *likeliest.values()][:LARGE_MODEL_REFITS]
    items = _begun(base.modified, [(one.candidate, one.strength) for one in few], {})
    fits, n_ended = _refits_in_time(base, items, work, "likeliest causes", None, budget)
    return replace(_weighed(base, fits, shortlist.tried), spent=clock.spent, left_out=len(items) - n_ended)


def with_freed(base: FittedModel, names: Sequence[str], tried: int, work: TaskExecutor = SERIAL) -> Explanation:
    """Explanation by fits in each of which one fixed property is made a parameter; each fit may be the truth.

    Parameters
    ----------
    base : FittedModel
        Fit with all properties fixed.
    names : sequence of str
        Fixed properties such as ``mass[deck]``.
    tried : int
        Number of fixed properties from which these were selected.
    work : TaskExecutor
        Runs the fits.

    Returns
    -------
    Explanation
        Its causes are the fits that lower the misfit, the lowest criterion first, without a test against chance.
    """
    changes = [(FixedValue(where=(name,)), 1.0) for name in names]
    fits = _refits(base, _begun(base.modified, changes, base.values), work, "values that the model holds")
    scale = _scale(base, fits)
    fits = sorted((one for one in fits if one.misfit < base.misfit), key=lambda one: _criterion(base, one, scale))
    return Explanation(base, tuple(fits), tuple(_criterion(base, one, scale) for one in fits), tried, tuple(fits))


def requested_changes(base: FittedModel, work: TaskExecutor = SERIAL) -> Explanation:
    """Small changes, fitted, that the record of an answer within its noise asks for beyond chance, as an `Explanation`.

    A score test, with a chance of 1 % for all candidates together, selects at most six changes for a fit. Up to 2000
    lines count, many more than in the screens of a misfit: the changes are far below the noise of any line.

    Parameters
    ----------
    base : FittedModel
        Fit to FRFs, without changes.
    work : TaskExecutor
        Runs the fits.
    """
    point = base.modified.point_at(base.modified.shown_problems, base.theta, REQUEST_LINES)
    several = point.candidates(titles(base.modified.setups))
    scale = max(1.0, base.misfit / max(base.modified.target.n_data - len(base.modified.target.names), 1))
    limit = float(special.ndtri(1 - REQUEST_RISK / (2 * max(len(several), 1)))) * np.sqrt(scale)
    best: dict[Hashable, RequestedChange] = {}
    for one in sorted(point.requested(several), key=lambda one: -one.score):
        if one.score > limit:
            best.setdefault(one.candidate.key, one)
    few = [(one.candidate, one.strength) for one in best.values()][:MOST_REQUESTED]
    fits = (
        _refits(base, _begun(base.modified, few, base.values), work, "changes that the record asks for") if few else []
    )
    return _weighed(base, fits, len(several))


def _weighed(base: FittedModel, fits: Sequence[FittedModel], tried: int) -> Explanation:
    """`Explanation` by the full fits of changes: causes among them, and the likely ones, sorted by criterion.

    Changes that leave no more than noise come first: their sums of squares have fixed values where the model has them,
    those of the others may have them freed. In this order a kind of change that resembles a simpler one is set back by
    its `handicap`. Of fits at one position only the best counts. Causes lower the misfit beyond chance among the `tried`
    changes; the likely ones have a criterion less than 6 above the lowest, that of `base` included.
    """
    scale = _scale(base, fits)
    fits = [one for one in fits if not _is_no_cause_of_its_own(base, one, fits, scale)]
    priced = sorted(
        ((one, _criterion(base, one, scale)) for one in fits),
        key=lambda pair: (pair[0].is_misfit, pair[1] + pair[0].cause.handicap),
    )
    best = {one.cause.place: one for one, _ in reversed(priced)}
    priced = [(one, criterion) for one, criterion in priced if one in best.values()]
    causes = [(one, criterion) for one, criterion in priced if _is_worth(base, one, scale, tried)]
    likeliest = min([_criterion(base, base, scale), *(criterion for _, criterion in priced)])
    likely = tuple(one for one, criterion in priced if criterion - likeliest < ALIKE)
    return Explanation(base, tuple(one for one, _ in causes), tuple(c for _, c in causes), tried, likely)


def _is_no_cause_of_its_own(base: FittedModel, fitted: FittedModel, fits: Sequence[FittedModel], scale: float) -> bool:
    """True if a local resonance is near a limit (mass or spring), fits no better than that, or is too heavy.

    Always False of other changes; too heavy is a mass above that of the structure. The limits are compared among the
    `fits`: a resonance fits no better where a likelihood ratio test at 1 % does not reject the simpler change, with
    `scale` as the variance of whitened residuals and lines within one correlation length of the residual of the simpler
    fit counted as one. `base` is the fit without changes, `fitted` that with the resonance.
    """
    if not isinstance(fitted.cause, Appendage):
        return False
    if _is_heavier(base, fitted):
        return True
    limit, dof = _limit_of(base, fitted), parse_dof(fitted.cause.where[0])
    limits = {("mass", (str(dof.node),)), ("inertia", (dof.place,)), ("spring", (dof.place,))}
    for other in fits:
        if limit is not None and other.cause.place == limit.place:
            return True
        more = n_parameters(fitted.modified) - n_parameters(other.modified)
        if other.cause.place in limits and more > 0:
            ratio = max(other.misfit - fitted.misfit, 0.0) / scale / _lines_that_count_as_one(other)
            if float(special.gammaincc(more / 2, ratio / 2)) > NESTED_RISK:
                return True
    return False


def _lines_that_count_as_one(fitted: FittedModel) -> float:
    """Correlation length of the residual of a fit, in lines, at least 1: so many lines count as one."""
    target = fitted.modified.target
    residual = target.residual(fitted.theta)[: target.n_data]
    return max(1.0, correlation_length(residual, target.rows.lines, target.rows.series))


def _scale(base: FittedModel, fits: Sequence[FittedModel]) -> float:
    """The lowest misfit per degree of freedom among `base` and `fits`, at least 1."""
    n_data = base.modified.target.n_data
    return max(1.0, min(one.misfit / max(n_data - len(one.modified.target.names), 1) for one in (base, *fits)))


def _criterion(base: FittedModel, one: FittedModel, scale: float) -> float:
    return one.misfit / scale + n_parameters(one.modified) * float(np.log(base.modified.target.n_data))


def _is_worth(base: FittedModel, fitted: FittedModel, scale: float, tried: int) -> bool:
    """True if a change lowers the misfit by more than chance among all `tried`, and by a part that matters.

    That part is 10 % of what goes beyond the noise, and the chance 1 %. `scale` is the variance of a whitened residual
    that counts as noise. Data that `fitted` leaves out must also stand out (`_stands_out`). `base` is the fit without
    the change, `fitted` that with it.
    """
    more = max(n_parameters(fitted.modified) - len(base.modified.target.names), 1)
    drop = base.misfit - fitted.misfit
    probability = float(special.gammaincc(more / 2, drop / scale / 2)) if drop > 0 else 1.0
    beyond = max(base.misfit - (base.modified.target.n_data - len(base.modified.target.names)), 0.0)
    return (
        probability * max(tried, 1) < CAUSE_RISK and drop >= LEAST_SHARE * beyond and _stands_out(base, fitted, tried)
    )


def _stands_out(base: FittedModel, fitted: FittedModel, tried: int) -> bool:
    """True if the data that a change leaves out have at least twice the misfit of the rest, beyond chance (F test).

    True as well if it leaves none out. `tried` is the number of changes that were tried, which share the risk of 1 %.
    `base` is the fit without the change, `fitted` that with it.
    """
    left = fitted.modified.target.n_data
    out = base.modified.target.n_data - left
    if out <= 0:
        return True
    ratio = (base.misfit - fitted.misfit) * left / (out * (fitted.misfit - fitted.left_out))
    return ratio >= OUTLYING_RATIO and float(special.fdtrc(out, left, ratio)) * max(tried, 1) < CAUSE_RISK

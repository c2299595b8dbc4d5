"""Which single changes of model or record would explain a misfit: screened by the hundreds, refitted by the dozen."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from structid.core.display import Overview, Shown, plural
from structid.core.dof import parse_dof
from structid.core.errors import StructidError
from structid.criticism.candidate import Candidate, bare
from structid.criticism.data import DATA_KINDS, extra_modes, outlying_lines
from structid.criticism.pool import pool
from structid.criticism.screen import Asked, Screened
from structid.criticism.verdict import FAR_BEYOND
from structid.explanation.edits import WITH_LOSS
from structid.explanation.kindred import kindred
from structid.explanation.pairs import promising
from structid.explanation.refits import (
    MISFIT,
    Change,
    Fit,
    Fitted,
    Item,
    approached,
    likewise,
    refitted,
    restored,
)
from structid.explanation.screening import of_study, shortlisted
from structid.explanation.time_budget import UNLIMITED, TimeBudget, map_within_budget
from structid.explanation.trial import Trial
from structid.explanation.words import cause_words
from structid.identification.setups.setup import titles
from structid.inversion.diagnostics.residual_tests import misfit_probability
from structid.inversion.search.work import ALONE, Work

#: A change with its strength, and free variables where its fit begins.
_FINALISTS = 8
#: Changes of a large model's records that are refitted, each from two starts.
_OF_LARGE = 4
#: Kinds that are always refitted to the end: smoothed data do not show them; and how many of them.
_ALWAYS, _OF_ALWAYS = ("friction", "tone", "leakage"), 3
#: Of changes of the study so many are refitted that leave this part of the misfit at most by a linear step at the fit: with 10 %
#: of model error nobody sees elements that are too long.
_OF_FEW, _AT_FIT = 2, 0.75
#: Part of the misfit that a first cause leaves at most where one more is looked for.
_CLEAR = 0.5
#: Parts of a search's time after which no more linear looks are taken, and no more near fits made; refits that are made in any
#: case.
_LOOKS, _NEAR_FITS, _LEAST_REFITS = 0.4, 0.7, 2
#: Part of the time for the first causes; what these leave is for second ones.
_FIRST = 0.6
#: Chance that a right model within its noise is asked to change, and changes at most that are then fitted.
_ASKED_RISK, _MOST_ASKED = 0.01, 6
#: Lines of a record at most that are asked.
_ASKED_LINES = 2000
#: Pairs with another first cause that are looked for where noise is not all that the first pair leaves.
_MORE_PAIRS = 4
#: Changes beside which a second promises most, that are fitted with one.
_LOOKED_AT = 2
#: Of the sum of squares, what another start must reach.
_CLEARLY_BETTER = 0.9
#: Differences of the criterion below which two causes cannot be told apart.
ALIKE = 6.0
_GIVES_WAY = {"joint": 0.5, "dashpot": 1.0, "friction": 1.5}
#: The same of all sets that are off by one factor.
_ALL_GIVE_WAY = 0.25
#: Loss factor at which a spring's own damping is looked for.
_LOSS = 0.02
_LEAST_SHARE, _RISK = 0.10, 0.01
#: Frequency of something that swings of its own over the highest of the data, from which on it is a mass; and so far below the
#: lowest it stands still.
_FAR = 3.0
#: By how much the misfit of what is left out exceeds that of the rest, value by value.
_TELLING = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class Explanation(Shown):
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
    spent : float
        Processor time that it took, in seconds.
    left_out : int
        How many changes a linear look promises something of, and were not fitted for want of time.
    is_single : bool
        Whether other pairs than the likeliest were not looked for for want of time.
    begun : tuple of Item
        Changes of the model or its channels where their near fits ended, the likeliest first.
    """

    base: Fitted
    causes: tuple[Fitted, ...]
    criteria: tuple[float, ...]
    tried: int
    near: tuple[Fitted, ...] = ()
    further: Explanation | None = None
    better: Fitted | None = None
    spent: float = 0.0
    left_out: int = 0
    is_single: bool = False
    begun: tuple[Item, ...] = ()

    def overview(self) -> Overview:
        """How many changes were tried, and one row for each that explains the misfit."""
        words = f"{plural(self.tried, 'change')} tried, {len(self.causes)} may explain the misfit"
        rows = [
            (
                cause_words(fitted.trial.changes[-1][0], None),
                f"{100 * max(0.0, 1 - fitted.cost / self.base.cost):.3g} %",
            )
            for fitted in self.causes
        ]
        return Overview(words, ("change", "misfit removed"), rows)

    @property
    def likely(self) -> tuple[Fitted, ...]:
        """All changes that may be the truth, second ones beside a first among them."""
        return self.near if self.further is None else (*self.near, *self.further.near)


def explained(base: Fitted, work: Work = ALONE, budget: TimeBudget = UNLIMITED) -> Explanation:
    """The changes that explain the misfit of a fitted study; and where the first leaves some, a second beside it.

    Parameters
    ----------
    base : Fitted
    work : Work
    budget : TimeBudget
        Processor time of the search, most of it for the first causes, what these leave for second ones. Other pairs are
        looked for as long as it suffices for one more.
    """
    base = replace(base, trial=replace(base.trial, fit_seconds=budget.fit_limit))
    if base.trial.is_large:
        return _of_records(base, work, budget)
    other = _from_elsewhere(base)
    if other is not None and not is_misfit(other):
        return Explanation(base, (), (), 0, better=other)
    base = other or base
    first = _once(base, work, "", budget.part(_FIRST))
    if _is_clear(first):
        return _paired(first, work, budget) if is_misfit(first.causes[0]) else first
    return _of_two(first, work, budget) if _is_far(base) else first


def _is_clear(found: Explanation) -> bool:
    """Whether one change removes much of the misfit."""
    return bool(found.causes) and found.causes[0].cost < _CLEAR * found.base.cost


def _is_far(fitted: Fitted) -> bool:
    """Whether the misfit is beyond what intervals may carry."""
    return fitted.cost > FAR_BEYOND * max(fitted.trial.target.n_data - n_parameters(fitted.trial), 1)


def _of_two(found: Explanation, work: Work, budget: TimeBudget, tried: Sequence[Fitted] = ()) -> Explanation:
    """Two changes that leave noise alone, where one by itself brings little.

    A fit to all data that is bent to one of two faults is as wrong once the other is known. Those that were `tried` with a
    second are passed over.
    """
    if budget.left < found.spent or not found.base.trial.is_small:
        return replace(found, is_single=True)
    known = {_place(one.trial.changes[-1][0]) for one in tried}
    begun = [item for item in found.begun if _place(item[0]) not in known]
    for item in promising(found.base, begun, work, "a second beside each change", budget)[:_LOOKED_AT]:
        if budget.left < found.spent:
            break
        first = _first(found, item, work)
        further = None if first is None else _beside(first, work, "of two, second ", budget)
        if first is None or further is None:
            continue
        pair = _led_by(found, first, further)
        if pair is not None and pair.further is not None and not is_misfit(pair.further.causes[0]):
            return pair
    return found


def _first(found: Explanation, item: Item, work: Work) -> Fitted | None:
    """The fit of a change that was fitted near, to the end."""
    known = [one for one in found.causes if _place(one.trial.changes[-1][0]) == _place(item[0])]
    fits = known or _refits(found.base, [item], work, "a first of two causes")
    return fits[0] if fits else None


def _paired(found: Explanation, work: Work, budget: TimeBudget) -> Explanation:
    """The first cause with a second; where noise is not all that both leave, the best of some other pairs.

    Beside the second, another first is looked for: a change that only looks like the first of two faults gives way once the
    second is known, a sensor that is said to be noisy to its wrong sense, something that swings to a mass. Where that brings
    nothing, a second is looked for beside the next of the first causes.
    """
    if budget.left < found.spent / 2:
        return replace(found, is_single=True)
    second = _beside(found.causes[0], work, "second ", budget)
    pair = replace(found, further=second)
    if _is_far(second.causes[0] if second.causes else second.base):
        both = _of_two(found, work, budget, found.causes[:1])
        if both.further is not None:
            return both
        pair = replace(pair, is_single=both.is_single)
    others, is_from_second = list(found.causes[1:]), True
    for _ in range(_MORE_PAIRS):
        second = pair.further or second
        if not second.causes or not is_misfit(second.causes[0]) or not (is_from_second or others):
            break
        if budget.left < second.spent:
            pair = replace(pair, is_single=True)
            break
        better = (
            _from_second(found, second, work, budget)
            if is_from_second
            else _from_next(found, second, others.pop(0), work, budget)
        )
        pair, is_from_second = better or pair, better is not None
    return _second_alone(found, pair, work) or pair


def _second_alone(found: Explanation, pair: Explanation, work: Work) -> Explanation | None:
    """The second cause as the only one, where it explains as much without the first: one that had only looked like it."""
    if pair.further is None or not pair.further.causes or is_misfit(pair.further.causes[0]):
        return None
    alone = _alone(found, pair.further.causes[0], work)
    if alone is None or is_misfit(alone):
        return None
    return _weighed(found.base, [alone, *(one for one in found.causes if one is not alone)], found.tried)


def _from_second(found: Explanation, second: Explanation, work: Work, budget: TimeBudget) -> Explanation | None:
    """A pair with another first cause, where it explains clearly more."""
    alone = _alone(found, second.causes[0], work)
    again = None if alone is None else _beside(alone, work, "beside the second, first ", budget)
    if again is None or not _is_better(again, second):
        return None
    both = again.causes[0]
    first = _alone(found, both, work)
    if first is None:
        return None
    items = _begun(first.trial, [_bare_change(one) for one in second.causes], both.values)
    return _led_by(found, first, _weighed(first, _refits(first, items, work, "second changes beside it"), again.tried))


def _from_next(
    found: Explanation, second: Explanation, first: Fitted, work: Work, budget: TimeBudget
) -> Explanation | None:
    """A pair with this first cause, where it explains clearly more."""
    further = _beside(first, work, "second change after another first one, ", budget)
    return _led_by(found, first, further) if _is_better(further, second) else None


def _is_better(one: Explanation, other: Explanation) -> bool:
    """Whether the likeliest of two pairs is one of the first explanation."""
    if not one.causes:
        return False
    mine, theirs = one.causes[0], other.causes[0]
    scale = _scale(one.base, [mine, theirs])
    return _criterion(one.base, mine, scale) < _criterion(other.base, theirs, scale) - ALIKE


def _led_by(found: Explanation, first: Fitted, further: Explanation) -> Explanation | None:
    """The explanation with another first cause than the one that is likeliest alone, and the second beside it.

    None where the first removes little alone, and noise is not all that is left beside it.
    """
    if not further.causes or (first.cost > _CLEAR * found.base.cost and is_misfit(further.causes[0])):
        return None
    own = _criterion(found.base, first, _scale(found.base, [first]))
    return replace(found, causes=(first,), criteria=(own,), near=(first,), further=further)


def _bare_change(fitted: Fitted) -> Change:
    candidate, strength = fitted.trial.changes[-1]
    return bare(candidate), strength


def _alone(found: Explanation, fitted: Fitted, work: Work) -> Fitted | None:
    """The last change of a fit as the only one."""
    change = _bare_change(fitted)
    for one in found.causes:
        if _place(one.trial.changes[-1][0]) == _place(change[0]):
            return one
    alone = _refits(found.base, _begun(found.base.trial, [change], fitted.values), work, "the second change alone")
    return alone[0] if alone and alone[0].cost < found.base.cost else None


def _from_elsewhere(base: Fitted) -> Fitted | None:
    """The study as it is from the way that candidates are refitted, where that is clearly better."""
    try:
        found = base.trial.fitted([base.trial.approached().theta, base.theta])
    except (StructidError, np.linalg.LinAlgError):
        return None
    cost = float(found.costs[-1])
    return Fitted(base.trial, found.theta, cost) if cost < _CLEARLY_BETTER * base.cost else None


def _once(base: Fitted, work: Work, which: str, budget: TimeBudget) -> Explanation:
    """The changes that explain the misfit of `base`, one at a time: looked at, fitted near, and the likeliest fitted to the end."""
    clock, looks = TimeBudget(), budget.part(_LOOKS)
    shortlist = shortlisted(base, work, f"{which}causes on a linear look", looks)
    problems = base.trial.problems
    residual = base.trial.target.residual(base.theta)[: base.trial.target.n_data]
    data = [*extra_modes(problems), *outlying_lines(problems, residual)]
    few = [
        *of_study(base, work, f"{which}changes of the study", looks),
        *(Screened(one, 1.0, base.cost) for one in data),
    ]
    tried = shortlist.tried + len(few)
    looked = [*few, *kindred(base, shortlist), *shortlist.rows]
    changes = [(bare(one.candidate), one.strength) for one in looked]
    first = len(looked) - len(shortlist.rows)
    alike = [*range(first), *(first + k for k in _first_alike(shortlist.rows))]
    telling = sorted((one for one in few if one.left < _AT_FIT * base.cost), key=lambda one: one.left)[:_OF_FEW]
    at_fit = [*shortlist.at_fit, *telling]
    kept = {k for k, one in enumerate(looked) if one.candidate.kind in _ALWAYS or one in at_fit}
    rank = [
        *np.argsort(np.argsort([one.left for one in few], kind="stable")).tolist(),
        *_ranks_of_kindred(looked[len(few) : first], shortlist.rows),
        *range(len(shortlist.rows)),
    ]
    approaches = _approached(base, changes, alike, rank, kept, work, f"{which}causes", budget)
    near = [one or Fit() for one in approaches]
    order = sorted((k for k, one in enumerate(near) if one), key=lambda k: float(near[k]["cost"]))
    always = [k for k in order if changes[k][0].kind in _ALWAYS][:_OF_ALWAYS]
    finalists = [*always, *(k for k in order if changes[k][0].kind not in _ALWAYS)][:_FINALISTS]
    finalists += [k for k, one in enumerate(looked) if near[k] and one in at_fit and k not in finalists]
    items = [(*changes[k], near[k]["theta"]) for k in finalists]
    same = [next(i for i, other in enumerate(finalists) if alike[other] == alike[k]) for k in finalists]
    fits, n_ended = _refits_in_time(base, items, work, f"likeliest {which}causes", same, budget)
    known = {_place(one.trial.changes[-1][0]) for one in fits}
    plain = {_place(item[0]): item for one in fits for item in _plainer(base, one)}
    others = [item for place, item in plain.items() if place not in known]
    others += [item for one in fits for item in _lossy(base, one)]
    if others:
        more, n_more = _refits_in_time(base, others, work, f"likeliest {which}causes, otherwise", None, budget, least=0)
        fits, n_ended = fits + more, n_ended + n_more - len(others)
    left_out = approaches.count(None) + len(items) - n_ended
    begun = [(*changes[k], near[k]["theta"]) for k in order if alike[k] == k and changes[k][0].kind not in DATA_KINDS]
    return replace(_weighed(base, fits, tried), spent=clock.spent, left_out=left_out, begun=tuple(begun))


def _ranks_of_kindred(kindred: Sequence[Screened], rows: Sequence[Screened]) -> list[int]:
    """The ranks of changes that no linear look is taken at: behind the finalists, but for feet that turn together.

    These come first where a look promises something of one of them.
    """
    turning = {row.candidate.where[0] for row in rows if row.candidate.kind == "support"}
    return [
        0 if one.candidate.kind == "support" and turning.intersection(one.candidate.where) else _FINALISTS + k
        for k, one in enumerate(kindred)
    ]


def _beside(first: Fitted, work: Work, which: str, budget: TimeBudget) -> Explanation:
    """What else a changed study would need; nothing where its records cannot be looked at so: friction under two loads."""
    try:
        return _once(first, work, which, budget)
    except (StructidError, np.linalg.LinAlgError):
        return Explanation(first, (), (), 0)


def _place(candidate: Candidate) -> tuple[str, tuple[str, ...]]:
    return candidate.kind, candidate.where


def _first_alike(rows: Sequence[Screened]) -> list[int]:
    """For each change the first that a linear look cannot tell from it: mostly itself, at mirrored places another."""
    seen = [(one.candidate.kind, f"{one.strength:.9e}", f"{one.left:.9e}") for one in rows]
    return [seen.index(key) for key in seen]


def _approached(
    base: Fitted,
    changes: Sequence[Change],
    alike: Sequence[int],
    rank: Sequence[int],
    kept: Collection[int],
    work: Work,
    name: str,
    budget: TimeBudget,
) -> list[Fit | None]:
    """`approached` of every change, of those of low `rank` first; None of those that there is no time for.

    Where so many of these are better that another cannot be among the finalists, its fit ends early, but for what is `kept`
    whatever comes of it.
    """
    time = TimeBudget(budget.left - (1 - _NEAR_FITS) * budget.seconds) if np.isfinite(budget.seconds) else budget
    originals = sorted((k for k, other in enumerate(alike) if other == k), key=lambda k: rank[k])
    first = [k for k in originals if rank[k] < _FINALISTS]
    least = _LEAST_REFITS
    fits = map_within_budget(
        time, work, f"most promising {name}", approached, base, [(*changes[k], np.inf) for k in first], least
    )
    known: dict[int, Fit | None] = dict(zip(first, fits, strict=True))
    costs = sorted(fit["cost"] for k, fit in known.items() if fit and changes[k][0].kind not in _ALWAYS)
    above = costs[_FINALISTS - 1] if len(costs) >= _FINALISTS else np.inf
    rest = sorted((k for k in originals if k not in known), key=lambda k: k not in kept)
    items = [(*changes[k], np.inf if k in kept else above) for k in rest]
    known.update(zip(rest, map_within_budget(time, work, name, approached, base, items), strict=True))
    twins = [k for k in range(len(changes)) if k not in known and known[alike[k]] is not None]
    asked = [(approached, (*changes[k], np.inf if k in kept else above), known[alike[k]] or Fit()) for k in twins]
    known.update(zip(twins, map_within_budget(time, work, f"{name}, alike", likewise, base, asked), strict=True))
    return [known.get(k) for k in range(len(changes))]


def _refits(
    base: Fitted,
    items: Sequence[Item],
    work: Work,
    name: str,
    alike: Sequence[int] | None = None,
    budget: TimeBudget = UNLIMITED,
) -> list[Fitted]:
    """The changes fitted to the end, those that a model can be made of; see `_refits_in_time`."""
    return _refits_in_time(base, items, work, name, alike, budget)[0]


def _refits_in_time(
    base: Fitted,
    items: Sequence[Item],
    work: Work,
    name: str,
    alike: Sequence[int] | None,
    budget: TimeBudget,
    least: int = _LEAST_REFITS,
) -> tuple[list[Fitted], int]:
    """The changes fitted to the end, those that a model can be made of, and of how many the time sufficed for.

    Those that may be `alike` an earlier one take its answer where they can.
    """
    alike = range(len(items)) if alike is None else alike
    originals = [k for k, other in enumerate(alike) if other == k]
    ends = map_within_budget(budget, work, name, refitted, base, [items[k] for k in originals], least)
    fits: dict[int, Fit | None] = dict(zip(originals, ends, strict=True))
    twins = [k for k in range(len(items)) if k not in fits and fits[alike[k]] is not None]
    asked = [(refitted, items[k], fits[alike[k]] or Fit()) for k in twins]
    fits.update(zip(twins, map_within_budget(budget, work, f"{name}, alike", likewise, base, asked), strict=True))
    ended = [(k, fit) for k, fit in sorted(fits.items()) if fit is not None]
    return [restored(base, items[k][0], fit) for k, fit in ended if fit], len(ended)


def _plainer(base: Fitted, one: Fitted) -> list[Item]:
    """What swings of its own far above all lines, as the mass that it is, far below them as a spring, to be refitted."""
    candidate, _ = one.trial.changes[-1]
    if candidate.kind != "appendage":
        return []
    added = {name.partition("[")[0]: value for name, value in one.values.items() if name not in base.values}
    dof, lines = parse_dof(candidate.where[0]), np.concatenate([problem.frequency for problem in base.trial.problems])
    size = added["rotary_inertia" if dof.is_rotation else "mass"]
    own = np.sqrt(added["stiffness"] / size) / (2 * np.pi)
    if own > _FAR * lines.max():
        kind, where = ("inertia", dof.place) if dof.is_rotation else ("mass", str(dof.node))
    elif own < lines[lines > 0].min() / _FAR:
        kind, where, size = "spring", dof.place, added["stiffness"]
    else:
        return []
    plainer = Candidate(kind, (where,), strengths=np.array([size]))
    return _begun(base.trial, [(plainer, size)], {**base.values, **one.values})


def _lossy(base: Fitted, one: Fitted) -> list[Item]:
    """A spring that is most of the cause but not all, with damping of its own, to be refitted."""
    candidate, strength = one.trial.changes[-1]
    if candidate.kind not in WITH_LOSS or base.trial.is_of_modes or one.cost > _CLEAR * base.cost or not is_misfit(one):
        return []
    lossy = replace(candidate, detail={**candidate.detail, "loss_factor": _LOSS})
    return _begun(base.trial, [(lossy, strength)], {**base.values, **one.values})


def _begun(trial: Trial, changes: Sequence[Change], known: Mapping[str, float]) -> list[Item]:
    """The changes that a study has a place for, with known physical values where their fits begin."""
    items: list[Item] = []
    for candidate, strength in changes:
        with suppress(StructidError):
            items.append((candidate, strength, trial.changed(candidate, strength).theta_of(known)))
    return items


def _of_records(base: Fitted, work: Work, budget: TimeBudget) -> Explanation:
    """The likeliest changes of the records of a large model, so few that they cost some identifications at most."""
    clock = TimeBudget()
    shortlist = shortlisted(base, work, "causes on a linear look", budget.part(_LOOKS))
    residual = base.trial.target.residual(base.theta)[: base.trial.target.n_data]
    data = outlying_lines(base.trial.problems, residual)
    few = [*(Screened(one, 1.0, base.cost) for one in data), *shortlist.rows][:_OF_LARGE]
    items = _begun(base.trial, [(bare(one.candidate), one.strength) for one in few], {})
    fits, n_ended = _refits_in_time(base, items, work, "likeliest causes", None, budget)
    return replace(_weighed(base, fits, shortlist.tried), spent=clock.spent, left_out=len(items) - n_ended)


def with_freed(base: Fitted, names: Sequence[str], tried: int, work: Work = ALONE) -> Explanation:
    """The study with each of some properties free that it holds, all of which may be the truth.

    Parameters
    ----------
    base : Fitted
    names : sequence of str
        Such as ``mass[deck]``.
    tried : int
        Of how many they are.
    work : Work
    """
    changes = [(Candidate("held", (name,)), 1.0) for name in names]
    fits = _refits(base, _begun(base.trial, changes, base.values), work, "values that the model holds")
    scale = _scale(base, fits)
    fits = sorted((one for one in fits if one.cost < base.cost), key=lambda one: _criterion(base, one, scale))
    return Explanation(base, tuple(fits), tuple(_criterion(base, one, scale) for one in fits), tried, tuple(fits))


def asked_for(base: Fitted, work: Work = ALONE) -> Explanation:
    """Of all changes that can be small, those that the record of an answer within its noise asks for beyond chance, fitted.

    Many more lines count than in the screens of a misfit: what is looked for is far below the noise of any of them.

    Parameters
    ----------
    base : Fitted
        Of FRFs.
    work : Work
    """
    point = base.trial.looked_at(base.trial.seen, base.theta, _ASKED_LINES)
    candidates = pool(point.records, titles(base.trial.setups))
    scale = max(1.0, base.cost / max(base.trial.target.n_data - len(base.trial.target.names), 1))
    limit = float(special.ndtri(1 - _ASKED_RISK / (2 * max(len(candidates), 1)))) * np.sqrt(scale)
    best: dict[tuple[object, ...], Asked] = {}
    for one in sorted(point.asked(candidates), key=lambda one: -one.score):
        if one.score > limit:
            own = one.candidate
            best.setdefault((own.kind, own.where, own.record, *own.others[:1]), one)
    few = [(bare(one.candidate), one.strength) for one in best.values()][:_MOST_ASKED]
    fits = _refits(base, _begun(base.trial, few, base.values), work, "changes that the record asks for") if few else []
    return _weighed(base, fits, len(candidates))


def _weighed(base: Fitted, fits: Sequence[Fitted], tried: int) -> Explanation:
    """Which refitted changes are causes, and which may be the truth."""
    scale = _scale(base, fits)
    priced = sorted(((one, _criterion(base, one, scale)) for one in fits), key=lambda pair: pair[1] + _odds(pair[0]))
    best = {_place(one.trial.changes[-1][0]): one for one, _ in reversed(priced)}
    priced = [(one, criterion) for one, criterion in priced if one in best.values()]
    causes = [(one, criterion) for one, criterion in priced if _is_worth(base, one, scale, tried)]
    likeliest = min([_criterion(base, base, scale), *(criterion for _, criterion in priced)])
    likely = tuple(one for one, criterion in priced if criterion - likeliest < ALIKE)
    return Explanation(base, tuple(one for one, _ in causes), tuple(c for _, c in causes), tried, likely)


def _odds(one: Fitted) -> float:
    """What a cause gives way to a plainer one that says the same: at a clamped end a joint to the support, a damper to a
    spring where both hold still, all masses to the calibration of the load.
    """
    candidate = one.trial.changes[-1][0]
    if candidate.kind == "held" and len(candidate.where) > 1:
        return _ALL_GIVE_WAY
    return _GIVES_WAY.get(candidate.kind, 0.0)


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
    beyond = max(base.cost - (base.trial.target.n_data - len(base.trial.target.names)), 0.0)
    return probability * max(tried, 1) < _RISK and drop >= _LEAST_SHARE * beyond and _stands_out(base, one, tried)


def _stands_out(base: Fitted, one: Fitted, tried: int) -> bool:
    """Whether data that a change leaves out miss more than the others, by an F test: any that are left out take a part along."""
    left = one.trial.target.n_data
    out = base.trial.target.n_data - left
    if out <= 0:
        return True
    ratio = (base.cost - one.cost) * left / (out * (one.cost - one.aside))
    return ratio >= _TELLING and float(special.fdtrc(out, left, ratio)) * max(tried, 1) < _RISK


def is_misfit(fitted: Fitted) -> bool:
    """Whether what a fit leaves is more than chance makes of noise."""
    dof = fitted.trial.target.n_data - n_parameters(fitted.trial)
    return dof > 0 and misfit_probability(fitted.trial.target, fitted.cost, dof) < MISFIT


def n_parameters(trial: Trial) -> int:
    """Parameters of a study, and of what was left out of it, is a tone or a length."""
    several, lengths = ("outlying_lines", "tone"), ("offset", "between", "load_between")
    own = [
        len(c.where) if c.kind in several else 1 for c, _ in trial.changes if c.kind in (*DATA_KINDS, "tone", *lengths)
    ]
    return len(trial.target.names) + sum(own)

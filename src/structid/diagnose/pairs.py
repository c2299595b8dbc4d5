"""Pairs of changes: two faults of which each alone lowers the misfit little, found from the most promising first change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from structid.core.errors import StructidError
from structid.diagnose.refits import FittedModel, RefitTask
from structid.diagnose.search_budget import UNLIMITED, SearchBudget, map_within_budget
from structid.diagnose.thresholds import (
    PAIR_LEFT,
    PAIR_LOOKS,
    PAIR_LOOKS_OF_KIND,
)
from structid.identification.setups.setup import titles
from structid.inversion.search.work import TaskContext, TaskExecutor


def promising(
    base: FittedModel, items_begun: Sequence[RefitTask], work: TaskExecutor, name: str, budget: SearchBudget = UNLIMITED
) -> list[RefitTask]:
    """First changes beside which a second one leaves at most 30 % of the misfit, sorted by what the best second leaves.

    Second changes are screened at quick fits of log-FRFs that stay near the start values: a full fit of one of two
    faults is bent towards the other. At most twelve first changes are tried, two of a kind.

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
    """
    of_kind, items = Counter[str](), list[RefitTask]()
    for item in items_begun:
        of_kind[item[0].kind] += 1
        if of_kind[item[0].kind] <= PAIR_LOOKS_OF_KIND:
            items.append(item)
    items = items[:PAIR_LOOKS]
    modified = base.modified
    whole = modified.point_at(modified.anchored_views(), base.near_theta).left
    looks = map_within_budget(budget, work, name, _looked_beside, base, items)
    left = [np.inf if look is None else look["left"] for look in looks]
    order = np.argsort(left, kind="stable").tolist()
    return [items[k] for k in order if left[k] < PAIR_LEFT * whole]


def _looked_beside(base: FittedModel, item: RefitTask, tools: TaskContext) -> dict[str, float]:
    """The misfit, under ``left``, after a change and the best second change, by a linear step; infinite where that fails.

    `item` is the first change, its strength and the free variables of its quick fit.
    """
    candidate, strength, theta = item
    try:
        modified = base.modified.changed(candidate, strength)
        point = modified.point_at(modified.anchored_views(), theta)
        rows = point.screened(point.candidates(titles(modified.setups)))
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    return {"left": min((row.left for row in rows), default=np.inf)}

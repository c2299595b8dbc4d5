"""Pairs of changes: two faults of which each alone lowers the misfit little, found from the most promising first change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from structid.core.errors import StructidError
from structid.diagnose.refits import Fitted, Item
from structid.diagnose.search_budget import UNLIMITED, SearchBudget, map_within_budget
from structid.diagnose.thresholds import (
    PAIR_LEFT,
    PAIR_LOOKS,
    PAIR_LOOKS_OF_KIND,
)
from structid.identification.setups.setup import titles
from structid.inversion.search.work import Tools, Work


def promising(
    base: Fitted, begun: Sequence[Item], work: Work, name: str, budget: SearchBudget = UNLIMITED
) -> list[Item]:
    """Changes, best first, beside which the best screened second change leaves little misfit.

    Looks are taken at near fits, of the logarithm of the FRFs with the start held: a full fit of one of two faults is bent
    to the other.

    Parameters
    ----------
    base : Fitted
    begun : sequence of Item
        Changes where their near fits ended, the likeliest first.
    work : Work
    name : str
        What the looks are called in progress and checkpoints.
    budget : SearchBudget
    """
    of_kind, items = Counter[str](), list[Item]()
    for item in begun:
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


def _looked_beside(base: Fitted, item: Item, tools: Tools) -> dict[str, float]:
    """The misfit that the best second change beside this one leaves, parameters following linearly; else infinite."""
    candidate, strength, theta = item
    try:
        modified = base.modified.changed(candidate, strength)
        point = modified.point_at(modified.anchored_views(), theta)
        rows = point.screened(point.candidates(titles(modified.setups)))
    except (StructidError, np.linalg.LinAlgError):
        return {"left": np.inf}
    return {"left": min((row.left for row in rows), default=np.inf)}

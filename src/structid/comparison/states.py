"""Two states of one structure: the later one identified with what the baseline says of its unchanged parameters."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from structid.errors import InputError
from structid.estimation.comparison.comparison import Identified
from structid.unknowns import Parameters, joint_prior


def unchanged_parameters(baseline: Identified, later: Parameters, patterns: Sequence[str]) -> tuple[str, ...]:
    """Names of both states that `patterns` choose: a full name, a kind such as ``mass``, or a pattern with ``*``.

    Raises
    ------
    InputError
        If a pattern chooses nothing that both states identify.
    """
    common = [(n, k) for n, k in zip(baseline.names, baseline.kinds, strict=True) if n in later.names]
    chosen: list[str] = []
    for pattern in patterns:
        like = re.compile(".*".join(map(re.escape, pattern.split("*"))))
        found = [n for n, k in common if pattern == k or like.fullmatch(n)]
        if not found:
            have = ", ".join(dict.fromkeys(k for _, k in common)) or "none"
            raise InputError(
                f"`unchanged` must name parameters that both states identify, got {pattern!r}; kinds that both have:"
                f" {have}"
            )
        chosen += found
    return tuple(dict.fromkeys(chosen))


def carried(baseline: Identified, later: Parameters, unchanged: Sequence[str]) -> Parameters:
    """The later state's parameters, started at the baseline, with its result as the prior of the unchanged ones.

    Parameters
    ----------
    baseline : Estimate or StoredEstimate
    later : Parameters
    unchanged : sequence of str
        Names; see `unchanged_parameters`. Their prior is the Gaussian of the baseline with all its correlations, so
        that what the baseline does not know of them is not known later either. Pass the same names to
        `compare_states` as `carried`.

    Raises
    ------
    InputError
        If the baseline does not determine one of them.
    """
    place = {name: i for i, name in enumerate(baseline.names)}
    start = np.array([baseline.values[place[n]] if n in place else later.start[i] for i, n in enumerate(later.names)])
    inside = (start > later.transforms.lower) & (start < later.transforms.upper)
    later = later.started_at(np.where(inside, start, later.start))
    if not unchanged:
        return later
    rows = [place[name] for name in unchanged]
    return later.coupled(
        joint_prior(
            "baseline",
            later.names,
            tuple(unchanged),
            baseline.values[rows],
            baseline.covariance[np.ix_(rows, rows)],
            logarithmic=bool((baseline.values[rows] > 0).all()),
        )
    )

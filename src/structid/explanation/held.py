"""What the values of an answer rest on, by the study with all that its model holds set free at once."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from structid.core.errors import StructidError
from structid.criticism.candidate import Candidate
from structid.criticism.held import HeldValue, influences
from structid.criticism.pool import MOST_DOFS
from structid.criticism.verdict import fits_noise
from structid.explanation.by_study import held_candidates
from structid.explanation.edits import edit
from structid.explanation.trial import read_study, started_at, weighed_like
from structid.forward.scatter import scatter_problems
from structid.identification.identified import Identification
from structid.identification.joint_problem import joint_problem
from structid.inversion import Problem
from structid.inversion.uncertainty import relative_steps
from structid.study.run.start import Start


def held_values(ready: Start, found: Identification) -> tuple[HeldValue, ...]:
    """What every held mass and stiffness does to the answer; none of models or searches that are too large for that.

    Parameters
    ----------
    ready : Start
        The study with its records.
    found : Identification
        Its answer.
    """
    setup = ready.setups[0]
    is_small = setup.structure.n_dofs <= MOST_DOFS and found.target is not None
    if not is_small or not found.estimate.uncertainty.has_matrix or not ready.study.structure.has_matrices:
        return ()
    held = held_candidates(setup.structure, setup.parameters)
    known = dict(zip(found.estimate.names, found.estimate.values.tolist(), strict=True))
    target = _freed(ready, found, held, known)
    if target is None:  # what can be freed, one by one
        held = tuple(one for one in held if _freed(ready, found, (one,), known) is not None)
        target = _freed(ready, found, held, known)
    if target is None or not held:
        return ()
    theta = target.theta_start
    at = target.linearize(theta)
    place = {name: i for i, name in enumerate(target.names)}
    free = [name for name, is_free in zip(found.estimate.names, found.estimate.spread.is_free, strict=True) if is_free]
    names = [name for name in target.names if name not in known]
    columns = [place[name] for name in (*free, *names)]
    estimate = found.estimate
    scale = 1.0 if fits_noise(found) else np.nan  # what a wrong model pulls at says nothing of a held value
    std = (estimate.std / target.unknowns.sizes(target.physical(theta))[[place[name] for name in estimate.names]])[
        estimate.spread.is_free
    ]
    fixed = estimate.fixed
    tolerances = {} if fixed is None else dict(zip(fixed.names, fixed.tolerance.tolist(), strict=True))
    rows = (at.jacobian * relative_steps(target, theta))[:, columns]
    found_values = influences(rows, at.residual, free, names, std, scale)
    return tuple(replace(one, tolerance=tolerances.get(one.name, 0.0)) for one in found_values)


def _freed(ready: Start, found: Identification, held: Sequence[Candidate], known: dict[str, float]) -> Problem | None:
    """The study with what it holds among its unknowns, started at the answer; None where it cannot be read so."""
    tables = deepcopy(dict(ready.study.root.table))
    before = [(source.section.table, setup) for source, setup in zip(ready.study.setups, ready.setups, strict=True)]
    try:
        for candidate in held:
            edit(tables, candidate, 1.0)
        problems, _, _ = read_study(ready.study, tables, before)
        problems = weighed_like(problems, found.problems, scatter_problems(found.problems))
        return joint_problem([started_at(one, known) for one in problems])
    except (StructidError, np.linalg.LinAlgError):
        return None  # some property has no place among the unknowns

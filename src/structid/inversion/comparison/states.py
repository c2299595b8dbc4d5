"""Two states of one structure as one problem: what stayed the same is one unknown, what may have changed is two."""

from __future__ import annotations

from collections.abc import Sequence

from structid.core.errors import InputError
from structid.inversion.problem import Problem
from structid.inversion.problems.joint import JointProblem

#: What is added to the names of the later state's own parameters.
LATER = " (later)"
#: What stands before the name of a record in that of a value of its own; such values are of no state, so not compared.
OF_RECORD = " @ "


def states_problem(baseline: Problem, later: Problem, shared: Sequence[str]) -> JointProblem:
    """Joint problem of the data of both states, with the `shared` parameters equal and all others free in each.

    The later state's own parameters are called ``<name> (later)``.

    Parameters
    ----------
    baseline, later : Problem
        From independent data.
    shared : sequence of str
        Names of parameters of both.

    Raises
    ------
    InputError
        If a shared parameter is missing in one of them, or differs in unit, transform, bounds or prior.
    """
    for name in shared:
        if name not in baseline.names or name not in later.names:
            raise InputError(f"`shared` must name parameters of both states, got {name!r}; identify it in both")
    names = tuple(name if name in shared else name + LATER for name in later.names)
    return JointProblem((baseline, later), labels=(baseline.names, names))

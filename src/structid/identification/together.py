"""The problems of several records as one: what they share begins alike, and counts once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.forward import RecordProblem
from structid.forward.scatter import scatter_problems
from structid.identification.varying import varying
from structid.inversion import JointProblem, Problem
from structid.unknowns.named_unknowns import N, NamedUnknowns
from structid.unknowns.priors import Prior, priors_of


def together(problems: Sequence[RecordProblem]) -> Problem:
    """The one problem, or all in one; with the scatter of what differs from record to record."""
    scatters = scatter_problems(problems)
    return problems[0] if len(problems) == 1 and not scatters else JointProblem((*problems, *scatters))


def places(names: tuple[str, ...], wanted: Sequence[str]) -> IntArray:
    """Positions among `names` of those `wanted`."""
    place = {name: i for i, name in enumerate(names)}
    return np.array([place[name] for name in wanted], dtype=int)


def by_name(
    names: tuple[str, ...], problems: Sequence[RecordProblem], values: Callable[[NamedUnknowns], FloatArray]
) -> FloatArray:
    """An array of the unknowns for all parameters, each from the first problem that has it."""
    known: dict[str, float] = {}
    for problem in problems:
        for name, value in zip(problem.names, values(problem.unknowns), strict=True):
            known.setdefault(name, value)
    return np.array([known[name] for name in names])


def alike(problems: Sequence[RecordProblem], titles: Sequence[str]) -> tuple[RecordProblem, ...]:
    """The same problems, with parameters of the same name begun alike and with the prior that any of them states.

    What varies from record to record has a value of its own in each of them.

    Parameters
    ----------
    problems : sequence of RecordProblem
    titles : sequence of str
        What each record is called.

    Raises
    ------
    InputError
        If two of them state different priors or scatters of one parameter, or too few records have one that varies.
    """
    problems = varying(problems, titles)
    if len(problems) == 1:
        return tuple(problems)
    first: dict[str, tuple[NamedUnknowns, int]] = {}
    priors: dict[str, Prior] = {}
    for part in (part for problem in problems for part in problem.parts):
        for i, name in enumerate(part.names):
            first.setdefault(name, (part, i))
            stated = part.priors.one(i)
            if stated is not None and priors.setdefault(name, stated) != stated:
                raise InputError(f"prior of {name} must be the same in all set-ups, got two; state it once, or alike")
    return tuple(
        problem.with_parts([_begun_alike(part, first, priors) for part in problem.parts]) for problem in problems
    )


def _begun_alike(unknowns: N, first: Mapping[str, tuple[NamedUnknowns, int]], priors: Mapping[str, Prior]) -> N:
    """The same with start and scale of each as the unknowns that `first` names by it, and with these `priors`."""
    if not unknowns.names:
        return unknowns
    origin = [first[name] for name in unknowns.names]
    return replace(
        unknowns,
        start=locked([one.start[i] for one, i in origin], float),
        scale=locked([one.scale[i] for one, i in origin], float),
        priors=priors_of(priors.get(name) for name in unknowns.names),
    )

"""The search over the problems of one or several records, with the polarities that no continuous search can decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import TypeVar

import numpy as np

from structid.arrays import FloatArray, locked
from structid.errors import InputError
from structid.estimation import Estimate, JointProblem, Problem, Status
from structid.observation import ChannelErrors, FrfProblem, ModalProblem
from structid.unknowns import Parameters

_MOST_TRIED = 3
_PRIOR_FIELDS = ("prior_mean", "prior_std", "prior_lognormal")

Named = TypeVar("Named", Parameters, ChannelErrors)
#: What one record of a study gives: the least-squares problem of its FRFs, or of its modes.
RecordProblem = FrfProblem | ModalProblem


def together(problems: Sequence[RecordProblem]) -> Problem:
    """The one problem, or all in one."""
    return problems[0] if len(problems) == 1 else JointProblem(tuple(problems))


def shared_parts(problems: Sequence[RecordProblem]) -> tuple[object, ...]:
    """Structure and record of each problem: what another process that reads the same study has as well."""
    return tuple(part for problem in problems for part in (problem.structure, problem.record))


def decided(problem: RecordProblem, theta: FloatArray) -> RecordProblem:
    """The problem with the polarities that `theta` asks for; modes have none."""
    return problem.decided(theta) if isinstance(problem, FrfProblem) else problem


def by_name(names: tuple[str, ...], problems: Sequence[RecordProblem], field: str) -> FloatArray:
    """An array attribute of the problems for all parameters, each from the first problem that has it."""
    known: dict[str, float] = {}
    for problem in problems:
        for name, value in zip(problem.names, getattr(problem, field), strict=True):
            known.setdefault(name, value)
    return np.array([known[name] for name in names])


def alike(problems: Sequence[RecordProblem]) -> tuple[RecordProblem, ...]:
    """The same problems, with parameters of the same name begun alike and with the prior that any of them states.

    Raises
    ------
    InputError
        If two of them state different priors of one parameter.
    """
    if len(problems) == 1:
        return tuple(problems)
    starts: dict[str, float] = {}
    scales: dict[str, float] = {}
    priors: dict[str, tuple[float, ...]] = {}
    parts = ((problem.parameters, _channels(problem)) for problem in problems)
    for part in (part for pair in parts for part in pair if part is not None):
        for i, name in enumerate(part.names):
            starts.setdefault(name, float(part.start[i]))
            if isinstance(part, ChannelErrors):
                scales.setdefault(name, float(part.scale[i]))
            stated = tuple(float(getattr(part, field)[i]) for field in _PRIOR_FIELDS)
            if np.isfinite(stated[1]) and priors.setdefault(name, stated) != stated:
                raise InputError(f"prior of {name} must be the same in all set-ups, got two; state it once, or alike")
    made: list[RecordProblem] = []
    for problem in problems:
        begun = _begun(problem.parameters, starts, priors)
        if isinstance(problem, ModalProblem):
            made.append(replace(problem, parameters=begun))
            continue
        channels = problem.channels
        if channels is not None:
            channels = replace(channels, scale=locked([scales[name] for name in channels.names], float))
            channels = _begun(channels, starts, priors)
        made.append(replace(problem, parameters=begun, channels=channels))
    return tuple(made)


def _channels(problem: RecordProblem) -> ChannelErrors | None:
    return problem.channels if isinstance(problem, FrfProblem) else None


def _begun(part: Named, starts: dict[str, float], priors: dict[str, tuple[float, ...]]) -> Named:
    none = (np.nan, np.nan, 0.0)
    mean, std, lognormal = (
        zip(*(priors.get(name, none) for name in part.names), strict=True) if part.names else ((),) * 3
    )
    return replace(
        part,
        start=locked([starts[name] for name in part.names], float),
        prior_mean=locked(mean, float),
        prior_std=locked(std, float),
        prior_lognormal=locked(lognormal, bool),
    )


def searched(
    problems: tuple[RecordProblem, ...], search: Callable[[Problem], Estimate]
) -> tuple[Estimate, tuple[RecordProblem, ...]]:
    """The best fit, and the problems with the polarities that it has.

    Polarities begin as the initial model asks for and are decided again by the fitted model. Where the fit then
    misses the noise, every other choice of up to three polarities is tried too.

    Parameters
    ----------
    problems : tuple of FrfProblem or ModalProblem
    search : callable
        The estimate of one problem.
    """
    current = tuple(decided(problem, problem.theta_start) for problem in problems)
    found = search(together(current))
    tried = {_polarities(current): (found, current)}
    while True:
        theta = dict(zip(found.names, found.theta, strict=True))
        current = tuple(decided(p, np.array([theta[name] for name in p.names])) for p in current)
        if _polarities(current) in tried:
            break
        found = search(together(current))
        tried[_polarities(current)] = (found, current)
    count = len(_polarities(current))
    if 0 < count <= _MOST_TRIED and min(f.covariance_basis == "model_error" for f, _ in tried.values()):
        for signs in product((1.0, -1.0), repeat=count):
            if signs not in tried:
                current = _with_polarities(current, signs)
                tried[signs] = (search(together(current)), current)
    return min(tried.values(), key=lambda pair: (pair[0].status is Status.NOT_CONVERGED, pair[0].chi_square))


def _polarities(problems: tuple[RecordProblem, ...]) -> tuple[float, ...]:
    found = [channels.polarities for channels in map(_channels, problems) if channels is not None]
    return tuple(float(sign) for own in found for sign in own)


def _with_polarities(problems: tuple[RecordProblem, ...], signs: Sequence[float]) -> tuple[RecordProblem, ...]:
    made: list[RecordProblem] = []
    rest = list(signs)
    for problem in problems:
        if isinstance(problem, FrfProblem) and problem.channels is not None:
            count = len(problem.channels.polarities)
            own, rest = rest[:count], rest[count:]
            problem = replace(problem, channels=replace(problem.channels, polarities=locked(own, float)))
        made.append(problem)
    return tuple(made)

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
from structid.observation import ChannelErrors, FrfProblem
from structid.parameters import Parameters

_MOST_TRIED = 3
_PRIOR_FIELDS = ("prior_mean", "prior_std", "prior_lognormal")

Named = TypeVar("Named", Parameters, ChannelErrors)


def together(problems: Sequence[FrfProblem]) -> Problem:
    """The one problem, or all in one."""
    return problems[0] if len(problems) == 1 else JointProblem(tuple(problems))


def by_name(names: tuple[str, ...], problems: Sequence[FrfProblem], field: str) -> FloatArray:
    """An array attribute of the problems for all parameters, each from the first problem that has it."""
    known: dict[str, float] = {}
    for problem in problems:
        for name, value in zip(problem.names, getattr(problem, field), strict=True):
            known.setdefault(name, value)
    return np.array([known[name] for name in names])


def alike(problems: Sequence[FrfProblem]) -> tuple[FrfProblem, ...]:
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
    for part in (part for problem in problems for part in (problem.parameters, problem.channels) if part is not None):
        for i, name in enumerate(part.names):
            starts.setdefault(name, float(part.start[i]))
            if isinstance(part, ChannelErrors):
                scales.setdefault(name, float(part.scale[i]))
            stated = tuple(float(getattr(part, field)[i]) for field in _PRIOR_FIELDS)
            if np.isfinite(stated[1]) and priors.setdefault(name, stated) != stated:
                raise InputError(f"prior of {name} must be the same in all set-ups, got two; state it once, or alike")
    made = []
    for problem in problems:
        channels = problem.channels
        if channels is not None:
            channels = replace(channels, scale=locked([scales[name] for name in channels.names], float))
            channels = _begun(channels, starts, priors)
        made.append(replace(problem, parameters=_begun(problem.parameters, starts, priors), channels=channels))
    return tuple(made)


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
    problems: tuple[FrfProblem, ...], search: Callable[[Problem], Estimate]
) -> tuple[Estimate, tuple[FrfProblem, ...]]:
    """The best fit, and the problems with the polarities that it has.

    Polarities begin as the initial model asks for and are decided again by the fitted model. Where the fit then
    misses the noise, every other choice of up to three polarities is tried too.

    Parameters
    ----------
    problems : tuple of FrfProblem
    search : callable
        The estimate of one problem.
    """
    current = tuple(problem.decided(problem.theta_start) for problem in problems)
    found = search(together(current))
    tried = {_polarities(current): (found, current)}
    while True:
        theta = dict(zip(found.names, found.theta, strict=True))
        current = tuple(p.decided(np.array([theta[name] for name in p.names])) for p in current)
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


def _polarities(problems: tuple[FrfProblem, ...]) -> tuple[float, ...]:
    return tuple(float(sign) for p in problems if p.channels is not None for sign in p.channels.polarities)


def _with_polarities(problems: tuple[FrfProblem, ...], signs: Sequence[float]) -> tuple[FrfProblem, ...]:
    made, rest = [], list(signs)
    for problem in problems:
        if problem.channels is not None:
            count = len(problem.channels.polarities)
            own, rest = rest[:count], rest[count:]
            problem = replace(problem, channels=replace(problem.channels, polarities=locked(own, float)))
        made.append(problem)
    return tuple(made)

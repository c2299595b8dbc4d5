"""Polarities of channels, +1 or -1 each, which no continuous search can decide: read, decided and set in a problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from structid.core.arrays import FloatArray, locked
from structid.forward.record_problem import RecordProblem

P = TypeVar("P", bound=RecordProblem)


def polarities(problem: RecordProblem) -> tuple[float, ...]:
    """Polarity of each channel of `problem` whose polarity is unknown, +1 or -1."""
    return () if problem.channels is None else tuple(problem.channels.polarities.tolist())


def with_polarities(problem: P, signs: Sequence[float]) -> P:
    """A copy of `problem` with these polarities, one each."""
    if problem.channels is None:
        return problem
    return problem.with_channels(replace(problem.channels, polarities=locked(signs, float)))


def decide_polarities(problem: P, theta: FloatArray) -> P:
    """A copy of `problem` with the polarities by which the model at `theta` agrees best in phase with the measurement."""
    if problem.channels is None or not problem.channels.polarity_names:
        return problem
    return problem.with_channels(problem.channels.decided(*problem.measured_and_predicted(theta)))

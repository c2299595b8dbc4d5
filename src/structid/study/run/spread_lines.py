"""The lines of a large FRF problem evaluated on several workers, a stretch of lines each, in the order of the record."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NotRequired, TypedDict

import numpy as np

from structid.core.arrays import FloatArray
from structid.forward import FrfProblem
from structid.inversion import JointProblem, Linearization, Problem
from structid.inversion.problems.wrapped import Wrapped
from structid.inversion.search.work import Tools
from structid.study.run.workers import Workers

#: Degrees of freedom times lines from which a sweep takes so long (about half a second) that it is worth sending.
WORTH_SENDING = 500_000
_MOST_BYTES = 256_000_000
_STRETCHES_A_WORKER = 2


@dataclass(frozen=True, eq=False)
class Stretches:
    """The problems of stretches of lines of `problem`, as a worker comes to them."""

    problem: FrfProblem
    made: dict[tuple[int, int], FrfProblem] = field(default_factory=dict)

    def at(self, first: int, last: int) -> FrfProblem:
        if (first, last) not in self.made:
            self.made[first, last] = self.problem.with_lines(np.arange(first, last))
        return self.made[first, last]


@dataclass(frozen=True, eq=False)
class SpreadLines(Wrapped):
    """The same residual and Jacobian as `problem`, from workers.

    Parameters
    ----------
    problem : FrfProblem
    workers : Workers
    """

    problem: FrfProblem
    workers: Workers

    @cached_property
    def stretches(self) -> Stretches:
        return Stretches(self.problem)

    def residual(self, theta: FloatArray) -> FloatArray:
        return _join_parts("residual", self._evaluate_parts(theta, False))

    def linearize(self, theta: FloatArray) -> Linearization:
        parts = self._evaluate_parts(theta, True)
        return Linearization(_join_parts("residual", parts), _join_parts("jacobian", parts))

    def _evaluate_parts(self, theta: FloatArray, with_jacobian: bool) -> list[_Lines]:
        """Residual (and Jacobian) of each stretch of lines, evaluated on the workers, in order."""
        n_lines = len(self.problem.record.frequency)
        count = min(n_lines, _STRETCHES_A_WORKER * self.workers.n_workers)
        ends = np.linspace(0, n_lines, count + 1).astype(int).tolist()
        items = {k: (ends[k], ends[k + 1], theta, with_jacobian) for k in range(count)}
        part_of = dict(self.workers.completed(stretch, self.stretches, items))
        return [part_of[k] for k in range(count)]


class _Lines(TypedDict):
    """Residual, and Jacobian where it is wanted, of some lines, and how many rows are of their data."""

    residual: FloatArray
    jacobian: NotRequired[FloatArray]
    n_data: int


def _join_parts(name: Literal["residual", "jacobian"], parts: list[_Lines]) -> FloatArray:
    """Residual or Jacobian of all lines: real parts of all stretches, imaginary parts of all, then the prior rows once."""
    real, imaginary = [], []
    for part in parts:
        rows, half = part[name], part["n_data"] // 2
        real.append(rows[:half])
        imaginary.append(rows[half : 2 * half])
    return np.concatenate([*real, *imaginary, parts[-1][name][2 * half :]])


def stretch(stretches: Stretches, item: tuple[int, int, FloatArray, bool], _: Tools) -> _Lines:
    """Residual, and Jacobian if wanted, of the stretch `item` (first, last, theta, with_jacobian), as a task for workers."""
    first, last, theta, with_jacobian = item
    part = stretches.at(first, last)
    if not with_jacobian:
        return {"residual": part.residual(theta), "n_data": part.n_data}
    linearization = part.linearize(theta)
    return {"residual": linearization.residual, "jacobian": linearization.jacobian, "n_data": part.n_data}


def spread(problem: Problem, workers: Workers) -> Problem:
    """The problem with the lines of its large FRF problems evaluated on workers, if there are several and it pays."""
    if workers.n_workers < 2:
        return problem
    if isinstance(problem, JointProblem):
        members = tuple(spread(member, workers) for member in problem.problems)
        changed = any(new is not old for new, old in zip(members, problem.problems, strict=True))
        return replace(problem, problems=members) if changed else problem
    if not isinstance(problem, FrfProblem) or problem.structure.n_dofs * len(problem.record.frequency) < WORTH_SENDING:
        return problem
    if 8 * problem.n_data * len(problem.names) > _MOST_BYTES or not problem.model.is_large:
        return problem
    return SpreadLines(problem, workers)

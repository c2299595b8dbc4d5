"""A problem around another one: what passes through unchanged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from scipy import sparse

from structid.arrays import FloatArray
from structid.estimation.linearization import Linearization, OperatorLinearization
from structid.estimation.problem import Data, OfData, OfUnknowns, Problem, Stages, Unknowns


@dataclass(frozen=True, eq=False)
class Wrapped(OfUnknowns, OfData):
    """Everything as the inner `problem` has it; subclasses change some of it."""

    problem: Problem

    def around(self, problem: Problem) -> Problem:
        """The same around another problem with these parameters, such as an easier form."""
        return replace(self, problem=problem)

    @property
    def unknowns(self) -> Unknowns:
        return self.problem

    @property
    def data(self) -> Data:
        return self.problem

    @property
    def matrix_free_obstacle(self) -> str:
        return self.problem.matrix_free_obstacle

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        return self.problem.linearize_operator(theta)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return self.problem.prior_rows(theta)

    def stage_plans(self) -> Sequence[Stages]:
        plans = self.problem.stage_plans()
        return tuple(tuple((name, self.around(stage)) for name, stage in plan) for plan in plans)

    def ways(self) -> Sequence[Stages]:
        return self.stage_plans()

    def thinned(self) -> Problem | None:
        part = self.problem.thinned()
        return None if part is None else self.around(part)

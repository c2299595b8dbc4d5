"""A problem around another one: what passes through unchanged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from scipy import sparse

from structid.arrays import FloatArray, IntArray
from structid.estimation.linearization import Linearization, OperatorLinearization
from structid.estimation.problem import Problem, Stages


@dataclass(frozen=True, eq=False)
class Wrapped:
    """Everything as the inner `problem` has it; subclasses change some of it."""

    problem: Problem

    def around(self, problem: Problem) -> Problem:
        """The same around another problem with these parameters, such as an easier form."""
        return replace(self, problem=problem)

    @property
    def names(self) -> tuple[str, ...]:
        return self.problem.names

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.problem.kinds

    @property
    def units(self) -> tuple[str, ...]:
        return self.problem.units

    @property
    def theta_start(self) -> FloatArray:
        return self.problem.theta_start

    @property
    def n_data(self) -> int:
        return self.problem.n_data

    @property
    def lines(self) -> IntArray:
        return self.problem.lines

    @property
    def series(self) -> IntArray:
        return self.problem.series

    @property
    def matrix_free_obstacle(self) -> str:
        return self.problem.matrix_free_obstacle

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        return self.problem.linearize_operator(theta)

    def physical(self, theta: FloatArray) -> FloatArray:
        return self.problem.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        return self.problem.slope(theta)

    def sizes(self, physical: FloatArray) -> FloatArray:
        return self.problem.sizes(physical)

    @property
    def bounds(self) -> FloatArray:
        return self.problem.bounds

    @property
    def reach(self) -> FloatArray:
        return self.problem.reach

    @property
    def averages(self) -> FloatArray | None:
        return self.problem.averages

    def data_changes(self, theta: FloatArray) -> FloatArray | None:
        return self.problem.data_changes(theta)

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        return self.problem.score_covariance(theta, jacobian)

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

"""A problem around another one: what passes through unchanged."""

from __future__ import annotations

from structid.arrays import FloatArray, IntArray
from structid.estimation.covariance import score_covariance
from structid.estimation.problem import Linearization, Problem


class Wrapped:
    """Everything as the inner `problem` has it; subclasses change some of it."""

    problem: Problem

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

    def residual(self, theta: FloatArray) -> FloatArray:
        return self.problem.residual(theta)

    def linearize(self, theta: FloatArray) -> Linearization:
        return self.problem.linearize(theta)

    def physical(self, theta: FloatArray) -> FloatArray:
        return self.problem.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        return self.problem.slope(theta)

    def score_covariance(self, theta: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        return score_covariance(self.problem, theta, jacobian)

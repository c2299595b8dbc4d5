"""Values that differ from record to record as rows of data: each is drawn about the common one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, locked
from structid.forward.record_problem import (
    RecordProblem,
    linearization_with_priors,
    residual_with_priors,
    sparse_prior_rows,
)
from structid.inversion.linearization import Linearization
from structid.inversion.problem import DataRows, Problem
from structid.unknowns import Coupling, NamedUnknowns, Transforms
from structid.unknowns.priors import no_priors


@dataclass(frozen=True, eq=False)
class ScatterProblem(Problem):
    """log(own / common) / std of every record's value, whose expectation is 0 and variance 1.

    These rows count as data: with them the minimum over the own values is the generalized least squares of the common
    ones, its chi-square and its information.

    Attributes
    ----------
    named : NamedUnknowns
        The common values, then those of each record.
    coupling : Coupling
        Rows at a standard deviation of 1, record by record.
    std : float

    References
    ----------
    Lee and Nelder (1996), J. R. Stat. Soc. B 58, 619, section 3.2: random effects as data beside the data.
    """

    named: NamedUnknowns
    coupling: Coupling
    std: float

    @property
    def unknowns(self) -> NamedUnknowns:
        return self.named

    @property
    def name(self) -> str:
        """Name of the scatter."""
        return self.coupling.name

    @property
    def rows(self) -> DataRows:
        n_data = len(self.coupling.target)
        return DataRows(np.arange(n_data), np.zeros(n_data, dtype=int))

    def residual(self, theta: FloatArray) -> FloatArray:
        return residual_with_priors(self.unknowns, theta, self.coupling.residual(self.physical(theta)) / self.std)

    def linearize(self, theta: FloatArray) -> Linearization:
        """Deviations of records' values from the common ones over the scatter, with derivatives, priors included."""
        residual, change = self.coupling.rows(self.physical(theta))
        rows = change * self.slope(theta) / self.std
        return linearization_with_priors(self.unknowns, theta, residual / self.std, rows)

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return sparse_prior_rows(self.unknowns, theta)


def scatter_problems(problems: Sequence[RecordProblem]) -> tuple[ScatterProblem, ...]:
    """Problems that tie parameters of several records to their common value, one for each scatter by name.

    A scatter without parameters of single records has none; the order is that of first appearance in `problems`.
    """
    members: dict[str, list[RecordProblem]] = {}
    for problem in problems:
        for scatter in problem.parameters.scatters:
            if scatter.own:
                members.setdefault(scatter.name, []).append(problem)
    return tuple(_scatter_problem(name, tied) for name, tied in members.items())


def _scatter_problem(name: str, problems: Sequence[RecordProblem]) -> ScatterProblem:
    """Problem that ties each record's own parameters in the scatter `name` to the common ones, in logarithms.

    A data row is log(own) - log(common) over the standard deviation of the scatter. `problems` are all that have this
    scatter; unknowns are the common parameters, then those of each record, without priors.
    """
    scatters = [next(s for s in p.parameters.scatters if s.name == name) for p in problems]
    where: dict[str, tuple[NamedUnknowns, int]] = {}
    for problem, scatter in zip(problems, scatters, strict=True):
        index_of = {label: i for i, label in enumerate(problem.parameters.names)}
        for label in (*scatter.common, *scatter.own):
            where.setdefault(label, (problem.parameters, index_of[label]))
    pairs = [pair for scatter in scatters for pair in zip(scatter.common, scatter.own, strict=True)]
    names = (*dict.fromkeys(common for common, _ in pairs), *(own for _, own in pairs))
    column = {label: i for i, label in enumerate(names)}
    matrix = np.zeros((len(pairs), len(names)))
    for row, (common, own) in enumerate(pairs):
        matrix[row, column[own]], matrix[row, column[common]] = 1.0, -1.0
    origin = [where[label] for label in names]
    named = NamedUnknowns(
        names=names,
        kinds=tuple(unknowns.kinds[i] for unknowns, i in origin),
        units=tuple(unknowns.units[i] for unknowns, i in origin),
        start=locked([unknowns.start[i] for unknowns, i in origin], float),
        transforms=Transforms(
            tuple(unknowns.transforms.kinds[i] for unknowns, i in origin),
            locked([unknowns.transforms.lower[i] for unknowns, i in origin], float),
            locked([unknowns.transforms.upper[i] for unknowns, i in origin], float),
        ),
        priors=no_priors(len(names)),
        scale=locked([unknowns.scale[i] for unknowns, i in origin], float),
    )
    return ScatterProblem(named, Coupling(name, matrix, np.zeros(len(pairs)), logarithmic=True), scatters[0].std)

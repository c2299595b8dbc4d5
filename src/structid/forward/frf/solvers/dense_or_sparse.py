"""Models of medium size: dense matrices and poles where many lines are worth them, sparse matrices line by line else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from scipy.sparse import csc_array

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.forward.frf.solvers.dense import DenseSolver
from structid.forward.frf.solvers.solver import LineDerivatives
from structid.forward.frf.solvers.sparse import SparseSolver

#: Largest eigenvalue problem that is tried, in degrees of freedom.
MEDIUM_UP_TO = 256


@dataclass(frozen=True, eq=False)
class DenseOrSparseSolver:
    """Solver of a model of medium size: dense where its poles are worth finding, sparse otherwise."""

    dense: DenseSolver
    sparse: SparseSolver

    @property
    def is_large(self) -> bool:
        return False

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        return self._serving(physical, coefficients, loads).fields(physical, coefficients, loads)

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        return self._serving(physical, coefficients).readings(physical, coefficients, columns)

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        return self._serving(physical, coefficients).derivatives(physical, coefficients)

    def _serving(
        self, physical: FloatArray, coefficients: ComplexArray, loads: csc_array | None = None
    ) -> DenseSolver | SparseSolver:
        has_poles = self.dense.at(physical, coefficients, loads).modal is not None
        return self.dense if has_poles else self.sparse

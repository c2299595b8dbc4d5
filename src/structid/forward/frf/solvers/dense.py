"""Solvers of small and medium models: dense matrices, many lines together, and sparse ones where no poles are worth it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csc_array

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.core.last_results import LastResults
from structid.dynamics.dense_fields import DenseFields
from structid.dynamics.receptance import single_blas
from structid.forward.frf.channels import Channels
from structid.forward.frf.slopes import StiffnessSlopes
from structid.forward.frf.solvers.solver import LineDerivatives
from structid.forward.frf.solvers.sparse import SparseSolver


@dataclass(frozen=True, eq=False)
class DenseSolver:
    """The lines of a small model; see `Response`.

    Attributes
    ----------
    slopes : StiffnessSlopes
    channels : Channels
    frequency : (n_lines,) float array
    """

    slopes: StiffnessSlopes
    channels: Channels
    frequency: FloatArray

    @property
    def is_large(self) -> bool:
        return False

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Fields (n, n_dofs, n_loads) for stretches of lines, under all columns where no other loads are given."""
        at = self.at(physical, coefficients, loads)
        return at.solve_in_chunks(coefficients, np.arange(at.loads.shape[1]))

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors and contacts under the load columns at indices `columns`, (n_lines, n_sensors, n_columns).

        `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) the factors of the matrices in
        Z.
        """
        with single_blas():
            read = [
                of for _, of in self.at(physical, coefficients).solve_in_chunks(coefficients, columns, self._reader)
            ]
        return np.concatenate(read)

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """`LineDerivatives` of the readings of a small model, for one block of lines after another.

        `physical` are the parameter values (n_params,), `coefficients` (n_lines, n_matrices) those of the matrices in
        Z.
        """
        forces = self.slopes.dense.at(self.slopes.parameters.values(physical))
        with single_blas():
            for part, fields in self.fields(physical, coefficients):
                x, y = self.channels.under_loads(fields), self.channels.under_sensors(fields)
                reach = self._reader @ y[:, :, self.channels.n_outputs :]
                yield LineDerivatives(part, self._reader @ x, forces.products(-coefficients[part], x, y), reach)

    @cached_property
    def _reader(self) -> FloatArray:
        return np.asarray(self.channels.reader.toarray())

    def at(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> DenseFields:
        """Fields under `loads` (n_dofs, n_loads), by default under all columns; the two last asked for are cached.

        `physical` are the parameter values (n_params,), `coefficients` (n_lines, n_matrices) those of the matrices in
        Z.
        """
        loads, laplace = self.channels.columns if loads is None else loads, coefficients[:, 1]
        key = physical.tobytes(), laplace.tobytes(), id(loads)

        def solve() -> tuple[DenseFields, sparse.csc_array]:
            structure, values = self.slopes.structure, self.slopes.parameters.values(physical)
            matrices = structure.dense_matrices(self.slopes.matrix_kinds, values)
            return DenseFields(matrices, laplace, loads.toarray(), self.frequency), loads

        return self._cache.get_or_make(key, solve)[0]

    @cached_property
    def _cache(self) -> LastResults[tuple[bytes, bytes, int], tuple[DenseFields, sparse.csc_array]]:
        """The two fields last asked for, by values, Laplace variables and identity of the loads, kept too."""
        return LastResults(2)


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

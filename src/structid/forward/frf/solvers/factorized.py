"""Fields, readings and derivatives of models with matrices, by factors of the dynamic stiffness.

Small models: dense matrices, many lines together. Large ones: sparse matrices, line by line, with one line's fields in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csc_array

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.core.last_results import LastResults
from structid.dynamics.dense_fields import DenseFields
from structid.dynamics.factorization import Analysis, factorizer
from structid.dynamics.receptance import (
    FEWEST_LINES,
    DynamicStiffness,
    ErrorOf,
    FieldSweep,
    reading_error,
    reduced_sweep,
    single_blas,
)
from structid.forward.contraction import ParameterForces
from structid.forward.frf.channels import Channels
from structid.forward.frf.slopes import StiffnessSlopes
from structid.forward.frf.solvers.solver import LineDerivatives

#: Readings of so many sets of parameters are kept, sweeps, and derivatives up to so many bytes.
_MOST_READINGS, _KEPT, _MOST_BYTES = 40, 2, 2e8
#: Derivatives may be off by so many times what readings may.
_DERIVATIVES = 10.0


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
        dense = self.at(physical, coefficients, loads)
        return dense.solve_in_chunks(coefficients, np.arange(dense.loads.shape[1]))

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
        """Yield readings of a small model and their derivatives by the parameters, one block of lines after another.

        A `LineDerivatives` has the lines, the readings of sensors and contacts, their derivatives, and the readings
        under unit contact forces. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those
        of the matrices in the dynamic stiffness.
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
        """Dense fields at all lines under `loads` (n_dofs, n_loads), by default under all columns.

        The two last results are cached. `physical` (n_params,) are the parameter values, `coefficients` (n_lines,
        n_matrices) those of the matrices in the dynamic stiffness; of these only the column of damping, s, is used.
        """
        loads, laplace = self.channels.columns if loads is None else loads, coefficients[:, 1]
        key = physical.tobytes(), laplace.tobytes(), id(loads)

        def solve() -> tuple[DenseFields, sparse.csc_array]:
            """Dense solver of all lines at the parameters, and the load columns (n_dofs, n_loads)."""
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


@dataclass(frozen=True, eq=False)
class Pattern:
    """The sparsity pattern of a large model with its channels.

    Attributes
    ----------
    slopes : StiffnessSlopes
    channels : Channels
    factorizer : str, optional
        See `structid.dynamics.factorization.factorizer`.
    """

    slopes: StiffnessSlopes
    channels: Channels
    factorizer: str | None = None

    @property
    def indices(self) -> tuple[IntArray, IntArray]:
        return self.slopes.assembled.indices, self.slopes.assembled.indptr

    @cached_property
    def analysis(self) -> Analysis:
        """Symbolic analysis of the pattern by the factorizer; it serves all lines and iterations."""
        loaded = np.diff(self.channels.columns.tocsr().indptr) > 0
        return factorizer(self.factorizer).analyse(*self.indices, loaded)


@dataclass(frozen=True, eq=False)
class SparseSolver:
    """The lines of a large model; see `Response`.

    Attributes
    ----------
    pattern : Pattern
    frequency : (n_lines,) float array
    reduced : float, optional
        Largest relative error of values that may be found from few factorizations; see `reduced_sweep`.
    """

    pattern: Pattern
    frequency: FloatArray
    reduced: float | None = None

    @property
    def slopes(self) -> StiffnessSlopes:
        return self.pattern.slopes

    @property
    def channels(self) -> Channels:
        return self.pattern.channels

    @property
    def is_large(self) -> bool:
        return True

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Fields of one line after another: the line as a slice, and the fields (1, n_dofs, n_loads).

        `loads` (n_dofs, n_loads) are all columns of the channels by default; then a reduced sweep is used if it is
        accurate enough. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of the
        matrices in Z.
        """
        sweep = self._reduced_sweep(physical, coefficients) if loads is None else None
        if sweep is not None:
            for line in range(sweep.n_lines):
                yield slice(line, line + 1), sweep.fields(line)[None]
            return
        stiffness, right = (
            self.stiffness(physical, coefficients),
            (self.channels.columns if loads is None else loads).toarray(),
        )
        with single_blas():
            for line in range(len(self.frequency)):
                yield slice(line, line + 1), stiffness.solver(line).solve(right)[None]

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors, then contacts, (n_lines, n_sensors, n_columns), under load columns at indices `columns`.

        With the tolerance `reduced` they come from a reduced basis where that is accurate enough, else from one
        factorization a line; those of a reduced sweep of all columns are cached. `physical` (n_params,) are the
        parameters, `coefficients` (n_lines, n_matrices) those of the matrices in the dynamic stiffness Z.
        """
        key = self._key(physical, coefficients)
        known = self.last_sweep.readings.get(key)
        if known is None:
            sweep = self._reduced_sweep(physical, coefficients)
            known = None if sweep is None else self.last_sweep.read(key, sweep, self.channels.sensors)
        if known is not None:
            return known[:, :, columns]
        loads = sparse.csc_array(self.channels.columns[:, columns])
        if self.reduced is not None and len(self.frequency) < FEWEST_LINES and not self.channels.n_contacts:
            stiffness, right = self.stiffness(physical, coefficients), loads.toarray()
            with single_blas():
                full = FieldSweep(stiffness, self.pattern.indices, right).in_full()
                return np.stack([self.channels.reader @ fields for fields in full])
        if self.reduced is not None and self.channels.n_contacts:
            stiffness, right = self.stiffness(physical, coefficients), loads.toarray()
            with single_blas():
                return reduced_sweep(stiffness, self.pattern.indices, right, self.channels.sensors, self.reduced).values
        readings = np.empty((len(self.frequency), self.channels.sensors.shape[1], len(columns)), dtype=np.complex128)
        for part, fields in self.fields(physical, coefficients, loads):
            readings[part] = self.channels.read(fields)
        return readings

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Yield readings and their derivatives by the parameters, line by line, or all at once from a reduced basis.

        A `LineDerivatives` has the lines, the readings of sensors and contacts, their derivatives, and the readings
        under unit contact forces. Where parameters times loads are fewer than sensors, Z^-1 (dZ/dp) x is solved for
        instead of adjoint fields. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those
        of the matrices in Z.
        """
        known = self.last_sweep.derivatives.get(self._key(physical, coefficients))
        if known is not None:
            yield known
            return
        sweep = self._reduced_sweep(physical, coefficients)
        sides, n_params = self.channels, self.slopes.parameters.n_params
        forces, factors = self.slopes.forces_at(physical, coefficients)
        if sweep is not None and len(forces.indices) > n_params * sweep.n_basis:
            yield self.last_sweep.derived(self._key(physical, coefficients), sweep, sides, forces, factors)
            return
        used, column_of = np.unique(sides.inputs[0], return_inverse=True)
        few = not sides.n_contacts and n_params * len(used) < sides.columns.shape[1] - len(used)
        direct = few and sweep is None
        right = sides.columns[:, used].toarray() if direct else sides.columns.toarray()
        stiffness = sweep.stiffness if sweep is not None else self.stiffness(physical, coefficients)
        n_sensors = sides.sensors.shape[1]
        with single_blas():
            for line in range(len(self.frequency)):
                if sweep is not None:
                    fields = sweep.fields(line)
                else:
                    solver = stiffness.solver(line)
                    fields = solver.solve(right)
                read = sides.reader @ fields
                if direct:
                    values, reach = read[:, column_of] * sides.inputs[1], np.zeros((n_sensors, 0))
                    moved = solver.solve(forces.columns(forces.entries(factors[line], fields)))
                    changes = list(np.swapaxes((sides.reader @ moved).reshape(n_sensors, len(used), -1), 0, 1))
                else:
                    values, reach = sides.under_loads(read), sides.under_sensors(read)[:, sides.n_outputs :]
                    products = forces.products(factors[line], fields[:, used], fields)
                    changes = [product.T[sides.outputs[0]] for product in products]
                derivative = np.empty((1, n_sensors, len(column_of), n_params), dtype=np.complex128)
                signs = np.ones(n_sensors) if direct else sides.outputs[1]
                for column, (row, sign) in enumerate(zip(column_of, sides.inputs[1], strict=True)):
                    np.multiply(changes[row], (-sign * signs)[:, None], out=derivative[0, :, column])
                yield LineDerivatives(slice(line, line + 1), values[None], derivative, reach[None])

    @cached_property
    def last_sweep(self) -> LastSweep:
        """The last reduced sweep, where `reduced` asks for them."""
        return LastSweep()

    def _reduced_sweep(self, physical: FloatArray, coefficients: ComplexArray) -> FieldSweep | None:
        """Reduced sweep with the fields of all columns at all lines from few factorizations.

        None if each line must be solved: None without `reduced`, with friction contacts, or if the error cannot be met
        cheaply. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of the matrices
        in Z.
        """
        if self.reduced is None or self.channels.n_contacts:
            return None

        def begun() -> FieldSweep:
            stiffness = self.stiffness(physical, coefficients)
            return FieldSweep(stiffness, self.pattern.indices, self.channels.columns.toarray())

        forces = self.slopes.forces_at(physical, coefficients)
        error_of = sweep_error(self.reduced, self.channels.sensors, np.unique(self.channels.inputs[0]), forces)
        return self.last_sweep.verified(self._key(physical, coefficients), begun, error_of)

    @staticmethod
    def _key(physical: FloatArray, coefficients: ComplexArray) -> bytes:
        """Key of a sweep: parameters rounded to 14 digits, and Laplace variables (the column of `coefficients` for damping)."""
        part, power = np.frexp(physical)
        return np.round(part, 14).tobytes() + power.tobytes() + coefficients[:, 1].tobytes()

    def stiffness(self, physical: FloatArray, coefficients: ComplexArray) -> DynamicStiffness:
        """Dynamic stiffness Z at all lines, for the parameters `physical` and the `coefficients` of the matrices."""
        data = self.slopes.assembled.data(self.slopes.parameters.values(physical))
        return DynamicStiffness(self.pattern.analysis, data, coefficients, self.frequency)


def sweep_error(
    tolerance: float,
    sensors: sparse.csc_array,
    loads: IntArray,
    forces: tuple[ParameterForces, ComplexArray],
) -> ErrorOf:
    """Function (line, exact, approximate) for the error of fields from a reduced basis, in parts of the allowed error.

    Above 1 they are not good enough. Readings may be off by `tolerance` of the largest in their line, derivatives by
    ten times that in root mean square over parameters; the worse of the two counts.

    Parameters
    ----------
    tolerance : float
    sensors : (n_dofs, n_sensors) sparse array
    loads : (n_loads,) int array
        Columns of the fields under loads.
    forces : (ParameterForces, (n_frequencies, n_maps) complex array)
        Operator of the forces (dZ/dp) x, and the factors of its maps at each line.
    """
    maps, factors = forces

    def error(line: int, exact: NumberArray, approximate: NumberArray) -> float:
        """Error of `approximate` fields (n_dofs, n_loads) against `exact` ones at `line`, over the allowed one.

        The larger of that of readings and that of derivatives.
        """
        readings = (
            reading_error(*(np.asarray(sensors.T @ fields[:, loads]) for fields in (exact, approximate))) / tolerance
        )
        pair = [np.stack(maps.products(factors[line], fields[:, loads], fields)) for fields in (exact, approximate)]
        return max(readings, derivative_error(*pair) / (_DERIVATIVES * tolerance))

    return error


def derivative_error(exact: NumberArray, approximate: NumberArray) -> float:
    """Root mean square over parameters of the relative error of derivatives (n_loads, n_params, n_readings).

    Parameters whose exact derivative is 0 are left out; 0 if all are.
    """
    size, off = (np.linalg.norm(values, axis=(0, 2)) for values in (exact, approximate - exact))
    return float(np.sqrt(np.mean((off[size > 0] / size[size > 0]) ** 2))) if size.any() else 0.0


class LastSweep:
    """The last `FieldSweep` of a model, and the one before: values and derivatives at the same parameters share them.

    A search comes back to a point after it has tried one beyond.

    Attributes
    ----------
    n_factorizations : int
        Number of factorizations in all sweeps so far.
    readings, derivatives : dict
        What sensors read, and `LineDerivatives` of all lines, by what they depend on.
    """

    def __init__(self) -> None:
        """Empty store of readings, derivatives and reduced sweeps by the key of their parameters."""
        self.readings: dict[bytes, ComplexArray] = {}
        self.derivatives: dict[bytes, LineDerivatives] = {}
        self._sweeps: dict[bytes, FieldSweep] = {}
        self._before = 0

    @property
    def n_factorizations(self) -> int:
        return self._before + sum(sweep.n_factorizations for sweep in self._sweeps.values())

    @property
    def n_basis(self) -> int:
        return max((sweep.n_basis for sweep in self._sweeps.values()), default=0)

    def verified(self, key: bytes, begun: Callable[[], FieldSweep], error_of: ErrorOf) -> FieldSweep | None:
        """Reduced sweep of `key`, cached or made by `begun`, whose basis has grown until `error_of` gives at most 0.3.

        That is for the line with the largest residual; 1 is the allowed error. None if it would cost too much. The two
        last sweeps are cached; `key` is the bytes of the parameters and coefficients.
        """
        sweep = self._sweeps.pop(key, None)
        if sweep is None:
            if len(self._sweeps) == _KEPT:  # the memory of the oldest goes before the next takes any
                self._before += self._sweeps.pop(next(iter(self._sweeps))).n_factorizations
            sweep = begun()
        self._sweeps[key] = sweep
        with single_blas():
            return None if sweep.verified(error_of) is None else sweep

    def read(self, key: bytes, sweep: FieldSweep, sensors: sparse.csc_array) -> ComplexArray:
        """Readings of `sensors` (n_dofs, n_sensors) in `sweep` under all load columns, (n_lines, n_sensors, n_columns).

        They are always computed, and stored in `readings` by `key`, the bytes of the parameters and coefficients, where
        the caller looks first; of more than 40 the oldest is dropped.
        """
        while len(self.readings) >= _MOST_READINGS:
            del self.readings[next(iter(self.readings))]
        self.readings[key] = sweep.basis.read(sensors)
        return self.readings[key]

    def derived(
        self, key: bytes, sweep: FieldSweep, sides: Channels, forces: ParameterForces, factors: ComplexArray
    ) -> LineDerivatives:
        """Sensor readings of `sweep` under the loads at all lines, and their derivatives by the parameters.

        They are cached by `key`, the bytes of the parameters and coefficients, where they take at most 256 MB.
        `sides` are loads and sensors; `forces` and `factors` (n_lines, n_maps) give the forces (dZ/dp) x of fields x at
        each line.
        """
        x = sweep.basis.all_coordinates()
        used, column_of = np.unique(sides.inputs[0], return_inverse=True)
        change = forces.projected(factors, sweep.basis.vectors, x[:, :, used], sides.under_sensors(x))[:, :, column_of]
        change *= -sides.inputs[1][:, None]
        values = sides.under_loads(sweep.basis.read(sides.sensors))
        derivatives = LineDerivatives(slice(0, len(x)), values, change, np.zeros((*values.shape[:2], 0)))
        most = int(_MOST_BYTES // change.nbytes)
        while self.derivatives and len(self.derivatives) >= most:
            del self.derivatives[next(iter(self.derivatives))]
        if most:
            self.derivatives[key] = derivatives
        return derivatives

    def __getstate__(self) -> dict[str, object]:
        """Without the fields, which are large."""
        return {"readings": {}, "derivatives": {}, "_sweeps": {}, "_before": self.n_factorizations}

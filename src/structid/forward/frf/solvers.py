"""Solvers of the equations of motion at the lines of a record: fields, readings and derivatives.

Small models: dense matrices, many lines together. Large ones: sparse matrices, line by line, with one line's fields in
memory. Others are joined to what is no part of their matrices, supports that drive or measured components, or have FRFs
of a solver in place of matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse import csc_array

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.core.errors import InputError
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
from structid.fem import Structure
from structid.fem.elements.matrix_group import SolverFrfs
from structid.forward.frf.line_equations import Channels, StiffnessSlopes, read
from structid.forward.sensitivity import ParameterForces
from structid.records import FrfRecord
from structid.unknowns import Parameters

#: What cannot be had of it, for messages; a sentence begins with what asks for it.
NO_MATRICES = (
    'needs masses and stiffnesses, and of this structure a solver gives FRFs alone (`gives = "frfs"`); take `gives = "matrices"`'
    ' or `"modes"` for it'
)
#: Readings of so many sets of parameters are kept, sweeps, and derivatives up to so many bytes.
_MOST_READINGS, _KEPT, _MOST_BYTES = 40, 2, 2e8
#: Derivatives may be off by so many times what readings may.
_DERIVATIVES = 10.0


class LineDerivatives(NamedTuple):
    """Readings of sensors and contacts at a block of lines, with their derivatives with respect to the parameters.

    Attributes
    ----------
    part : slice
        The lines.
    values : (n_lines, n_sensors, n_inputs) complex array
        Readings under the loads.
    derivative : (n_lines, n_sensors, n_inputs, n_params) complex array
        Their derivative with friction as it is.
    reach : (n_lines, n_sensors, n_contacts) complex array
        Readings under unit forces at the contacts.
    """

    part: slice
    values: NumberArray
    derivative: ComplexArray
    reach: NumberArray


class FrfSolver(Protocol):
    """Solver of the equations of motion at the lines of a record, for coefficients (n_lines, n_matrices)."""

    @property
    def is_large(self) -> bool:
        """True where lines are factorized one by one as sparse matrices, with one line's fields in memory at a time."""
        ...

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Fields (n, n_dofs, n_loads) for blocks of lines, under all load columns where no other loads are given."""
        ...

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors and contacts under some of the load columns, (n_lines, n_sensors, n_columns)."""
        ...

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Readings and derivatives for blocks of lines, one after another."""
        ...


@dataclass(frozen=True, eq=False)
class TabulatedFrf:
    """FRFs that a solver gave, between and beside the values of its runs; see `FrfSolver`.

    Attributes
    ----------
    element : SolverFrfs
    structure : Structure
        Structure that consists of that element alone.
    parameters : Parameters
    record : FrfRecord
        Gives lines, sensors and loads.
    """

    element: SolverFrfs
    structure: Structure
    parameters: Parameters
    record: FrfRecord

    @property
    def is_large(self) -> bool:
        return False

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """There are none.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(f"the motion of all nodes {NO_MATRICES}")

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Tabulated receptances of sensors, (n_lines, n_outputs, n_columns), under load columns at indices `columns`.

        Columns are of unit loads along the axes; sensors have the signs of their directions. `physical` (n_params,) are
        the parameters; `coefficients` are not used.
        """
        values, _ = self._signed_receptances(physical)
        senses = np.array([dof.sign for dof in self.record.inputs])
        first = [list(self._columns).index(column) for column in columns.tolist()]
        return values[:, :, first] * senses[first]

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Yield `LineDerivatives` of all lines at once at the parameters `physical` (n_params,), without contacts.

        `coefficients` are not used.
        """
        values, change = self._signed_receptances(physical)
        yield LineDerivatives(slice(0, len(values)), values, change, np.zeros((*values.shape[:2], 0), np.complex128))

    def _signed_receptances(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Receptances (n_lines, n_outputs, n_inputs) with the signs of both channels, and derivatives (..., n_params).

        They are interpolated in the table of the solver, in the order of the record. `physical` (n_params,) are the
        parameters.
        """
        lines, (outputs, senses), (inputs, input_senses) = self._places
        values, change = self.element.table.evaluated(self.parameters.values(physical)[self._rows])
        chosen = np.ix_(lines, outputs, inputs)
        sign = senses[:, None] * input_senses
        inner = np.asarray(self.parameters.design[self._rows, :].toarray())
        return values[chosen] * sign, (change[chosen] @ inner) * sign[..., None]

    @cached_property
    def _rows(self) -> IntArray:
        """Indices (n,) of the property values that are the parameters of the deck, in its order."""
        row = {item.term.property: item.values.start for item in self.structure.properties}
        return np.array([row[name] for name in self.element.table.at], dtype=np.int64)

    @cached_property
    def _columns(self) -> tuple[int, ...]:
        """Number of the distinct degree of freedom of each load, from 0 in the order of first appearance."""
        known: dict[str, int] = {}
        return tuple(known.setdefault(str(dof.unsigned), len(known)) for dof in self.record.inputs)

    @cached_property
    def _places(self) -> tuple[IntArray, tuple[IntArray, FloatArray], tuple[IntArray, FloatArray]]:
        """Line indices of the table, then indices and signs of its outputs, and of its inputs, that the record has."""
        element = self.element
        lines = element.table.lines(self.record.frequency)
        return (
            lines,
            element.channel_indices(self.record.outputs, "output"),
            element.channel_indices(self.record.inputs, "input"),
        )


@dataclass(frozen=True, eq=False)
class SubstructureCoupling:
    """The lines of a model some of whose degrees of freedom are joined to something else; see `Response`.

    What is joined has the receptance Y there, and motions b of its own. The force between the two brings them together:
    with X = Z^-1 (columns), columns b of unit forces at what is joined, and H their readings there, a forces column f
    gives

        x = X_f - X_b (Y + H_bb)^-1 (H_bf - b).

    A measured component has its own Y and no motion of its own: frequency-based substructuring in its dual form, which
    needs the inverse of neither Y nor H_bb. A support that drives has no Y, and a load at it is its motion, not a
    force. The same holds for the adjoint fields of sensors, so that derivatives are -y' (dZ/dp) x as ever.

    Attributes
    ----------
    free : FrfSolver
        Solver of the model without what is joined.
    slopes : StiffnessSlopes
    channels : Channels
        Loads and sensors; no sensor reads a support that drives.
    joined : (n_dofs, n_joined) sparse array
        Columns of what is joined, supports that drive first.
    receptance : (n_lines, n_joined, n_joined) complex array
        Y, the receptance of what is joined by itself.
    n_driven : int
        Number of supports that drive among the columns of `joined`.

    References
    ----------
    De Klerk, Rixen and Voormeeren (2008), AIAA Journal 46(5), 1169-1181.
    """

    free: FrfSolver
    slopes: StiffnessSlopes
    channels: Channels
    joined: sparse.csc_array
    receptance: ComplexArray
    n_driven: int

    @property
    def is_large(self) -> bool:
        return self.free.is_large

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Yield lines and fields (n, n_dofs, n_loads) of the coupled structure, one block of lines after another.

        `loads` (n_dofs, n_loads) are all columns of the channels by default. `physical` (n_params,) are the parameters,
        `coefficients` (n_lines, n_matrices) the factors of the matrices in Z.
        """
        right, n_joined = self.channels.columns if loads is None else loads, self.joined.shape[1]
        for part, fields, push in self._fields_and_interface_forces(physical, coefficients, right):
            yield part, fields[:, :, n_joined:] - fields[:, :, :n_joined] @ push

    def forces(self, physical: FloatArray, coefficients: ComplexArray) -> ComplexArray:
        """Forces between the model and what is joined, under all channel columns, (n_lines, n_joined, n_columns)."""
        return np.concatenate(
            [push for _, _, push in self._fields_and_interface_forces(physical, coefficients, self.channels.columns)]
        )

    def _fields_and_interface_forces(
        self, physical: FloatArray, coefficients: ComplexArray, right: sparse.csc_array
    ) -> Iterator[tuple[slice, NumberArray, NumberArray]]:
        """Yield the lines, the fields of the model alone and the interface forces of one block of lines after another.

        Fields (n, n_dofs, n_joined + n_loads) are under unit interface forces, then under the load columns `right`
        (n_dofs, n_loads). Forces (n, n_joined, n_loads) are those of the model on bases and components, so that the
        model feels their negative. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) the
        factors of the matrices in the dynamic stiffness.
        """
        n_joined = self.joined.shape[1]
        prescribed = np.zeros((n_joined, right.shape[1]))
        prescribed[: self.n_driven] = (self._reader[: self.n_driven] @ right).toarray()
        for part, fields in self.free.fields(physical, coefficients, self._with_interface_forces(right)):
            seen = read(self._reader, fields)
            yield (
                part,
                fields,
                np.linalg.solve(self.receptance[part] + seen[:, :, :n_joined], seen[:, :, n_joined:] - prescribed),
            )

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors and contacts under the load columns at `columns`, (n_lines, n_sensors, n_columns).

        `columns` are indices. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of
        the matrices in Z. Small models solve for all columns, as derivatives do, so that both share cached fields.
        """
        if not self.is_large:
            every = self.fields(physical, coefficients)
            return np.concatenate([self.channels.read(x[:, :, columns]) for _, x in every])
        chosen = sparse.csc_array(self.channels.columns[:, columns])
        return np.concatenate([self.channels.read(x) for _, x in self.fields(physical, coefficients, chosen)])

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Yield the coupled structure's readings and their derivatives, for one block of lines after another.

        A `LineDerivatives` has the lines as a slice, the readings of sensors and then contacts (n, n_sensors, n_loads),
        their derivatives by the physical parameters (..., n_params), and the readings under unit contact forces (n,
        n_sensors, n_contacts), all displacement per force. `physical` (n_params,) are the parameters, `coefficients`
        (n_lines, n_matrices) those of the matrices in the dynamic stiffness.
        """
        for part, fields in self.fields(physical, coefficients):
            x, y = self.channels.under_loads(fields), self.channels.under_sensors(fields)
            change = self.slopes.products(physical, -coefficients[part], x, y)
            reach = self.channels.read(y[:, :, self.channels.n_outputs :])
            yield LineDerivatives(part, self.channels.read(x), change, reach)

    @cached_property
    def _reader(self) -> sparse.csr_array:
        return sparse.csr_array(self.joined.T)

    def _with_interface_forces(self, loads: sparse.csc_array) -> sparse.csc_array:
        """Columns of unit forces at the interfaces, then `loads` (n_dofs, n_loads), as (n_dofs, n_joined + n_loads).

        The last result is cached: the same object is returned while `loads` is the same object.
        """
        known = self._last.get("last")
        if known is None or known[0] is not loads:
            known = self._last["last"] = loads, sparse.csc_array(sparse.hstack([self.joined, loads]))
        return known[1]

    @cached_property
    def _last(self) -> dict[str, tuple[sparse.csc_array, sparse.csc_array]]:
        return {}


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
        """Readings of sensors and contacts under load columns at indices `columns`, (n_lines, n_sensors, n_columns).

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

        A `LineDerivatives` has the lines as a slice, the readings of sensors and then contacts (n, n_sensors, n_loads),
        their derivatives (..., n_params), and the readings under unit contact forces (n, n_sensors, n_contacts), all
        displacement per force. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of
        the matrices in the dynamic stiffness.
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

        A `LineDerivatives` has the lines as a slice, the readings of sensors and then contacts (n, n_sensors, n_loads),
        their derivatives (..., n_params), and the readings under unit contact forces (n, n_sensors, n_contacts), all
        displacement per force. Where parameters times loads are fewer than sensors, Z^-1 (dZ/dp) x is solved for
        instead of adjoint fields. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those
        of the matrices in the dynamic stiffness Z.
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
        """Key of a sweep: parameters rounded to 14 digits, and s at each line (the column of damping coefficients)."""
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

        Readings are (n_lines, n_sensors, n_loads), derivatives (..., n_params); there are none under contact forces.
        They are cached by `key`, the bytes of the parameters and coefficients, as long as all that are cached take at
        most 256 MB. `sides` are loads and sensors; `forces` and `factors` (n_lines, n_maps) give the forces (dZ/dp) x
        of fields x at each line.
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

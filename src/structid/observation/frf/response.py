"""What a structure with given parameters answers at the sensors, and how the answer changes with each parameter."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakValueDictionary

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics import harmonic_fields
from structid.dynamics.factorization import VARIABLE, Analysis, factorizer
from structid.dynamics.receptance import DENSE_UP_TO, DynamicStiffness, single_blas
from structid.dynamics.reduced_sweep import FieldSweep, reduced_sweep
from structid.observation.contraction import ParameterForces, parameter_forces
from structid.observation.frf.block_sensitivity import BlockSensitivity
from structid.observation.frf.contacts import Contact, sliding_contacts
from structid.observation.frf.friction import add_amplitude_change, balanced_amplitudes
from structid.observation.frf.laws import distinct_columns, law_coefficients
from structid.observation.frf.reduced_response import LastSweep, sweep_error
from structid.observation.frf.sliding import sliding_amplitudes
from structid.observation.sensitive import (
    SensitiveElements,
    WeightedParts,
    sensitive_elements,
    steering_values,
    weighted_elements,
)
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.structure import Friction, Structure
from structid.structure.assembly import Assembly, assembly
from structid.unknowns import Parameters

_STUCK = 1e-4
#: Large models in use, by the identity of what they are made of, which they hold.
_SHARED: WeakValueDictionary[tuple[object, ...], Response] = WeakValueDictionary()


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency response of a parametrized structure at fixed frequencies, sensors and loads.

    Made by `response`; its methods are pure functions of the physical parameters. The last outputs are the sliding
    motions of `contacts`, which are not handed out.
    """

    assembled: Assembly
    parameters: Parameters
    fixed_coefficients: ComplexArray
    frequency: FloatArray
    kind_factor: ComplexArray
    columns: sparse.csc_array
    outputs: tuple[IntArray, FloatArray]
    inputs: tuple[IntArray, FloatArray]
    sensitive: tuple[SensitiveElements, ...]
    contacts: tuple[Contact, ...]
    factorizer: str | None = None
    reduced: float | None = None

    @property
    def n_outputs(self) -> int:
        return len(self.outputs[0]) - len(self.contacts)

    @property
    def is_large(self) -> bool:
        """Whether lines are factorized one by one as sparse matrices, with one line's fields in memory at a time."""
        return self.assembled.structure.n_dofs > DENSE_UP_TO

    def values_at(self, physical: FloatArray) -> ComplexArray:
        """The FRF, (n_frequencies, n_outputs, n_inputs)."""
        used, sign = np.unique(self.inputs[0]), self.inputs[1]
        readings = self._readings(physical, self._coefficients(physical), used)
        read = readings[:, :, np.searchsorted(used, self.inputs[0])] * sign
        return read[:, : self.n_outputs] * self.kind_factor[:, None, None]

    def derivatives_at(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """The FRF and its derivative with respect to the physical parameters, (..., n_params).

        By the adjoint method: with y = Z^-1 s for each sensor and x = Z^-1 f for each load, dH/dp is
        -y' (dZ/dp) x, a sum of element-local products; one factorization a frequency serves all of it. Where a large
        model has fewer parameters times loads than sensors, Z^-1 (dZ/dp) x is solved for instead.
        """
        coefficients = self._coefficients(physical)
        if self.is_large:
            values, derivative, reach = self._swept(physical, coefficients)
        else:
            fields = self._fields(physical, coefficients, self.columns)
            x = fields[:, :, self.inputs[0]] * self.inputs[1]
            y = fields[:, :, self.outputs[0]] * self.outputs[1]
            values, reach = self.read(x), self.read(y[:, :, self.n_outputs :])
            derivative = self._sensitivity(physical, coefficients, x, y)
        weights = self.parameters.values(physical)
        if self.contacts:
            force = weights[[contact.value for contact in self.contacts]]
            size = (1j / coefficients[:, [contact.law for contact in self.contacts]]).real
            motion = values[:, self.n_outputs :, 0]
            derivative = add_amplitude_change(derivative[:, :, 0], motion, reach, force, size)[:, :, None]
        factor = self.kind_factor[:, None, None]
        if (factor != 1).any():
            derivative *= factor[..., None]
        return values[:, : self.n_outputs] * factor, derivative[:, : self.n_outputs]

    def _swept(
        self, physical: FloatArray, coefficients: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Readings under the loads, their derivatives, and readings under forces at the contacts, line by line."""
        sweep = self._reduced_sweep(physical)
        n_lines, n_sensors, n_inputs = len(self.frequency), len(self.outputs[0]), len(self.inputs[0])
        values = np.empty((n_lines, n_sensors, n_inputs), dtype=np.complex128)
        derivative = np.empty((*values.shape, self.parameters.n_params), dtype=np.complex128)
        reach = np.empty((n_lines, n_sensors, len(self.contacts)), dtype=np.complex128)
        forces, factors = self.forces_at(physical, coefficients)
        used, place = np.unique(self.inputs[0], return_inverse=True)
        n_sides = self.columns.shape[1]
        few = not self.contacts and self.parameters.n_params * len(used) < n_sides - len(used)
        direct = few and sweep is None
        right = self.columns[:, used].toarray() if direct else self.columns.toarray()
        stiffness = sweep.stiffness if sweep is not None else self.stiffness(physical, coefficients)
        with single_blas():
            for line in range(n_lines):
                if sweep is not None:
                    fields = sweep.fields(line)
                else:
                    solver = stiffness.solver(line)
                    fields = solver.solve(right)
                read = self._reader @ fields
                if direct:
                    values[line] = read[:, place] * self.inputs[1]
                    moved = solver.solve(forces.columns(forces.entries(factors[line], fields)))
                    changes = list(np.swapaxes((self._reader @ moved).reshape(n_sensors, len(used), -1), 0, 1))
                else:
                    values[line] = read[:, self.inputs[0]] * self.inputs[1]
                    reach[line] = (read[:, self.outputs[0]] * self.outputs[1])[:, self.n_outputs :]
                    products = forces.contracted(factors[line], fields[:, used], fields)
                    changes = [product.T[self.outputs[0]] for product in products]
                signs = np.ones(n_sensors) if direct else self.outputs[1]
                for column, (row, sign) in enumerate(zip(place, self.inputs[1], strict=True)):
                    np.multiply(changes[row], (-sign * signs)[:, None], out=derivative[line, :, column])
        return values, derivative, reach

    def forces_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[ParameterForces, ComplexArray]:
        """The forces (dZ/dp) x of all parameters, and the factors of their maps at every line: (n_frequencies, n_maps)."""
        found, factors = self.parts_at(physical, coefficients)
        known = self._known_forces.get("last")
        if known is None or (known[0] is not found and not known[0].same_slopes(found)):
            forces = parameter_forces(found.parts, self.parameters.n_params, self.assembled.structure.n_dofs)
            known = self._known_forces["last"] = found, forces
        return known[1], factors

    def parts_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[WeightedParts, ComplexArray]:
        """The element matrices that the parameters weigh, and the factor of each kind at every line."""
        key = self.parameters.values(physical)[self._steering].tobytes()
        if key not in self._known_parts:
            self._known_parts.clear()
            structure = self.assembled.structure
            self._known_parts[key] = weighted_elements(structure, self.parameters, self.sensitive, physical)
        found = self._known_parts[key]
        factors = np.zeros((len(self.frequency), len(found.uses)), dtype=np.complex128)
        for kind, uses in enumerate(found.uses):
            for law, scale in uses:
                factors[:, kind] += coefficients[:, self.assembled.laws.index(law)] * scale
        return found, factors

    @cached_property
    def _steering(self) -> IntArray:
        return steering_values(self.assembled.structure, self.parameters, self.sensitive)

    @cached_property
    def _known_parts(self) -> dict[bytes, WeightedParts]:
        """The last `WeightedParts`, by the values that they depend on."""
        return {}

    @cached_property
    def _known_forces(self) -> dict[str, tuple[WeightedParts, ParameterForces]]:
        """The last `ParameterForces`, and the weights that they were made for."""
        return {}

    def fields_at(self, physical: FloatArray, loads: sparse.csc_array) -> ComplexArray:
        """Motion of every degree of freedom under unit loads, (n_frequencies, n_dofs, n_loads)."""
        return self._fields(physical, self._coefficients(physical), loads)

    def sensitivity_at(self, physical: FloatArray, x: ComplexArray, y: ComplexArray) -> ComplexArray:
        """-y' (dZ/dp) x for motions x under any drive and y under unit loads at the sensors.

        Shapes (n_frequencies, n_dofs, n_x), (n_frequencies, n_dofs, n_y) and (n_frequencies, n_y, n_x, n_params).
        """
        return self._sensitivity(physical, self._coefficients(physical), x, y)

    def _sensitivity(
        self, physical: FloatArray, coefficients: ComplexArray, x: ComplexArray, y: ComplexArray
    ) -> ComplexArray:
        return self._block_sensitivity.at(self.parameters.values(physical), coefficients, x, y)

    @cached_property
    def _block_sensitivity(self) -> BlockSensitivity:
        return BlockSensitivity(self.assembled.structure, self.assembled.laws, self.parameters, self.sensitive)

    def sensor_gram(self, physical: FloatArray) -> ComplexArray:
        """Y' conj(Y) with Y = Z^-1 S, the receptance from every force to the sensors, (n_frequencies, n_outputs, n_outputs)."""
        index, sign = self.outputs[0][: self.n_outputs], self.outputs[1][: self.n_outputs]
        gram = np.empty((len(self.frequency), len(index), len(index)), dtype=np.complex128)
        for part, fields in self._solved(physical, self._coefficients(physical), self.columns):
            y = fields[:, :, index] * sign
            gram[part] = np.swapaxes(y, 1, 2) @ np.conj(y)
        return gram

    def _coefficients(self, physical: FloatArray) -> ComplexArray:
        """How each law enters the dynamic stiffness, with the sliding amplitudes of `contacts` in balance."""
        if not self.contacts:
            return self.fixed_coefficients
        free, flexibility = self._contact_receptances(physical)
        force = self.parameters.values(physical)[[c.value for c in self.contacts]]
        amplitude = balanced_amplitudes(flexibility, free, force, self._stuck_amplitude)
        coefficients = np.array(self.fixed_coefficients)
        coefficients[:, [c.law for c in self.contacts]] = 1j / amplitude
        return coefficients

    @cached_property
    def _stuck_amplitude(self) -> FloatArray:
        """Amplitude that stands for a contact that sticks: a small part of its frictionless motion at the start."""
        free, _ = self._contact_receptances(self.parameters.start)
        return np.maximum(_STUCK * np.abs(free), np.finfo(float).tiny)

    def _contact_receptances(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Motion of the contacts under the drive, and under unit forces at the contacts, all without their friction."""
        columns, signs = self.outputs[0][self.n_outputs :], self.outputs[1][self.n_outputs :]
        used = np.unique(np.concatenate([self.inputs[0], columns]))
        readings = self._readings(physical, self.fixed_coefficients, used)[:, self.n_outputs :]
        drive = readings[:, :, np.searchsorted(used, self.inputs[0])] * self.inputs[1]
        return drive[:, :, 0], readings[:, :, np.searchsorted(used, columns)] * signs

    def _fields(self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array) -> ComplexArray:
        fields = np.empty((len(self.frequency), *loads.shape), dtype=np.complex128)
        for part, found in self._solved(physical, coefficients, loads):
            fields[part] = found
        return fields

    def _solved(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array
    ) -> Iterator[tuple[slice, ComplexArray]]:
        """Fields (n, n_dofs, n_loads) of stretches of lines: all at once, or line by line where the model is large."""
        if not self.is_large:
            at = self.assembled
            data = at.data(self.parameters.values(physical))
            yield slice(None), harmonic_fields(at.indices, at.indptr, data, coefficients, loads, self.frequency)
            return
        stiffness, right = self.stiffness(physical, coefficients), loads.toarray()
        with single_blas():
            for line in range(len(self.frequency)):
                yield slice(line, line + 1), stiffness.solver(line).solve(right)[None]

    def solved_at(self, physical: FloatArray) -> Iterator[tuple[slice, ComplexArray]]:
        """Motion (n, n_dofs, n_columns) under unit loads at all `columns` for stretches of lines, one after another."""
        sweep = self._reduced_sweep(physical)
        if sweep is None:
            return self._solved(physical, self._coefficients(physical), self.columns)
        return ((slice(line, line + 1), sweep.fields(line)[None]) for line in range(sweep.n_lines))

    def _reduced_sweep(self, physical: FloatArray) -> FieldSweep | None:
        """Fields of all `columns` from few factorizations, verified; None where each line is to be solved for."""
        if self.reduced is None or not self.is_large or self.contacts:
            return None

        def begun() -> FieldSweep:
            stiffness = self.stiffness(physical, self.fixed_coefficients)
            return FieldSweep(stiffness, self._pattern, self.columns.toarray())

        forces = self.forces_at(physical, self.fixed_coefficients)
        error_of = sweep_error(self.reduced, self.sensors, np.unique(self.inputs[0]), forces)
        return self.last_sweep.verified(physical, begun, error_of)

    @cached_property
    def last_sweep(self) -> LastSweep:
        """The last reduced sweep, where `reduced` asks for them."""
        return LastSweep()

    @property
    def _pattern(self) -> tuple[IntArray, IntArray]:
        return self.assembled.indices, self.assembled.indptr

    def stiffness(self, physical: FloatArray, coefficients: ComplexArray) -> DynamicStiffness:
        """The dynamic stiffness of a large model, with the factors of each law at every line."""
        data = self.assembled.data(self.parameters.values(physical))
        return DynamicStiffness(self.analysis, data, coefficients, self.frequency)

    @cached_property
    def analysis(self) -> Analysis:
        """What the factorizer knows of the sparsity pattern; it serves all lines and iterations."""
        loaded = np.diff(self.columns.tocsr().indptr) > 0
        return factorizer(self.factorizer).analyse(*self._pattern, loaded)

    def _readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """What the sensors and contacts read under some of the columns, (n_frequencies, n_sensors, n_columns)."""
        known = self.last_sweep.readings.get(physical.tobytes())
        if known is None:
            sweep = self._reduced_sweep(physical)
            known = None if sweep is None else self.last_sweep.read(sweep, self.sensors)
        if known is not None:
            return known[:, :, columns]
        if self.is_large and self.reduced is not None and self.contacts:
            loads, at = self.columns[:, columns].toarray(), self.stiffness(physical, coefficients)
            with single_blas():
                return reduced_sweep(at, self._pattern, loads, self.sensors, self.reduced).values
        readings = np.empty((len(self.frequency), len(self.outputs[0]), len(columns)), dtype=np.complex128)
        for part, fields in self._solved(physical, coefficients, self.columns[:, columns]):
            readings[part] = self.read(fields)
        return readings

    @cached_property
    def sensors(self) -> sparse.csc_array:
        """Columns of the sensors and contacts, signs included, (n_dofs, n_sensors)."""
        index, sign = self.outputs
        return sparse.csc_array(self.columns[:, index] @ sparse.diags_array(sign))

    @cached_property
    def _reader(self) -> sparse.csr_array:
        return sparse.csr_array(self.sensors.T)

    def read(self, x: ComplexArray) -> ComplexArray:
        """Sensor readings of fields x, (n_frequencies, n_outputs, n_inputs)."""
        flat = np.moveaxis(x, 1, 0).reshape(x.shape[1], -1)
        return np.moveaxis((self._reader @ flat).reshape(len(self.outputs[0]), x.shape[0], x.shape[2]), 0, 1)


def response(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    measured_sliding: bool = False,
    factorizer: str | None = None,
    reduced: float | None = None,
) -> Response:
    """The `Response` of `structure` at the frequencies, sensors and loads of `record`, in its kind.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Parameters of that structure.
    record : FrfRecord
        Its values serve only for measured sliding amplitudes.
    measured_sliding : bool
        Whether friction elements that name sensors slide with the amplitude that those measured.
    factorizer : {"pardiso", "superlu", "mumps"}, optional
        Of large models; see `structid.dynamics.factorization.factorizer`.
    reduced : float, optional
        Largest relative error of values that a large model may find from few factorizations; see `reduced_sweep`.

    Raises
    ------
    InputError
        If a sensor or load is not part of the structure, or there is friction and the record has several loads.

    Notes
    -----
    Large models without friction are shared while in use: assembly, factorizer's memory and last fields.
    """
    if structure.n_dofs <= DENSE_UP_TO or any(isinstance(element, Friction) for element in structure.elements):
        return _made(structure, unknown, record, measured_sliding, factorizer, reduced)
    lines = record.laplace.tobytes(), record.kind, record.outputs, record.inputs
    key = (id(structure), id(unknown), *lines, factorizer or os.environ.get(VARIABLE), reduced)
    known = _SHARED.get(key)
    return known or _SHARED.setdefault(key, _made(structure, unknown, record, measured_sliding, factorizer, reduced))


def _made(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    measured_sliding: bool,
    factorizer: str | None,
    reduced: float | None,
) -> Response:
    assembled = assembly(structure)
    measured = sliding_amplitudes(structure, record) if measured_sliding else {}
    fixed = law_coefficients(assembled.laws, record.laplace, measured)
    contacts, slides = sliding_contacts(structure, assembled.laws, record, set(measured))
    loads, sensors = structure.selection(record.inputs), structure.selection(record.outputs)
    columns, places = distinct_columns(sparse.csc_array(sparse.hstack([loads, sensors, slides])))
    n_inputs = len(record.inputs)
    index, sign = np.array([p for p, _ in places]), np.array([s for _, s in places])
    return Response(
        assembled=assembled,
        parameters=unknown,
        fixed_coefficients=fixed,
        frequency=record.frequency,
        kind_factor=record.laplace ** DERIVATIVES[record.kind],
        columns=columns,
        outputs=(index[n_inputs:], sign[n_inputs:]),
        inputs=(index[:n_inputs], sign[:n_inputs]),
        sensitive=sensitive_elements(structure, unknown),
        contacts=contacts,
        factorizer=factorizer,
        reduced=reduced,
    )

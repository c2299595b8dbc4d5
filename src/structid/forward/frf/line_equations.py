"""Equations of motion at the lines of a record: dynamic stiffness with derivatives, loads and sensors as columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Structure
from structid.fem.assembly import Assembly, assembly, structure_matrix_kinds
from structid.forward.sensitivity import (
    DenseSlopes,
    ParameterForces,
    SensitiveElements,
    WeightedParts,
    dense_slopes,
    parameter_forces,
    sensitive_elements,
    slope_value_indices,
    weighted_elements,
)
from structid.unknowns import Parameters


@dataclass(frozen=True, eq=False)
class Channels:
    """Loads, sensors and the sliding motions of contacts; made by `channels`.

    Attributes
    ----------
    columns : (n_dofs, n_columns) sparse array
        Unit loads at all loads and sensors, each once: at a drive point one column serves both.
    inputs, outputs : ((n,) int array, (n,) float array)
        Column and sign of each load, and of each sensor; the last of `outputs` are contacts.
    n_contacts : int
    """

    columns: sparse.csc_array
    inputs: tuple[IntArray, FloatArray]
    outputs: tuple[IntArray, FloatArray]
    n_contacts: int

    @property
    def n_outputs(self) -> int:
        """Number of sensors without contacts."""
        return len(self.outputs[0]) - self.n_contacts

    @cached_property
    def sensors(self) -> sparse.csc_array:
        """Columns of the sensors and contacts, signs included, (n_dofs, n_outputs + n_contacts)."""
        index, sign = self.outputs
        return sparse.csc_array(self.columns[:, index] @ sparse.diags_array(sign))

    @cached_property
    def reader(self) -> sparse.csr_array:
        """Map from fields (n_dofs, n) to the readings of sensors and contacts."""
        return sparse.csr_array(self.sensors.T)

    def read(self, fields: NumberArray) -> NumberArray:
        """Readings of sensors and contacts, (n_lines, n_outputs + n_contacts, n), from fields (n_lines, n_dofs, n)."""
        return read(self.reader, fields)

    def under_loads(self, fields: NumberArray) -> NumberArray:
        """Fields under the loads, signs included, from fields (..., n_columns) under all `columns`."""
        return fields[..., _as_slice(self.inputs[0])] * self.inputs[1]

    def under_sensors(self, fields: NumberArray) -> NumberArray:
        """Fields under loads at sensors and contacts, with signs, from fields (..., n_columns) under `columns`."""
        return fields[..., _as_slice(self.outputs[0])] * self.outputs[1]


def _as_slice(index: IntArray) -> slice | IntArray:
    """The `index` (n,) as a slice where it counts up by one, which takes no copy; as it is otherwise."""
    counts_up = len(index) > 0 and (np.diff(index) == 1).all()
    return slice(int(index[0]), int(index[-1]) + 1) if counts_up else index


def read(reader: sparse.csr_array, fields: NumberArray) -> NumberArray:
    """Readings (n_lines, n_readings, n) of fields (n_lines, n_dofs, n) by sparse rows `reader` (n_readings, n_dofs)."""
    flat = np.moveaxis(fields, 1, 0).reshape(fields.shape[1], -1)
    readings = np.asarray(reader @ flat).reshape(reader.shape[0], fields.shape[0], fields.shape[2])
    return np.moveaxis(readings, 0, 1)


def channels(loads: sparse.csc_array, sensors: sparse.csc_array, slides: sparse.csc_array) -> Channels:
    """Columns of `loads`, `sensors` and friction contacts `slides`, (n_dofs, n) each; equal ones are merged.

    Columns that agree up to sign count as equal. The result has the distinct columns and, for each load and for each
    sensor and then contact, its column and its sign.
    """
    columns, places = _distinct(sparse.csc_array(sparse.hstack([loads, sensors, slides])))
    index, sign = np.array([p for p, _ in places], dtype=np.int64), np.array([s for _, s in places])
    n = loads.shape[1]
    return Channels(columns, (index[:n], sign[:n]), (index[n:], sign[n:]), slides.shape[1])


def _distinct(columns: sparse.csc_array) -> tuple[sparse.csc_array, list[tuple[int, float]]]:
    """Columns without repetitions up to sign, and for each column of `columns` its index among them and its sign.

    The sign (+1 or -1) is that of the first nonzero entry, which the distinct columns have positive; +1 for an empty
    column. Distinct columns are in the order in which they first occur.
    """
    kept: dict[tuple[bytes, bytes], int] = {}
    first, places = [], []
    for j in range(columns.shape[1]):
        part = slice(columns.indptr[j], columns.indptr[j + 1])
        index, value = columns.indices[part], columns.data[part]
        order = np.argsort(index)
        index, value = index[order].astype(np.int64), value[order]
        sign = 1.0 if not value.size or value[0] > 0 else -1.0
        key = (index.tobytes(), (sign * value).tobytes())
        if key not in kept:
            kept[key] = len(kept)
            first.append((j, sign))
        places.append((kept[key], sign))
    unique = columns[:, [j for j, _ in first]] @ sparse.diags_array([s for _, s in first])
    return sparse.csc_array(unique), places


def matrix_coefficients(
    matrix_kinds: tuple[str, ...], laplace: ComplexArray, sliding: dict[str, FloatArray]
) -> ComplexArray:
    """Coefficient of each of `matrix_kinds` in the dynamic stiffness, (n_frequencies, n_matrices), in their order.

    It is s^2 for mass, s for damping, 1 for stiffness, i for structural damping and i / amplitude for friction, whose
    `sliding` amplitude is (n_frequencies,) by element name; 0 without one. `laplace` (n_frequencies,) is s in 1/s.
    """
    table: dict[str, ComplexArray] = {
        "mass": laplace**2,
        "damping": laplace,
        "stiffness": np.ones_like(laplace),
        "structural_damping": np.full_like(laplace, 1j),
    }
    table.update({f"friction:{name}": np.asarray(1j / amplitude) for name, amplitude in sliding.items()})
    zero = np.zeros_like(laplace)
    return np.stack([table.get(matrix_kind, zero) for matrix_kind in matrix_kinds], axis=1)


@dataclass(frozen=True, eq=False)
class StiffnessSlopes:
    """The matrices of a parametrized structure, and how they change.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
        Only the property values that they give the structure matter.
    """

    structure: Structure
    parameters: Parameters

    @cached_property
    def matrix_kinds(self) -> tuple[str, ...]:
        """Kinds of the matrices of the structure, such as "mass", in the order of the matrix coefficients."""
        return structure_matrix_kinds(self.structure)

    @cached_property
    def assembled(self) -> Assembly:
        """The matrices on one sparsity pattern, for large models."""
        return assembly(self.structure)

    def serves(self, structure: Structure, parameters: Parameters) -> bool:
        """True if these are the derivatives for that structure and parameters, whatever their priors and starts."""
        known = self.parameters
        same = known.design is parameters.design and known.offset is parameters.offset
        return same and self.structure is structure

    def parts_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[WeightedParts, ComplexArray]:
        """Element matrices with the derivatives of their weights, and the factor of each kind in Z, (n_lines, n_kinds).

        Matrices that enter the dynamic stiffness Z with one factor are of one kind. The element matrices are cached for
        the last parameters.

        Parameters
        ----------
        physical : (n_params,) float array
        coefficients : (n_lines, n_matrices) complex array
            Coefficient of each matrix (s^2 of mass, s of damping, ...) in the dynamic stiffness.
        """
        structure, parameters = self.structure, self.parameters
        key = parameters.values(physical)[self._steering].tobytes()
        weighted = self._parts_cache.get(key)
        if weighted is None:
            weighted = weighted_elements(structure, parameters, self._sensitive, physical)
            self._parts_cache.clear()
            self._parts_cache[key] = weighted
        factors = np.zeros((len(coefficients), len(weighted.uses)), dtype=np.complex128)
        for kind, uses in enumerate(weighted.uses):
            for matrix_kind, scale in uses:
                factors[:, kind] += coefficients[:, self.matrix_kinds.index(matrix_kind)] * scale
        return weighted, factors

    def forces_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[ParameterForces, ComplexArray]:
        """Operator for the forces (dZ/dp) x of all parameters, and the factors (n_lines, n_maps) of its maps.

        `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of the matrices in the
        dynamic stiffness Z. Maps are sparse, from fields to forces, one for each kind of matrix in Z. The operator is
        cached as long as the derivatives of the weights stay.
        """
        parts, factors = self.parts_at(physical, coefficients)
        cached = self._forces_cache.get("last")
        if cached is None or (cached[0] is not parts and not cached[0].same_slopes(parts)):
            forces = parameter_forces(parts.parts, self.parameters.n_params, self.structure.n_dofs)
            cached = self._forces_cache["last"] = parts, forces
        return cached[1], factors

    def products(
        self, physical: FloatArray, coefficients: ComplexArray, x: NumberArray, y: NumberArray
    ) -> ComplexArray:
        """Products y' (dZ/dp) x without conjugate, Z the dynamic stiffness, (n_lines, n_y, n_x, n_params).

        Fields are `x` (n_lines, n_dofs, n_x) and `y` (n_lines, n_dofs, n_y). `physical` (n_params,) are the parameters,
        `coefficients` (n_lines, n_matrices) those of the matrices in Z.
        """
        if self.structure.n_dofs <= DENSE_UP_TO:
            return self.dense.at(self.parameters.values(physical)).products(coefficients, x, y)
        forces, factors = self.forces_at(physical, coefficients)
        products = np.empty((len(x), y.shape[2], x.shape[2], self.parameters.n_params), dtype=np.complex128)
        for line, factor in enumerate(factors):
            products[line] = np.transpose(forces.products(factor, x[line], y[line]), (2, 0, 1))
        return products

    @cached_property
    def dense(self) -> DenseSlopes:
        """The derivatives as dense matrices, for small models."""
        return dense_slopes(self.structure, self.matrix_kinds, self.parameters.design)

    @cached_property
    def _sensitive(self) -> tuple[SensitiveElements, ...]:
        return sensitive_elements(self.structure, self.parameters)

    @cached_property
    def _steering(self) -> IntArray:
        return slope_value_indices(self.structure, self.parameters, self._sensitive)

    @cached_property
    def _parts_cache(self) -> dict[bytes, WeightedParts]:
        """The last `WeightedParts`, by the values that they depend on."""
        return {}

    @cached_property
    def _forces_cache(self) -> dict[str, tuple[WeightedParts, ParameterForces]]:
        """The last `ParameterForces`, and the weights that they were made for."""
        return {}

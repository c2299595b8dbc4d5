"""What a structure with given parameters answers at the sensors, and how the answer changes with each parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dof import Dof
from structid.dynamics import harmonic_fields
from structid.errors import InputError
from structid.parameters import Parameters
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.structure import Contribution, Friction, Structure
from structid.structure.assembly import Assembly, assembly
from structid.structure.blocks import ElementMatrices

_CHUNK_BYTES = 48_000_000


def sliding_amplitudes(structure: Structure, record: FrfRecord) -> dict[str, FloatArray]:
    """Sliding amplitude per unit drive of every friction element, from the receptance that `record` measured.

    Raises
    ------
    InputError
        If a friction element names a sensor that the record lacks, or the record has several loads.
    """
    amplitudes = {}
    for element in structure.elements:
        if not isinstance(element, Friction):
            continue
        if len(record.inputs) != 1:
            raise InputError(f"friction {element.name!r} needs a record with one load, got {len(record.inputs)}")
        measured = record.channels(_as_recorded(element.measured_by, record)).as_kind("receptance")
        signs = np.array([dof.sign for dof in measured.outputs])
        amplitudes[element.name] = element.sliding(measured.values[:, :, 0] * signs)
    return amplitudes


def _as_recorded(wanted: tuple[Dof, ...], record: FrfRecord) -> tuple[Dof, ...]:
    """The record's own outputs at the same places and directions, whatever their sense."""
    own = {dof.unsigned: dof for dof in record.outputs}
    return tuple(own.get(dof.unsigned, dof) for dof in wanted)


def law_coefficients(laws: tuple[str, ...], frequency: FloatArray, sliding: dict[str, FloatArray]) -> ComplexArray:
    """How each law enters the dynamic stiffness, (n_frequencies, n_laws): -omega^2, i omega, 1, i, i / amplitude."""
    omega = 2 * np.pi * frequency
    table = {
        "inertia": -(omega**2) + 0j,
        "viscous": 1j * omega,
        "elastic": np.ones_like(omega) + 0j,
        "structural": np.full_like(omega, 1j, dtype=complex),
    }
    table.update({f"friction:{name}": 1j / amplitude for name, amplitude in sliding.items()})
    return np.stack([table[law] for law in laws], axis=1)


def weight_slope(part: Contribution, unknown: Parameters, values: FloatArray) -> sparse.csr_array:
    """Derivative of the element weights of one contribution with respect to the parameters, (n_elements, n_params)."""
    design = unknown.design.tocsr()
    own = design[part.value]
    if part.factor is None:
        return own
    other = design[part.factor].multiply(values[part.value][:, None])
    return sparse.csr_array(own.multiply(values[part.factor][:, None]) + other)


@dataclass(frozen=True, eq=False)
class _Sensitive:
    """Elements of one family of blocks whose weights depend on the parameters, and in which laws they appear."""

    blocks: ElementMatrices
    rows: IntArray
    members: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency response of a parametrized structure at fixed frequencies, sensors and loads.

    Made by `response`; `values_at` and `derivatives_at` are pure functions of the physical parameters.
    """

    assembled: Assembly
    parameters: Parameters
    coefficients: ComplexArray
    frequency: FloatArray
    kind_factor: ComplexArray
    columns: sparse.csc_array
    outputs: tuple[IntArray, FloatArray]
    inputs: tuple[IntArray, FloatArray]
    sensitive: tuple[_Sensitive, ...]

    def values_at(self, physical: FloatArray) -> ComplexArray:
        """The FRF, (n_frequencies, n_outputs, n_inputs)."""
        used, sign = np.unique(self.inputs[0]), self.inputs[1]
        fields = self._fields(physical, self.columns[:, used])[:, :, np.searchsorted(used, self.inputs[0])]
        read = self._read(fields * sign)
        return read * self.kind_factor[:, None, None]

    def derivatives_at(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """The FRF and its derivative with respect to the physical parameters, (..., n_params).

        By the adjoint method: with y = Z^-1 s for each sensor and x = Z^-1 f for each load, dH/dp is
        -y' (dZ/dp) x, a sum of element-local products; one factorization a frequency serves all of it.
        """
        fields = self._fields(physical, self.columns)
        x = fields[:, :, self.inputs[0]] * self.inputs[1]
        y = fields[:, :, self.outputs[0]] * self.outputs[1]
        values = self._read(x)
        shape = (len(self.frequency), len(self.outputs[0]), len(self.inputs[0]), self.parameters.n_params)
        derivative = np.zeros(shape, dtype=np.complex128)
        weights = self.parameters.values(physical)
        for group in self.sensitive:
            self._add_group(derivative, group, weights, x, y)
        factor = self.kind_factor[:, None, None]
        return values * factor, derivative * factor[..., None]

    def sensor_gram(self, physical: FloatArray) -> ComplexArray:
        """Y' conj(Y) with Y = Z^-1 S, the receptance from every force to the sensors, (n_frequencies, n_outputs, n_outputs)."""
        y = self._fields(physical, self.columns)[:, :, self.outputs[0]] * self.outputs[1]
        return np.swapaxes(y, 1, 2) @ np.conj(y)

    def _add_group(
        self, derivative: ComplexArray, group: _Sensitive, weights: FloatArray, x: ComplexArray, y: ComplexArray
    ) -> None:
        contributions = self.assembled.structure.contributions
        slopes = [
            (contributions[m], weight_slope(contributions[m], self.parameters, weights)[group.rows])
            for m in group.members
        ]
        n_lines, _, n_inputs = x.shape
        n_outputs = y.shape[2]
        per_line = 16 * len(group.rows) * (n_outputs + 2 * n_inputs) * 12
        step = max(1, _CHUNK_BYTES // per_line)
        for first in range(0, n_lines, step):
            part = slice(first, min(first + step, n_lines))
            forms = group.blocks.bilinear(y[part], x[part])
            flat = np.moveaxis(forms, 1, -1).reshape(-1, len(group.rows))
            for contribution, slope in slopes:
                law = self.assembled.laws.index(contribution.law)
                change = (slope.T @ flat.T).T.reshape(-1, n_outputs, n_inputs, slope.shape[1])
                derivative[part] -= self.coefficients[part, law, None, None, None] * change

    def _fields(self, physical: FloatArray, loads: sparse.csc_array) -> ComplexArray:
        data = self.assembled.data(self.parameters.values(physical))
        return harmonic_fields(
            self.assembled.indices, self.assembled.indptr, data, self.coefficients, loads, self.frequency
        )

    def _read(self, x: ComplexArray) -> ComplexArray:
        """Sensor readings of fields x, (n_frequencies, n_outputs, n_inputs)."""
        index, sign = self.outputs
        sensors = self.columns[:, index] @ sparse.diags_array(sign)
        flat = np.moveaxis(x, 1, 0).reshape(x.shape[1], -1)
        return np.moveaxis((sensors.T @ flat).reshape(len(index), x.shape[0], x.shape[2]), 0, 1)


def response(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    sliding: dict[str, FloatArray] | None = None,
) -> Response:
    """The `Response` of `structure` at the frequencies, sensors and loads of `record`, in its kind.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Parameters of that structure.
    record : FrfRecord
        Its values serve only for the sliding amplitude of friction elements.
    sliding : mapping of name to (n_frequencies,) array, optional
        Sliding amplitudes; from the record by default.
    """
    assembled = assembly(structure)
    amplitude = sliding_amplitudes(structure, record) if sliding is None else sliding
    coefficients = law_coefficients(assembled.laws, record.frequency, amplitude)
    loads, sensors = structure.selection(record.inputs), structure.selection(record.outputs)
    columns, places = _distinct_columns(sparse.csc_array(sparse.hstack([loads, sensors])))
    n_inputs = len(record.inputs)
    index, sign = np.array([p for p, _ in places]), np.array([s for _, s in places])
    return Response(
        assembled=assembled,
        parameters=unknown,
        coefficients=coefficients,
        frequency=record.frequency,
        kind_factor=(1j * record.omega) ** DERIVATIVES[record.kind],
        columns=columns,
        outputs=(index[n_inputs:], sign[n_inputs:]),
        inputs=(index[:n_inputs], sign[:n_inputs]),
        sensitive=_sensitive(structure, unknown),
    )


def _distinct_columns(columns: sparse.csc_array) -> tuple[sparse.csc_array, list[tuple[int, float]]]:
    """The columns that differ by more than their sign, and for each given column its place among them and its sign."""
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


def _sensitive(structure: Structure, unknown: Parameters) -> tuple[_Sensitive, ...]:
    """Families of element matrices that the parameters weigh, contributions that share matrices together."""
    touched = np.diff(unknown.design.tocsr().indptr) > 0
    families: dict[int, list[int]] = {}
    for member, part in enumerate(structure.contributions):
        families.setdefault(id(part.blocks), []).append(member)
    found = []
    for members in families.values():
        masks = []
        for member in members:
            part = structure.contributions[member]
            mask = touched[part.value]
            masks.append(mask if part.factor is None else mask | touched[part.factor])
        rows = np.flatnonzero(np.any(masks, axis=0))
        used = tuple(m for m, mask in zip(members, masks, strict=True) if mask.any())
        if len(rows):
            found.append(_Sensitive(structure.contributions[members[0]].blocks.take(rows), rows, used))
    return tuple(found)

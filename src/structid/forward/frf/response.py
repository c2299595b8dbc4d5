"""FRFs of a structure at its sensors, with their derivatives with respect to each parameter."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakSet, WeakValueDictionary

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, NumberArray
from structid.core.errors import InputError
from structid.dynamics.dense_fields import worthwhile
from structid.dynamics.factorization import VARIABLE
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Base, Structure
from structid.fem.elements.matrix_group import SolverFrfs
from structid.fem.measured import joined_receptance
from structid.forward.frf.friction import Contact, Sliding, sliding_amplitudes, sliding_contacts
from structid.forward.frf.line_equations import Channels, StiffnessSlopes, channels, matrix_coefficients
from structid.forward.frf.solvers import (
    MEDIUM_UP_TO,
    DenseOrSparseSolver,
    DenseSolver,
    FrfSolver,
    Pattern,
    SparseSolver,
    SubstructureCoupling,
    TabulatedFrf,
)
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.unknowns import Parameters


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency response of a parametrized structure at fixed frequencies, sensors and loads.

    Made by `response`; its methods are pure functions of the physical parameters. The last outputs of `channels` are
    the sliding motions of `contacts`, which are not handed out.
    """

    slopes: StiffnessSlopes
    parameters: Parameters
    fixed_coefficients: ComplexArray
    frequency: FloatArray
    kind_factor: ComplexArray
    channels: Channels
    contacts: tuple[Contact, ...]
    solver: FrfSolver

    @property
    def is_large(self) -> bool:
        """True where lines are factorized one by one as sparse matrices, with one line's fields in memory at a time."""
        return self.solver.is_large

    def values_at(self, physical: FloatArray) -> ComplexArray:
        """FRFs in the kind of the record, (n_frequencies, n_outputs, n_inputs), at parameters `physical` (n_params,).

        Friction contacts slide with balanced amplitudes and are not among the outputs.
        """
        coefficients, readings = self._sliding.at(physical) if self.contacts else (self.fixed_coefficients, None)
        if readings is None:
            used, column_of = np.unique(self.channels.inputs[0], return_inverse=True)
            readings = self.solver.readings(physical, coefficients, used)[:, :, column_of] * self.channels.inputs[1]
        return readings[:, : self.channels.n_outputs] * self.kind_factor[:, None, None]

    def derivatives_at(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """FRFs (n_frequencies, n_outputs, n_inputs), and their derivatives by the physical parameters, (..., n_params).

        By the adjoint method: with y = Z^-1 s for each sensor and x = Z^-1 f for each load, dH/dp is -y' (dZ/dp) x;
        changes of sliding amplitudes count. A large model with fewer parameters times loads than sensors solves for
        Z^-1 (dZ/dp) x instead.
        """
        coefficients, n_outputs = self._coefficients(physical), self.channels.n_outputs
        shape = len(self.frequency), n_outputs, len(self.channels.inputs[0])
        values = np.empty(shape, dtype=np.complex128)
        derivative = np.empty((*shape, self.parameters.n_params), dtype=np.complex128)
        for part, read, change, reach in self.solver.derivatives(physical, coefficients):
            if self.contacts:
                self._sliding.add_change(change, read, reach, physical, part)
            factor = self.kind_factor[part, None, None]
            np.multiply(read[:, :n_outputs], factor, out=values[part])
            np.multiply(change[:, :n_outputs], factor[..., None], out=derivative[part])
        return values, derivative

    def fields_at(self, physical: FloatArray, loads: sparse.csc_array) -> ComplexArray:
        """Motion of every degree of freedom under unit loads, (n_frequencies, n_dofs, n_loads), displacement per force.

        `physical` (n_params,) are the parameter values, `loads` (n_dofs, n_loads) the columns of the loads.
        """
        fields = np.empty((len(self.frequency), *loads.shape), dtype=np.complex128)
        for part, solved in self.solver.fields(physical, self._coefficients(physical), loads):
            fields[part] = solved
        return fields

    def solved_at(
        self, physical: FloatArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Motion (n, n_dofs, n_loads) under unit loads (all columns by default), one block of lines after another."""
        return self.solver.fields(physical, self._coefficients(physical), loads)

    def sensitivity_at(self, physical: FloatArray, x: NumberArray, y: NumberArray) -> ComplexArray:
        """Products -y' (dZ/dp) x without conjugate, (n_frequencies, n_y, n_x, n_params).

        `x` (n_frequencies, n_dofs, n_x) are motions under any drive, `y` (n_frequencies, n_dofs, n_y) under unit loads
        at the sensors.
        """
        return self.slopes.products(physical, -self._coefficients(physical), x, y)

    def sensor_gram(self, physical: FloatArray) -> ComplexArray:
        """Product Y' conj(Y), (n_frequencies, n_outputs, n_outputs), of motions under forces at the sensors.

        Y = Z^-1 S is that motion, with Z the dynamic stiffness and S the columns of the sensors. `physical` (n_params,)
        are the parameters.
        """
        n_outputs = self.channels.n_outputs
        gram = np.empty((len(self.frequency), n_outputs, n_outputs), dtype=np.complex128)
        for part, fields in self.solved_at(physical):
            y = self.channels.under_sensors(fields)[:, :, :n_outputs]
            gram[part] = np.swapaxes(y, 1, 2) @ np.conj(y)
        return gram

    def _coefficients(self, physical: FloatArray) -> ComplexArray:
        """Coefficients of the matrices in the dynamic stiffness, with balanced sliding amplitudes of `contacts`."""
        return self._sliding.at(physical)[0] if self.contacts else self.fixed_coefficients

    @cached_property
    def _sliding(self) -> Sliding:
        return Sliding(self.contacts, self.channels, self.solver, self.parameters, self.fixed_coefficients)


class ResponseCache:
    """Cache of what responses in use share: sparsity patterns with their analyses, sparse solvers with their fields.

    Problems that are made from one another share one cache; its content goes to no other process.

    Parameters
    ----------
    factorizer : {"pardiso", "superlu"}, optional
        Factorizer of models with more than 64 degrees of freedom; by default the one that the environment variable
        STRUCTID_FACTORIZER names, or the fastest that is installed.
    """

    def __init__(self, factorizer: str | None = None) -> None:
        """Empty cache for solvers with this `factorizer` ("pardiso" or "superlu"), by default the fastest installed."""
        self.factorizer = factorizer
        self._slopes: WeakSet[StiffnessSlopes] = WeakSet()
        self._patterns: WeakValueDictionary[tuple[object, ...], Pattern] = WeakValueDictionary()
        self._solvers: WeakValueDictionary[tuple[object, ...], SparseSolver] = WeakValueDictionary()

    def __reduce__(self) -> tuple[type[ResponseCache], tuple[str | None]]:
        return ResponseCache, (self.factorizer,)

    def slopes(self, structure: Structure, parameters: Parameters) -> StiffnessSlopes:
        """Derivatives of the dynamic stiffness of the structure by the parameters; the cached object if there is one.

        One serves for equal structure and design of the parameters, whatever their priors and starts.
        """
        slopes = next((known for known in self._slopes if known.serves(structure, parameters)), None)
        if slopes is None:
            slopes = StiffnessSlopes(structure, parameters)
            self._slopes.add(slopes)
        return slopes

    def sparse_solver(
        self, slopes: StiffnessSlopes, sides: Channels, record: FrfRecord, reduced: float | None = None
    ) -> SparseSolver:
        """Sparse solver for the structure and parameters of `slopes` at the lines of `record`.

        It is cached while it is in use. `sides` are its loads and sensors. With friction contacts each record has
        another solver. `reduced` is the largest error of values, in parts of the largest of their line, that may come
        from few factorizations; None solves every line.
        """
        with_contacts = record if sides.n_contacts else None
        key: tuple[object, ...] = (
            slopes,
            record.outputs,
            record.inputs,
            with_contacts,
            self.factorizer or os.environ.get(VARIABLE),
        )
        pattern = self._patterns.get(key) or self._patterns.setdefault(key, Pattern(slopes, sides, self.factorizer))
        key = (pattern, record.frequency.tobytes(), reduced)
        return self._solvers.get(key) or self._solvers.setdefault(key, SparseSolver(pattern, record.frequency, reduced))


def response(
    structure: Structure,
    unknown: Parameters,
    record: FrfRecord,
    measured_sliding: bool = False,
    reduced: float | None = None,
    cache: ResponseCache | None = None,
) -> Response:
    """FRF model of `structure` at the frequencies, sensors and loads of `record`.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Parameters of that structure.
    record : FrfRecord
        Its values serve only for measured sliding amplitudes.
    measured_sliding : bool
        Whether friction elements that name sensors slide with the amplitude that those measured.
    reduced : float, optional
        Largest error of values, in parts of the largest of their line, that a large model may have from few
        factorizations; None factorizes at every line. It is not used with driving supports or measured components.
    cache : ResponseCache, optional
        Cache that it shares with other responses; it names the factorizer of large models.

    Raises
    ------
    InputError
        If a sensor or load is not part of the structure, there is friction and the record has several loads or is of
        supports that drive the structure, or a measured component is not known at the lines of the record.
    """
    cache = cache or ResponseCache()
    bases = driving_bases(structure, record)
    structure = structure.release_supports(bases) if bases else structure
    slopes = cache.slopes(structure, unknown)
    matrix_kinds = slopes.matrix_kinds
    measured = sliding_amplitudes(structure, record) if measured_sliding else {}
    contacts, slides = sliding_contacts(structure, matrix_kinds, record, set(measured))
    sides = channels(structure.selection(record.inputs), structure.selection(record.outputs), slides)
    reduced = None if bases or structure.measured else reduced
    small = DenseSolver(slopes, sides, record.frequency)
    solver: FrfSolver = small
    alone = next((element for element in structure.elements if isinstance(element, SolverFrfs)), None)
    if alone is not None:
        solver = TabulatedFrf(alone, structure, unknown, record)
    elif structure.n_dofs > DENSE_UP_TO:
        solver = large = cache.sparse_solver(slopes, sides, record, reduced)
        medium = reduced is None and structure.n_dofs <= MEDIUM_UP_TO
        if medium and worthwhile(len(record.frequency), structure.n_dofs, False):
            solver = DenseOrSparseSolver(small, large)
    if bases or structure.measured:
        solver = _coupled(solver, structure, bases, record, sides, slopes)
    return Response(
        slopes=slopes,
        parameters=unknown,
        fixed_coefficients=matrix_coefficients(matrix_kinds, record.laplace, measured),
        frequency=record.frequency,
        kind_factor=record.laplace ** DERIVATIVES[record.kind],
        channels=sides,
        contacts=contacts,
        solver=solver,
    )


def driving_bases(structure: Structure, record: FrfRecord) -> tuple[Base, ...]:
    """Supports whose motion is the input of `record`, in the order of its inputs; empty if the inputs are forces.

    Raises
    ------
    InputError
        If inputs are supports and the record is no transmissibility, or the other way round, or only some inputs are
        supports.
    """
    bases = structure.driven(record.inputs)
    if bases and not record.is_per_motion:
        raise InputError(
            f"input {record.inputs[0]} is a support of base {bases[0].name!r}, so its values are motion per motion of the"
            f" support, but the record holds {record.kind}; read it with kind = 'transmissibility'"
        )
    if record.is_per_motion and not bases:
        raise InputError(
            f"transmissibility is per motion of a support, but input {record.inputs[0]} is none; make it a support of a"
            " [[structure.base]], or read the record as receptance, mobility or accelerance"
        )
    return bases


def _coupled(
    solver: FrfSolver,
    structure: Structure,
    bases: tuple[Base, ...],
    record: FrfRecord,
    sides: Channels,
    slopes: StiffnessSlopes,
) -> SubstructureCoupling:
    """Solver of `structure`, whose driving supports `bases` are released already, coupled to its measured components.

    `solver` solves the structure alone, `slopes` has its matrices and their derivatives, `sides` its loads and sensors.
    Coupled are the bases, in their order, then the interfaces of the components. Raises `InputError` for components if
    `record` has a window decay, and for bases with friction contacts or with a sensor on one.
    """
    driven = _driven(structure, bases, record, sides)
    interface = structure.selection([dof for component in structure.measured for dof in component.interface])
    receptance = np.zeros((len(record.frequency), *[driven.shape[1] + interface.shape[1]] * 2), dtype=np.complex128)
    if structure.measured:
        if record.decay is not None and record.decay.any():
            raise InputError(
                f"{structure.measured[0].words} was measured without a window that decays, so that `window_decay` of the record"
                " does not fit it; correct the record for its window"
            )
        receptance[:, driven.shape[1] :, driven.shape[1] :] = joined_receptance(structure.measured, record.frequency)
    joined = sparse.csc_array(sparse.hstack([driven, interface]))
    return SubstructureCoupling(solver, slopes, sides, joined, receptance, driven.shape[1])


def _driven(structure: Structure, bases: tuple[Base, ...], record: FrfRecord, sides: Channels) -> sparse.csc_array:
    """Columns (n_dofs, n_bases) of unit motion of the first support of each released base.

    `sides` has the loads, sensors and friction contacts of the structure. Raises `InputError` with friction contacts,
    or if a sensor reads one of the bases.
    """
    if bases and sides.n_contacts:
        raise InputError("dry friction takes no motion of supports; take the friction out, or measure the force")
    columns = structure.selection([base.supports[0].unsigned for base in bases])
    seen = np.abs(structure.selection(record.outputs)[columns.indices, :]).sum(axis=0)
    if seen.any():
        sensor = record.outputs[int(np.argmax(seen))]
        raise InputError(
            f"sensor {sensor} moves with the support that drives the structure; leave it out of `channels_used`"
        )
    return columns

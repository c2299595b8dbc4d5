"""Harmonic balance of dry friction: sliding amplitudes that were measured, or that the motion itself has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, NumberArray
from structid.core.errors import InputError
from structid.core.last_results import LastResults
from structid.dynamics.dense_fields import MOST_SMALLER, solve_small_systems
from structid.fem import Friction, Structure
from structid.forward.frf.line_equations import Channels
from structid.forward.frf.solvers import FrfSolver
from structid.records import FrfRecord
from structid.records.record import as_recorded
from structid.unknowns import Parameters

_MOST_ITERATIONS = 60
#: Amplitude of a contact that sticks, in parts of its motion without friction.
_STUCK = 1e-4
#: A Newton step by no more than this part leaves an error of rounding.
_SMALL_STEP = 1e-8
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Contact:
    """A friction element that slides with the model's own amplitude: the indices of its matrix and of its force."""

    matrix_index: int
    value: int


def sliding_contacts(
    structure: Structure, matrix_kinds: tuple[str, ...], record: FrfRecord, measured: set[str]
) -> tuple[tuple[Contact, ...], sparse.csc_array]:
    """Contacts of the friction elements in harmonic balance, and columns (n_dofs, n_contacts) of their sliding motion.

    They are in the order of the elements. A contact has the index of its matrix in `matrix_kinds` and that of its force
    among the property values. Elements named in `measured` are left out: their sliding was measured. Raises
    `InputError` if any is left and the record has several loads.
    """
    contacts, columns = [], [sparse.csc_array((structure.n_dofs, 0))]
    for element in structure.elements:
        if isinstance(element, Friction) and element.name not in measured:
            require_one_load(element, record)
            value = next(p.values.start for p in structure.properties if p.element == element.name)
            contacts.append(Contact(matrix_kinds.index(f"friction:{element.name}"), value))
            slide = structure.selection(element.first)
            columns.append(slide if element.second is None else slide - structure.selection(element.second))
    return tuple(contacts), sparse.csc_array(sparse.hstack(columns))


@dataclass(frozen=True, eq=False)
class Sliding:
    """A model whose contacts slide with the amplitudes of its own motion.

    Attributes
    ----------
    contacts : tuple of Contact
    channels : Channels
    solver : FrfSolver
    parameters : Parameters
    fixed_coefficients : (n_lines, n_matrices) complex array
        Coefficient of each matrix in the dynamic stiffness, 0 for `contacts`.
    """

    contacts: tuple[Contact, ...]
    channels: Channels
    solver: FrfSolver
    parameters: Parameters
    fixed_coefficients: ComplexArray

    def at(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Coefficients of the matrices with balanced sliding amplitudes, (n_lines, n_matrices), and readings; cached.

        The readings of sensors and contacts, (n_lines, n_outputs + n_contacts, 1), come from those without friction;
        None where that would lose digits. `physical` (n_params,) are the parameters.
        """
        return self._cache.get_or_make(physical.tobytes(), lambda: self._balanced(physical))

    def _balanced(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray | None]:
        """Coefficients (n_lines, n_matrices) with balanced sliding amplitudes, and readings of sensors, then contacts.

        Coefficients are those of the matrices in the dynamic stiffness, i / amplitude for friction. Readings are
        (n_lines, n_outputs + n_contacts, 1); None where friction makes them more than 1000 times smaller at any line.
        `physical` (n_params,) are the parameters.
        """
        free, reach = self._frictionless_readings(physical)
        n_outputs, frictions = self.channels.n_outputs, self.matrix_indices
        force, floor = self.force(physical), self._stuck_amplitude
        amplitude = balanced_amplitudes(reach[:, n_outputs:], free[:, n_outputs:, 0], force, floor)
        coefficients = np.array(self.fixed_coefficients)
        coefficients[:, frictions] = 1j / amplitude
        return coefficients, slid_readings(free, reach, coefficients[:, frictions] * force)

    def add_change(
        self, derivative: ComplexArray, readings: NumberArray, reach: NumberArray, physical: FloatArray, part: slice
    ) -> None:
        """Add to derivatives at fixed sliding amplitudes the part by the change of the amplitudes, in place.

        `part` is the range of lines, `physical` (n_params,) are the parameters; see `LineDerivatives` for the others.
        """
        size = (1j / self.at(physical)[0][part][:, self.matrix_indices]).real
        motion = readings[:, self.channels.n_outputs :, 0]
        add_amplitude_change(derivative[:, :, 0], motion, reach, self.force(physical), size)

    @property
    def matrix_indices(self) -> list[int]:
        return [contact.matrix_index for contact in self.contacts]

    def force(self, physical: FloatArray) -> FloatArray:
        """Friction force of each contact per unit drive, (n_contacts,), at the parameters `physical` (n_params,)."""
        return self.parameters.values(physical)[[contact.value for contact in self.contacts]]

    @cached_property
    def _cache(self) -> LastResults[bytes, tuple[ComplexArray, ComplexArray | None]]:
        """Balanced coefficients and readings at the two sets of parameters that were asked for last."""
        return LastResults(2)

    @cached_property
    def _stuck_amplitude(self) -> FloatArray:
        """Amplitude of a contact that sticks, (n_lines, n_contacts): a small part of its free motion at the start."""
        free, _ = self._frictionless_readings(self.parameters.start)
        return np.maximum(_STUCK * np.abs(free[:, self.channels.n_outputs :, 0]), _TINY)

    def _frictionless_readings(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Frictionless readings of sensors and then contacts, under the load and under unit forces at the contacts.

        Shapes (n_lines, n_outputs + n_contacts, 1) and (n_lines, n_outputs + n_contacts, n_contacts). `physical`
        (n_params,) are the parameters.
        """
        (load, load_sign), n_outputs = self.channels.inputs, self.channels.n_outputs
        columns, signs = self.channels.outputs[0][n_outputs:], self.channels.outputs[1][n_outputs:]
        used, column_of = np.unique(np.concatenate([load, columns]), return_inverse=True)
        readings = self.solver.readings(physical, self.fixed_coefficients, used)[:, :, column_of]
        return readings[:, :, : len(load)] * load_sign, readings[:, :, len(load) :] * signs


def balanced_amplitudes(
    flexibility: ComplexArray, free: ComplexArray, force: FloatArray, floor: FloatArray
) -> FloatArray:
    """Sliding amplitudes s = abs(q) that solve q = b - A (i r q / s), (n_frequencies, n_contacts).

    By at most 60 Newton steps. A contact sticks where friction exceeds the force that reaches it; its amplitude is then
    `floor`.

    Parameters
    ----------
    flexibility : (n_frequencies, n_contacts, n_contacts) complex array
        A: motion of each contact per unit force at each contact, without friction.
    free : (n_frequencies, n_contacts) complex array
        b: motion of each contact under the drive, without friction.
    force : (n_contacts,) float array
        r: friction force per unit drive.
    floor : (n_frequencies, n_contacts) float array
        Amplitude of a contact that sticks; small against abs(b).
    """
    size = np.maximum(np.abs(free), floor)
    moving, identity = np.arange(len(size)), np.eye(len(force))
    motions, sizes = np.concatenate([free[..., None], flexibility], axis=2), size
    for _ in range(_MOST_ITERATIONS):
        new = _newton_step(motions, force, floor, sizes, identity)
        goes_on = (np.abs(new - sizes) / sizes).max(axis=1, initial=0.0) > _SMALL_STEP
        size[moving] = new
        if not goes_on.any():
            break
        if goes_on.all():
            sizes = new
        else:
            moving, motions, floor, sizes = moving[goes_on], motions[goes_on], floor[goes_on], new[goes_on]
    return size


def _newton_step(
    motions: ComplexArray, force: FloatArray, floor: FloatArray, size: FloatArray, identity: FloatArray
) -> FloatArray:
    """Sliding amplitudes (n_frequencies, n_contacts) after one Newton step from `size`, changed fivefold at most.

    `motions` (n_frequencies, n_contacts, 1 + n_contacts) are those of the contacts without friction: under the drive,
    then under unit contact forces. `force` (n_contacts,) is the friction force per unit drive, `floor` the least
    amplitude, that of a contact that sticks. `size` and `floor` are (n_frequencies, n_contacts), `identity` is
    (n_contacts, n_contacts).
    """
    pull = 1j * force / size
    solved = solve_small_systems(identity + motions[..., 1:] * pull[:, None, :], motions)
    motion, reach = solved[..., 0], solved[..., 1:]
    length = np.abs(motion)
    unit = np.conj(motion) / np.maximum(length, _TINY)
    slope = (unit[..., None] * reach * (pull * motion / size)[:, None, :]).real
    error = length - size
    stuck = (size <= floor) & (error <= 0)
    if stuck.any():
        error[stuck] = 0.0
        slope[stuck] = 0.0
    step = solve_small_systems(identity - slope, error[..., None])[..., 0]
    return np.maximum(np.minimum(np.maximum(size + step, 0.2 * size), 5.0 * size), floor)


def slid_readings(free: ComplexArray, reach: ComplexArray, factors: ComplexArray) -> ComplexArray | None:
    """Readings with friction from those without, in the shape of `free`; None where the difference would lose digits.

    It does where friction makes the readings of a line more than 1000 times smaller.

    Parameters
    ----------
    free : (n_frequencies, n_outputs + n_contacts, n_inputs) complex array
        Readings under the loads, contacts last.
    reach : (n_frequencies, n_outputs + n_contacts, n_contacts) complex array
        Readings under unit forces at the contacts.
    factors : (n_frequencies, n_contacts) complex array
        Force on the structure per sliding motion of each contact, against that motion: i r / s with r the friction
        force per unit drive and s the sliding amplitude.
    """
    n_contacts = factors.shape[1]
    system = np.eye(n_contacts) + factors[:, :, None] * reach[:, -n_contacts:]
    readings = free - reach @ solve_small_systems(system, factors[:, :, None] * free[:, -n_contacts:])
    before, after = (np.linalg.norm(values, axis=(1, 2)) for values in (free, readings))
    return None if (before > MOST_SMALLER * after).any() else readings


def add_amplitude_change(
    derivative: ComplexArray, motion: NumberArray, reach: NumberArray, force: FloatArray, size: FloatArray
) -> None:
    """Add to a derivative at fixed sliding amplitudes the part by their change, in place.

    With s the amplitudes, dH = dH|s + (dH/ds) ds and ds = Re(conj(q) dq) / s, solved for ds line by line.

    Parameters
    ----------
    derivative : (n_frequencies, n_outputs + n_contacts, n_params) complex array
        Derivative of receptances at fixed amplitudes, contacts last; changed in place.
    motion : (n_frequencies, n_contacts) complex array
        q, motion of the contacts under the drive.
    reach : (n_frequencies, n_outputs + n_contacts, n_contacts) complex array
        Receptance from a force at each contact.
    force : (n_contacts,) float array
        r: friction force per unit drive.
    size : (n_frequencies, n_contacts) float array
        s; where it differs from abs(q) by more than 1e-6 of it the contact sticks and s stays.
    """
    n_contacts = len(force)
    by_size = reach * (1j * force * motion / size**2)[:, None, :]
    slides = np.abs(np.abs(motion) / size - 1) < 1e-6
    unit = (slides * np.conj(motion) / size)[..., None]
    coupling = np.eye(n_contacts) - (unit * by_size[:, -n_contacts:]).real
    change = solve_small_systems(coupling, (unit * derivative[:, -n_contacts:]).real)
    derivative += by_size @ change


def sliding_amplitudes(structure: Structure, record: FrfRecord) -> dict[str, FloatArray]:
    """Measured sliding amplitude per unit drive, (n_frequencies,), of friction elements that name sensors, by name.

    It is in m per N (or rad), from the FRFs turned into receptance. Empty if no friction element names sensors.

    Raises
    ------
    InputError
        If a friction element names a sensor that the record lacks, or the record has several loads.
    """
    amplitudes = {}
    for element in structure.elements:
        if not isinstance(element, Friction) or not element.measured_by:
            continue
        require_one_load(element, record)
        measured = record.channels(as_recorded(element.measured_by, record)).as_kind("receptance")
        signs = np.array([dof.sign for dof in measured.outputs])
        amplitudes[element.name] = element.sliding(measured.values[:, :, 0] * signs)
    return amplitudes


def require_one_load(element: Friction, record: FrfRecord) -> None:
    """Raise `InputError` unless the record has one load: friction makes the response to each load its own."""
    if len(record.inputs) != 1:
        raise InputError(f"friction {element.name!r} needs a record with one load, got {len(record.inputs)}")

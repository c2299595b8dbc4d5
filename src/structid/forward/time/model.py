"""Readings of a structure's sensors at the samples of a record, without discretization error, from held forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import Dof
from structid.core.errors import InputError, SingularModelError
from structid.dynamics.exact_discretization import Step, exact_step, stepped
from structid.fem import Base, Structure
from structid.forward.sensitivity import require_matrices_in_time, weight_slope
from structid.forward.time.options import Hold, Oscillation
from structid.unknowns import Parameters

_MOST_DOFS = 200
_MATRIX_KINDS = ("mass", "damping", "stiffness")
_CHUNK = 4_000_000


@dataclass(frozen=True, eq=False)
class TimeModel:
    """A structure with mass, viscous damping and stiffness, its loads and its sensors.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    drive : InputHold
    loads : tuple of Dof
        Degrees of freedom of forces, or of driven supports, whose accelerations take the place of forces.
    sensors : tuple of Dof
    orders : (n_sensors,) int array
        Derivative that each sensor reads: 0 displacement, 1 velocity, 2 acceleration.
    bases : tuple of Base
        Supports that drive the structure, one for each load; empty if forces do.
    """

    structure: Structure
    unknown: Parameters
    drive: InputHold
    loads: tuple[Dof, ...]
    sensors: tuple[Dof, ...]
    orders: IntArray
    bases: tuple[Base, ...] = ()

    def __post_init__(self) -> None:
        """Raise `InputError` if the model does not suit a time-domain fit.

        The reasons are: loss factors or friction; more than 200 free degrees of freedom; a support that drives together
        with an oscillating force; a rest that ends before the first sample of a sampled force.
        """
        require_viscous(self.structure, self.unknown)
        if self.structure.n_dofs > _MOST_DOFS:
            raise InputError(
                f"the structure must have at most {_MOST_DOFS} free degrees of freedom for a time-domain fit, got"
                f" {self.structure.n_dofs}; condense it (see `reduction`), or identify from FRFs with `identify`"
            )
        if self.bases and self.drive.oscillates:
            raise InputError(
                f"base {self.bases[0].name!r} drives the structure by samples of its acceleration; take force = 'first' or 'zero'"
            )
        if self.drive.gap > 0 and not self.drive.oscillates:
            raise InputError(
                f"the rest must last until the first sample where the force is known by samples, but they begin {self.drive.gap:g}"
                " s later; begin the record at rest, take initial 'unknown', or give the force as an Oscillation"
            )

    @cached_property
    def moving(self) -> Structure:
        """The structure with the supports that drive it released."""
        return self.structure.release_supports(self.bases) if self.bases else self.structure

    @cached_property
    def load_columns(self) -> FloatArray:
        """Columns (n_dofs, n_loads), on degrees of freedom of `moving`, of the force or support motion of each load."""
        return np.asarray(self.moving.selection(self.loads).toarray(), dtype=np.float64)

    @cached_property
    def free(self) -> IntArray:
        """Degrees of freedom of `moving` that no support drives."""
        return np.flatnonzero(~self.load_columns.any(axis=1)) if self.bases else np.arange(self.structure.n_dofs)

    @cached_property
    def sensor_columns(self) -> FloatArray:
        """Matrix (n_free, n_sensors) of sensor readings as combinations of the free motion.

        Raises
        ------
        InputError
            If a sensor reads a support that drives the structure.
        """
        columns = np.asarray(self.moving.selection(self.sensors).toarray(), dtype=np.float64)
        still = np.delete(columns, self.free, axis=0).any(axis=0)
        if still.any():
            raise InputError(
                f"sensor {self.sensors[int(np.argmax(still))]} moves with the support that drives the structure; leave it out"
                " of `channels_used`"
            )
        return columns[self.free]

    def readings(self, values: FloatArray, force: FloatArray, initial: FloatArray | None, n_times: int) -> FloatArray:
        """Readings of the sensors, (n_times, n_sensors).

        Parameters
        ----------
        values : (n_params,) float array
            Physical parameters.
        force : (n_times, n_loads) float array
            N or N m; for an `Oscillation` (n_force_values,), all cosines and then all sines.
        initial : (2 n_free,) float array, optional
            Displacement and velocity at the start; rest if None.
        n_times : int

        Raises
        ------
        SingularModelError
            If the mass matrix is not positive definite.
        """
        system = self._linear(values, derivatives=False)
        inputs = self.drive.inputs(force, n_times)[..., None]
        return system.readings(system.start_of(initial)[:, None], inputs, n_times)[..., 0]

    def derivatives(
        self, values: FloatArray, force: FloatArray, initial: FloatArray | None, n_times: int
    ) -> tuple[FloatArray, FloatArray]:
        """Readings (n_times, n_sensors) and their derivative by the parameters, (n_times, n_sensors, n_params).

        Arguments are those of `readings`.
        """
        system = self._linear(values, derivatives=True)
        return system.derivatives(system.start_of(initial), self.drive.inputs(force, n_times), n_times)

    def unit_forces(self, values: FloatArray, n_times: int) -> FloatArray:
        """Readings from rest for unit amplitudes of an oscillation, (n_times, n_sensors, n_force_values)."""
        system, inputs = self._linear(values, derivatives=False), self.drive.oscillation(n_times)
        return system.readings(np.zeros((2 * len(self.free), inputs.shape[2])), inputs, n_times)

    def unit_starts(self, values: FloatArray, n_times: int) -> FloatArray:
        """Readings of free motion from unit displacements and velocities, (n_times, n_sensors, 2 n_free).

        `values` (n_values,) are the property values, `n_times` the number of samples.
        """
        system = self._linear(values, derivatives=False)
        nothing = np.zeros((len(self.drive.times(n_times)), len(self.drive.generator), 2 * len(self.free)))
        return system.readings(system.start_of(np.eye(2 * len(self.free))), nothing, n_times)

    def unit_pulses(self, values: FloatArray, n_times: int) -> FloatArray:
        """Readings from rest for a unit of each force sample alone, (n_times, n_sensors, n_times, n_loads).

        They are indexed by the sample that is read, the sensor, the force sample that is 1, and its load. `values`
        (n_params,) are the parameters.
        """
        system, n_loads = self._linear(values, derivatives=False), len(self.loads)
        readings = np.zeros((n_times, len(self.sensors), n_times, n_loads))
        rest = np.zeros((2 * len(self.free), 2))
        for load in range(n_loads):
            signal = np.zeros((2, n_times + 1, n_loads))
            signal[0, 0, load] = signal[1, 1, load] = 1.0
            inputs = np.stack([self.drive.inputs(s, n_times + 1) for s in signal], axis=2)
            both = system.readings(rest, inputs, n_times + 1)
            readings[:, :, 0, load] = both[:n_times, :, 0]
            for k in range(1, n_times):
                readings[k:, :, k, load] = both[1 : n_times - k + 1, :, 1]
        return readings

    def _linear(self, values: FloatArray, derivatives: bool) -> LinearSystem:
        """Modal state space of the structure at the parameters `values` (n_params,).

        Without `derivatives` its derivatives by the parameters have no columns. Raises `SingularModelError` if the mass
        matrix is not positive definite.
        """
        properties = self.unknown.values(values)
        whole = [self.moving.matrix(matrix_kind, properties).toarray() for matrix_kind in _MATRIX_KINDS]
        mass, damping, stiffness = (matrix[np.ix_(self.free, self.free)] for matrix in whole)
        try:
            squares, shapes = linalg.eigh(stiffness, mass)
        except (linalg.LinAlgError, ValueError) as error:
            raise SingularModelError(
                "the mass matrix must be positive definite; give every degree of freedom some mass"
            ) from error
        scale = np.sqrt(np.maximum(squares, 0.0))
        step, n_inputs = self.drive.step, len(self.drive.generator)
        scale = np.where(scale * step > 1e-3, scale, 1e-3 / step)
        n_params = self.unknown.n_params if derivatives else 0
        n, modal_damping = len(squares), shapes.T @ damping @ shapes
        wide = np.zeros((self.moving.n_dofs, n))
        wide[self.free] = shapes
        load: FloatArray = wide.T @ self.load_columns
        if self.bases:
            load = self.drive.force_matrix(*(wide.T @ matrix @ self.load_columns for matrix in whole))
        rate = np.zeros((2 * n, 2 * n))
        rate[:n, n:], rate[n:, :n], rate[n:, n:] = np.diag(scale), np.diag(-squares / scale), -modal_damping
        coupling = np.zeros((2 * n, n_inputs))
        coupling[n:, : load.shape[1]] = load
        rate_change, coupling_change = (np.zeros((2 * n, n_params, width)) for width in (2 * n, n_inputs))
        if derivatives:
            right = np.concatenate([wide, self.load_columns], axis=1) if self.bases else wide
            changes = [
                _change_between(self.moving, self.unknown, matrix_kind, wide, right, properties)
                for matrix_kind in _MATRIX_KINDS
            ]
            inertia, viscous, elastic = (change[..., :n] for change in changes)
            rate_change[n:, :, :n] = (inertia * squares - elastic) / scale
            rate_change[n:, :, n:] = inertia @ modal_damping - viscous
            coupling_change[n:, :, : load.shape[1]] = -(inertia @ load)
            if self.bases:
                coupling_change[n:] += self.drive.force_matrix(*(change[..., n:] for change in changes))
        return LinearSystem(self, shapes, scale, shapes.T @ mass, rate, coupling, rate_change, coupling_change)


def _change_between(
    structure: Structure,
    unknown: Parameters,
    matrix_kind: str,
    left: FloatArray,
    right: FloatArray,
    properties: FloatArray,
) -> FloatArray:
    """Products left' (dA/dp) right for the matrix A named by `matrix_kind`, (n_left, n_params, n_right).

    `left` and `right` are (n_dofs, n_left) and (n_dofs, n_right); `properties` (n_values,) are the property values.
    """
    n_params, n_left, n_right = unknown.n_params, left.shape[1], right.shape[1]
    total = np.zeros((n_params, n_left * n_right))
    for part in structure.contributions:
        if part.matrix_kind != matrix_kind:
            continue
        rows = weight_slope(part, unknown, properties)
        used = np.flatnonzero(np.diff(rows.indptr))
        if len(used) > n_params:  # as modal damping has, an element an entry
            changes = (part.blocks.assemble(column) for column in rows.toarray().T)
            total += np.stack([(left.T @ (matrix @ right)).ravel() for matrix in changes])
        elif len(used):
            forms = part.blocks.take(used).bilinear(left, right).reshape(len(used), -1)
            total += rows[used].T @ forms
    return np.swapaxes(total.reshape(n_params, n_left, n_right), 0, 1)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Modal state space of a `TimeModel` at given parameters; shapes stay fixed where derivatives are taken."""

    model: TimeModel
    shapes: FloatArray
    scale: FloatArray
    inverse_shapes: FloatArray
    rate: FloatArray
    coupling: FloatArray
    rate_change: FloatArray
    coupling_change: FloatArray

    def _step(self, length: float) -> Step:
        generator = self.model.drive.generator
        return exact_step(self.rate, self.coupling, generator, length, self.rate_change, self.coupling_change)

    @cached_property
    def _steps(self) -> tuple[Step, Step]:
        """Exact state transition over the first time step, and over all later ones.

        They differ if the motion starts before the first sample by another time than a step. Each has the transition of
        the state and the entry of the inputs, with derivatives by the parameters.
        """
        step, gap = self.model.drive.step, self.model.drive.gap
        usual = self._step(step)
        same = gap == 0 or abs(gap - step) < 1e-12 * step
        return (usual if same else self._step(gap)), usual

    def _pieces(self, n_times: int, width: int) -> Iterator[tuple[Step, slice]]:
        """Yield the state transition and the range of step numbers (from 0) of one block of steps after another.

        A block fits into memory; `width` is the number of state columns that are carried along. The step from the start
        of the motion to the first sample, if there is one, is a block of its own. `n_times` is the number of samples.
        """
        n_steps = n_times - 1 + (self.model.drive.gap > 0)
        first = 0
        if self.model.drive.gap > 0:
            yield self._steps[0], slice(0, 1)
            first = 1
        chunk = max(1, _CHUNK // (len(self.rate) * width))
        for begin in range(first, n_steps, chunk):
            yield self._steps[1], slice(begin, min(begin + chunk, n_steps))

    def start_of(self, initial: FloatArray | None) -> FloatArray:
        """Scaled modal state (n_states, ...) from `initial`, displacements and then velocities (2 n_free, ...).

        The state is modal displacements times their frequency scale, then modal velocities; (n_states,) zeros if
        `initial` is None.
        """
        n = len(self.scale)
        if initial is None:
            return np.zeros(2 * n)
        displacement, velocity = self.inverse_shapes @ initial[:n], self.inverse_shapes @ initial[n:]
        return np.concatenate([(displacement.T * self.scale).T, velocity])

    @cached_property
    def _output(self) -> tuple[FloatArray, FloatArray]:
        """Output matrices of the sensors: (n_sensors, n_states) for the state, (n_sensors, n_inputs) for inputs.

        The state is scaled modal displacements, then modal velocities; the inputs' matrix is 0 except for
        accelerations.
        """
        n, seen = len(self.scale), self.model.sensor_columns.T @ self.shapes
        order = self.model.orders[:, None]
        slow = [np.where(order == 0, seen / self.scale, 0.0), np.where(order == 1, seen, 0.0)]
        fast = np.where(order == 2, seen, 0.0)
        return np.concatenate(slow, axis=1) + fast @ self.rate[n:], fast @ self.coupling[n:]

    def readings(self, start: FloatArray, inputs: FloatArray, n_times: int) -> FloatArray:
        """Readings of several motions at once, (n_times, n_sensors, n_motions).

        Parameters
        ----------
        start : (n_states, n_motions) float array
            Scaled modal state at the first instant.
        inputs : (n_steps + 1, n_inputs, n_motions) float array
            Input state (such as force and its change over a step) at the start and at the end of each step, for each
            motion.
        n_times : int
            Number of samples of the record; they are the last of the instants of `inputs`.
        """
        of_state, of_input = self._output
        readings = np.empty((len(inputs), len(of_state), start.shape[1]))
        readings[0], state = of_state @ start, start
        for step, span in self._pieces(n_times, start.shape[1]):
            states = stepped(step.transition, step.entry @ inputs[span], state)
            readings[span.start + 1 : span.stop + 1], state = of_state @ states[1:], states[-1]
        return (readings + of_input @ inputs)[-n_times:]

    def derivatives(self, start: FloatArray, inputs: FloatArray, n_times: int) -> tuple[FloatArray, FloatArray]:
        """Readings of one motion and their derivatives, (n_times, n_sensors) and (n_times, n_sensors, n_params).

        Parameters
        ----------
        start : (n_states,) float array
            Scaled modal state at the first instant; it does not depend on the parameters.
        inputs : (n_steps + 1, n_inputs) float array
            Input state (such as force and its change over a step) at the start and at the end of each step.
        n_times : int
            Number of samples of the record; one less than the instants of `inputs` where motion starts before the
            first.
        """
        n_params = self.rate_change.shape[1]
        values, slopes = [], []
        state = np.concatenate([start[:, None], np.zeros((len(start), n_params))], axis=1)
        if self.model.drive.gap == 0:
            value, slope = self._read(state[None], inputs[:1])
            values.append(value)
            slopes.append(slope)
        for step, span in self._pieces(n_times, 1 + n_params):
            states = self._advanced(step, state, inputs[span])
            value, slope = self._read(states[1:], inputs[span.start + 1 : span.stop + 1])
            values.append(value)
            slopes.append(slope)
            state = states[-1]
        return np.concatenate(values), np.concatenate(slopes)

    def _advanced(self, step: Step, state: FloatArray, inputs: FloatArray) -> FloatArray:
        """States and their derivatives by parameters over the next steps, (n_steps + 1, n_states, 1 + n_params).

        The first of them is `state` (n_states, 1 + n_params), whose first column is the state itself; `inputs`
        (n_steps, n_inputs) are those at the begin of each step, and `step` is the transition over one.
        """
        states = stepped(step.transition, inputs @ step.entry.T, state[:, 0])
        wide = np.concatenate([step.transition_change, step.entry_change], axis=2)
        known = np.concatenate([states[:-1], inputs], axis=1)
        pushed = (wide.reshape(-1, wide.shape[2]) @ known.T).reshape(len(state), -1, len(inputs))
        drive = np.ascontiguousarray(np.moveaxis(pushed, 2, 0))
        return np.concatenate([states[..., None], stepped(step.transition, drive, state[:, 1:])], axis=2)

    def _read(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sensor readings (n_times, n_sensors) and their derivatives (n_times, n_sensors, n_params) at known states.

        `states` (n_times, n_states, 1 + n_params) hold the state and its derivatives, `inputs` are (n_times, n_inputs).
        """
        of_state, of_input = self._output
        n_params, n = self.rate_change.shape[1], len(self.scale)
        readings = of_state @ states
        values, slopes = readings[..., 0] + inputs @ of_input.T, readings[..., 1:]
        fast = np.flatnonzero(self.model.orders == 2)
        if len(fast):
            seen = self.model.sensor_columns[:, fast].T @ self.shapes
            wide = np.concatenate([self.rate_change[n:], self.coupling_change[n:]], axis=2)
            known = np.concatenate([states[..., 0], inputs], axis=1)
            pushed = seen @ (wide.reshape(-1, wide.shape[2]) @ known.T).reshape(n, -1)
            slopes[:, fast] += np.moveaxis(pushed.reshape(len(fast), n_params, -1), 2, 0)
        return values, slopes


def require_viscous(structure: Structure, unknown: Parameters) -> None:
    """Raise `InputError` for friction, loss factors or measured FRFs, which have no linear equation in time."""
    structure.require_scaled_modes("histories")
    require_matrices_in_time(structure, unknown)


@dataclass(frozen=True, eq=False)
class InputHold:
    """Input of a structure as the output of a linear system of its own.

    Parameters
    ----------
    force : {"first", "zero"} or Oscillation
    n_loads : int
        Number of forces, or of supports whose accelerations take their place.
    moves_supports : bool
        True if supports drive; they are at rest at the start, from where displacements and velocities count.
    step : float
        Time between samples, s.
    gap : float
        Time from the start to the first sample, s.
    start : float
        Time of the start, s.
    """

    force: Hold | Oscillation
    n_loads: int
    moves_supports: bool
    step: float
    gap: float
    start: float

    @cached_property
    def generator(self) -> FloatArray:
        """System matrix (n_states, n_states), 1/s, of the equation whose state gives the inputs between samples.

        The state is all forces, then their changes over a step (first-order hold) or their quadratures (oscillation).
        Under driven supports it is accelerations, their changes over a step, velocities over a step and displacements
        over its square.
        """
        eye = np.eye(self.n_loads)
        if self.moves_supports:
            rate = np.zeros((4, 4))
            rate[0, 1] = rate[2, 0] = rate[3, 2] = 1.0
            return np.kron(rate, eye) / self.step
        if isinstance(self.force, Oscillation):
            return self.force.omega * np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), eye)
        if self.force == "zero":
            return np.zeros((self.n_loads, self.n_loads))
        return np.kron(np.array([[0.0, 1.0], [0.0, 0.0]]), eye) / self.step

    @property
    def oscillates(self) -> bool:
        return isinstance(self.force, Oscillation)

    def times(self, n_times: int) -> FloatArray:
        """Instants in s of the `n_times` samples, after the start if it precedes them: (n_times,) or (n_times + 1,)."""
        samples = self.start + self.gap + self.step * np.arange(n_times)
        return np.concatenate([[self.start], samples]) if self.gap > 0 else samples

    def oscillation(self, n_times: int) -> FloatArray:
        """State of the oscillating force at the start and end of each step, (n_steps + 1, n_states, n_force_values).

        It is for unit amplitudes: all cosines, then all sines if they are free. The state is forces, then their
        quadratures. `n_times` is the number of samples.
        """
        assert isinstance(self.force, Oscillation)
        time, eye = self.times(n_times), np.eye(self.n_loads)
        c, s = np.cos(self.force.omega * time), np.sin(self.force.omega * time)
        cosine = np.kron(np.stack([c, -s], axis=1)[..., None], eye)
        if not self.force.sine:
            return cosine
        return np.concatenate([cosine, np.kron(np.stack([s, c], axis=1)[..., None], eye)], axis=2)

    def waveforms(self, n_times: int) -> FloatArray:
        """Force samples for unit amplitudes of an oscillation, (n_times, n_loads, n_force_values)."""
        return self.oscillation(n_times)[-n_times:, : self.n_loads]

    def force_values(self, samples: FloatArray) -> FloatArray:
        """The force as the simulation takes it: `samples` (n_times, n_loads), or the amplitudes of an oscillation.

        The amplitudes (n_force_values,), cosines and then sines, are fitted to the samples by least squares.
        """
        if not self.oscillates:
            return samples
        waveforms = self.waveforms(len(samples))
        wide = waveforms.reshape(-1, waveforms.shape[2])
        return np.asarray(np.linalg.lstsq(wide, samples.ravel(), rcond=None)[0])

    def inputs(self, force: FloatArray, n_times: int) -> FloatArray:
        """Input state at the start and at the end of each step, (n_steps + 1, n_inputs), in the order of `generator`.

        `force` holds samples (n_times, n_loads), or amplitudes (n_force_values,) of an oscillation, with which
        `n_times`, the number of samples, counts. After the last sample a first-order hold stays constant.
        """
        if self.oscillates:
            return self.oscillation(n_times) @ force
        slope = np.diff(force, axis=0, append=force[-1:]) * (self.force == "first")
        if self.moves_supports:
            velocity = _summed(force + slope / 2)
            return np.concatenate([force, slope, velocity, _summed(velocity + force / 2 + slope / 6)], axis=1)
        return force if self.force == "zero" else np.concatenate([force, slope], axis=1)

    def force_matrix(self, mass: FloatArray, damping: FloatArray, stiffness: FloatArray) -> FloatArray:
        """Modal forces per unit of each input state, (..., n_inputs), where supports move.

        The arguments are the matrices times unit motions of the supports, (..., n_loads) each.
        """
        return -np.concatenate([mass, 0 * mass, damping * self.step, stiffness * self.step**2], axis=-1)


def _summed(rates: FloatArray) -> FloatArray:
    """Sum of the rates before each sample, (n_times, n)."""
    return np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(rates[:-1], axis=0)])

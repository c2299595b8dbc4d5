"""Motion of modes under known and unknown forces, as state equations from sample to sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, IntArray
from structid.prediction.poles import ReducedMatrices
from structid.prediction.sensing.forces import ForceModel, ForceProcess, combine_forces
from structid.prediction.sensing.setup import SensingSetup

#: Variance, in units of a state's own size, by which every modal state moves at random in a time 1 / reference: so small that it
#: shows nowhere, so that no state is known without error and the equations for the steady gains have a solution.
_STRAY = 1e-10
#: Size of modal speeds, in sqrt(kg) m/s, where no unknown force gives one.
_SPEED = 1e-6


@dataclass(frozen=True, eq=False)
class StateEquations:
    """z' = transition z + entry (f_k, f_{k+1}) + noise; asked = wanted z + wanted_direct f.

    Sensors read reading z + direct f, in standard deviations of their noise; the last rows of `wanted` are the unknown forces.
    `unmoved` is the covariance of what is asked that moves no mode, so that no reading tells it: (n_asked, n_asked).
    `n_combined` is the number of unknown forces that move the modes independently.
    """

    transition: FloatArray
    entry: FloatArray
    noise: FloatArray
    reading: FloatArray
    direct: FloatArray
    wanted: FloatArray
    wanted_direct: FloatArray
    unmoved: FloatArray
    n_combined: int


def state_equations(setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess) -> StateEquations:
    """State equations from sample to sample; states are modal displacements, modal speeds and those of unknown forces.

    They hold the transition, the effect of known forces at both ends of a step, the covariance of the noise, and the
    readings of the sensors (in standard deviations of their noise) and of what is asked: wanted outputs, left-out
    sensors, unknown forces. Forces that move the structure alike are combined; each independent combination has its
    states. States are in scaled units. The inputs of `reduced` are the known forces, then the unknown ones, each of
    which is `process`.
    """
    n, n_known = len(reduced.omega), reduced.inputs.shape[1] - setup.n_forces
    known = reduced.inputs[:, :n_known]
    unknown, parts_of_forces = combine_forces(reduced.inputs[:, n_known:])
    n_forces = unknown.shape[1]
    force, std = ForceModel.of(process, setup.rate if setup.is_filtered else None), process.std
    n_each = len(force.output)
    step, size = 1 / setup.rate, 2 * n + n_forces * n_each
    elastic = reduced.omega[~reduced.is_rigid & (reduced.omega > 0)]
    reference = max(float(elastic.min(initial=np.inf)) if len(elastic) else 0.0, float(-force.dynamics[0, 0]))
    speed = max(float(np.abs(unknown).max(initial=0.0)) * std / reference, _SPEED)
    scales = speed / np.maximum(reduced.omega, reference), np.full(n, speed), np.full(n_forces * n_each, std)
    units = np.concatenate(scales)
    pushing = np.kron(np.eye(n_forces), force.output)  # forces from their states
    dynamics = np.zeros((size, size))
    dynamics[:n, n : 2 * n] = np.eye(n)
    dynamics[n : 2 * n, :n], dynamics[n : 2 * n, n : 2 * n] = (
        -np.diag(reduced.omega**2),
        -reduced.viscous_equivalent(),
    )
    dynamics[n : 2 * n, 2 * n :] = unknown @ pushing
    dynamics[2 * n :, 2 * n :] = np.kron(np.eye(n_forces), force.dynamics)
    acceleration = dynamics[n : 2 * n]
    n_sensors, n_left = len(setup.channels.sensors), len(setup.channels.left)
    orders = np.array([*setup.channels.derivatives, *setup.channels.left_derivatives])
    rows, direct = _output_matrices(reduced.outputs[: len(orders)], orders, acceleration, known)
    groups = np.split(reduced.outputs[len(orders) :], len(setup.read.orders))
    asked, asked_direct = np.zeros((setup.read.n_rows, size)), np.zeros((setup.read.n_rows, n_known))
    for order, group in zip(setup.read.orders, groups, strict=True):
        parts = _output_matrices(group, np.full(len(group), order), acceleration, known)
        asked, asked_direct = asked + parts[0], asked_direct + parts[1]
    left = slice(n_sensors, n_sensors + n_left)
    forces = np.hstack([np.zeros((setup.n_forces, 2 * n)), parts_of_forces @ pushing])
    wanted = np.vstack([asked, rows[left], forces]) * units
    wanted_direct = np.vstack([asked_direct, direct[left], np.zeros((setup.n_forces, n_known))])
    unmoved = np.zeros((len(wanted), len(wanted)))
    among_forces = slice(len(wanted) - setup.n_forces, None)
    unmoved[among_forces, among_forces] = std**2 * (np.eye(setup.n_forces) - parts_of_forces @ parts_of_forces.T)
    dynamics = dynamics * units / units[:, None]
    random = np.diag(
        np.full(size, _STRAY * reference) + np.concatenate([np.zeros(2 * n), np.tile(force.noise, n_forces)])
    )
    wide = np.block([[-dynamics, random], [np.zeros_like(dynamics), dynamics.T]]) * step
    held = np.zeros((size + 2 * n_known,) * 2)
    held[:size, :size], held[n : 2 * n, size : size + n_known] = dynamics * step, known * step / speed
    held[size : size + n_known, size + n_known :] = np.eye(n_known)
    transition, constant, rising = np.split(linalg.expm(held)[:size], [size, size + n_known], axis=1)
    noise = transition @ linalg.expm(wide)[:size, size:]
    deviation = np.sqrt(setup.channels.variance)[:, None]
    return StateEquations(
        transition,
        np.hstack([constant - rising, rising]),
        symmetric(noise),
        rows[:n_sensors] * units / deviation,
        direct[:n_sensors] / deviation,
        wanted,
        wanted_direct,
        unmoved,
        n_forces,
    )


def stationary_covariance(system: StateEquations, noise: FloatArray, n_samples: int) -> FloatArray:
    """Stationary covariance (n_states, n_states) of the state under a `noise` covariance (n_states, n_states) per sample.

    Motions that last longer than the record of `n_samples` fade over its length, so that those of a free structure are finite.
    """
    lasting = float(np.abs(np.linalg.eigvals(system.transition)).max())
    fade = 1.0 if lasting < 1 - 0.1 / n_samples else 1 - 1 / n_samples
    return np.asarray(linalg.solve_discrete_lyapunov(fade * system.transition, noise))


def _output_matrices(
    outputs: FloatArray, orders: IntArray, acceleration: FloatArray, forces: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Matrices of outputs over states, (n_outputs, n_states), and over known forces, (n_outputs, n_known).

    `outputs` (n_outputs, n_modes) read modal displacements, or their derivatives of `orders` (0, 1 or 2; (n_outputs,)).
    `acceleration` (n_modes, n_states) gives modal accelerations from states, `forces` (n_modes, n_known) those by known forces.
    """
    n = outputs.shape[1]
    rows, direct = np.zeros((len(orders), acceleration.shape[1])), np.zeros((len(orders), forces.shape[1]))
    for order in (0, 1):
        rows[orders == order, order * n : (order + 1) * n] = outputs[orders == order]
    rows[orders == 2], direct[orders == 2] = outputs[orders == 2] @ acceleration, outputs[orders == 2] @ forces
    return rows, direct


def symmetric(matrix: FloatArray) -> FloatArray:
    """A matrix that is symmetric but for rounding, made so."""
    return np.asarray((matrix + matrix.T) / 2)

"""Motion of modes under known and unknown forces, as state equations from sample to sample.

A `SensingSetup` has the channels of a record by role and the outputs that are asked of it; each unknown force is a
`ForceProcess` with equations of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg, signal

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import Dof
from structid.core.errors import InputError, NoAnswerError
from structid.fem import Structure
from structid.prediction.poles import ReducedMatrices
from structid.prediction.recovery import OutputMap
from structid.prediction.sensing.innovations import ASSUMED_NOISE
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES


@dataclass(frozen=True, eq=False)
class Channels:
    """Channels of a record by role: known forces, sensors that are used, sensors that are left out.

    Attributes
    ----------
    loads, sensors, left : tuple of Dof
    known, measured, left_values : (n_times, n) float arrays
    derivatives, left_derivatives : tuple of int
        0 to 2 of displacement to acceleration.
    variance, left_variance : (n,) float arrays
        Of the noise of each sensor.
    has_stated_noise : bool
        False where the record states none, and a part of the size of each sensor is taken.
    """

    loads: tuple[Dof, ...]
    sensors: tuple[Dof, ...]
    left: tuple[Dof, ...]
    known: FloatArray
    measured: FloatArray
    left_values: FloatArray
    derivatives: tuple[int, ...]
    left_derivatives: tuple[int, ...]
    variance: FloatArray
    left_variance: FloatArray
    has_stated_noise: bool

    @property
    def readings(self) -> FloatArray:
        """Readings of the used sensors in standard deviations of their noise, (n_times, n_used)."""
        return self.measured / np.sqrt(self.variance)

    @classmethod
    def of_record(cls, record: TimeRecord, left_out: tuple[Dof, ...]) -> Channels:
        """Channels of a record by role: known forces, sensors that are used, and those in `left_out`, only compared.

        Where the record states no noise, 1 % of the standard deviation of each sensor is taken.

        `InputError` if `left_out` names a force or no channel, the record holds other quantities or no motion, or a
        sensor has no noise.
        """
        quantities = record.quantities
        pushed = [
            str(dof)
            for dof, what in zip(record.channels, quantities, strict=True)
            if what == "force" and dof in left_out
        ]
        if pushed:
            raise InputError(
                f"`leave_out` names {pushed[0]}, a force of the record; name sensors, whose motion is compared"
            )
        other = [str(quantity) for quantity in quantities if quantity not in (*MOTION_DERIVATIVES, "force")]
        if other:
            raise InputError(f"the record holds {other[0]}; motion at other places takes forces and motions alone")
        missing = [str(dof) for dof in left_out if dof not in record.channels]
        if missing:
            raise InputError(f"`leave_out` names {missing[0]}, which the record does not have")
        variance = record.variance
        if variance is None:
            variance = (ASSUMED_NOISE * record.values.std(axis=0)) ** 2
        rows = range(len(record.channels))
        loads = [i for i in rows if quantities[i] == "force"]
        used = [i for i in rows if quantities[i] != "force" and record.channels[i] not in left_out]
        out = [i for i in rows if quantities[i] != "force" and record.channels[i] in left_out]
        if not used:
            raise InputError(
                "the record has no motion to sense from; use one with displacements, velocities or accelerations"
            )
        silent = [i for i in (*used, *out) if not np.asarray(variance)[i] > 0]
        if silent:
            what = "states no noise and reads a constant" if record.variance is None else "has a noise of 0"
            raise InputError(
                f"sensor {record.channels[silent[0]]} {what}; take it out of the record, or state its noise"
            )

        def dofs(index: list[int]) -> tuple[Dof, ...]:
            return tuple(record.channels[i] for i in index)

        def order(index: list[int]) -> tuple[int, ...]:
            return tuple(MOTION_DERIVATIVES[quantities[i]] for i in index)

        return cls(
            dofs(loads), dofs(used), dofs(out),
            record.values[:, loads], record.values[:, used], record.values[:, out],
            order(used), order(out), np.asarray(variance)[used], np.asarray(variance)[out],
            record.variance is not None,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SensingSetup:
    """A record by channels, and the outputs that are asked of it.

    Attributes
    ----------
    channels : Channels
    driving : (n_times, n_known) float array
        The known forces between samples, see `band_limited_loads`.
    n_forces : int
        Unknown forces, the last inputs.
    is_filtered : bool
        Whether the record went through a filter against aliasing.
    rate : float
        Samples per second.
    read : OutputMap
        Outputs that are asked for, behind used and left-out sensors among those of the model.
    is_distributed : bool
        Whether more independent unknown forces act than sensors are used.
    """

    channels: Channels
    driving: FloatArray
    n_forces: int
    is_filtered: bool
    rate: float
    read: OutputMap
    is_distributed: bool


#: Filter against aliasing: elliptic, order, ripple and attenuation in dB, passing up to half the sampling rate. It must be steep:
#: lightly damped modes just above ring in whatever it lets through. Deviations of accelerations are those of the errors behind a
#: filter that halves what is at half the sampling rate, and wider than the errors behind one that ends before.
_FILTER = 9, 0.1, 80.0
#: Rate at which each low-pass of a force forgets its input, over one by the correlation time, for each order that is tried: the
#: correlation time is the integral of the correlation from 0 on (without a frequency), which is exp(-|t| / T) for order 1.
_FADING = {1: 1.0, 2: 2.0, 3: 8 / 3}
HIGHEST_ORDER = max(_FADING)
#: Part of the sum of squares of what forces move, below which a combination of them moves nothing.
_DEPENDENT = 1e-10


@dataclass(frozen=True)
class UnknownForces:
    """Forces that act and were not measured: independent, stationary, with the covariance std^2 exp(-|t| / correlation_time).

    Parameters
    ----------
    dofs : sequence of Dof or str
        Where they act.
    correlation_time : float, optional
        s; short for wind or traffic, long for what changes slowly. By default the shortest one under which the record is as
        likely, but for chance, as under any; where that does not fit, and neither it nor `std` is stated, the spectrum of the
        forces may fall more steeply, as behind two or three low-passes of first order, and lie about the likeliest frequency:
        the correlation time is then the integral of the correlation, or of its envelope, from 0 on.
    std : float, optional
        N; the one under which the record is likeliest by default.
    """

    dofs: Sequence[Dof | str]
    correlation_time: float | None = None
    std: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` where no force is named, or for a correlation time or standard deviation that is not positive."""
        if not len(self.dofs):
            raise InputError(
                "`dofs` of unknown forces must name where they act, got none; leave `unknown` out if there are none"
            )
        if self.correlation_time is not None and not (np.isfinite(self.correlation_time) and self.correlation_time > 0):
            raise InputError(f"`correlation_time` must be greater than 0 s, got {self.correlation_time:g}")
        if self.std is not None and not (np.isfinite(self.std) and self.std > 0):
            raise InputError(f"`std` of unknown forces must be greater than 0 N, got {self.std:g}")


@dataclass(frozen=True)
class ForceProcess:
    """The stationary process that each unknown force is taken to be, independent of the others.

    Attributes
    ----------
    correlation_time : float
        s, the integral of the correlation, or of its envelope, from 0 on.
    std : float
        Standard deviation, N.
    frequency : float
        Hz, about which the spectrum lies; 0 where it falls from 0 Hz on.
    order : int
        Far from its middle the spectrum falls with the frequency to the power -2 order; 1 to `HIGHEST_ORDER`.
    """

    correlation_time: float
    std: float
    frequency: float = 0.0
    order: int = 1


@cache
def _aliasing_filter(rate: float | None) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Filter against aliasing for a sampling `rate` in Hz, as (a, b, c, d) of x' = a x + b u and y = c x + d u.

    It is an elliptic low-pass of order n = 9, with 0.1 dB of ripple up to its corner at half the rate and 80 dB of
    attenuation beyond; a (n, n) and b (n,) are in 1/s, c is (n,) and d a number. Without a rate nothing is filtered: n
    is 0 and d is 1.
    """
    if rate is None:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    corner = np.pi * rate
    a, b, c, d = signal.zpk2ss(*signal.ellip(*_FILTER, 1.0, analog=True, output="zpk"))
    return corner * a, corner * b[:, 0], c[0], float(d[0, 0])


@dataclass(frozen=True, eq=False)
class ForceModel:
    """An unknown force of unit variance: z' = dynamics z + white noise of density `noise`; force = output z.

    Attributes
    ----------
    dynamics : (n, n) float array
        1/s. Low-passes of first order in a row, each of one state, or of two where there is a frequency; the last one is the
        force. A filter against aliasing follows.
    noise : (n,) float array
        Square of each state per second.
    output : (n,) float array
    """

    dynamics: FloatArray
    noise: FloatArray
    output: FloatArray

    @classmethod
    def of(cls, process: ForceProcess, filtered_rate: float | None) -> ForceModel:
        """Model of a force of the spectrum of `process`, of unit variance: states, white noise behind them, output.

        The force is white noise behind low-passes of first order in a row, about a frequency if the process has one,
        and as a record filtered for the sampling rate `filtered_rate`, Hz, holds it; None means without filter.
        `NoAnswerError` if the force is so near to a sine that its covariance loses its digits.
        """
        frequency, order = process.frequency, process.order
        inner, entry, output, direct = _aliasing_filter(filtered_rate)
        n_each = 2 if frequency else 1
        n_own, fade = order * n_each, _FADING[order] / process.correlation_time
        turning = 2 * np.pi * frequency * np.array([[0.0, -1.0], [1.0, 0.0]])[:n_each, :n_each]
        stage = turning - fade * np.eye(n_each)
        dynamics = np.zeros((n_own + len(inner),) * 2)
        dynamics[:n_own, :n_own] = np.kron(np.eye(order), stage) + fade * np.kron(np.eye(order, k=-1), np.eye(n_each))
        dynamics[n_own:, n_own - n_each], dynamics[n_own:, n_own:] = entry, inner
        white = np.where(np.arange(len(dynamics)) < n_each, 2 * fade, 0.0)
        covariance = linalg.solve_continuous_lyapunov(dynamics, -np.diag(white))
        if not np.diag(covariance).min() > 0:
            raise NoAnswerError(
                "the unknown forces are so near to a sine that their covariance has lost its digits; state a shorter"
                " `correlation_time`"
            )
        size = np.sqrt(np.diag(covariance))
        read = np.concatenate([np.zeros(n_own - n_each), [direct], np.zeros(n_each - 1), output])
        scaled = dynamics * size / size[:, None]  # states of unit variance, for the digits of the filter
        return cls(scaled, white / size**2, read * size / np.sqrt(read @ covariance @ read))


def count_independent_forces(structure: Structure, forces: Sequence[Dof]) -> int:
    """Number of the unknown forces that move a structure independently of each other; those on one rigid part may not.

    It is the rank of their columns over the degrees of freedom; 0 without `forces`.
    """
    if not forces:
        return 0
    columns = structure.selection(forces)
    products = (columns.T @ columns).toarray()
    return int(np.linalg.matrix_rank(products, tol=_DEPENDENT * float(np.trace(products)), hermitian=True))


def combine_forces(inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fewest independent forces of one spectrum that do to the modes what `inputs` of that spectrum do.

    `inputs` (n_modes, n_forces) are the modal forces of unit forces. Returns the modal forces of each combination,
    (n_modes, n_combined), and the part of each in the forces, (n_forces, n_combined). Combinations that move no mode
    are left out; `inputs` and the identity are returned if all forces are independent.
    """
    if not inputs.size:
        return inputs, np.eye(inputs.shape[1])
    modal, sizes, parts = np.linalg.svd(inputs, full_matrices=False)
    n_combined = int((sizes > np.sqrt(_DEPENDENT) * sizes[0]).sum())
    if n_combined == inputs.shape[1]:
        return inputs, np.eye(n_combined)
    return modal[:, :n_combined] * sizes[:n_combined], parts[:n_combined].T


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
    `n_combined` is the number of unknown forces that move the modes independently. With states in scaled units,
    `transition` and the covariance `noise` of a step are (n_states, n_states), `entry` (n_states, 2 n_known).
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
    """The symmetric part of a `matrix` (n, n) that is symmetric but for rounding."""
    return np.asarray((matrix + matrix.T) / 2)

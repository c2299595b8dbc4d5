"""Motion where no sensor is, and forces that nobody measured, from a record of other places: a Kalman smoother of modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray
from structid.core.display import Overview, Shown, format_number, join_words
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError, NoAnswerError
from structid.dynamics.exact_discretization import stepped
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.poles import ReducedMatrices, Sides, reduce_structure, reduction_basis
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES

#: Orders of magnitude about a first guess of the unknown forces that are tried, and how many sizes.
_DECADES, _SIZES = 2.0, 17
#: Part of the variance of a force before the record that remains, above which the record says next to nothing of it.
_UNSEEN = 0.9
#: Part of the noise of a sensor that is put on top of what the record states, where it states none.
_NOISE = 0.01
#: Part of its size by which a state moves at random in a time of the slowest, and modal speed where nothing unknown acts.
_STRAY, _SPEED = 1e-10, 1e-6


@dataclass(frozen=True)
class UnknownForces:
    """Forces that act and were not measured: independent, stationary, with the covariance std^2 exp(-|t| / correlation_time).

    Parameters
    ----------
    dofs : sequence of Dof or str
        Where they act.
    correlation_time : float
        s; short for wind or traffic, long for what changes slowly.
    std : float, optional
        N; the one under which the record is likeliest by default.
    """

    dofs: Sequence[Dof | str]
    correlation_time: float
    std: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` for a correlation time or a standard deviation that is not positive."""
        if not (np.isfinite(self.correlation_time) and self.correlation_time > 0):
            raise InputError(f"`correlation_time` must be greater than 0 s, got {self.correlation_time:g}")
        if self.std is not None and not (np.isfinite(self.std) and self.std > 0):
            raise InputError(f"`std` of unknown forces must be greater than 0 N, got {self.std:g}")


@dataclass(frozen=True, eq=False, repr=False)
class SensedMotion(Shown):
    """Motion and forces during a record, each with its standard deviation.

    Attributes
    ----------
    time : (n_times,) float array
        s.
    outputs : tuple of Dof
    motion : {"displacement", "velocity", "acceleration"}
    values, std : (n_times, n_outputs) float arrays
        SI units.
    force_dofs : tuple of Dof
    forces, force_std : (n_times, n_forces) float arrays
        The unknown forces, N or N m.
    prior_std : float
        Standard deviation of the unknown forces before the record; NaN where there are none.
    checks : tuple of (Dof, float)
        Sensors that were left out, and the root mean square of measured less sensed over the stated deviation: 1 is right.
    words : tuple of str
        What the record does not tell.
    """

    time: FloatArray
    outputs: tuple[Dof, ...]
    motion: str
    values: FloatArray
    std: FloatArray
    force_dofs: tuple[Dof, ...]
    forces: FloatArray
    force_std: FloatArray
    prior_std: float
    checks: tuple[tuple[Dof, float], ...] = ()
    words: tuple[str, ...] = ()

    def overview(self) -> Overview:
        """A table with the size and the standard deviation of each output and force, and checks of left-out sensors."""
        rows = [
            (
                str(dof),
                format_number(float(np.sqrt(np.mean(value**2))), 3),
                format_number(float(np.sqrt(np.mean(std**2))), 2),
            )
            for dof, value, std in zip(
                (*self.outputs, *self.force_dofs),
                (*self.values.T, *self.forces.T),
                (*self.std.T, *self.force_std.T),
                strict=True,
            )
        ]
        told = "".join(f"; {dof}, left out: {format_number(z, 3)} times its stated deviation" for dof, z in self.checks)
        return Overview(
            f"{self.motion} at {join_words(self.outputs)} over {len(self.time)} samples{told}",
            ("where", "rms", "± rms"),
            rows,
        )


def sense(
    model: IdentifiedModel,
    record: TimeRecord,
    outputs: Sequence[Dof | str],
    motion: str = "displacement",
    unknown: UnknownForces | None = None,
    leave_out: Sequence[Dof | str] = (),
    n_draws: int = 20,
    seed: int = 0,
) -> SensedMotion:
    """Motion at any degree of freedom during a record, whose forces may be known, partly known or unknown.

    A Kalman filter with steady gains and a Rauch-Tung-Striebel smoother run over the modes up to half the sampling rate, with each
    unknown force as a state of first order. They are run again for models within the uncertainty: the deviation includes both.

    Parameters
    ----------
    model : IdentifiedModel
    record : TimeRecord
        Forces (quantity ``force``) are taken as known, motions as measured, with the record's noise; where it states none, 1 % of
        the size of each sensor is taken.
    outputs : sequence of Dof or str
        Where motion is wanted.
    motion : {"displacement", "velocity", "acceleration"}
    unknown : UnknownForces, optional
        Forces that were not measured.
    leave_out : sequence of Dof or str
        Sensors that are not used, but compared with what is sensed there.
    n_draws : int
        Models within the uncertainty; 0 takes the identified model as exact.
    seed : int

    Returns
    -------
    SensedMotion

    Raises
    ------
    InputError
        If a place is not part of the structure, or there are more unknown forces than sensors.
    NoAnswerError
        If the record cannot tell the motion: nothing holds the structure and accelerations alone are measured.

    References
    ----------
    Rauch, Tung and Striebel (1965), AIAA J. 3, 1445-1450; Lourens et al. (2012), Mech. Syst. Signal Process. 27, 446-460 (forces as
    states); Van Loan (1978), IEEE Trans. Automatic Control 23, 395-404 (noise between samples).
    """
    if motion not in MOTION_DERIVATIVES:
        raise InputError(f"`motion` must be one of {', '.join(MOTION_DERIVATIVES)}, got {motion!r}")
    wanted, left = parse_dofs(outputs), parse_dofs(leave_out)
    channels = _Channels.of_record(record, left)
    forces = () if unknown is None else parse_dofs(unknown.dofs)
    if len(forces) > len(channels.sensors):
        raise InputError(
            f"{len(forces)} unknown forces cannot be told by {len(channels.sensors)} sensors; name fewer, or use more sensors"
        )
    structure = model.structure
    structure.require_modes("motion at other places")
    sides = Sides(
        structure.selection((*channels.sensors, *wanted, *channels.left)),
        structure.selection((*channels.loads, *forces)),
    )
    rate = record.sampling_rate
    basis = reduction_basis(structure, [model.values], sides, rate / len(record.values), rate / 2)
    correlation_time = 1.0 if unknown is None else unknown.correlation_time
    smoother = _Smoother(channels, len(forces), correlation_time, rate, MOTION_DERIVATIVES[motion], len(wanted))
    reduced = reduce_structure(structure, model.values, basis, sides)
    if reduced.is_rigid.any() and 0 not in channels.derivatives:
        raise NoAnswerError(
            "nothing holds the structure, so that velocities and accelerations do not tell where it is; measure a displacement too"
        )
    std = 0.0 if unknown is None else (unknown.std or smoother.likeliest_std(reduced))
    nominal = smoother.run(reduced, std)
    draws = [
        smoother.run(reduce_structure(structure, model.parameters.values(physical), basis, sides), std)
        for physical in (model.draw_parameters(n_draws, np.random.default_rng(seed)) if n_draws else ())
    ]
    spread = sum(((draw.mean - nominal.mean) ** 2 for draw in draws), np.zeros_like(nominal.mean)) / max(len(draws), 1)
    deviation = np.sqrt(nominal.variance + spread)
    n_wanted, n_left = len(wanted), len(channels.left)
    seen = slice(n_wanted, n_wanted + n_left)
    error = (channels.left_values - nominal.mean[:, seen]) ** 2 / (deviation[:, seen] ** 2 + channels.left_variance)
    remaining = nominal.variance[n_wanted + n_left :] / std**2 if forces else np.zeros(0)
    blind = [str(dof) for dof, part in zip(forces, remaining, strict=True) if part > _UNSEEN]
    words = (
        (f"the record says next to nothing of the force at {join_words(blind)}: no sensor moves with it",)
        if blind
        else ()
    )
    return SensedMotion(
        np.arange(len(record.values)) / rate,
        wanted,
        motion,
        nominal.mean[:, :n_wanted],
        deviation[:, :n_wanted],
        forces,
        nominal.mean[:, n_wanted + n_left :],
        deviation[:, n_wanted + n_left :],
        std if forces else float("nan"),
        tuple(zip(channels.left, np.sqrt(error.mean(axis=0)).tolist(), strict=True)),
        words,
    )


@dataclass(frozen=True, eq=False)
class _Channels:
    """What a record holds: known forces, sensors that are used, and sensors that are left out.

    Attributes
    ----------
    loads, sensors, left : tuple of Dof
    known, measured, left_values : (n_times, n) float arrays
    derivatives, left_derivatives : tuple of int
        0 to 2 of displacement to acceleration.
    variance, left_variance : (n,) float arrays
        Of the noise of each sensor.
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

    @classmethod
    def of_record(cls, record: TimeRecord, left: tuple[Dof, ...]) -> _Channels:
        """Forces and sensors of a record, without the sensors in `left`, which are only compared."""
        quantities = record.quantities
        other = [str(quantity) for quantity in quantities if quantity not in (*MOTION_DERIVATIVES, "force")]
        if other:
            raise InputError(f"the record holds {other[0]}; motion at other places takes forces and motions alone")
        missing = [str(dof) for dof in left if dof not in record.channels]
        if missing:
            raise InputError(f"`leave_out` names {missing[0]}, which the record does not have")
        variance = record.variance
        if variance is None:
            variance = (_NOISE * record.values.std(axis=0)) ** 2
        rows = range(len(record.channels))
        loads = [i for i in rows if quantities[i] == "force"]
        used = [i for i in rows if quantities[i] != "force" and record.channels[i] not in left]
        out = [i for i in rows if quantities[i] != "force" and record.channels[i] in left]
        if not used:
            raise InputError(
                "the record has no motion to sense from; use one with displacements, velocities or accelerations"
            )

        def dofs(index: list[int]) -> tuple[Dof, ...]:
            return tuple(record.channels[i] for i in index)

        def order(index: list[int]) -> tuple[int, ...]:
            return tuple(MOTION_DERIVATIVES[quantities[i]] for i in index)

        return cls(
            dofs(loads), dofs(used), dofs(out),
            record.values[:, loads], record.values[:, used], record.values[:, out],
            order(used), order(out), np.asarray(variance)[used], np.asarray(variance)[out],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """Mean (n_times, n_outputs + n_forces) and variance (n_outputs + n_forces,) of what was asked for."""

    mean: FloatArray
    variance: FloatArray


@dataclass(frozen=True, eq=False)
class _StateSpace:
    """z' = transition z + entry (f_k, f_{k+1}) + noise; asked = wanted z + wanted_direct f.

    Sensors read reading z + direct f, in standard deviations of their noise; the last rows of `wanted` are the unknown forces.
    """

    transition: FloatArray
    entry: FloatArray
    noise: FloatArray
    reading: FloatArray
    direct: FloatArray
    wanted: FloatArray
    wanted_direct: FloatArray


@dataclass(frozen=True, eq=False)
class _Smoother:
    """A filter and smoother of modal states for one record.

    Attributes
    ----------
    channels : _Channels
    n_forces : int
        Unknown forces, the last inputs.
    correlation_time, rate : float
    derivatives : int
        Of the motion that is asked for at the first `n_wanted` outputs behind the sensors.
    n_wanted : int
    """

    channels: _Channels
    n_forces: int
    correlation_time: float
    rate: float
    derivatives: int
    n_wanted: int

    def run(self, reduced: ReducedMatrices, std: float) -> _Smoothed:
        """Smoothed motion and forces, where unknown forces have the standard deviation `std`, N."""
        system = self._system(reduced, std)
        predicted, gain, innovation = self._steady(system)
        before, after = self._filtered(system, gain)
        updated = predicted - gain @ innovation @ gain.T
        back = np.linalg.solve(predicted, system.transition @ updated).T
        drive = (after[:-1] - before[1:] @ back.T)[::-1]
        smoothed = stepped(back, drive, after[-1])[::-1]
        covariance = linalg.solve_discrete_lyapunov(back, updated - back @ predicted @ back.T)
        covariance = (covariance + covariance.T) / 2
        mean = smoothed @ system.wanted.T + self.channels.known @ system.wanted_direct.T
        variance = np.einsum("ij,jk,ik->i", system.wanted, covariance, system.wanted)
        return _Smoothed(mean, np.maximum(variance, 0.0))

    def likeliest_std(self, reduced: ReducedMatrices) -> float:
        """Standard deviation, N, of the unknown forces under which the record is likeliest."""
        size = self._first_std(reduced)
        tried = size * np.logspace(-_DECADES, _DECADES, _SIZES)
        likelihood = [self._log_likelihood(reduced, float(std)) for std in tried]
        best = int(np.argmax(likelihood))
        if best in (0, len(tried) - 1):
            return float(tried[best])
        left, middle, right = likelihood[best - 1 : best + 2]
        shift = 0.5 * (left - right) / (left - 2 * middle + right)
        return float(tried[best] * (tried[1] / tried[0]) ** np.clip(shift, -0.5, 0.5))

    def _first_std(self, reduced: ReducedMatrices) -> float:
        """A first guess of the unknown forces, N: they would make the sensors move as much as they do."""
        system = self._system(reduced, 1.0)
        stationary = linalg.solve_discrete_lyapunov(system.transition, system.noise)
        made = np.einsum("ij,jk,ik->i", system.reading, stationary, system.reading)
        return float(np.sqrt((self._measured.var(axis=0) / made).mean()))

    @property
    def _measured(self) -> FloatArray:
        """What the sensors that are used read, in standard deviations of their noise."""
        return self.channels.measured / np.sqrt(self.channels.variance)

    def _log_likelihood(self, reduced: ReducedMatrices, std: float) -> float:
        """Log-likelihood of the record, less a constant, where unknown forces have the standard deviation `std`, N."""
        system = self._system(reduced, std)
        _, gain, innovation = self._steady(system)
        before, _ = self._filtered(system, gain)
        error = self._measured - self.channels.known @ system.direct.T - before @ system.reading.T
        whitened = linalg.solve_triangular(np.linalg.cholesky(innovation), error.T, lower=True)
        return float(-0.5 * (whitened**2).sum() - 0.5 * len(error) * np.linalg.slogdet(innovation)[1])

    def _steady(self, system: _StateSpace) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Covariance of the predicted state, gain, and covariance of the innovations, all in the steady state."""
        noise = np.eye(len(self.channels.variance))
        try:
            predicted = linalg.solve_discrete_are(system.transition.T, system.reading.T, system.noise, noise)
        except (linalg.LinAlgError, ValueError) as error:
            raise NoAnswerError(
                "these sensors do not tell the motion: none of them sees one of the modes; measure more places"
            ) from error
        innovation = system.reading @ predicted @ system.reading.T + noise
        gain = np.linalg.solve(innovation, system.reading @ predicted).T
        return predicted, gain, innovation

    def _filtered(self, system: _StateSpace, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States before and after the reading of each sample, (n_times, n_states) each."""
        known = self.channels.known
        read = (self._measured - known @ system.direct.T) @ gain.T
        n = len(system.transition)
        keep = np.eye(n) - gain @ system.reading
        inputs = np.hstack([known[:-1], known[1:]]) @ system.entry.T
        drive = read[:-1] @ system.transition.T + inputs
        before = stepped(system.transition @ keep, drive, np.zeros(n))
        return before, before @ keep.T + read

    def _system(self, reduced: ReducedMatrices, std: float) -> _StateSpace:
        """The equations from sample to sample of modal displacements, speeds and unknown forces, in scaled units."""
        n, n_forces, n_known = len(reduced.omega), self.n_forces, reduced.inputs.shape[1] - self.n_forces
        step, size = 1 / self.rate, 2 * n + n_forces
        known, unknown = reduced.inputs[:, :n_known], reduced.inputs[:, n_known:]
        slowest = max(float(reduced.omega[reduced.omega > 0].min(initial=np.inf)), 1 / self.correlation_time)
        speed = max(float(np.abs(unknown).max(initial=0.0)) * std / slowest, _SPEED)
        units = np.concatenate([speed / np.maximum(reduced.omega, slowest), np.full(n, speed), np.full(n_forces, std)])
        rate = np.zeros((size, size))
        rate[:n, n : 2 * n] = np.eye(n)
        rate[n : 2 * n, :n], rate[n : 2 * n, n : 2 * n] = -np.diag(reduced.omega**2), -reduced.viscous_equivalent()
        rate[n : 2 * n, 2 * n :] = unknown
        rate[2 * n :, 2 * n :] = -np.eye(n_forces) / self.correlation_time
        n_sensors = len(self.channels.sensors)
        orders = (*self.channels.derivatives, *([self.derivatives] * self.n_wanted), *self.channels.left_derivatives)
        rows, direct = self._readings(reduced.outputs, orders, rate[n : 2 * n], known)
        wanted = np.vstack([rows[n_sensors:], np.eye(size)[2 * n :]]) * units
        wanted_direct = np.vstack([direct[n_sensors:], np.zeros((n_forces, n_known))])
        rate = rate * units / units[:, None]
        # what no unknown force drives moves a little all the same, so that every state can be told from its noise
        random = np.diag([_STRAY * slowest] * 2 * n + [2 / self.correlation_time] * n_forces)
        wide = np.block([[-rate, random], [np.zeros_like(rate), rate.T]]) * step
        power = linalg.expm(wide)
        transition = power[size:, size:].T
        noise = transition @ power[:size, size:]
        held = np.zeros((size + 2 * n_known,) * 2)
        held[:size, :size], held[n : 2 * n, size : size + n_known] = rate * step, known * step / speed
        held[size : size + n_known, size + n_known :] = np.eye(n_known)
        whole = linalg.expm(held)[:size]
        constant, rising = whole[:, size : size + n_known], whole[:, size + n_known :]
        deviation = np.sqrt(self.channels.variance)[:, None]
        return _StateSpace(
            transition,
            np.hstack([constant - rising, rising]),
            (noise + noise.T) / 2,
            rows[:n_sensors] * units / deviation,
            direct[:n_sensors] / deviation,
            wanted,
            wanted_direct,
        )

    @staticmethod
    def _readings(
        outputs: FloatArray, orders: tuple[int, ...], acceleration: FloatArray, known: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Matrices of outputs over states (n_outputs, n_states) and over known forces (n_outputs, n_known)."""
        n = outputs.shape[1]
        rows, direct = np.zeros((len(orders), acceleration.shape[1])), np.zeros((len(orders), known.shape[1]))
        for i, order in enumerate(orders):
            if order == 2:
                rows[i], direct[i] = outputs[i] @ acceleration, outputs[i] @ known
            else:
                rows[i, order * n : (order + 1) * n] = outputs[i]
        return rows, direct

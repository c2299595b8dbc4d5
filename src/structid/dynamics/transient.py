"""Exact motion of a linear structure: from rest under harmonic or sampled loads, and free from initial conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, sparse

from structid.core.arrays import FloatArray, require_finite, require_shape
from structid.core.errors import InputError, SingularModelError

Matrix: TypeAlias = sparse.sparray | np.ndarray


@dataclass(frozen=True, eq=False)
class Transient:
    """Motion at instants.

    Attributes
    ----------
    time : (n_times,) float array
        s.
    displacement, velocity, acceleration : (n_times, n_dofs) float arrays
    """

    time: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def harmonic_transient(
    mass: Matrix, stiffness: Matrix, load: ArrayLike, omega: float, time: ArrayLike, damping: Matrix | None = None
) -> Transient:
    """Response to load cos(omega t) of a structure at rest at t = 0.

    Without damping it is the modal sum in closed form: with a the natural and b the driving frequency,
    s = (a + b) / 2 and d = (a - b) / 2, a mode of unit mass under cos(b t) moves as
    (cos b t - cos a t) / (a^2 - b^2) = (sin s t / s) (sin d t / d) / 2, which holds for rigid-body modes and at
    resonance too. With damping of any form the load's oscillator joins the state, and the matrix exponential carries
    both from instant to instant.

    Parameters
    ----------
    mass, stiffness, damping : (n_dofs, n_dofs) arrays, sparse or dense
        Symmetric; mass positive definite. None for damping is none.
    load : (n_dofs,) array
        Amplitude, N or N m.
    omega : float
        rad/s.
    time : (n_times,) array
        Instants in s, not negative and increasing.

    Returns
    -------
    Transient
        Displacement, velocity and acceleration, (n_times, n_dofs) each, in SI units.

    Raises
    ------
    InputError
        If shapes or instants do not fit.
    SingularModelError
        If the mass matrix is not positive definite.
    """
    instants, amplitude = np.asarray(time, dtype=np.float64), np.asarray(load, dtype=np.float64)
    system = _modal_system(mass, stiffness, damping)
    require_shape("time", instants, (None,))
    require_finite("time", instants)
    if (instants < 0).any() or (np.diff(instants) <= 0).any():
        raise InputError("`time` must not be negative and must increase; the structure is at rest at 0 s")
    require_shape("load", amplitude, (len(system.shapes),), "one amplitude a degree of freedom")
    modal_load = system.shapes.T @ amplitude
    if system.damping is None:
        q, dq = _undamped(system.natural, modal_load, omega, instants)
    else:
        q, dq = _driven(system, modal_load, omega, instants)
    return system.motion(instants, q, dq, np.cos(omega * instants)[:, None] * amplitude)


def sampled_transient(
    mass: Matrix,
    stiffness: Matrix,
    loads: Matrix,
    signals: ArrayLike,
    sampling_rate: float,
    damping: Matrix | None = None,
) -> Transient:
    """Response from rest to loads that vary linearly between their samples (first-order hold), exact at the samples.

    Parameters
    ----------
    mass, stiffness, damping : (n_dofs, n_dofs) arrays, sparse or dense
        Symmetric; mass positive definite. None for damping is none.
    loads : (n_dofs, n_loads) array
        Force on each degree of freedom per unit of each signal.
    signals : (n_times, n_loads) array
        N or N m, the first sample at t = 0.
    sampling_rate : float
        Samples per second.

    Returns
    -------
    Transient
        Displacement, velocity and acceleration at the samples, (n_times, n_dofs) each, in SI units.

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, or the sampling rate is not positive.
    SingularModelError
        If the mass matrix is not positive definite.

    References
    ----------
    Van Loan (1978), IEEE Trans. Automatic Control 23, 395-404: integrals of the matrix exponential.
    """
    system = _modal_system(mass, stiffness, damping)
    samples = np.asarray(signals, dtype=np.float64)
    where = _dense(loads)
    require_shape("loads", where, (len(system.shapes), None))
    require_shape("signals", samples, (None, where.shape[1]), "one column a load")
    require_finite("signals", samples)
    if not np.isfinite(sampling_rate) or sampling_rate <= 0:
        raise InputError(f"`sampling_rate` must be positive, got {sampling_rate!r} Hz")
    n, n_loads, step = len(system.natural), where.shape[1], 1 / sampling_rate
    state_matrix, scale = system.state_matrix()
    wide = np.zeros((2 * n + 2 * n_loads,) * 2)
    wide[: 2 * n, : 2 * n] = state_matrix * step
    wide[n : 2 * n, 2 * n : 2 * n + n_loads] = system.shapes.T @ where * step
    wide[2 * n : 2 * n + n_loads, 2 * n + n_loads :] = np.eye(n_loads)
    power = linalg.expm(wide)[: 2 * n]
    inputs = (
        samples[:-1] @ power[:, 2 * n : 2 * n + n_loads].T + np.diff(samples, axis=0) @ power[:, 2 * n + n_loads :].T
    )
    states = np.zeros((len(samples), 2 * n))
    for k in range(len(samples) - 1):
        states[k + 1] = power[:, : 2 * n] @ states[k] + inputs[k]
    return system.motion(np.arange(len(samples)) * step, states[:, :n] / scale, states[:, n:], samples @ where.T)


def _dense(matrix: Matrix) -> FloatArray:
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray(), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _ModalSystem:
    """Matrices, natural frequencies in rad/s and mass-normalized shapes (n_dofs, n_dofs)."""

    mass: FloatArray
    stiffness: FloatArray
    damping: FloatArray | None
    natural: FloatArray
    shapes: FloatArray

    def motion(self, time: FloatArray, q: FloatArray, dq: FloatArray, force: FloatArray) -> Transient:
        """Motion of the structure at `time` (s) from modal displacement `q` and velocity `dq`, (n_times, n_modes).

        `force` (n_times, n_dofs) are the loads. The acceleration follows from the equations of motion, so that they
        hold to rounding.
        """
        displacement, velocity = q @ self.shapes.T, dq @ self.shapes.T
        inertia = force - displacement @ self.stiffness
        if self.damping is not None:
            inertia -= velocity @ self.damping
        return Transient(time, displacement, velocity, linalg.solve(self.mass, inertia.T, assume_a="pos").T)

    def state_matrix(self) -> tuple[FloatArray, FloatArray]:
        """Matrix A of x' = A x for the state x = [scale q; q'], (2 n_modes, 2 n_modes), and the scale, (n_modes,).

        q are modal displacements. The scale makes A nearly skew-symmetric, so that its exponential is accurate.
        """
        n = len(self.natural)
        scale = np.where(self.natural > 1e-6 * self.natural.max(initial=0.0), self.natural, 1.0)
        system = np.zeros((2 * n, 2 * n))
        system[:n, n:] = np.diag(scale)
        system[n:, :n] = np.diag(-(self.natural**2) / scale)
        if self.damping is not None:
            system[n:, n:] = -self.shapes.T @ self.damping @ self.shapes
        return system, scale


def _modal_system(mass: Matrix, stiffness: Matrix, damping: Matrix | None) -> _ModalSystem:
    """Dense matrices with their undamped modes, after checks of shape and values.

    `InputError` if shapes do not fit or a value is not finite, `SingularModelError` if the mass is not positive
    definite. Matrices may be sparse or dense, (n_dofs, n_dofs); `damping` None is none.
    """
    m, k, c = _dense(mass), _dense(stiffness), None if damping is None else _dense(damping)
    for name, matrix in (("mass", m), ("stiffness", k), ("damping", c)):
        if matrix is not None:
            require_shape(name, matrix, (len(m), len(m)))
            require_finite(name, matrix)
    try:
        eigenvalues, shapes = linalg.eigh(k, m)
    except linalg.LinAlgError as error:
        raise SingularModelError(
            "the mass matrix is not positive definite: give every degree of freedom some mass, or condense those without"
        ) from error
    return _ModalSystem(m, k, c, np.sqrt(np.maximum(eigenvalues, 0.0)), shapes)


def _undamped(
    natural: FloatArray, modal_load: FloatArray, omega: float, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Modal displacement and velocity from rest under load cos(omega t) without damping, (n_times, n_modes) each.

    `natural` are natural frequencies in rad/s, `modal_load` is (n_modes,), `time` (n_times,) in s.
    """
    t = time[:, None]
    mean, half = 0.5 * (natural + omega), 0.5 * (natural - omega)
    sinc_mean, sinc_half = np.sinc(mean * t / np.pi), np.sinc(half * t / np.pi)
    q = 0.5 * t**2 * sinc_mean * sinc_half
    dq = 0.5 * t * (np.cos(mean * t) * sinc_half + np.cos(half * t) * sinc_mean)
    return q * modal_load, dq * modal_load


def _driven(
    system: _ModalSystem, modal_load: FloatArray, omega: float, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Modal displacement and velocity from rest under load cos(omega t), with any damping, (n_times, n_modes) each.

    `modal_load` is (n_modes,), `omega` in rad/s, `time` (n_times,) in s, increasing from 0 or more. The cosine and sine
    of the load are two additional states of one matrix exponential. `system` has the modes, matrices and damping of the
    structure.
    """
    n = len(system.natural)
    state_matrix, scale = system.state_matrix()
    extended = np.zeros((2 * n + 2, 2 * n + 2))
    extended[: 2 * n, : 2 * n] = state_matrix
    extended[n : 2 * n, 2 * n] = modal_load
    extended[2 * n, 2 * n + 1], extended[2 * n + 1, 2 * n] = -omega, omega
    state = np.zeros(2 * n + 2)
    state[2 * n] = 1.0
    states, reached, powers = [], 0.0, {}
    for instant in time:
        step = float(f"{instant - reached:.9g}")  # so that steps that differ by rounding share one exponential
        if step not in powers:
            powers[step] = linalg.expm(extended * step)
        state = powers[step] @ state
        reached += step
        states.append(state + (instant - reached) * (extended @ state))  # and this makes up for it
    history = np.array(states).reshape(-1, 2 * n + 2)
    return history[:, :n] / scale, history[:, n : 2 * n]


class FreeDecay(NamedTuple):
    """Motion at the outputs; each field is (n_times, n_outputs), in m, m/s and m/s^2 (or rad)."""

    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def free_decay(
    omega: FloatArray,
    mode_shapes: FloatArray,
    time: FloatArray,
    displacement: FloatArray | float = 0.0,
    velocity: FloatArray | float = 0.0,
    damping_ratio: FloatArray | float = 0.0,
) -> FreeDecay:
    """Free motion of modes that are damped less than critically, in closed form.

    q(t) = exp(-s t) (q0 cos(wd t) + (q1 + s q0) sin(wd t) / wd), with s = zeta w and wd = w sqrt(1 - zeta^2). Nothing
    is checked: the motion of a damping ratio above 1 is NaN.

    Parameters
    ----------
    omega : (n_modes,) float array
        Undamped circular frequency, rad/s; 0 for rigid-body modes, which then drift.
    mode_shapes : (n_outputs, n_modes) float array
        At the outputs.
    time : (n_times,) float array
        Instants in s after the initial conditions.
    displacement, velocity : (n_modes,) float array or number
        Initial modal coordinates q0 and q1. For mass-normalized shapes they are phi' M u(0) and phi' M udot(0); an
        impulse of size p gives q1 = p times phi where it acts.
    damping_ratio : (n_modes,) float array or number
        Viscous, below 1.

    Returns
    -------
    FreeDecay
        Displacement, velocity and acceleration at the outputs, (n_times, n_outputs) each.

    Examples
    --------
    >>> import numpy as np
    >>> u = free_decay(np.array([2.0]), np.ones((1, 1)), np.array([0.0, np.pi / 4]), velocity=2.0).displacement
    >>> u.round(12).ravel().tolist()
    [0.0, 1.0]
    """
    rate = damping_ratio * omega
    damped = omega * np.sqrt(1 - np.square(damping_ratio))
    t = time[:, None]
    decay, cosine = np.exp(-rate * t), np.cos(damped * t)
    sine = t * np.sinc(damped * t / np.pi)
    u = decay * (displacement * cosine + (velocity + rate * displacement) * sine)
    v = decay * (velocity * cosine - (rate * velocity + omega**2 * displacement) * sine)
    a = -2 * rate * v - omega**2 * u
    return FreeDecay(u @ mode_shapes.T, v @ mode_shapes.T, a @ mode_shapes.T)

"""Free motion from initial conditions, exact at every instant: a sum of modes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray


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

    q(t) = exp(-s t) (q0 cos(wd t) + (q1 + s q0) sin(wd t) / wd), with s = zeta w and wd = w sqrt(1 - zeta^2).

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
        impulse of size p gives q1 = p phi(its place).
    damping_ratio : (n_modes,) float array or number
        Viscous, below 1.

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

"""Ambient motion and free decays of a chain by a plain state space in NumPy and SciPy: nothing of structid."""

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from structid import TimeRecord

N, STIFFNESS = 4, 2000.0


def chain():
    """Frequencies (Hz) and mass-normalized shapes of unit masses in a row, held at one end."""
    matrix = STIFFNESS * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    matrix[-1, -1] = STIFFNESS
    values, shapes = np.linalg.eigh(matrix)
    return np.sqrt(values) / (2 * np.pi), shapes


def system(ratio):
    """A and B of x' = A x + B u with x = [displacement; velocity] and modal damping `ratio`."""
    frequency, shapes = chain()
    omega = 2 * np.pi * frequency
    stiffness, damping = (shapes * w @ shapes.T for w in (omega**2, 2 * ratio * omega))
    a = np.block([[np.zeros((N, N)), np.eye(N)], [-stiffness, -damping]])
    return a, np.concatenate([np.zeros((N, N)), np.eye(N)])


def run(a, states, inputs, rate):
    """States at all samples from those at the start, with `inputs` (n_times, n_states) added at every step."""
    values, vectors = np.linalg.eig(expm(a / rate))
    first = np.concatenate([states[None], inputs[:-1]])
    modal = (np.linalg.inv(vectors) @ first.T).T
    moved = np.stack([lfilter([1.0], [1.0, -z], column) for z, column in zip(values, modal.T, strict=True)], axis=1)
    return (moved @ vectors.T).real


def ambient(seed, duration=120.0, rate=40.0, ratio=0.01, noise=0.1, tone=None):
    """Velocities under white forces, with sensor noise, and the hum of a machine at `tone` Hz."""
    rng = np.random.default_rng(seed)
    a, b = system(ratio)
    kicks = rng.standard_normal((round((duration + 60) * rate), N)) @ b.T
    y = run(a, np.zeros(2 * N), kicks, rate)[round(60 * rate) :, N:]
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    if tone is not None:
        y = y + 0.5 * y.std() * np.sin(2 * np.pi * tone * np.arange(len(y)) / rate)[:, None]
    return record(y - y.mean(axis=0), rate)


def decay(seed, duration=10.0, rate=100.0, ratio=0.01, noise=0.02, rings=0.0):
    """Velocities after a blow at the free end, with sensor noise and a ringing of the amplifiers at 14.3 Hz."""
    rng = np.random.default_rng(seed)
    a, b = system(ratio)
    n_times = round(duration * rate)
    y = run(a, b[:, -1], np.zeros((n_times, 2 * N)), rate)[:, N:]
    size = y.std(axis=0).mean()
    pole = 0.98 * np.exp(0.9j)
    ring = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(n_times))
    more = rings * (ring / ring.std())[:, None] * rng.standard_normal(N)
    return record(y + size * (noise * rng.standard_normal(y.shape) + more), rate)


def record(y, rate):
    return TimeRecord(rate, y, [f"{i + 1}X" for i in range(N)], ["velocity"] * N)

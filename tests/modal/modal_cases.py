"""Records with known modes: the beam of ten sensors in free decay, and a chain under ambient forces."""

import numpy as np
from scipy import linalg
from scipy.signal import lfilter

from structid.core.dof import Dof
from structid.dynamics.transient import free_decay
from structid.records import TimeRecord
from structid.reproduce.chapter_5 import SENSORS, beam_omega, beam_shapes

QUANTITIES = ("displacement", "velocity", "acceleration")


def beam_decay(noise=0.0, damping_ratio=0.0, seed=0, kinds=(0, 1), n_modes=10, duration=100.0, step=0.05):
    """Ten sensors after an impulse at the first; noise in parts of each channel's rms."""
    time = np.arange(round(duration / step) + 1) * step
    shapes = beam_shapes(SENSORS, n_modes)
    motion = free_decay(beam_omega(n_modes), shapes, time, velocity=shapes[0], damping_ratio=damping_ratio)
    return _record([motion[k] for k in kinds], [QUANTITIES[k] for k in kinds], step, noise, seed)


def decay(omega, shapes, duration, step, kinds=(0,), noise=0.0, seed=0, **start):
    """Free motion of modes given."""
    time = np.arange(round(duration / step) + 1) * step
    motion = free_decay(omega, shapes, time, **start)
    return _record([motion[k] for k in kinds], [QUANTITIES[k] for k in kinds], step, noise, seed)


def _record(parts, quantities, step, noise, seed):
    values = np.concatenate(parts, axis=1)
    rng = np.random.default_rng(seed)
    values = values + noise * np.sqrt(np.mean(values**2, axis=0)) * rng.standard_normal(values.shape)
    n = parts[0].shape[1]
    dofs = [Dof(r, "Y") for r in range(1, n + 1)]
    return TimeRecord(1 / step, values, dofs * len(parts), [q for q in quantities for _ in range(n)])


def nearest(found, truth):
    """Index of the identified frequency nearest to each of `truth`."""
    return np.abs(found[:, None] - truth).argmin(axis=0)


def chain_modes(n=4, stiffness=100.0):
    """Circular frequencies and mass-normalized shapes of unit masses in a row, free at one end."""
    matrix = stiffness * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    matrix[-1, -1] = stiffness
    values, shapes = np.linalg.eigh(matrix)
    return np.sqrt(values), shapes


def ambient_chain(seed, duration=600.0, rate=10.0, noise=0.02, damping_ratio=0.01):
    """Velocities of the chain under independent white forces on all masses, exact at the samples, stationary."""
    omega, shapes = chain_modes()
    rng = np.random.default_rng(seed)
    n_times, settling = round(duration * rate), round(60 * rate)
    modal = np.empty((n_times + settling, len(omega)))
    for r, w in enumerate(omega):
        a = np.array([[0.0, 1.0], [-(w**2), -2 * damping_ratio * w]])
        force = np.diag([0.0, 1.0])
        block = linalg.expm(np.block([[-a, force], [np.zeros((2, 2)), a.T]]) / rate)  # Van Loan (1978)
        step = block[2:, 2:].T
        kicks = rng.standard_normal((n_times + settling, 2)) @ np.linalg.cholesky(step @ block[:2, 2:]).T
        values, vectors = np.linalg.eig(step)
        kicks = kicks @ np.linalg.inv(vectors).T
        states = np.stack([lfilter([1.0], [1.0, -v], kicks[:, i]) for i, v in enumerate(values)], axis=1)
        modal[:, r] = (states @ vectors.T).real[:, 1]
    motion = (modal @ shapes.T)[settling:]
    motion += noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
    return TimeRecord(rate, motion, [f"{i + 1}X" for i in range(4)], ["velocity"] * 4)


HEAVY_FREQUENCY, HEAVY_DAMPING = np.array([2.1, 2.6, 4.5, 6.8, 9.3]), np.array([0.1, 0.12, 0.15, 0.1, 0.08])


def damped_decay(seed, duration=20.0, noise=0.05, damping=HEAVY_DAMPING):
    """Five modes at six points, 50 Hz, with white noise of `noise` of the rms, and the shapes."""
    five = np.arange(1, 6)
    shapes = np.sin(five * np.pi * (np.arange(6)[:, None] + 0.7) / 7.3)
    shapes[:, 1] = np.cos(1.3 * np.arange(6) + 0.5)
    omega, rng = 2 * np.pi * HEAVY_FREQUENCY, np.random.default_rng(seed)
    time = np.arange(int(50 * duration))[:, None] / 50
    size, phase = rng.uniform(0.5, 1.5, 5), rng.uniform(0, 2 * np.pi, 5)
    motion = size * np.exp(-damping * omega * time) * np.cos(omega * np.sqrt(1 - damping**2) * time + phase)
    values = motion @ shapes.T
    values = values + noise * values.std() * rng.standard_normal(values.shape)
    return TimeRecord(50.0, values, [f"{i + 1}X" for i in range(6)], ("acceleration",) * 6), shapes

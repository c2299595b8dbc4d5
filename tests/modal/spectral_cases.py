"""Ambient records with a pair of close modes, and lines of a band drawn from the model of the Bayesian FFT method."""

import numpy as np
from scipy import linalg
from scipy.signal import lfilter

from structid.modal.spectral.bayesian_fft import BandLines, BandModes, transfer
from structid.records import TimeRecord

CLOSE = (1.0, 1.01)  # Hz


def pair_shapes(angle=60.0, n=4):
    """Two unit shapes at an angle in degrees, (n, 2)."""
    basis = np.linalg.qr(np.random.default_rng(99).standard_normal((n, 2)))[0]
    turn = np.radians(angle)
    return basis @ np.array([[1.0, np.cos(turn)], [0.0, np.sin(turn)]])


def close_pair(seed, frequency=CLOSE, duration=1800.0, rate=10.0, noise=0.02, ratio=0.01, angle=60.0, n=4):
    """Velocities of two modes under independent white modal forces, exact at the samples, stationary."""
    rng = np.random.default_rng(seed)
    n_times, settling = round(duration * rate), round(100 * rate)
    modal = np.empty((n_times + settling, 2))
    for r, w in enumerate(2 * np.pi * np.array(frequency)):
        a = np.array([[0.0, 1.0], [-(w**2), -2 * ratio * w]])
        block = linalg.expm(np.block([[-a, np.diag([0.0, 1.0])], [np.zeros((2, 2)), a.T]]) / rate)  # Van Loan (1978)
        step = block[2:, 2:].T
        kicks = rng.standard_normal((n_times + settling, 2)) @ np.linalg.cholesky(step @ block[:2, 2:]).T
        values, vectors = np.linalg.eig(step)
        kicks = kicks @ np.linalg.inv(vectors).T
        states = np.stack([lfilter([1.0], [1.0, -v], kicks[:, i]) for i, v in enumerate(values)], axis=1)
        modal[:, r] = (states @ vectors.T).real[:, 1]
    motion = (modal @ pair_shapes(angle, n).T)[settling:]
    motion += noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
    return TimeRecord(rate, motion, [f"{i + 1}X" for i in range(n)], ["velocity"] * n)


def covariances(frequency, modes, derivative):
    """E_k = Phi H_k Phi' + S_e I of every line, as written, (n_lines, n_channels, n_channels)."""
    lines = BandLines(frequency, np.zeros((len(frequency), len(modes.shapes)), dtype=complex), derivative)
    h, found = transfer(lines, modes)[0], []
    for row in h:
        shaped = modes.shapes @ np.diag(row)
        found.append(shaped @ modes.force @ shaped.conj().T + modes.noise * np.eye(len(modes.shapes)))
    return np.array(found)


def drawn_lines(seed, frequency, modes, derivative=2):
    """Complex normal lines with these covariances."""
    rng = np.random.default_rng(seed)
    roots = np.linalg.cholesky(covariances(frequency, modes, derivative))
    white = rng.standard_normal((2, len(frequency), len(modes.shapes))) / np.sqrt(2)
    return BandLines(frequency, np.einsum("kij,kj->ki", roots, white[0] + 1j * white[1]), derivative)


def modes_of(n=5, m=2, seed=0, noise=0.01):
    """Modes near 2 Hz with random shapes and correlated forces."""
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((n, m))
    root = rng.standard_normal((m, m)) + 1j * rng.standard_normal((m, m))
    force = root @ root.conj().T / m + 0.5 * np.eye(m)
    frequency = np.linspace(2.0, 2.06, m)
    return BandModes(frequency, np.linspace(0.01, 0.015, m), shapes / np.linalg.norm(shapes, axis=0), force, noise)

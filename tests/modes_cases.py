"""A chain of three storeys under random forces, and its FRFs: records with known modes for `structid modes`."""

from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, dlsim

from structid.records import FrfRecord, TimeRecord
from structid.records.formats import write_record

STIFFNESS = 400.0 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
OMEGA = np.sqrt(np.linalg.eigvalsh(STIFFNESS))
SHAPES = np.linalg.eigh(STIFFNESS)[1]
FREQUENCY = OMEGA / (2 * np.pi)
RATIO = 0.01
_DAMPING = SHAPES @ np.diag(2 * RATIO * OMEGA) @ SHAPES.T


def ambient(duration=200.0, rate=25.0, seed=0, noise=0.01):
    """Displacements of unit masses under independent white forces; the second sensor points the other way."""
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-STIFFNESS, -_DAMPING]])
    b, c = np.vstack([np.zeros((3, 3)), np.eye(3)]), np.hstack([np.eye(3), np.zeros((3, 3))])
    system = cont2discrete((a, b, c, np.zeros((3, 3))), 1 / rate)
    rng = np.random.default_rng(seed)
    forces = rng.standard_normal((round((duration + 40) * rate), 3))
    motion = dlsim(system, forces)[1][round(40 * rate) :]
    motion = motion + noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
    return TimeRecord(rate, motion * [1, -1, 1], ("1X+", "2X-", "3X+"), ("displacement",) * 3)


def frfs(noise=0.01, seed=0, decay=0.0):
    """Accelerances of the three masses under a force at the third, both under a window e^(-decay t)."""
    frequency = np.arange(0.5, 8.0, 0.02)
    s = decay + 2j * np.pi * frequency[:, None]
    modal = 1 / (OMEGA**2 + s**2 + 2 * RATIO * OMEGA * s)
    values = s**2 * np.einsum("ir,fr,r->fi", SHAPES, modal, SHAPES[2])
    rng = np.random.default_rng(seed)
    error = rng.standard_normal((2, *values.shape)) * noise * np.abs(values).mean(axis=0) / np.sqrt(2)
    values = values + error[0] + 1j * error[1]
    return FrfRecord(frequency, values[:, :, None], ("1X+", "2X+", "3X+"), ("3X+",), "accelerance")


def write_ambient(path: Path, channels: tuple[str, ...] = ("1X+", "2X+", "3X+"), seed: int = 5) -> None:
    """Motion of three equal storeys (5000 kg, 1.6e6 N/m, 1 % damping) under white forces, 300 s at 50 Hz."""
    rng, rate, n = np.random.default_rng(seed), 50.0, 15000
    stiffness = 1.6e6 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    omega, shapes = np.linalg.eigh(stiffness / 5000.0)
    line = 2j * np.pi * np.fft.rfftfreq(n, 1 / rate)[:, None]
    force = rng.standard_normal((len(line), 3)) + 1j * rng.standard_normal((len(line), 3))
    modal = (force @ shapes) / (line**2 + 2 * 0.01 * np.sqrt(omega) * line + omega)
    motion = np.fft.irfft((line**2 * modal) @ shapes.T, n, axis=0)
    motion += 0.01 * motion.std() * rng.standard_normal(motion.shape)
    own = [("1X+", "2X+", "3X+").index(name) for name in channels]
    write_record(path, TimeRecord(rate, motion[:, own], channels, ("acceleration",) * len(channels)))

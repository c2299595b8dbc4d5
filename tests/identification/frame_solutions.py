"""Every frame of given masses that has given frequencies, by Newton's method on the characteristic polynomial from many starts."""

from __future__ import annotations

import numpy as np

import structid as sid
from structid.forward import ModalSettings
from structid.identification.setups.modal import ModalSetup


def frame_matrices(masses: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """M^-1 K of shear frames, stiffness (..., n_storeys) from the ground up, (..., n, n)."""
    n = len(masses)
    matrix = np.zeros((*stiffness.shape, n), dtype=stiffness.dtype)
    for storey in range(n):
        matrix[..., storey, storey] += stiffness[..., storey]
        if storey:
            matrix[..., storey - 1, storey - 1] += stiffness[..., storey]
            matrix[..., storey - 1, storey] -= stiffness[..., storey]
            matrix[..., storey, storey - 1] -= stiffness[..., storey]
    return matrix / masses[:, None]


def frame_frequencies(masses: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Hz, lowest first."""
    return np.sort(np.sqrt(np.linalg.eigvals(frame_matrices(masses, stiffness)).real)) / (2 * np.pi)


def _coefficients(matrix: np.ndarray) -> np.ndarray:
    """Of the characteristic polynomial, by Faddeev and LeVerrier, (..., n)."""
    n = matrix.shape[-1]
    product, found = matrix, []
    for k in range(1, n + 1):
        found.append(-np.trace(product, axis1=-2, axis2=-1) / k)
        product = matrix @ (product + found[-1][..., None, None] * np.eye(n))
    return np.stack(found, axis=-1)


def all_frames(masses: np.ndarray, frequency: np.ndarray, n_starts: int = 4000, seed: int = 0) -> np.ndarray:
    """Stiffnesses (n_frames, n_storeys) of all positive solutions that the starts come to, in rising order of the first."""
    n = len(masses)
    wanted = np.poly((2 * np.pi * frequency) ** 2)[1:]
    size = masses.mean() * (2 * np.pi * frequency.mean()) ** 2
    point = np.log(size) + np.random.default_rng(seed).uniform(-3.0, 2.0, (n_starts, n))
    for _ in range(60):
        value = _coefficients(frame_matrices(masses, np.exp(point))) / wanted - 1
        slopes = [
            _coefficients(frame_matrices(masses, np.exp(point + 1e-30j * np.eye(n)[k]))).imag / 1e-30 / wanted
            for k in range(n)
        ]
        jacobian = np.stack(slopes, axis=-1)
        sound = np.abs(np.linalg.det(jacobian)) > 1e-12
        step = np.zeros_like(point)
        step[sound] = np.linalg.solve(jacobian[sound], value[sound][..., None])[..., 0]
        point = point - np.clip(step, -0.7, 0.7)
    value = _coefficients(frame_matrices(masses, np.exp(point))) / wanted - 1
    found: list[np.ndarray] = []
    for stiffness in np.exp(point[np.abs(value).max(axis=1) < 1e-10]):
        if all(np.abs(np.log(stiffness / other)).max() > 1e-4 for other in found):
            found.append(stiffness)
    return np.array(sorted(found, key=lambda one: one[0]))


def frame(masses, start):
    """A shear frame of given masses, every storey with the stiffness `start`."""
    n = len(masses)
    floors, below = [f"{i + 1}X" for i in range(n)], [f"{i}X" for i in range(n)]
    return sid.Structure(
        {i: float(i) for i in range(n + 1)},
        [sid.PointMass("floor", list(range(1, n + 1)), masses), sid.Spring("storey", below, floors, stiffness=start)],
        fixed=["0X"],
        active=["X"],
    )


def frame_setup(masses, frequency, start=2.5e5, shapes=None, channels=("1X",), error=0.002):
    """Frequencies of a frame whose stiffnesses are all unknown, with shapes if they are known."""
    structure = frame(masses, start)
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "storey", each=True)])
    shapes = np.full((len(channels), len(frequency)), np.nan) if shapes is None else shapes
    record = sid.ModalRecord(frequency, np.full(len(frequency), np.nan), shapes, channels)
    return ModalSetup(structure, unknown, record, ModalSettings(frequency_error=error, shape_error=0.01))

"""Fields of a small structure at very many lines by one eigenvalue problem instead of one factorization a line."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from structid.arrays import ComplexArray, FloatArray

#: Largest difference to the direct solution at the lines where both are computed, in parts of the field.
TOLERANCE = 1e-7
_SPREAD = 8
_CHUNK_ENTRIES = 2_000_000


def modal_fields(
    mass: FloatArray, damping: FloatArray, stiffness: ComplexArray, loads: ComplexArray, laplace: ComplexArray
) -> ComplexArray | None:
    """X with (s^2 M + s C + K) X = loads at every s, from the poles and residues of the structure.

    With state (b x, x') and the scale b = (|K| / |M|)^(1/2), x(s) = sum over poles of u_r w_r' / (s - p_r): one matrix
    product serves all lines. The sum is compared with the direct solution at the line nearest to each pole and at
    eight more.

    Parameters
    ----------
    mass, damping : (n_dofs, n_dofs) float arrays
    stiffness : (n_dofs, n_dofs) complex array
        Structural damping as its imaginary part.
    loads : (n_dofs, n_loads) complex array
    laplace : (n_lines,) complex array
        s, 1/s.

    Returns
    -------
    (n_lines, n_dofs, n_loads) complex array, or None
        None where the mass matrix is singular, or the sum differs from the direct solution by more than `TOLERANCE`:
        the eigenvectors are then close to dependent, as those of undamped rigid-body motions or critical damping are.
    """
    n = len(mass)
    try:
        inverse = linalg.cho_solve(linalg.cho_factor(mass), np.eye(n))
        scale = float(np.sqrt(np.abs(stiffness).max() / np.abs(mass).max())) or 1.0
        state = np.zeros((2 * n, 2 * n), dtype=np.complex128)
        state[:n, n:] = scale * np.eye(n)
        state[n:, :n] = -inverse @ stiffness / scale
        state[n:, n:] = -inverse @ damping
        poles, vectors = np.linalg.eig(state)
        drive = np.linalg.solve(vectors, np.concatenate([np.zeros((n, loads.shape[1])), inverse @ loads]))
    except (np.linalg.LinAlgError, linalg.LinAlgError):
        return None
    residues = np.asarray((vectors[:n] / scale).T[:, :, None] * drive[:, None, :], dtype=np.complex128)
    check = _check_lines(poles, laplace)
    s = laplace[check, None, None]
    try:
        exact = np.linalg.solve(s**2 * mass + s * damping + stiffness, loads)
    except np.linalg.LinAlgError:
        return None
    off = np.abs(_sum(poles, residues, laplace[check]) - exact).max(axis=1)
    if not (off <= TOLERANCE * np.abs(exact).max(axis=1)).all():
        return None
    return _sum(poles, residues, laplace)


def _check_lines(poles: ComplexArray, laplace: ComplexArray) -> np.ndarray:
    """The line next to each pole, and a few over the band."""
    order = np.argsort(laplace.imag)
    near = np.clip(np.searchsorted(laplace.imag[order], poles.imag[poles.imag >= 0]), 0, len(laplace) - 1)
    spread = np.linspace(0, len(laplace) - 1, _SPREAD).astype(int)
    return np.unique(np.concatenate([order[near], spread]))


def _sum(poles: ComplexArray, residues: ComplexArray, laplace: ComplexArray) -> ComplexArray:
    """Sum over poles of residue / (s - pole), (n_lines, n_dofs, n_loads)."""
    flat = residues.reshape(len(poles), -1)
    values = np.empty((len(laplace), flat.shape[1]), dtype=np.complex128)
    step = max(1, _CHUNK_ENTRIES // len(poles))
    with np.errstate(divide="ignore", invalid="ignore"):
        for first in range(0, len(laplace), step):
            part = slice(first, first + step)
            np.matmul(1 / (laplace[part, None] - poles), flat, out=values[part])
    return values.reshape(len(laplace), *residues.shape[1:])

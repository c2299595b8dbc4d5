"""Fields of a small structure at very many lines by one eigenvalue problem instead of one factorization a line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray

#: Largest difference to the direct solution where both are computed, in parts of the field, or in parts of what the last
#: digit of the matrices and the order of the unknowns change in the direct solution.
TOLERANCE, ROUNDINGS = 1e-10, 30.0
_SPREAD = 8
#: Lines that one eigenvalue problem is worth: these, and so many for each degree of freedom.
_LEAST, _EACH, _EACH_DAMPED = 60, 1, 5


@dataclass(frozen=True, eq=False)
class ModalFields:
    """Fields under several loads as a sum over poles; made by `modal_fields`.

    At a line with the variable t the field is the sum over poles of shape times drive over 1 - t m, where m is the
    inverse of t at the pole.

    Attributes
    ----------
    variable : (n_lines,) complex array
    inverse : (n_poles,) complex array
    shapes : (n_dofs, n_poles) complex array
    drive : (n_poles, n_loads) complex array
    """

    variable: ComplexArray
    inverse: ComplexArray
    shapes: ComplexArray
    drive: ComplexArray

    @cached_property
    def _residues(self) -> ComplexArray:
        return (self.shapes.T[:, :, None] * self.drive[:, None, :]).reshape(len(self.inverse), -1)

    def read(self, reader: FloatArray, loads: IntArray) -> ModalFields:
        """Readings of a reader (n_read, n_dofs) under some of the loads, in place of the fields."""
        return replace(self, shapes=reader @ self.shapes, drive=self.drive[:, loads])

    def at(self, lines: slice | IntArray) -> ComplexArray:
        """The fields at some of the lines, (n, n_dofs, n_loads)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = 1 / (1 - self.variable[lines, None] * self.inverse)
            return (weights @ self._residues).reshape(len(weights), len(self.shapes), -1)


def worthwhile(n_lines: int, n_dofs: int, damped: bool) -> bool:
    """True if `n_lines` lines are worth an eigenvalue problem of the structure, twice as large with viscous damping (`damped`).

    They are from 60 + `n_dofs` lines on, or from 60 + 5 `n_dofs` with viscous damping.
    """
    return n_lines >= _LEAST + (_EACH_DAMPED if damped else _EACH) * n_dofs


def modal_fields(matrices: FloatArray, loads: FloatArray, laplace: ComplexArray) -> ModalFields | None:
    """Fields X with (s^2 M + s C + K + i H) X = loads at all s, as a sum over the poles of the structure.

    With s0 the mean size of s, without viscous damping and with t = s0^2 - s^2, Z = Z(s0) (I - t B), where
    B = Z(s0)^-1 M; with it and t = s - s0 the same holds of (x, t x / s0) and a B of twice the size. The eigenvectors
    of B serve all lines. As B is an inverse, modes near the lines are as exact as by factorization at each line, and
    motions without mass are modes with m = 0. The sum is compared with the direct solution at the line nearest to
    each pole and at eight more.

    Parameters
    ----------
    matrices : (4, n_dofs, n_dofs) float array
        M, C, K and H.
    loads : (n_dofs, n_loads) float array
    laplace : (n_lines,) complex array
        s, 1/s.

    Returns
    -------
    ModalFields or None
        None where the sum differs from the direct solution by more than `TOLERANCE`, and by more than rounding
        explains: the eigenvectors are then close to dependent, as those of critical damping are.
    """
    mass, damping = matrices[:2]
    stiffness = matrices[2] + 1j * matrices[3] if matrices[3].any() else matrices[2]
    size = np.abs(laplace)
    shift = float(np.exp(np.log(size[size > 0]).mean()))
    n = len(mass)
    try:
        shifted = shift**2 * mass + shift * damping + stiffness
        if damping.any():
            right = np.concatenate([(2 * shift * mass + damping) * shift, mass * shift**2, loads], axis=1)
            solved = np.linalg.solve(shifted, right)
            state = np.zeros((2 * n, 2 * n), dtype=solved.dtype)
            state[:n] = -solved[:, : 2 * n]
            state[n:, :n] = np.eye(n)
            inverse, vectors = np.linalg.eig(state)
            still = np.concatenate([solved[:, 2 * n :], np.zeros((n, loads.shape[1]))])
            found = ModalFields((laplace - shift) / shift, inverse, vectors[:n], np.linalg.solve(vectors, still))
            near = shift * (1 + 1 / inverse[inverse != 0])
        else:
            solved = np.linalg.solve(shifted, np.concatenate([shift**2 * mass, loads], axis=1))
            inverse, vectors = np.linalg.eig(solved[:, :n])
            drive = np.linalg.solve(vectors, solved[:, n:])
            found = ModalFields(1 - (laplace / shift) ** 2, inverse, vectors, drive)
            near = shift * np.sqrt(1 - 1 / inverse[inverse != 0] + 0j)
    except np.linalg.LinAlgError:
        return None
    lines = _check_lines(np.abs(near.imag), laplace.imag)
    s = laplace[lines, None, None]
    return found if _matches_direct_solution(found.at(lines), s**2 * mass + s * damping + stiffness, loads) else None


def _matches_direct_solution(fields: ComplexArray, dynamic: ComplexArray, loads: FloatArray) -> bool:
    """True if `fields` (n_lines, n_dofs, n_loads) differ from Z^-1 loads, solved directly, by rounding only.

    `dynamic` has the dynamic stiffness Z at each line, (n_lines, n_dofs, n_dofs). False too if Z is singular.
    """
    right = loads.astype(np.complex128)
    try:
        exact = np.linalg.solve(dynamic, right)
        difference = _difference(fields, exact)
        if difference <= TOLERANCE:
            return True
        digit = np.finfo(np.float64).eps * np.random.default_rng(0).uniform(-1.0, 1.0, dynamic.shape[1:])
        other = np.linalg.solve((dynamic * (1 + digit))[:, ::-1, ::-1], right[::-1])[:, ::-1]
    except np.linalg.LinAlgError:
        return False
    return difference <= ROUNDINGS * _difference(other, exact)


def _difference(fields: ComplexArray, exact: ComplexArray) -> float:
    """Largest difference between two fields (n_lines, n_dofs, n_loads), relative to the largest entry of each exact field."""
    largest = np.abs(exact).max(axis=1)
    off = np.abs(fields - exact).max(axis=1)
    return float((off / np.where(largest > 0, largest, 1.0)).max())


def _check_lines(poles: FloatArray, lines: FloatArray) -> IntArray:
    """Index of the first line at or above each pole within the band, and of eight spread over it (`_SPREAD`), increasing.

    `poles` (n_poles,) and `lines` (n_lines,) are frequencies in one unit and need not be sorted; poles outside the lines do
    not count.
    """
    order = np.argsort(lines)
    in_band = poles[(poles >= lines.min()) & (poles <= lines.max())]
    near = np.clip(np.searchsorted(lines[order], in_band), 0, len(lines) - 1)
    spread = np.linspace(0, len(lines) - 1, _SPREAD).astype(int)
    return np.unique(np.concatenate([order[near], spread]))

"""Fields of a large model at many lines from a small basis: Galerkin projection, and what it leaves of each equation."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.receptance import DynamicStiffness, LineFactor

#: Products with Z^-1 M that follow the solutions of one factorization into the basis: so many real fields in all, if few.
_FIELDS, _MOST_MOMENTS = 84, 8
#: Part of a new vector that must be new, or rounding fills the basis.
_NEW = 1e-9


class FieldBasis:
    """A real orthonormal basis for Z^-1 B at all lines, and the equations projected on it.

    Attributes
    ----------
    right : (n_dofs, n_columns) float array
        The right-hand sides B.
    vectors : (n_dofs, n_vectors) float array
    coordinates : (n_lines, n_vectors, n_columns) complex array
        Of the fields.
    residuals : (n_lines,) float array
        Largest |b - Z x| / |b| of the right-hand sides b of each line.
    """

    def __init__(self, stiffness: DynamicStiffness, pattern: tuple[IntArray, IntArray], right: FloatArray) -> None:
        shape = (len(right),) * 2
        self.right = right
        self.matrices = [sparse.csr_array((row, *pattern), shape) for row, _ in stiffness.merged]
        self.factors = [factor for _, factor in stiffness.merged]
        self.mass = sparse.csr_array((stiffness.data[0], *pattern), shape) if stiffness.data[0].any() else None
        self.vectors: FloatArray = np.zeros((len(right), 0))
        self._products = [self.vectors] * len(self.matrices)

    @property
    def size(self) -> int:
        return self.vectors.shape[1]

    def grow(self, solver: LineFactor, fields: NumberArray) -> None:
        """Take in the solution at one line and its moments there."""
        moments, each = [fields], fields.shape[1] * (2 if np.iscomplexobj(fields) else 1)
        for _ in range(0 if self.mass is None else min(_MOST_MOMENTS, max(1, _FIELDS // each - 1))):
            size = np.linalg.norm(moments[-1], axis=0)
            if not size.all():  # at a resonance without damping a factor may give anything, nothing as well
                break
            moments.append(solver.solve(self.mass @ (moments[-1] / size)))
        found = np.concatenate(moments, axis=1)
        del moments
        parts = np.concatenate([found.real, found.imag], axis=1) if np.iscomplexobj(found) else found.real
        new = _orthonormal(self.vectors, parts)
        self.vectors = np.concatenate([self.vectors, new], axis=1)
        self._products = [
            np.concatenate([known, matrix @ new], axis=1)
            for known, matrix in zip(self._products, self.matrices, strict=True)
        ]
        self._solve()

    def _solve(self) -> None:
        """Coordinates of the fields and what is left of the equations, whose size is that of R x in [B, A_k V] = Q R."""
        projected = [self.vectors.T @ product for product in self._products]
        triangle = np.linalg.qr(np.concatenate([self.right, *self._products], axis=1), mode="r")
        n_lines, n_columns, right = len(self.factors[0]), self.right.shape[1], self.vectors.T @ self.right
        self.coordinates: ComplexArray = np.empty((n_lines, self.size, n_columns), dtype=np.complex128)
        self.residuals: FloatArray = np.empty(n_lines)
        for line in range(n_lines):
            factors = [complex(factor[line]) for factor in self.factors]
            small = sum(factor * matrix for factor, matrix in zip(factors, projected, strict=True))
            x = self.coordinates[line] = np.linalg.solve(np.asarray(small), right)
            rest = np.concatenate([np.eye(n_columns), *(-factor * x for factor in factors)])
            size = np.linalg.norm(triangle @ rest, axis=0) / np.linalg.norm(self.right, axis=0)
            self.residuals[line] = size.max(initial=0.0)

    def fields(self, line: int) -> NumberArray:
        """Fields at a line, (n_dofs, n_columns), real where nothing damps."""
        x = self.coordinates[line]
        if not x.imag.any():
            return np.asarray(self.vectors @ x.real)
        found = np.empty((len(self.vectors), x.shape[1]), dtype=np.complex128)
        found.real, found.imag = self.vectors @ x.real, self.vectors @ x.imag
        return found

    def read(self, sensors: sparse.sparray) -> ComplexArray:
        """S' times the fields at all lines, (n_lines, n_readings, n_columns)."""
        read: ComplexArray = np.asarray(sensors.T @ self.vectors) @ self.coordinates
        return read


def _orthonormal(known: FloatArray, vectors: FloatArray) -> FloatArray:
    """The part of the space of `vectors` that is not in the orthonormal `known`, as orthonormal columns."""
    size = np.linalg.norm(vectors, axis=0)
    rest = vectors[:, size > 0] / size[size > 0]
    for _ in range(2):
        rest = rest - known @ (known.T @ rest)
    left, singular, _ = np.linalg.svd(rest, full_matrices=False)
    new = left[:, singular > _NEW * max(1.0, singular.max(initial=0.0))]
    new = new - known @ (known.T @ new)
    return np.linalg.qr(new)[0]

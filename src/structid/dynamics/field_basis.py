"""Fields of a large model at many lines from a small basis: Galerkin projection, and what it leaves of each equation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg, sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.receptance import DynamicStiffness, LineFactor

#: Products with Z^-1 M that follow the solutions of one factorization into the basis: so many real fields in all, if few.
_FIELDS, _MOST_MOMENTS = 84, 8
#: Part of a new vector that must be new, or rounding fills the basis.
_NEW = 1e-9
#: Random sums of equations that tell the sizes of what is left of them.
_SUMS = 2000


class FieldBasis:
    """A real orthonormal basis for Z^-1 B at all lines, and the equations projected on it.

    Attributes
    ----------
    right : (n_dofs, n_columns) float array
        The right-hand sides B.
    vectors : (n_dofs, n_vectors) float array
    """

    def __init__(self, stiffness: DynamicStiffness, pattern: tuple[IntArray, IntArray], right: FloatArray) -> None:
        """An empty basis for the model `stiffness` with sparsity `pattern` and right-hand sides (n_dofs, n_columns)."""
        shape = (len(right),) * 2
        self.right = right
        self.matrices = [sparse.csr_array((row, *pattern), shape) for row, _ in stiffness.merged]
        self.factors = [factor for _, factor in stiffness.merged]
        self.mass = sparse.csr_array((stiffness.data[0], *pattern), shape) if stiffness.data[0].any() else None
        self.vectors: FloatArray = np.zeros((len(right), 0))
        self._products = [self.vectors] * len(self.matrices)
        self._sketching_matrix = _sketching_matrix(len(right))
        self._sketched = [self._sketching_matrix @ self.vectors] * len(self.matrices)
        self._projected = [np.zeros((0, 0))] * len(self.matrices)
        self._loads: FloatArray = np.zeros((0, right.shape[1]))
        self._known: dict[int, ComplexArray] = {}

    @property
    def size(self) -> int:
        return self.vectors.shape[1]

    def grow(self, solver: LineFactor, fields: NumberArray) -> None:
        """Add the solution `fields` at one line, and Krylov vectors about it, to the basis; `solver` is Z factorized there."""
        krylov_vectors, n_real_columns = [fields], fields.shape[1] * (2 if np.iscomplexobj(fields) else 1)
        for _ in range(0 if self.mass is None else min(_MOST_MOMENTS, max(1, _FIELDS // n_real_columns - 1))):
            size = np.linalg.norm(krylov_vectors[-1], axis=0)
            if not size.all():  # at a resonance without damping a factor may give anything, nothing as well
                break
            krylov_vectors.append(solver.solve(self.mass @ (krylov_vectors[-1] / size)))
        self._extend(np.concatenate(krylov_vectors, axis=1))

    def improve(self, solver: LineFactor, lines: Sequence[int]) -> None:
        """Add corrections to the basis: the factorization `solver` of some line applied to the residuals of other `lines`."""
        residuals = np.concatenate([self.residual(line) for line in lines], axis=1)
        size = np.linalg.norm(residuals, axis=0)
        if not size.any():
            return
        self._extend(solver.solve(residuals[:, size > 0] / size[size > 0]))

    def residual(self, line: int) -> NumberArray:
        """Residual B - Z x of the projected fields at one line, (n_dofs, n_columns)."""
        x = self.coordinates(line)
        parts = [
            sum(
                (product @ factor for product, factor in zip(self._products, factors, strict=True)),
                np.zeros_like(self.right),
            )
            for factors in ([np.real(f[line] * x) for f in self.factors], [np.imag(f[line] * x) for f in self.factors])
        ]
        residual = self.right - parts[0]
        return residual - 1j * parts[1] if parts[1].any() else residual

    def left(self, line: int) -> float:
        """Largest |b - Z x| / |b| of the right-hand sides b of a line."""
        size: FloatArray = np.linalg.norm(self.residual(line), axis=0) / np.linalg.norm(self.right, axis=0)
        return float(size.max(initial=0.0))

    @property
    def residuals(self) -> FloatArray:
        """Relative residual at every line, (n_lines,); for large models accurate to about a tenth, from a random sketch."""
        n_columns = self.right.shape[1]
        triangle = np.linalg.qr(
            np.concatenate([self._sketching_matrix @ self.right, *self._sketched], axis=1), mode="r"
        )
        norms: FloatArray = np.empty(len(self.factors[0]))
        for line in range(len(norms)):
            x = self.coordinates(line)
            residual = np.concatenate([np.eye(n_columns), *(-factor[line] * x for factor in self.factors)])
            size = np.linalg.norm(triangle @ residual, axis=0) / np.linalg.norm(self.right, axis=0)
            norms[line] = size.max(initial=0.0)
        return norms

    def coordinates(self, line: int) -> ComplexArray:
        """Coordinates of the fields in the basis at one line, (n_vectors, n_columns)."""
        if line not in self._known:
            small = sum(
                complex(factor[line]) * matrix for factor, matrix in zip(self.factors, self._projected, strict=True)
            )
            self._known[line] = np.linalg.solve(np.asarray(small), self._loads.astype(np.complex128))
        return self._known[line]

    def fields(self, line: int) -> NumberArray:
        """Fields at one line, (n_dofs, n_columns); real if the model has no damping."""
        x = self.coordinates(line)
        if not x.imag.any():
            return np.asarray(self.vectors @ x.real)
        total = np.empty((len(self.vectors), x.shape[1]), dtype=np.complex128)
        total.real, total.imag = self.vectors @ x.real, self.vectors @ x.imag
        return total

    def all_coordinates(self) -> ComplexArray:
        """Of the fields at all lines, (n_lines, n_vectors, n_columns)."""
        return np.stack([self.coordinates(line) for line in range(len(self.factors[0]))])

    def read(self, sensors: sparse.sparray) -> ComplexArray:
        """S' times the fields at all lines, (n_lines, n_readings, n_columns)."""
        read: ComplexArray = np.asarray(sensors.T @ self.vectors) @ self.all_coordinates()
        return read

    def _extend(self, fields: NumberArray) -> None:
        """Extend the basis by the part of `fields`, (n_dofs, n_fields), that it does not span yet."""
        parts = np.concatenate([fields.real, fields.imag], axis=1) if np.iscomplexobj(fields) else fields.real
        new, before = _orthonormal_part(self.vectors, parts), self.vectors
        self.vectors = np.concatenate([before, new], axis=1)
        for k, matrix in enumerate(self.matrices):
            product = matrix @ new
            side, corner = before.T @ product, new.T @ product
            self._projected[k] = np.block([[self._projected[k], side], [side.T, corner]])
            self._products[k] = np.concatenate([self._products[k], product], axis=1)
            self._sketched[k] = np.concatenate([self._sketched[k], self._sketching_matrix @ product], axis=1)
        self._loads = self.vectors.T @ self.right
        self._known = {}


def _sketching_matrix(n: int) -> sparse.csr_array:
    """Random sparse matrix, (n_sums, n), that adds n equations with random signs: norms are kept to about a tenth.

    Woodruff (2014), Foundations and Trends in Theoretical Computer Science 10(1-2), 1-157, section 2.1.

    References
    ----------
    Woodruff (2014), Foundations and Trends in Theoretical Computer Science 10(1-2), 1-157, section 2.1.
    """
    if n <= _SUMS:
        return sparse.eye_array(n, format="csr")
    rng = np.random.default_rng(0)
    coordinates = np.arange(n), rng.integers(_SUMS, size=n)
    return sparse.csr_array((rng.choice([-1.0, 1.0], size=n), coordinates), (n, _SUMS)).T.tocsr()


def _orthonormal_part(basis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Orthonormal columns that span the part of `vectors` (n, n_vectors) outside the span of the orthonormal `basis`."""
    size = np.linalg.norm(vectors, axis=0)
    residual = vectors[:, size > 0] / size[size > 0]
    for _ in range(2):
        residual = residual - basis @ (basis.T @ residual)
    _, singular, right = np.linalg.svd(np.linalg.qr(residual, mode="r"), full_matrices=False)
    kept = singular > _NEW * max(1.0, singular.max(initial=0.0))
    new = residual @ (right[kept].T / singular[kept])
    new = new - basis @ (basis.T @ new)
    triangle = linalg.cholesky(new.T @ new, lower=True)
    return np.asarray(linalg.solve_triangular(triangle, new.T, lower=True).T)

"""A sweep over many frequencies from few factorizations: a basis grown where the error is largest, and verified there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics.receptance import DynamicStiffness

#: Fewer lines than this are solved one by one.
FEWEST_LINES = 20
#: Law of the mass matrix, and how many products with Z^-1 M a factorization gives to the basis.
_MASS, _MOMENTS = 0, 8
#: Part of a new vector that must be new, or rounding fills the basis.
_NEW = 1e-9
_MOST_COLUMNS = 600
#: Other lines may be off by more than the one that is verified: it must be better than asked by this factor.
_SAFE = 0.3


@dataclass(frozen=True, eq=False)
class ReducedSweep:
    """Readings at all lines, and how they were found.

    Attributes
    ----------
    values : (n_frequencies, n_readings, n_loads) complex array
    n_factorizations : int
    n_basis : int
        Vectors of the basis; 0 where every line was solved for.
    error : float
        Largest relative difference to the full solution at the line that was verified last: the one with the largest
        residual of all. Relative to the largest reading of that line; NaN where every line was solved for.
    """

    values: ComplexArray
    n_factorizations: int
    n_basis: int
    error: float


def reduced_sweep(
    stiffness: DynamicStiffness,
    pattern: tuple[IntArray, IntArray],
    loads: FloatArray,
    sensors: sparse.sparray,
    tolerance: float = 1e-6,
) -> ReducedSweep:
    """Readings S' Z^-1 F at every line by Galerkin projection on solutions at few lines, to a verified `tolerance`.

    The basis holds, for each line that was factorized, Z^-1 F and further products with Z^-1 M there (rational Krylov).
    The next line is the one with the largest residual |F - Z x| / |F|; it is solved in full, which verifies the
    reduced readings there, and serves the basis if they are off. Where that takes more than a third of the lines, all
    are solved for.

    Parameters
    ----------
    stiffness : DynamicStiffness
        Law 0 is the mass matrix.
    pattern : (indices, indptr)
        Of its entries, compressed columns.
    loads : (n_dofs, n_loads) float array
    sensors : (n_dofs, n_readings) sparse array
    tolerance : float
        Largest error in parts of the largest reading of a line.

    Raises
    ------
    SingularModelError
        If Z cannot be factorized at a line that is chosen.

    References
    ----------
    Grimme (1997), Krylov projection methods for model reduction, PhD thesis, University of Illinois, chapter 5;
    Feng, Antoulas and Benner (2017), ESAIM: M2AN 51, 2129, for the choice of points by the residual.
    """
    n_lines = len(stiffness.frequency)
    laws = {
        law: sparse.csr_array((row, *pattern), (loads.shape[0],) * 2)
        for law, row in enumerate(stiffness.data)
        if row.any()
    }
    basis = _Basis(laws, loads, sensors)
    line, solved = n_lines // 2, 0
    values = np.empty((n_lines, sensors.shape[1], loads.shape[1]), dtype=np.complex128)
    residuals = np.full(n_lines, np.inf)
    visited = np.zeros(n_lines, dtype=bool)
    while n_lines >= FEWEST_LINES and solved < max(3, n_lines // 3) and basis.size < _MOST_COLUMNS:
        solver = stiffness.solver(line)
        fields = solver.solve(loads)
        solved, visited[line] = solved + 1, True
        exact = sensors.T @ fields
        error = float(np.abs(values[line] - exact).max() / np.abs(exact).max()) if basis.size else np.inf
        if error <= _SAFE * tolerance:
            values[line] = exact
            return ReducedSweep(values, solved, basis.size, error)
        basis.grow(solver, fields)
        for other in range(n_lines):
            values[other], residuals[other] = basis.solution(stiffness.coefficients[other])
        line = int(np.argmax(np.where(visited, -1.0, residuals)))
    for other in range(n_lines):
        values[other] = sensors.T @ stiffness.solver(other).solve(loads)
    return ReducedSweep(values, solved + n_lines, 0, float("nan"))


class _Basis:
    """A real orthonormal basis, and the matrices projected on it."""

    def __init__(self, laws: dict[int, sparse.csr_array], loads: FloatArray, sensors: sparse.sparray) -> None:
        self.laws, self.loads, self.sensors = laws, loads, sensors
        self.vectors: FloatArray = np.zeros((loads.shape[0], 0))
        self.products: dict[int, FloatArray] = dict.fromkeys(laws, self.vectors)
        self.projected: dict[int, FloatArray] = {}

    @property
    def size(self) -> int:
        return self.vectors.shape[1]

    def grow(self, solver: Any, fields: NDArray[Any]) -> None:
        """Take in the solution at one line and its moments there."""
        moments = [fields]
        for _ in range(_MOMENTS if _MASS in self.laws else 0):
            last = moments[-1] / np.linalg.norm(moments[-1], axis=0)
            moments.append(solver.solve(self.laws[_MASS] @ last))
        found = np.concatenate(moments, axis=1)
        parts = np.concatenate([found.real, found.imag], axis=1) if np.iscomplexobj(found) else found
        new = _orthonormal(self.vectors, parts)
        self.vectors = np.concatenate([self.vectors, new], axis=1)
        for law, matrix in self.laws.items():
            self.products[law] = np.concatenate([self.products[law], matrix @ new], axis=1)
            self.projected[law] = self.vectors.T @ self.products[law]

    def solution(self, coefficients: ComplexArray) -> tuple[NDArray[Any], float]:
        """Readings at a line, and the largest relative residual of its loads."""
        small: NDArray[Any] = np.zeros((self.size, self.size), dtype=np.complex128)
        for law, matrix in self.projected.items():
            small += coefficients[law] * matrix
        x = np.linalg.solve(small, self.vectors.T @ self.loads)
        rest: NDArray[Any] = self.loads.astype(np.complex128)
        for law, product in self.products.items():
            if coefficients[law] != 0:
                rest -= product @ (coefficients[law] * x)
        size = np.linalg.norm(rest, axis=0) / np.linalg.norm(self.loads, axis=0)
        return self.sensors.T @ (self.vectors @ x), float(size.max(initial=0.0))


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

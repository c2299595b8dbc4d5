"""SuperLU, which comes with SciPy: always there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from structid.core.arrays import IntArray, NumberArray
from structid.dynamics.factorization.base import SingularMatrixError

#: Diagonal pivots are kept unless they are smaller than this part of the largest entry of their column.
_PIVOT = 0.01


@dataclass(frozen=True)
class SuperLu:
    """Minimum degree ordering of A' + A and diagonal pivots: for symmetric matrices faster than SciPy's defaults."""

    name: str = "superlu"

    @property
    def words(self) -> str:
        return f"SuperLU (SciPy {scipy.__version__})"

    def analyse(self, indices: IntArray, indptr: IntArray, loaded: NDArray[np.bool_] | None = None) -> SuperLuAnalysis:
        """The analysis of a symmetric pattern in compressed columns; `loaded` makes no difference."""
        return SuperLuAnalysis(np.asarray(indices), np.asarray(indptr))


@dataclass(frozen=True, eq=False)
class SuperLuAnalysis:
    """A pattern, its rows and columns put in the order of least fill, which is found once."""

    indices: IntArray
    indptr: IntArray

    @cached_property
    def _ordering(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """Fill-reducing order of the unknowns, source of each reordered entry, and the reordered pattern (indices, indptr).

        `right[order]` is in the new order; `entries[source]` are those of the new pattern in compressed columns.
        """
        n = len(self.indptr) - 1
        columns = np.repeat(np.arange(n), np.diff(self.indptr))
        dominant = np.where(self.indices == columns, 2.0 * np.diff(self.indptr)[columns], -1.0)
        trial = splu(
            sparse.csc_matrix((dominant, self.indices, self.indptr), (n, n)),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        new_position = np.asarray(trial.perm_c)
        keys = new_position[columns].astype(np.int64) * n + new_position[self.indices]
        entry = np.argsort(keys, kind="stable")
        indptr = np.concatenate([[0], np.cumsum(np.bincount(new_position[columns], minlength=n))])
        return np.argsort(new_position), entry, (keys[entry] % n).astype(np.int32), indptr.astype(np.int32)

    def factor(self, entries: NumberArray) -> SuperLuFactor:
        """Factorization of the matrix with `entries` (n_entries,), in the order of the pattern.

        Raises
        ------
        SingularMatrixError
            If an entry is not finite or the matrix is singular.
        """
        order, entry, indices, indptr = self._ordering
        n = len(indptr) - 1
        if not np.isfinite(entries).all():
            raise SingularMatrixError("the matrix has entries that are not finite")
        try:
            factor = splu(
                sparse.csc_matrix((entries[entry], indices, indptr), (n, n)),
                permc_spec="NATURAL",
                diag_pivot_thresh=_PIVOT,
                options={"SymmetricMode": True, "Equil": True},
            )
        except RuntimeError as error:
            raise SingularMatrixError(str(error)) from error
        return SuperLuFactor(factor, order, bool(np.iscomplexobj(entries)))


@dataclass(frozen=True, eq=False)
class SuperLuFactor:
    """L and U of a reordered matrix."""

    factor: SuperLU
    order: IntArray
    is_complex: bool

    def solve(self, right: NumberArray) -> NumberArray:
        """Solution X, (n, n_right), of A X = `right` (n, n_right), real or complex."""
        reordered = right[self.order]
        if self.is_complex:
            unordered = self.factor.solve(np.asarray(reordered, dtype=np.complex128))
        elif np.iscomplexobj(reordered):
            unordered = self.factor.solve(np.ascontiguousarray(reordered.real)) + 1j * self.factor.solve(
                np.ascontiguousarray(reordered.imag)
            )
        else:
            unordered = self.factor.solve(np.asarray(reordered, dtype=np.float64))
        solution = np.empty_like(unordered, order="C")
        solution[self.order] = unordered
        return solution

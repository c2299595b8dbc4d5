"""Element matrices as values: weighted sums, products with a field, and bilinear forms, never a dense stack.

M, C and K are weighted sums of element matrices. Three operations serve everything that is built on them:
`assemble` gives the sum, `apply` the columns B_e x (the linear regressor of Norris 1986, Eqs. 3.9 and 4.12) and
`bilinear` all y' B_e x at once (every sensitivity of a response by the adjoint method).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_shape
from structid.core.errors import InputError


def index_kind(largest: int) -> type[np.int32] | type[np.int64]:
    """The narrowest kind of index that holds numbers up to `largest`."""
    return np.int32 if largest <= np.iinfo(np.int32).max else np.int64


class ElementMatrices(Protocol):
    """Common interface of `Blocks` and `MatrixBlocks`: element matrices that are assembled, applied and selected."""

    @property
    def n_elements(self) -> int: ...

    @property
    def n_dofs(self) -> int: ...

    def entries(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Row, column, element and value of every stored entry, (n_entries,) each."""
        ...

    def assemble(self, weights: np.ndarray) -> sparse.csc_array:
        """The sum of weights[e] B_e, (n_dofs, n_dofs)."""
        ...

    def bilinear(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Products y' B_e x with each element matrix, without conjugate, (..., n_elements, n_y, n_x).

        `y` is (..., n_dofs, n_y) and `x` (..., n_dofs, n_x).
        """
        ...

    def take(self, elements: IntArray) -> ElementMatrices:
        """Copy with these elements only, in this order."""
        ...


@dataclass(frozen=True, eq=False)
class Blocks:
    """Small dense matrices, one an element, all of the same size.

    Parameters
    ----------
    dofs : (n_elements, n_local) int array
        Global index of each local degree of freedom; -1 where it is held at zero.
    local : (n_elements, n_local, n_local) float array
        Element matrices.
    n_dofs : int
        Number of global degrees of freedom.
    """

    dofs: IntArray
    local: FloatArray
    n_dofs: int

    def __post_init__(self) -> None:
        """Make the arrays read-only; raise `InputError` if shapes do not fit or a degree of freedom is out of range.

        The range is -1 (constrained) to `n_dofs` - 1.
        """
        object.__setattr__(self, "dofs", locked(self.dofs, np.int64))
        object.__setattr__(self, "local", locked(self.local, np.float64))
        require_shape("dofs", self.dofs, (None, None))
        n_elements, n_local = self.dofs.shape
        require_shape("local", self.local, (n_elements, n_local, n_local), "one square matrix per row of `dofs`")
        if self.dofs.size and (self.dofs.max() >= self.n_dofs or self.dofs.min() < -1):
            raise InputError(f"`dofs` must lie from -1 to {self.n_dofs - 1}, got up to {self.dofs.max()}")

    @property
    def n_elements(self) -> int:
        return self.dofs.shape[0]

    def entries(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Row, column, element and value of each non-zero entry at free degrees of freedom, (n_entries,) each.

        Rows and columns are degrees of freedom, elements the rows of `dofs`, all from 0. Entries may repeat; their sum
        is the matrix for unit weights.
        """
        shape = self.local.shape
        row = np.broadcast_to(self.dofs[:, :, None], shape)
        column = np.broadcast_to(self.dofs[:, None, :], shape)
        element = np.broadcast_to(np.arange(self.n_elements)[:, None, None], shape)
        keep = (row >= 0) & (column >= 0) & (self.local != 0)
        return row[keep], column[keep], element[keep], self.local[keep]

    def stored(self, chosen: slice | IntArray) -> tuple[IntArray, IntArray, NDArray[np.bool_]]:
        """Row and column (n_entries,) of the non-zero entries of the elements `chosen`, and their mask.

        The mask has the shape of `local[chosen]`. Entries at constrained degrees of freedom are left out. Row and
        column indices have the narrowest integer type that holds them, for models whose entries are many.
        """
        dofs: IntArray = self.dofs[chosen].astype(index_kind(self.n_dofs))
        is_stored, free = self.local[chosen] != 0, dofs >= 0
        if not free.all():
            is_stored &= free[:, :, None] & free[:, None, :]
        row, column = (
            np.broadcast_to(table, is_stored.shape)[is_stored] for table in (dofs[:, :, None], dofs[:, None, :])
        )
        return row, column, is_stored

    def assemble(self, weights: np.ndarray) -> sparse.csc_array:
        """Sum of weights[e] B_e over the elements, as a sparse (n_dofs, n_dofs) array; `weights` is (n_elements,)."""
        row, column, element, value = self.entries()
        summed = sparse.coo_array((value * np.asarray(weights)[element], (row, column)), (self.n_dofs, self.n_dofs))
        return summed.tocsc()

    def bilinear(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Products y' B_e x with each element matrix, without conjugate, (..., n_elements, n_y, n_x).

        `y` is (..., n_dofs, n_y) and `x` (..., n_dofs, n_x).
        """
        products = self.local @ self._gather(x)
        return np.swapaxes(self._gather(y), -1, -2) @ products

    def take(self, elements: IntArray) -> Blocks:
        """Copy with these elements only, in this order."""
        return Blocks(self.dofs[elements], self.local[elements], self.n_dofs)

    def _gather(self, x: np.ndarray) -> np.ndarray:
        """x (..., n_dofs, n_x) at the elements' degrees of freedom, (..., n_elements, n_local, n_x), 0 where held."""
        if self.dofs.size and self.dofs.min() < 0:
            x = np.concatenate([x, np.zeros((*x.shape[:-2], 1, x.shape[-1]), x.dtype)], axis=-2)
        return x[..., self.dofs, :]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of a weighted sum of several families of element matrices; made by `pattern`."""

    indices: IntArray
    starts: IntArray
    entry: IntArray  # index of each element entry in the sum
    element: IntArray
    value: FloatArray

    def summed(self, weights: np.ndarray) -> sparse.csc_array:
        """Weighted sum of all element matrices as a sparse (n_dofs, n_dofs) array, without entries that are zero.

        `weights` hold one number for each element, family by family.
        """
        size = len(self.starts) - 1
        total = sparse.csc_array((self._data(weights), self.indices.copy(), self.starts.copy()), (size, size))
        total.eliminate_zeros()
        return total

    def _data(self, weights: np.ndarray) -> FloatArray:
        return np.asarray(np.bincount(self.entry, self.value * weights[self.element], len(self.indices)), np.float64)


def pattern(families: Sequence[ElementMatrices]) -> Pattern:
    """The sparsity pattern of the weighted sum of `families` of element matrices, for fast sums with other weights.

    There is at least one family, and all have the same n_dofs. Elements are counted through all families in their
    order.
    """
    parts, n = [family.entries() for family in families], families[0].n_dofs
    row, column, value = (np.concatenate([part[k] for part in parts]) for k in (0, 1, 3))
    firsts = np.cumsum([0, *(family.n_elements for family in families)])
    element = np.concatenate([first + part[2] for first, part in zip(firsts, parts, strict=False)])
    all_positions, entry = np.unique(column * n + row, return_inverse=True)
    starts = np.searchsorted(all_positions // n, np.arange(n + 1))
    kind = index_kind(len(all_positions))
    return Pattern((all_positions % n).astype(kind), starts.astype(kind), entry.ravel(), element, value)


@dataclass(frozen=True, eq=False)
class MatrixBlocks:
    """Whole sparse matrices as elements: groups of a model from another finite element code.

    Parameters
    ----------
    matrices : sequence of sparse (n_dofs, n_dofs) arrays
        One matrix a group.
    """

    matrices: tuple[sparse.csc_array, ...]

    def __init__(self, matrices: Sequence[sparse.sparray | sparse.spmatrix | np.ndarray]) -> None:
        """Element matrices that are whole matrices, one for each element, converted to compressed columns.

        Raises `InputError` unless they are square and of equal size.
        """
        converted = tuple(sparse.csc_array(matrix, dtype=np.float64) for matrix in matrices)
        object.__setattr__(self, "matrices", converted)
        for index, matrix in enumerate(converted):
            if matrix.shape != (converted[0].shape[0],) * 2:
                raise InputError(f"`matrices` must be square and of one size, got {matrix.shape} at index {index}")

    @property
    def n_elements(self) -> int:
        return len(self.matrices)

    @property
    def n_dofs(self) -> int:
        return int(self.matrices[0].shape[0])

    def entries(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Row, column, element and value of every stored entry, (n_entries,) each, matrix by matrix."""
        coordinates = [matrix.tocoo() for matrix in self.matrices]
        return (
            np.concatenate([c.row for c in coordinates]).astype(np.int64),
            np.concatenate([c.col for c in coordinates]).astype(np.int64),
            np.repeat(np.arange(len(coordinates)), [c.nnz for c in coordinates]),
            np.concatenate([c.data for c in coordinates]),
        )

    def assemble(self, weights: np.ndarray) -> sparse.csc_array:
        """Sum of the matrices times `weights` (n_elements,), one a matrix, as a sparse (n_dofs, n_dofs) array.

        Raises `ValueError` for another number of weights.
        """
        total = sparse.csc_array((self.n_dofs, self.n_dofs))
        for weight, matrix in zip(np.asarray(weights), self.matrices, strict=True):
            total = total + weight * matrix
        return total

    def bilinear(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Products y' B x with each matrix B, without conjugate, (..., n_elements, n_y, n_x).

        `y` is (..., n_dofs, n_y) and `x` (..., n_dofs, n_x), with the same leading axes.
        """
        batch = x.shape[:-2]
        flat = np.moveaxis(x, -2, 0).reshape(self.n_dofs, -1)
        adjoint = np.swapaxes(y, -1, -2)
        forms = []
        for matrix in self.matrices:
            product = (matrix @ flat).reshape(self.n_dofs, *batch, x.shape[-1])
            forms.append(adjoint @ np.moveaxis(product, 0, -2))
        return np.stack(forms, axis=-3)

    def take(self, elements: IntArray) -> MatrixBlocks:
        """Copy with these elements only, in this order."""
        return MatrixBlocks([self.matrices[int(e)] for e in elements])

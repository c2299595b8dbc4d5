"""All matrices of a structure on one sparsity pattern, so that a sum of them is a sum of arrays."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.fem.blocks import Blocks, ElementMatrices, index_kind
from structid.fem.contribution import MATRIX_KINDS
from structid.fem.structure import Structure

#: Element matrices of which more than this part is not zero are taken as full: they join all their unknowns.
_FULL = 0.9
#: Entries of element matrices that are looked up at once.
_CHUNK_ENTRIES = 4_000_000


@dataclass(frozen=True, eq=False)
class Assembly:
    """The union pattern of a structure's matrices and the maps from element weights to its entries.

    Attributes
    ----------
    structure : Structure
    matrix_kinds : tuple of str
        ``mass damping stiffness structural_damping`` and one ``friction:NAME`` for each friction element.
    indices, indptr : int arrays
        The pattern in compressed columns.
    maps : tuple of (n_entries, n_elements) sparse arrays
        One for each contribution of the structure; contributions that share element matrices share it.
    """

    structure: Structure
    matrix_kinds: tuple[str, ...]
    indices: IntArray
    indptr: IntArray
    maps: tuple[sparse.csc_array, ...]

    def data(self, values: FloatArray) -> FloatArray:
        """Entries (n_matrices, n_entries) of each matrix in the shared pattern at the property `values` (n_values,).

        Rows are in the order of `matrix_kinds`; zeros where the structure has no such matrix. Entries are in the order
        of compressed columns.
        """
        rows = np.zeros((len(self.matrix_kinds), len(self.indices)))
        for part, entries in zip(self.structure.contributions, self.maps, strict=True):
            weights = part.weights(values)
            if weights.any():
                rows[self.matrix_kinds.index(part.matrix_kind)] += entries @ weights
        return rows


def structure_matrix_kinds(structure: Structure) -> tuple[str, ...]:
    """Kinds of the matrices in the dynamic stiffness of `structure`: the four of all, then one each friction."""
    frictions = dict.fromkeys(
        part.matrix_kind for part in structure.contributions if part.matrix_kind not in MATRIX_KINDS
    )
    return (*MATRIX_KINDS, *frictions)


def assembly(structure: Structure) -> Assembly:
    """The shared sparsity pattern of the matrices of `structure`, with maps from element weights to its entries.

    The pattern holds the entries of all matrices and the diagonal, in compressed columns. There is a sparse map
    (n_entries, n_elements) for each contribution, that is for each family of element matrices with the values that
    weigh them.

    Notes
    -----
    The pattern is the product of the incidence of elements and degrees of freedom with itself, so no list of all
    entries of all elements is sorted. The maps hold the element matrices as they are, where no entry of them is zero,
    and the place of each entry.
    """
    blocks_of = {id(part.blocks): part.blocks for part in structure.contributions}
    pattern = _union_pattern(structure.n_dofs, blocks_of.values())
    entry_number = np.arange(1, len(pattern.indices) + 1, dtype=pattern.indices.dtype)
    numbered = sparse.csr_array((entry_number, pattern.indices, pattern.indptr), pattern.shape)
    map_of = {key: _weight_map(blocks, numbered) for key, blocks in blocks_of.items()}
    maps = tuple(map_of[id(part.blocks)] for part in structure.contributions)
    return Assembly(structure, structure_matrix_kinds(structure), pattern.indices, pattern.indptr, maps)


def _union_pattern(n: int, families: Collection[ElementMatrices]) -> sparse.csr_array:
    """Union of the sparsity patterns of all element matrices and the diagonal, boolean (n, n), indices sorted.

    `families` are the element matrices on n degrees of freedom. Rows of the result are the columns of the matrices.
    """
    total = sparse.csr_array(sparse.eye_array(n, dtype=np.bool_, format="csr"))
    small = [blocks for blocks in families if isinstance(blocks, Blocks)]
    full = {b.dofs.tobytes(): b.dofs for b in small if np.count_nonzero(b.local) > _FULL * b.local.size}
    for width in sorted({dofs.shape[1] for dofs in full.values()}):
        total = total + _element_pattern(np.concatenate([dofs for dofs in full.values() if dofs.shape[1] == width]), n)
    for blocks in families:
        if not isinstance(blocks, Blocks):
            row, column, _, _ = blocks.entries()
            total = total + _boolean_pattern(column, row, n)
        elif blocks.dofs.tobytes() not in full:
            row, column, _ = blocks.stored(slice(None))
            total = total + _boolean_pattern(column, row, n)
    total.sort_indices()
    return total


def _boolean_pattern(row: IntArray, column: IntArray, n: int) -> sparse.csr_array:
    """Sparse (n, n) array of True at the positions `row` and `column` (n_entries,); doubled positions count once."""
    kind = index_kind(max(n, len(row)))
    positions = row.astype(kind, copy=False), column.astype(kind, copy=False)
    return sparse.coo_array((np.ones(len(row), dtype=np.bool_), positions), (n, n)).tocsr()


def _element_pattern(dofs: IntArray, n: int) -> sparse.csr_array:
    """Boolean pattern (n, n) of all pairs of degrees of freedom that belong to the same element.

    `dofs` (n_elements, n_local) are those of each element, -1 where constrained. `n` is the number of free ones.
    """
    free = dofs >= 0
    indptr = np.concatenate([[0], np.cumsum(free.sum(axis=1))])
    kind = index_kind(max(n, int(indptr[-1])))
    columns = dofs[free].astype(kind)
    incidence = sparse.csr_array((np.ones(len(columns), np.bool_), columns, indptr.astype(kind)), (len(dofs), n))
    return sparse.csr_array(incidence.T.tocsr() @ incidence)


def _weight_map(blocks: ElementMatrices, numbered: sparse.csr_array) -> sparse.csc_array:
    """Sparse map from the weights of elements to the entries of the pattern, (n_entries, n_elements).

    `blocks` are the element matrices; `numbered` is the pattern with its entries counted from 1, columns stored as
    rows. The map shares the array `local` of the blocks where none of its entries is left out.
    """
    n_entries, n_elements = len(numbered.indices), blocks.n_elements
    if not isinstance(blocks, Blocks):
        row, column, element, value = blocks.entries()
        return sparse.coo_array(
            (value, (_entry_indices(numbered, row, column), element)), (n_entries, n_elements)
        ).tocsc()
    entry_indices, counts, values = [], [], []
    step = max(1, _CHUNK_ENTRIES // max(1, blocks.dofs.shape[1] ** 2))
    for first in range(0, n_elements, step):
        chosen = slice(first, first + step)
        row, column, is_stored = blocks.stored(chosen)
        entry_indices.append(_entry_indices(numbered, row, column))
        counts.append(is_stored.sum(axis=(1, 2)))
        values.append(None if is_stored.all() else blocks.local[chosen][is_stored])
    indptr = np.concatenate([[0], np.cumsum(np.concatenate([[], *counts]))])
    kind = index_kind(max(n_entries, int(indptr[-1])))
    indices = np.concatenate([np.zeros(0, kind), *entry_indices]).astype(kind, copy=False)
    if all(part is None for part in values):
        data = blocks.local.reshape(-1)
    else:
        steps = range(0, n_elements, step)
        whole = (blocks.local[f : f + step].ravel() if v is None else v for f, v in zip(steps, values, strict=True))
        data = np.concatenate(list(whole))
    return sparse.csc_array((data, indices, indptr.astype(kind)), (n_entries, n_elements))


def _entry_indices(numbered: sparse.csr_array, row: IntArray, column: IntArray) -> IntArray:
    """Indices from 0 of the entries (row, column), (n,) each, in the pattern `numbered`.

    `numbered` holds the number of each entry, counted from 1, and its rows are the columns of the matrices.
    """
    kind = numbered.indices.dtype
    if not len(row):
        return np.zeros(0, dtype=kind)
    indices: IntArray = np.asarray(numbered[column.astype(kind, copy=False), row.astype(kind, copy=False)]).ravel() - 1
    return indices

"""Degrees of freedom of a structure: all that elements and ties use, and what the free ones make of them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray
from structid.dof import Dof
from structid.errors import InputError
from structid.structure.blocks import Blocks, ElementMatrices, MatrixBlocks
from structid.structure.elements.element import Layer, dof_code, dof_of_code
from structid.structure.supports import Equations


@dataclass(frozen=True, eq=False)
class Numbering:
    """The map u = T q from free degrees of freedom to all of them.

    Attributes
    ----------
    codes : (n_all,) int array
        Codes of all of them in order, see `dof_code`.
    matrix : (n_all, n_free) sparse array
        T.
    free : tuple of int
        Codes of the free ones.
    """

    codes: IntArray
    matrix: sparse.csr_array
    free: tuple[int, ...]


def numbering(codes: Sequence[int], held: frozenset[int], equations: Equations) -> Numbering:
    """The free degrees of freedom, and how the others follow them.

    Parameters
    ----------
    codes : sequence of int
        All codes in order, n_all of them.
    held : frozenset of int
        Codes at zero.
    equations : mapping
        Dependent codes with what they depend on; a dependent may depend on another dependent.

    Raises
    ------
    InputError
        If one is fixed and depends on others too, or constraints run in a circle.
    """
    for code in held & equations.keys():
        raise InputError(
            f"{dof_of_code(code)} is fixed and also depends on others; fix the degrees of freedom it follows"
        )
    free = [code for code in codes if code not in held and code not in equations]
    column = {code: i for i, code in enumerate(free)}
    resolved: dict[int, dict[int, float]] = {code: {code: 1.0} for code in free}
    resolved.update({code: {} for code in held})
    for code in codes:
        _resolve(code, equations, resolved, ())
    rows, columns, values = [], [], []
    for i, code in enumerate(codes):
        for other, coefficient in resolved[code].items():
            rows.append(i)
            columns.append(column[other])
            values.append(coefficient)
    matrix = sparse.csr_array((values, (rows, columns)), shape=(len(codes), len(free)))
    return Numbering(np.array(codes, dtype=np.int64), matrix, tuple(free))


def _resolve(
    code: int, equations: Equations, resolved: dict[int, dict[int, float]], path: tuple[int, ...]
) -> dict[int, float]:
    """`code` in terms of free codes only, kept in `resolved`."""
    if code in resolved:
        return resolved[code]
    if code in path:
        loop = " -> ".join(str(dof_of_code(c)) for c in (*path, code))
        raise InputError(f"constraints run in a circle: {loop}; remove one of them")
    total: dict[int, float] = {}
    for other, coefficient in equations[code].items():
        for free, inner in _resolve(other, equations, resolved, (*path, code)).items():
            total[free] = total.get(free, 0.0) + coefficient * inner
    resolved[code] = total
    return total


def selection(all_dofs: Numbering, nodes: Mapping[int, FloatArray], dofs: Iterable[Dof]) -> sparse.csc_array:
    """Columns that read (or load) `dofs`; see `Structure.selection`."""
    chosen = tuple(dofs)
    known, held = all_dofs.codes, np.diff(all_dofs.matrix.indptr) == 0
    rows = []
    for dof in chosen:
        if dof.node not in nodes:
            near = difflib.get_close_matches(str(dof.node), [str(n) for n in nodes], 1, 0.0)
            raise InputError(f"{dof} is at node {dof.node}, which the structure does not have (nearest: {near[0]})")
        code = dof_code(dof.node, dof.direction)
        row = int(np.searchsorted(known, code))
        if row == len(known) or known[row] != code:
            here = [str(dof_of_code(c).unsigned) for c in known.tolist() if c // 6 == dof.node]
            raise InputError(
                f"{dof} is not part of the structure; node {dof.node} moves in {', '.join(here) or 'nothing'}"
            )
        if held[row]:
            raise InputError(
                f"{dof} is held at zero by the supports; move the sensor or load, free it, or, where its motion was"
                " measured and drives the structure, make it a support of a base ([[structure.base]])"
            )
        rows.append(row)
    if not rows:
        return sparse.csc_array((len(all_dofs.free), 0))
    signs = sparse.diags_array(np.array([float(dof.sign) for dof in chosen]))
    return sparse.csc_array((signs @ all_dofs.matrix[np.array(rows), :]).T)


def free_blocks(all_dofs: Numbering, layer: Layer) -> ElementMatrices:
    """The matrices of a layer on free degrees of freedom."""
    known = all_dofs.codes
    place = np.minimum(np.searchsorted(known, layer.codes), len(known) - 1)
    if layer.whole is not None:
        rows = all_dofs.matrix[place[0], :]
        return MatrixBlocks([rows.T @ layer.whole @ rows])
    position = np.where(known[place] == layer.codes, place, -1)
    return _tied_blocks(position, layer.local, all_dofs.matrix, len(all_dofs.free))


def _tied_blocks(position: IntArray, local: FloatArray, matrix: sparse.csr_array, n_free: int) -> Blocks:
    """Blocks on free degrees of freedom: those of tied elements become T_e' B_e T_e, the others keep their size."""
    counts = np.append(np.diff(matrix.indptr), 0)
    first = np.append(matrix.indices[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0)
    value = np.append(matrix.data[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0.0)
    simple = (counts == 0) | ((counts == 1) & (np.resize(value, counts.shape) == 1.0))
    if simple[position].all():
        dofs = np.where(counts[position] == 1, np.resize(first, counts.shape)[position], -1).astype(np.int64)
        return Blocks(dofs, local, n_free)
    tied = [
        _tied_element(row[row >= 0], block[np.ix_(row >= 0, row >= 0)], matrix)
        for row, block in zip(position, local, strict=True)
    ]
    size = max(len(free) for free, _ in tied)
    dofs = -np.ones((len(tied), size), dtype=np.int64)
    blocks = np.zeros((len(tied), size, size))
    for e, (free, block) in enumerate(tied):
        dofs[e, : len(free)] = free
        blocks[e, : len(free), : len(free)] = block
    return Blocks(dofs, blocks, n_free)


def _tied_element(row: IntArray, block: FloatArray, matrix: sparse.csr_array) -> tuple[IntArray, FloatArray]:
    """Free degrees of freedom of one element and its matrix on them."""
    part = matrix[row, :]
    free = np.unique(part.indices).astype(np.int64)
    dense = part[:, free].toarray() if len(free) else np.zeros((len(row), 0))
    return free, dense.T @ block @ dense

"""Sensitivities of fields to parameters: the forces (dZ/dp) x, and their products with adjoint fields.

For every parameter the derivative of Z is a sum of element matrices, so (dZ/dp) x is a force on the degrees of freedom
of its elements alone. The forces of all parameters are kept as one sparse matrix whose pattern is found once; line by
line only its entries change. A parameter with one element and one with a thousand cost the same an entry.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.structure.blocks import Blocks, ElementMatrices, index_kind

#: Most entries of forces that are held at once.
_CHUNK_ENTRIES = 4_000_000


@dataclass(frozen=True, eq=False)
class WeightedElements:
    """Element matrices and how the parameters weigh them.

    Attributes
    ----------
    blocks : ElementMatrices
    slope : (n_elements, n_params) sparse array
        Derivative of the weights with respect to the parameters.
    kind : int
        Parts of one kind enter the dynamic stiffness alike.
    """

    blocks: ElementMatrices
    slope: sparse.csr_array
    kind: int


@dataclass(frozen=True, eq=False)
class ParameterForces:
    """The forces (dZ/dp) x of all parameters, as a map from fields; made by `parameter_forces`.

    Attributes
    ----------
    indices, indptr : int arrays
        Degrees of freedom that each parameter's forces act on, parameter after parameter.
    maps : tuple of (n_forces, n_dofs) sparse arrays
        From a field to the forces, one for each kind of `WeightedElements`.
    n_dofs : int
    """

    indices: IntArray
    indptr: IntArray
    maps: tuple[sparse.csr_array, ...]
    n_dofs: int

    @property
    def n_params(self) -> int:
        return len(self.indptr) - 1

    def entries(self, factors: ComplexArray, x: NDArray[Any]) -> NDArray[Any]:
        """The forces for fields x (n_dofs, n_x), (n_forces, n_x), with the `factors` (n_maps,) of one line."""
        is_complex = np.iscomplexobj(x)
        flat = np.ascontiguousarray(x)
        flat = flat.view(np.float64) if is_complex else flat
        total: NDArray[Any] = np.zeros((len(self.indices), x.shape[1]), dtype=x.dtype)
        for factor, matrix in zip(factors, self.maps, strict=True):
            if factor == 0:
                continue
            forces = matrix @ flat
            own = forces.view(np.complex128) if is_complex else forces
            total = total + (factor if factor.imag else factor.real) * own
        return total

    def columns(self, entries: NDArray[Any]) -> NDArray[Any]:
        """The forces `entries` (n_forces, n_x) as fields (n_dofs, n_x n_params), parameters fastest."""
        shape = (self.n_params, self.n_dofs)
        wide = [sparse.csr_array((column, self.indices, self.indptr), shape).toarray().T for column in entries.T]
        return np.concatenate(wide, axis=1)

    def contracted(self, factors: ComplexArray, x: NDArray[Any], y: NDArray[Any]) -> list[NDArray[Any]]:
        """y' (dZ/dp) x (no conjugate) for fields x (n_dofs, n_x) and y (n_dofs, n_y): (n_params, n_y) for each x."""
        entries = np.ascontiguousarray(self.entries(factors, x).T)
        rows = np.ascontiguousarray(y)
        shape = (self.n_params, self.n_dofs)
        return [sparse.csr_array((column, self.indices, self.indptr), shape) @ rows for column in entries]


def parameter_forces(parts: Sequence[WeightedElements], n_params: int, n_dofs: int) -> ParameterForces:
    """The `ParameterForces` of element matrices with weights that depend on parameters."""
    keys = [key for part in parts for key in _force_keys(part, n_dofs)]
    pattern = np.unique(np.concatenate([np.zeros(0, np.int64), *keys]))
    shape = (len(pattern), n_dofs)
    maps = []
    for kind in range(1 + max((part.kind for part in parts), default=-1)):
        own = [piece for part in parts if part.kind == kind for piece in _force_maps(part, pattern, n_dofs)]
        if own:
            row, column, value = (np.concatenate([piece[i] for piece in own]) for i in range(3))
            maps.append(sparse.coo_array((value, (row, column)), shape).tocsr())
        else:
            maps.append(sparse.csr_array(shape))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(pattern // n_dofs, minlength=n_params))])
    kind_of = index_kind(max(n_dofs, len(pattern)))
    return ParameterForces((pattern % n_dofs).astype(kind_of), indptr.astype(kind_of), tuple(maps), n_dofs)


def _pairs(part: WeightedElements) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Element, parameter and slope of every weight that depends on a parameter, in stretches that fit in memory."""
    element = np.repeat(np.arange(part.slope.shape[0]), np.diff(part.slope.indptr))
    local = part.blocks.dofs.shape[1] ** 2 if isinstance(part.blocks, Blocks) else 1
    step = max(1, _CHUNK_ENTRIES // max(1, local))
    for first in range(0, len(element), step):
        chosen = slice(first, first + step)
        yield element[chosen], part.slope.indices[chosen].astype(np.int64), part.slope.data[chosen]


def _force_keys(part: WeightedElements, n_dofs: int) -> Iterator[IntArray]:
    """Parameter times n_dofs plus degree of freedom wherever there are forces, each once in a stretch."""
    if not isinstance(part.blocks, Blocks):
        yield np.unique(_matrix_entries(part, n_dofs)[0])
        return
    acts = part.blocks.local.any(axis=2) & (part.blocks.dofs >= 0)
    for element, parameter, _ in _pairs(part):
        yield np.unique((parameter[:, None] * n_dofs + part.blocks.dofs[element])[acts[element]])


def _force_maps(
    part: WeightedElements, pattern: IntArray, n_dofs: int
) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Row in the `pattern` of keys, column and value of d(sum of weights B_e)/dp, summed within each stretch."""
    if not isinstance(part.blocks, Blocks):
        key, column, value = _matrix_entries(part, n_dofs)
        yield np.searchsorted(pattern, key), column, value
        return
    kind = index_kind(max(len(pattern), n_dofs))
    for element, parameter, slope in _pairs(part):
        key = parameter[:, None] * n_dofs + part.blocks.dofs[element]
        row = np.minimum(np.searchsorted(pattern, key.ravel()), len(pattern) - 1).astype(kind)
        _, column, kept = part.blocks.stored(element)
        ends = np.concatenate([[0], np.cumsum(kept.sum(axis=2))]).astype(kind)
        values = (part.blocks.local[element] * slope[:, None, None])[kept]
        each = sparse.csr_array((values, column, ends), (key.size, n_dofs))
        sums = sparse.csc_array((np.ones(key.size), row, np.arange(key.size + 1, dtype=kind)), (len(pattern), key.size))
        forces = (sums.tocsr() @ each).tocoo()
        yield forces.row, forces.col, forces.data


def _matrix_entries(part: WeightedElements, n_dofs: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Of d(sum of weights B_e)/dp: parameter times n_dofs plus row, column and value of every entry."""
    row, column, element, value = part.blocks.entries()
    counts = np.diff(part.slope.indptr)
    keys, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for k in range(int(counts.max(initial=0))):
        own = counts[element] > k
        at = part.slope.indptr[element[own]] + k
        keys.append(part.slope.indices[at].astype(np.int64) * n_dofs + row[own])
        columns.append(column[own])
        values.append(part.slope.data[at] * value[own])
    return np.concatenate(keys), np.concatenate(columns), np.concatenate(values)


def element_products(blocks: ElementMatrices, y: NDArray[Any], x: NDArray[Any]) -> FloatArray:
    """Real parts of the sums over columns of conj(y)' B_e x, for y and x (n_dofs, n_columns): (n_elements,).

    Columns are whatever the sums run over: lines and loads.
    """
    left, right = (np.ascontiguousarray(a, dtype=np.complex128).view(np.float64) for a in (y, x))
    if not isinstance(blocks, Blocks):
        rows, columns, element, value = blocks.entries()
        order = np.argsort(element, kind="stable")
        found = np.zeros(blocks.n_elements)
        step = max(1, _CHUNK_ENTRIES // left.shape[1])
        for first in range(0, len(order), step):
            part = order[first : first + step]
            forms = np.einsum("ij,ij->i", left[rows[part]], right[columns[part]]) * value[part]
            found += np.bincount(element[part], forms, minlength=len(found))
        return found
    left, right = (np.concatenate([a, np.zeros((1, a.shape[1]))]) for a in (left, right))  # row -1: held at 0
    found = np.empty(blocks.n_elements)
    step = max(1, _CHUNK_ENTRIES // (left.shape[1] * blocks.dofs.shape[1]))
    for first in range(0, blocks.n_elements, step):
        chosen = slice(first, first + step)
        products = blocks.local[chosen] @ right[blocks.dofs[chosen]]
        found[chosen] = np.einsum("eij,eij->e", left[blocks.dofs[chosen]], products)
    return found

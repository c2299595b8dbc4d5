"""The stiffness matrix as B'B: what each element is strained by, which keeps digits that the assembled matrix loses.

An element matrix is a sum of squares of a few strains. The matrix that is assembled from them has rounding errors of
eps |K|, in parts of a low eigenvalue eps times the condition number of K; B has eps |B|, the square root of that. The
motions that strain nothing are exact in B.

References
----------
Argyris and Bronlund (1975), The natural factor formulation of the stiffness for the matrix displacement method, Comput.
Methods Appl. Mech. Eng. 5, 97-119 (the same for static solutions).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.fem.matrices.blocks import Blocks
from structid.fem.matrices.contribution import Contribution

#: Part of the largest eigenvalue of a scaled element matrix below which an eigenvalue is rounding.
_ROUNDING = 1e-11


def strain_operator(contributions: Sequence[Contribution], values: FloatArray, n_dofs: int) -> sparse.csr_array | None:
    """The matrix B with K = B'B, sparse (n_strains, n_dofs), without rows that are zero.

    None if an element matrix has a negative eigenvalue beyond rounding, or is a whole matrix of a group.

    Parameters
    ----------
    contributions : sequence of Contribution
        Those of the stiffness are used.
    values : (n_values,) float array
        Property values of the structure.
    n_dofs : int
        Number of free degrees of freedom.
    """
    summed: dict[tuple[tuple[int, ...], bytes], tuple[IntArray, FloatArray]] = {}
    for part in contributions:
        if part.matrix_kind != "stiffness":
            continue
        if not isinstance(part.blocks, Blocks):
            return None
        dofs = part.blocks.dofs
        local: FloatArray = part.blocks.local * part.weights(values)[:, None, None]
        key = (dofs.shape, dofs.tobytes())
        summed[key] = (dofs, local + summed[key][1] if key in summed else local)
    row, column, entry, n_strains = [], [], [], 0
    for dofs, local in summed.values():
        strains = _strains(np.where((dofs >= 0)[:, :, None] & (dofs >= 0)[:, None, :], local, 0.0))
        if strains is None:
            return None
        kept = np.broadcast_to((dofs >= 0)[:, None, :], strains.shape) & (strains != 0)
        number = n_strains + np.arange(strains.shape[0] * strains.shape[1]).reshape(*strains.shape[:2], 1)
        row.append(np.broadcast_to(number, strains.shape)[kept])
        column.append(np.broadcast_to(dofs[:, None, :], strains.shape)[kept])
        entry.append(strains[kept])
        n_strains += number.size
    if not n_strains:
        return sparse.csr_array((0, n_dofs))
    indices = np.concatenate(row), np.concatenate(column)
    operator = sparse.csr_array(sparse.coo_array((np.concatenate(entry), indices), (n_strains, n_dofs)))
    return operator[np.diff(operator.indptr) > 0]


def _strains(local: FloatArray) -> FloatArray | None:
    """B of each of the symmetric matrices `local` = B'B, both (n_elements, n_local, n_local).

    None if a matrix has a negative eigenvalue beyond rounding. Degrees of freedom of an element are scaled to a
    diagonal of 1 before, as rotations of a short beam are far softer than its displacements.
    """
    diagonal = np.diagonal(local, axis1=1, axis2=2)
    if (diagonal < 0).any():
        return None
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    squares, turn = np.linalg.eigh(local / size[:, :, None] / size[:, None, :])
    if (squares < -_ROUNDING * np.maximum(squares[:, -1:], 1.0)).any():
        return None
    roots = np.sqrt(np.where(squares > _ROUNDING * squares[:, -1:], squares, 0.0))
    return np.asarray(roots[:, :, None] * np.swapaxes(turn, 1, 2) * size[:, None, :])

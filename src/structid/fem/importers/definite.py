"""Check that a symmetric matrix is positive semidefinite, as mass and stiffness must be, by its factors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from structid.core.dof import Dof
from structid.core.errors import InputError

_FACTORED_UP_TO = 20_000
#: Eigenvalues of the scaled matrix down to minus this count as zero: five digits, as short text fields have.
_ZERO = 1e-5


def require_semidefinite(name: str, matrix: sparse.csc_array, dofs: Sequence[Dof]) -> None:
    """Raise `InputError` if a symmetric matrix has negative eigenvalues; the message says where, as far as that is known.

    The matrix is scaled to a unit diagonal, so that translations and rotations count alike; eigenvalues down to -1e-5 pass.
    Every pair of rows is looked at; up to 20,000 rows the whole matrix is factorized and the signs of the pivots are counted
    (Sylvester's law of inertia).

    Parameters
    ----------
    name : str
        Name of the matrix, for the message.
    matrix : (n, n) sparse array
    dofs : n degrees of freedom
        Degree of freedom of each row, for the message.
    """
    diagonal = matrix.diagonal()
    low = int(np.argmin(diagonal)) if len(diagonal) else 0
    if len(diagonal) and diagonal[low] < -_ZERO * abs(diagonal).max():
        raise InputError(
            f"`{name}` must be positive semidefinite, but its diagonal is {diagonal[low]:.6g} at {dofs[low].unsigned}; check "
            "signs and numbering, or set `indefinite = true` if this is intended (preload)"
        )
    root = np.sqrt(np.maximum(diagonal, 0.0))
    coordinates = matrix.tocoo()
    limit = (1 + _ZERO) * root[coordinates.row] * root[coordinates.col] + 1e-14 * abs(diagonal).max(initial=0.0)
    over = (coordinates.row != coordinates.col) & (abs(coordinates.data) > limit)
    if over.any():
        at = int(np.argmax(np.where(over, abs(coordinates.data), 0.0)))
        i, j = coordinates.row[at], coordinates.col[at]
        raise InputError(
            f"`{name}` must be positive semidefinite, but the entry of {dofs[i].unsigned} and {dofs[j].unsigned} is "
            f"{coordinates.data[at]:.6g} beside {diagonal[i]:.6g} and {diagonal[j]:.6g} on the diagonal (in {int(over.sum()) // 2} "
            "pairs); entries are missing or out of place, or set `indefinite = true` if this is intended (preload)"
        )
    used = np.flatnonzero(root > 0)
    if 0 < len(used) <= _FACTORED_UP_TO:
        scaled = sparse.diags_array(1 / root[used]) @ matrix[used][:, used] @ sparse.diags_array(1 / root[used])
        count = _count_negative_pivots(sparse.csc_array(scaled + _ZERO * sparse.eye_array(len(used))))
        if count:
            raise InputError(
                f"`{name}` must be positive semidefinite, but has {count} negative eigenvalues; entries are missing or wrong, "
                "or set `indefinite = true` if this is intended (preload)"
            )


def _count_negative_pivots(matrix: sparse.csc_array) -> int:
    """Number of negative eigenvalues of a symmetric matrix, by L D L'.

    At least 1 if a diagonal pivot vanishes; 1 if the matrix is singular.
    """
    try:
        factors = splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return 1
    count = int((factors.U.diagonal() < 0).sum())
    return count if np.array_equal(factors.perm_r, factors.perm_c) else max(count, 1)

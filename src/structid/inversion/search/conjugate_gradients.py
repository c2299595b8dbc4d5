"""Conjugate gradients for the normal equations of a linearization without a Jacobian, and their preconditioner."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.linearization import OperatorLinearization, solved_by

#: x of a system of equations for its right-hand side.
Solver = Callable[[FloatArray], FloatArray]
#: What the data add to the preconditioner, as a part of their own diagonal.
_DATA_PART = 1e-3
#: The same where the Jacobian is stored: as little as rounding allows.
_STORED_PART = 1e-5
#: Keeps the small system of a preconditioner regular, as a part of its mean eigenvalue.
_REGULAR = 1e-14
#: Most rows of a stored Jacobian that enter the preconditioner, and how many are solved for at once.
_MOST_ROWS, _RIGHT_SIDES = 6000, 256


def preconditioner(linearization: OperatorLinearization, damping: FloatArray) -> Solver:
    """Function that solves (S + U C^-1 U') x = b, the preconditioner for the damped normal equations.

    S = P'P + damping + a small part of diag(J'J), with P the prior rows and `damping` (n_params,) a diagonal. U = J'
    and C = 1 if the data rows J are stored and at most 6000, else U C^-1 U' is `linearization.sketch`, a low-rank
    approximation of J'J. The part is 1e-5 with stored rows, else 1e-3. The function takes b and gives x, (n_params,).
    """
    from scipy.linalg import cho_factor, cho_solve

    is_whole = linearization.jacobian is not None and len(linearization.jacobian) <= _MOST_ROWS
    part = _STORED_PART if is_whole else _DATA_PART
    solve = solved_by(linearization.prior, damping + part * linearization.data_squares)
    wide: FloatArray
    inner: FloatArray
    if is_whole and linearization.jacobian is not None:
        wide, inner = linearization.jacobian.T, np.eye(len(linearization.jacobian))
    else:
        wide, inner = linearization.sketch
    across = np.empty(wide.shape, order="F")
    for first in range(0, wide.shape[1], _RIGHT_SIDES):
        across[:, first : first + _RIGHT_SIDES] = solve(np.asfortranarray(wide[:, first : first + _RIGHT_SIDES]))
    rows = wide.T @ across + inner
    rows[np.diag_indices_from(rows)] += _REGULAR * np.trace(rows) / max(len(rows), 1)
    factor = cho_factor(0.5 * (rows + rows.T), lower=True, overwrite_a=True, check_finite=False)

    def solved(right: FloatArray) -> FloatArray:
        first = solve(right)
        return np.asarray(first - across @ cho_solve(factor, wide.T @ first, check_finite=False))

    return solved


def conjugate_gradients(
    apply: Callable[[FloatArray], FloatArray],
    right: FloatArray,
    precondition: Solver,
    tolerance: float,
    most: int,
) -> tuple[FloatArray, int, float]:
    """Solution x of A x = `right` for positive definite A, the number of iterations, and the relative residual.

    `apply` multiplies by A, `precondition` solves approximately. The residual is in the norm of the preconditioner.
    Iterations end at a relative residual of `tolerance`, or after `most`; the residual is infinite where A or the
    preconditioner is not positive along a direction. `right` (n,) of zeros gives zeros, without an iteration.

    References
    ----------
    Nocedal and Wright (2006), Numerical Optimization, algorithm 5.3.
    """
    x = np.zeros_like(right)
    residual = np.array(right)
    direction = better = precondition(residual)
    size = first = float(residual @ better)
    if not first > 0:
        return x, 0, 0.0 if first == 0 else float("inf")
    for count in range(1, most + 1):
        product = apply(direction)
        curvature = float(direction @ product)
        if not curvature > 0:  # 0 where nothing sees the direction; NaN where the model broke down
            return x, count, float("inf")
        length = size / curvature
        x = x + length * direction
        residual = residual - length * product
        better = precondition(residual)
        size, before = max(float(residual @ better), 0.0), size
        if size <= tolerance**2 * first:
            return x, count, float(np.sqrt(size / first))
        direction = better + (size / before) * direction
    return x, most, float(np.sqrt(size / first))

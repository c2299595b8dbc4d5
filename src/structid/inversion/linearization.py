"""A whitened residual with its derivative at one point, as a Jacobian or as products; and the cache of the last point.

Normal equations of products are solved by conjugate gradients with a preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Generic, TypeVar

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from structid.core.arrays import FloatArray

#: Directions of a sketch at most; the part of diag(J'J) that stands for what the data add; and what keeps a matrix regular.
_SKETCHED, _DATA_PART, _LEAST = 300, 1e-3, 1e-12
#: Rows of a stretch that is factorized near the processor: these at least, and so many for each column.
_NEAR_ROWS, _OF_COLUMN = 256, 8
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Linearization:
    """Whitened residual and its derivative at one point.

    Attributes
    ----------
    residual : (n_residuals,) float array
        Data rows first, then one row for each prior; unit variance each where model and noise are right.
    jacobian : (n_residuals, n_params) float array
        Derivative with respect to the free variables.
    n_eliminated : int
        Unknowns that the problem solved for inside; each takes one degree of freedom from chi-square.
    """

    residual: FloatArray
    jacobian: FloatArray
    n_eliminated: int = 0

    @property
    def n_params(self) -> int:
        return self.jacobian.shape[1]

    def product(self, v: FloatArray) -> FloatArray:
        """J v, (n_residuals,), for a change v (n_params,) of the free variables."""
        return self.jacobian @ v

    def triangle(self) -> FloatArray:
        """Triangle R of the QR factorization of [J r], (n_params + 1, n_params + 1), fewer rows if there are fewer residuals.

        The last column holds Q'r; its last entry is, up to sign, the norm of the residual that no step reduces.
        """
        return triangle_of(np.column_stack([self.jacobian, self.residual]))


def triangle_of(rows: FloatArray) -> FloatArray:
    """Upper triangle R of the QR factorization of `rows` (n_rows, n_columns), with min(n_rows, n_columns) rows.

    Rows of R have the sign that NumPy gives. Many rows are factorized in chunks, whose triangles are stacked and
    factorized again, in a fifth of the time.
    """
    width = rows.shape[1]
    size = max(_NEAR_ROWS, _OF_COLUMN * width)
    whole = len(rows) // size * size
    if not whole:
        return np.asarray(np.linalg.qr(rows, mode="r"))
    tops = np.asarray(np.linalg.qr(rows[:whole].reshape(whole // size, size, width), mode="r"))
    return np.asarray(np.linalg.qr(np.concatenate([tops.reshape(len(tops) * width, width), rows[whole:]]), mode="r"))


def solve_upper(triangle: FloatArray, right: FloatArray, transposed: bool = False) -> FloatArray:
    """Solution x of R x = b, or of R'x = b if `transposed`, for the upper `triangle` R (n, n) and b, `right`, (n,) or (n, k).

    It has the digits of `scipy.linalg.solve_triangular`, whose checks take several times as long as a small system. The
    result has the shape of `right`.

    Raises
    ------
    LinAlgError
        If R is singular.
    """
    if not right.size:  # LAPACK takes no empty system
        return np.zeros_like(right)
    if triangle.flags.f_contiguous:
        solution, info = lapack.dtrtrs(triangle, right, trans=int(transposed))
    else:  # a row-major R is the column-major R' of its memory
        solution, info = lapack.dtrtrs(triangle.T, right, lower=1, trans=int(not transposed))
    if info > 0:
        raise np.linalg.LinAlgError(f"the triangle is singular at its diagonal entry {info}")
    return np.asarray(solution)


@dataclass(frozen=True, eq=False)
class OperatorLinearization:
    """Whitened residual at one point, and what its derivative does to vectors.

    Attributes
    ----------
    residual : (n_residuals,) float array
        Data rows first, then those of the priors.
    forward : callable
        J v of the data rows, (n_params,) to (n_data,).
    adjoint : callable
        J' u of the data rows, (n_data,) to (n_params,).
    data_squares : (n_params,) float array
        Diagonal of J'J of the data rows.
    prior : (n_priors, n_params) sparse array
        Derivative of the rows of the priors.
    words : str
        How the products are made.
    jacobian : (n_data, n_params) float array, optional
        Of the data rows, where it is stored nevertheless.
    """

    residual: FloatArray
    forward: Callable[[FloatArray], FloatArray]
    adjoint: Callable[[FloatArray], FloatArray]
    data_squares: FloatArray
    prior: sparse.csr_array
    words: str = ""
    jacobian: FloatArray | None = None

    n_eliminated: ClassVar[int] = 0

    @property
    def n_data(self) -> int:
        return len(self.residual) - self.prior.shape[0]

    @property
    def n_params(self) -> int:
        return len(self.data_squares)

    def product(self, v: FloatArray) -> FloatArray:
        """J v, (n_residuals,), data rows before prior rows, for a change v (n_params,) of the free variables."""
        return np.concatenate([self.forward(v), self.prior @ v])

    def transposed(self, u: FloatArray) -> FloatArray:
        """J'u, (n_params,), for u (n_residuals,), data rows before prior rows."""
        return self.adjoint(u[: self.n_data]) + self.prior.T @ u[self.n_data :]

    def information(self, v: FloatArray) -> FloatArray:
        """J'J v, (n_params,), of data and prior rows, for a change v (n_params,) of the free variables."""
        return self.adjoint(self.forward(v)) + self.prior.T @ (self.prior @ v)

    @cached_property
    def squares(self) -> FloatArray:
        """Diagonal of J'J, all rows, (n_params,)."""
        return self.data_squares + np.asarray(self.prior.multiply(self.prior).sum(axis=0)).ravel()

    @cached_property
    def sketch(self) -> tuple[FloatArray, FloatArray]:
        """Y (n_params, k) and C (k, k) of the randomized low-rank approximation J'J = Y C^-1 Y' of the data.

        Y = J'J W and C = W'J'J W with W spanning S^-1 J'G, G Gaussian, S the information of the priors with a part of
        diag(J'J): it takes 3 k products, and holds the directions that the data see best beside the priors. J are the
        data rows, and k = min(n_data, n_params, 300).

        References
        ----------
        Frangella, Tropp and Udell (2023), SIAM J. Matrix Anal. Appl. 44, 718, Eq. (2.2).
        """
        count = min(self.n_data, self.n_params, _SKETCHED)
        generator = np.random.default_rng(0)
        solve = solved_by(self.prior, _DATA_PART * self.data_squares + _LEAST * self.squares)
        seen = [solve(self.adjoint(generator.standard_normal(self.n_data))) for _ in range(count)]
        basis = np.linalg.qr(np.array(seen).T)[0]
        moved = np.array([self.forward(column) for column in basis.T]).T
        image = np.array([self.adjoint(column) for column in moved.T]).T
        return image, moved.T @ moved


def solved_by(prior: sparse.csr_array, diagonal: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Function that solves (P'P + D) x = b for sparse prior rows P (n_priors, n_params) and a diagonal D (n_params,).

    It takes and gives (n_params,). Where D is 0, 1e-12 of the diagonal of P'P takes its place, or 1 where both are
    zero.
    """
    from scipy.sparse.linalg import splu

    own = np.asarray(prior.multiply(prior).sum(axis=0)).ravel()
    sound = np.where(diagonal > 0, diagonal, np.where(own > 0, _LEAST * own, 1.0))
    matrix = sparse.csc_matrix(prior.T @ prior + sparse.diags_array(sound))
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return lambda right: np.asarray(factor.solve(right))


class LastEvaluation(Generic[T]):
    """The evaluation at the last point, where a step is tried and taken, and tests follow; a pickled copy is empty."""

    def __init__(self) -> None:
        self._kept: tuple[bytes, T] | None = None

    def __reduce__(self) -> tuple[type[LastEvaluation[T]], tuple[()]]:
        return LastEvaluation, ()

    def at(self, theta: FloatArray, evaluate: Callable[[FloatArray], T]) -> T:
        """Evaluation at the free variables `theta` (n_params,): the cached one, else by `evaluate`, which is then cached."""
        evaluation = self.known(theta)
        if evaluation is None:
            evaluation = evaluate(theta)
            self.keep(theta, evaluation)
        return evaluation

    def known(self, theta: FloatArray) -> T | None:
        """The evaluation that is kept of exactly the free variables `theta` (n_params,); None if there is none."""
        return self._kept[1] if self._kept is not None and self._kept[0] == theta.tobytes() else None

    def keep(self, theta: FloatArray, evaluation: T) -> None:
        self._kept = theta.tobytes(), evaluation

    def taken(self, theta: FloatArray) -> T | None:
        """The evaluation that `known` gives of `theta` (n_params,); nothing is kept afterwards."""
        evaluation, self._kept = self.known(theta), None
        return evaluation


#: x of a system of equations for its right-hand side.
Solver = Callable[[FloatArray], FloatArray]
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

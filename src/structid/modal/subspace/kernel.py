"""One kernel for all methods: a block Hankel matrix, its singular vectors, and poles by shift invariance.

The column space of the matrix is that of the observability matrix O = [C; C A; C A^2; ...]. Left singular vectors
U_n stand for O in another basis, and A_n = U_n(without the last block row)^+ U_n(without the first). Matrices of all
orders are leading parts of those of the greatest: one QR decomposition serves them all.

References
----------
Doehler and Mevel (2012), Fast multi-order computation of system matrices in subspace-based system identification,
Control Eng. Pract. 20, 882-894.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.modal.correlations import RecordPiece, ScaledMotion
from structid.modal.poles.poles import Poles, state_poles

_LARGE, _FEW = 200, 4  # rows or columns, and times the vectors wanted, from which on Lanczos bidiagonalization pays
MatrixParts = Callable[[ScaledMotion, Sequence[RecordPiece]], Iterator[FloatArray]]


@dataclass(frozen=True, eq=False)
class Subspace:
    """Singular vectors of the matrix that a method forms, and the transition matrices of all orders.

    Attributes
    ----------
    data : ScaledMotion
        Channels the first block row stands for.
    left, singular, right : arrays (n_rows, rank), (rank,), (n_columns, rank)
        Singular value decomposition of the matrix, complete where there are `windows` for a covariance.
    inverse, moved : (max_order, max_order) float arrays
        A_n = inverse[:n, :n] moved[:n, :n]; the inverse is that of a triangular matrix, whose leading parts are inverses too.
    parts : function of (data, windows), or None
        Yields what each piece of the records contributes to the matrix; their sum is the matrix.
    windows : tuple of RecordPiece
        The pieces.
    method : str
        Name of the method.
    """

    data: ScaledMotion
    left: FloatArray
    singular: FloatArray
    right: FloatArray
    inverse: FloatArray
    moved: FloatArray
    parts: MatrixParts | None
    windows: tuple[RecordPiece, ...]
    method: str

    @property
    def max_order(self) -> int:
        return len(self.inverse)

    def transition(self, order: int) -> FloatArray:
        """State matrix A of the model with `order` states, (order, order), for one sample step."""
        return self.inverse[:order, :order] @ self.moved[:order, :order]

    def output(self, order: int) -> FloatArray:
        """Output matrix C of the model with `order` states, (n_channels, order), in the units of the channels."""
        return self.data.scale[:, None] * self.left[: self.data.n_channels, :order]


def shift_invariant(
    matrix: FloatArray,
    data: ScaledMotion,
    method: str,
    max_order: int,
    parts: MatrixParts | None = None,
    windows: Sequence[RecordPiece] = (),
    complete: bool = False,
) -> Subspace:
    """Subspace from the singular value decomposition of a block Hankel `matrix` whose block rows are one sample apart.

    Parameters
    ----------
    matrix : (n_rows, n_columns) float array
        A block row holds all channels of `data`.
    data : ScaledMotion
        The records behind it.
    method : str
        Name of the subspace method, in words.
    max_order : int
        Largest model order; lowered where the matrix has less room.
    parts : callable, optional
        Maps data and windows to an iterator over the contribution of each window to the matrix.
    windows : sequence of RecordPiece
        Windows for a covariance; with several the decomposition is complete.
    complete : bool
        Whether all singular vectors are computed.

    Returns
    -------
    Subspace
        Singular vectors and values, from which the transition matrix of a model of any order up to `max_order` follows,
        with `data`, `parts`, `windows` and `method` as given.

    Raises
    ------
    InputError
        If the block rows hold fewer than `max_order` independent states.
    """
    left, singular, right = _singular_vectors(matrix, max_order, complete or len(windows) > 1)
    m, n = data.n_channels, min(max_order, len(singular), len(matrix) - data.n_channels)
    q, triangle = np.linalg.qr(left[:-m, :n])
    _require_full(triangle, n)
    inverse = linalg.solve_triangular(triangle, np.eye(n))
    return Subspace(data, left, singular, right.T, inverse, q.T @ left[m:, :n], parts, tuple(windows), method)


def _singular_vectors(matrix: FloatArray, rank: int, complete: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Singular value decomposition (U, s, V') of `matrix`, values decreasing: complete, or the leading `rank` of a large one.

    It is complete if `complete`, or if the smaller side is below 200 or 4 `rank`. U is (n_rows, k), s (k,) and V' (k,
    n_columns), with k the number of values.
    """
    if complete or min(matrix.shape) < max(_LARGE, _FEW * rank):
        return tuple(linalg.svd(matrix, full_matrices=False))
    from scipy.sparse.linalg import svds

    left, singular, right = svds(matrix, k=rank, solver="propack", rng=np.random.default_rng(0))
    order = np.argsort(-singular, kind="stable")
    return left[:, order], singular[order], right[order]


def _require_full(triangle: FloatArray, order: int) -> None:
    if np.abs(np.diag(triangle)).min(initial=1.0) <= 1e-14:
        raise InputError(f"`orders` must be lower than {order}: the block rows hold fewer states; raise `block_rows`")


def poles_of_orders(subspace: Subspace, orders: Sequence[int] | IntArray) -> tuple[Poles, ...]:
    """Poles and shapes of the model of every order, one `Poles` for each of `orders` (numbers of states), in order.

    Raises
    ------
    InputError
        If an order is not between 1 and `subspace.max_order`, the greatest that the matrix has room for.
    """
    for order in orders:
        if not 1 <= order <= subspace.max_order:
            raise InputError(
                f"`orders` must lie from 1 to {subspace.max_order}, got {order}; raise `block_rows` for more"
            )
    rate = subspace.data.sampling_rate
    return tuple(
        state_poles(subspace.transition(int(n)), subspace.output(int(n)), rate, subspace.singular[: int(n)])
        for n in orders
    )

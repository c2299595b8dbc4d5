"""The subspace methods: each forms a matrix whose columns span the observability matrix, whatever moves the structure.

``pencil``: with F(t) = [y(t+1); ...; y(t+i)] and P(t) = [y(t); ...; y(t-i+1)], G = sum of F P' over one window for all
lags has the column space of the observability matrix whatever P is: free decays are exact with damping and with more modes
than channels, and ambient motion is treated as by covariance-driven subspace identification. Lag zero, which holds white
measurement noise, is left out. It is the eigensystem realization algorithm with data correlations (ERA/DC). With i = 1, an
offset of 0 and a second difference for the shift it is Norris's quotient.

``ssi_cov``: block Hankel matrix of R_1 .. R_(2i-1), each with divisor N - k, for stationary motion; a free decay is
biased by it, since each lag has another window. ``ssi_data``: future samples projected on past ones, unweighted.

References
----------
Juang, Cooper and Wright (1988), An eigensystem realization algorithm using data correlations (ERA/DC), Control
Theory Adv. Technol. 4; Norris (1986), Eqs. (5.10) to (5.33), for its limit; Van Overschee and De Moor (1996), Subspace
identification for linear systems, chapter 3; Peeters and De Roeck (1999), Reference-based stochastic subspace
identification for output-only modal analysis, Mech. Syst. Signal Process. 13.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray
from structid.modal.correlations import (
    RecordPiece,
    ScaledMotion,
    lag_hankels,
    pieces,
    require_length,
    window_hankel,
    window_hankels,
)
from structid.modal.subspace.kernel import Subspace, shift_invariant

_REGULAR = 1e-4


def pencil(data: ScaledMotion, block_rows: int, max_order: int, n_pieces: int = 1) -> Subspace:
    """Subspace of the matrix pencil of output covariances (block Hankel matrix).

    Block (i, j) of the matrix, i and j from 0, is the mean of y(t + 1 + i) y(t - j)' over all instants t with all
    delays.

    Parameters
    ----------
    data : ScaledMotion
        Free decays or ambient motion; covariances of several records add up, which separates repeated modes.
    block_rows : int
        Delays i on either side, at least 2.
    max_order : int
        Greatest number of states wanted.
    n_pieces : int
        Number of windows of the data for the covariance of the result.

    Returns
    -------
    Subspace
        Singular vectors and values of the matrix, from which models of up to `max_order` states follow, and the
        windows.

    Raises
    ------
    InputError
        If a record is too short for the delays.
    """
    require_length(data, 2 * block_rows + 1, max_order)
    windows = pieces(data, block_rows - 1, block_rows, n_pieces)
    parts = partial(window_hankels, rows=block_rows, columns=block_rows, offset=1)
    matrix = np.sum(list(parts(data, windows)), axis=0)
    return shift_invariant(matrix, data, "covariance pencil", max_order, parts, windows)


def ssi_cov(data: ScaledMotion, block_rows: int, max_order: int, n_pieces: int = 1) -> Subspace:
    """Subspace by covariance-driven stochastic subspace identification.

    Block (i, j) of the matrix, i and j from 0, is the correlation of the channels at lag 1 + i + j, each lag the mean
    over all pairs of samples that the records hold.

    Parameters
    ----------
    data : ScaledMotion
        Free decays or ambient motion.
    block_rows : int
        Delays on either side, at least 2.
    max_order : int
        Greatest number of states.
    n_pieces : int
        Number of windows of the data for the covariance of the result.

    Returns
    -------
    Subspace
        Singular vectors and values of the matrix, from which models of up to `max_order` states follow, and the
        windows.

    Raises
    ------
    InputError
        If a record is too short for the delays.
    """
    require_length(data, 2 * block_rows, max_order)
    windows = pieces(data, 0, 2 * block_rows, n_pieces)
    parts = partial(lag_hankels, rows=block_rows, columns=block_rows, offset=1)
    matrix = np.sum(list(parts(data, windows)), axis=0)
    return shift_invariant(matrix, data, "covariance-driven SSI", max_order, parts, windows)


def ssi_data(data: ScaledMotion, block_rows: int, max_order: int, n_pieces: int = 1) -> Subspace:
    """Subspace by data-driven stochastic subspace identification.

    F and P stack i = `block_rows` future and past samples of the n channels in their columns, one for each of the N
    samples. With L L' the sum of P P' over the window, the projection is the sum of F P' times L^-T. Where the past is
    too close to singular for that (L's diagonal spans more than four decades, as in motion without noise), it comes
    from a QR decomposition of all samples, which costs 8 i^2 n^2 N. `parts` of the result, the same sums over pieces,
    are multiplied by L^-T too; they are None where the past is singular.

    Parameters
    ----------
    data : ScaledMotion
        Free decays or ambient motion.
    block_rows : int
        Delays on either side, at least 2.
    max_order : int
        Greatest number of states.
    n_pieces : int
        Pieces of the data for the covariance of the result.

    Returns
    -------
    Subspace
        Singular vectors and values of the projection, from which models of up to `max_order` states follow, and the
        pieces; without pieces where the past is singular.

    Raises
    ------
    InputError
        If a record is too short for the delays.
    """
    require_length(data, 2 * block_rows, max_order)
    windows = pieces(data, block_rows - 1, block_rows, n_pieces)
    whole = pieces(data, block_rows - 1, block_rows)
    gram = np.zeros((block_rows * data.n_channels,) * 2)
    for piece in whole:
        lagged = window_hankel(
            data.series[piece.record], piece.start, piece.stop, block_rows, block_rows, 1 - block_rows
        )
        gram += _forward(lagged, block_rows)
    past, matrix = _cholesky(gram, _REGULAR), None
    if past is None:
        width = len(gram)
        triangle = delayed_triangle(data, 2 * block_rows)
        past, matrix = triangle[:width, :width], triangle[:width, width:].T
        size = np.abs(np.diag(past))
        if len(triangle) < 2 * width or size.min() <= 1e-10 * size.max():
            return shift_invariant(matrix, data, "data-driven SSI", max_order)
    parts = partial(_window_projections, rows=block_rows, past=past)
    matrix = np.sum(list(parts(data, whole)), axis=0) if matrix is None else matrix
    return shift_invariant(matrix, data, "data-driven SSI", max_order, parts, windows)


def _forward(matrix: FloatArray, rows: int) -> FloatArray:
    """`matrix` with its `rows` block columns in reverse order: from backwards in time to forwards."""
    return np.asarray(matrix.reshape(len(matrix), rows, -1)[:, ::-1].reshape(len(matrix), -1))


def _cholesky(gram: FloatArray, least: float) -> FloatArray | None:
    """Upper triangle R (n, n) with R' R = `gram`; None if `gram` is not positive definite, or if R is nearly singular.

    It is so if the smallest entry on the diagonal of R is at most `least` times the largest.
    """
    try:
        triangle = np.asarray(linalg.cholesky(gram))
    except np.linalg.LinAlgError:
        return None
    size = np.diag(triangle)
    return triangle if size.min() > least * size.max() else None


def _window_projections(
    data: ScaledMotion, windows: Sequence[RecordPiece], rows: int, past: FloatArray
) -> Iterator[FloatArray]:
    """Contribution of each window, in order, to the projection of future on past samples: F P' times the inverse of R.

    `rows` is the number of block rows, `past` the upper triangle R with R' R the sum of P P' over all windows. Each matrix is
    (rows * n_channels, rows * n_channels).
    """
    total = sum(piece.stop - piece.start for piece in windows)
    for part in window_hankels(data, windows, rows, rows, 1):
        yield total * linalg.solve_triangular(past.T, _forward(part, rows).T, lower=True).T


def delayed_triangle(data: ScaledMotion, rows: int) -> FloatArray:
    """Upper triangle R of the QR decomposition of delayed samples [y(t), ..., y(t + rows - 1)], a row for each instant.

    All instants of all records count at which `rows` samples are left; channels are contiguous within a delay.

    Returns
    -------
    (k, rows * n_channels) float array
        k is rows * n_channels, or the number of instants if that is less.
    """
    width = rows * data.n_channels
    triangle = np.zeros((0, width))
    for y in data.series:
        delayed = np.lib.stride_tricks.sliding_window_view(y, rows, axis=0).transpose(0, 2, 1)
        size = max(4 * width, 1024)
        for start in range(0, len(delayed), size):
            chunk = delayed[start : start + size].reshape(-1, width)
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, chunk]), mode="r"))
    return triangle

"""Stochastic subspace identification of ambient motion, driven by covariances or by data.

References
----------
Van Overschee and De Moor (1996), Subspace identification for linear systems, chapter 3; Peeters and De Roeck (1999),
Reference-based stochastic subspace identification for output-only modal analysis, Mech. Syst. Signal Process. 13.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy import linalg

from structid.arrays import FloatArray
from structid.modal.correlations import (
    Outputs,
    Piece,
    lag_hankels,
    outputs,
    pieces,
    require_length,
    window_hankel,
    window_hankels,
)
from structid.modal.subspace.kernel import Subspace, delayed_triangle, shift_invariant
from structid.records import TimeRecord

_REGULAR = 1e-4


def ssi_cov(
    records: TimeRecord | Sequence[TimeRecord] | Outputs, block_rows: int, max_order: int, n_pieces: int = 1
) -> Subspace:
    """Covariance-driven: block Hankel matrix of R_1 .. R_(2i-1), each with divisor N - k; for stationary motion.

    A free decay is biased by it, since each lag has another window; use `pencil` there.
    """
    data = outputs(records)
    require_length(data, 2 * block_rows, max_order)
    windows = pieces(data, 0, 2 * block_rows, n_pieces)
    parts = partial(lag_hankels, rows=block_rows, columns=block_rows, offset=1)
    return shift_invariant(
        np.sum(list(parts(data, windows)), axis=0), data, "covariance-driven SSI", max_order, parts, windows
    )


def ssi_data(
    records: TimeRecord | Sequence[TimeRecord] | Outputs, block_rows: int, max_order: int, n_pieces: int = 1
) -> Subspace:
    """Data-driven, unweighted: future samples projected on past ones.

    With L L' the sum of P P' over the window, the projection is the pencil's sum of F P' times L^-T. Where the past
    is too close to singular for that (L's diagonal spans more than four decades, as in motion without noise), it
    comes from a QR decomposition of all samples, which costs 8 i^2 n^2 N for i delays and n channels. `parts` are
    weighted by L^-T in turn; they are None where the past is singular.
    """
    data = outputs(records)
    require_length(data, 2 * block_rows, max_order)
    windows = pieces(data, block_rows - 1, block_rows, n_pieces)
    whole = pieces(data, block_rows - 1, block_rows)
    gram = np.zeros((block_rows * data.n_channels,) * 2)
    for piece in whole:
        lagged = window_hankel(
            data.series[piece.record], piece.start, piece.stop, block_rows, block_rows, 1 - block_rows
        )
        gram += _forward(lagged, block_rows)
    past = _cholesky(gram, _REGULAR)
    if past is not None:
        parts = partial(_projected, rows=block_rows, past=past)
        matrix = np.sum(list(parts(data, whole)), axis=0)
        return shift_invariant(matrix, data, "data-driven SSI", max_order, parts, windows)
    width = len(gram)
    triangle = delayed_triangle(data, 2 * block_rows)
    past = triangle[:width, :width]
    size = np.abs(np.diag(past))
    if len(triangle) < 2 * width or size.min() <= 1e-10 * size.max():
        return shift_invariant(triangle[:width, width:].T, data, "data-driven SSI", max_order)
    parts = partial(_projected, rows=block_rows, past=past)
    return shift_invariant(triangle[:width, width:].T, data, "data-driven SSI", max_order, parts, windows)


def _forward(matrix: FloatArray, rows: int) -> FloatArray:
    """Columns of a past that runs backwards in time, as the pencil's does, in order of time."""
    return np.asarray(matrix.reshape(len(matrix), rows, -1)[:, ::-1].reshape(len(matrix), -1))


def _cholesky(gram: FloatArray, least: float) -> FloatArray | None:
    """Upper triangle R with R' R = `gram`; None where its diagonal spans more than 1 / `least`."""
    try:
        triangle = np.asarray(linalg.cholesky(gram))
    except np.linalg.LinAlgError:
        return None
    size = np.diag(triangle)
    return triangle if size.min() > least * size.max() else None


def _projected(data: Outputs, windows: Sequence[Piece], rows: int, past: FloatArray) -> Iterator[FloatArray]:
    """Parts of the projection: sums of F P' of every piece, times the inverse of the past's triangle."""
    total = sum(piece.stop - piece.start for piece in windows)
    for part in window_hankels(data, windows, rows, rows, 1):
        yield total * linalg.solve_triangular(past.T, _forward(part, rows).T, lower=True).T

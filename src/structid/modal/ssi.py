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
from structid.modal.correlations import Outputs, Piece, lag_hankels, outputs, pieces, require_length, window_hankels
from structid.modal.subspace import Subspace, delayed_triangle, shift_invariant
from structid.records import TimeRecord


def ssi_cov(records: TimeRecord | Sequence[TimeRecord], block_rows: int, max_order: int, n_pieces: int = 1) -> Subspace:
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
    records: TimeRecord | Sequence[TimeRecord], block_rows: int, max_order: int, n_pieces: int = 1
) -> Subspace:
    """Data-driven, unweighted: future samples projected on past ones by a QR decomposition.

    Its projection is the fixed-window covariance matrix of the pencil times the inverse triangle of the past, by
    which `parts` are weighted in turn; they are None where the past is singular.
    """
    data = outputs(records)
    require_length(data, 2 * block_rows, max_order)
    width = block_rows * data.n_channels
    triangle = delayed_triangle(data, 2 * block_rows)
    past = triangle[:width, :width]
    windows = pieces(data, block_rows - 1, block_rows, n_pieces)
    size = np.abs(np.diag(past))
    regular = len(triangle) == 2 * width and size.min() > 1e-10 * size.max()
    parts = partial(_projected, rows=block_rows, past=past) if regular else None
    return shift_invariant(triangle[:width, width:].T, data, "data-driven SSI", max_order, parts, windows)


def _projected(data: Outputs, windows: Sequence[Piece], rows: int, past: FloatArray) -> Iterator[FloatArray]:
    """Parts of the projection: sums of F P' of every piece, times the inverse of the past's triangle."""
    total = sum(piece.stop - piece.start for piece in windows)
    m = data.n_channels
    for part in window_hankels(data, windows, rows, rows, 1):
        # the pencil's past runs backwards in time, the triangle's forwards
        forward = part.reshape(-1, rows, m)[:, ::-1].reshape(-1, rows * m)
        yield total * linalg.solve_triangular(past.T, forward.T, lower=True).T

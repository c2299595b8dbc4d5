"""What a record's linear unknowns leave of its misfit at one point of the parameters, and how it is kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.arrays import ComplexArray, FloatArray

#: Columns with singular values below this part of the largest count as dependent.
_DEPENDENT = 1e-10
#: An evaluation is kept for its derivative where it takes no more than this; rows of a block of the orthogonalization.
_KEPT_BYTES, _BLOCK_ROWS = 2e8, 1024


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What is known of a `SpectraProblem` at one point, its linear unknowns solved for.

    Attributes
    ----------
    y : (n_frequencies, n_dofs, n_outputs) complex array
        Motions under unit forces at the sensors.
    read : (n_frequencies, n_outputs) complex array
        What sensors read over the displacement.
    forced : (n_frequencies, n_outputs, n_inputs) complex array
        The part of each likeliest force in each reading.
    free : (n_frequencies, n_outputs) complex array
        The part of the transient but its polynomials.
    motion : (n_frequencies, n_dofs, 1) complex array
    aliased : (n_frequencies, n_outputs, n_inputs) complex array
        What readings hold of the likeliest forces through aliases, in parts of the response far above all modes.
    whitening : (n_frequencies, n_outputs, n_outputs) complex array
    basis : (n_data, rank) float array
        What the linear unknowns can explain of the whitened data.
    data : (n_data,) float array
    """

    y: ComplexArray
    read: ComplexArray
    forced: ComplexArray
    free: ComplexArray
    motion: ComplexArray
    aliased: ComplexArray
    whitening: ComplexArray
    basis: FloatArray
    data: FloatArray

    @property
    def is_small(self) -> bool:
        """Whether it may be kept."""
        return self.basis.nbytes + self.y.nbytes < _KEPT_BYTES


def orthonormal(columns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Q, W and d with Q orthonormal over the span of `columns` and columns @ (d * (W @ a)) = Q a.

    By blocks of rows that stay in the processor's cache (Demmel et al. 2012, SIAM J. Sci. Comput. 34, A206-A239, TSQR).
    """
    if columns.shape[1] == 0:
        return columns, np.zeros((0, 0)), np.zeros(0)
    scale = np.linalg.norm(columns, axis=0)
    safe = np.where(scale > 0, scale, 1.0)
    n_rows, n = columns.shape
    blocks = max(1, n_rows // max(_BLOCK_ROWS, 2 * n))
    size = -(-n_rows // blocks)
    padded = np.zeros((blocks * size, n))
    np.divide(columns, safe, out=padded[:n_rows])
    within, triangles = np.linalg.qr(padded.reshape(blocks, size, n))
    between, triangle = np.linalg.qr(triangles.reshape(-1, n))
    left, singular, right = np.linalg.svd(triangle)
    rank = int((singular > _DEPENDENT * singular.max(initial=0.0)).sum())
    across = (between @ left[:, :rank]).reshape(blocks, -1, rank)
    return (within @ across).reshape(-1, rank)[:n_rows], right[:rank].T / singular[:rank], 1 / safe

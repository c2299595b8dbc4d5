"""The covariance pencil: delayed channels, one window for all lags, lag zero left out.

With F(t) = [y(t+l); ...; y(t+l+i-1)] and P(t) = [y(t); ...; y(t-j+1)], G = sum of F P' over one window has the column
space of the observability matrix whatever P is: free decays are exact with damping and with more modes than
channels, and ambient motion is treated as by covariance-driven subspace identification. An offset l of 1 keeps white
measurement noise out of G. With i = j = 1, l = 0 and a second difference for the shift it is Norris's quotient.

References
----------
Juang, Cooper and Wright (1988), An eigensystem realization algorithm using data correlations (ERA/DC), Control
Theory Adv. Technol. 4, for the estimator; Norris (1986), Eqs. (5.10) to (5.33), for its limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy import linalg

from structid.modal.correlations import Outputs, outputs, pieces, require_length, window_hankels
from structid.modal.poles import Poles
from structid.modal.subspace.kernel import Subspace, shift_invariant
from structid.records import TimeRecord


def pencil(
    records: TimeRecord | Sequence[TimeRecord] | Outputs,
    block_rows: int,
    max_order: int,
    offset: int = 1,
    n_pieces: int = 1,
) -> Subspace:
    """Covariance pencil with `block_rows` delays on either side.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Free decays or ambient motion; covariances of several records add up, which separates repeated modes.
    block_rows : int
        i = j, at least 2.
    max_order : int
        Greatest number of states wanted.
    offset : int
        First lag, in samples; more than 1 for noise with a memory.
    n_pieces : int
        Pieces for the covariance of the result.
    """
    data = outputs(records)
    require_length(data, 2 * block_rows + offset, max_order)
    windows = pieces(data, block_rows - 1, offset + block_rows - 1, n_pieces)
    parts = partial(window_hankels, rows=block_rows, columns=block_rows, offset=offset)
    return shift_invariant(
        np.sum(list(parts(data, windows)), axis=0), data, "covariance pencil", max_order, parts, windows
    )


def second_difference_poles(
    records: TimeRecord | Sequence[TimeRecord] | Outputs, n_modes: int | None = None, offset: int = 0
) -> Poles:
    """Undamped modes by y(t+1) + y(t-1) = 2 cos(omega h) y(t): the pencil without delays, as Norris's quotient.

    Parameters
    ----------
    n_modes : int, optional
        At most the number of channels, its default.
    offset : int
        Lag of the covariances in the middle; 0 is the quotient, 2 keeps white noise out.

    Returns
    -------
    Poles
        On the imaginary axis, real shapes; those beyond the Nyquist frequency and complex ones are left out.
    """
    data = outputs(records)
    require_length(data, offset + 4, 0)
    windows = pieces(data, max(0, 1 - offset), offset + 1)
    matrix = np.sum(list(window_hankels(data, windows, 3, 1, offset - 1)), axis=0)
    m = data.n_channels
    left = linalg.svd(matrix, full_matrices=False)[0][:, : n_modes or m]
    shift = np.linalg.lstsq(left[m : 2 * m], left[:m] + left[2 * m :], rcond=None)[0]
    values, vectors = np.linalg.eig(shift)
    kept = np.flatnonzero((np.abs(values.imag) <= 1e-9) & (np.abs(values.real) < 2))
    omega = np.arccos(values[kept].real / 2) * data.sampling_rate
    order = np.argsort(omega)
    shapes = data.scale[:, None] * (left[m : 2 * m] @ vectors[:, kept])
    return Poles(1j * omega[order], shapes[:, order].astype(np.complex128), 2 * len(values))

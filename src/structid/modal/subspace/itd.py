"""Ibrahim's time domain method with delayed channels, for free decays.

References
----------
Ibrahim and Mikulcik (1977), A method for the direct identification of vibration parameters from the free response,
Shock Vib. Bull. 47(4); the projection on leading singular vectors follows dynamic mode decomposition, Tu et al. (2014).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from structid.modal.correlations import Outputs, outputs, pieces, require_length
from structid.modal.subspace.kernel import Subspace, delayed_triangle
from structid.records import TimeRecord


def itd(
    records: TimeRecord | Sequence[TimeRecord] | Outputs, block_rows: int, max_order: int, n_pieces: int = 1
) -> Subspace:
    """A = Y1 Y0^+ of delayed samples Y0 and the same one step later, Y1, on the leading singular vectors of Y0."""
    data = outputs(records)
    require_length(data, block_rows + 1, max_order)
    width = block_rows * data.n_channels
    rows = delayed_triangle(data, block_rows + 1)
    left, singular, right = linalg.svd(rows[:, :width].T, full_matrices=False)
    n = min(max_order, int(np.sum(singular > 1e-14 * singular[0])))
    moved = left[:, :n].T @ rows[:, data.n_channels :].T @ right[:n].T / singular[:n]
    windows = pieces(data, 0, block_rows, n_pieces)
    return Subspace(data, left, singular, right.T, np.eye(n), moved, None, windows, "ITD", rows)

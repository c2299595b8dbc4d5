"""The eigensystem realization algorithm for free decays, with the samples themselves or with their correlations.

References
----------
Juang and Pappa (1985), An eigensystem realization algorithm for modal parameter identification and model reduction,
J. Guid. Control Dyn. 8(5); Juang, Cooper and Wright (1988), Control Theory Adv. Technol. 4 (ERA/DC).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from structid.modal.correlations import Outputs, outputs, pieces, require_length
from structid.modal.subspace.kernel import Subspace, delayed_triangle, shift_invariant
from structid.modal.subspace.pencil import pencil
from structid.records import TimeRecord


def era(
    records: TimeRecord | Sequence[TimeRecord] | Outputs, block_rows: int, max_order: int, n_pieces: int = 1
) -> Subspace:
    """ERA with as many columns as the records have instants; several records stand side by side as inputs do."""
    data = outputs(records)
    require_length(data, block_rows, max_order)
    samples = delayed_triangle(data, block_rows)
    windows = pieces(data, 0, block_rows - 1, n_pieces)
    return replace(shift_invariant(samples.T, data, "ERA", max_order, None, windows), samples=samples)


def era_dc(
    records: TimeRecord | Sequence[TimeRecord] | Outputs,
    block_rows: int,
    max_order: int,
    lag: int | None = None,
    n_pieces: int = 1,
) -> Subspace:
    """ERA/DC: the Hankel matrix `lag` samples later times the transpose of the first one.

    Parameters
    ----------
    lag : int, optional
        At least `block_rows`, its default, below which measurement noise is correlated with itself. The product is
        the matrix of `pencil` with offset `lag` - `block_rows` + 1 and the columns in another order.
    """
    shift = 0 if lag is None else lag - block_rows
    return replace(pencil(records, block_rows, max_order, shift + 1, n_pieces), method="ERA/DC")

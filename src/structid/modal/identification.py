"""Modes from any record, with their covariance: one door for all methods."""

from __future__ import annotations

from collections.abc import Sequence

from structid.errors import InputError
from structid.modal.modal_identification import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria
from structid.modal.subspace_modes import SUBSPACE_METHODS, subspace_modes
from structid.records import TimeRecord

#: Names of all methods.
METHODS: tuple[str, ...] = tuple(SUBSPACE_METHODS)


def identify_modes(
    records: TimeRecord | Sequence[TimeRecord],
    method: str = "pencil",
    orders: Sequence[int] | None = None,
    block_rows: int | None = None,
    criteria: HardCriteria | None = None,
    frequencies: Sequence[float] | None = None,
    n_pieces: int = 40,
) -> ModalRecord:
    """Frequencies, damping ratios and mode shapes of free or ambient motion, with covariance.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Any mixture of displacement, velocity and acceleration; forces are left out. Channels, quantities and
        sampling rates agree between records. Records excited in different ways separate repeated modes.
    method : {"pencil", "era", "era_dc", "ssi_cov", "ssi_data", "itd"}
        ``pencil`` serves free and ambient motion alike; ``era``, ``era_dc`` and ``itd`` are for free decays, ``ssi_cov``
        and ``ssi_data`` for ambient motion.
    orders : sequence of int, optional
        Numbers of states to try; by default 2, 4, ... as far as channels and delays have room, at most 60. One
        order only gives all its poles that meet `criteria`.
    block_rows : int, optional
        Delays on either side; by default 30, less for short records, more for few channels.
    criteria : HardCriteria, optional
        What poles must meet; by default a damping ratio from -1 % to 20 %.
    frequencies : sequence of float, optional
        Hz: the modes wanted, by hand. Each takes the nearest cluster of stable poles.
    n_pieces : int
        Pieces the record is cut into for the covariance; 0 or 1 for none.

    Returns
    -------
    ModalRecord
        Complex mode shapes with largest entry 1, one row a degree of freedom, as displacement where quantities are
        mixed. `covariance` and `shape_std` are None for ``era`` and ``itd``.

    Raises
    ------
    InputError
        If records do not fit together, a channel is dead, or the record is too short.

    Notes
    -----
    Cost 4 i n^2 N for i delays, n channels and N samples, twice with covariance (`n_pieces` times for a free decay),
    and O((i n)^3) for the singular value decomposition.

    The covariance is of first order and holds no bias. In ambient motion it comes from independent pieces, which must
    be long against the memory of the slowest mode, 1 / (zeta omega). Where the modes explain most of the record as a
    free decay, it comes from the remaining noise, taken as stationary; that of ``ssi_data`` is then about twice too
    wide, since its projection is taken as free of noise.

    References
    ----------
    See `pencil`, `era`, `ssi_cov`, `stabilization` and `pole_uncertainty` in this package.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(400)[:, None] * 0.05
    >>> both = np.exp(-0.02 * t) * (np.cos(2 * t) * [[1.0, 1.0]] + np.cos(5 * t) * [[1.0, -1.0]])
    >>> record = TimeRecord(20.0, both, ("1Z", "2Z"), ("displacement",) * 2)
    >>> identify_modes(record, orders=[4]).omega.round(4).tolist()
    [2.0001, 5.0]
    """
    options = ModalOptions(orders, block_rows, criteria or HardCriteria(), frequencies, n_pieces)
    return modal_identification(records, method, options).modes


def modal_identification(
    records: TimeRecord | Sequence[TimeRecord], method: str = "pencil", options: ModalOptions | None = None
) -> ModalIdentification:
    """As `identify_modes`, with the poles of all orders and their clusters, for a stabilization diagram.

    Raises
    ------
    InputError
        If `method` is unknown, and as `identify_modes` does.
    """
    if method not in METHODS:
        raise InputError(f"`method` must be one of {', '.join(METHODS)}, got {method!r}")
    return subspace_modes(records, method, options or ModalOptions())

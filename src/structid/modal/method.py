"""What a method of modal identification is told, and all that it found on the way to the modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from structid.errors import InputError
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria, Poles
from structid.modal.stabilization import Cluster


@dataclass(frozen=True)
class ModalOptions:
    """Settings of modal identification; every default serves without a look at the record.

    Parameters
    ----------
    orders : sequence of int, optional
        Numbers of states to try.
    block_rows : int, optional
        Delays on either side of a block Hankel matrix.
    criteria : HardCriteria
        What poles must meet.
    frequencies : sequence of float, optional
        Hz: the modes wanted, by hand.
    n_pieces : int
        Pieces the record is cut into for the covariance; 0 or 1 for none.
    segment : int, optional
        Samples of a segment of spectral estimates, for methods in the frequency domain.
    bands : sequence of (float, float), optional
        Hz: the bands that methods in the frequency domain look at, one after another.
    refine : bool
        Whether ``pencil`` ends with maximum likelihood where the record is a free decay of the modes found.
    """

    orders: Sequence[int] | None = None
    block_rows: int | None = None
    criteria: HardCriteria = field(default_factory=HardCriteria)
    frequencies: Sequence[float] | None = None
    n_pieces: int = 40
    segment: int | None = None
    bands: Sequence[tuple[float, float]] | None = None
    refine: bool = True

    def __post_init__(self) -> None:
        for low, high in self.bands or ():
            if not 0 <= low < high:
                raise InputError(f"`bands` must be ranges (least, greatest) in Hz, got ({low!r}, {high!r})")


@dataclass(frozen=True, eq=False)
class ModalIdentification:
    """Modes with what lies behind them.

    Attributes
    ----------
    modes : ModalRecord
        The result.
    method : str
        Name of the method, as given to `identify_modes`.
    sweep : tuple of Poles
        Poles of every order; empty for methods without an order.
    clusters : tuple of Cluster
        The poles of all orders behind each mode, one a mode; empty where there is one order only, or none.
    options : ModalOptions
        As used.
    """

    modes: ModalRecord
    method: str
    sweep: tuple[Poles, ...] = ()
    clusters: tuple[Cluster, ...] = ()
    options: ModalOptions = field(default_factory=ModalOptions)

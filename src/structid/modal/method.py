"""Input and result of a method of modal identification, with all that it found on the way to the modes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, arrays_to_tuples
from structid.core.constraints import require_band
from structid.core.errors import InputError, NoModesError
from structid.modal.modal_record import ModalRecord
from structid.modal.poles.poles import HardCriteria, Poles
from structid.modal.poles.stabilization import Cluster


@dataclass(frozen=True)
class ModalOptions:
    """Settings of modal identification; every default serves without a look at the record.

    Parameters
    ----------
    orders : sequence of int, optional
        Numbers of states to try; by default 2, 4, ... 60, as far as channels and delays have room, and twice as many
        where there are fewer than four for each likely mode. One order only gives all its poles that meet `criteria`.
    block_rows : int, optional
        Delays on either side of a block Hankel matrix; by default 30, less for short records, more for few channels.
    criteria : HardCriteria
        What poles must meet; by default a damping ratio from -1 % to 20 %, above 0 in ambient motion.
    frequencies : sequence of float, optional
        Hz: the modes wanted, by hand. Each takes the nearest cluster of stable poles, or the nearest peak.
    n_pieces : int
        Pieces the record is cut into for the covariance; 0 or 1 for none.
    segment : int, optional
        Samples of a segment of spectral estimates, for methods in the frequency domain.
    bands : sequence of (float, float), optional
        Hz: the bands that methods in the frequency domain look at, one after another.
    refine : bool
        Whether ``pencil`` ends with maximum likelihood where the record is a free decay of the modes found.
    deviation : float, optional
        Greatest standard deviation of a frequency over the frequency. By default 0.005 in free decays, except for modes
        with a hundredth of the record's energy or more; none in other motion.
    """

    orders: Sequence[int] | None = None
    block_rows: int | None = None
    criteria: HardCriteria = field(default_factory=HardCriteria)
    frequencies: Sequence[float] | None = None
    n_pieces: int = 40
    segment: int | None = None
    bands: Sequence[tuple[float, float]] | None = None
    refine: bool = True
    deviation: float | None = None

    @property
    def separate_bands(self) -> list[tuple[float, float]]:
        """Frequency bands as (low, high) in Hz, in the order of `bands`; an empty list if there are none.

        Raises
        ------
        InputError
            If two bands overlap.
        """
        bands = [(float(low), float(high)) for low, high in self.bands or ()]
        for (_, high), (low, _) in pairwise(sorted(bands)):
            if low < high:
                raise InputError(f"`bands` must not overlap, got one to {high:g} Hz and one from {low:g} Hz; join them")
        return bands

    def __post_init__(self) -> None:
        """Make tuples of arrays; raise `InputError` on an entry of `bands` that is no range in Hz, or a `deviation` not above 0."""
        arrays_to_tuples(self, "orders", "frequencies", "bands")
        for band in self.bands or ():
            require_band("bands", band)
        if self.deviation is not None and not self.deviation > 0:
            raise InputError(f"`deviation` must be greater than 0, got {self.deviation!r}")


@dataclass(frozen=True)
class LeftOut:
    """Poles that were not taken for a mode.

    Attributes
    ----------
    frequency, damping_ratio : float
        Hz and 1.
    n_poles : int
        How many poles of all orders.
    probability : float
        Probability that the poles are a mode (`mode_probability`); NaN where it is not known.
    reason : str
    """

    frequency: float
    damping_ratio: float
    n_poles: int
    probability: float
    reason: str


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
    left_out : tuple of LeftOut
        Stable poles that are no mode here, by frequency, and why.
    is_free_decay : bool
        Whether the records were taken as free decays of the modes.
    """

    modes: ModalRecord
    method: str
    sweep: tuple[Poles, ...] = ()
    clusters: tuple[Cluster, ...] = ()
    options: ModalOptions = field(default_factory=ModalOptions)
    left_out: tuple[LeftOut, ...] = ()
    is_free_decay: bool = False

    @property
    def probability(self) -> FloatArray:
        """Probability that each mode is physical, from its cluster, (n_modes,); all NaN without one cluster per mode."""
        if len(self.clusters) != self.modes.n_modes:
            return np.full(self.modes.n_modes, np.nan)
        return np.array([cluster.probability for cluster in self.clusters])

    @property
    def orders(self) -> tuple[int, ...]:
        """Numbers of states that were tried, increasing."""
        return tuple(sorted({poles.order for poles in self.sweep}))

    def kept(self, keep: NDArray[np.bool_], words: str) -> ModalIdentification:
        """Identification with only the modes where the mask `keep` (n_modes,) is true; itself if all are.

        The modes left out are added to `left_out` with reason `words`, and a further warning lists their frequencies.

        Raises
        ------
        NoModesError
            If no mode is kept.
        """
        if keep.all():
            return self
        modes, std = self.modes, self.modes.frequency_std
        listed = ", ".join(
            f"{f:.4g}" + (f" \u00b1 {e:.2g}" if np.isfinite(e) else "")
            for f, e in zip(modes.frequency[~keep], std[~keep], strict=True)
        )
        reason, words = words, f"{words} are left out: {listed} Hz"
        if not keep.any():
            raise NoModesError(
                f"`records` show no mode that stands out of the noise; {words}. Measure longer, or give `frequencies`"
            )
        few = modes.some_modes(np.flatnonzero(keep))
        clusters = tuple(self.clusters[i] for i in np.flatnonzero(keep)) if self.clusters else ()
        numbers = np.flatnonzero(~keep).tolist()
        sizes = [c.size for c in self.clusters] if len(self.clusters) == len(keep) else [0] * len(keep)
        gone = (
            LeftOut(float(modes.frequency[i]), float(modes.damping_ratio[i]), sizes[i], self.probability[i], reason)
            for i in numbers
        )
        return replace(
            self,
            modes=replace(few, warnings=(*modes.warnings, words)),
            clusters=clusters,
            left_out=by_rising_frequency((*self.left_out, *gone)),
        )


def by_rising_frequency(poles: Iterable[LeftOut]) -> tuple[LeftOut, ...]:
    """`poles` sorted by frequency, the lowest first."""
    return tuple(sorted(poles, key=lambda part: part.frequency))

"""Stored correlation functions of motion: those of channels with references, estimated by another program."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, locked, require_finite, require_shape
from structid.core.display import Overview, Shown, format_number
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.core.units import Quantity
from structid.records.spectrum import channel_words, checked_channels

_FEWEST = 16
#: Relative distance from 1 within which autocorrelations at lag 0 are normalized ones.
_NORMALIZED = 1e-5


@dataclass(frozen=True, eq=False, repr=False)
class CorrelationRecord(Shown):
    """Auto- and cross-correlation functions of motion, for `identify_modes`.

    Parameters
    ----------
    sampling_rate : float
        Lags a second, Hz.
    values : (n_lags, n_channels, n_references) float array
        Expected product of each channel at t + lag and each reference at t, at lags 0, 1 / sampling_rate, ..., in SI units.
    channels, references : tuple of Dof
        References are some of the channels, or all.
    quantities : tuple of {"displacement", "velocity", "acceleration"}
        Of each channel.
    averages : int, optional
        Number of independent averages behind each value.
    source : str
        File or procedure that it comes from.

    Raises
    ------
    InputError
        If shapes disagree, there are fewer than 16 lags, a channel is doubled, a reference is no channel, an entry is NaN or
        infinite, an autocorrelation exceeds its value at lag 0, or all autocorrelations are normalized to 1.
    """

    sampling_rate: float
    values: FloatArray
    channels: tuple[Dof, ...]
    references: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    averages: int | None = None
    source: str = ""

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            sampling_rate: float,
            values: ArrayLike,
            channels: Iterable[str | Dof],
            references: Iterable[str | Dof],
            quantities: Iterable[Quantity],
            averages: int | None = None,
            source: str = "",
        ) -> None: ...

    def __post_init__(self) -> None:
        """Convert and check the arguments: shapes, finite values, channels named once, autocorrelations that are such."""
        channels, references, quantities = checked_channels(
            self.channels, self.references, self.quantities, self.averages
        )
        values = locked(self.values, np.float64)
        require_shape("values", values, (None, len(channels), len(references)))
        require_finite("values", values)
        if not (np.isfinite(self.sampling_rate) and self.sampling_rate > 0):
            raise InputError(f"`sampling_rate` must be a positive number of Hz, got {self.sampling_rate!r}")
        if len(values) < _FEWEST:
            raise InputError(f"`values` must have at least {_FEWEST} lags from 0 s on, got {len(values)}; export more")
        start = np.array([values[0, channels.index(dof), k] for k, dof in enumerate(references)])
        for k, dof in enumerate(references):
            largest = np.abs(values[:, channels.index(dof), k]).max()
            if not largest > 0 or start[k] < largest * (1 - _NORMALIZED):
                raise InputError(
                    f"the autocorrelation of {dof} must be largest at lag 0, where it is {start[k]:.4g}, got {largest:.4g}"
                    " elsewhere; export correlation functions from lag 0 on, with lag 0 first"
                )
        if (np.abs(start - 1) <= _NORMALIZED).all() and len(channels) > 1:
            raise InputError(
                "autocorrelations of 1 at lag 0 are coefficients of correlation, from which the size of each channel's motion is"
                " lost, and with it the mode shapes; export functions that are not normalized"
            )
        for name, value in (
            ("sampling_rate", float(self.sampling_rate)),
            ("values", values),
            ("channels", channels),
            ("references", references),
            ("quantities", quantities),
        ):
            object.__setattr__(self, name, value)

    @property
    def lag(self) -> FloatArray:
        """Lags in s from 0 on, (n_lags,)."""
        return np.arange(len(self.values)) / self.sampling_rate

    def overview(self) -> Overview:
        """Lags, channels and references."""
        words = (
            f"correlation functions of {channel_words(self.channels, self.references, self.quantities)},"
            f" {len(self.values)} lags to {format_number(self.lag[-1])} s"
        )
        return Overview(words)

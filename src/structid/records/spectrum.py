"""Stored spectra of motion: the spectral matrix of channels and references, averaged by another program."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import ComplexArray, FloatArray, locked, require_finite, require_shape
from structid.core.display import Overview, Shown, format_number, plural
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.units import Quantity
from structid.records.record import QUANTITY_UNITS

#: Part of the line spacing by which spacings may differ.
_EVEN = 1e-3


def checked_channels(
    channels: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantities: Iterable[Quantity],
    averages: int | None,
) -> tuple[tuple[Dof, ...], tuple[Dof, ...], tuple[Quantity, ...]]:
    """Channels, references and quantities of spectra or correlation functions of motion, as tuples.

    Parameters
    ----------
    channels, references : iterable of str or Dof
        Measured degrees of freedom, and those among them that functions refer to.
    quantities : iterable of str
        Quantity of motion of each channel.
    averages : int or None

    Raises
    ------
    InputError
        If a channel is doubled, a reference is no channel, a quantity is no motion, or `averages` is below 1.
    """
    channels, references, quantities = parse_dofs(channels), parse_dofs(references), tuple(quantities)
    for name, dofs in (("channels", channels), ("references", references)):
        if len(set(dofs)) < len(dofs) or not dofs:
            raise InputError(f"`{name}` must name each place and direction once, got {', '.join(map(str, dofs))}")
    if not set(references) <= set(channels):
        raise InputError("`references` must be among the channels; add what every reference measured as a channel")
    if len(quantities) != len(channels) or not set(quantities) <= {"displacement", "velocity", "acceleration"}:
        raise InputError(
            f"`quantities` must say displacement, velocity or acceleration of each channel, got {quantities}"
        )
    if averages is not None and not averages >= 1:
        raise InputError(f"`averages` must be at least 1, got {averages!r}")
    return channels, references, quantities


def channel_words(channels: tuple[Dof, ...], references: tuple[Dof, ...], quantities: tuple[Quantity, ...]) -> str:
    """Words on the numbers of channels and references, with the units of the motions (for translations)."""
    units = ", ".join(dict.fromkeys(QUANTITY_UNITS[quantity][0] for quantity in quantities))
    return f"{plural(len(channels), 'channel')} ({units}) and {plural(len(references), 'reference')}"


@dataclass(frozen=True, eq=False, repr=False)
class SpectrumRecord(Shown):
    """Auto- and cross-spectra of motion, for `identify_modes` by frequency domain decomposition.

    Parameters
    ----------
    frequency : (n_frequencies,) float array
        Hz, evenly spaced.
    values : (n_frequencies, n_channels, n_references) complex array
        Expected product of each channel's transform with the conjugate of each reference's, in SI units, per Hz or per line,
        one-sided or two-sided: a factor that is common to all changes no mode.
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
        If shapes disagree, the axis is not evenly spaced, a channel is doubled, a reference is no channel, or an entry is NaN
        or infinite.
    """

    frequency: FloatArray
    values: ComplexArray
    channels: tuple[Dof, ...]
    references: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    averages: int | None = None
    source: str = ""

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            frequency: ArrayLike,
            values: ArrayLike,
            channels: Iterable[str | Dof],
            references: Iterable[str | Dof],
            quantities: Iterable[Quantity],
            averages: int | None = None,
            source: str = "",
        ) -> None: ...

    def __post_init__(self) -> None:
        """Make arrays read-only and channels `Dof`, and raise `InputError` on what makes no record of spectra.

        Values must be finite, channels named once, references be among them, and frequencies at least three evenly
        spaced lines.
        """
        channels, references, quantities = checked_channels(
            self.channels, self.references, self.quantities, self.averages
        )
        frequency = locked(self.frequency, np.float64)
        values = locked(self.values, np.complex128)
        require_shape("values", values, (len(frequency), len(channels), len(references)))
        require_finite("frequency", frequency)
        require_finite("values", values)
        steps = np.diff(frequency)
        if len(steps) < 2 or not (steps > 0).all() or np.ptp(steps) > _EVEN * steps.mean() or frequency[0] < 0:
            raise InputError(
                "`frequency` must be at least three evenly spaced lines from 0 Hz or more; export all lines"
            )
        for name, value in (
            ("frequency", frequency),
            ("values", values),
            ("channels", channels),
            ("references", references),
            ("quantities", quantities),
        ):
            object.__setattr__(self, name, value)

    def overview(self) -> Overview:
        """Lines, channels and references."""
        words = (
            f"spectra of {channel_words(self.channels, self.references, self.quantities)},"
            f" {len(self.frequency)} lines from {format_number(self.frequency[0])} to {format_number(self.frequency[-1])} Hz"
        )
        return Overview(words)

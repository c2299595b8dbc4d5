"""Spectra and correlation functions of motion that another program averaged, with their lags: which half is of a reversed pair."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import ComplexArray, FloatArray, locked, require_finite, require_shape
from structid.core.display import Overview, Shown, format_number, plural
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError
from structid.core.units import Quantity
from structid.records.record import QUANTITY_UNITS

#: Part of the line spacing by which spacings may differ.
_EVEN = 1e-3
_FEWEST = 16
#: Relative distance from 1 within which autocorrelations at lag 0 are normalized ones.
_NORMALIZED = 1e-5
#: What a lag is; programs that count it the other way give shapes of the references in place of those of the channels.
FORWARD = "taken as the mean product of the response at t + lag and the reference at t"
#: Unevenness of lags allowed, as a part of the step, and of symmetry, as a part of the value at lag 0.
_EVEN_LAGS, _SYMMETRIC = 1e-2, 1e-3


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
        """Make arrays read-only and raise `InputError` on wrong shapes, values not finite, or doubled channels.

        It is raised too if the sampling rate is not positive, there are fewer than 16 lags, an autocorrelation is not
        positive and largest in size at lag 0, or all autocorrelations of several channels are 1 there (normalized
        functions).
        """
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


class TwoSidedCorrelations(NamedTuple):
    """Functions from lag 0 on by pair, and those of the reverse pairs (none where the file has no negative lags), and words."""

    forward: dict[tuple[Dof, Dof], FloatArray]
    backward: dict[tuple[Dof, Dof], FloatArray]
    words: str


def step_of(path: Path, lag: FloatArray) -> float:
    """Step in s of the evenly spaced lag axis `lag` (n_points,) in s.

    Raises
    ------
    FileError
        If the lags are uneven or do not increase, or there are fewer than three; the message begins with `path`.
    """
    steps = np.diff(lag)
    if len(steps) < 2 or not (steps > 0).all() or np.ptp(steps) > _EVEN_LAGS * steps.mean():
        raise FileError(f"{path}: lags must rise in even steps; export correlation functions at evenly spaced lags")
    return float((lag[-1] - lag[0]) / (len(lag) - 1))


def lag_halves(path: Path, lag: FloatArray, values: Mapping[tuple[Dof, Dof], FloatArray]) -> TwoSidedCorrelations:
    """Correlation functions split at lag 0 into non-negative and negative lags, both ordered from lag 0 outwards.

    Returns forward and backward functions by pair of channels, each beginning with lag 0, and words on the lags. The
    backward ones are {} if the lags begin at 0 s and nothing shows that the second half are negative lags. Lags that
    begin before 0 s are cut to the length of the shorter side, so that both have as many lags.

    Parameters
    ----------
    path : Path
        File, named in errors.
    lag : (n_points,) float array
        Lags in s, evenly spaced, with 0 s among them.
    values : mapping of (Dof, Dof) to (n_points,) float arrays
        Correlation function of each pair of channels. If the lags begin at 0 s and every autocorrelation is symmetric
        about the middle, the second half holds the negative lags, as a Fourier transform leaves them.

    Raises
    ------
    FileError
        If lags are uneven, lag 0 is not among them, or an autocorrelation is not symmetric about lag 0.
    """
    step = step_of(path, lag)
    zero = round(-lag[0] / step)
    if not 0 <= zero < len(lag) or abs(lag[0] + zero * step) > _EVEN_LAGS * step:
        raise FileError(
            f"{path}: lags run from {lag[0]:.6g} to {lag[-1]:.6g} s without 0 s; export correlation functions from lag 0 on"
        )
    autocorrelations = {pair: value for pair, value in values.items() if pair[0] == pair[1]}
    if zero == 0:
        wrapped = [_is_even(value[1:], value[0]) for value in autocorrelations.values()]
        if not wrapped or not all(wrapped):
            return TwoSidedCorrelations(dict(values), {}, f"lags from 0 to {lag[-1]:.6g} s")
        half = (len(lag) + 1) // 2
        forward = {pair: value[:half] for pair, value in values.items()}
        backward = {pair: np.concatenate([value[:1], value[:-half:-1]]) for pair, value in values.items()}
        words = f"lags beyond {lag[half - 1]:.6g} s are negative ones, since autocorrelations are symmetric about the middle"
        return TwoSidedCorrelations(forward, backward, words)
    count = min(zero + 1, len(lag) - zero)
    for pair, value in autocorrelations.items():
        if not _is_even(value[zero - count + 1 : zero + count], value[zero]):
            raise FileError(f"{path}: the autocorrelation of {pair[0]} is not symmetric about lag 0 s; export it again")
    forward = {pair: value[zero : zero + count] for pair, value in values.items()}
    backward = {pair: value[zero - count + 1 : zero + 1][::-1] for pair, value in values.items()}
    return TwoSidedCorrelations(forward, backward, f"lags from {lag[0]:.6g} to {lag[-1]:.6g} s")


def _is_even(values: FloatArray, start: float) -> bool:
    """True if `values` are the same backwards but for rounding, beside the value `start` at lag 0."""
    return bool(np.abs(values - values[::-1]).max() <= _SYMMETRIC * abs(start))

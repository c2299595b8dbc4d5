"""Auto and cross spectra of all channels of time records, for records without a force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from structid.arrays import ComplexArray, FloatArray, locked
from structid.dof import Dof
from structid.errors import InputError
from structid.records.record import Quantity, TimeRecord
from structid.records.transforms.segments import (
    Detrend,
    effective_averages,
    require_alike,
    segment_count,
    segment_step,
    segment_transforms,
    window_weights,
)


@dataclass(frozen=True, eq=False)
class SpectralMatrix:
    """One-sided spectral density of every pair of channels.

    Attributes
    ----------
    frequency : (n_frequencies,) float array
        Hz.
    values : (n_frequencies, n_channels, n_channels) complex array
        E[y_i conj(y_j)] per Hz, in the unit of channel i times that of channel j over Hz; Hermitian.
    averages : float
        Number of independent segments that would have the same random error.
    channels, quantities : tuples
        Place and kind of each channel.
    source : str
        File or procedure that the records come from.
    """

    frequency: FloatArray
    values: ComplexArray
    averages: float
    channels: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    source: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency", locked(self.frequency, np.float64))
        object.__setattr__(self, "values", locked(self.values, np.complex128))

    @property
    def auto(self) -> FloatArray:
        """Auto spectra, (n_frequencies, n_channels)."""
        return np.einsum("fii->fi", self.values).real

    @property
    def coherence(self) -> FloatArray:
        """|S_ij|^2 / (S_ii S_jj), (n_frequencies, n_channels, n_channels); 0 where a channel is silent."""
        power = self.auto[:, :, None] * self.auto[:, None, :]
        return np.divide(np.abs(self.values) ** 2, power, out=np.zeros_like(power), where=power > 0)

    @property
    def relative_error(self) -> FloatArray:
        """Standard deviation of |S_ij| over |S_ij|, sqrt((1 + 1 / coherence) / (2 averages)), of the shape of `values`.

        On the diagonal 1 / sqrt(averages). Infinite where the coherence is 0. To first order, by the covariance of a
        complex Wishart matrix (Goodman 1963, Ann. Math. Stat. 34, 152-177). Random error only: a peak narrower than
        about four lines is also too low, by leakage.
        """
        coherence = self.coherence
        inverse = np.divide(1.0, coherence, out=np.full_like(coherence, np.inf), where=coherence > 0)
        return np.asarray(np.sqrt((1 + inverse) / (2 * self.averages)))


def spectral_matrix(
    records: TimeRecord | Sequence[TimeRecord],
    segment_length: int,
    overlap: float = 0.5,
    window: str | tuple[Any, ...] = "hann",
    detrend: Detrend = "constant",
) -> SpectralMatrix:
    """Welch's estimate of all auto and cross spectra, averaged over the segments of all records.

    S = 2 / (rate sum w^2) mean(Y Y^H) with Y the Fourier transform of a windowed segment; not doubled at 0 Hz and at the
    Nyquist frequency, so that the sum over lines times their spacing is the mean square.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Channels, quantities and sampling rates agree.
    segment_length : int
        Samples in a segment; lines come in steps of sampling rate over it.
    overlap : float
        Part of a segment shared with the next, 0 to less than 1.
    window : str or tuple
        As `scipy.signal.get_window` takes it.
    detrend : {"constant", "linear", "none"}
        What is taken off each segment before the window.

    Raises
    ------
    InputError
        If records do not fit together, or none is as long as a segment.

    References
    ----------
    Welch (1967), IEEE Trans. Audio Electroacoust. 15, 70-73. Bendat and Piersol (2010), Random Data, 4th ed., chapter 9.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal((20000, 1))
    >>> spectra = spectral_matrix(TimeRecord(100.0, noise, ("1X",), ("velocity",)), 256)
    >>> round(float(spectra.auto.sum() * spectra.frequency[1]), 1)
    1.0
    """
    given = [records] if isinstance(records, TimeRecord) else list(records)
    require_alike(given, segment_length)
    step, weights = segment_step(segment_length, overlap), window_weights(window, segment_length)
    if detrend not in ("constant", "linear", "none"):
        raise InputError(f"`detrend` must be constant, linear or none, got {detrend!r}")
    counts = [segment_count(record, segment_length, step) for record in given]
    if not sum(counts):
        longest = max(len(record.values) for record in given)
        raise InputError(
            f"`segment_length` {segment_length} is longer than the longest record ({longest} samples); shorten it"
        )
    first, lines = given[0], segment_length // 2 + 1
    total = np.zeros((lines, len(first.channels), len(first.channels)), dtype=np.complex128)
    for transform in segment_transforms(given, weights, step, detrend):
        total += transform[:, :, None] * transform[:, None, :].conj()
    sides = np.full(lines, 2.0)
    sides[0] = 1.0
    if segment_length % 2 == 0:
        sides[-1] = 1.0
    total *= (sides / (sum(counts) * first.sampling_rate * np.sum(weights**2)))[:, None, None]
    averages = effective_averages(weights, step, [count for count in counts if count])
    frequency = np.fft.rfftfreq(segment_length, 1 / first.sampling_rate)
    return SpectralMatrix(frequency, total, averages, first.channels, first.quantities, first.source)

"""Output covariances of time records at lags, arranged as block Hankel matrices, whole and piece by piece.

R_k = <y(t + k) y(t)'>, over all pairs of samples (divisor N - k), or over one window for all lags, which keeps
G = C F^k X exact for a free decay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES, Quantity

_AT_ONCE = 24  # segments that are transformed together: few enough for a cache, many enough to add up by one product
_CHUNK = 2048  # samples whose sums are taken together
_DEAD = 1e-9  # part of the median rms of channels of its quantity below which a channel has no motion


@dataclass(frozen=True, eq=False)
class ScaledMotion:
    """Motion channels of one or more records, each channel scaled to a root mean square of 1.

    Attributes
    ----------
    series : tuple of (n_times, n_channels) float arrays
        One a record, dimensionless.
    scale : (n_channels,) float array
        Root mean square of every channel over all records, in its unit.
    channels, quantities : tuples
        Place and kind of every channel.
    sampling_rate : float
        Hz.
    """

    series: tuple[FloatArray, ...]
    scale: FloatArray
    channels: tuple[Dof, ...]
    quantities: tuple[Quantity, ...]
    sampling_rate: float

    @property
    def n_channels(self) -> int:
        return len(self.channels)

    @property
    def derivative(self) -> FloatArray:
        """0, 1 or 2 for displacement, velocity or acceleration, (n_channels,)."""
        return np.array([MOTION_DERIVATIVES[quantity] for quantity in self.quantities])

    @property
    def duration(self) -> float:
        """Duration of the longest record, s."""
        return max(len(y) for y in self.series) / self.sampling_rate

    @property
    def seconds(self) -> float:
        """Duration of all records together, s."""
        return sum(map(len, self.series)) / self.sampling_rate


@dataclass(frozen=True)
class RecordPiece:
    """Samples `start` to `stop` - 1 of record number `record` (from 0); `part` is their number over that of all windows."""

    record: int
    start: int
    stop: int
    part: float


def outputs(records: TimeRecord | Sequence[TimeRecord] | ScaledMotion) -> ScaledMotion:
    """Motion channels of one or more records, each divided by its root mean square over all records, without forces.

    Channels are in the order of the first record, samples (n_times, n_channels) for each record; means are not
    subtracted. A `ScaledMotion` is returned as it is.

    Raises
    ------
    InputError
        If there is no record, channels or sampling rates differ, there are only forces, or a channel is dead or
        constant.
    """
    if isinstance(records, ScaledMotion):
        return records
    given = (records,) if isinstance(records, TimeRecord) else tuple(records)
    if not given or not all(isinstance(record, TimeRecord) for record in given):
        raise InputError("`records` must be one or more TimeRecords; read them from a file, or construct them")
    first = given[0]
    for number, record in enumerate(given[1:], 2):
        if record.channels != first.channels or record.quantities != first.quantities:
            raise InputError(
                f"record {number} must have the channels and quantities of record 1, in the same order; select them"
            )
        if not np.isclose(record.sampling_rate, first.sampling_rate, rtol=1e-9):
            raise InputError(
                f"record {number} must be sampled at {first.sampling_rate:g} Hz as record 1 is, "
                f"got {record.sampling_rate:g} Hz; resample it"
            )
    moving = [i for i, quantity in enumerate(first.quantities) if quantity in MOTION_DERIVATIVES]
    if not moving:
        raise InputError("`records` must hold displacement, velocity or acceleration, got forces only")
    channels = tuple(first.channels[i] for i in moving)
    quantities = tuple(first.quantities[i] for i in moving)
    columns = slice(None) if len(moving) == len(first.quantities) else moving
    series = [record.values[:, columns] for record in given]
    scale = _scale(series, channels, quantities)
    return ScaledMotion(tuple(y / scale for y in series), scale, channels, quantities, first.sampling_rate)


def _mean_and_variance(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of each column of `values` (n_times, n_channels), (n_channels,) each.

    The variance is about the mean, with divisor n_times. Sums are taken in chunks, about the first row.
    """
    start, total, square = values[0], np.zeros(values.shape[1]), np.zeros(values.shape[1])
    for first in range(0, len(values), _CHUNK):
        chunk = values[first : first + _CHUNK] - start
        total += np.ones(len(chunk)) @ chunk
        square += np.einsum("ij,ij->j", chunk, chunk)
    mean = total / len(values)
    return start + mean, np.maximum(square / len(values) - mean**2, 0.0)


def _scale(series: list[FloatArray], channels: tuple[Dof, ...], quantities: tuple[Quantity, ...]) -> FloatArray:
    """Root mean square of every channel over all records, (n_channels,), without subtracting means.

    `series` are the samples of each record, (n_times, n_channels). Raises `InputError` if the standard deviation of a
    channel is at most 1e-9 of the median of its quantity or of its own root mean square. `channels` and their
    `quantities` are for the check and its message.
    """
    n_samples = sum(map(len, series))
    moments = [_mean_and_variance(y) for y in series]
    spread = np.sqrt(sum(len(y) * variance for y, (_, variance) in zip(series, moments, strict=True)) / n_samples)
    square = sum(len(y) * mean**2 for y, (mean, _) in zip(series, moments, strict=True)) / n_samples
    scale = np.hypot(spread, np.sqrt(square))
    kinds = np.array(quantities)
    for i, (channel, quantity) in enumerate(zip(channels, quantities, strict=True)):
        typical = np.median(spread[kinds == quantity])
        if spread[i] <= _DEAD * max(typical, scale[i]) or spread[i] == 0.0:
            raise InputError(
                f"{quantity} channel {channel} is dead or constant (standard deviation {spread[i]:.3g}); "
                "leave this channel out, or repair the sensor"
            )
    return np.asarray(scale)


def displacement_rows(data: ScaledMotion, s: ComplexArray) -> tuple[tuple[Dof, ...], ComplexArray]:
    """Degrees of freedom, and weights (n_dofs, n_channels, n_modes) that turn channels of `data` into displacements.

    The displacement of mode k is weights[:, :, k] times the shape at the channels. `s` (n_modes,) are the poles in
    rad/s. A channel of the n-th derivative holds s^n times the displacement, with noise in proportion to its root mean
    square: weighted least squares over the channels of one degree of freedom. If all channels have one quantity, the
    weights are the identity and shapes stay in that quantity.
    """
    dofs = tuple(dict.fromkeys(data.channels))
    if len(set(data.quantities)) == 1:
        return dofs, np.repeat(np.eye(len(dofs))[:, :, None], len(s), axis=2).astype(np.complex128)
    factor = s[None, :] ** data.derivative[:, None]
    here = np.array([[channel == dof for channel in data.channels] for dof in dofs])[:, :, None]
    weight = np.where(here, factor.conj() / data.scale[:, None] ** 2, 0.0)
    total = np.sum(weight * factor, axis=1, keepdims=True)
    return dofs, weight / total


def require_length(data: ScaledMotion, lags: int, max_order: int) -> None:
    """Raise `InputError` if a record has fewer than 3 `lags` samples, or all too few for models of order `max_order`.

    `lags` is the number of samples that the lags span. Over all records together, the samples beyond `lags` of each
    must number at least `max_order`.
    """
    shortest = min(len(y) for y in data.series)
    needed = 3 * lags
    if shortest < needed:
        raise InputError(
            f"every record must hold at least {needed} samples for lags up to {lags} samples, got {shortest}; "
            "measure longer, or lower `block_rows`"
        )
    n_rows = sum(len(y) - lags for y in data.series)
    if n_rows < max_order:
        raise InputError(
            f"`records` must hold more than {max_order} instants for models of order {max_order}, got {n_rows}; "
            "measure longer, or lower `orders`"
        )


def pieces(data: ScaledMotion, head: int, tail: int, n_pieces: int = 1) -> tuple[RecordPiece, ...]:
    """Consecutive windows of all records, of about equal length, about `n_pieces` in all, as record lengths allow.

    Parameters
    ----------
    data : ScaledMotion
        Records that are cut; `series` holds the samples of each.
    head, tail : int
        Numbers of samples at the begin and at the end of each record that no window covers.
    n_pieces : int
        Number of windows wanted over all records; each record has at least one.

    Returns
    -------
    tuple of RecordPiece
        Record index (from 0), first sample and sample after the last of each window, by record and time. `part` is its
        number of samples over that of all windows.
    """
    lengths = np.array([len(y) - head - tail for y in data.series])
    counts = np.clip(np.round(n_pieces * lengths / lengths.sum()).astype(int), 1, np.maximum(lengths, 1))
    windows = []
    for number, (length, count) in enumerate(zip(lengths, counts, strict=True)):
        edges = head + np.round(np.linspace(0, length, count + 1)).astype(int)
        for start, stop in pairwise(edges.tolist()):
            windows.append(RecordPiece(number, start, stop, (stop - start) / float(lengths.sum())))
    return tuple(windows)


def lag_sums(y: FloatArray, first_lag: int, n_lags: int, start: int, stop: int) -> FloatArray:
    """Sum over s = start .. stop - 1 of y(s + k) y(s)' for k = first_lag .. first_lag + n_lags - 1.

    `y` is (n_times, n_channels); lags are in samples. Fourier transforms of segments, whose cross spectra add up, need about
    n_lags / 4 times fewer operations than one matrix product per lag. Samples after the end of `y` count as zero.

    Returns
    -------
    (n_lags, n_channels, n_channels) float array
    """
    from scipy import fft

    m = y.shape[1]
    size = fft.next_fast_len(max(8 * n_lags, 64), real=True)
    step = size - n_lags + 1
    n_inside = max(0, (min(stop, len(y) - first_lag - n_lags + 1) - start) // step)
    edge = start + n_inside * step
    spectrum = np.zeros((size // 2 + 1, m, m), dtype=np.complex128)
    for k in range(0, n_inside, _AT_ONCE):  # segments inside of `y`
        count, first = min(_AT_ONCE, n_inside - k), start + k * step
        here = y[first : first + count * step].reshape(count, step, m)
        windows = np.lib.stride_tricks.sliding_window_view(y[first + first_lag :], size, axis=0)
        ahead = windows[: count * step : step].transpose(0, 2, 1)
        spectrum += _cross_spectrum(fft.rfft(ahead, axis=1), fft.rfft(here, size, axis=1))
    for first in range(edge, stop, step):  # segments over its end
        end = min(first + step, stop)
        part = y[first + first_lag : end + first_lag + n_lags - 1]
        lines = (fft.rfft(values, size, axis=0)[None] for values in (part, y[first:end]) if len(values))
        spectrum += _cross_spectrum(*lines) if len(part) else 0.0
    return np.asarray(fft.irfft(spectrum, size, axis=0)[:n_lags])


def _cross_spectrum(ahead: ComplexArray, here: ComplexArray) -> ComplexArray:
    """Cross spectra ahead here^H summed over segments, (n_lines, n_channels, n_channels).

    Both arguments are (n_segments, n_lines, n_channels); `here` is conjugated in place.
    """
    return np.asarray(ahead.transpose(1, 2, 0) @ np.conjugate(here, out=here).transpose(1, 0, 2))


def _samples(y: FloatArray, start: int, stop: int) -> FloatArray:
    """Samples y[start:stop], (stop - start, n_channels), with zeros after the end of `y` as in `lag_sums`."""
    return np.concatenate([y[start:stop], np.zeros((max(0, stop - max(len(y), start)), y.shape[1]))])


def window_hankel(y: FloatArray, start: int, stop: int, rows: int, columns: int, offset: int) -> FloatArray:
    """Sum over t = start .. stop - 1 of [y(t+offset); ...; y(t+offset+rows-1)] [y(t); ...; y(t-columns+1)]'.

    `y` is (n_times, n_channels); `rows` and `columns` are numbers of blocks, `offset` is the lag of the first block in
    samples. Blocks of equal lag differ only by samples near the ends of the window.

    Returns
    -------
    (rows * n_channels, columns * n_channels) float array
    """
    m = y.shape[1]
    blocks = np.empty((rows, m, columns, m))
    sums = lag_sums(y, offset, rows + columns - 1, start, stop)
    back = columns - 1
    reach = max(offset, 0) + rows + columns
    head, tail = (_samples(y, edge - back, edge + reach) for edge in (start, stop))
    for k, whole in enumerate(sums):
        c = np.arange(1, min(back, k) + 1)
        entered, left = (part[back - c + offset + k] for part in (head, tail))
        change = entered[:, :, None] * head[back - c][:, None, :] - left[:, :, None] * tail[back - c][:, None, :]
        own = np.concatenate([whole[None], whole + np.cumsum(change, axis=0)])
        first = max(0, k - rows + 1)
        column = np.arange(first, len(own))
        blocks[k - column, :, column] = own[first:]
    return blocks.reshape(rows * m, columns * m)


def window_hankels(
    data: ScaledMotion, windows: Sequence[RecordPiece], rows: int, columns: int, offset: int
) -> Iterator[FloatArray]:
    """Block Hankel matrix of each window, in order, divided by the number of instants in all windows.

    Summed over the windows they are the mean over all instants. Each is (rows * n_channels, columns * n_channels) with
    block (i, j) y(t + offset + i) y(t - j)' summed over the instants t of its window, i and j from 0; y are the
    channels of `data`. `rows` and `columns` are numbers of blocks, `offset` is the lag of the first block in samples.
    """
    total = sum(piece.stop - piece.start for piece in windows)
    for piece in windows:
        y = data.series[piece.record]
        yield window_hankel(y, piece.start, piece.stop, rows, columns, offset) / total


def lag_hankels(
    data: ScaledMotion, windows: Sequence[RecordPiece], rows: int, columns: int, offset: int
) -> Iterator[FloatArray]:
    """Contribution of each window, in order, to the block Hankel matrix of the lag correlations; they add up to it.

    Each is (rows * n_channels, columns * n_channels); block (i, j) belongs to lag offset + i + j in samples, i and j
    from 0. A product of two samples counts in the window that holds the earlier one (the last window of a record
    reaches to its end), divided by the number of such products at that lag in all records of `data`. `rows` and
    `columns` are numbers of blocks. `windows` cover the records.
    """
    for piece in windows:
        y = data.series[piece.record]
        last = not any(p.record == piece.record and p.start >= piece.stop for p in windows)
        lags = np.arange(offset, offset + rows + columns - 1)
        n_pairs = np.sum([len(x) - lags for x in data.series], axis=0)
        stack = lag_sums(y, offset, len(lags), piece.start, len(y) if last else piece.stop) / n_pairs[:, None, None]
        yield hankel(stack, rows, columns)


def hankel(stack: FloatArray, rows: int, columns: int) -> FloatArray:
    """Block Hankel matrix, (rows * n_outputs, columns * n_inputs), with block stack[r + c] in block row r and column c.

    Parameters
    ----------
    stack : (rows + columns - 1, n_outputs, n_inputs) float array
    rows, columns : int
        Numbers of blocks.
    """
    blocks = np.lib.stride_tricks.sliding_window_view(stack, columns, axis=0)
    return np.ascontiguousarray(blocks.transpose(0, 1, 3, 2)).reshape(rows * stack.shape[1], -1)

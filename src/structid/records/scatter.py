"""The noise floor of frequency response functions, told by the scatter of neighbouring lines."""

from __future__ import annotations

from dataclasses import replace
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray
from structid.records.record import FrfRecord

#: Orders of the differences: the higher tells the floor, and both agree where it is white and the lines resolve the response.
_LOWER, _ORDER = 4, 6
#: Least and greatest ratio of both variances that white noise gives, and fewest windows of quiet lines.
_WHITE, _FEWEST_WINDOWS = (0.7, 1.4), 40
#: Size at most, and phase from that of white noise in rad at most, of the mean product of neighbouring sixth differences, of
#: modulus 1 each: white noise has -0.76, values that turn by one angle from line to line have modulus 1 and that phase.
_PHASOR, _TURNED = 0.9, 0.4
#: Part of the windows that are quiet, by the size of their values.
_QUIET = 0.5
#: Greatest difference of two line spacings within a window, as a part of the median spacing.
_EVEN = 1e-3
#: Scatter over the stated noise on quiet lines from which on that is called too small, and how much more it is than on the others.
_UNDERSTATED, _MORE_THAN_LOUD = 2.0, 1.5
#: Floor over assumed noise on quiet lines below which it is left out.
_NEGLIGIBLE = 0.2


class LineScatter(NamedTuple):
    """Scatter of neighbouring lines of each pair of sensor and load; all arrays are (n_outputs, n_inputs).

    Attributes
    ----------
    floor : float array
        Standard deviation of the complex noise on the quiet lines, in the unit of the record; 0 where it cannot be told.
    quiet, loud : float array
        Scatter over the stated standard deviation on the quiet half of the lines, and on the loud half; NaN where no floor is told.
    """

    floor: FloatArray
    quiet: FloatArray
    loud: FloatArray


def line_scatter(record: FrfRecord, stated: FloatArray) -> LineScatter:
    """Scatter of neighbouring lines of `record` for each pair of sensor and load, and the noise floor that it tells.

    Returns (n_outputs, n_inputs) arrays: `floor`, the standard deviation of the noise on the quiet lines, in the unit
    of the record, 0 where it cannot be told; `quiet` and `loud`, the scatter over the stated deviation on either half
    of the lines, NaN where there is no floor. `stated` (n_lines, n_outputs, n_inputs) are the variances that the noise
    is said to have.

    A smooth response cancels in sixth differences of evenly spaced lines, white noise does not (the weights of a
    difference of order p have the sum of squares C(2 p, p)). The floor is from the median square of these differences
    over the half of the windows of seven lines with the smallest values. It is 0 for a pair whose fourth differences
    give another size, since its noise is not white there or its lines do not resolve the response, and for one with
    fewer than 40 such windows.
    """
    shape, n_windows = record.values.shape[1:], len(record.frequency) - _ORDER
    scatter = LineScatter(np.zeros(shape), np.full(shape, np.nan), np.full(shape, np.nan))
    is_even = _evenly_spaced(record.frequency)
    if np.count_nonzero(is_even) * _QUIET < _FEWEST_WINDOWS:
        return scatter
    differences = _normalized_differences(record.values, _ORDER)
    higher = np.abs(differences) ** 2
    margin = (_ORDER - _LOWER) // 2
    lower = np.abs(_normalized_differences(record.values, _LOWER)[margin : margin + n_windows]) ** 2
    size = _mean_of_windows(np.abs(record.values) ** 2)
    stated = _mean_of_windows(stated)
    for pair in np.ndindex(shape):
        is_small = size[:, *pair] <= np.quantile(size[is_even, *pair], _QUIET)
        quiet, loud = is_even & is_small, is_even & ~is_small
        variance = _median_variance(higher[quiet, *pair])
        is_white = variance > 0 and _WHITE[0] < _median_variance(lower[quiet, *pair]) / variance < _WHITE[1]
        if not (is_white and _scatters(differences[:, *pair], quiet)):
            continue
        scatter.floor[pair] = np.sqrt(variance)
        over = np.divide(higher[:, *pair], stated[:, *pair], out=np.full(n_windows, np.inf), where=stated[:, *pair] > 0)
        scatter.quiet[pair], scatter.loud[pair] = (np.sqrt(_median_variance(over[half])) for half in (quiet, loud))
    return scatter


def missing_floor(record: FrfRecord, part: float, is_assumed: bool) -> FloatArray:
    """Noise floor of each pair that the stated noise leaves out, (n_outputs, n_inputs), in the record's unit; 0 where none.

    The stated noise is the variance of the record, if any, and `part` of each magnitude. A floor is left out where the lines
    scatter by twice the stated noise on the quiet half of them, and there by 1.5 times more than on the loud half: noise that is
    too small by one factor everywhere is no missing floor. With `is_assumed` nobody stated `part`: a floor counts from 0.2 times
    that on.
    """
    stated = (part * np.abs(record.values)) ** 2 + (0.0 if record.variance is None else record.variance)
    floor, quiet, loud = line_scatter(record, stated)
    least = _NEGLIGIBLE if is_assumed else _UNDERSTATED
    return np.where((quiet >= least) & (quiet >= _MORE_THAN_LOUD * loud), floor, 0.0)


def with_noise_floor(record: FrfRecord, floor: FloatArray) -> FrfRecord:
    """`record` with the squares of `floor` (n_outputs, n_inputs) added to its variances; the same where all are 0.

    The noise source of a record that states no noise becomes "scatter".
    """
    if not floor.any():
        return record
    stated = 0.0 if record.variance is None else record.variance
    source = "scatter" if record.variance is None else record.noise_source
    return replace(record, variance=np.broadcast_to(stated + floor**2, record.values.shape), noise_source=source)


def _evenly_spaced(frequency: FloatArray) -> NDArray[np.bool_]:
    """True for each window of seven lines that are evenly spaced, (n_lines - 6,); empty for fewer lines."""
    spacing = np.diff(frequency)
    if len(spacing) < _ORDER:
        return np.zeros(0, dtype=bool)
    usual = np.abs(spacing - np.median(spacing)) < _EVEN * np.median(spacing)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(usual, _ORDER).all(axis=1))


def _normalized_differences(values: ComplexArray, order: int) -> ComplexArray:
    """Differences of `order` along the lines, (n_lines - order, ...), of white noise with the variance of that noise."""
    return np.diff(values, order, axis=0) / np.sqrt(comb(2 * order, order))


def _mean_of_windows(values: FloatArray) -> FloatArray:
    """Means over windows of seven lines, (n_lines - 6, ...), of `values` (n_lines, ...)."""
    return np.lib.stride_tricks.sliding_window_view(values, _ORDER + 1, axis=0).mean(axis=-1)


def _scatters(differences: ComplexArray, chosen: NDArray[np.bool_]) -> bool:
    """True if neighbouring sixth differences (n_windows,) among the `chosen` go together as those of white noise do."""
    product = differences[1:] * differences[:-1].conj()
    product = product[chosen[1:] & chosen[:-1] & (np.abs(product) > 0)]
    phasor = complex(np.mean(product / np.abs(product))) if len(product) else 0.0
    return bool(abs(phasor) < _PHASOR and abs(np.angle(-phasor)) < _TURNED)


def _median_variance(squares: FloatArray) -> float:
    """Variance of complex Gaussian noise from the median of its squared moduli, which are exponential; 0 without values."""
    return float(np.median(squares) / np.log(2)) if len(squares) else 0.0

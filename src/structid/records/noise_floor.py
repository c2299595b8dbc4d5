"""The noise floor of frequency response functions, told by the scatter of neighbouring lines."""

from __future__ import annotations

from dataclasses import replace
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray
from structid.records.record import FrfRecord

#: Orders of the differences along the lines: the sixth gives the floor, the fourth checks it. A window is seven lines.
_LOWER, _ORDER = 4, 6
#: Variance by fourth over that by sixth differences, least and greatest, of noise that is independent from line to line and
#: lines that resolve the response; and fewest windows of quiet lines.
_WHITE, _FEWEST_WINDOWS = (0.7, 1.4), 40
#: The mean product of neighbouring sixth differences, each of modulus 1: it is -0.76 for independent noise, and exp(i a) for
#: values that turn by the angle a from line to line. Greatest modulus, and greatest angle (rad) from -1, that count as noise.
_PHASOR, _TURNED = 0.9, 0.4
#: Part of the windows that are quiet: those with the smallest mean square of their values. The others are loud.
_QUIET = 0.5
#: Greatest difference of a line spacing from the median spacing of the record, as a part of that.
_EVEN = 1e-3
#: Least scatter over stated deviation in quiet windows where that noise is too small, and least such ratio over that in loud
#: windows; the first where nobody stated the noise.
_UNDERSTATED, _MORE_THAN_LOUD = 2.0, 1.5
_UNDERSTATED_IF_ASSUMED = 0.2


class LineScatter(NamedTuple):
    """Scatter of neighbouring lines of each pair of sensor and load; all arrays are (n_outputs, n_inputs).

    Attributes
    ----------
    floor : float array
        Standard deviation of the complex noise in the quiet windows, in the unit of the record; 0 where it cannot be told.
    quiet, loud : float array
        Scatter in the quiet and in the loud windows over the deviation that is stated there; NaN where `floor` is 0.
    """

    floor: FloatArray
    quiet: FloatArray
    loud: FloatArray


def line_scatter(record: FrfRecord, stated: FloatArray) -> LineScatter:
    """The scatter of neighbouring lines of `record`, beside the noise that is stated.

    A smooth response cancels in sixth differences of evenly spaced lines, noise that is independent from line to line
    does not (the weights of a difference of order p have the sum of squares C(2 p, p)). The floor is the median of
    these differences over the quiet windows, the half with the smallest mean square of their values.

    It is 0 for all pairs where the record has fewer than 80 evenly spaced windows. It is 0 for a pair whose fourth
    differences give another size (the noise is not independent, or the lines do not resolve the response), whose values
    turn from line to line (as under a delay of about half the reciprocal line spacing), or that does not scatter at
    all.

    Parameters
    ----------
    record : FrfRecord
    stated : (n_lines, n_outputs, n_inputs) float array
        Variance E|error|^2 that the complex values are said to have.

    Returns
    -------
    LineScatter
        Floor (standard deviation of the complex noise, in the unit of the record), and scatter over stated deviation in
        the quiet and in the loud windows, (n_outputs, n_inputs) each; the latter two are NaN where the floor is 0.
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
        if not (is_white and _is_independent(differences[:, *pair], quiet)):
            continue
        scatter.floor[pair] = np.sqrt(variance)
        over = np.divide(higher[:, *pair], stated[:, *pair], out=np.full(n_windows, np.inf), where=stated[:, *pair] > 0)
        scatter.quiet[pair], scatter.loud[pair] = (np.sqrt(_median_variance(over[half])) for half in (quiet, loud))
    return scatter


def missing_floor(record: FrfRecord, part: float, is_assumed: bool) -> FloatArray:
    """Noise floor of each pair that the stated noise omits, (n_outputs, n_inputs), in the record's unit; 0 where none.

    The stated noise is the variance of the record, if any, and a standard deviation of `part` of each magnitude. It omits a
    floor where the quiet windows scatter by at least twice the stated deviation, and by 1.5 times more of it than the loud ones:
    noise that is too small by one factor everywhere omits no floor. With `is_assumed` nobody stated `part`, and 0.2 times the
    stated deviation is enough in place of twice.
    """
    stated = (part * np.abs(record.values)) ** 2 + (0.0 if record.variance is None else record.variance)
    floor, quiet, loud = line_scatter(record, stated)
    least = _UNDERSTATED_IF_ASSUMED if is_assumed else _UNDERSTATED
    return np.where((quiet >= least) & (quiet >= _MORE_THAN_LOUD * loud), floor, 0.0)


def with_noise_floor(record: FrfRecord, floor: FloatArray) -> FrfRecord:
    """`record` with the squares of `floor` (n_outputs, n_inputs) added to the variances of all lines; the same if all are 0.

    The noise source of a record without variances becomes "scatter"; pairs without a floor have variances of 0 then.
    """
    if not floor.any():
        return record
    stated = 0.0 if record.variance is None else record.variance
    source = "scatter" if record.variance is None else record.noise_source
    return replace(record, variance=np.broadcast_to(stated + floor**2, record.values.shape), noise_source=source)


def _evenly_spaced(frequency: FloatArray) -> NDArray[np.bool_]:
    """True for each window of seven lines of `frequency` whose spacings are the median one to 0.1 %, (n_lines - 6,).

    Empty for fewer than seven lines.
    """
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


def _is_independent(differences: ComplexArray, chosen: NDArray[np.bool_]) -> bool:
    """True if neighbouring sixth differences (n_windows,) among the `chosen` have the phase of noise, independent by line.

    False without two neighbours that are not 0.
    """
    product = differences[1:] * differences[:-1].conj()
    product = product[chosen[1:] & chosen[:-1] & (np.abs(product) > 0)]
    if not len(product):
        return False
    phasor = complex(np.mean(product / np.abs(product)))
    return abs(phasor) < _PHASOR and abs(float(np.angle(-phasor))) < _TURNED


def _median_variance(squares: FloatArray) -> float:
    """Variance of complex Gaussian noise from the median of its squared moduli, which are exponential; 0 without values."""
    return float(np.median(squares) / np.log(2)) if len(squares) else 0.0

"""Faults of single samples in one channel: clipping, drop-outs and spikes, and the repair of the last two.

Each test is scaled by the data around it, so that quantized, smooth, quiet and impulsive signals keep their samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import FloatArray, IntArray

Flags = NDArray[np.bool_]

_BLOCK = 64  # samples of a block with one scale of the second difference
_NEAR = 50  # samples on either side that show how often values repeat
_FALSE_ALARMS = 1e-3  # expected number in a channel of independent Gaussian samples
_MARGIN = 1.6  # over the Gaussian quantile, for scales from 64 samples that depend on each other


def runs(values: NDArray[np.generic]) -> tuple[IntArray, IntArray]:
    """First index and length of each run of equal values, two arrays (n_runs,), in order."""
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


def flagged_runs(flags: Flags) -> list[tuple[int, int]]:
    """Runs of True in a mask (n_times,), as (first sample, sample after the last) each."""
    starts, lengths = runs(flags)
    return [(int(a), int(a + n)) for a, n in zip(starts, lengths, strict=True) if flags[a]]


def quantum(y: FloatArray) -> float:
    """Least difference between values of `y` (n,), rounding apart: the step of the converter, or nearly 0; 0 if all are equal."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * np.ptp(y)]
    return float(steps.min()) if steps.size else 0.0


def clipped_samples(y: FloatArray) -> Flags:
    """Mask (n_times,) of samples of `y` at its highest or lowest value because the converter or amplifier saturates.

    That value must lie half a standard deviation from the median, occur 2.5 times as often as the next two steps of the
    converter together, and at least three times in a row away from the ends or 20 times in all. A smooth crest in
    coarse steps gives at most 1.4 times (levels in the ratio 1 : 0.41 : 0.32). None are flagged where `y` has fewer
    than four values. Signals that were filtered or resampled after clipping are not recognised.
    """
    flags = np.zeros(len(y), dtype=bool)
    levels, counts = np.unique(y, return_counts=True)
    if len(levels) < 4:
        return flags
    middle, spread, step = np.median(y), y.std(), quantum(y)
    for level, count in ((levels[0], counts[0]), (levels[-1], counts[-1])):
        below = counts[(np.abs(levels - level) < 2.5 * step) & (levels != level)].sum()
        if abs(level - middle) > 0.5 * spread and count >= max(4, 2.5 * below):
            at_level = y == level
            inner = [stop - start for start, stop in flagged_runs(at_level) if start > 0 and stop < len(y)]
            if inner and (max(inner) >= 3 or count >= 20):
                flags |= at_level
    return flags


def drop_outs(y: FloatArray, besides: Flags | None = None) -> list[tuple[int, int]]:
    """Runs of a repeated value that the samples around do not explain, as (first sample, sample after the last) each.

    With p the fraction of repeats among 50 samples on either side, a run of length L is expected N p^(L - 1) times among N
    samples. A run is reported if that is below 0.001, it is longer than eight times the 98 % quantile
    of all run lengths (crests in coarse steps), or than four samples if that quantile is 1, and the signal before or after it
    moves by four steps of the converter or more (else a decay has died out). There are none in fewer than 16 samples or four
    runs.

    Parameters
    ----------
    y : (n_times,) float array
        Samples of a channel.
    besides : (n_times,) bool array, optional
        Samples that are known to repeat (clipped ones); runs of them are not reported.
    """
    starts, lengths = runs(y)
    n = len(y)
    if n < 16 or len(starts) < 4:
        return []
    total = np.concatenate([[0], np.cumsum(np.concatenate([[False], y[1:] == y[:-1]]))])
    stops = starts + lengths
    before, after = np.maximum(starts - _NEAR, 0), np.minimum(stops + _NEAR, n)
    repeats = total[starts] - total[before] + total[after] - total[np.minimum(stops + 1, n)]
    seen = (starts - before) + (after - stops)
    chance = (repeats + 1) / (seen + 2)
    rare = np.log(n) + (lengths - 1) * np.log(chance) < np.log(_FALSE_ALARMS)
    usual = np.quantile(lengths, 0.98)
    rare &= lengths > (8 * usual if usual > 1 else 4)
    least = 4 * quantum(y) if rare.any() else 0.0
    runs_found = []
    for i in np.flatnonzero(rare):
        start, stop = int(starts[i]), int(stops[i])
        if besides is not None and besides[start]:
            continue
        around = [part for part in (y[before[i] : start], y[stop : after[i]]) if len(part)]
        if max(np.ptp(part) for part in around) >= least:
            runs_found.append((start, stop))
    return runs_found


def spikes(y: FloatArray) -> Flags:
    """Mask (n_times,) of single samples of `y`, up to about three in a row, that lie off the motion around them.

    e_i = y_i - (y_(i-1) + y_(i+1)) / 2 is compared with the median of |e| in blocks of 64 samples, the greatest of a
    block and its neighbours; the limit is 1.6 times the Gaussian quantile for 0.001 false alarms per channel. A spike
    starts and ends on the motion (the sum of e and its first moment vanish over it) and leaves nothing behind: a step,
    a kink or a shock that rings is no spike. Records shorter than two blocks have none.
    """
    from scipy.stats import norm

    n = len(y)
    flags = np.zeros(n, dtype=bool)
    if n < 2 * _BLOCK:
        return flags
    e = np.zeros(n)
    e[1:-1] = y[1:-1] - (y[:-2] + y[2:]) / 2
    limit = _MARGIN * float(norm.isf(_FALSE_ALARMS / (2 * n))) * np.maximum(local_scale(e), 0.5 * quantum(y))
    hot = np.flatnonzero(np.abs(e) > limit)
    if not len(hot):
        return flags
    for group in np.split(hot, np.flatnonzero(np.diff(hot) > 3) + 1):
        first, last = int(group[0]) - 1, int(group[-1]) + 1
        if last - first <= 6 and _is_spike(e, first, last):
            line = np.interp(np.arange(first, last + 1), [first - 1, last + 1], y[[first - 1, min(last + 1, n - 1)]])
            distance = np.abs(y[first : last + 1] - line)
            flags[first : last + 1] |= distance > 0.5 * distance.max()
    return flags


def local_scale(e: FloatArray) -> FloatArray:
    """Standard deviation of `e` (n_times,) around each sample, (n_times,), by medians of |e| in blocks of 64 samples.

    The largest of a block and both neighbours counts; samples after the last whole block take that of it.
    """
    n_blocks = len(e) // _BLOCK
    medians = np.median(np.abs(e[: n_blocks * _BLOCK]).reshape(n_blocks, _BLOCK), axis=1) / 0.6745
    padded = np.concatenate([medians[:1], medians, medians[-1:]])
    greatest = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return np.asarray(greatest[np.minimum(np.arange(len(e)) // _BLOCK, n_blocks - 1)])


def _is_spike(e: FloatArray, first: int, last: int) -> bool:
    """True if the second differences `e` (n_times,) over samples `first` to `last` (included) are those of an isolated spike.

    They must sum to about 0, also weighted by time, and be small within the twelve samples on either side.
    """
    if first < 1 or last > len(e) - 2:
        return False
    in_spike = e[first : last + 1]
    offset = np.arange(len(in_spike)) - (len(in_spike) - 1) / 2
    if abs(in_spike.sum()) > 0.3 * np.abs(in_spike).sum() or abs(offset @ in_spike) > 0.3 * np.abs(offset) @ np.abs(
        in_spike
    ):
        return False
    outside = np.concatenate([e[max(first - 12, 0) : first], e[last + 1 : last + 13]])
    return bool(np.abs(outside).max(initial=0.0) < 0.2 * np.abs(in_spike).max())


def fill_missing(y: FloatArray, missing: Flags) -> FloatArray:
    """`y` (n_times,) with the samples in the mask `missing` replaced by the cubic through two kept samples on either side.

    With fewer kept samples on a side the polynomial is of lower degree; before the first and after the last kept sample its
    value is held.
    """
    result, kept = np.array(y, dtype=float), np.flatnonzero(~missing)
    for start, stop in flagged_runs(missing):
        index = int(np.searchsorted(kept, start))
        left, right = kept[max(index - 2, 0) : index], kept[index : index + 2]
        nodes = np.concatenate([left, right])
        if not len(left) or not len(right):
            result[start:stop] = y[left[-1]] if len(left) else y[right[0]]
            continue
        offset = (np.arange(start, stop)[:, None] - nodes) / (stop - start + 1.0)
        gaps = (nodes[:, None] - nodes) / (stop - start + 1.0)
        others = ~np.eye(len(nodes), dtype=bool)
        weights = [offset[:, others[k]].prod(axis=1) / gaps[k, others[k]].prod() for k in range(len(nodes))]
        result[start:stop] = np.stack(weights, axis=1) @ y[nodes]
    return result

"""Continuation from the right half-plane: the smooth data of its stages, and how far off the start is taken to be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import InputError
from structid.records import FrfRecord
from structid.records.half_plane import right_half_plane
from structid.unknowns.named_unknowns import DAMPING, NamedUnknowns

#: Decay of the smoothed lines in parts of their angular frequency, from far off the axis down to it.
LEVELS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.09, 0.06, 0.03, 0.015)
#: What the start is expected to be off by, in the logarithm: 0.5 is a factor of 1.65.
START_ERROR = 0.5
_DAMPING_ERROR = 1.0
_FEWEST_LINES = 60
_MOST_LINES = 250
_USABLE_LINES = 8
_THINNED_LINES = 2000
_NOISY = 0.2


def start_deviation(unknowns: NamedUnknowns, start_error: float) -> FloatArray:
    """Expected error (n_params,) of each free variable of `unknowns` at the start, if values are off by `start_error`.

    That is relative to the size of the parameter; a size of 0 counts as 1 of the free variable. Dampings are taken as
    wrong by 1 of their size at least. Infinite for a parameter with a prior. The unit is that of the free variable.
    """
    expected = np.where(np.isin(unknowns.kinds, DAMPING), max(start_error, _DAMPING_ERROR), start_error)
    slope = unknowns.transforms.slope(unknowns.theta_start)
    size = unknowns.sizes(unknowns.start) / np.abs(slope)
    width = expected * np.where(size > 0, size, 1.0)
    return np.where(unknowns.priors.stated, np.inf, width)


def level_frequencies(omega: FloatArray, level: float) -> FloatArray:
    """Angular frequencies over the band of `omega` (rad/s), evenly spaced in the logarithm by about `level`.

    There are at least `_FEWEST_LINES` (60) and at most `_MOST_LINES` (250).
    """
    count = int(np.clip(np.log(omega[-1] / omega[0]) / level, _FEWEST_LINES, _MOST_LINES))
    return np.geomspace(omega[0], omega[-1], count)


def smoothed_records(record: FrfRecord, levels: Sequence[float] = LEVELS) -> tuple[tuple[float, FrfRecord], ...]:
    """Pairs of a level a and the FRFs at s = d + omega (a + i), with d the decay of `record`, for each of `levels`.

    FRFs away from the imaginary axis are smooth; they come from those on it by rational transformation. Lines are
    evenly spaced in the logarithm by a, at least 60 and at most 250 over the band. A level is left out where fewer than
    eight of its lines are good to 25 %; the result is empty if `record` has fewer than eight lines above 0 Hz.
    """
    omega = record.omega[record.omega > 0]
    if len(omega) < _USABLE_LINES:
        return ()
    record_decay = 0.0 if record.decay is None else float(record.decay[0])
    records = []
    for level in levels:
        omegas = level_frequencies(omega, level)
        try:
            smooth = right_half_plane(record, omegas / (2 * np.pi), record_decay + level * omegas)
        except InputError:
            continue
        if len(smooth.frequency) >= _USABLE_LINES:
            records.append((level, smooth))
    return tuple(records)


def is_noisy(record: FrfRecord) -> bool:
    """True if the median noise of the values exceeds 20 % of their magnitude; False for a record without variance."""
    return record.variance is not None and bool(np.median(record.variance / np.abs(record.values) ** 2) > _NOISY**2)


def thinned_lines(omega: FloatArray) -> IntArray:
    """Indices of at most about 2000 lines, evenly spread in the logarithm; all if no more than 2000 lie above 0 Hz.

    `omega` (n_lines,) are ascending angular frequencies. The first line of each of many equal logarithmic intervals is
    taken.
    """
    positive = omega[omega > 0]
    if len(positive) <= _THINNED_LINES:
        return np.arange(len(omega))
    low, high = 0.0, float(np.log(positive[-1] / positive[0]))
    keep = _spread(omega, high / _THINNED_LINES)
    for _ in range(30):
        step = 0.5 * (low + high)
        keep = _spread(omega, step)
        low, high = (step, high) if len(keep) > _THINNED_LINES else (low, step)
    return keep


def _spread(omega: FloatArray, step: float) -> IntArray:
    stretch = np.floor(np.log(np.maximum(omega, omega[omega > 0][0]) / omega[omega > 0][0]) / step)
    return np.flatnonzero(np.concatenate([[True], np.diff(stretch) > 0]))

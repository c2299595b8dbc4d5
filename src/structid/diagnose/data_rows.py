"""Whitened data rows: their size line by line, lines and tones that stand out, and the price of rows with larger errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from structid.core.arrays import FloatArray
from structid.diagnose.thresholds import (
    LINES_ABOUT,
    LONGEST_OUTLIER,
    MOST_TONES,
    OUTLYING_LINE,
    TONE_SKIRT,
)
from structid.forward import FrfProblem, RecordProblem

if TYPE_CHECKING:
    from structid.forward import SpectraProblem


def scaled_misfit(squares: float, n_rows: int) -> float:
    """Misfit, -2 ln likelihood, of `n_rows` rows with the sum of squares `squares`, errors scaled by the likeliest factor.

    The factor is never below 1: with `squares` up to `n_rows` the misfit is `squares`.
    """
    return float(n_rows * (1 + np.log(squares / n_rows))) if squares > n_rows > 0 else squares


def rows_of(problems: Sequence[RecordProblem], residual: FloatArray) -> Iterator[tuple[RecordProblem, FloatArray]]:
    """Pairs (problem, its part of `residual`) of all problems; `residual` (n_rows,) has their whitened data rows in order."""
    first = 0
    for problem in problems:
        yield problem, residual[first : first + problem.n_data]
        first += problem.n_data


def misfit_of_lines(problem: RecordProblem, residual: FloatArray) -> FloatArray:
    """Mean square of the whitened data rows `residual` (n_data,) on each frequency line, (n_lines,).

    0 on lines without rows.
    """
    count = np.bincount(problem.rows.lines, minlength=len(problem.frequency))
    found: FloatArray = np.bincount(problem.rows.lines, residual**2, len(problem.frequency)) / np.maximum(count, 1)
    return found


def _level_about(size: FloatArray) -> FloatArray:
    """Median of the misfit `size` (n_lines,) over the 21 lines about each line, at least 1: (n_lines,)."""
    level: FloatArray = np.maximum(np.median(_neighbours(size, LINES_ABOUT), axis=1), 1.0)
    return level


def _neighbours(size: FloatArray, width: int) -> FloatArray:
    """The `width` (odd) values of `size` (n_lines,) about each line, (n_lines, width); beyond the ends the end value again."""
    return sliding_window_view(np.pad(size, width // 2, mode="edge"), width)


def outlying_spans(problem: FrfProblem, residual: FloatArray) -> tuple[str, ...]:
    """Spans of lines whose misfit stands out from those about them, as ``49.8 to 50.2 Hz``, in rising order.

    A line stands out if its misfit is 8 times the median of 21 lines about it, or 8 if that is below 1. Empty if more
    than a tenth of the lines do (three at least). Runs of more than three lines are left out: they are resonances that
    the model misses. `residual` (n_data,) is the whitened residual of the problem.
    """
    frequency = problem.frequency
    size = misfit_of_lines(problem, residual)
    out = np.flatnonzero(size > OUTLYING_LINE * _level_about(size))
    if not 0 < len(out) <= max(3, len(frequency) // 10):
        return ()
    runs = [run for run in np.split(out, np.flatnonzero(np.diff(out) > 1) + 1) if len(run) <= LONGEST_OUTLIER]
    if not runs:
        return ()
    edges = np.concatenate([[2 * frequency[0] - frequency[1]], frequency, [2 * frequency[-1] - frequency[-2]]])
    middles = np.array([(a + b) / 2 for a, b in pairwise(edges)])
    return tuple(f"{middles[run[0]]:.5g} to {middles[run[-1] + 1]:.5g} Hz" for run in runs)


def tones(problem: SpectraProblem, residual: FloatArray) -> tuple[str, ...]:
    """Steady tones in the misfit of a record, as ``50.003 Hz``, sorted by frequency; the six largest at most.

    A tone is a line whose misfit is 8 times the median of 21 lines about it (8 if that is below 1) and the largest of
    the four lines to either side, and whose neighbours fall off as 1 / (f - f0)^2: four lines off the misfit is at most
    1/16. The two lines about a tone have amplitudes in inverse proportion to their distances from it, which gives its
    frequency. `residual` (n_data,) is the whitened residual of the problem.
    """
    frequency, size = problem.frequency, misfit_of_lines(problem, residual)
    is_largest = size == _neighbours(size, 2 * TONE_SKIRT + 1).max(axis=1)
    peaks = np.flatnonzero(is_largest & (size > OUTLYING_LINE * _level_about(size)))
    found = []
    for k in peaks[np.argsort(-size[peaks])][:MOST_TONES].tolist():
        if max(size[max(k - TONE_SKIRT, 0)], size[min(k + TONE_SKIRT, len(size) - 1)]) > size[k] / TONE_SKIRT**2:
            continue
        near = k + 1 if k == 0 or (k + 1 < len(size) and size[k + 1] > size[k - 1]) else k - 1
        weights = np.sqrt(size[[k, near]])
        found.append(float(weights @ frequency[[k, near]] / weights.sum()))
    return tuple(f"{value:.7g} Hz" for value in sorted(found))

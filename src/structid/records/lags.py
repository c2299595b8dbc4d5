"""Lags of stored correlation functions: where lag 0 is, and which half of a function belongs to a pair or to its reverse."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import FileError

#: What a lag is; programs that count it the other way give shapes of the references in place of those of the channels.
FORWARD = "taken as the mean product of the response at t + lag and the reference at t"
#: Unevenness of lags allowed, as a part of the step, and of symmetry, as a part of the value at lag 0.
_EVEN, _SYMMETRIC = 1e-2, 1e-3


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
    if len(steps) < 2 or not (steps > 0).all() or np.ptp(steps) > _EVEN * steps.mean():
        raise FileError(f"{path}: lags must rise in even steps; export correlation functions at evenly spaced lags")
    return float((lag[-1] - lag[0]) / (len(lag) - 1))


def lag_halves(path: Path, lag: FloatArray, values: Mapping[tuple[Dof, Dof], FloatArray]) -> TwoSidedCorrelations:
    """Correlation functions split at lag 0 into non-negative and negative lags, both ordered from lag 0 outwards.

    Returns forward and backward functions by pair of channels, each beginning with lag 0, and words on the lags. The
    backward ones are {} if the lags begin at 0 s and nothing shows that the second half are negative lags.

    Parameters
    ----------
    path : Path
        File, named in errors.
    lag : (n_points,) float array
        Lags in s, evenly spaced, with 0 s among them.
    values : mapping of (Dof, Dof) to (n_points,) float arrays
        Correlation function of each pair of channels. If the lags begin at 0 s and every autocorrelation is symmetric about
        the middle, the second half holds the negative lags, as a Fourier transform leaves them.

    Raises
    ------
    FileError
        If lags are uneven, lag 0 is not among them, or an autocorrelation is not symmetric about lag 0.
    """
    step = step_of(path, lag)
    zero = round(-lag[0] / step)
    if not 0 <= zero < len(lag) or abs(lag[0] + zero * step) > _EVEN * step:
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

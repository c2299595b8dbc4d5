"""Continuation from the right half-plane: one minimum followed from smooth data down to the measured FRFs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from structid.arrays import FloatArray, IntArray
from structid.errors import InputError
from structid.records import FrfRecord
from structid.records.transforms.half_plane import right_half_plane

if TYPE_CHECKING:
    from structid.observation.frf.problem import FrfProblem

#: Decay of the smoothed lines in parts of their angular frequency, from far off the axis down to it.
LEVELS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.09, 0.06, 0.03, 0.015)
#: What the start is expected to be off by, in the logarithm: 0.5 is a factor of 1.65.
START_ERROR = 0.5
_DAMPING = ("viscous_damping", "loss_factor")
_DAMPING_ERROR = 1.0
_FEWEST_LINES = 60
_MOST_LINES = 250
_USABLE_LINES = 8
_THINNED_LINES = 2000
_WORTH_THINNING = 10
_NOISY = 0.2


def start_deviation(problem: FrfProblem, start_error: float) -> FloatArray:
    """Expected error of each free variable at the start; damping, seldom known, by 1 at least; infinite with a prior."""
    expected = np.where(np.isin(problem.kinds, _DAMPING), max(start_error, _DAMPING_ERROR), start_error)
    theta = problem.theta_start
    size = problem.sizes(problem.physical(theta)) / np.abs(problem.slope(theta))
    width = expected * np.where(size > 0, size, 1.0)
    return np.where(np.isfinite(problem.prior_std), np.inf, width)


def smoothed_records(record: FrfRecord, levels: tuple[float, ...] = LEVELS) -> tuple[tuple[float, FrfRecord], ...]:
    """The record at s = omega (a + i) for each level a that its lines allow.

    Lines are spaced evenly in the logarithm, a apart, at least 60 and at most 250 over the band. A level is left out
    where fewer than eight of its lines are good to 25 %: see `right_half_plane`.
    """
    omega = record.omega[record.omega > 0]
    if len(omega) < _USABLE_LINES:
        return ()
    own = 0.0 if record.decay is None else float(record.decay[0])
    found = []
    for level in levels:
        count = int(np.clip(np.log(omega[-1] / omega[0]) / level, _FEWEST_LINES, _MOST_LINES))
        at = np.geomspace(omega[0], omega[-1], count)
        try:
            smooth = right_half_plane(record, at / (2 * np.pi), own + level * at)
        except InputError:
            continue
        if len(smooth.frequency) >= _USABLE_LINES:
            found.append((level, smooth))
    return tuple(found)


def continuation_plan(problem: FrfProblem, start_error: float = START_ERROR) -> tuple[tuple[str, FrfProblem], ...]:
    """Stages from smooth data far right of the axis down to the axis; empty where lines are too few.

    At s = omega (a + i) with a near 1 an FRF has no resonances, and a fit cannot be caught between them; as a goes
    to 0 it becomes what was measured. Each stage fits the logarithm of the FRF, weighted by the error that
    smoothing leaves; the last one the FRF itself, with the start still held, by the pole-free residual or, where noise
    is more than a fifth of most values, by the plain one.

    Parameters
    ----------
    problem : FrfProblem
        Its `theta_start` is the centre of the prior that holds what the smooth data do not say.
    start_error : float
        Standard deviation of that prior, in the logarithm; for damping at least 1.

    References
    ----------
    Shin and Cha (2009), Geophysical Journal International 177, 1067-1079.
    """
    decay = problem.record.decay
    if problem.form == "equation" or (decay is not None and np.ptp(decay) > 0):
        return ()
    smooth = smoothed_records(problem.record)
    if not smooth:
        return ()
    prior = (problem.theta_start, start_deviation(problem, start_error))
    held = replace(problem, start_prior=prior, measured_sliding=True)
    stages = [
        (f"decay {level:g} omega", replace(held, form="log", model_error=0.0, record=record))
        for level, record in smooth
    ]
    near = replace(held, form="output") if _noisy(problem.record) else replace(held, form="pole_free")
    return *stages, ("held on the axis", thinned_problem(near) or near)


def _noisy(record: FrfRecord) -> bool:
    """Whether the noise of most lines is too large for a residual that is divided by what was measured."""
    return record.variance is not None and bool(np.median(record.variance / np.abs(record.values) ** 2) > _NOISY**2)


def nearer(plan: tuple[tuple[str, FrfProblem], ...], ratio: float = 0.5) -> tuple[tuple[str, FrfProblem], ...]:
    """The same stages with the start expected to be closer: its error smaller by `ratio`."""
    held = [(name, stage, stage.start_prior) for name, stage in plan]
    return tuple((n, replace(s, start_prior=None if p is None else (p[0], ratio * p[1]))) for n, s, p in held)


def thinned_problem(problem: FrfProblem) -> FrfProblem | None:
    """The problem on about 2000 of its lines, evenly spread in the logarithm; None with less than ten times as many.

    Fewer lines say less: what noisy lines determine only together may be lost, so that the search takes all of them
    where their number allows.
    """
    record, keep = problem.record, thinned_lines(problem.record.omega)
    return None if _WORTH_THINNING * len(keep) > len(record.frequency) else replace(problem, record=record.lines(keep))


def thinned_lines(omega: FloatArray) -> IntArray:
    """Indices of lines that are at least one of about 2000 equal logarithmic steps apart."""
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

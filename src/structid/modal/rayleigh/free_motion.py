"""Free motion from time records, arranged for averages over time: samples in rows, quadrature weights beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES

RULES = ("trapezoid", "left", "interior", "gregory")
_GREGORY_ORDER = 7  # differences at each end; from order 8 on some weights are negative


def sample_weights(n_samples: int, rule: str) -> FloatArray:
    """Quadrature weights of samples 0..N for the average over the N steps between them, (n_samples,).

    Parameters
    ----------
    n_samples : int
        N + 1.
    rule : {"trapezoid", "left", "interior", "gregory"}
        ``left`` takes samples 0..N-1 and ``interior`` 1..N-1, each by 1/N; ``trapezoid`` halves the two ends;
        ``gregory`` corrects the trapezoid by differences at the ends, with an error of order step^9.

    References
    ----------
    Hildebrand (1974), Introduction to Numerical Analysis, 2nd ed., section 5.9 (Gregory's formula).
    """
    weights = np.ones(n_samples)
    if rule in ("left", "interior"):
        weights[-1] = 0.0
        weights[0] = float(rule == "left")
    else:
        weights[[0, -1]] = 0.5
    if rule == "gregory":
        order = min(_GREGORY_ORDER, (n_samples - 1) // 2)
        difference = np.array([1.0])
        for coefficient in _gregory_coefficients(order):
            difference = np.convolve(difference, [1.0, -1.0])
            weights[: len(difference)] -= coefficient * difference
            weights[::-1][: len(difference)] -= coefficient * difference
    return weights / (n_samples - 1)


def _gregory_coefficients(order: int) -> list[float]:
    """Magnitudes of Gregory's coefficients, `order` of them: 1/12, 1/24, 19/720, ..., of z / log(1 + z) from z^2 on."""
    series = [1.0]
    for n in range(1, order + 2):
        series.append(-sum(series[k] * (-1.0) ** (n - k) / (n - k + 1) for k in range(n)))
    return [abs(c) for c in series[2:]]


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """All records' samples, one below the other.

    Attributes
    ----------
    channels : tuple of Dof
    base : (n_rows, n_channels) float array
        The first quantity y, in the unit of the record.
    derivative : (n_rows, n_channels) float array
        Its time derivative, or its negative second one (measured, or the second difference of y).
    weights : (n_rows,) float array
        Of each row in averages over time by the rule asked for; their sum is about 1.
    smooth_weights : (n_rows,) float array
        The same by ``gregory``, the most exact rule.
    ends : (n_channels, n_channels) float array
        [ydot y'] from start to end of each record, summed, over the total duration; zero where not asked for.
    inner, curvature : (n_inner, n_channels) float arrays
        y, and its negative second derivative at the same instants: measured, or by differences of samples.
    duration : float
        Of the longest record, s.
    step : float
        Sampling step in s (of the first record).
    """

    channels: tuple[Dof, ...]
    base: FloatArray
    derivative: FloatArray
    weights: FloatArray
    smooth_weights: FloatArray
    ends: FloatArray
    inner: FloatArray
    curvature: FloatArray
    duration: float
    step: float

    @property
    def misfit(self) -> float:
        """Relative RMS part (0 to 1) of the acceleration that no constant matrix times the motion explains; 0 without motion.

        Undamped modes, no more than channels, leave nothing, whatever the step: the second difference of cos(w t) is
        -(4/h^2) sin^2(w h/2) cos(w t), and the central difference of its derivative -(w/h) sin(w h) cos(w t).
        """
        triangle = np.asarray(np.linalg.qr(np.concatenate([self.inner, self.curvature], axis=1), mode="r"))
        x, y = triangle[:, : len(self.channels)], triangle[:, len(self.channels) :]
        size = np.linalg.norm(y)
        return float(np.linalg.norm(y - x @ np.linalg.lstsq(x, y, rcond=1e-12)[0]) / size) if size > 0 else 0.0


def free_motion(records: Sequence[TimeRecord], quantities: Sequence[str], rule: str) -> FreeMotion:
    """Motion samples and time derivatives of free responses, checked, with weights for time averages.

    Parameters
    ----------
    records : sequence of TimeRecord
        Free responses with the same channels; lengths may differ, each counts by its duration.
    quantities : one or two names
        The first quantity, and the one that holds its first or second derivative. With one name the second
        derivative is taken by differences of samples; the first and last sample of each record then drop out.
    rule : str
        See `sample_weights`.

    Raises
    ------
    InputError
        If a record lacks a quantity or has other channels, samples are too few, or sampling steps differ for differences.
    """
    channels = _channels(records, quantities)
    parts = [_one_record(record, channels, quantities, rule) for record in records]
    steps, durations = np.array([part.step for part in parts]), np.array([part.duration for part in parts])
    if len(quantities) == 1 and np.ptp(steps) > 1e-9 * steps.max():
        raise InputError(
            f"`records` must share one sampling step for second differences, got {steps.min():g} to {steps.max():g} s; "
            "resample them, or measure the derivative too"
        )
    shares = durations / durations.sum()
    return FreeMotion(
        channels,
        np.concatenate([part.base for part in parts]),
        np.concatenate([part.derivative for part in parts]),
        np.concatenate([share * part.weights for share, part in zip(shares, parts, strict=True)]),
        np.concatenate([share * part.smooth_weights for share, part in zip(shares, parts, strict=True)]),
        np.sum([part.ends for part in parts], axis=0) / durations.sum(),
        np.concatenate([part.inner for part in parts]),
        np.concatenate([part.curvature for part in parts]),
        float(durations.max()),
        float(steps[0]),
    )


def _one_record(record: TimeRecord, channels: tuple[Dof, ...], quantities: Sequence[str], rule: str) -> FreeMotion:
    """`FreeMotion` of one record, weighted for time averages by the `rule`; arguments as in `free_motion`.

    Its `ends` are the boundary terms times the duration. The matrices are in the order of `channels`.
    """
    base, *measured = (_columns(record, channels, quantity) for quantity in quantities)
    step, inner, no_ends = 1 / record.sampling_rate, base[1:-1], np.zeros((len(channels),) * 2)
    spans = step * (len(base) - 1), step
    if not measured:
        second = (2 * inner - base[2:] - base[:-2]) / step**2
        equal = np.full(len(inner), 1 / len(inner))
        return FreeMotion(channels, inner, second, equal, equal, no_ends, inner, second, *spans)
    derivative = measured[0]
    weights, smooth = sample_weights(len(base), rule), sample_weights(len(base), "gregory")
    if MOTION_DERIVATIVES[quantities[1]] - MOTION_DERIVATIVES[quantities[0]] == 2:
        return FreeMotion(channels, base, -derivative, weights, smooth, no_ends, base, -derivative, *spans)
    ends = np.outer(derivative[-1], base[-1]) - np.outer(derivative[0], base[0])
    curvature = (derivative[:-2] - derivative[2:]) / (2 * step)
    return FreeMotion(channels, base, derivative, weights, smooth, ends, inner, curvature, *spans)


def _channels(records: Sequence[TimeRecord], quantities: Sequence[str]) -> tuple[Dof, ...]:
    """Degrees of freedom with all `quantities` in every record, in the order of the first record.

    `InputError` if a quantity is missing, degrees of freedom differ, or samples are too few.
    """
    if not records:
        raise InputError("`records` must hold at least one TimeRecord, got none")
    wanted: tuple[Dof, ...] | None = None
    for number, record in enumerate(records, 1):
        if not isinstance(record, TimeRecord):
            raise InputError(f"`records` must be TimeRecords of free vibration, got {type(record).__name__}")
        for quantity in quantities:
            found = tuple(c for c, q in zip(record.channels, record.quantities, strict=True) if q == quantity)
            if not found:
                raise InputError(
                    f"record {number} has no {quantity} channel; it holds {', '.join(sorted(set(record.quantities)))}. "
                    "Choose another `pair`, or form='second_difference', which needs one quantity only"
                )
            wanted = found if wanted is None else wanted
            if set(found) != set(wanted):
                odd = ", ".join(str(dof) for dof in sorted(set(found) ^ set(wanted)))
                raise InputError(
                    f"{quantity} of record {number} must be at the same degrees of freedom as {quantities[0]} of "
                    f"record 1, got a difference at {odd}; leave out the channels that are not common"
                )
    assert wanted is not None
    n_samples = sum(len(record.values) for record in records)
    shortest = min(len(record.values) for record in records)
    if shortest < 3 or n_samples < 2 * len(wanted) + 2:
        raise InputError(
            f"`records` must hold at least {2 * len(wanted) + 2} samples for {len(wanted)} channels (3 a record), "
            f"got {n_samples} (shortest {shortest}); measure longer"
        )
    return wanted


def _columns(record: TimeRecord, channels: tuple[Dof, ...], quantity: str) -> FloatArray:
    """Samples of `quantity` at `channels`, (n_times, n_channels)."""
    column_of = {
        (str(dof), str(held)): i for i, (dof, held) in enumerate(zip(record.channels, record.quantities, strict=True))
    }
    return np.take(record.values, [column_of[str(channel), quantity] for channel in channels], axis=1)

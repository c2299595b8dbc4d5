"""Unknown forces: where they act, the process that each is taken to be, and its equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import linalg, signal

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError, NoAnswerError
from structid.fem import Structure

#: Filter against aliasing: elliptic, order, ripple and attenuation in dB, passing up to half the sampling rate. It must be steep:
#: lightly damped modes just above ring in whatever it lets through. Deviations of accelerations are those of the errors behind a
#: filter that halves what is at half the sampling rate, and wider than the errors behind one that ends before.
_FILTER = 9, 0.1, 80.0
#: Rate at which each low-pass of a force forgets its input, over one by the correlation time, for each order that is tried: the
#: correlation time is the integral of the correlation from 0 on (without a frequency), which is exp(-|t| / T) for order 1.
_FADING = {1: 1.0, 2: 2.0, 3: 8 / 3}
HIGHEST_ORDER = max(_FADING)
#: Part of the sum of squares of what forces move, below which a combination of them moves nothing.
_DEPENDENT = 1e-10


@dataclass(frozen=True)
class UnknownForces:
    """Forces that act and were not measured: independent, stationary, with the covariance std^2 exp(-|t| / correlation_time).

    Parameters
    ----------
    dofs : sequence of Dof or str
        Where they act.
    correlation_time : float, optional
        s; short for wind or traffic, long for what changes slowly. By default the shortest one under which the record is as
        likely, but for chance, as under any; where that does not fit, and neither it nor `std` is stated, the spectrum of the
        forces may fall more steeply, as behind two or three low-passes of first order, and lie about the likeliest frequency:
        the correlation time is then the integral of the correlation, or of its envelope, from 0 on.
    std : float, optional
        N; the one under which the record is likeliest by default.
    """

    dofs: Sequence[Dof | str]
    correlation_time: float | None = None
    std: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` where no force is named, or for a correlation time or standard deviation that is not positive."""
        if not len(self.dofs):
            raise InputError(
                "`dofs` of unknown forces must name where they act, got none; leave `unknown` out if there are none"
            )
        if self.correlation_time is not None and not (np.isfinite(self.correlation_time) and self.correlation_time > 0):
            raise InputError(f"`correlation_time` must be greater than 0 s, got {self.correlation_time:g}")
        if self.std is not None and not (np.isfinite(self.std) and self.std > 0):
            raise InputError(f"`std` of unknown forces must be greater than 0 N, got {self.std:g}")


@dataclass(frozen=True)
class ForceProcess:
    """The stationary process that each unknown force is taken to be, independent of the others.

    Attributes
    ----------
    correlation_time : float
        s, the integral of the correlation, or of its envelope, from 0 on.
    std : float
        Standard deviation, N.
    frequency : float
        Hz, about which the spectrum lies; 0 where it falls from 0 Hz on.
    order : int
        Far from its middle the spectrum falls with the frequency to the power -2 order; 1 to `HIGHEST_ORDER`.
    """

    correlation_time: float
    std: float
    frequency: float = 0.0
    order: int = 1


@cache
def _aliasing_filter(rate: float | None) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Filter against aliasing for a sampling `rate` in Hz, as (a, b, c, d) of x' = a x + b u and y = c x + d u.

    a is (n, n), b and c are (n,), d is a number; without a rate n is 0 and d is 1.
    """
    if rate is None:
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    corner = np.pi * rate
    a, b, c, d = signal.zpk2ss(*signal.ellip(*_FILTER, 1.0, analog=True, output="zpk"))
    return corner * a, corner * b[:, 0], c[0], float(d[0, 0])


@dataclass(frozen=True, eq=False)
class ForceModel:
    """An unknown force of unit variance: z' = dynamics z + white noise of density `noise`; force = output z.

    Attributes
    ----------
    dynamics : (n, n) float array
        1/s. Low-passes of first order in a row, each of one state, or of two where there is a frequency; the last one is the
        force. A filter against aliasing follows.
    noise : (n,) float array
        Square of each state per second.
    output : (n,) float array
    """

    dynamics: FloatArray
    noise: FloatArray
    output: FloatArray

    @classmethod
    def of(cls, process: ForceProcess, filtered_rate: float | None) -> ForceModel:
        """Model of a force of the spectrum of `process`, of unit variance: states, white noise behind them, output.

        The force is white noise behind low-passes of first order in a row, about a frequency if the process has one,
        and as a record filtered for the sampling rate `filtered_rate`, Hz, holds it; None means without filter.
        `NoAnswerError` if the force is so near to a sine that its covariance loses its digits.
        """
        frequency, order = process.frequency, process.order
        inner, entry, output, direct = _aliasing_filter(filtered_rate)
        n_each = 2 if frequency else 1
        n_own, fade = order * n_each, _FADING[order] / process.correlation_time
        turning = 2 * np.pi * frequency * np.array([[0.0, -1.0], [1.0, 0.0]])[:n_each, :n_each]
        stage = turning - fade * np.eye(n_each)
        dynamics = np.zeros((n_own + len(inner),) * 2)
        dynamics[:n_own, :n_own] = np.kron(np.eye(order), stage) + fade * np.kron(np.eye(order, k=-1), np.eye(n_each))
        dynamics[n_own:, n_own - n_each], dynamics[n_own:, n_own:] = entry, inner
        white = np.where(np.arange(len(dynamics)) < n_each, 2 * fade, 0.0)
        covariance = linalg.solve_continuous_lyapunov(dynamics, -np.diag(white))
        if not np.diag(covariance).min() > 0:
            raise NoAnswerError(
                "the unknown forces are so near to a sine that their covariance has lost its digits; state a shorter"
                " `correlation_time`"
            )
        size = np.sqrt(np.diag(covariance))
        read = np.concatenate([np.zeros(n_own - n_each), [direct], np.zeros(n_each - 1), output])
        scaled = dynamics * size / size[:, None]  # states of unit variance, for the digits of the filter
        return cls(scaled, white / size**2, read * size / np.sqrt(read @ covariance @ read))


def count_independent_forces(structure: Structure, forces: Sequence[Dof]) -> int:
    """Number of the unknown forces that move a structure independently of each other; those on one rigid part may not.

    It is the rank of their columns over the degrees of freedom; 0 without `forces`.
    """
    if not forces:
        return 0
    columns = structure.selection(forces)
    products = (columns.T @ columns).toarray()
    return int(np.linalg.matrix_rank(products, tol=_DEPENDENT * float(np.trace(products)), hermitian=True))


def combine_forces(inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fewest independent forces of one spectrum that do to the modes what `inputs` of that spectrum do.

    `inputs` (n_modes, n_forces) are the modal forces of unit forces. Returns the modal forces of each combination,
    (n_modes, n_combined), and the part of each in the forces, (n_forces, n_combined). Combinations that move no mode
    are left out; `inputs` and the identity are returned if all forces are independent.
    """
    if not inputs.size:
        return inputs, np.eye(inputs.shape[1])
    modal, sizes, parts = np.linalg.svd(inputs, full_matrices=False)
    n_combined = max(int((sizes > np.sqrt(_DEPENDENT) * sizes[0]).sum()), 1)
    if n_combined == inputs.shape[1]:
        return inputs, np.eye(n_combined)
    return modal[:, :n_combined] * sizes[:n_combined], parts[:n_combined].T

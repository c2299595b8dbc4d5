"""Parameters that end at a bound: how hard the data push them beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem

#: Largest distance from a bound, in parts of the range and in standard deviations, at which a parameter is at it.
_CLOSE, _CLOSE_STD = 0.01, 0.1
#: Standard deviations beyond a bound where a push is more than chance.
_HARD = 3.0


@dataclass(frozen=True)
class AtBound:
    """A parameter whose best value lies at or beyond one of its bounds.

    Attributes
    ----------
    name, unit : str
    index : int
        Its position among the parameters.
    side : {"lower", "upper"}
    limit : float
        The bound.
    multiplier : float
        Decrease of half chi-square (priors included) for each unit of the parameter beyond the bound, at the bound, the
        other free parameters fitted again.
    std : float
        Standard deviation that the parameter would have without its bounds, from the noise.
    noise_scale : float
        The noise in parts of what is stated, where the fit misses it; else 1.
    """

    name: str
    unit: str
    index: int
    side: Literal["lower", "upper"]
    limit: float
    multiplier: float
    std: float
    noise_scale: float = 1.0

    @property
    def gain_per_std(self) -> float:
        """Decrease of chi-square if the bound were wider by one `std`, to second order."""
        push = self.multiplier * self.std
        return 2 * push - 1 if push > 1 else push**2

    @property
    def push(self) -> float:
        """Distance of the best value beyond the bound, to first order, in standard deviations of the fit."""
        return self.multiplier * self.std / self.noise_scale

    @property
    def is_pushed(self) -> bool:
        """True if the data push the parameter beyond the bound by more than chance."""
        return self.push > _HARD

    @property
    def words(self) -> str:
        """Sentence with the bound that a parameter is at, and how strongly the data push beyond it.

        If they push by more than chance, a remedy is added.
        """
        unit = "" if self.unit == "1" else f" {self.unit}"
        sentence = f"{self.name} is at its {self.side} bound {self.limit:.6g}{unit}"
        if not self.is_pushed:
            return f"{sentence}: the data allow it, and do not push beyond it by more than chance"
        side = "below" if self.side == "lower" else "above"
        return (
            f"{sentence}; the data push {side} it (a bound wider by one standard deviation, {self.std:.2g}{unit}, would lower"
            f" chi-square by {self.gain_per_std:.3g}): widen the bound or doubt the model"
        )


def is_free(at_bound: Sequence[AtBound], n_params: int) -> np.ndarray:
    """Mask of the parameters that are not in `at_bound`, (n_params,) bool."""
    free = np.ones(n_params, dtype=bool)
    free[[bound.index for bound in at_bound]] = False
    return free


def at_bounds(
    problem: Problem, theta: FloatArray, linearization: Linearization, noise_scale: float = 1.0
) -> tuple[AtBound, ...]:
    """Parameters at a bound at the minimum `theta`, in their order, from the linearized model; empty if there are none.

    A parameter is at a bound if it is within 1 % of its range and 0.1 standard deviations of the bound, and the minimum
    of the linear model lies beyond. A parameter without two finite bounds is never at one. If its standard deviation
    without bounds, times `noise_scale`, exceeds both its range and its size, it counts as undetermined and is not
    returned.

    Parameters
    ----------
    problem : Problem
    theta : (n_params,) float array
    linearization : Linearization
        At `theta`.
    noise_scale : float
        Factor on the noise: the root of chi-square per degree of freedom where the fit holds model error, else 1.

    References
    ----------
    Nocedal and Wright (2006), Numerical Optimization, section 12.3: multipliers of active bounds.
    """
    bounds, values, slope = problem.unknowns.bounds, problem.physical(theta), problem.slope(theta)
    span = bounds[:, 1] - bounds[:, 0]
    side = np.argmin(np.abs(bounds - values[:, None]), axis=1)
    limit = bounds[np.arange(len(values)), side]
    distance = np.abs(values - limit)
    near = np.isfinite(span) & (distance <= _CLOSE * span) & (slope != 0)
    if not near.any():
        return ()
    basis, kept = (
        np.linalg.qr(linearization.jacobian[:, ~near])
        if not near.all()
        else (np.zeros((len(linearization.residual), 0)), None)
    )
    if kept is not None:
        basis = basis[:, np.abs(np.diag(kept)) > 1e-12 * np.abs(np.diag(kept)).max(initial=0.0)]
    bounds_met = []
    for i in np.flatnonzero(near).tolist():
        column = linearization.jacobian[:, i] / slope[i]
        independent = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(independent))
        outward = -1.0 if side[i] == 0 else 1.0
        multiplier = -outward * float(independent @ linearization.residual)
        if not size > 0:
            continue
        std = 1 / size
        size_here = float(problem.unknowns.sizes(values)[i])
        is_beyond = multiplier * std**2 > distance[i] and distance[i] <= _CLOSE_STD * std
        if is_beyond and noise_scale * std <= max(span[i], size_here):
            words = problem.names[i], problem.unknowns.units[i]
            which: Literal["lower", "upper"] = "lower" if side[i] == 0 else "upper"
            bounds_met.append(AtBound(*words, i, which, float(limit[i]), multiplier, std, noise_scale))
    return tuple(bounds_met)

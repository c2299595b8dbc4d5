"""Sensitivity of identified values to the properties that the model fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.display import plural
from structid.diagnose.thresholds import (
    CLEAR_DOUBT_RISK,
    DOUBT_RISK,
    DOUBTED_TOLERANCES,
    MATTERS,
    SHIFTS,
    TOLD_SENSITIVITY,
)
from structid.inversion.linearization import triangle_of

#: Part of a column's length that is left off the parameters' columns, below which the data do not tell it from them.
_TOLD = 1e-6


@dataclass(frozen=True, eq=False)
class FixedValueSensitivity:
    """First-order sensitivity of the answer to the value of a property that the model holds fixed.

    Attributes
    ----------
    name : str
        Such as ``mass[deck]``.
    parameters : tuple of str
        Those that it moves.
    influence : (n_params,) float array
        Relative change of each parameter over that of the fixed value.
    distance : (n_params,) float array
        Change of each parameter, in its standard deviations, where the fixed value is 1 % larger.
    pull, pull_std : float
        Relative change of the fixed value that the record asks for, were it a parameter too, and the standard deviation of
        this change; NaN where the record does not tell.
    tolerance : float
        Standard deviation that the answer allows the fixed value, in parts of that value.
    clock_pull : float
        For a fixed stiffness, by what part the record would change all fixed stiffnesses by one factor, where nothing else
        that is fixed explains more: a clock that is off has the same effect. NaN elsewhere.
    """

    name: str
    parameters: tuple[str, ...]
    influence: FloatArray
    distance: FloatArray
    pull: float
    pull_std: float
    tolerance: float = 0.0
    clock_pull: float = float("nan")

    @property
    def is_like_clock(self) -> bool:
        """True where a clock that is off explains what the record would change by more than three tolerances and 1 %."""
        return abs(self.clock_pull) > max(DOUBTED_TOLERANCES * self.tolerance, SHIFTS)

    @property
    def most_moved(self) -> int:
        """Index of the parameter that the fixed value moves farthest."""
        return int(np.argmax(np.abs(self.distance)))

    @property
    def moved_by_pull(self) -> int | None:
        """Index of the parameter that the pull moves farthest; None if by no more than 2.2 deviations or 1 %."""
        moves = 100 * np.abs(self.distance * self.pull)
        matters = (moves > MATTERS) & (np.abs(self.influence * self.pull) > SHIFTS)
        return int(np.argmax(np.where(matters, moves, 0.0))) if matters.any() else None

    @property
    def moved_words(self) -> str:
        """Clause on the parameter that moves most, in its standard deviations, if the fixed value is 1 % larger."""
        index = self.most_moved
        size = f"{abs(self.distance[index]):.2g}"
        moved = f"{self.parameters[index]} would be {_percent(0.01 * self.influence[index])}"
        return f"with {self.name} 1 % larger, {moved} ({size} standard deviation{'' if size == '1' else 's'})"

    @property
    def words(self) -> str:
        """Clause on the value that the record would prefer, and the parameter that would move farthest with it.

        A parameter is named only if it moves by more than 2.2 standard deviations and 1 %. Where a clock or sampling
        rate that is off looks the same (`is_like_clock`), the clause names that instead of the parameter, with the
        factor on the stiffnesses.
        """
        more = f"{_percent(self.pull)} (standard deviation {abs(100 * self.pull_std):.2g} %)"
        words = f"the record prefers {self.name}, fixed in the model, {more}"
        if self.is_like_clock:
            off = np.sqrt(1 + self.clock_pull) - 1
            return (
                f"{words}, or every identified stiffness {_percent(1 / (1 + self.clock_pull) - 1)} with a clock or sampling rate by"
                f" which all frequencies read {abs(100 * off):.2g} % too {'high' if off > 0 else 'low'}: do not rely on the"
                " stiffnesses before both are checked"
            )
        index = self.moved_by_pull
        if index is None:
            return words
        return f"{words}, and then {self.parameters[index]} {_percent(self.influence[index] * self.pull)}"

    def is_doubted(self, among: int, risk: float = DOUBT_RISK) -> bool:
        """True if the record prefers another value beyond chance and three tolerances, and a parameter would move.

        The parameter must move by more than 2.2 standard deviations and 1 %, or a clock look the same. `risk` is the
        chance that any of `among` fixed values of a right model is doubted. False if the noise level is unknown.
        """
        matters = self.is_like_clock or self.moved_by_pull is not None
        if not self.pull_std > 0 or not matters or abs(self.pull) <= DOUBTED_TOLERANCES * self.tolerance:
            return False
        return abs(self.pull) > float(special.ndtri(1 - risk / (2 * among))) * self.pull_std


def _percent(part: float) -> str:
    return f"{abs(100 * part):.2g} % {'larger' if part > 0 else 'smaller'}"


def doubted(sensitivities: Sequence[FixedValueSensitivity]) -> tuple[FixedValueSensitivity, ...]:
    """The fixed values for which the record prefers other values (`is_doubted`): what a clock explains, then the clearest first."""
    doubtful = [one for one in sensitivities if one.is_doubted(len(sensitivities))]
    return tuple(sorted(doubtful, key=lambda one: (not one.is_like_clock, -abs(one.pull / one.pull_std))))


def resting(sensitivities: Sequence[FixedValueSensitivity]) -> list[FixedValueSensitivity]:
    """All `sensitivities`, that of the most influential fixed value first.

    Influence is the largest change of a parameter per 1 % of the fixed value, in standard deviations of the parameter.
    """
    return sorted(sensitivities, key=lambda one: -abs(one.distance[one.most_moved]))


def resting_words(sensitivities: Sequence[FixedValueSensitivity]) -> str:
    """Clause on the fixed value in `sensitivities` that the intervals depend on most; "" where none matters.

    A fixed value matters if 1 % of it moves a parameter by half a standard deviation or more; others that do are
    counted.
    """
    most = [one for one in resting(sensitivities) if abs(one.distance[one.most_moved]) >= TOLD_SENSITIVITY]
    if not most:
        return ""
    first = most[0]
    others = f", and {plural(len(most) - 1, 'other')} like it on the page" if len(most) > 1 else ""
    return (
        f"fixed values matter: {first.moved_words}{others}; state its `tolerance` (0 where it is exact), or make it an"
        " unknown with a prior"
    )


def is_clear(sensitivities: Sequence[FixedValueSensitivity]) -> bool:
    """True if a fixed value is doubted at a risk of 0.001, so clearly that a full search for causes is due."""
    return any(one.is_doubted(len(sensitivities), CLEAR_DOUBT_RISK) for one in sensitivities)


def influences(
    jacobian: FloatArray,
    residual: FloatArray,
    parameters: Sequence[str],
    names: Sequence[str],
    std: FloatArray,
    scale: float,
) -> tuple[FixedValueSensitivity, ...]:
    """Sensitivity of the parameters to each fixed value, and the change that the residual asks for: one score test each.

    With J_p of the parameters, J_q of a fixed value, both by relative changes, and r the residual: the parameters follow by
    -(J_p' J_p)^-1 J_p' J_q; what J_q has off J_p, w, would have q change by -w'r / w'w, with deviation `scale` / |w|.

    Parameters
    ----------
    jacobian : (n_rows, n_params + n_held) float array
        Whitened, by relative changes, the parameters first.
    residual : (n_rows,) float array
        Whitened.
    parameters, names : sequence of str
        Names of the parameters, and of the fixed values.
    std : (n_params,) float array
        Standard deviations of the parameters, in parts of them.
    scale : float
        Standard deviation of a row; NaN where it is not that of noise.

    Returns
    -------
    tuple of FixedValueSensitivity
        Those that the residual sees; none where it does not determine the parameters.

    References
    ----------
    Rao (1948), Proc. Cambridge Phil. Soc. 44, 50-57.
    """
    r = triangle_of(np.column_stack([jacobian, residual]))
    n_params = len(parameters)
    triangle = r[:n_params, :n_params]
    if not np.abs(np.diag(triangle)).min(initial=np.inf) > _TOLD * np.linalg.norm(triangle, axis=0).max(initial=0.0):
        return ()
    inverse = np.linalg.inv(triangle)
    columns, rest = r[:, n_params:-1], r[n_params:, -1]
    sensitivities = []
    for name, column in zip(names, columns.T, strict=True):
        size, off = float(np.linalg.norm(column)), column[n_params:]
        if size == 0:
            continue
        left = float(np.linalg.norm(off))
        is_told = left > _TOLD * size
        influence = -inverse @ column[:n_params]
        pull, deviation = (-float(off @ rest) / left**2, scale / left) if is_told else (np.nan, np.nan)
        sensitivities.append(
            FixedValueSensitivity(name, tuple(parameters), influence, 0.01 * influence / std, pull, deviation)
        )
    return tuple(sensitivities)

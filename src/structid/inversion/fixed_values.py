"""Influence of fixed values on an estimate: intervals and tests of residuals that allow for their tolerances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.inversion.covariance import chi_square_law, row_law, shift_of_minimum
from structid.inversion.diagnostics.residual_tests import misses_noise
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import Problem

#: What the names of fixed values begin with where they are unknowns beside those that are sought.
FIXED = "fixed "
#: Name of the last column of `FixedValueInfluence.changes`.
SECOND_ORDER = "second order"
#: Fixed values that words name one by one.
_MOST_NAMED = 3
#: What fixed values are called, by their kinds.
_CALLED = {
    "masses": ("mass", "rotary_inertia"),
    "stiffnesses": ("stiffness", "thickness"),
    "axial forces": ("axial_force",),
    "dampings": ("viscous_damping", "loss_factor", "damping_ratio", "friction"),
    "lengths": ("length",),
    "places": ("position", "parameter"),
}


@dataclass(frozen=True, eq=False)
class FixedValueInfluence:
    """Change of an estimate with the values that its model fixes, to first order, and what a refit adds.

    Attributes
    ----------
    names, kinds : tuple of str
        Such as ``mass[deck]`` and ``mass``; ``gain`` of the calibration of a record.
    tolerance : (n_fixed,) float array
        Standard deviation of each, in parts of its value.
    slope : (n_params, n_fixed) float array
        Change of each parameter, physical units, per relative change of each fixed value: K = -D (J'J + P)^-1 J'J_h
        with the derivatives J and J_h of the whitened data by free variables and fixed values, the priors' information P, and
        the derivatives D of the physical values by the free variables.
    asked : (n_fixed,) float array
        Where each would be, in tolerances, with all of them free within their tolerances; zeros where noise explains the residual.
    theta : (n_params,) float array
        Free variables of the parameters there; those of the answer where noise explains the residual.
    second_order : (n_params,) float array
        Change of the parameters by `slope` less that of a refit, where the fixed values move as far as the data ask and
        `likely_move` allows, physical units: large where they move resonances by as much as these are wide.
    explained : float
        Part of the misfit beyond noise that the fixed values explain where they are as `asked`, 0 to 1.

    References
    ----------
    Schmidt (1966), Adv. Control Systems 3, 293-340 (consider parameters); Tapley, Schutz and Born (2004), Statistical Orbit
    Determination, chapter 6.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    tolerance: FloatArray
    slope: FloatArray
    asked: FloatArray
    theta: FloatArray
    second_order: FloatArray
    explained: float = 0.0

    @property
    def error(self) -> FloatArray:
        """Standard deviation that each fixed value is taken to have, in parts of its value, (n_fixed,).

        It is the tolerance. A value that the data put farther off than chance allows has the error that the data ask for, times the
        part of the misfit that the fixed values explain: then its tolerance is not what it was said to be.
        """
        widened = np.ones(len(self.asked))
        beyond = list(self.beyond)
        widened[beyond] = np.maximum(1.0, self.explained * np.abs(self.asked[beyond]))
        return np.asarray(self.tolerance * widened)

    @property
    def changes(self) -> FloatArray:
        """Changes of the parameters for one `error` of each fixed value, then `second_order`, (n_params, n_fixed + 1).

        Physical units.
        """
        return np.column_stack([self.slope * self.error, self.second_order])

    @property
    def change_names(self) -> tuple[str, ...]:
        """Name of the cause of each column of `changes`."""
        return (*self.names, SECOND_ORDER)

    @property
    def change_tolerances(self) -> tuple[float, ...]:
        """`error` of the cause of each column of `changes`; 0 of the second order."""
        return (*self.error.tolist(), 0.0)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters by the errors of fixed values and the second order, physical units, (n_params, n_params)."""
        return self.changes @ self.changes.T

    @property
    def std(self) -> FloatArray:
        """Standard deviation that the fixed values add to each parameter, physical units, (n_params,)."""
        return np.asarray(np.linalg.norm(self.changes, axis=1))

    @property
    def beyond(self) -> tuple[int, ...]:
        """Indices of the fixed values that the data put farther off than chance allows, largest distance first.

        The limit in tolerances is `limit_of`.
        """
        limit = limit_of(len(self.asked))
        order = np.argsort(-np.abs(self.asked))
        return tuple(int(i) for i in order if abs(self.asked[i]) > limit)

    @property
    def words(self) -> str:
        """Tolerances of fixed values in words, such as ``1 % of fixed masses and stiffnesses``.

        Values whose `error` is larger than their tolerance follow, as in ``(mass[deck]: 5 %, as the data ask)``.
        """
        wider = [f"{self.names[i]}: {_size([self.error[i]])}" for i in self.beyond if self.error[i] > self.tolerance[i]]
        asked = f" ({join_words(wider, _MOST_NAMED)}, as the data ask)" if wider else ""
        return tolerance_words(self.names, self.kinds, self.tolerance.tolist()) + asked


def tolerance_words(names: Sequence[str], kinds: Sequence[str], tolerances: Sequence[float]) -> str:
    """Tolerances of fixed values in words, such as ``1 % of fixed masses and stiffnesses``.

    `names`, `kinds` and `tolerances` (relative, 0.01 for 1 %) have one entry for each fixed value; kinds of equal tolerance are
    joined. Where elements of a set err on their own, ``mass[deck:2]``, what they have in common, ``mass[deck]``, is left out: its
    tolerance is a part of theirs.
    """
    in_common = {name.rpartition(":")[0] + "]" for name in names if ":" in name}
    kinds_of_size: dict[str, list[str]] = {}
    pairs = [
        (kind, tolerance)
        for name, kind, tolerance in zip(names, kinds, tolerances, strict=True)
        if name not in in_common
    ]
    for what, several in _CALLED.items():
        sizes = sorted({tolerance for kind, tolerance in pairs if kind in several})
        if sizes:
            kinds_of_size.setdefault(_size(sizes), []).append(what)
    said = [f"{size} of fixed {' and '.join(what)}" for size, what in kinds_of_size.items()]
    gains = sorted({tolerance for kind, tolerance in pairs if kind == "gain"})
    return ", ".join([*said, *([f"{_size(gains)} of the calibration"] if gains else [])])


def limit_of(count: int, probability: float = 1e-3) -> float:
    """Limit in tolerances that any of `count` fixed values exceeds with at most this probability (Bonferroni, two-sided)."""
    return float(special.ndtri(1 - probability / (2 * max(count, 1))))


def likely_move(asked: FloatArray) -> FloatArray:
    """Changes `asked` (n_fixed,) of fixed values, in tolerances, shortened to a mean square of 1 where it is larger.

    1 is what errors as large as the tolerances have; their proportions stay.
    """
    return asked / np.sqrt(max(float(asked @ asked) / max(len(asked), 1), 1.0))


def explained_part(chi_square: float, least: float, expected: float) -> float:
    """Part of a misfit beyond noise, `chi_square` - `expected`, that a fit which leaves `least` removes; 0 without such.

    `expected` is the mean sum of squares that noise alone leaves. The result is from 0 to 1.
    """
    return float(np.clip((chi_square - least) / (chi_square - expected), 0.0, 1.0)) if chi_square > expected else 0.0


def widen_changes(changes: FloatArray, errors: FloatArray, wider: FloatArray) -> FloatArray:
    """Changes (n_params, n_fixed) of parameters by errors `wider` of fixed values, from `changes` by errors `errors`.

    Each column is in proportion to the error of its fixed value; errors are (n_fixed,). Columns with an error of 0,
    such as the one of second order, stay.
    """
    has_error = errors > 0
    return np.asarray(changes * np.where(has_error, wider / np.where(has_error, errors, 1.0), 1.0))


def _size(parts: list[float]) -> str:
    """Range of rising `parts` in per cent, such as ``1 to 2 %``; one number where the first and the last agree."""
    return " to ".join(dict.fromkeys(f"{100 * part:.3g}" for part in (parts[0], parts[-1]))) + " %"


@dataclass(frozen=True, eq=False)
class FitWithinTolerances:
    """A fit with every fixed value free within its tolerance.

    Attributes
    ----------
    problem : Problem
        With the fixed values among its unknowns.
    theta : (n_params + n_fixed,) float array
    at : Linearization or OperatorLinearization
    asked : (n_fixed,) float array
        Logarithm of each fixed value over what the model has, in tolerances.
    parameters : (n_params,) float array
        Free variables of the parameters alone.
    followed : (n_params,) float array or None
        Free variables of the parameters that fit best where the fixed values are at `likely`; None where they are not known.
    explained : float
        Part of the misfit beyond noise that this fit removes, 0 to 1; 0 where `FixedValues.followed` was not called.
    """

    problem: Problem
    theta: FloatArray
    at: Linearization | OperatorLinearization
    asked: FloatArray
    parameters: FloatArray
    followed: FloatArray | None = None
    explained: float = 0.0

    @property
    def likely(self) -> FloatArray:
        """`asked`, shortened by `likely_move`, (n_fixed,)."""
        return likely_move(self.asked)

    @property
    def chi_square(self) -> float:
        """Sum of squares of the data, and of the fixed values in tolerances."""
        data = self.at.residual[: self.problem.n_data]
        return float(data @ data + self.asked @ self.asked)

    @property
    def expected_chi_square(self) -> float:
        """Mean sum of squares that noise alone leaves after the fit, data and fixed values together.

        Without a Jacobian it is that of the data as if no parameter were fitted.
        """
        if isinstance(self.at, Linearization):
            scale, freedom = chi_square_law(self.problem, self.theta, self.at)
            return scale * freedom
        scale, share = row_law(self.problem.rows.averages)
        return scale * share * self.problem.n_data

    def misfits(self, probability: float) -> bool:
        """True if the fit within tolerances misses the noise at this probability; see `misfits_chi_square`.

        It needs a linearization with a Jacobian, which gives scale and degrees of freedom by `chi_square_law`.
        """
        assert isinstance(self.at, Linearization)
        return self.misfits_chi_square(probability, *chi_square_law(self.problem, self.theta, self.at))

    def misfits_chi_square(self, probability: float, scale: float, freedom: float) -> bool:
        """True if the fit within tolerances misses the noise, tested at `probability` against `scale` times chi-square.

        That is so if a fixed value is off by more tolerances than any would be with this probability, or if noise
        alone, whose sum of squares is `scale` times chi-square of `freedom` degrees of freedom, exceeds the sum of
        squares of data and fixed values with less than this probability (see `misses_noise`).
        """
        if np.abs(self.asked).max() > limit_of(len(self.asked), probability):
            return True
        more = float(self.asked @ self.asked)
        return misses_noise(self.problem, self.at.residual, scale, freedom, probability, more)


@dataclass(frozen=True, eq=False)
class FixedColumns:
    """The values that the model of a problem holds, at one point.

    Attributes
    ----------
    names, kinds : tuple of str
    tolerance : (n_fixed,) float array
        Standard deviation of the logarithm of each.
    columns : (n_data, n_fixed) float array
        Derivative of the whitened data rows with respect to the logarithm of each.
    within : FitWithinTolerances or None
        The fit with all of them free, where noise alone does not explain the residual.
    refit : callable or None
        Makes that fit, where it is not known beforehand if noise explains the residual.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    tolerance: FloatArray
    columns: FloatArray
    within: FitWithinTolerances | None
    refit: Callable[[], FitWithinTolerances] | None = None

    def refitted(self) -> FixedColumns:
        """A copy that holds the fit with all fixed values free, made now by `refit` if it is missing.

        The object itself if the fit is there or cannot be made.
        """
        return self if self.within is not None or self.refit is None else replace(self, within=self.refit())

    def only(self, kept: Sequence[int]) -> FixedColumns:
        """A copy with the fixed values at indices `kept` alone, and no way to refit; the others count as exact.

        Where any is left out, no fit of the parameters is known that follows the kept ones alone, and the influence is linear.
        """
        index, within = list(kept), self.within
        if within is not None:
            followed = within.followed if len(index) == len(self.names) else None
            within = replace(within, asked=within.asked[index], followed=followed)
        return replace(
            self,
            names=tuple(self.names[i] for i in index),
            kinds=tuple(self.kinds[i] for i in index),
            tolerance=self.tolerance[index],
            columns=self.columns[:, index],
            within=within,
            refit=None,
        )

    def influence(self, theta: FloatArray, linearization: Linearization, slope: FloatArray) -> FixedValueInfluence:
        """Influence of the fixed values on the parameters, to first order; NaN for undetermined parameters.

        Parameters
        ----------
        theta : (n_params,) float array
        linearization : Linearization
            Of the problem without them.
        slope : (n_params,) float array
            Derivative of each physical parameter with respect to its free variable.
        """
        return self.influence_by(theta, shift_of_minimum(linearization.jacobian, self.columns), slope)

    def influence_by(self, theta: FloatArray, changes: FloatArray, slope: FloatArray) -> FixedValueInfluence:
        """Influence of the fixed values on the physical parameters, from derivatives of the free variables.

        `theta` (n_params,) are the free variables of the estimate, `changes` (n_params, n_fixed) their derivatives by
        the logarithm of each fixed value, and `slope` (n_params,) the derivative of each physical parameter by its free
        variable. Where a fit within tolerances was made, the shift that it gives beyond these derivatives is stored
        too.
        """
        within = self.within
        asked = np.zeros(len(self.names)) if within is None else within.asked
        free = theta if within is None else within.parameters
        remainder: FloatArray = np.zeros(len(theta))
        if within is not None and within.followed is not None:
            remainder = theta - within.followed + changes @ (within.likely * self.tolerance)
        return FixedValueInfluence(
            self.names,
            self.kinds,
            self.tolerance,
            changes * slope[:, None],
            asked,
            free,
            remainder * slope,
            0.0 if within is None else within.explained,
        )

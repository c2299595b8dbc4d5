"""What an answer owes to the values that its model holds: intervals and tests of residuals that allow for their tolerances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.inversion.covariance import chi_square_law, inverse_information
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem
from structid.inversion.residual_law import misses_noise

#: What the names of held values begin with where they are unknowns beside those that are sought.
FIXED = "fixed "


@dataclass(frozen=True, eq=False)
class FixedValueInfluence:
    """How an answer changes with the values that its model holds, to first order.

    Attributes
    ----------
    names : tuple of str
        Such as ``mass[deck]``.
    tolerance : (n_fixed,) float array
        Standard deviation of each, in parts of its value.
    slope : (n_params, n_fixed) float array
        Change of each parameter, physical units, per relative change of each held value: K = -(J'J + P)^-1 J'J_h.
    asked : (n_fixed,) float array
        Where each would be, in tolerances, with all of them free within their tolerances; zeros where noise explains the residual.
    chi_square : float
        Sum of squares of data and held values there; NaN where noise explains the residual.

    References
    ----------
    Schmidt (1966), Adv. Control Systems 3, 293-340 (consider parameters); Tapley, Schutz and Born (2004), Statistical Orbit
    Determination, chapter 6.
    """

    names: tuple[str, ...]
    tolerance: FloatArray
    slope: FloatArray
    asked: FloatArray
    chi_square: float = float("nan")

    @property
    def changes(self) -> FloatArray:
        """Change of each parameter for one tolerance of each held value, physical units, (n_params, n_fixed)."""
        return self.slope * self.tolerance

    @property
    def covariance(self) -> FloatArray:
        """K S K' of the parameters, physical units, (n_params, n_params)."""
        return self.changes @ self.changes.T


@dataclass(frozen=True, eq=False)
class FitWithinTolerances:
    """A fit with every held value free within its tolerance.

    Attributes
    ----------
    problem : Problem
        With the held values among its unknowns.
    theta : (n_params + n_fixed,) float array
    at : Linearization
    asked : (n_fixed,) float array
        Logarithm of each held value over what the model has, in tolerances.
    """

    problem: Problem
    theta: FloatArray
    at: Linearization
    asked: FloatArray

    @property
    def chi_square(self) -> float:
        """Sum of squares of the data, and of the held values in tolerances."""
        data = self.at.residual[: self.problem.n_data]
        return float(data @ data + self.asked @ self.asked)

    def misfits(self, probability: float) -> bool:
        """Whether noise and tolerances leave a misfit as large, or a held value as far off, with less than this probability."""
        limit = float(special.ndtri(1 - probability / (2 * len(self.asked))))
        if np.abs(self.asked).max() > limit:
            return True
        scale, freedom = chi_square_law(self.problem, self.theta, self.at)
        more = float(self.asked @ self.asked)
        return misses_noise(self.problem, self.at.residual, scale, freedom, probability, more)


@dataclass(frozen=True, eq=False)
class FixedColumns:
    """The values that the model of a problem holds, at one point.

    Attributes
    ----------
    names : tuple of str
    tolerance : (n_fixed,) float array
        Standard deviation of the logarithm of each.
    columns : (n_data, n_fixed) float array
        Derivative of the whitened data rows with respect to the logarithm of each.
    within : FitWithinTolerances or None
        The fit with all of them free, where noise alone does not explain the residual.
    """

    names: tuple[str, ...]
    tolerance: FloatArray
    columns: FloatArray
    within: FitWithinTolerances | None

    def influence(self, at: Linearization, slope: FloatArray) -> FixedValueInfluence:
        """What they do to the parameters; NaN of those that the data do not tell.

        Parameters
        ----------
        at : Linearization
            Of the problem without them.
        slope : (n_params,) float array
            Derivative of each physical parameter with respect to its free variable.
        """
        bread = inverse_information(at.jacobian)
        seen = np.isfinite(np.diag(bread))
        changes = np.full((len(slope), len(self.names)), np.nan)
        score = at.jacobian[: len(self.columns), seen].T @ self.columns
        changes[seen] = -bread[np.ix_(seen, seen)] @ score * slope[seen, None]
        within = self.within
        if within is None:
            return FixedValueInfluence(self.names, self.tolerance, changes, np.zeros(len(self.names)))
        return FixedValueInfluence(self.names, self.tolerance, changes, within.asked, within.chi_square)

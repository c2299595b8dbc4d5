"""Fits with the values that a model holds free within their tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structid import inversion
from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import StructidError
from structid.inversion.composed_problems import FixedVariables
from structid.inversion.fixed_values import FIXED, FitWithinTolerances, FixedColumns, explained_part
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import Problem
from structid.inversion.search.least_squares import Method, Minimum, Progress, minimize, sizes_at, squared
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt

#: Fixed values are near: a few steps settle them.
_REFIT = LevenbergMarquardt(max_iterations=12, gain_tolerance=1e-5, initial_damping=1e-6)
#: Of a fit far beyond its noise: Gauss-Newton steps are too long there, and what tolerances explain of it is a small part.
_FAR_REFIT = LevenbergMarquardt(max_iterations=7, gain_tolerance=1e-5, initial_damping=1e-3)
#: Of a refit that goes on from one to a part of the data.
_LAST_REFIT = LevenbergMarquardt(max_iterations=4, gain_tolerance=1e-4, initial_damping=1e-3)


#: Sum of squares, in parts of the number of data, from which on a fit is far beyond its noise.
_FAR = 4.0
#: Times its start, or parts of it, from where on a value ran away and is no longer taken for an answer. Starts that were
#: 50 times off are found again, and what has no effect ends at the reach of the search, a million times the start.
RUNAWAY_FACTOR = 1e3


@dataclass(frozen=True, eq=False)
class FixedValues:
    """The values that the model of a problem holds, and how well each is known.

    Parameters
    ----------
    problem : Problem
        The problem with a factor on each of them among its unknowns, in names that begin with `FIXED`; their logarithms are the
        free variables and have Gaussian priors of mean 0.
    tolerances : mapping of str to float
        Standard deviation of each of these priors.
    sample : Problem, optional
        The problem on the part of the data that a search uses; on all data by default.
    is_matrix_free : bool
        Whether products take the place of a Jacobian, for very many parameters.
    """

    problem: Problem
    tolerances: Mapping[str, float]
    sample: Problem | None = None
    is_matrix_free: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fixed values, in the order of the unknowns."""
        return tuple(name for name in self.problem.names if name.startswith(FIXED))

    @property
    def std(self) -> FloatArray:
        """Standard deviation of the logarithm of each fixed value, (n_fixed,)."""
        return np.array([self.tolerances[name] for name in self.names])

    def on_sample(self) -> FixedValues:
        """A copy on the part of the data that a search uses."""
        return replace(self, problem=self.sample or self.problem, sample=None)

    def refit(
        self,
        names: tuple[str, ...],
        theta: FloatArray,
        chi_square: float,
        progress: Progress | None = None,
        start: FloatArray | None = None,
    ) -> FitWithinTolerances:
        """Refit of all unknowns with fixed values free within tolerances, from the free variables `theta` of `names`.

        `chi_square` is the sum of squares at `theta`, (n_params,). Above four times the number of data (not in a
        matrix-free search), a first search of seven iterations has more damping, and the refit ends there if it stays
        above. A refit that stays above is repeated with the values that ran away back at their starts: the data that
        drove them off with fixed values exact may not see the way back; the better of both counts, the first where the
        model fails there. `start` is the end of a refit to a part of the data, free variables of all unknowns with
        fixed values among them: from there only a few steps are taken, if it fits all data better than `theta`.
        """
        begun = self._all_free_variables(names, theta)
        if start is not None and self._cost(start) < self._cost(begun):
            minimum = minimize(self.problem, _LAST_REFIT, start, progress)
            return self._fit(minimum.theta, minimum.linearization, names)
        minimum = self._refit_from(begun, chi_square, progress)
        lost = self._lost(begun)
        if lost.any() and minimum.costs[-1] > self._far:
            with suppress(StructidError, np.linalg.LinAlgError):  # the first refit stands where the model fails there
                again = self._refit_from(np.where(lost, self.problem.theta_start, begun), chi_square, progress)
                minimum = min(minimum, again, key=lambda one: float(one.costs[-1]))
        return self._fit(minimum.theta, minimum.linearization, names)

    def _refit_from(self, begun: FloatArray, chi_square: float, progress: Progress | None) -> Minimum:
        """Minimum with parameters and fixed values free, searched from `begun`, the free variables of both.

        `chi_square` is the sum of squares of the fit with fixed values exact. If it is above `self._far` (not in a
        matrix-free search), a short, more damped search comes first, and its end is the result if that stays above.
        """
        if not self.is_matrix_free and chi_square > self._far:
            minimum = minimize(self.problem, _FAR_REFIT, begun, progress)
            if minimum.costs[-1] > self._far:
                return minimum
            begun = minimum.theta
        return minimize(self.problem, self._method, begun, progress)

    @property
    def _far(self) -> float:
        """Sum of squares from which on a fit is far beyond its noise."""
        return _FAR * self.problem.n_data

    def _lost(self, theta: FloatArray) -> NDArray[np.bool_]:
        """Mask (n_params,) of free variables `theta` so far from their starts that the data do not see the way back."""
        start = np.array(self.problem.theta_start)
        return np.abs(theta - start) > np.log(RUNAWAY_FACTOR) * sizes_at(self.problem, start)

    def followed(self, within: FitWithinTolerances, names: tuple[str, ...], theta: FloatArray) -> FitWithinTolerances:
        """Copy of the fit `within` tolerances with its `followed` and `explained`, by comparison with an answer.

        The answer is at the free variables `theta` (n_params,) of the parameters `names`. `followed` are the free
        variables that fit best with the fixed values at their likely values, `explained` the part of the answer's
        misfit beyond noise that `within` removes. If the search for `followed` fails, it is on the straight line from
        the answer to the fit.
        """
        data = self.problem.residual(self._all_free_variables(names, theta))[: self.problem.n_data]
        explained = explained_part(float(data @ data), within.chi_square, within.expected_chi_square)
        likely = within.likely
        if np.array_equal(likely, within.asked):
            return replace(within, followed=within.parameters, explained=explained)
        rest = FixedVariables(self.problem, self._index(self.names), likely * self.std)
        order = np.array([names.index(name) for name in rest.names], dtype=int)
        part = float(np.linalg.norm(likely) / np.linalg.norm(within.asked))
        followed = theta + part * (within.parameters - theta)
        with suppress(StructidError, np.linalg.LinAlgError):  # the answer itself needs no such fit
            followed[order] = minimize(rest, self._method, theta[order]).theta
        return replace(within, followed=followed, explained=explained)

    def fit_at(self, theta: FloatArray, names: tuple[str, ...]) -> FitWithinTolerances:
        """Fit within tolerances at the free variables `theta` of all unknowns, without a search.

        `names` are the parameters, apart from the fixed values.
        """
        return self._fit(theta, self.problem.linearize(theta), names)

    def sensitivities_at(
        self, names: tuple[str, ...], theta: FloatArray, within: FitWithinTolerances | None = None
    ) -> FixedColumns:
        """Derivatives (n_data, n_fixed) of the data rows by the logarithm of each fixed value; names and tolerances.

        Taken at the free variables `theta` (n_params,) of the parameters `names`, fixed values as in the model.
        `within` is a fit with fixed values free within their tolerances, if one was made; it is stored with its
        `followed` filled in.
        """
        within = None if within is None else self.followed(within, names, theta)
        whole, index = self._all_free_variables(names, theta), self._index(self.names)
        if self.is_matrix_free:
            linearized, units = self.problem.linearize_operator(whole), np.arange(len(whole))
            columns = np.column_stack([linearized.forward((units == i).astype(np.float64)) for i in index])
        else:
            columns = self.problem.linearize(whole).jacobian[: self.problem.n_data, index]
        kinds = tuple(self.problem.unknowns.kinds[i] for i in self._index(self.names))
        return FixedColumns(tuple(name.removeprefix(FIXED) for name in self.names), kinds, self.std, columns, within)

    def _cost(self, theta: FloatArray) -> float:
        """Sum of squares at the free variables `theta` of all unknowns; infinite where it cannot be evaluated."""
        try:
            return squared(self.problem.residual(theta))
        except (StructidError, np.linalg.LinAlgError):
            return np.inf

    def _fit(
        self, theta: FloatArray, linearization: Linearization | OperatorLinearization, names: tuple[str, ...]
    ) -> FitWithinTolerances:
        """The fit that ends at `theta`: changes of the fixed values in standard deviations, and the parameters `names`."""
        asked = theta[self._index(self.names)] / self.std
        parameters = theta[self._index(names)]
        return FitWithinTolerances(self.problem, theta, linearization, asked, parameters)

    @property
    def _method(self) -> Method:
        """Method of refits: a few steps settle values that are near."""
        if not self.is_matrix_free:
            return _REFIT
        return inversion.MatrixFree(max_iterations=12, gain_tolerance=1e-5, initial_damping=1e-6)

    def _all_free_variables(self, names: tuple[str, ...], theta: FloatArray) -> FloatArray:
        """Free variables of all unknowns, (n_unknowns,), from `theta` (n_params,), those of the parameters `names`.

        Every fixed value is as in the model.
        """
        whole = np.array(self.problem.theta_start, dtype=np.float64)
        whole[self._index(names)], whole[self._index(self.names)] = theta, 0.0
        return whole

    def _index(self, names: tuple[str, ...]) -> IntArray:
        index = {name: i for i, name in enumerate(self.problem.names)}
        return np.array([index[name] for name in names], dtype=int)

"""Profile likelihood: how the best fit worsens as one parameter is held away from its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError, SingularModelError
from structid.inversion.composed_problems import FixedVariables
from structid.inversion.covariance import fit_covariance
from structid.inversion.estimate import Estimate, require_level
from structid.inversion.problem import Problem, few_averages
from structid.inversion.search.least_squares import StoredValues, minimize
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.inversion.search.work import SERIAL, TaskContext, TaskExecutor

_SEARCH = LevenbergMarquardt(max_iterations=40, gain_tolerance=1e-8, initial_damping=1e-4)
_END_TOLERANCE = 2e-3
_LOWER_BY = 1e-2
_FARTHEST, _FARTHEST_LINEAR = 40.0, 1e4


@dataclass(frozen=True, eq=False)
class Profile:
    """The likelihood ratio of one parameter, all others fitted again at each of its values.

    Attributes
    ----------
    name, unit : str
    level : float
    values : (n_points,) float array
        Physical values at which the others were fitted, rising.
    deviance : (n_points,) float array
        By how much the least sum of squares there is above that of the estimate, over `scale`.
    scale : float
        What the sum of squares is divided by: 1 for noise, the ratio of variances with and without model error else.
    lower, upper : float
        Where the deviance is the chi-square quantile of `level` with one degree of freedom, in physical units; the
        end of the parameter's range where it never is.
    is_open : (bool, bool)
        Whether the lower and the upper end are such ends of the range: the data give no limit there.
    nonlinearity : float
        Largest relative difference of a half-width in the free variable from the Laplace one; infinite for an open end.
    """

    name: str
    unit: str
    level: float
    values: FloatArray
    deviance: FloatArray
    scale: float
    lower: float
    upper: float
    is_open: tuple[bool, bool]
    nonlinearity: float

    @property
    def better(self) -> float:
        """Least deviance that was met; clearly below 0 the estimate was not the minimum."""
        return float(self.deviance.min())

    @property
    def names(self) -> tuple[str, ...]:
        """Name of the profiled parameter, as a tuple of one."""
        return (self.name,)

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """Random draws of the parameter in physical units, (1, n_draws, 1), distributed as the profile likelihood.

        A standard normal number is the signed root of the deviance, interpolated between the points and extrapolated
        linearly. `rng` gives the random numbers.

        Raises
        ------
        InputError
            If the data give no limit on a side.
        """
        if any(self.is_open):
            raise InputError(f"{self.words}: there is no distribution to draw from")
        least = int(self.deviance.argmin())
        root = np.sign(np.arange(len(self.values)) - least) * np.sqrt(np.maximum(self.deviance, 0.0))
        wanted = rng.standard_normal(n_draws)
        inside = np.interp(wanted, root, self.values)
        for end, inner in ((0, 1), (-1, -2)):
            slope = (self.values[end] - self.values[inner]) / (root[end] - root[inner])
            beyond = (wanted - root[end]) * root[end] > 0
            inside = np.where(beyond, self.values[end] + slope * (wanted - root[end]), inside)
        return inside[None, :, None]

    @property
    def words(self) -> str:
        """Sentence that compares the profile-likelihood interval with the Laplace interval.

        It names instead a better fit than the estimate (deviance below -0.01), or sides without limit. The interval
        counts as quadratic if the half-widths differ by less than 10 %, as mildly nonlinear below 50 %, else as
        strongly nonlinear.
        """
        if self.better < -_LOWER_BY:
            return f"{self.name}: the profile found a better fit; the estimate is not the minimum, search again"
        if all(self.is_open):
            return f"{self.name} has no limit on either side"
        percent = f"{100 * self.level:g} %"
        if self.is_open[1]:
            return f"{self.name} has no upper limit; {percent} above {self.lower:.4g} {self.unit}"
        if self.is_open[0]:
            return f"{self.name} has no lower limit; {percent} below {self.upper:.4g} {self.unit}"
        if self.nonlinearity < 0.1:
            return (
                f"{self.name}: quadratic, the Laplace interval is right to {100 * self.nonlinearity:.0f} % of its width"
            )
        kind = "mildly" if self.nonlinearity < 0.5 else "strongly"
        return f"{self.name}: {kind} nonlinear, half-widths differ by up to {100 * self.nonlinearity:.0f} %; use the profile"


def profile(
    problem: Problem, estimate: Estimate, parameter: str | int, level: float = 0.95, max_points: int = 24
) -> Profile:
    """The profile likelihood of one parameter and its likelihood-ratio interval.

    From the estimate outwards to both sides, each point starts from the one before moved along the tangent, and
    the ends are found by Newton's method on the signed root of the deviance, whose slope needs no further fit:
    d(deviance)/d(theta_j) = 2 r' J_j at the constrained minimum.

    Parameters
    ----------
    problem : Problem
        That gave the estimate.
    estimate : Estimate
    parameter : str or int
        Name, or index from 0.
    level : float
        Probability of the interval.
    max_points : int
        Most constrained fits on one side. Where they do not reach the end, it is open: infinite in the free variable.
        Each costs some linearizations.

    Returns
    -------
    Profile

    Raises
    ------
    InputError
        If there is no such parameter, or the level is not between 0 and 1.

    Notes
    -----
    Where the estimate carries model error, the deviance of a parameter is the chi-square times the ratio of its
    variances with and without model error (Kent 1982), which `scale` takes out; so it does with what few averages add.
    Valid to second order where Laplace is to first, and unchanged by any transformation of the parameter.

    References
    ----------
    Wilks (1938), Ann. Math. Stat. 9; Venzon and Moolgavkar (1988), Appl. Stat. 37; Kent (1982), Biometrika 69.
    """
    index = _position(estimate, parameter)
    require_level(level)
    quantile = float(special.ndtri(0.5 + level / 2))
    scale = _scale(problem, estimate, index)
    sides = [_Side(problem, estimate, index, scale, sign, quantile, max_points) for sign in (-1, 1)]
    (below, low), (above, high) = (side.walked() for side in sides)
    points = [*below[::-1], (float(estimate.theta[index]), 0.0, np.array(estimate.theta)), *above]
    ends = np.array([low, high])
    with np.errstate(over="ignore"):
        values = [problem.physical(theta)[index] for _, _, theta in points]
        lower, upper = (float(problem.physical(_with(estimate.theta, index, end))[index]) for end in ends)
    half = quantile * estimate.std_free[index]
    ratios = np.abs(ends - estimate.theta[index]) / half if np.isfinite(half) and half > 0 else np.full(2, np.inf)
    return Profile(
        name=estimate.names[index],
        unit=estimate.units[index],
        level=level,
        values=locked(values),
        deviance=locked([deviance for _, deviance, _ in points]),
        scale=scale,
        lower=lower,
        upper=upper,
        is_open=(not np.isfinite(low), not np.isfinite(high)),
        nonlinearity=float(np.abs(ratios - 1).max()),
    )


def profiles(
    problem: Problem,
    estimate: Estimate,
    parameters: Sequence[str | int] | None = None,
    level: float = 0.95,
    max_points: int = 24,
    work: TaskExecutor = SERIAL,
) -> tuple[Profile, ...]:
    """Profile likelihoods of several `parameters`, in their order; each is a parallel task of `work`.

    `parameters` are names or indices, all by default; the other arguments are those of `profile`. At most `max_points`
    points are computed on either side of the estimate.

    Raises
    ------
    InputError
        If there is no such parameter, or the level is not between 0 and 1.
    """
    chosen = range(len(estimate.names)) if parameters is None else parameters
    shared = (problem, estimate.with_transform(np.array), level, max_points)
    return tuple(Profile(**stored) for stored in work.map("profiles", _compute_profile, shared, list(chosen)))


def profile_ends(
    problem: Problem, estimate: Estimate, level: float, seed: int, work: TaskExecutor
) -> tuple[FloatArray, tuple[str, ...]]:
    """Interval ends (n_params, 2) in physical units from all profiles, and sentences on those that are not quadratic.

    A profile has a sentence if a half-width differs by 10 % from the Laplace interval, or a better fit was met. `level` is the
    probability of the interval; `seed` is not used.
    """
    computed = profiles(problem, estimate, level=level, work=work)
    notes = tuple(item.words for item in computed if item.nonlinearity >= 0.1 or item.better < -0.01)
    return np.array([(item.lower, item.upper) for item in computed]).reshape(-1, 2), notes


def _compute_profile(
    shared: tuple[Problem, Estimate, float, int], parameter: str | int, tools: TaskContext
) -> StoredValues:
    """Fields of the `Profile` of one parameter by name, as a parallel task.

    `shared` holds problem, estimate, level and the largest number of points on a side.
    """
    problem, estimate, level, max_points = shared
    computed = profile(problem, estimate.with_transform(problem.physical), parameter, level, max_points)
    return {entry.name: getattr(computed, entry.name) for entry in fields(computed)}


def _position(estimate: Estimate, parameter: str | int) -> int:
    """Index of a parameter given by name or by index; `InputError` if there is none."""
    if isinstance(parameter, str):
        if parameter not in estimate.names:
            raise InputError(
                f"`parameter` must be one of {', '.join(estimate.names)}, got {parameter!r}; correct the name"
            )
        return estimate.names.index(parameter)
    if not 0 <= parameter < len(estimate.names):
        raise InputError(
            f"`parameter` must be from 0 to {len(estimate.names) - 1}, got {parameter}; correct the position"
        )
    return parameter


def _scale(problem: Problem, estimate: Estimate, index: int) -> float:
    """Ratio of a parameter's variance to that of the fit with known noise: 1 without model error and few averages.

    `index` is that of the parameter. If it is not identified, the ratio is chi-square per degree of freedom, at least
    1. With few averages the variance is compared with that of the least-squares fit as if the noise were known.
    """
    few = few_averages(problem.rows.averages)
    if estimate.covariance_basis == "noise" and few is None:
        return 1.0
    if not estimate.identified[index]:
        return max(estimate.chi_square_per_dof, 1.0)
    if few is None:
        return float(
            estimate.spread.covariance_model_error[index, index] / estimate.spread.covariance_noise[index, index]
        )
    return float(estimate.std_free[index] ** 2 / fit_covariance(problem, estimate.theta)[index, index])


def _with(theta: FloatArray, index: int, value: float) -> FloatArray:
    """A copy of `theta` (n_params,) with `value` at `index`."""
    changed = np.array(theta)
    changed[index] = value
    return changed


_Point = tuple[float, float, FloatArray]


@dataclass(frozen=True, eq=False)
class _Side:
    """The walk from the estimate to one side of parameter `index`, `sign` -1 or 1, in units of its free variable.

    It ends where the root of the deviance, the increase of the sum of squares over `scale`, is `quantile`.
    """

    problem: Problem
    estimate: Estimate
    index: int
    scale: float
    sign: int
    quantile: float
    max_points: int

    def walked(self) -> tuple[list[_Point], float]:
        """Points of the profile on this side, and the interval end in the free variable; infinite if none was reached.

        A point is the free variable, the deviance and all free variables (n_params,); points go outwards from the
        estimate. The walk ends where the root of the deviance is within 0.2 % of the wanted quantile, which is the
        interval end, and without one after `max_points` fits, where a fit fails, or at the farthest distance: 1e4
        standard deviations for a parameter that is its own free variable, else 40 plus the magnitude of the start.
        """
        start = float(self.estimate.theta[self.index])
        std = float(self.estimate.std_free[self.index])
        step = std if np.isfinite(std) and std > 0 else 1.0
        step, farthest = (
            (step, _FARTHEST_LINEAR * step) if self._is_linear() else (min(step, 1.0), _FARTHEST + abs(start))
        )
        target = self.quantile
        points: list[_Point] = []
        theta = np.array(self.estimate.theta)
        inside, outside = (start, 0.0, 1 / step), None
        moved = 0.5 * self.sign * target * step
        for _ in range(self.max_points):
            trial = inside[0] + moved
            if abs(trial - start) > farthest:
                trial = start + self.sign * farthest
                if inside[0] == trial:
                    break
            fitted = self._fit_others(theta, trial)
            if fitted is None:
                break
            theta_new, deviance, slope = fitted
            points.append((trial, deviance, theta_new))
            root = np.sqrt(max(deviance, 0.0))
            if abs(root - target) <= _END_TOLERANCE * target:
                return sorted(points, key=lambda p: self.sign * p[0]), trial
            rate = abs(slope) / (2 * root) if root > 0 else 0.0
            if root < target:
                inside, theta = (trial, root, rate), theta_new
            else:
                outside = (trial, root, rate)
            moved = self._next(inside, outside, (trial, root, rate)) - inside[0]
        return sorted(points, key=lambda p: self.sign * p[0]), self.sign * np.inf

    def _is_linear(self) -> bool:
        """True where the physical value has no limit for a free variable of minus or plus infinity.

        False for a logarithmic or bounded parameter.
        """
        ends = [
            self.problem.physical(_with(self.estimate.theta, self.index, end))[self.index] for end in (-np.inf, np.inf)
        ]
        return not np.isfinite(ends).any()

    def _next(
        self,
        inside: tuple[float, float, float],
        outside: tuple[float, float, float] | None,
        last: tuple[float, float, float],
    ) -> float:
        """Next trial value of the free variable for the interval end, by Newton's method kept inside a bracket.

        `inside` and `outside` (None if not met yet) are points on either side of the end, and `last` is the last one
        tried: free variable, root of the deviance, and slope of this root. Without `outside` a step at most triples the
        distance from the estimate. A Newton step that leaves the middle 90 % of the bracket is replaced by linear
        interpolation, or by the middle where the root inside is below a tenth of the wanted quantile.
        """
        start = float(self.estimate.theta[self.index])
        trial, root, rate = last
        newton = trial + self.sign * (self.quantile - root) / rate if rate > 0 else self.sign * np.inf
        if outside is None:
            farthest = inside[0] + 2 * max(abs(inside[0] - start), 1e-300) * self.sign
            return farthest if self.sign * (newton - farthest) > 0 else newton
        low, high = sorted((inside[0], outside[0]))
        margin = 0.05 * (high - low)
        if low + margin < newton < high - margin:
            return float(newton)
        share = (self.quantile - inside[1]) / (outside[1] - inside[1]) if inside[1] > 0.1 * self.quantile else 0.5
        return inside[0] + min(max(share, 0.1), 0.9) * (outside[0] - inside[0])

    def _fit_others(self, theta: FloatArray, at: float) -> tuple[FloatArray, float, float] | None:
        """Fit with the free variable of the parameter fixed at the value `at`; None if it fails.

        Returns all free variables (n_params,), the deviance (increase of the sum of squares over `self.scale`) and its
        slope by the fixed variable. The search starts from `theta` (n_params,), shifted along the tangent if the model
        can be evaluated there.
        """
        others = np.delete(theta, self.index)
        others_free = FixedVariables(self.problem, np.array([self.index]), np.array([at]))
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                begin = others + self._tangent(theta) * (at - theta[self.index])
                if not np.isfinite(others_free.residual(begin)).all():
                    begin = others
                if len(others):
                    others = minimize(others_free, _SEARCH, begin).theta
                whole = others_free.whole(others)
                reached = self.problem.linearize(whole)
                cost = float(reached.residual @ reached.residual)
        except (SingularModelError, np.linalg.LinAlgError):
            return None
        if not np.isfinite(cost):
            return None
        least = self._least()
        slope = 2 * float(reached.residual @ reached.jacobian[:, self.index]) / self.scale
        return whole, (cost - least) / self.scale, slope

    def _least(self) -> float:
        residual = self.problem.residual(self.estimate.theta)
        return float(residual @ residual)

    def _tangent(self, theta: FloatArray) -> FloatArray:
        """Derivative (n_params - 1,) of the other free variables by this one, along the constrained minima, at `theta`."""
        jacobian = self.problem.linearize(theta).jacobian
        column = jacobian[:, self.index]
        return -np.linalg.lstsq(np.delete(jacobian, self.index, axis=1), column, rcond=None)[0]

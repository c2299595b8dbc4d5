"""The answer: values, covariance, status and diagnostics, complete when constructed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import special

from structid.arrays import FloatArray, locked
from structid.estimation.covariance import correlation_length, inverse_information, model_error_covariance
from structid.estimation.identifiability import Identifiability, identifiability
from structid.estimation.least_squares import LevenbergMarquardt, Method, Minimum, minimize
from structid.estimation.problem import Linearization, Problem


class Status(Enum):
    """How an identification ended; the value is what files and reports show."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    NOT_IDENTIFIABLE = "not_identifiable"

    @property
    def words(self) -> str:
        """What happened, and what helps."""
        return _STATUS_WORDS[self]


_STATUS_WORDS = {
    Status.CONVERGED: "the search converged and the data determine every parameter",
    Status.NOT_CONVERGED: (
        "the search did not converge; start closer, fix or tie parameters, or narrow the band, and look at the residual"
    ),
    Status.NOT_IDENTIFIABLE: (
        "the data do not determine every parameter; tie or fix the parameters named, give a prior, or measure more places"
    ),
}


@dataclass(frozen=True, eq=False)
class Estimate:
    """Identified parameters with their uncertainty.

    Attributes
    ----------
    names, kinds, units : tuple of str
    initial, values : (n_params,) float arrays
        Physical values before and after.
    covariance_noise : (n_params, n_params) float array
        From the noise of the data alone (and the priors), physical units.
    covariance_model_error : (n_params, n_params) float array
        From the residuals themselves, correlated along the axis and within channels; carries model error.
    covariance_basis : str
        ``"noise"`` or ``"model_error"``: which of the two `covariance` and `std` are.
    identified : (n_params,) bool array
        Whether the relative standard deviation is at most 1.
    status : Status
    message : str
        What ended the search.
    identifiability : Identifiability
        Rank, condition and undetermined directions, from the data alone.
    chi_square : float
        Sum of squared whitened data residuals.
    degrees_of_freedom : int
    residual_correlation : float
        Correlation length of the residual in lines; about 1 for noise.
    n_iterations : int
    n_starts, n_agreeing : int
        How many searches were tried, and how many of them ended at this minimum.
    theta : (n_params,) float array
        Free variables at the end.
    history : (n_iterations + 1, n_params) float array
        Physical values along the way of the last stage.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    initial: FloatArray
    values: FloatArray
    covariance_noise: FloatArray
    covariance_model_error: FloatArray
    covariance_basis: str
    identified: np.ndarray
    status: Status
    message: str
    identifiability: Identifiability
    chi_square: float
    degrees_of_freedom: int
    residual_correlation: float
    n_iterations: int
    n_starts: int
    n_agreeing: int
    theta: FloatArray
    history: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """The covariance that `covariance_basis` names."""
        return self.covariance_noise if self.covariance_basis == "noise" else self.covariance_model_error

    @property
    def std(self) -> FloatArray:
        """Standard deviations from `covariance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_noise(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance_noise))

    @property
    def std_model_error(self) -> FloatArray:
        return np.sqrt(np.diag(self.covariance_model_error))

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix of the parameters."""
        return self.covariance / np.outer(self.std, self.std)

    @property
    def chi_square_per_dof(self) -> float:
        return self.chi_square / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")

    @property
    def chi_square_probability(self) -> float:
        """Probability of a larger chi-square if model and noise level were right."""
        if self.degrees_of_freedom == 0:
            return float("nan")
        return float(special.gammaincc(self.degrees_of_freedom / 2, self.chi_square / 2))

    def __getitem__(self, name: str) -> tuple[float, float]:
        """Value and standard deviation of one parameter."""
        index = self.names.index(name)
        return float(self.values[index]), float(self.std[index])

    def __str__(self) -> str:
        """One line a parameter, after the status."""
        rows = zip(self.names, self.values, self.std, self.units, strict=True)
        width = max((len(name) for name in self.names), default=0)
        lines = [f"{name:{width}}  {value:12.6g} +- {std:.2g} {unit}" for name, value, std, unit in rows]
        return "\n".join([f"{self.status.value}; standard deviations from {self.covariance_basis}", *lines])


StageProgress = Callable[[str, int, float], None]


def estimate(
    problem: Problem,
    method: Method | None = None,
    plans: Sequence[Sequence[tuple[str, Problem]]] = (),
    misfit_probability: float = 1e-3,
    restarts: int = 0,
    seed: int = 0,
    progress: StageProgress | None = None,
) -> Estimate:
    """Parameters that minimize the problem's sum of squares, with their uncertainty.

    Parameters
    ----------
    problem : Problem
        Its residual is whitened by the noise; it gives the final values and the covariance.
    method : Method, optional
        Levenberg-Marquardt by default.
    plans : sequence of sequences of (name, Problem)
        Ways to the answer: easier forms of the same problem (same parameters), run one after another before it. The
        first search takes the first way; restarts take the others in turn.
    misfit_probability : float
        Below this probability of its chi-square the fit is taken to hold model error, and the standard deviations
        are those that carry it.
    restarts : int
        How many more searches are tried where the fit misses the noise by that measure: by each other way from the
        given start, then from random points about 20 % from it. The lowest minimum is kept.
    seed : int
        Of the random starts.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    """
    start = np.array(problem.theta_start)
    ways: Sequence[Sequence[tuple[str, Problem]]] = plans or ((),)
    spread = 0.2 * np.abs(problem.physical(start)) / problem.slope(start)
    rng = np.random.default_rng(seed)
    minima: list[tuple[Minimum, int]] = []
    for attempt in range(restarts + 1):
        given = start if attempt < len(ways) else start + spread * rng.standard_normal(len(start))
        prefix = f"search {attempt + 1}, " if attempt else ""
        way = ways[attempt % len(ways)]
        minima.append(_staged(problem, method or LevenbergMarquardt(), way, given, progress, prefix))
        if not _misfits(problem, minima[-1][0].linearization, misfit_probability):
            break
    best = min(minima, key=lambda m: (not m[0].converged, m[0].costs[-1]))
    same = sum(m[0].converged and m[0].costs[-1] <= best[0].costs[-1] * (1 + 1e-6) + 1e-12 for m in minima)
    return _complete(problem, best[0], best[1], misfit_probability, (len(minima), same))


def _staged(
    problem: Problem,
    method: Method,
    stages: Sequence[tuple[str, Problem]],
    theta: FloatArray,
    progress: StageProgress | None,
    prefix: str = "",
) -> tuple[Minimum, int]:
    """The minimum that the stages and then the problem itself lead to, and the iterations spent."""
    iterations = 0
    for name, stage in stages:
        minimum = minimize(stage, LevenbergMarquardt(gain_tolerance=1e-6), theta, _named(progress, prefix + name))
        theta, iterations = minimum.theta, iterations + len(minimum.costs) - 1
    minimum = minimize(problem, method, theta, _named(progress, prefix + "final"))
    return minimum, iterations + len(minimum.costs) - 1


def _misfits(problem: Problem, at: Linearization, probability: float) -> bool:
    """Whether chi-square is larger than noise alone would make it with this probability."""
    data = at.residual[: problem.n_data]
    freedom = len(at.residual) - at.jacobian.shape[1]
    return freedom > 0 and bool(special.gammaincc(freedom / 2, float(data @ data) / 2) < probability)


def relative_jacobian(problem: Problem, theta: FloatArray, at: Linearization) -> FloatArray:
    """Data rows of the Jacobian with respect to relative changes of the physical parameters."""
    values = problem.physical(theta)
    scale = np.where(values != 0, np.abs(values), 1.0)
    return at.jacobian[: problem.n_data] * (scale / problem.slope(theta))


def _named(progress: StageProgress | None, name: str) -> Callable[[int, float], None] | None:
    if progress is None:
        return None
    report = progress
    return lambda iteration, cost: report(name, iteration, cost)


def _complete(
    problem: Problem, minimum: Minimum, n_iterations: int, misfit_probability: float, starts: tuple[int, int]
) -> Estimate:
    theta, at = minimum.theta, minimum.linearization
    values, slope = problem.physical(theta), problem.slope(theta)
    data = at.residual[: problem.n_data]
    chi_square = float(data @ data)
    freedom = max(len(at.residual) - len(values), 0)
    noise = inverse_information(at.jacobian) * np.outer(slope, slope)
    model = model_error_covariance(problem, at) * np.outer(slope, slope)
    misfit = _misfits(problem, at, misfit_probability)
    noise_scale = float(np.sqrt(chi_square / freedom)) if misfit else 1.0
    found = identifiability(relative_jacobian(problem, theta, at), values, problem.names, noise_scale)
    adopted = np.sqrt(np.diag(model if misfit else noise))
    identified = adopted <= np.abs(values)
    if not minimum.converged:
        status = Status.NOT_CONVERGED
    elif not identified.all():
        status = Status.NOT_IDENTIFIABLE
    else:
        status = Status.CONVERGED
    return Estimate(
        names=problem.names,
        kinds=problem.kinds,
        units=problem.units,
        initial=locked(problem.physical(np.asarray(problem.theta_start))),
        values=locked(values),
        covariance_noise=locked(noise),
        covariance_model_error=locked(model),
        covariance_basis="model_error" if misfit else "noise",
        identified=locked(identified),
        status=status,
        message=minimum.message,
        identifiability=found,
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        residual_correlation=correlation_length(data, problem.lines, problem.series),
        n_iterations=n_iterations,
        n_starts=starts[0],
        n_agreeing=starts[1],
        theta=locked(theta),
        history=locked(np.array([problem.physical(t) for t in minimum.history])),
    )

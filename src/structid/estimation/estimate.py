"""The answer: values, covariance, status and diagnostics, complete when constructed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy import special

from structid.arrays import FloatArray, locked
from structid.errors import InputError
from structid.estimation.covariance import chi_square_law, correlation_length, model_error_covariance, noise_covariance
from structid.estimation.diagnostics.identifiability import Identifiability, identifiability
from structid.estimation.diagnostics.refusal import Bound, bound_at, carried, refusal_words
from structid.estimation.diagnostics.residual_tests import ResidualTests, residual_tests
from structid.estimation.problem import Linearization, Problem, parameter_sizes
from structid.estimation.search.least_squares import LevenbergMarquardt, Method, Minimum
from structid.estimation.search.multistart import (
    Answer,
    Search,
    StageProgress,
    Way,
    distinct_answers,
    named,
    searched_minima,
)
from structid.estimation.search.work import ALONE, Work


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
        Whether the relative standard deviation is at most 1, at the estimate and at the initial values (see `carried`).
    status : Status
    message : str
        What ended the search, and the Cramer-Rao bound where the data do not determine every parameter.
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
    residual_tests : ResidualTests or None
        Whether the residual looks like noise; None where there is no residual to test.
    to_physical : callable
        Physical values of free variables, each of its own (`Problem.physical`).
    slope : (n_params,) float array or None
        Derivative of each physical value with respect to its free variable at `theta`; ones where None.
    bound_initial : (n_params,) float array or None
        Cramer-Rao bound of each parameter if the truth were the initial values, physical units.
    answers : tuple of Answer
        The distinct minima that the searches found, best first; where a sample was searched, those of the sample.
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
    residual_tests: ResidualTests | None = None
    to_physical: Callable[[FloatArray], FloatArray] = np.array
    slope: FloatArray | None = None
    bound_initial: FloatArray | None = None
    answers: tuple[Answer, ...] = ()

    @property
    def n_fitting(self) -> int:
        """How many distinct parameter sets among `answers` the data allow."""
        return sum(answer.fits for answer in self.answers)

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

    @property
    def std_free(self) -> FloatArray:
        """Standard deviations of the free variables, from `covariance`: of the logarithm for a log parameter."""
        if self.slope is None:
            return self.std
        return np.divide(self.std, np.abs(self.slope), out=np.full(len(self.std), np.nan), where=self.slope != 0)

    def interval(self, level: float = 0.95) -> FloatArray:
        """Interval of each parameter in physical units, lower and upper end: (n_params, 2), NaN where not determined.

        The normal interval of the free variable, taken to physical units: of a positive parameter it is
        exp(log p -+ z s / p), positive and longer upwards; of a bounded one it stays between the bounds.

        Parameters
        ----------
        level : float
            Probability between 0 and 1 that it covers the truth, where the problem is nearly linear.
        """
        if not 0 < level < 1:
            raise InputError(f"`level` must be between 0 and 1, got {level:g}; 0.95 is usual")
        half = float(special.ndtri(0.5 + level / 2)) * self.std_free
        with np.errstate(over="ignore"):
            return np.stack([self.to_physical(self.theta - half), self.to_physical(self.theta + half)], axis=1)

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


def estimate(
    problem: Problem,
    method: Method | None = None,
    plans: Sequence[Way] = (),
    misfit_probability: float = 1e-3,
    restarts: int = 0,
    seed: int = 0,
    progress: StageProgress | None = None,
    sample: Problem | None = None,
    uniqueness_starts: int = 0,
    work: Work = ALONE,
) -> Estimate:
    """Parameters that minimize the problem's sum of squares, with their uncertainty.

    Parameters
    ----------
    problem : Problem
        Its residual is whitened by the noise; it gives the final values and the covariance.
    method : Method, optional
        Levenberg-Marquardt by default.
    plans : sequence of sequences of (name, Problem), or of functions of the start that give one
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
    sample : Problem, optional
        The same problem with a part of its data, on which the searches are made; only the last iterations, from the
        best minimum, then take all of the data.
    uniqueness_starts : int
        How many more searches begin at random points about 20 % from the start even where a search fits: a test
        whether other parameters fit the data as well. See ``Estimate.answers``.
    work : Work
        Where the searches run, and whether they are kept; in this process by default.
    """
    searched = problem if sample is None else sample

    def fits(minimum: Minimum) -> bool:
        return not _misfits(searched, minimum.theta, minimum.linearization, misfit_probability)

    search = Search(restarts, uniqueness_starts, seed)
    minima = searched_minima(searched, method or LevenbergMarquardt(), plans, search, fits, progress, work)
    answers = distinct_answers(searched, [minimum for minimum, _ in minima], fits, misfit_probability)
    best = min(minima, key=lambda m: (not m[0].converged, m[0].costs[-1]))
    same = answers[0].n_searches if answers else 0
    if sample is not None:
        polished = work.minimize(problem, _close_by(method), best[0].theta, named(progress, "all data"))
        best = polished, best[1] + len(polished.costs) - 1
    return _complete(problem, best[0], best[1], misfit_probability, (len(minima), same), answers)


def _close_by(method: Method | None) -> Method:
    """The same search where the minimum is known to be close: steps are hardly damped."""
    chosen = method or LevenbergMarquardt()
    if not isinstance(chosen, LevenbergMarquardt):
        return chosen
    return replace(chosen, initial_damping=1e-9, acceleration=0.0, gain_tolerance=max(chosen.gain_tolerance, 1e-10))


def _misfits(problem: Problem, theta: FloatArray, at: Linearization, probability: float) -> bool:
    """Whether chi-square is larger than noise alone would make it with this probability."""
    data = at.residual[: problem.n_data]
    scale, freedom = chi_square_law(problem, theta, at)
    return freedom > 0 and bool(special.gammaincc(freedom / 2, float(data @ data) / (2 * scale)) < probability)


def relative_jacobian(problem: Problem, theta: FloatArray, at: Linearization) -> FloatArray:
    """Data rows of the Jacobian with respect to relative changes of the physical parameters."""
    sizes = parameter_sizes(problem, problem.physical(theta))
    scale = np.where(sizes != 0, sizes, 1.0)
    slope = problem.slope(theta)
    return at.jacobian[: problem.n_data] * np.divide(scale, slope, out=np.zeros(len(slope)), where=slope != 0)


def _complete(
    problem: Problem,
    minimum: Minimum,
    n_iterations: int,
    misfit_probability: float,
    starts: tuple[int, int],
    answers: tuple[Answer, ...],
) -> Estimate:
    theta, at = minimum.theta, minimum.linearization
    values, slope = problem.physical(theta), problem.slope(theta)
    data = at.residual[: problem.n_data]
    chi_square = float(data @ data)
    freedom = max(len(at.residual) - len(values) - at.n_eliminated, 0)
    noise = noise_covariance(problem, theta, at) * np.outer(slope, slope)
    model = model_error_covariance(problem, at) * np.outer(slope, slope)
    misfit = _misfits(problem, theta, at, misfit_probability)
    noise_scale = float(np.sqrt(chi_square / freedom)) if misfit else 1.0
    found = identifiability(relative_jacobian(problem, theta, at), values, problem.names, noise_scale)
    adopted = np.sqrt(np.diag(model if misfit else noise))
    sizes = parameter_sizes(problem, values)
    initial = bound_at(problem, np.asarray(problem.theta_start), "the initial values")
    final = Bound(np.sqrt(np.diag(noise)), sizes, "the estimate")
    carried_at_start = carried(initial, sizes, adopted, minimum.converged and not misfit)
    identified = carried_at_start & (adopted <= sizes)
    if not minimum.converged and carried_at_start.all():
        status = Status.NOT_CONVERGED
    elif not identified.all() or sum(answer.fits for answer in answers) > 1:
        status = Status.NOT_IDENTIFIABLE
    else:
        status = Status.CONVERGED
    refused = status is Status.NOT_IDENTIFIABLE and not identified.all()
    refusal = refusal_words(initial, final, carried_at_start, problem.names) if refused else ""
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
        message=f"{minimum.message}; {refusal}" if refusal else minimum.message,
        identifiability=found,
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        residual_correlation=correlation_length(data, problem.lines, problem.series),
        n_iterations=n_iterations,
        n_starts=starts[0],
        n_agreeing=starts[1],
        theta=locked(theta),
        history=locked(np.array([problem.physical(t) for t in minimum.history])),
        residual_tests=residual_tests(problem, at.residual, freedom),
        to_physical=problem.physical,
        slope=locked(slope),
        bound_initial=initial.std,
        answers=answers,
    )

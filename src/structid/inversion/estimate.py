"""The answer: values, covariance, status and diagnostics, complete when constructed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, locked
from structid.core.display import Overview, Shown, data_frame, format_number, join_words, names_like, plural
from structid.core.errors import InputError, MissingNameError, require_class
from structid.inversion.covariance import correlation_length
from structid.inversion.diagnostics.identifiability import Identifiability
from structid.inversion.diagnostics.residual_tests import ResidualTests, residual_tests
from structid.inversion.fixed_values import FitWithinTolerances, FixedValueInfluence
from structid.inversion.problem import ContinuationPath, Problem, expected_square
from structid.inversion.search.least_squares import Method, Minimum, StageCourse, squared
from structid.inversion.search.levenberg_marquardt import LevenbergMarquardt
from structid.inversion.search.multistart import (
    DistinctMinimum,
    Search,
    are_same,
    cost_rank,
    distinct_answers,
    ends_at_other,
    named,
    searched_minima,
)
from structid.inversion.search.within_tolerances import FixedValues
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.inversion.uncertainty import Covariance, Spread, Uncertainty

if TYPE_CHECKING:
    import pandas as pd


#: Standard deviation relative to the value beyond which data determine a parameter only weakly.
_WEAK = 0.5
#: Probability of a larger chi-square below which the residual is looked at with fixed values free within their tolerances.
_DOUBTFUL = 0.3


class Status(Enum):
    """End of an identification; files and reports show its value."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    NOT_IDENTIFIABLE = "not_identifiable"

    @property
    def words(self) -> str:
        """The status in a sentence, with remedies."""
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
#: Of very many parameters, which the data never determine without priors.
_WORDS_WITH_PRIORS = {
    Status.CONVERGED: "the search converged, and data and priors together hold every parameter",
    Status.NOT_IDENTIFIABLE: (
        "data and priors together do not hold every parameter; strengthen the smoothness, group the unknowns, or measure"
        " more places"
    ),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class ParameterValues:
    """Names and values of the parameters.

    Attributes
    ----------
    names, kinds, units : tuple of str
    initial, values : (n_params,) float arrays
        Physical values at the start and at the answer.
    theta : (n_params,) float array
        Free variables at the answer.
    slope : (n_params,) float array or None
        Derivative of each physical value with respect to its free variable at `theta`; ones where None.
    to_physical : callable
        Physical values as a function of the free variables (`Problem.physical`).
    scale : (n_params,) float array or None
        Size that the deviation of a parameter that may vanish is compared with; 0 for the others.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    initial: FloatArray
    values: FloatArray
    theta: FloatArray
    slope: FloatArray | None = None
    to_physical: Callable[[FloatArray], FloatArray] = np.array
    scale: FloatArray | None = None

    def free_std(self, std: FloatArray) -> FloatArray:
        """Standard deviations (n_params,) of the free variables from `std` in physical units; NaN where a slope is 0."""
        if self.slope is None:
            return std
        return np.divide(std, np.abs(self.slope), out=np.full(len(std), np.nan), where=self.slope != 0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Goodness:
    """Goodness of the fit.

    Attributes
    ----------
    chi_square : float
        Sum of squared whitened data residuals.
    n_data : int
    degrees_of_freedom : float
        A whole number where there is a Jacobian.
    residual_correlation : float
        Correlation length of the residual in lines; about 1 for noise.
    residual_tests : ResidualTests or None
        Tests whether the residual looks like noise; None where there is no residual to test. They are of the fit with fixed values
        free within their tolerances where noise alone does not explain that with exact ones.
    expected_per_dof : float
        Chi-square per degree of freedom where all is right: 1, and more where few averages tell the noise.
    n_values : int
        Independent data values: `n_data` but for those that solve for quantities of the record alone. 0 where they are not counted.
    test_freedom : float
        What `n_values` have beyond the degrees of freedom that parameters take from them: below 1, the data test nothing. Infinite
        where they are not counted.
    least_chi_square : float
        The smallest chi-square with fixed values within their tolerances, their squares included; NaN where noise explains
        `chi_square`.
    """

    chi_square: float
    n_data: int
    degrees_of_freedom: float
    residual_correlation: float
    residual_tests: ResidualTests | None = None
    expected_per_dof: float = 1.0
    least_chi_square: float = float("nan")
    n_values: int = 0
    test_freedom: float = float("inf")

    @property
    def misfit(self) -> float:
        """Least chi-square per degree of freedom over its expectation for a correct model; NaN without degrees of freedom.

        Fixed values are free within their tolerances; about 1 for a correct model.
        """
        return self.least_per_dof / self.expected_per_dof

    @property
    def least_per_dof(self) -> float:
        """Smallest chi-square per degree of freedom with fixed values free within their tolerances.

        It is `chi_square` per degree of freedom where `least_chi_square` is NaN; NaN without degrees of freedom.
        """
        return (
            self.chi_square_within_tolerances / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")
        )

    @property
    def chi_square_within_tolerances(self) -> float:
        """`least_chi_square`, or `chi_square` where noise explains it."""
        return self.least_chi_square if np.isfinite(self.least_chi_square) else self.chi_square

    @property
    def misfit_words(self) -> str:
        """The misfit in words, as root mean square over its expectation from noise and tolerances."""
        if not self.degrees_of_freedom > 0:
            return "no degree of freedom is left to test the model"
        return f"misfit {format_number(float(np.sqrt(self.misfit)), 3)} times what is expected"

    @property
    def chi_square_per_dof(self) -> float:
        return self.chi_square / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")

    @property
    def chi_square_probability(self) -> float:
        """Probability of a larger chi-square if model and noise level are right; NaN without degrees of freedom."""
        if not self.degrees_of_freedom > 0:
            return float("nan")
        if self.residual_tests is not None:
            return self.residual_tests.chi_square_probability
        return float(special.gammaincc(self.degrees_of_freedom / 2, self.chi_square / 2))


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchRecord:
    """Searches that led to the answer.

    Attributes
    ----------
    n_iterations : int
    n_starts, n_agreeing : int
        Number of searches, and number of those that ended at this minimum.
    history : (n_iterations + 1, n_params) float array
        Physical values at each iteration of the last stage.
    stages : tuple of StageCourse
        All stages of the search that led to the answer, the last one included, with physical values and sums of squares.
    answers : tuple of DistinctMinimum
        The distinct minima that the searches found, best first; where a sample was searched, those of the sample.
    is_exhaustive : bool
        Whether wide starts were made until no more answers are to be expected.
    n_rows : int
        Rows of data that all iterations of all searches evaluated; 0 where they are not counted.
    """

    n_iterations: int
    n_starts: int
    n_agreeing: int
    history: FloatArray
    answers: tuple[DistinctMinimum, ...] = ()
    is_exhaustive: bool = False
    stages: tuple[StageCourse, ...] = ()
    n_rows: int = 0

    @property
    def n_fitting(self) -> int:
        """Number of distinct parameter sets among `answers` that the data allow."""
        return sum(answer.fits for answer in self.answers)


class Value(NamedTuple):
    """Value and standard deviation of one parameter, in physical units; the latter is NaN if undetermined."""

    value: float
    std: float


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Estimate(Shown):
    """Identified parameters with their uncertainty.

    The quantities that are asked for most are properties of the estimate itself; its parts have all of them.

    Attributes
    ----------
    parameters : ParameterValues
    spread : Spread
        Covariances, identifiability and influence of fixed values.
    goodness : Goodness
        Chi-square and tests of the residual.
    search : SearchRecord
        Searches and the distinct answers that they found.
    status : Status
    message : str
        What ended the search, and the Cramer-Rao bound where the data do not determine every parameter.
    """

    parameters: ParameterValues
    spread: Spread
    goodness: Goodness
    search: SearchRecord
    status: Status
    message: str

    @property
    def names(self) -> tuple[str, ...]:
        return self.parameters.names

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.parameters.kinds

    @property
    def units(self) -> tuple[str, ...]:
        return self.parameters.units

    @property
    def initial(self) -> FloatArray:
        """Initial physical values, (n_params,)."""
        return self.parameters.initial

    @property
    def values(self) -> FloatArray:
        """Identified physical values, (n_params,)."""
        return self.parameters.values

    @property
    def theta(self) -> FloatArray:
        """Free variables of the identified values, (n_params,)."""
        return self.parameters.theta

    @property
    def std(self) -> FloatArray:
        """Standard deviations in physical units from `uncertainty`, (n_params,)."""
        return self.spread.std

    @property
    def std_noise(self) -> FloatArray:
        """Standard deviations from the noise of the data alone, (n_params,)."""
        return self.spread.noise.std

    @property
    def uncertainty(self) -> Covariance:
        """Covariance of the parameters, with what the tolerances of fixed values add; see `Spread.uncertainty`."""
        return self.spread.uncertainty

    @property
    def covariance(self) -> FloatArray:
        """Covariance matrix, physical units, (n_params, n_params); a matrix-free search gives none."""
        return self.spread.covariance

    @property
    def covariance_of_data(self) -> FloatArray:
        """Covariance matrix without the tolerances of fixed values, (n_params, n_params)."""
        return self.spread.covariance_of_data

    @property
    def covariance_basis(self) -> str:
        """``"noise"`` or ``"model_error"``: the source of `covariance`."""
        return self.spread.covariance_basis

    @property
    def identified(self) -> np.ndarray:
        """Mask of the parameters that the data determine, (n_params,) bool."""
        return self.spread.identified

    @property
    def weakly_determined(self) -> np.ndarray:
        """Mask of the parameters whose standard deviation exceeds half their value, (n_params,) bool.

        A value of either sign near 0 is among them, however small its deviation is.
        """
        return np.abs(self.std) > _WEAK * np.abs(self.values)

    @property
    def identifiability(self) -> Identifiability:
        """Rank, condition and undetermined directions; see `Spread`."""
        return self.spread.identifiability

    @property
    def fixed(self) -> FixedValueInfluence | None:
        """Influence of the values that the model fixes; None where these are taken as exact."""
        return self.spread.fixed

    @property
    def chi_square_per_dof(self) -> float:
        return self.goodness.chi_square_per_dof

    def with_initial(self, initial: FloatArray) -> Estimate:
        """A copy whose initial physical values are `initial`, (n_params,)."""
        return replace(self, parameters=replace(self.parameters, initial=initial))

    def with_transform(self, to_physical: Callable[[FloatArray], FloatArray]) -> Estimate:
        """A copy with another function `to_physical` from free variables to physical values, (n_params,) each."""
        return replace(self, parameters=replace(self.parameters, to_physical=to_physical))

    def without_fixed_values(self) -> Estimate:
        """A copy that takes the values that the model fixes as exact."""
        return replace(self, spread=replace(self.spread, fixed=None))

    @property
    def status_words(self) -> str:
        """Status of the estimate in a sentence, with parameters at a bound or left open, and with remedies."""
        few = self.uncertainty.has_matrix
        spread, n_fitting = self.spread, self.search.n_fitting
        is_known = bool((self.identified | ~spread.is_free).all())
        if n_fitting > 1 and self.status is Status.NOT_IDENTIFIABLE and is_known:
            return (
                f"the search converged, but {n_fitting} sets of values fit the data equally well; measure what tells them"
                " apart, or give a prior"
            )
        if self.status is Status.CONVERGED and spread.at_bound:
            at_bound = ", ".join(bound.name for bound in spread.at_bound)
            return f"the search converged with {at_bound} at a bound, and the data determine every other parameter"
        if self.status is Status.CONVERGED and few and not self.identified.all():
            lost = join_words([name for name, known in zip(self.names, self.identified, strict=True) if not known])
            return f"the search converged; models that are about as likely leave {lost} open"
        return self.status.words if few else _WORDS_WITH_PRIORS.get(self.status, self.status.words)

    @property
    def std_free(self) -> FloatArray:
        """Standard deviations (n_params,) of the free variables, from `uncertainty`: of log p for a positive p."""
        return self.parameters.free_std(self.std)

    @property
    def distance(self) -> FloatArray:
        """Change from the initial value in standard deviations, (n_params,); NaN where there is none."""
        std, change = self.std, self.values - self.initial
        return np.divide(change, std, out=np.full(len(std), np.nan), where=std > 0)

    def beyond_chance(self, level: float = 0.05) -> tuple[np.ndarray, float]:
        """Mask (n_params,) of the parameters that changed from their initial values by more than chance, and the limit used.

        The limit, in standard deviations, is the quantile of Student's t with Bonferroni's correction: if no parameter differs
        from its initial value, the probability that any is marked is at most `level`. NaN changes are never marked.
        """
        limit = float(special.stdtrit(self.uncertainty.freedom, 1 - level / (2 * max(len(self.names), 1))))
        return np.abs(np.nan_to_num(self.distance)) > limit, limit

    def interval(self, level: float = 0.95) -> FloatArray:
        """Confidence interval of each parameter at `level`, lower and upper end: (n_params, 2).

        The normal interval of the free variable, taken to physical units: of a positive parameter it is
        exp(log p -+ z s / p), positive and longer upwards; of a bounded one it stays between the bounds. A positive one
        that may vanish, and that the data do not tell from 0, has p + z s above 0.

        Parameters
        ----------
        level : float
            Probability between 0 and 1 that it covers the truth, where the problem is nearly linear.
        """
        return normal_intervals(self.parameters, self.std, self.identified, level)

    def may_be_absent(self, level: float = 0.95) -> np.ndarray:
        """True for identified positive parameters not significantly different from 0, (n_params,) bool.

        `level` is the probability of the interval that would have to exclude 0.
        """
        return may_be_absent(self.parameters, self.std, self.identified, level)

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """Random draws of the parameters in physical units, (1, n_draws, n_params), normal in the free variables.

        NaN for undetermined parameters. Without a covariance matrix (matrix-free search) the stored draws are returned,
        whose number is not `n_draws`. Positive parameters not significantly different from 0 are drawn normal in
        physical units, cut at 0. `rng` gives the random numbers.
        """
        if not self.uncertainty.has_matrix:
            return (self.values + self.uncertainty.draws)[None]
        slope = np.ones(len(self.values)) if self.parameters.slope is None else np.abs(self.parameters.slope)
        known = np.isfinite(self.std_free)
        free = self.covariance[np.ix_(known, known)] / np.outer(slope[known], slope[known])
        theta = np.full((n_draws, len(self.values)), np.nan)
        theta[:, known] = rng.multivariate_normal(self.theta[known], free, n_draws, method="eigh")
        with np.errstate(over="ignore"):
            draws = np.stack([self.parameters.to_physical(point) for point in theta])
        absent = self.may_be_absent()
        draws[:, absent] = np.maximum(self.values + slope * (theta - self.theta), 0.0)[:, absent]
        return draws[None]

    def __contains__(self, name: object) -> bool:
        """True if there is a parameter of that name."""
        return name in self.names

    def __iter__(self) -> Iterator[str]:
        """Names of the parameters, as iterating over a dictionary gives its keys."""
        return iter(self.names)

    def __getitem__(self, name: str) -> Value:
        """Value and standard deviation of one parameter.

        Raises
        ------
        MissingNameError
            If there is none of that name; with the nearest names, then the first that there are. It is a `KeyError` too.
        """
        if name not in self:
            likely = names_like(str(name), self.names)
            nearest = f"did you mean {' or '.join(map(repr, likely))}? " if likely else ""
            raise MissingNameError(f"no parameter {name!r}; {nearest}there are {join_words(self.names)}")
        index = self.names.index(name)
        return Value(float(self.values[index]), float(self.std[index]))

    def overview(self) -> Overview:
        """Overview of the estimate: a line on status and fit, and a table with one row for each parameter."""
        words = (
            f"{self.status.value}, {plural(len(self.names), 'parameter')} from {self.goodness.n_data} data,"
            f" {self.goodness.misfit_words};"
            f" standard deviations from {self.covariance_basis.replace('_', ' ')}"
        )
        rows = [
            (name, format_number(value), format_number(std, 2), format_number(initial), unit)
            for name, value, std, initial, unit in zip(
                self.names, self.values, self.std, self.initial, self.units, strict=True
            )
        ]
        return Overview(words, ("parameter", "value", "std", "initial", "unit"), rows)

    def to_dataframe(self) -> pd.DataFrame:
        """Table with one row for each parameter: value, standard deviations, 95 % interval, initial value, unit, identified."""
        low, high = self.interval().T
        return data_frame(
            {
                "parameter": self.names, "value": self.values, "std": self.std, "low": low, "high": high,
                "initial": self.initial, "std_noise": self.std_noise, "std_model_error": self.spread.std_model_error,
                "unit": self.units, "identified": self.identified,
            },
            "parameter",
        )  # fmt: skip


def parameters_at(problem: Problem, theta: FloatArray) -> ParameterValues:
    """The parameters of a problem with their values at free variables `theta`, (n_params,)."""
    return ParameterValues(
        names=problem.names,
        kinds=problem.unknowns.kinds,
        units=problem.unknowns.units,
        initial=locked(problem.physical(np.asarray(problem.theta_start))),
        values=locked(problem.physical(theta)),
        theta=locked(theta),
        slope=locked(problem.slope(theta)),
        to_physical=problem.physical,
        scale=locked(problem.unknowns.sizes(np.zeros(len(theta)))),
    )


def normal_intervals(
    parameters: ParameterValues, std: FloatArray, identified: np.ndarray, level: float = 0.95
) -> FloatArray:
    """Normal confidence intervals at `level`, lower and upper end in physical units: (n_params, 2).

    The interval is symmetric in the free variable; NaN where the standard deviation is NaN. Of an identified positive
    parameter that is not significantly different from 0 it goes from 0 to value plus quantile times standard deviation.

    Parameters
    ----------
    parameters : ParameterValues
    std : (n_params,) float array
        Standard deviations in physical units.
    identified : (n_params,) bool array
        Parameters that the data determine.
    level : float
        Probability between 0 and 1.

    Raises
    ------
    InputError
        If `level` is not between 0 and 1.
    """
    require_level(level)
    quantile = float(special.ndtri(0.5 + level / 2))
    half = quantile * parameters.free_std(std)
    with np.errstate(over="ignore"):
        ends = np.sort([parameters.to_physical(parameters.theta + sign * half) for sign in (-1, 1)], axis=0).T
    ends[np.abs(ends) < np.finfo(float).tiny] = 0.0
    absent = may_be_absent(parameters, std, identified, level)
    ends[absent] = np.stack([np.zeros(absent.sum()), (parameters.values + quantile * std)[absent]], axis=1)
    return ends


def may_be_absent(
    parameters: ParameterValues, std: FloatArray, identified: np.ndarray, level: float = 0.95
) -> np.ndarray:
    """True for identified positive parameters not significantly different from 0, (n_params,) bool.

    That is where the value is below q standard deviations, with q the quantile of the two-sided normal interval at
    `level`, and the lower end of the interval symmetric in the free variable is not negative. Only parameters with a
    positive entry of `parameters.scale`, those that may vanish, count.

    Parameters
    ----------
    parameters : ParameterValues
    std : (n_params,) float array
        Standard deviations in physical units.
    identified : (n_params,) bool array
    level : float
        Probability of that interval.
    """
    if parameters.scale is None:
        return np.zeros(len(parameters.names), dtype=bool)
    quantile = float(special.ndtri(0.5 + level / 2))
    with np.errstate(invalid="ignore", over="ignore"):
        is_positive = parameters.to_physical(parameters.theta - quantile * parameters.free_std(std)) >= 0
        return is_positive & (parameters.scale > 0) & identified & (parameters.values < quantile * std)


def expected_per_row(problem: Problem) -> float:
    """Mean square of the whitened data rows where all is right: 1, and n / (n - 2) where n averages tell the noise."""
    averages = problem.rows.averages
    return 1.0 if averages is None else float(expected_square(averages).mean())


def require_level(level: float) -> None:
    """Raise `InputError` unless `level` lies between 0 and 1."""
    if not 0 < level < 1:
        raise InputError(f"`level` must be between 0 and 1, got {level:g}; 0.95 is usual")


def estimate(
    problem: Problem,
    method: Method | None = None,
    plans: Sequence[ContinuationPath] = (),
    search: Search | None = None,
    misfit_probability: float = 1e-3,
    progress: StageProgress | None = None,
    sample: Problem | None = None,
    work: TaskExecutor = SERIAL,
    fixed: FixedValues | None = None,
    **moved: object,
) -> Estimate:
    """Least-squares or maximum-posterior estimate of the parameters of a problem, with uncertainty and diagnostics.

    An estimate is returned also if the search does not converge or the data do not determine every parameter; see its
    `status`.

    Parameters
    ----------
    problem : Problem
        Its residual is whitened by the noise; it gives the final values and the covariance.
    method : Method, optional
        Levenberg-Marquardt by default; `MatrixFree` for very many parameters.
    plans : sequence of sequences of (name, Problem), or of functions of the start that give one
        Continuation paths: easier forms of the same problem (same parameters), searched one after another before it.
        The first search takes the first path; restarts take the others in turn. Without any, the problem is searched at
        once.
    search : Search, optional
        How often and from where is searched; once from the problem's start by default.
    misfit_probability : float
        Below this probability of its chi-square the fit is taken to hold model error, and the standard deviations
        are those from the residual instead of the noise.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    sample : Problem, optional
        The same problem with a part of its data, on which the searches are made; only the last iterations, from the
        best minimum, then take all of the data.
    work : TaskExecutor
        Where the searches run, and whether they are stored; in this process by default.
    fixed : FixedValues, optional
        Fixed values of the model that may be wrong by their tolerances; exact if None.
    **moved
        Must be empty: any other argument raises an error.

    Raises
    ------
    InputError
        If `problem` is no `Problem`, or an unknown argument is given.
    """
    require_class("problem", problem, Problem, "make it by `FrfProblem` and its like; a structure goes to `identify`")
    if moved:
        name = next(iter(moved))
        raise InputError(
            f"`estimate` takes no {name!r}; restarts, uniqueness_starts and seed are given as search=Search(restarts=2)"
        )
    searched, chosen, search = sample or problem, method or LevenbergMarquardt(), search or Search()

    if fixed is not None and chosen.is_matrix_free:
        fixed = replace(fixed, is_matrix_free=True)
    sampled = fixed.on_sample() if fixed is not None and sample is not None else fixed
    sampled = None if chosen.is_matrix_free else sampled  # it searches from one start alone

    refits: dict[Minimum, FitWithinTolerances] = {}
    accepted: list[tuple[Minimum, FloatArray]] = []

    def refit(minimum: Minimum) -> FitWithinTolerances | None:
        """Refit of `minimum` with fixed values free within their tolerances.

        None if there are no fixed values or noise alone explains the misfit.
        """
        if sampled is None or not chosen.misfits(searched, minimum, misfit_probability):
            return None
        return _refit_once(refits, sampled, searched.names, minimum)

    def fits(minimum: Minimum) -> bool:
        """True if the data allow `minimum` and it is no answer in `accepted`; then it is added there.

        The misfit is judged at `misfit_probability`. Where a misfit asks for it, the fit with fixed values free within
        their tolerances is judged, and compared, instead.
        """
        within = refit(minimum)
        if within is None:
            is_fitting, end = not chosen.misfits(searched, minimum, misfit_probability), minimum.theta
        else:
            is_fitting, end = not within.misfits(misfit_probability), within.parameters
        if is_fitting and any(ends_at_other(searched, minimum, end, *answer) for answer in accepted):
            return (
                False  # free within their tolerances, fixed values only let the search go on to an answer that is known
            )
        if is_fitting:
            accepted.append((minimum, end))
        return is_fitting

    def least_cost(minimum: Minimum) -> float:
        within = refit(minimum)
        return float(minimum.costs[-1]) if within is None else squared(within.at.residual)

    searched_starts = searched_minima(searched, chosen, plans, search, fits, progress, work)
    minima = searched_starts.minima
    answers = distinct_answers(searched, [minimum for minimum, _ in minima], fits, least_cost, misfit_probability)
    best, n_iterations = min(
        minima, key=lambda m: (not m[0].converged, cost_rank(m[0]) if search.wide_starts else float(m[0].costs[-1]))
    )
    if sample is not None:
        of_sample = (*best.stages, StageCourse("sample of the data", best.history, best.costs, sample.n_data))
        best = work.minimize(problem, chosen.for_polishing(), best.theta, named(progress, "all data"))
        best = replace(best, stages=of_sample)
        n_iterations += len(best.costs) - 1
    columns = None
    if fixed is not None:
        refit_best = partial(_refit_once, refits, fixed, problem.names, best)
        if not chosen.is_matrix_free and chosen.misfits(problem, best, _DOUBTFUL):
            refit_best()
        columns = fixed.sensitivities_at(problem.names, best.theta, refits.get(best))
        # without a Jacobian, the draws tell first how many degrees of freedom the residual has
        if chosen.is_matrix_free:
            columns = replace(columns, refit=lambda: fixed.followed(refit_best(), problem.names, best.theta))
    uncertainty = chosen.uncertainty(problem, best, misfit_probability, search.seed, columns)
    within = refits.get(best)
    theta, residual = best.theta, best.linearization.residual
    data = residual[: problem.n_data]
    parameters = parameters_at(problem, theta)
    tests = (
        residual_tests(problem, residual, uncertainty.freedom)
        if within is None
        else residual_tests(within.problem, within.at.residual, uncertainty.freedom, float(within.asked @ within.asked))
    )
    goodness = Goodness(
        chi_square=float(data @ data),
        n_data=problem.n_data,
        degrees_of_freedom=uncertainty.freedom,
        residual_correlation=correlation_length(data, problem.rows.lines, problem.rows.series),
        residual_tests=tests,
        expected_per_dof=expected_per_row(problem),
        least_chi_square=np.nan if within is None else within.chi_square,
        n_values=(n_values := problem.n_data - best.linearization.n_eliminated),
        test_freedom=n_values - uncertainty.taken if np.isfinite(uncertainty.taken) else np.inf,
    )
    courses = tuple(
        stage._replace(
            history=locked(np.array([problem.physical(t) for t in stage.history])), costs=locked(stage.costs)
        )
        for stage in (*best.stages, StageCourse("final", best.history, best.costs, problem.n_data))
    )
    searched_courses = [
        stage
        for minimum, _ in minima
        for stage in (*minimum.stages, StageCourse("final", minimum.history, minimum.costs, searched.n_data))
    ]
    searches = SearchRecord(
        n_iterations=n_iterations,
        n_rows=sum(stage.n_rows for stage in searched_courses) + (0 if sample is None else courses[-1].n_rows),
        n_starts=len(minima),
        n_agreeing=answers[0].n_searches if answers else 0,
        history=courses[-1].history,
        answers=answers,
        is_exhaustive=searched_starts.is_complete,
        stages=courses,
    )
    return Estimate(
        parameters=parameters,
        spread=uncertainty.spread,
        goodness=goodness,
        search=searches,
        status=_status(best, uncertainty, searches),
        message="; ".join(words for words in (best.message, *uncertainty.words) if words),
    )


def _refit_once(
    refits: dict[Minimum, FitWithinTolerances], fixed: FixedValues, names: tuple[str, ...], minimum: Minimum
) -> FitWithinTolerances:
    """Refit of `minimum` with fixed values free within their tolerances, cached in `refits`.

    Minima that are one answer to the same data share one refit. `names` are the names of the parameters in the order of the
    free variables of `minimum`.
    """
    if minimum not in refits:
        fitted = [(other, fit) for other, fit in refits.items() if fit.problem is fixed.problem]
        shared = next((fit for other, fit in fitted if are_same(other, minimum)), None)
        refits[minimum] = shared or fixed.refit(names, minimum.theta, float(minimum.costs[-1]))
    return refits[minimum]


def _status(best: Minimum, uncertainty: Uncertainty, searches: SearchRecord) -> Status:
    """Status of an estimate from its best minimum, its uncertainty and the number of answers that fit, in `searches`.

    Not converged if the search of `best` did not, `uncertainty.carried` is True for every parameter, and the fit misses
    the noise or all free parameters are identified. Else not identifiable if one of these is not identified or two
    answers or more fit, and converged otherwise. Parameters at a bound are not free.
    """
    spread = uncertainty.spread
    is_determined = bool((spread.identified | ~spread.is_free).all())
    if not best.converged and uncertainty.carried.all() and (uncertainty.misfit or is_determined):
        return Status.NOT_CONVERGED  # one that fits the noise, and leaves a parameter open, need not go on
    return Status.CONVERGED if is_determined and searches.n_fitting < 2 else Status.NOT_IDENTIFIABLE

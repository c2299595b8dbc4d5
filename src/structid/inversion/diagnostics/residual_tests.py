"""Tests that a residual is noise (size, whiteness, signs, distribution), and that repeated quantities agree on the parameters.

P-values of many tests are corrected for their number.

References
----------
Holm (1979), Scand. J. Statist. 6, 65; Benjamini and Hochberg (1995), J. R. Statist. Soc. B 57, 289.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.core.errors import InputError
from structid.inversion.covariance import repeated_quantities, row_law
from structid.inversion.linearization import Linearization
from structid.inversion.problem import Problem, few_averages, normal_values

Correction = Literal["holm", "benjamini_hochberg"]


def require_levels(level: float, power: float, correction: str) -> None:
    """Raise `InputError` unless 0 < level < 0.5, 0.5 <= power < 1 and `correction` is a known one.

    Known are "holm" and "benjamini_hochberg".
    """
    if not 0 < level < 0.5:
        raise InputError(f"`level` must lie between 0 and 0.5, got {level:g}; 0.05 is usual")
    if not 0.5 <= power < 1:
        raise InputError(f"`power` must be at least 0.5 and below 1, got {power:g}; 0.9 is usual")
    if correction not in ("holm", "benjamini_hochberg"):
        raise InputError(f"`correction` must be 'holm' or 'benjamini_hochberg', got {correction!r}; use one of them")


def adjusted_p_values(p_values: FloatArray, correction: Correction = "holm") -> FloatArray:
    """p-values (n,) corrected for the number of tests by Holm or Benjamini-Hochberg; NaN entries stay NaN.

    With p_(1) <= ... <= p_(n): Holm max over j <= i of (n - j + 1) p_(j), Benjamini-Hochberg min over j >= i of
    n p_(j) / j, at most 1.

    Examples
    --------
    >>> adjusted_p_values(np.array([0.01, 0.04, 0.03])).tolist()
    [0.03, 0.06, 0.06]
    """
    tested = np.flatnonzero(np.isfinite(p_values))
    n = len(tested)
    order = tested[np.argsort(p_values[tested], kind="stable")]
    ranked = p_values[order]
    if correction == "holm":
        made = np.maximum.accumulate((n - np.arange(n)) * ranked)
    else:
        made = np.minimum.accumulate((n / np.arange(1, n + 1) * ranked)[::-1])[::-1]
    adjusted = np.full(len(p_values), np.nan)
    adjusted[order] = np.minimum(made, 1.0)
    return adjusted


def detectable(n_tests: int, level: float, power: float) -> float:
    """Smallest single change, in standard deviations, that is declared with probability `power` among `n_tests` tests.

    It is z(1 - level / (2 n_tests)) + z(power), since both corrections declare the smallest p-value where it is at most
    level / n_tests; a declaration in the wrong direction is left out. NaN if `n_tests` is 0.
    """
    if n_tests == 0:
        return float("nan")
    return float(special.ndtri(1 - level / (2 * n_tests)) + special.ndtri(power))


_DOUBT = 1e-3
_FEWEST_ROWS = 20
_FEWEST_FOR_SHAPE = 50
_MOST_NAMED = 6
_NULL = 1e-10


@dataclass(frozen=True)
class SeriesTest:
    """One channel's whitened residual along its axis.

    Attributes
    ----------
    name : str
    n_rows : int
    lag_1 : float
        First autocorrelation.
    whiteness_distance : float
        Largest distance of the cumulative periodogram, 0 to 1, from the straight line that it is on average for
        white noise.
    whiteness_probability : float
        Of a larger distance for white noise, for this channel alone.
    runs, runs_expected : int and float
        Stretches of one sign, and how many there are on average for independent signs.
    runs_probability : float
        Of a number of runs as far from that or farther, either way.
    """

    name: str
    n_rows: int
    lag_1: float
    whiteness_distance: float
    whiteness_probability: float
    runs: int
    runs_expected: float
    runs_probability: float


def _doubted(series: Sequence[SeriesTest], p_values: Sequence[float]) -> tuple[str, ...]:
    """Names of the channels whose p-value is below 0.001 after Holm's correction for their number, without repetition.

    `p_values` are in the order of `series`; NaN never counts.
    """
    adjusted = adjusted_p_values(np.array(p_values))
    return tuple(dict.fromkeys(test.name for test, p in zip(series, adjusted, strict=True) if p < _DOUBT))


@dataclass(frozen=True)
class ResidualTests:
    """Tests of a whole residual; a small probability speaks against model or noise level, never for them.

    Attributes
    ----------
    series : tuple of SeriesTest
        One a channel (real and imaginary parts apart), in the order of `DataRows.series`.
    chi_square_per_dof : float
    chi_square_probability : float
        Of a larger chi-square, if model and noise level were right. Where few averages tell the noise, by the law of
        these or of a noise that is known, whichever doubts it less.
    whiteness_probability : float
        The smallest of the channels', Holm-adjusted for their number.
    runs_probability : float
        Likewise for the runs.
    normality_probability : float
        Jarque-Bera, all channels together; NaN below 50 rows. Where few averages tell the noise, of the values or of the
        normal ones that their law makes of them, whichever doubts it less.
    """

    series: tuple[SeriesTest, ...]
    chi_square_per_dof: float
    chi_square_probability: float
    whiteness_probability: float
    runs_probability: float
    normality_probability: float

    @property
    def not_white(self) -> tuple[str, ...]:
        """Names of the channels whose residual is correlated along its axis, at 0.001 for all of them together."""
        return _doubted(self.series, [test.whiteness_probability for test in self.series])

    @property
    def one_sided(self) -> tuple[str, ...]:
        """Names of the channels whose residual has too few or too many sign changes, at 0.001 for all channels together."""
        return _doubted(self.series, [test.runs_probability for test in self.series])

    @property
    def words(self) -> tuple[str, ...]:
        """Sentences on what the residual tests object to in the fit, at a probability below 0.001; empty if nothing.

        Objections are a size beyond noise either way, channels that are not white, signs in long runs, and a residual
        that is not normal.
        """
        said = []
        if self.chi_square_probability < _DOUBT:
            said.append(
                f"the residual is larger than the noise allows (chi-square per degree of freedom"
                f" {self.chi_square_per_dof:.3g}, {_told(self.chi_square_probability)}): model error, or noise taken"
                " too small"
            )
        elif 1 - self.chi_square_probability < _DOUBT:
            said.append(
                f"the residual is smaller than the noise allows (chi-square per degree of freedom"
                f" {self.chi_square_per_dof:.3g}): noise taken too large, and so are the standard deviations"
            )
        n_names = len({test.name for test in self.series})
        if self.not_white:
            said.append(
                f"residual of {_listed(self.not_white, n_names)} has an order that noise has not"
                f" ({_told(self.whiteness_probability)}): model error there"
            )
        if self.one_sided:
            said.append(
                f"signs of the residual of {_listed(self.one_sided, n_names)} do not alternate as those of noise do"
                f" (runs test, {_told(self.runs_probability)})"
            )
        if self.normality_probability < _DOUBT:
            said.append(
                f"the residual is not normal (Jarque-Bera, {_told(self.normality_probability)}): outliers, or lines"
                " whose noise is taken wrongly against the others"
            )
        return tuple(said)

    def named(self, names: Sequence[str]) -> ResidualTests:
        """A copy with `names` as the names of the channels, in the order of `series`; both must be of equal length."""
        series = [replace(test, name=name) for test, name in zip(self.series, names, strict=True)]
        return replace(self, series=tuple(series))


def residual_tests(
    problem: Problem, residual: FloatArray, degrees_of_freedom: float, fixed_squares: float = 0.0
) -> ResidualTests:
    """Tests of the whitened `residual` at the minimum for white, normal noise, by channel.

    Parameters
    ----------
    problem : Problem
        Says which row belongs to which channel and line.
    residual : (n_residuals,) float array
        Data rows first; rows of priors are not tested.
    degrees_of_freedom : float
        Degrees of freedom of chi-square; without any the tests of its size and of normality are NaN.
    fixed_squares : float
        Sum of squares of the fixed values, in tolerances, if they are free in the fit; it is added to chi-square, since
        each of them takes a degree of freedom and brings one.

    Returns
    -------
    ResidualTests
        With one test for each channel, named ``series 0`` and so on in the order of `problem.rows.series`.

    Notes
    -----
    Lines that were left out are passed over: neighbours are neighbours in the list of lines used. A fit takes a little
    of the noise with it, so that its residual is slightly less than white; with many rows a parameter this is not seen.

    References
    ----------
    Bartlett (1955), An Introduction to Stochastic Processes, section 9.2; Durbin (1969), Biometrika 56; Wald and
    Wolfowitz (1940), Ann. Math. Stat. 11; Jarque and Bera (1987), Int. Stat. Rev. 55; Holm (1979), Scand. J. Stat. 6.
    """
    data = residual[: problem.n_data]
    chi_square = float(data @ data) + fixed_squares
    freedom = degrees_of_freedom
    tests = []
    for number in np.unique(problem.rows.series):
        rows = np.flatnonzero(problem.rows.series == number)
        tests.append(_series_test(f"series {number}", data[rows[np.argsort(problem.rows.lines[rows], kind="stable")]]))
    return ResidualTests(
        series=tuple(tests),
        chi_square_per_dof=chi_square / freedom if freedom > 0 else float("nan"),
        chi_square_probability=misfit_probability(problem, chi_square, freedom) if freedom > 0 else float("nan"),
        whiteness_probability=_smallest(tests, lambda test: test.whiteness_probability),
        runs_probability=_smallest(tests, lambda test: test.runs_probability),
        normality_probability=_normality(data, few_averages(problem.rows.averages)) if freedom > 0 else float("nan"),
    )


def has_order(problem: Problem, residual: FloatArray, degrees_of_freedom: float) -> bool:
    """True where the whiteness or the runs test rejects a channel of the residual, at 0.001 for all channels together.

    `residual` is whitened, data rows first.
    """
    tests = residual_tests(problem, residual, degrees_of_freedom)
    return bool(tests.not_white or tests.one_sided)


def misfit_probability(problem: Problem, chi_square: float, freedom: float) -> float:
    """Probability of a larger chi-square of the data, if model and noise level were right.

    `chi_square` has `freedom` degrees of freedom. If few averages determine the noise, it is the median of 0.5 and the
    probabilities for known noise and by `row_law`, so that the law with the less extreme result decides.
    """
    scale, share = row_law(problem.rows.averages)
    known, few = (special.gammaincc(freedom * f / 2, chi_square / s / 2) for s, f in ((1.0, 1.0), (scale, share)))
    return float(sorted((known, 0.5, few))[1]) if share < 1 else float(known)


def _series_test(name: str, values: FloatArray) -> SeriesTest:
    """Tests of one residual series (n,) in order of lines: lag-1 correlation, periodogram and runs.

    Results are NaN (and 0 runs) if it has fewer than 20 values or is constant. `name` is that of the series in the
    result.
    """
    n, nan = len(values), float("nan")
    if n < _FEWEST_ROWS or np.ptp(values) == 0:
        return SeriesTest(name, n, nan, nan, nan, 0, nan, nan)
    lag_1 = float(values[1:] @ values[:-1] / (values @ values))
    distance, whiteness = periodogram_test(values)
    runs, expected, by_runs = runs_test(values)
    return SeriesTest(name, n, lag_1, distance, whiteness, runs, expected, by_runs)


def periodogram_test(values: FloatArray) -> tuple[float, float]:
    """Kolmogorov distance of the cumulative periodogram from that of white noise, 0 to 1, and its p-value.

    `values` (n,) are evenly ordered. For normal white noise the ordinates without frequency 0 and the Nyquist frequency are
    independent exponentials, so their cumulative sums over the total are ordered uniform numbers. The p-value has the
    correction of Stephens (1970) for their number.
    """
    ordinates = np.abs(np.fft.rfft(values)[1 : (len(values) + 1) // 2]) ** 2
    steps = np.cumsum(ordinates)[:-1] / ordinates.sum()
    m = len(steps)
    above = (np.arange(1, m + 1) / m - steps).max()
    below = (steps - np.arange(m) / m).max()
    distance = float(max(above, below))
    return distance, float(special.kolmogorov((np.sqrt(m) + 0.12 + 0.11 / np.sqrt(m)) * distance))


def runs_test(values: FloatArray) -> tuple[int, float, float]:
    """Number of runs of equal sign in `values` (n,), its expectation for independent signs, and the two-sided p-value.

    With n1 positive and n2 negative values the mean is 2 n1 n2 / n + 1 and the variance (mean - 1)(mean - 2) / (n - 1),
    with a continuity correction of half a run. If all n signs are equal, the expectation is 1 + n / 2 and the p-value
    2^(1 - n), those of fair signs. Zeros are dropped; the p-value is NaN if nothing is left or the variance is 0.
    """
    signs = values[values != 0] > 0
    n, n_positive = len(signs), int(signs.sum())
    runs = 1 + int(np.count_nonzero(signs[1:] != signs[:-1])) if n else 0
    if n_positive in (0, n):
        return runs, 1.0 + n / 2, float(2.0 ** (1 - n)) if n else float("nan")
    mean = 2 * n_positive * (n - n_positive) / n + 1
    variance = (mean - 1) * (mean - 2) / (n - 1)
    if variance <= 0:
        return runs, mean, float("nan")
    distance = max(abs(runs - mean) - 0.5, 0.0) / np.sqrt(variance)
    return runs, mean, float(2 * special.ndtr(-distance))


def _smallest(tests: Sequence[SeriesTest], probability: Callable[[SeriesTest], float]) -> float:
    """Smallest p-value of the series after Holm's correction for their number; NaN if all are NaN.

    `probability` takes the p-value out of a `SeriesTest`.
    """
    adjusted = adjusted_p_values(np.array([probability(test) for test in tests]))
    known = adjusted[np.isfinite(adjusted)]
    return float(known.min()) if known.size else float("nan")


def _normality(values: FloatArray, averages: FloatArray | None) -> float:
    """p-value of the Jarque-Bera test of residual `values`; the larger of two if few averages tell the noise.

    `averages` (n_data,) or None: if given, `normal_values` of the residual are tested as well.
    """
    normal = _jarque_bera(values)
    return normal if averages is None else max(normal, _jarque_bera(normal_values(values, averages)))


def _jarque_bera(values: FloatArray) -> float:
    """p-value of the Jarque-Bera test for normality of `values` (n,); NaN below 50 values or if they are constant."""
    if len(values) < _FEWEST_FOR_SHAPE or np.ptp(values) == 0:
        return float("nan")
    z = (values - values.mean()) / values.std()
    statistic = len(values) / 6 * (float((z**3).mean()) ** 2 + (float((z**4).mean()) - 3) ** 2 / 4)
    return float(np.exp(-statistic / 2))


def _told(probability: float) -> str:
    return f"p = {probability:.1g}" if probability > 0 else "p below 1e-300"


def _listed(names: Sequence[str], n_all: int) -> str:
    shown = join_words(names, _MOST_NAMED)
    return shown if n_all == len(names) == 1 else f"{shown} ({len(names)} of {n_all} channels)"


def misses_noise(
    problem: Problem, residual: FloatArray, scale: float, freedom: float, probability: float, more: float = 0.0
) -> bool:
    """True if noise alone would exceed the chi-square of `residual` with less than `probability`.

    Chi-square is the sum of squares of the data rows plus `more`. Noise alone gives `scale` times chi-square of
    `freedom` degrees of freedom; without any, the number of data rows takes their place. Where few averages determine
    the noise, the test for known noise is made too, and a misfit by it alone counts only if the residual of a channel
    is correlated (`has_order`).
    """
    data, (_, share) = residual[: problem.n_data], row_law(problem.rows.averages)
    chi_square, of_known = float(data @ data) + more, freedom / share
    if freedom <= 0:
        return is_misfit(chi_square / scale, max(len(data), 1), probability)
    if is_misfit(chi_square / scale, freedom, probability):
        return True
    return share < 1 and is_misfit(chi_square, of_known, probability) and has_order(problem, residual, of_known)


def is_misfit(chi_square: float, freedom: float, probability: float) -> bool:
    """True where a chi-square variable of `freedom` degrees of freedom exceeds `chi_square` with less than `probability`."""
    return bool(special.gammaincc(freedom / 2, chi_square / 2) < probability)


@dataclass(frozen=True)
class Agreement:
    """The test that each quantity alone, in all records, gives the same parameters.

    Attributes
    ----------
    ratio : float
        Mean square of what parameters of each quantity's own would take from the residual, over that of what they would leave.
    between, within : float
        Degrees of freedom of the two.
    probability : float
        Of a larger ratio where model and data are right, whatever the size of the noise.
    """

    ratio: float
    between: float
    within: float
    probability: float

    @property
    def words(self) -> str:
        """Meaning of a small probability, in a sentence."""
        return (
            f"each mode, common to all records, gives other values than the other modes do (F = {self.ratio:.2g},"
            f" {self.between:.0f} and {self.within:.0f} degrees of freedom, p = {self.probability:.1g}): model error that is"
            " common to all records"
        )


def agreement(problem: Problem, linearization: Linearization) -> Agreement | None:
    """F test that quantities measured in several records agree on the parameters; None if it cannot be made.

    With S the sum of squares of a common fit to all quantities and S_q that of a separate fit to quantity q, to first
    order and without priors, (S - sum S_q) / between over (sum S_q) / within follows Fisher's distribution for
    independent errors. The common size of the errors may be unknown. None with fewer than four quantities, with one
    that is measured at a single line, or without a degree of freedom for either sum. `linearization` is that of
    `problem` at the minimum of all of its data.

    References
    ----------
    Chow (1960), Econometrica 28, 591-605, section 3; Fisher (1970), Econometrica 38, 361-366.
    """
    block = repeated_quantities(problem)
    if block is None:
        return None
    residual, jacobian = linearization.residual[: problem.n_data], linearization.jacobian[: problem.n_data]
    rows = [block == number for number in range(int(block.max()) + 1)]
    is_repeated = block >= 0
    whole, rank = _residual_squares_and_rank(jacobian[is_repeated], residual[is_repeated])
    separate = [_residual_squares_and_rank(jacobian[q], residual[q]) for q in rows]
    least = sum(square for square, _ in separate)
    ranks = sum(count for _, count in separate)
    between, within = ranks - rank, int(is_repeated.sum()) - ranks - linearization.n_eliminated
    if between <= 0 or within <= 0 or least <= 0:
        return None
    ratio = (whole - least) / between / (least / within)
    return Agreement(ratio, between, within, float(special.fdtrc(between, within, max(ratio, 0.0))))


def _residual_squares_and_rank(jacobian: FloatArray, residual: FloatArray) -> tuple[float, int]:
    """Residual sum of squares of a least-squares fit to `residual` (n_rows,), and the rank of `jacobian`.

    `jacobian` (n_rows, n_params) is scaled to unit columns; its rank counts singular values above 1e-10 of the largest.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    vectors, singular, _ = np.linalg.svd(jacobian / np.where(scale > 0, scale, 1.0), full_matrices=False)
    used = vectors[:, singular > _NULL * singular.max(initial=0.0)]
    left = residual - used @ (used.T @ residual)
    return float(left @ left), used.shape[1]

"""Profile likelihood: against Laplace where it is exact, against brute force where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import Case, correlated, decay_case, line_case, rise, rise_slope

from structid import estimate
from structid.core.arrays import locked
from structid.core.errors import InputError
from structid.inversion.intervals.profile import profile, profiles

QUANTILE_95 = 3.841458821


def test_profile_of_a_linear_problem_is_its_laplace_interval():
    case = line_case(np.random.default_rng(0).standard_normal(100))
    found = estimate(case)
    for j, item in enumerate(profiles(case, found)):
        assert (item.lower, item.upper) == pytest.approx(found.interval()[j], rel=1e-3)
        expected = ((item.values - found.values[j]) / found.std_noise[j]) ** 2
        assert item.deviance == pytest.approx(expected, rel=1e-6, abs=1e-9)
        assert item.nonlinearity < 3e-3
        assert "quadratic" in item.words


def brute_force_ends(case, j, found):
    """Ends of the likelihood-ratio interval by minimizing over the other parameter on a fine grid."""
    from scipy.optimize import brentq, minimize_scalar

    least = found.goodness.chi_square

    def deviance(value):
        def cost(other):
            theta = np.insert(np.array([other]), j, np.log(value))
            residual = case.residual(theta)
            return residual @ residual

        centre = found.theta[1 - j]
        return (
            minimize_scalar(cost, bounds=(centre - 2, centre + 2), method="bounded", options={"xatol": 1e-10}).fun
            - least
        )

    best = found.values[j]
    return [brentq(lambda v: deviance(v) - QUANTILE_95, *sorted((best, best * far))) for far in (0.3, 3.0)]


@pytest.mark.parametrize("j", [0, 1])
def test_profile_of_a_nonlinear_problem_is_that_of_brute_force(j):
    """Ends are found to 0.2 % of their distance in the root of the deviance, here 1e-3 of the value."""
    case = decay_case(1)
    found = estimate(case)
    item = profile(case, found, "ab"[j])
    assert (item.lower, item.upper) == pytest.approx(brute_force_ends(case, j, found), rel=1e-3)


def test_interval_does_not_depend_on_the_free_variable():
    """The Laplace interval does: its lower end differs by more than 5 %."""
    log, linear = decay_case(2), decay_case(2, transform=("linear", "linear"))
    first, second = estimate(log), estimate(linear)
    one, two = profile(log, first, "b"), profile(linear, second, "b")
    assert (one.lower, one.upper) == pytest.approx((two.lower, two.upper), rel=2e-3)
    assert abs(first.interval()[1, 0] / second.interval()[1, 0] - 1) > 0.05
    assert two.nonlinearity > 0.1
    assert "nonlinear" in two.words


def fast_rise(seed):
    """A rise that is over before the second sample: its rate has a lower limit only."""
    x = np.linspace(0.5, 5, 10)
    y = rise(x, (1.0, 20.0)) + 0.05 * np.random.default_rng(seed).standard_normal(10)
    return Case(rise, rise_slope, x, y, (1.0, 5.0), ("log", "log"), 0.05)


@pytest.mark.parametrize(("seed", "basis"), [(4, "noise"), (3, "model_error")])
def test_parameter_without_an_upper_limit_says_so(seed, basis):
    """Seed 3 happens to have a chi-square of 27 for 8 degrees of freedom: the limit is then lower, and still there."""
    case = fast_rise(seed)
    found = estimate(case)
    assert found.covariance_basis == basis
    item = profile(case, found, "b")
    assert item.is_open[1]
    assert not item.is_open[0]
    assert item.upper == np.inf
    assert 2.0 < item.lower < 8.0
    assert "no upper limit" in item.words
    assert item.nonlinearity == np.inf


def test_estimate_that_is_not_the_minimum_is_found_out():
    case = decay_case(4)
    found = estimate(case)
    moved = replace(found, parameters=replace(found.parameters, theta=locked(found.theta + np.array([0.0, 0.3]))))
    assert "found a better fit" in profile(case, moved, "b").words


def test_profile_carries_model_error_where_the_estimate_does():
    case = line_case(3 * correlated(5))
    found = estimate(case)
    assert found.covariance_basis == "model_error"
    item = profile(case, found, "a")
    assert item.scale == pytest.approx((found.spread.std_model_error[0] / found.std_noise[0]) ** 2)
    assert (item.lower, item.upper) == pytest.approx(found.interval()[0], rel=1e-3)


def test_one_parameter_alone_and_wrong_names():
    y = 2.0 + np.random.default_rng(6).standard_normal(20)
    case = Case(lambda x, p: np.full(20, p[0]), lambda x, p: np.ones((20, 1)), y, y, (1.0,), ("linear",))
    found = estimate(case)
    assert profile(case, found, 0).upper == pytest.approx(found.interval()[0, 1], rel=1e-3)
    with pytest.raises(InputError, match="`parameter` must be one of a, got 'z'"):
        profile(case, found, "z")
    with pytest.raises(InputError, match="from 0 to 0, got 1"):
        profile(case, found, 1)


def test_parameter_at_its_bound_has_a_profile_with_one_limit():
    """The data want 1.02 +- 0.02, the bound is 1: Laplace gives the whole range, the profile one limit, here by hand."""
    y = 1.02 + 0.1 * np.array([1.0, -1.0] * 12 + [0.0])
    case = Case(lambda x, p: np.full(25, p[0]), lambda x, p: np.ones((25, 1)), y, y, (0.5,), ((0.0, 1.0),), 0.1)
    found = estimate(case)
    low, high = found.interval()[0]
    assert np.isnan(low) or (low < 0.01 and high > 0.99)
    item = profile(case, found, 0)
    assert item.is_open[1]
    assert item.lower == pytest.approx(1.02 - np.sqrt(QUANTILE_95 * 0.02**2 + 0.02**2), abs=2e-4)

"""Tests of residuals: against textbook sums, every sequence of signs, and repeated noise."""

from itertools import combinations

import numpy as np
import pytest
from fit_cases import Case, correlated, line_case, straight, straight_slope
from scipy.special import ndtr

from structid import estimate
from structid.core.errors import InputError
from structid.inversion.diagnostics.residual_tests import adjusted_p_values, residual_tests, runs_test


def looked_at(values, series=None):
    case = Case(
        straight, straight_slope, np.arange(len(values), dtype=float), values, (1.0,), ("linear",), channel=series
    )
    return residual_tests(case, values, len(values))


def test_runs_have_mean_and_variance_of_all_sequences():
    """Every one of the 126 orders of four pluses and five minuses; two-sided probabilities near the exact ones."""
    counts = []
    for places in combinations(range(9), 4):
        signs = -np.ones(9)
        signs[list(places)] = 1.0
        counts.append(runs_test(signs))
    runs = np.array([c[0] for c in counts])
    assert runs.mean() == pytest.approx(counts[0][1], rel=1e-12)
    mean = counts[0][1]
    assert runs.var() == pytest.approx((mean - 1) * (mean - 2) / 8, rel=1e-12)
    few = next(c[2] for c in counts if c[0] == 3)
    exact = np.mean(np.abs(runs - mean) >= abs(3 - mean) - 1e-9)
    assert few == pytest.approx(exact, abs=0.02)
    assert few == pytest.approx(2 * ndtr(-(mean - 3 - 0.5) / runs.std()), rel=1e-12)


def test_whiteness_is_the_kolmogorov_test_of_the_cumulative_periodogram():
    """Against SciPy's exact probability: the correction of Stephens is right to 5 % of a small probability."""
    from scipy import stats

    values = np.random.default_rng(3).standard_normal(101)
    values[1:] += 0.6 * values[:-1].copy()
    power = [abs(sum(v * np.exp(-2j * np.pi * j * k / 101) for k, v in enumerate(values))) ** 2 for j in range(1, 51)]
    steps = np.cumsum(power)[:-1] / np.sum(power)
    exact = stats.kstest(steps, "uniform")
    [test] = looked_at(values).series
    assert test.whiteness_distance == pytest.approx(exact.statistic, rel=1e-9)
    assert test.whiteness_probability == pytest.approx(exact.pvalue, rel=0.05)
    assert exact.pvalue < 0.05


def test_jarque_bera_is_that_of_scipy():
    from scipy import stats

    values = np.sinh(0.3 * np.random.default_rng(4).standard_normal(300)) + 0.1
    expected = float(stats.jarque_bera(values).pvalue)
    assert 1e-6 < expected < 0.5  # two zeros would be equal whatever they are made of
    assert looked_at(values).normality_probability == pytest.approx(expected, rel=1e-9)


def test_holm_adjusts_as_worked_by_hand():
    assert adjusted_p_values(np.array([0.01, np.nan, 0.04, 0.03, 0.005])) == pytest.approx(
        [0.03, np.nan, 0.06, 0.06, 0.02], nan_ok=True
    )


def test_noise_is_rejected_as_seldom_as_the_level_says():
    """600 repeats of four channels of 150 rows, seeds 0 to 599: each test at 5 % rejects 5 % -/+ 2.7 % (three deviations)."""
    series = np.tile(np.arange(4), 150)
    found = [looked_at(np.random.default_rng(seed).standard_normal(600), series) for seed in range(600)]
    for name in ("chi_square_probability", "whiteness_probability", "runs_probability", "normality_probability"):
        rejected = np.mean([getattr(item, name) < 0.05 for item in found])
        assert 0.023 <= rejected <= 0.077, name


def test_correlated_channel_is_named_and_the_white_one_is_not():
    rng = np.random.default_rng(5)
    values = np.stack([rng.standard_normal(500), correlated(6, 500)], axis=1).ravel()
    found = looked_at(values, np.tile([0, 1], 500)).named(["401X+", "402X+"])
    assert found.not_white == ("402X+",)
    assert found.one_sided == ("402X+",)
    [white] = [words for words in found.words if "an order that noise has not" in words]
    assert white.startswith("residual of 402X+ (1 of 2 channels) has an order that noise has not (p = ")


def test_two_series_share_the_name_of_their_channel():
    found = looked_at(np.random.default_rng(7).standard_normal(160), np.tile(np.arange(4), 40)).named(
        ["p", "p", "q", "q"]
    )
    assert [test.name for test in found.series] == ["p", "p", "q", "q"]


@pytest.mark.parametrize(
    ("size", "words"), [(1.3, "larger than the noise allows"), (0.7, "smaller than the noise allows")]
)
def test_size_of_the_residual_is_told_both_ways(size, words):
    found = estimate(line_case(size * np.random.default_rng(8).standard_normal(400)))
    assert [w for w in found.goodness.residual_tests.words if words in w]
    assert estimate(line_case(np.random.default_rng(8).standard_normal(400))).goodness.residual_tests.words == ()


def test_heavy_tails_are_told():
    values = np.random.default_rng(9).standard_t(3, 2000)
    assert any("not normal" in words for words in looked_at(values / values.std()).words)


def test_interval_of_a_log_parameter_is_the_exponential_of_its_normal_one():
    x = np.arange(50.0)
    y = 3.0 + np.random.default_rng(1).standard_normal(50)
    case = Case(lambda x, p: np.full(50, p[0]), lambda x, p: np.ones((50, 1)), x, y, (1.0,), ("log",))
    found = estimate(case)
    relative = 1.959963985 * found.std / found.values
    assert found.interval()[0] == pytest.approx(found.values * np.exp([-relative[0], relative[0]]), rel=1e-9)
    assert found.interval(0.6826894921)[0, 1] == pytest.approx(found.values[0] * np.exp(relative[0] / 1.959963985))
    with pytest.raises(InputError, match="`level` must be between 0 and 1"):
        found.interval(95)


def test_interval_of_a_bounded_parameter_stays_between_its_bounds():
    """Half-way between bounds 0 and 1, where the logistic is a straight line, and near the upper one, where it is not."""
    for centre, low_end in ((0.5, 0.5 - 1.96 * 0.02), (0.95, 0.89)):
        y = centre + 0.1 * np.array([1.0, -1.0] * 12 + [0.0])
        case = Case(lambda x, p: np.full(25, p[0]), lambda x, p: np.ones((25, 1)), y, y, (0.5,), ((0.0, 1.0),), 0.1)
        low, high = estimate(case).interval()[0]
        assert low == pytest.approx(low_end, abs=0.001 if centre == 0.5 else 0.005)
        assert centre < high < 1.0

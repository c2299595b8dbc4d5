"""Bootstraps: against covariances known in closed form, with failures counted."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import Case, constant, constant_slope, correlated, decay_case, line_case

from structid import estimate
from structid.core.errors import InputError
from structid.inversion.covariance import error_blocks
from structid.inversion.intervals.bootstrap import Bootstrap, bootstrap, bootstrap_repeats


def mean_case(values):
    values = np.asarray(values)
    return Case(constant, constant_slope, values, values, (1.0,), ("linear",))


def test_noise_bootstrap_of_a_straight_line_has_the_textbook_covariance():
    """1000 replicates: a standard deviation is met within three of its own deviations, 3 / sqrt(2000) = 6.7 %."""
    case = line_case(np.random.default_rng(0).standard_normal(60))
    found = estimate(case)
    boot = bootstrap(case, found, "noise", 1000, np.random.default_rng(1))
    assert boot.std == pytest.approx(found.std_noise, rel=0.067)
    assert boot.bias == pytest.approx([0.0, 0.0], abs=4 * found.std_noise.max() / np.sqrt(1000))
    assert boot.interval() == pytest.approx(found.interval(), abs=0.3 * found.std_noise.max())
    assert boot.words == ()


def test_block_bootstrap_has_the_covariance_of_the_block_scores():
    """1000 replicates of a correlated error; the sum over blocks is written out."""
    case = line_case(2 * correlated(2, 600))
    found = estimate(case)
    at = case.linearize(found.theta)
    [block] = error_blocks(at.residual, case.rows.lines, case.rows.series)
    scores = np.array([at.jacobian[block == b].T @ at.residual[block == b] for b in range(block.max() + 1)])
    inverse = np.linalg.inv(at.jacobian.T @ at.jacobian)
    expected = np.sqrt(np.diag(inverse @ scores.T @ scores @ inverse))
    boot = bootstrap(case, found, n_replicates=1000, rng=np.random.default_rng(3))
    assert boot.kind == "blocks"
    assert boot.std == pytest.approx(expected, rel=0.067)
    assert (expected > 2 * found.std_noise).all()


def test_block_bootstrap_counts_stretches_and_channels():
    """An error common to five channels and an offset of each; neither sum is below a quarter of the other. 1000 replicates."""
    common, offsets = correlated(6, 100, 3), 0.08 * np.array([3.0, -2.0, 1.0, -4.0, 2.0])
    y = (np.random.default_rng(3).standard_normal((100, 5)) + common[:, None] + offsets).ravel()
    series = np.tile(2 * np.arange(5), 100)
    case = Case(constant, constant_slope, y, y, (1.0,), ("linear",), channel=series)
    found = estimate(case)
    blocks = error_blocks(case.residual(found.theta), case.rows.lines, case.rows.series)
    assert len(blocks) == 2
    sums = [np.bincount(block, case.residual(found.theta)) for block in blocks]
    variances = [(part**2).sum() for part in sums]
    assert min(variances) > 0.25 * max(variances)
    expected = np.sqrt(sum(variances)) / len(y)
    boot = bootstrap(case, found, "blocks", 1000, np.random.default_rng(5))
    assert boot.std[0] == pytest.approx(expected, rel=0.067)


@pytest.mark.parametrize(("freedom", "ends"), [(np.inf, (0.00131, 0.81889)), (11.0, (0.00058, 0.87539))])
def test_interval_is_corrected_for_bias_and_widened_for_few_repeats(freedom, ends):
    """Replicates uniform from 0 to 1, the original at 0.3: Phi(2 Phi^-1(0.3) -+ 1.960), or 2.201 for t with 11."""
    values = np.linspace(0, 1, 100001)[:, None]
    boot = Bootstrap(("a",), ("1",), "repeats", np.array([0.3]), values, 100001, (), np.array([freedom]))
    assert boot.interval()[0] == pytest.approx(ends, abs=2e-5)


def test_interval_is_the_same_in_any_free_variable():
    log, linear = decay_case(5, 0.05), decay_case(5, 0.05, transform=("linear", "linear"))
    one = bootstrap(log, estimate(log), "noise", 100, np.random.default_rng(4)).interval()
    two = bootstrap(linear, estimate(linear), "noise", 100, np.random.default_rng(4)).interval()
    assert one == pytest.approx(two, rel=1e-5)


def test_bootstrap_of_repeats_has_the_variance_of_a_mean():
    """The average over 300 sets of five repeats of the bootstrap variance of their mean: 1/5 within 10 %."""
    base = estimate(mean_case([1.0, 2.0]))
    variances = []

    def mean(chosen):
        return replace(base, parameters=replace(base.parameters, values=np.array([np.mean(chosen)])))

    for seed in range(300):
        repeats = np.random.default_rng(seed).standard_normal(5)
        boot = bootstrap_repeats(repeats, mean, 60, np.random.default_rng(seed))
        variances.append(boot.covariance[0, 0])
    assert np.mean(variances) == pytest.approx(0.2, rel=0.1)


def test_failures_are_counted_and_many_of_them_refuse_the_interval():
    repeats = np.random.default_rng(8).standard_normal(12)

    def refit(limit):
        def fitted(chosen):
            if np.max(chosen) > limit:
                raise InputError("a repeat is out of range")
            return estimate(mean_case(chosen))

        return fitted

    whole = bootstrap_repeats(repeats, refit(np.inf), 100)
    assert (whole.failures, len(whole.values)) == ((), 100)
    most = np.sort(repeats)[-1]

    def sometimes(chosen):
        return refit(np.inf if len(chosen) == 12 else most - 1e-9)(chosen)

    part = bootstrap_repeats(repeats, sometimes, 100)
    assert len(part.values) + len(part.failures) == 100
    assert len(part.failures) > 40
    assert "a repeat is out of range" in part.words[0]
    assert np.isnan(part.interval()).all()
    assert np.isnan(part.std).all()
    assert "no bootstrap interval" in part.words[1]


def test_search_that_does_not_converge_is_a_failure():
    case = decay_case(9)
    found = estimate(case)
    far = replace(found, parameters=replace(found.parameters, theta=found.theta + np.array([0.0, 40.0])))
    boot = bootstrap(case, far, "noise", 5, np.random.default_rng(0))
    assert len(boot.values) + len(boot.failures) == 5


def test_wrong_requests_are_told():
    case = line_case(np.random.default_rng(0).standard_normal(20))
    found = estimate(case)
    with pytest.raises(InputError, match="`n_replicates` must be at least 1, got 0"):
        bootstrap(case, found, n_replicates=0)
    with pytest.raises(InputError, match="`kind` must be 'noise' or 'blocks', got 'repeats'"):
        bootstrap(case, found, "repeats")
    with pytest.raises(InputError, match="three records at least, got 2"):
        bootstrap_repeats([1, 2], lambda chosen: found)

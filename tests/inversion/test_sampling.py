"""Posterior samples: against posteriors in closed form; diagnostics against ArviZ and a process of known time."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import Case, constant, constant_slope, correlated, decay_case, line_case

from structid import estimate
from structid.core.arrays import locked
from structid.core.errors import InputError
from structid.inversion import DenseCovariance
from structid.inversion.intervals import to_arviz
from structid.inversion.intervals.bootstrap import bootstrap
from structid.inversion.intervals.profile import profile
from structid.inversion.intervals.sampling import (
    Samples,
    _Target,
    _whitening,
    bulk_sample_size,
    sample,
    split_r_hat,
    tail_sample_size,
)


def autoregressive(rho, n_chains=4, n_draws=2000, seed=0):
    rng = np.random.default_rng(seed)
    draws = np.zeros((n_chains, n_draws))
    draws[:, 0] = rng.standard_normal(n_chains)
    for i in range(1, n_draws):
        draws[:, i] = rho * draws[:, i - 1] + np.sqrt(1 - rho**2) * rng.standard_normal(n_chains)
    return draws


@pytest.mark.parametrize("rho", [0.0, 0.7, -0.4])
def test_sample_size_of_a_first_order_process_is_the_known_one(rho):
    """n (1 - rho) / (1 + rho), to 15 %: three to four deviations of the estimate."""
    draws = autoregressive(rho)
    assert bulk_sample_size(draws) == pytest.approx(8000 * (1 - rho) / (1 + rho), rel=0.15)
    assert split_r_hat(draws) < 1.01


def test_chains_that_differ_in_place_or_width_or_drift_are_told():
    draws = autoregressive(0.3)
    moved, wider, drifting = draws.copy(), draws.copy(), draws + np.linspace(-1, 1, 2000)
    moved[0] += 1.0
    wider[0] *= 3.0
    assert min(split_r_hat(moved), split_r_hat(wider), split_r_hat(drifting)) > 1.02


@pytest.mark.filterwarnings("ignore:\nArviZ is undergoing:FutureWarning")
def test_diagnostics_and_export_are_those_of_arviz():
    arviz = pytest.importorskip("arviz", reason="needs the extra `sampling`")
    draws = autoregressive(0.6, n_draws=501, seed=3) ** 3
    assert split_r_hat(draws) == pytest.approx(float(arviz.rhat(draws)), rel=1e-9)
    assert bulk_sample_size(draws) == pytest.approx(float(arviz.ess(draws)), rel=1e-9)
    assert tail_sample_size(draws) == pytest.approx(float(arviz.ess(draws, method="tail")), rel=0.02)
    exported = to_arviz(samples_of(draws[:, :, None]))
    assert exported.posterior["a"].shape == (4, 501)
    assert np.array_equal(exported.posterior["a"].values, draws)


@pytest.mark.filterwarnings("ignore:\nArviZ is undergoing:FutureWarning")
@pytest.mark.parametrize("kind", ["laplace", "profile", "bootstrap"])
def test_exported_draws_of_every_kind_have_the_quantiles_of_its_interval(kind):
    pytest.importorskip("arviz", reason="needs the extra `sampling`")
    case = decay_case(1, transform=("log", "log"))
    found = estimate(case)
    if kind == "bootstrap":
        source = bootstrap(case, found, "noise", 400)
        ends = np.quantile(source.values[:, 0], [0.025, 0.975])
    else:
        source = found if kind == "laplace" else profile(case, found, 0)
        ends = found.interval()[0] if kind == "laplace" else np.array([source.lower, source.upper])
    exported = to_arviz(source, n_draws=40000).posterior[found.names[0]].values.ravel()
    assert np.quantile(exported, [0.025, 0.975]) == pytest.approx(ends, abs=0.02 * (ends[1] - ends[0]))


def samples_of(values):
    columns = [values[:, :, j] for j in range(values.shape[2])]
    diagnostics = [locked([f(c) for c in columns]) for f in (split_r_hat, bulk_sample_size, tail_sample_size)]
    names = tuple("abc"[: values.shape[2]])
    return Samples(names, names, locked(values), False, *diagnostics, 0, 0)


def test_gradient_of_the_log_posterior_is_its_difference_quotient():
    case = decay_case(1, transform=("log", (0.0, 3.0)))
    found = estimate(case)
    x, step = np.array([0.7, -1.1]), 1e-5
    for flat_in in ("physical", "free"):
        density = _Target(case, np.array(found.theta), _whitening(found), flat_in)
        for j in range(2):
            e = step * np.eye(2)[j]
            quotient = (density(x + e)[0] - density(x - e)[0]) / (2 * step)
            assert density(x)[1][j] == pytest.approx(quotient, rel=1e-6)


def test_samples_of_a_straight_line_have_its_textbook_covariance():
    """About 2000 effective draws: deviations of 2.3 % of the standard deviation; tolerances are three to four of them."""
    case = line_case(np.random.default_rng(0).standard_normal(60))
    found = estimate(case)
    drawn = sample(case, found, 500, rng=np.random.default_rng(1))
    assert drawn.samples.shape == (4, 500, 2)
    assert drawn.is_reliable, drawn.words
    flat = drawn.samples.reshape(-1, 2)
    assert flat.mean(axis=0) == pytest.approx(found.values, abs=0.1 * found.std_noise.max())
    assert np.sqrt(np.diag(drawn.covariance)) == pytest.approx(found.std_noise, rel=0.08)
    assert drawn.interval() == pytest.approx(found.interval(), abs=0.25 * found.std_noise.max())


def positive_mean(seed=0):
    """One positive mean, 0.8 standard deviations from 0."""
    y = np.random.default_rng(seed).standard_normal(25)
    y += 0.8 / 5 - y.mean()
    return Case(constant, constant_slope, y, y, (0.3,), ("log",))


def test_positive_parameter_has_the_truncated_normal_posterior():
    """Flat for p > 0: normal of mean 0.16 and deviation 0.2, cut off at 0. Quantiles to 0.02, a tenth of the deviation."""
    from scipy import stats

    case = positive_mean()
    drawn = sample(case, estimate(case), 1000, rng=np.random.default_rng(2))
    assert drawn.is_reliable, drawn.words
    exact = stats.truncnorm(-0.8, np.inf, 0.16, 0.2)
    parts = [0.05, 0.25, 0.5, 0.75, 0.975]
    assert np.quantile(drawn.samples, parts) == pytest.approx(exact.ppf(parts), abs=0.02)


def test_posterior_that_has_no_limit_is_refused():
    """Flat in the logarithm, where 0 is allowed: the chains run off to minus infinity."""
    case = positive_mean()
    drawn = sample(case, estimate(case), 30, n_warmup=20, flat_in="free", rng=np.random.default_rng(3))
    assert not drawn.is_reliable
    assert any("chains disagree" in words for words in drawn.words)
    assert np.isnan(drawn.interval()).all()
    assert np.isnan(drawn.covariance).all()


def test_samples_carry_model_error_where_the_estimate_does():
    case = line_case(2 * correlated(4, 400))
    found = estimate(case)
    drawn = sample(case, found, 500, rng=np.random.default_rng(5))
    assert drawn.stretched
    assert np.sqrt(np.diag(drawn.covariance)) == pytest.approx(found.spread.std_model_error, rel=0.08)
    kept = np.corrcoef(drawn.samples.reshape(-1, 2), rowvar=False)[0, 1]
    assert kept == pytest.approx(found.spread.correlation[0, 1], abs=0.08)


def test_emcee_draws_from_the_same_posterior():
    pytest.importorskip("emcee", reason="needs the extra `sampling`")
    case = decay_case(6, 0.05)
    found = estimate(case)
    gradients = sample(case, found, 500, rng=np.random.default_rng(7))
    ensemble = sample(case, found, 250, sampler="emcee", n_chains=12, rng=np.random.default_rng(8))
    assert ensemble.samples.shape == (12, 250, 2)
    parts = [0.05, 0.5, 0.95]
    for j in range(2):
        one, two = (np.quantile(d.samples[:, :, j], parts) for d in (gradients, ensemble))
        assert one == pytest.approx(two, abs=0.3 * found.std[j])


def test_what_cannot_be_sampled_is_told():
    case = line_case(np.random.default_rng(0).standard_normal(20))
    found = estimate(case)
    lost = replace(found, spread=replace(found.spread, noise=DenseCovariance(np.full((2, 2), np.nan))))
    with pytest.raises(InputError, match="finite covariance, got none for a, b"):
        sample(case, lost)
    with pytest.raises(InputError, match="`sampler` must be 'nuts' or 'emcee'"):
        sample(case, found, sampler="gibbs")
    with pytest.raises(InputError, match="`flat_in` must be"):
        sample(case, found, flat_in="log")


def test_few_or_broken_draws_are_told():
    few = samples_of(autoregressive(0.0, n_draws=40)[:, :, None])
    assert any("too few independent draws" in words for words in few.words)
    broken = replace(samples_of(autoregressive(0.0)[:, :, None]), n_divergent=100)
    assert any("broke down" in words for words in broken.words)


def test_a_tail_that_does_not_vary_has_no_effective_draws_whichever_it_is():
    """The 95 % quantile of draws of which a tenth equal the largest has no draw above it."""
    draws = autoregressive(0.3)
    heaped = np.minimum(draws, np.quantile(draws, 0.9))
    assert np.isnan(tail_sample_size(heaped))
    assert np.isfinite([tail_sample_size(draws), tail_sample_size(-heaped)]).all()

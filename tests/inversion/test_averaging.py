"""Noise that few averages tell: the law of what it leaves, and intervals that hold over repeats of the averages themselves."""

import numpy as np
import pytest
from scipy import stats

import structid as sid
from structid import JointProblem, MatrixFree, estimate
from structid.identification.warning_words import estimate_warnings
from structid.inversion.covariance import row_law
from structid.inversion.estimate import expected_per_row
from structid.inversion.intervals.bootstrap import bootstrap
from structid.inversion.intervals.profile import profile
from structid.inversion.intervals.sampling import sample
from structid.inversion.problem import expected_square, normal_values, score_factor, square_variance
from structid.records import with_coherence_noise

FREE = ("k1", "k2", "m1", "c1")


def chain():
    """Three masses on springs, with the true values of what is free."""
    parts = [sid.PointMass(f"m{i}", [i], m) for i, m in ((1, 1.2), (2, 1.4), (3, 1.6))]
    ends = [("1X", None), ("2X", "1X"), ("3X", "2X")]
    parts += [sid.Spring(f"k{i}", a, second=b, stiffness=1000.0 + 100 * i) for i, (a, b) in enumerate(ends, 1)]
    parts += [sid.Dashpot("c1", "1X", viscous_damping=4.0), sid.Dashpot("c3", "3X", second="2X", viscous_damping=2.0)]
    structure = sid.Structure({i: float(i) for i in (1, 2, 3)}, parts, active=["X"])
    kinds = {"m": "mass", "k": "stiffness", "c": "viscous_damping"}
    return structure, sid.parameters(structure, [sid.Unknown(kinds[name[0]], name) for name in FREE])


def averaged(n, seed, lines=60, noise=0.03, heavier=1.0):
    """FRFs of n averages of random loads, with the coherence that these have; the third mass may be heavier than believed."""
    structure, truth = chain()
    rng, values = np.random.default_rng(seed), structure.values.copy()
    [third] = [p for p in structure.properties if p.label == "mass[m3]"]
    values[third.values] *= heavier
    frequency = np.linspace(0.5, 10.0, lines)
    own = [structure.matrix(law, values).toarray() for law in ("mass", "damping", "stiffness")]
    stiffness = [own[2] - w**2 * own[0] + 1j * w * own[1] for w in 2 * np.pi * frequency]
    h = np.linalg.inv(np.array(stiffness))[:, [0, 2], 1:2]

    def random(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    load = random(n, lines, 1, 1)
    motion = h * load + noise * np.sqrt(n) * np.abs(h) * random(n, *h.shape)
    xx, yy = (abs(load) ** 2).sum(axis=0), (abs(motion) ** 2).sum(axis=0)
    xy = (motion * load.conj()).sum(axis=0)
    record = sid.FrfRecord(
        frequency, xy / xx, ["1X", "3X"], ["2X"], "receptance", coherence=abs(xy) ** 2 / (xx * yy), averages=n
    )
    return sid.FrfProblem(structure, truth, with_coherence_noise(record))


@pytest.mark.parametrize("n", [6.0, 15.0])
def test_squares_have_the_mean_and_variance_of_their_law(n):
    """2 (n - 1) g is chi-square over two, as the variance of n averages about a fitted line is; a million draws."""
    rng = np.random.default_rng(3)
    told = rng.chisquare(2 * (n - 1), 10**6) / (2 * n)
    rows = rng.standard_normal((2, 10**6)) / np.sqrt(told)
    both = (rows**2).sum(axis=0)
    assert both.mean() / 2 == pytest.approx(float(expected_square(n)), rel=0.01)
    assert both.var() / 2 == pytest.approx(float(square_variance(np.array(n))), rel=0.1)
    scores = (rows[0] ** 2 / told).mean() / (1 / told).mean()
    assert scores == pytest.approx(float(score_factor(np.array(n))), rel=0.02)
    assert stats.kstest(normal_values(rows[0], np.full(10**6, n)), "norm").pvalue > 1e-3
    scale, share = row_law(np.full(8, n))
    assert scale * share == pytest.approx(float(expected_square(n)), rel=1e-12)


@pytest.mark.parametrize("n", [5, 8, 15])
def test_right_models_fit_to_within_the_noise_of_few_averages_and_intervals_hold(n):
    """Seeds 0 to 39. With the noise as if it were known, 5 averages hold 8 in 10, and most right models are misfits."""
    found, truth = [estimate(averaged(n, seed)) for seed in range(40)], chain()[1].start
    assert [one.covariance_basis for one in found].count("noise") >= 39
    assert np.mean([one.chi_square_per_dof for one in found]) == pytest.approx(n / (n - 2), rel=0.05)
    words = [w for one in found for w in estimate_warnings(one)]
    assert sum("to within the noise" in w for w in words) <= 1
    assert sum("not normal" in w for w in words) <= 1
    inside = [(one.interval()[:, 0] <= truth) & (truth <= one.interval()[:, 1]) for one in found]
    assert 0.92 <= np.mean(inside) <= 0.99
    plain = [one.std * np.sqrt(1 - 3 / n) for one in found]
    if n == 5:
        held = [abs(one.values - truth) < 1.96 * std for one, std in zip(found, plain, strict=True)]
        assert np.mean(held) < 0.88


def test_a_wrong_model_is_a_misfit_of_few_averages_too():
    found = estimate(averaged(8, 0, heavier=1.1))
    assert found.covariance_basis == "model_error"
    assert any("to within the noise" in words for words in estimate_warnings(found))


def test_an_order_in_the_residual_is_model_error_where_the_size_is_that_of_few_averages():
    """A heavier mass, seed 3: chi-square is what 8 averages leave now and then, but signs go together."""
    found = [estimate(averaged(8, 3, lines=400, noise=0.1, heavier=h)) for h in (1.0, 1.009)]
    assert [one.covariance_basis for one in found] == ["noise", "model_error"]
    assert found[1].goodness.chi_square_probability > 0.002


def test_every_kind_of_interval_knows_of_few_averages():
    problem = averaged(8, 1)
    found = estimate(problem)
    plain = np.linalg.inv(problem.linearize(found.theta).jacobian.T @ problem.linearize(found.theta).jacobian)
    assert found.std_free == pytest.approx(np.sqrt(np.diag(plain) * 8 / 5), rel=1e-9)
    width = np.diff(found.interval(), axis=1)[:, 0]
    curve = profile(problem, found, "stiffness[k1]")
    assert curve.scale == pytest.approx(8 / 5)
    assert curve.upper - curve.lower == pytest.approx(width[0], rel=0.05)
    refits = bootstrap(problem, found, "noise", n_replicates=100)
    assert np.diff(refits.interval(), axis=1)[:, 0] == pytest.approx(width, rel=0.2)
    draws = sample(problem, found, n_draws=250, n_warmup=100)
    assert np.diff(draws.interval(), axis=1)[:, 0] == pytest.approx(width, rel=0.15)
    free = estimate(problem, MatrixFree(draws=4, solved=problem.names))
    assert free.covariance_basis == "noise"
    assert free.std == pytest.approx(found.std, rel=1e-3)


@pytest.mark.long
def test_model_error_has_the_same_intervals_by_profile_and_samples():
    problem = averaged(8, 0, heavier=1.1)
    found = estimate(problem)
    assert found.covariance_basis == "model_error"
    width = np.diff(found.interval(), axis=1)[:, 0]
    curve = profile(problem, found, 0)
    assert curve.upper - curve.lower == pytest.approx(width[0], rel=0.1)
    draws = sample(problem, found, n_draws=250, n_warmup=100)
    assert np.diff(draws.interval(), axis=1)[:, 0] == pytest.approx(width, rel=0.15)


def test_records_of_few_averages_beside_others():
    few, many = averaged(8, 1), averaged(200, 1, lines=20)
    joint = JointProblem((few, many))
    assert joint.rows.averages.tolist() == [8.0] * few.n_data + [200.0] * many.n_data
    expected = (few.n_data * 8 / 6 + many.n_data * 200 / 198) / joint.n_data
    assert expected_per_row(joint) == pytest.approx(expected)
    scale, share = row_law(joint.rows.averages)
    assert scale * share == pytest.approx(expected)


def test_of_too_few_averages_nothing_is_expected():
    problem = averaged(3, 0)
    assert row_law(problem.rows.averages) == (1.0, 1.0)
    assert estimate(problem).covariance_basis == "model_error"
    assert expected_per_row(averaged(2, 0)) == np.inf


def test_stated_errors_beside_the_noise_make_it_better_known():
    own = averaged(8, 0)
    mixed = sid.FrfProblem(own.structure, own.parameters, own.record, model_error=1.0)
    assert (mixed.rows.averages > 100).all()
    assert (own.rows.averages == 8).all()

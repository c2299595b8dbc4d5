"""Strengths of penalties against brute-force evidence, and on a textbook ill-posed problem."""

import numpy as np
import pytest
from scipy import optimize, stats

from structid import InputError
from structid.inversion import Linearization
from structid.inversion.strengths import (
    LocalModel,
    absolute_strengths,
    discrepancy_strength,
    l_curve_strength,
    log_evidence,
    marginal_likelihood_strengths,
    prior_share,
    settled,
    sparse_strengths,
)


def linear(matrix, data, *penalties):
    """A model around p = 0 of rows matrix p - data and penalties L p."""
    return LocalModel(
        Linearization(-data, matrix), tuple(Linearization(np.zeros(len(part)), part) for part in penalties)
    )


@pytest.fixture
def small():
    rng = np.random.default_rng(3)
    matrix = rng.standard_normal((12, 5))
    return matrix, matrix @ np.array([4.0, -2.0, 3.0, -2.0, 1.4]) + rng.standard_normal(12)


def test_evidence_is_the_density_of_the_data_with_the_parameters_integrated_out(small):
    matrix, data = small
    root = np.tril(np.ones((5, 5))) + np.eye(5)
    for strength in (0.1, 1.0, 30.0):
        prior = np.linalg.inv(strength * root.T @ root)
        brute = stats.multivariate_normal(np.zeros(12), np.eye(12) + matrix @ prior @ matrix.T).logpdf(data)
        assert log_evidence(linear(matrix, data, root), (strength,)) == pytest.approx(brute, rel=1e-12)


def test_marginal_likelihood_finds_the_top_of_the_evidence(small):
    matrix, data = small
    first, second = np.eye(5)[:2], np.diff(np.eye(5)[1:], axis=0)
    model = linear(matrix, data, first, second)
    found = marginal_likelihood_strengths(model)
    best = optimize.minimize(
        lambda x: -log_evidence(model, tuple(np.exp(x))), np.zeros(2), method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-12},
    )  # fmt: skip
    assert np.log(found) == pytest.approx(best.x, abs=1e-4)


def test_marginal_likelihood_holds_completely_what_does_not_vary():
    rng = np.random.default_rng(5)
    matrix = rng.standard_normal((40, 6))
    data = matrix @ np.full(6, 2.0) + 0.3 * rng.standard_normal(40)
    model = linear(matrix, data, np.diff(np.eye(6), axis=0))
    (found,) = marginal_likelihood_strengths(model)
    values = model.solved((found,)).step
    assert found > 1e5
    assert np.ptp(values) < 1e-3


def shaw(n=32):
    """Shaw's image restoration problem and its solution, as in Hansen's Regularization Tools."""
    angle = -np.pi / 2 + (np.arange(n) + 0.5) * np.pi / n
    u = np.pi * (np.sin(angle)[:, None] + np.sin(angle)[None])
    kernel = (np.cos(angle)[:, None] + np.cos(angle)[None]) ** 2 * np.sinc(u / np.pi) ** 2 * np.pi / n
    truth = 2 * np.exp(-6 * (angle - 0.8) ** 2) + np.exp(-2 * (angle + 0.5) ** 2)
    return kernel, truth


@pytest.fixture(params=range(4))
def ill_posed(request):
    """Whitened rows of Shaw's problem with noise of 1e-3, its solution, and the least error of any strength."""
    matrix, truth = shaw()
    noise = 1e-3
    data = matrix @ truth + noise * np.random.default_rng(request.param).standard_normal(len(truth))
    model = linear(matrix / noise, data / noise, np.eye(len(truth)))
    errors = [np.linalg.norm(model.solved((s,)).step - truth) for s in np.geomspace(1e-6, 1e6, 200) * model.balance(0)]
    return model, truth, min(errors) / np.linalg.norm(truth)


@pytest.mark.parametrize("rule", ["l_curve", "discrepancy", "marginal_likelihood"])
def test_rules_come_close_to_the_best_strength_of_an_ill_posed_problem(ill_posed, rule):
    model, truth, best = ill_posed
    strength = {
        "l_curve": lambda: l_curve_strength(model),
        "discrepancy": lambda: discrepancy_strength(model, len(truth)),
        "marginal_likelihood": lambda: marginal_likelihood_strengths(model)[0],
    }[rule]()
    error = np.linalg.norm(model.solved((strength,)).step - truth) / np.linalg.norm(truth)
    plain = np.linalg.norm(model.solved((1e-30,)).step - truth) / np.linalg.norm(truth)
    assert best < 0.1
    assert plain > 1e6
    assert error < 5 * best  # the worst of the three rules and four draws has 4.7; no strength at all, 4e10


def test_discrepancy_fits_to_one_deviation_above_the_noise(ill_posed):
    model, truth, _ = ill_posed
    n = len(truth)
    assert model.solved((discrepancy_strength(model, n),)).data_cost == pytest.approx(n + np.sqrt(2 * n), rel=1e-9)


def test_discrepancy_takes_the_least_strength_where_the_noise_cannot_be_reached():
    matrix = np.vander(np.linspace(0, 1, 30), 3)
    model = linear(matrix, 100 * np.cos(9 * np.linspace(0, 1, 30)), np.eye(3))
    assert discrepancy_strength(model, 30) == pytest.approx(1e-8 * model.balance(0))


def test_one_strength_a_row_cannot_be_bettered_row_by_row():
    rng = np.random.default_rng(8)
    truth = np.zeros(8)
    truth[2], truth[5] = 3.0, -12.0
    matrix = rng.standard_normal((20, 8)) * np.geomspace(1, 0.03, 8)  # what is seen worst by far comes last
    truth[7] = 60.0
    data = matrix @ truth + 0.5 * rng.standard_normal(20)
    model = linear(matrix, data, np.eye(8))
    found = sparse_strengths(model, 0, (1.0,))
    free = set(np.flatnonzero(found < 1e3).tolist())
    assert {2, 5, 7} <= free
    assert len(free) <= 5
    single = linear(matrix, data, *np.eye(8)[:, None])
    top = log_evidence(single, tuple(found))
    for i in range(8):
        for factor in (0.5, 0.99, 1.01, 2.0, 1e-4, 1e-3, 1e3):
            other = found.copy()
            other[i] *= factor
            assert log_evidence(single, tuple(other)) <= top + 1e-5


def test_sparse_strength_of_what_the_data_do_not_see_is_the_highest():
    matrix = np.array([[1.0, 0.0], [2.0, 0.0], [0.5, 0.0]])
    model = linear(matrix, matrix @ [5.0, 0.0], np.eye(2))
    found = sparse_strengths(model, 0, (1.0,))
    assert found[1] == pytest.approx(1e6 * model.balance(0))
    assert found[0] == pytest.approx(1 / (25 - 1 / 5.25), rel=1e-6)


def test_sum_of_magnitudes_thresholds_softly_where_the_rows_are_orthogonal():
    data, smoothing = np.array([3.0, -0.4, 0.9, -2.5, 1.2]), 1e-7
    model = linear(np.eye(5), data, np.eye(5))
    weights = absolute_strengths(model, 0, (1.0,), 1.0, smoothing)
    found = model.solved((weights,)).step
    assert found == pytest.approx(np.sign(data) * np.maximum(np.abs(data) - 1.0, 0), abs=1e-5)


def test_prior_share_of_one_parameter_is_its_part_of_the_information():
    assert prior_share(np.array([[3.0], [4.0], [2.0]]), 2) == pytest.approx([4 / 29])


def test_prior_share_does_not_depend_on_units_and_adds_up():
    rng = np.random.default_rng(2)
    jacobian = rng.standard_normal((9, 4))
    share = prior_share(jacobian, 6)
    assert prior_share(jacobian * [1e-3, 1.0, 50.0, 1e6], 6) == pytest.approx(share, rel=1e-9)
    data_first = np.concatenate([jacobian[6:], jacobian[:6]])
    assert share + prior_share(data_first, 3) == pytest.approx(np.ones(4), rel=1e-12)
    assert prior_share(jacobian, 9) == pytest.approx(np.zeros(4))
    assert prior_share(np.eye(2)[[0, 0]], 1)[1] != prior_share(np.eye(2)[[0, 0]], 1)[1]  # NaN: nothing sees it


def test_strengths_of_a_nonlinear_problem_settle_where_the_linearized_choice_agrees():
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((30, 4))
    truth = np.array([0.3, 0.35, 0.28, 0.33])
    data = np.exp(matrix @ truth) + 0.2 * rng.standard_normal(30)
    rows = np.diff(np.eye(4), axis=0)

    def at(theta):
        value = np.exp(matrix @ theta)
        return LocalModel(
            Linearization((value - data) / 0.2, matrix * value[:, None] / 0.2), (Linearization(rows @ theta, rows),)
        )

    def refit(strengths, theta):
        for _ in range(50):
            theta = theta + at(theta).solved(strengths).step
        return theta

    found = settled(refit, at, lambda m, s: marginal_likelihood_strengths(m, s), np.zeros(4), (1.0,))
    assert found.converged
    assert found.rounds < 15
    assert marginal_likelihood_strengths(at(found.theta)) == pytest.approx(found.strengths, rel=2e-3)
    assert np.abs(at(found.theta).solved(found.strengths).step).max() < 1e-9
    stopped = settled(refit, at, lambda m, s: (2 * s[0],), np.zeros(4), (1.0,), max_rounds=3)
    assert (stopped.converged, stopped.rounds) == (False, 3)


def test_rules_for_one_penalty_refuse_several(small):
    matrix, data = small
    with pytest.raises(InputError, match="one penalty, got 2"):
        l_curve_strength(linear(matrix, data, np.eye(5), np.eye(5)))

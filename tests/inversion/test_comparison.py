"""Comparison of two states: corrections against published examples, covariance against brute force, error rates."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from structid import InputError, Status, compare_jointly, compare_states, estimate
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.diagnostics.residual_tests import adjusted_p_values, detectable
from structid.inversion.state_comparison import states_problem

#: Benjamini and Hochberg (1995), section 3.2: p-values of fifteen hypotheses on thrombolysis.
THROMBOLYSIS = np.array([
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0,
])  # fmt: skip


def test_corrections_declare_what_the_published_example_does():
    shuffled = np.random.default_rng(0).permutation(15)
    for correction, count in (("benjamini_hochberg", 4), ("holm", 3)):
        adjusted = np.empty(15)
        adjusted[shuffled] = adjusted_p_values(THROMBOLYSIS[shuffled], correction)
        assert (np.diff(adjusted) >= 0).all()
        assert (adjusted <= 0.05).sum() == count


def test_adjusted_values_by_hand():
    p = np.array([0.02, np.nan, 0.01, 0.03, 0.2])
    assert adjusted_p_values(p) == pytest.approx([0.06, np.nan, 0.04, 0.06, 0.2], nan_ok=True)
    assert adjusted_p_values(p, "benjamini_hochberg") == pytest.approx([0.04, np.nan, 0.04, 0.04, 0.2], nan_ok=True)
    assert adjusted_p_values(np.array([0.9, 0.8])) == pytest.approx([1.0, 1.0])


def state(values, covariance, names=("a", "b"), status=Status.CONVERGED, units=None):
    n = len(names)
    return SimpleNamespace(
        names=tuple(names), kinds=("test",) * n, units=units or ("1",) * n, values=np.array(values, float),
        covariance=np.array(covariance, float), covariance_of_data=np.array(covariance, float), status=status, fixed=None,
    )  # fmt: skip


def test_what_both_states_owe_to_the_same_held_values_is_no_change():
    first, second = (state([10, 20], 0.01 * np.eye(2)) for _ in range(2))
    first.fixed = SimpleNamespace(
        change_names=("mass", "gain 1"), change_tolerances=(0.01, 0.02), changes=np.array([[2.0, 0.1], [3.0, 0.2]])
    )
    second.fixed = SimpleNamespace(
        change_names=("gain 2", "mass"), change_tolerances=(0.02, 0.01), changes=np.array([[0.3, 2.1], [0.4, 2.8]])
    )
    found = compare_states(first, second)
    assert np.diag(found.covariance) == pytest.approx(
        [0.02 + 0.1**2 + 0.1**2 + 0.3**2, 0.02 + 0.2**2 + 0.2**2 + 0.4**2]
    )
    assert np.diag(found.covariance_before) == pytest.approx([0.01 + 4.01, 0.01 + 9.04])


def test_independent_states_add_their_covariances():
    p, q = np.array([[1.0, 0.3], [0.3, 2.0]]), np.array([[0.5, -0.1], [-0.1, 4.0]])
    found = compare_states(state([10, 20], p), state([18, 12], q[::-1, ::-1], ("b", "a")))
    assert found.names == ("a", "b")
    assert found.change == pytest.approx([2.0, -2.0])
    assert found.covariance == pytest.approx(p + q)
    assert found.relative_change == pytest.approx([0.2, -0.1])
    assert found.p_values == pytest.approx(
        [0.1024704, 0.4142162], rel=1e-6
    )  # 2 Phi(-2 / sqrt(1.5)), 2 Phi(-2 / sqrt(6))
    change = np.array([2.0, -2.0])
    assert found.statistic == pytest.approx(change @ np.linalg.solve(p + q, change))


@dataclass
class Line(Problem):
    """matrix p = data with unit noise and Gaussian priors of mean 0 on some parameters."""

    matrix: np.ndarray
    data: np.ndarray
    labels: tuple
    prior: np.ndarray | None = None
    mean: np.ndarray | None = None

    @property
    def unknowns(self):
        return FreeUnknowns(self.labels, np.zeros(len(self.labels)))

    @property
    def rows(self):
        return DataRows(np.arange(len(self.data)), np.zeros(len(self.data), int))

    def linearize(self, theta):
        residual, jacobian = self.matrix @ theta - self.data, self.matrix
        if self.prior is not None:
            offset = 0 if self.mean is None else self.prior @ self.mean
            residual = np.concatenate([residual, self.prior @ theta - offset])
            jacobian = np.concatenate([jacobian, self.prior])
        return Linearization(residual, jacobian)

    def residual(self, theta):
        return self.linearize(theta).residual


def two_states(seed, change=0.0, common_prior=None):
    """Two states of five parameters, m1 and m2 the same in both, k3 changed."""
    rng = np.random.default_rng(seed)
    names = ("m1", "m2", "k1", "k2", "k3")
    truth = np.array([2.0, -1.0, 3.0, -4.0, 5.0])
    problems = []
    for moved in (0.0, change):
        matrix = np.random.default_rng(99).standard_normal((40, 5)) + 0.5
        at = truth + moved * np.eye(5)[4]
        problems.append(Line(matrix, matrix @ at + rng.standard_normal(40), names, common_prior))
    return problems


def brute_force(first, second):
    """Least squares of both states at once, m1 and m2 in common: k before, k later, covariance of their difference."""
    wide = np.zeros((80, 8))
    wide[:40, :5] = first.matrix
    wide[40:, :2], wide[40:, 5:] = second.matrix[:, :2], second.matrix[:, 2:]
    right = np.concatenate([first.data, second.data])
    covariance = np.linalg.inv(wide.T @ wide)
    p = covariance @ wide.T @ right
    difference = np.hstack([np.zeros((3, 2)), -np.eye(3), np.eye(3)])
    return p[2:5], p[5:], difference @ covariance @ difference.T


def test_states_at_once_and_carried_are_the_least_squares_of_all_data():
    first, second = two_states(1, change=-0.7)
    before, later, covariance = brute_force(first, second)
    joint = compare_jointly(estimate(states_problem(first, second, ("m1", "m2"))), ("m1", "m2"))
    baseline = estimate(first)
    root = np.linalg.inv(np.linalg.cholesky(baseline.covariance[:2, :2]))
    prior = np.hstack([root, np.zeros((2, 3))])
    later_state = estimate(Line(second.matrix, second.data, second.names, prior, baseline.values))
    carried = compare_states(baseline, later_state, ("m1", "m2"))
    for found, tolerance in ((joint, 1e-7), (carried, 2e-2)):
        assert found.names == ("k1", "k2", "k3")
        assert found.carried == ("m1", "m2")
        assert found.before == pytest.approx(before, rel=tolerance)
        assert found.after == pytest.approx(later, rel=1e-7)
        assert found.covariance == pytest.approx(covariance, rel=tolerance, abs=tolerance * covariance.max())
    apart = compare_states(baseline, estimate(second))
    assert (carried.std < apart.std[2:]).all()


def test_carried_covariance_is_exact_where_nothing_is_taken_in_logarithms():
    first, second = two_states(1)
    first.data, second.data = -first.data, -second.data  # m2, k2 positive, the rest negative: mixed signs
    for problem in (first, second):
        problem.matrix = problem.matrix * np.array([1, -1, 1, -1, 1])  # now all are negative
    before, later, covariance = brute_force(first, second)
    baseline = estimate(first)
    root = np.linalg.inv(np.linalg.cholesky(baseline.covariance[:2, :2]))
    prior = np.hstack([root, np.zeros((2, 3))])
    found = compare_states(
        baseline, estimate(Line(second.matrix, second.data, second.names, prior, baseline.values)), ("m1", "m2")
    )
    assert (baseline.values < 0).all()
    assert found.before == pytest.approx(before, rel=1e-7)
    assert found.after == pytest.approx(later, rel=1e-7)
    assert found.covariance == pytest.approx(covariance, rel=1e-7, abs=1e-9)


def test_states_problem_counts_a_common_prior_once_and_has_the_right_derivative():
    prior = np.zeros((2, 5))
    prior[0, 0], prior[1, 4] = 2.0, 3.0
    first, second = two_states(2, common_prior=prior)
    problem = states_problem(first, second, ("m1", "m2"))
    assert problem.names == ("m1", "m2", "k1", "k2", "k3", "k1 (later)", "k2 (later)", "k3 (later)")
    theta = np.random.default_rng(0).standard_normal(8)
    at = problem.linearize(theta)
    assert len(at.residual) == 80 + 3  # m1 once, k3 in both states
    step = 1e-6
    found = np.stack(
        [(problem.residual(theta + step * e) - problem.residual(theta - step * e)) / (2 * step) for e in np.eye(8)], 1
    )
    assert at.jacobian == pytest.approx(found, abs=1e-8)
    assert problem.problems == (first, second)


REPEATS = 500


def draws(n_repeats, n_params=10, moved=0.0, correction="holm"):
    """Declared changes of two independent estimates with correlated errors; parameter 0 moves by `moved`."""
    rng = np.random.default_rng(11)
    root = np.tril(rng.standard_normal((n_params, n_params))) + 2 * np.eye(n_params)
    covariance, names = root @ root.T, tuple(map(str, range(n_params)))
    declared = np.empty((n_repeats, n_params), dtype=bool)
    for k in range(n_repeats):
        first, second = 50 + (root @ rng.standard_normal((n_params, 2))).T
        second[0] += moved
        found = compare_states(state(first, covariance, names), state(second, covariance, names), correction=correction)
        declared[k] = found.changed
    return declared, found


@pytest.mark.parametrize("correction", ["holm", "benjamini_hochberg"])
def test_nothing_changed_is_called_a_change_no_more_often_than_the_level(correction):
    declared, _ = draws(REPEATS, correction=correction)
    rate = declared.any(axis=1).mean()
    assert 0.02 < rate < 0.05 + 3 * np.sqrt(0.05 * 0.95 / REPEATS)


def test_a_change_of_the_detection_limit_is_declared_with_its_power():
    _, found = draws(1)
    declared, _ = draws(REPEATS, moved=float(found.detection_limit[0]))
    assert abs(declared[:, 0].mean() - 0.9) < 3 * np.sqrt(0.9 * 0.1 / REPEATS)


def test_detection_limit_of_one_test_is_the_textbook_sum():
    assert detectable(1, 0.05, 0.9) == pytest.approx(1.959964 + 1.281552, abs=1e-6)
    assert detectable(15, 0.05, 0.9) > detectable(1, 0.05, 0.9)
    assert np.isnan(detectable(0, 0.05, 0.9))


def test_what_a_state_does_not_determine_is_not_tested():
    found = compare_states(
        state([1.0, 2.0], np.eye(2)),
        state([9.0, 2.0], [[1.0, np.nan], [np.nan, np.nan]], status=Status.NOT_IDENTIFIABLE),
    )
    assert not found.is_complete
    assert found.status is Status.NOT_IDENTIFIABLE
    assert found.changed.tolist() == [True, False]
    assert np.isnan(found.detection_limit[1])
    assert found.detection_limit[0] == pytest.approx(np.sqrt(2) * detectable(1, 0.05, 0.9))
    lost = compare_states(
        state([1.0, 2.0], [[np.nan, np.nan], [np.nan, 1.0]]), state([1.0, 2.0], np.eye(2)), carried=["a"]
    )
    assert not lost.is_complete
    assert np.isnan(lost.p_values).all()
    assert not lost.changed.any()


def test_the_sentence_names_what_changed():
    found = compare_states(state([10.0, 20.0], np.eye(2) * 0.01), state([9.0, 20.1], np.eye(2) * 0.01))
    assert found.words == "changed (joint risk 5 %): a (-10.0 %)"
    small = compare_states(state([10.0, 20.0], np.eye(2) * 1e-14), state([9.9999, 20.0], np.eye(2) * 1e-14))
    assert small.words == "changed (joint risk 5 %): a (-0.001 %)"
    same = compare_states(
        state([10.0], [[1.0]], ("a",)), state([10.1], [[1.0]], ("a",)), correction="benjamini_hochberg"
    )
    assert same.words == "no parameter changed (false discovery rate 5 %)"
    assert compare_states(state([1, 2, 3], np.eye(3), "abc"), state([1, 2], np.eye(2), "bd")).only_before == ("a", "c")


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ({"level": 0.7}, "`level` must lie between 0 and 0.5"),
        ({"power": 1.0}, "`power` must be"),
        ({"correction": "bonferroni"}, "`correction` must be"),
        ({"carried": ["z"]}, "must name parameters of both states, got 'z'"),
        ({"carried": ["a", "b"]}, "no parameter in common"),
    ],
)
def test_unusable_comparisons_are_refused(arguments, fragment):
    with pytest.raises(InputError, match=fragment):
        compare_states(state([1, 2], np.eye(2)), state([1, 2], np.eye(2)), **arguments)
    with pytest.raises(InputError, match="one unit in both states"):
        compare_states(state([1, 2], np.eye(2)), state([1, 2], np.eye(2), units=("1", "kg")))
    with pytest.raises(InputError, match="`shared` must name parameters of both"):
        states_problem(*two_states(0), ("m9",))

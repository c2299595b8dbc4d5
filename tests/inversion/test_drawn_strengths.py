"""Strengths of smoothness by draws against the dense fixed point, and errors of the data as the residual shows them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from test_matrix_free import field

from structid.core.errors import InputError
from structid.inversion import Linearization, MatrixFree, Search, minimize
from structid.inversion.covariance import error_blocks
from structid.inversion.drawn_strengths import Differences, balanced_strengths, settled_strengths
from structid.inversion.estimate import estimate
from structid.inversion.posterior_draws import error_draws, posterior_draws
from structid.inversion.problem import DataRows
from structid.inversion.search.work import restored_minimum, stored_minimum
from structid.inversion.strengths import LocalModel, marginal_likelihood_strengths


def differences(n):
    matrix = sparse.csr_array(sparse.diags_array([np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n)))
    return Differences(
        matrix,
        lambda physical: matrix @ np.log(physical),
        lambda physical: sparse.csr_array(matrix @ sparse.diags_array(1 / physical)),
    )


def smooth_problem(stored=True):
    problem, _ = field(stored)
    held = differences(60)

    def made(strengths):
        return replace(problem, smoothness=sparse.csr_array(np.sqrt(strengths[0]) * held.matrix))

    return problem, held, made


def dense_strength(made, held, theta):
    """The fixed point of MacKay with exact traces, refitted at each of its own answers."""
    problem = made((1.0,))
    for _ in range(30):
        jacobian = problem.windows * np.exp(theta)
        data = Linearization(problem.windows @ np.exp(theta) - problem.data, jacobian)
        model = LocalModel(data, (Linearization(held.matrix @ theta, held.matrix.toarray()),))
        strength = marginal_likelihood_strengths(model)[0]
        theta = theta + model.solved((strength,)).step
    return strength


@pytest.mark.parametrize("stored", [False, True])
def test_strength_is_that_of_the_dense_fixed_point(stored):
    _, held, made = smooth_problem(stored)
    start = np.zeros(60)
    begun = balanced_strengths(made((1.0,)), start, [held], [None])
    found = settled_strengths(made, [held], [None], begun, start)
    assert found.converged
    exact = dense_strength(made, held, start)
    assert abs(np.log(found.strengths[0] / exact)) < np.sqrt(2 / found.determined[0])  # what the data tell of it
    assert 3 < found.determined[0] < 25


def test_counted_combinations_are_the_exact_trace():
    problem, held, made = smooth_problem()
    found = settled_strengths(made, [held], [None], (100.0,), np.zeros(60))
    at = made(found.strengths)
    jacobian = problem.windows * np.exp(found.theta)
    prior = found.strengths[0] * (held.matrix.T @ held.matrix).toarray()
    exact = np.trace(np.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ jacobian)) - 1
    assert found.determined[0] == pytest.approx(exact, rel=0.35)  # eight draws, a strength from before the last change
    assert estimate(at, MatrixFree(draws=300)).spread.determined == pytest.approx(exact + 1, rel=0.1)


def test_balance_has_equal_traces():
    problem, held, made = smooth_problem()
    (strength,) = balanced_strengths(made((1.0,)), np.zeros(60), [held], [None])
    assert strength * (held.matrix.toarray() ** 2).sum() == pytest.approx((problem.windows**2).sum())
    assert balanced_strengths(made((1.0,)), np.zeros(60), [held], [7.0]) == (7.0,)


def test_terms_that_share_parameters_are_refused():
    _, held, made = smooth_problem()
    with pytest.raises(InputError, match="held twice"):
        settled_strengths(made, [held, held], [None, None], (1.0, 1.0), np.zeros(60))


def test_rows_leave_one_mean_of_each_connected_part_free():
    one = differences(60)
    assert one.nullity == 1
    split = Differences(sparse.csr_array(one.matrix[np.r_[0:20, 21:59]]), one.residual, one.jacobian)
    assert split.nullity == 2
    assert len(split.members) == 60


class Kept:
    """Searches one after another, each stopped after some iterations in all, and gone on with by the next of its kind."""

    def __init__(self, stop=None, before=None):
        self.stop, self.calls, self.number = stop, 0, 0
        self.done = dict(before.done) if before else {}
        self.last = before.last if before else None

    def __call__(self, problem, method, theta=None, progress=None):
        self.number += 1
        if self.number in self.done:
            return restored_minimum(problem, method, self.done[self.number])
        self.state = self.last[1] if self.last and self.last[0] == self.number else None
        found = minimize(problem, method, theta, progress, self)
        self.done[self.number] = stored_minimum(found)
        return found

    def keep(self, iteration, cost, state):
        self.last, self.calls = (self.number, dict(state())), self.calls + 1
        if self.calls == self.stop:
            raise KeyboardInterrupt


def test_choice_interrupted_anywhere_goes_on_to_the_same_digits():
    _, held, made = smooth_problem()
    kept = Kept()
    whole = settled_strengths(made, [held], [None], (1e5,), np.zeros(60), search=kept)
    assert kept.calls >= 5
    assert kept.number >= 2
    for stop in range(1, kept.calls + 1):
        stopped = Kept(stop)
        with pytest.raises(KeyboardInterrupt):
            settled_strengths(made, [held], [None], (1e5,), np.zeros(60), search=stopped)
        rest = settled_strengths(made, [held], [None], (1e5,), np.zeros(60), search=Kept(before=stopped))
        assert rest.strengths == whole.strengths
        assert rest.determined == whole.determined
        np.testing.assert_array_equal(rest.theta, whole.theta)


def test_progress_counts_the_iterations_of_all_fits():
    _, held, made = smooth_problem()
    told = []
    settled_strengths(
        made, [held], [None], (1e5,), np.zeros(60), progress=lambda iteration, cost: told.append(iteration)
    )
    assert told == list(range(1, len(told) + 1))
    assert len(told) >= 5


def test_interrupted_search_goes_on_to_the_same_digits():
    _, _, made = smooth_problem()
    problem, method = made((100.0,)), MatrixFree()
    whole = minimize(problem, method)
    stopped = Kept(2)
    with pytest.raises(KeyboardInterrupt):
        stopped(problem, method)
    rest = Kept(before=stopped)(problem, method)
    for name in ("theta", "history", "costs", "inner"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name))


def test_errors_drawn_from_the_residual_have_the_block_covariance():
    problem, _, made = smooth_problem()
    wrong = replace(made((400.0,)), data=problem.data + 30 * np.sin(1.5 * np.arange(25)))
    found = estimate(wrong, MatrixFree(draws=2000), search=Search(seed=3))
    assert found.covariance_basis == "model_error"
    assert "misses the noise" in found.message
    at = wrong.linearize(found.theta)
    block = error_blocks(at.residual[:25], wrong.rows.lines, wrong.rows.series)[0]
    count = block.max() + 1
    scores = np.zeros((count, 60))
    np.add.at(scores, block, at.jacobian[:25] * at.residual[:25, None])
    bread = np.linalg.inv(at.jacobian.T @ at.jacobian)
    prior = at.jacobian[25:].T @ at.jacobian[25:]
    from scipy import special

    raised = special.stdtrit(max(count - 1, 2), 0.975) / special.ndtri(0.975)
    meat = raised**2 * count / (count - 1) * scores.T @ scores + prior
    exact = np.sqrt(np.diag(bread @ meat @ bread)) * found.values
    assert np.abs(found.std / exact - 1).max() < 4.5 / np.sqrt(4000)
    assert estimate(made((400.0,)), MatrixFree(draws=8)).covariance_basis == "noise"


def test_one_block_gives_no_standard_deviation():
    _, _, made = smooth_problem()
    free = made((100.0,)).linearize_operator(np.zeros(60))

    class OneLine:
        rows = DataRows(np.zeros(25, int), np.arange(25))

    draws, missed = posterior_draws(free, 3, np.random.default_rng(0), error_draws(OneLine(), free))
    assert missed == 3
    assert np.isnan(draws).all()


def test_changes_beyond_chance_are_rare_where_nothing_changed():
    """Fields at their initial values, 40 noises: the share of them with any mark is at most 5 % and a few."""
    marked = []
    for seed in range(40):
        problem, _ = field(True, seed=seed)
        noise = np.random.default_rng(1000 + seed).standard_normal(25)
        still = replace(problem, data=problem.windows.sum(axis=1) + noise)
        beyond, limit = estimate(still, MatrixFree(), search=Search(seed=seed)).beyond_chance()
        marked.append(beyond.any())
        assert 3.5 < limit < 4.5
    assert np.mean(marked) <= 0.1
    problem, truth = field(True)
    beyond, _ = estimate(problem, MatrixFree()).beyond_chance()
    assert beyond[np.argmin(truth)]
    assert not beyond[np.abs(truth - 1) < 1e-4].any()

"""A search without a Jacobian against the one with it, and against dense linear algebra."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import sparse

from structid.core.errors import InputError
from structid.inversion import (
    DataRows,
    FreeUnknowns,
    LevenbergMarquardt,
    Linearization,
    MatrixFree,
    OperatorLinearization,
    Problem,
    Search,
    Status,
    linearization,
    minimize,
)
from structid.inversion.estimate import estimate
from structid.inversion.linearization import conjugate_gradients, preconditioner
from structid.inversion.posterior_draws import posterior_draws, solved_std
from structid.inversion.search.least_squares import dense_search_fits
from structid.inversion.search.within_tolerances import FixedValues

EXACT = MatrixFree(gain_tolerance=1e-13, inner_tolerance=1e-9)


class Exponential(FreeUnknowns):
    """Positive unknowns; their logarithms are free."""

    def physical(self, theta):
        return np.exp(theta)

    slope = physical


@dataclass(frozen=True, eq=False)
class Field(Problem):
    """exp(theta) along a line seen through few wide windows, smooth from one to the next."""

    windows: np.ndarray
    data: np.ndarray
    smoothness: sparse.csr_array
    stored: bool

    @property
    def unknowns(self):
        count = self.windows.shape[1]
        return Exponential(tuple(f"p{i}" for i in range(count)), np.zeros(count), ("stiffness",) * count)

    @property
    def rows(self):
        return DataRows(np.arange(len(self.data)), np.zeros(len(self.data), int))

    def residual(self, theta):
        return np.concatenate([self.windows @ np.exp(theta) - self.data, self.smoothness @ theta])

    def linearize(self, theta):
        return Linearization(
            self.residual(theta), np.concatenate([self.windows * np.exp(theta), self.smoothness.toarray()])
        )

    def linearize_operator(self, theta):
        jacobian = self.windows * np.exp(theta)
        return OperatorLinearization(
            residual=self.residual(theta),
            forward=lambda v: jacobian @ v,
            adjoint=lambda u: jacobian.T @ u,
            data_squares=(jacobian**2).sum(axis=0),
            prior=self.smoothness,
            words="formed by the test",
            jacobian=jacobian if self.stored else None,
        )


def field(stored, n=60, n_windows=25, strength=400.0, seed=0):
    rng = np.random.default_rng(seed)
    place = np.linspace(0, 1, n)
    centre = np.linspace(0, 1, n_windows)
    windows = 40 * np.exp(-0.5 * ((place - centre[:, None]) / 0.05) ** 2)
    truth = 1 - 0.4 * np.exp(-0.5 * ((place - 0.6) / 0.1) ** 2)
    differences = sparse.diags_array([np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    smoothness = sparse.csr_array(np.sqrt(strength) * differences)
    return Field(windows, windows @ truth + rng.standard_normal(n_windows), smoothness, stored), truth


@pytest.mark.parametrize("stored", [False, True])
def test_minimum_and_damage_equal_those_of_the_dense_search(stored):
    problem, truth = field(stored)
    dense = minimize(problem, LevenbergMarquardt())
    free = minimize(problem, EXACT)
    assert free.converged
    assert free.theta == pytest.approx(dense.theta, abs=1e-6)
    assert free.costs[-1] == pytest.approx(dense.costs[-1], rel=1e-9)
    assert abs(int(np.argmin(free.theta)) - int(np.argmin(truth))) <= 3
    assert (free.inner <= 5).all()


@pytest.mark.parametrize("stored", [False, True])
def test_standard_deviations_equal_the_dense_covariance(stored):
    problem, _ = field(stored)
    found = estimate(problem, MatrixFree(draws=400, solved=("p3", "p40")), search=Search(seed=1))
    jacobian = problem.linearize(found.theta).jacobian
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    exact = np.sqrt(np.diag(covariance)) * found.values
    assert found.std[[3, 40]] == pytest.approx(exact[[3, 40]], rel=1e-4)
    rest = np.setdiff1d(np.arange(60), [3, 40])
    off = found.std[rest] / exact[rest] - 1
    assert np.abs(off).max() < 4.5 / np.sqrt(800)  # 4.5 of their own standard errors
    assert found.uncertainty.std_error[[3, 5]] == pytest.approx([0.0, 1 / np.sqrt(800)])
    draws = found.uncertainty.draws / found.parameters.slope
    sampled = draws.T @ draws / 400
    assert np.corrcoef(sampled.ravel(), covariance.ravel())[0, 1] > 0.9
    assert found.status is Status.CONVERGED
    assert "400 posterior draws" in found.message
    assert "no covariance matrix" in found.message
    assert found.goodness.chi_square == pytest.approx((problem.residual(found.theta)[:25] ** 2).sum())


class Loaded(Field):
    """A field whose last unknown is the factor of a load, which the model of the field holds at 1."""

    @property
    def unknowns(self):
        free = super().unknowns
        return Exponential((*free.names[:-1], "fixed load"), free.theta_start, free.kinds)


def test_fixed_values_are_freed_by_the_test_that_judges_a_misfit():
    """Rows less parameters are 24 degrees of freedom, and the data leave 10: by these alone a chi-square of 37 misses the noise."""
    problem, truth = field(True)
    load = 8 * np.cos(3.0 * np.arange(25))
    data = problem.windows @ truth + np.random.default_rng(0).standard_normal(25) + load * (np.exp(0.15) - 1)
    rows = sparse.block_diag([problem.smoothness, [[1 / 0.3]]], format="csr")
    loaded = Loaded(np.column_stack([problem.windows, load]), data + load, rows, True)
    problem = replace(problem, data=data)
    assert not MatrixFree().misfits(problem, minimize(problem, MatrixFree()), 1e-3)
    assert estimate(problem, MatrixFree()).covariance_basis == "model_error"
    found = estimate(problem, MatrixFree(), fixed=FixedValues(loaded, {"fixed load": 0.3}))
    assert found.covariance_basis == "noise"
    assert found.fixed.asked * 0.3 == pytest.approx([0.15], abs=0.1)
    assert found.goodness.least_chi_square < 10 < found.goodness.chi_square


def test_without_draws_and_without_convergence_nothing_is_zero():
    problem, _ = field(True)
    found = estimate(problem, MatrixFree(draws=0))
    assert np.isnan(found.std).all()
    assert found.status is Status.NOT_IDENTIFIABLE
    stopped = estimate(problem, MatrixFree(max_iterations=1, draws=4))
    assert stopped.status is Status.NOT_CONVERGED
    assert "stopped after 1 iterations" in stopped.message


def test_parameter_that_nothing_sees_has_no_standard_deviation():
    problem, _ = field(False, n=30)
    blind = problem.windows.copy()
    blind[:, 7] = 0.0
    loose = problem.smoothness.toarray()
    loose[6:8] = 0.0
    unseen = Field(blind, problem.data, sparse.csr_array(loose), False)
    found = estimate(unseen, MatrixFree(draws=8, solved=("p7",)))
    assert np.isnan(found.std[7])
    assert np.isfinite(np.delete(found.std, 7)).all()
    assert found.status is Status.NOT_IDENTIFIABLE


def test_information_is_that_of_the_jacobian_and_the_preconditioner_is_close():
    rng = np.random.default_rng(3)
    for stored in (False, True):
        problem, _ = field(stored)
        at = problem.linearize_operator(0.1 * rng.standard_normal(60))
        jacobian = np.concatenate([at.forward(e)[None] for e in np.eye(60)]).T
        whole = np.concatenate([jacobian, problem.smoothness.toarray()])
        v = rng.standard_normal(60)
        assert at.information(v) == pytest.approx(whole.T @ whole @ v)
        assert at.squares == pytest.approx((whole**2).sum(axis=0))
        damping = 0.1 * at.squares
        solve = preconditioner(at, damping)
        system = whole.T @ whole + np.diag(damping)
        if stored:
            assert solve(system @ v) == pytest.approx(v, rel=1e-2, abs=1e-2)
        x, _, left = conjugate_gradients(lambda u, a=system: a @ u, system @ v, solve, 1e-10, 200)
        assert x == pytest.approx(v, rel=1e-6)
        assert left <= 1e-10


def test_conjugate_gradients_say_where_they_stopped():
    matrix = np.diag(np.arange(1.0, 31.0))
    _, count, left = conjugate_gradients(lambda v: matrix @ v, np.ones(30), lambda v: v, 1e-12, 3)
    assert count == 3
    assert 1e-12 < left < 1
    assert conjugate_gradients(lambda v: v, np.zeros(3), lambda v: v, 1e-6, 5)[0] == pytest.approx(np.zeros(3))


def test_draws_and_solved_deviations_that_do_not_converge_are_nan():
    problem, _ = field(False)
    at = problem.linearize_operator(problem.theta_start)
    broken = OperatorLinearization(at.residual, lambda v: at.forward(v) * np.nan, at.adjoint, at.data_squares, at.prior)
    made, missed = posterior_draws(broken, 2, np.random.default_rng(0))
    assert missed == 2
    assert np.isnan(made).all()
    assert np.isnan(solved_std(broken, 0))


def test_reason_for_a_search_without_jacobian_has_the_numbers():
    problem, _ = field(False)
    fits, words = dense_search_fits(len(problem.names), problem.n_data)
    assert fits
    assert "60 parameters and 25 data" in words
    fits, words = dense_search_fits(60, 25, dense_bytes=1000)
    assert not fits
    assert "more than" in words


def test_what_cannot_be_asked_for():
    problem, _ = field(False)
    with pytest.raises(InputError, match="`solved` must name parameters, got 'q'"):
        estimate(problem, MatrixFree(solved=("q",)))
    with pytest.raises(InputError, match="`draws` must be 0 or at least 2, got 1"):
        MatrixFree(draws=1)


@pytest.mark.parametrize("count", [4, 12])
def test_sketch_of_few_directions_only_costs_iterations(count, monkeypatch):
    problem, _ = field(False)
    exact = minimize(problem, EXACT)
    monkeypatch.setattr(linearization, "_SKETCHED", count)
    image, inner = problem.linearize_operator(np.zeros(60)).sketch
    assert image.shape == (60, count)
    assert inner.shape == (count, count)
    found = minimize(problem, EXACT)
    assert found.theta == pytest.approx(exact.theta, abs=1e-7)
    assert exact.inner.max() < found.inner.max() < 60


def test_whole_sketch_is_the_information_of_the_data():
    problem, _ = field(False)
    at = problem.linearize_operator(np.zeros(60))
    image, inner = at.sketch
    whole = problem.windows.T @ problem.windows
    assert image @ np.linalg.solve(inner, image.T) == pytest.approx(whole, rel=1e-6, abs=1e-8 * whole.max())

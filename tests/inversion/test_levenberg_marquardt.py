"""Levenberg-Marquardt with geodesic acceleration: curved valleys, units, badly conditioned problems."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from structid.core.errors import SingularModelError
from structid.inversion import DataRows, FreeUnknowns, LevenbergMarquardt, Linearization, Problem, minimize
from structid.inversion.linearization import solve_upper


@dataclass
class Residual(Problem):
    """Any residual with its Jacobian, in parameters times `unit`."""

    function: object
    jacobian: object
    start: np.ndarray
    unit: np.ndarray = 1.0
    evaluations: list = field(default_factory=list)

    @property
    def unknowns(self):
        return FreeUnknowns(tuple(f"p{i}" for i in range(len(self.start))), self.start)

    @property
    def rows(self):
        n_data = len(self.function(self.start / self.unit))
        return DataRows(np.arange(n_data), np.zeros(n_data, int))

    def residual(self, theta):
        self.evaluations.append(theta)
        return self.function(theta / self.unit)

    def linearize(self, theta):
        return Linearization(self.function(theta / self.unit), self.jacobian(theta / self.unit) / self.unit)


def banana(steep, unit=1.0):
    """A parabolic valley y = x^2 that is `steep` times as steep across as along, from (-1.2, 1) to (1, 1)."""
    return Residual(
        lambda p: np.array([steep * (p[1] - p[0] ** 2), 1 - p[0]]),
        lambda p: np.array([[-2 * steep * p[0], steep], [-1.0, 0.0]]),
        np.array([-1.2, 1.0]) * unit,
        unit,
    )


def test_acceleration_follows_a_narrow_curved_valley():
    """10^4 times as steep across: at least two times fewer iterations, and fewer residuals in all."""
    fast, plain = banana(1e4), banana(1e4)
    accelerated = minimize(fast, LevenbergMarquardt(max_iterations=5000))
    bare = minimize(plain, LevenbergMarquardt(max_iterations=5000, acceleration=0.0))
    for found in (accelerated, bare):
        assert found.converged
        assert found.theta == pytest.approx([1.0, 1.0], abs=1e-8)
    assert 2 * len(accelerated.costs) <= len(bare.costs)
    assert len(fast.evaluations) <= len(plain.evaluations)


def test_acceleration_costs_nothing_where_steps_keep_their_promise():
    """A mild curve, seen by the gain ratio; an exact straight fit, where the last refused steps bend by rounding only."""
    x = np.linspace(0, 1, 20)
    design = np.vander(x, 4)
    for function, jacobian, start in (
        (lambda p: np.exp(p[0] * x) - np.exp(0.5 * x), lambda p: (x * np.exp(p[0] * x))[:, None], np.array([0.4])),
        (lambda p: design @ (p - np.array([0.1, 0.7, 3.0, 9.0])), lambda p: design, np.ones(4)),
    ):
        evaluations = []
        for acceleration in (0.0, 0.75):
            curve = Residual(function, jacobian, start)
            assert minimize(curve, LevenbergMarquardt(acceleration=acceleration)).converged
            evaluations.append(len(curve.evaluations))
        assert evaluations[0] == evaluations[1]


@pytest.mark.parametrize("acceleration", [0.0, 0.75])
def test_the_path_does_not_depend_on_the_units(acceleration):
    """Units changed by powers of two, which round nothing: the same path to rounding."""
    unit = np.array([2.0**-30, 2.0**40])
    method = LevenbergMarquardt(acceleration=acceleration)
    first, second = minimize(banana(100.0), method), minimize(banana(100.0, unit), method)
    assert first.converged
    assert second.converged
    assert second.history / unit == pytest.approx(first.history, rel=1e-9, abs=1e-12)


def test_no_parameter_moves_by_more_than_its_largest_step():
    far = Residual(lambda p: np.array([p[0] - 1000.0, p[1] + 5.0]), lambda p: np.eye(2), np.array([1.0, 2.0]))
    found = minimize(far, LevenbergMarquardt(largest_step=0.5))
    assert found.theta == pytest.approx([1000.0, -5.0])
    largest = np.maximum.accumulate(np.abs(found.history), axis=0)
    assert (np.abs(np.diff(found.history, axis=0)) <= 0.5 * largest[:-1] * (1 + 1e-12)).all()
    assert len(found.costs) > 15


class Positive(Residual):
    """The same in the logarithms of positive parameters."""

    def physical(self, theta):
        return np.exp(theta)

    def slope(self, theta):
        return np.exp(theta)


def test_a_parameter_that_runs_to_zero_does_not_stop_the_others():
    """Data with one negative coefficient fitted by positive ones: that one goes to 0, the rest to its least squares."""
    x = np.linspace(0, 1, 60)
    design = np.column_stack([np.sin((k + 1) * 2.2 * x) for k in range(6)]) * np.array([1, 1, 1, 1, 1, 1e-3])
    data = design @ np.array([1.3, 0.6, 1.9, 0.8, 1.1, -40.0])
    best = np.linalg.lstsq(design[:, :5], data, rcond=None)[0]
    assert (best > 0).all()
    found = minimize(
        Positive(lambda t: design @ np.exp(t) - data, lambda t: design * np.exp(t), np.zeros(6)), LevenbergMarquardt()
    )
    assert found.converged
    assert np.exp(found.theta[:5]) == pytest.approx(best, rel=1e-4)
    assert np.exp(found.theta[5]) < 1e-3
    assert len(found.costs) < 60


def test_a_parameter_that_starts_at_zero_can_leave_it():
    found = minimize(Residual(lambda p: p - 3.0, lambda p: np.eye(1), np.zeros(1)), LevenbergMarquardt())
    assert found.theta == pytest.approx([3.0])


def test_condition_enters_once_and_not_squared():
    """Condition 1e9: the answer is good to 1e-6, where the normal equations hold no digit of it."""
    rng = np.random.default_rng(3)
    left, right = np.linalg.qr(rng.standard_normal((12, 4)))[0], np.linalg.qr(rng.standard_normal((4, 4)))[0]
    design = left @ np.diag([1.0, 1e-3, 1e-6, 1e-9]) @ right
    truth = np.array([1.0, 2.0, 3.0, 4.0])
    found = minimize(
        Residual(lambda p: design @ (p - truth), lambda p: design, 1.1 * truth), LevenbergMarquardt(largest_step=np.inf)
    )
    assert found.theta == pytest.approx(truth, abs=1e-6)
    assert np.linalg.cond(design.T @ design) > 1e15


@pytest.mark.parametrize("error", [SingularModelError, np.linalg.LinAlgError])
def test_a_region_where_the_model_is_singular_is_stepped_around(error):
    def guarded(p):
        if p[0] < 0.5:
            raise error("singular")
        return np.array([np.log(p[0]), 0.1 * (p[0] - 1)])

    found = minimize(Residual(guarded, lambda p: np.array([[1 / p[0]], [0.1]]), np.array([40.0])), LevenbergMarquardt())
    assert found.converged
    assert found.theta == pytest.approx([1.0])


@pytest.mark.parametrize("n_rows", [3, 5, 300, 2000, 2049])
def test_triangle_of_any_number_of_rows_has_their_products(n_rows):
    rng = np.random.default_rng(n_rows)
    at = Linearization(rng.normal(size=n_rows), rng.normal(size=(n_rows, 4)))
    rows, triangle = np.column_stack([at.jacobian, at.residual]), at.triangle()
    assert np.allclose(triangle.T @ triangle, rows.T @ rows)
    assert triangle.shape == (min(n_rows, 5), 5)
    assert not np.tril(triangle, -1).any()


@pytest.mark.parametrize("order", ["C", "F"])
def test_triangles_are_solved_to_the_digits_of_scipy(order):
    rng = np.random.default_rng(3)
    triangle = np.array(np.triu(rng.standard_normal((5, 5))) + 3 * np.eye(5), order=order)
    for right in (rng.standard_normal(5), rng.standard_normal((5, 3))):
        assert np.array_equal(solve_upper(triangle, right), solve_triangular(triangle, right))
        assert np.array_equal(solve_upper(triangle, right, transposed=True), solve_triangular(triangle, right, trans=1))
    triangle[2, 2] = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="entry 3"):
        solve_upper(triangle, np.ones(5))

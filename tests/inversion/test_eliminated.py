"""Problems whose linear unknowns are eliminated: what the search sees is what all rows would give."""

from itertools import pairwise

import numpy as np
import pytest

from structid.inversion import LevenbergMarquardt, minimize
from structid.inversion.eliminated_problem import EliminatedProblem, NormalEquations, minimize_eliminated


def test_compressed_rows_have_the_steps_and_the_sum_of_squares_of_all_rows():
    """Gauss-Newton step and sum of squares after it, against least squares of 40 rows: 1e-9 with columns a million apart."""
    rng = np.random.default_rng(1)
    jacobian = rng.standard_normal((40, 3)) * [1e-3, 1.0, 1e3]
    residual = rng.standard_normal(40)
    rows = NormalEquations(jacobian.T @ jacobian, jacobian.T @ residual, float(residual @ residual)).compressed()
    assert rows.jacobian.shape == (4, 3)
    step = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    np.testing.assert_allclose(-np.linalg.lstsq(rows.jacobian, rows.residual, rcond=None)[0], step, rtol=1e-9)
    for change in (0 * step, step, 2 * step):
        left = np.sum((residual + jacobian @ change) ** 2)
        assert np.sum((rows.residual + rows.jacobian @ change) ** 2) == pytest.approx(left, rel=1e-9)


def test_the_rate_of_a_decay_is_that_of_the_search_over_rate_and_amplitude():
    """y = a exp(-b t) + 0.01 sin 9 t with a eliminated ends at the stationary point of both unknowns: gradient 1e-9."""
    t = np.linspace(0.0, 3.0, 60)
    y = 2.0 * np.exp(-1.3 * t) + 0.01 * np.sin(9 * t)

    def parts(change):
        shape = np.exp(-(1.0 + change[0]) * t)
        amplitude = shape @ y / (shape @ shape)
        slope = -t * shape * amplitude
        along = shape / np.linalg.norm(shape)
        return amplitude, amplitude * shape - y, slope - along * (along @ slope)

    def normal(change):
        _, residual, slope = parts(change)
        return NormalEquations(np.array([[slope @ slope]]), np.array([slope @ residual]), float(residual @ residual))

    problem = EliminatedProblem(np.array([1.0]), lambda change: normal(change).cost, normal)
    end = minimize(problem, LevenbergMarquardt(gain_tolerance=1e-18))
    assert end.converged
    change = problem.changes(end.theta)
    amplitude, residual, _ = parts(change)
    jacobian = np.stack([np.exp(-(1.0 + change[0]) * t), -amplitude * t * np.exp(-(1.0 + change[0]) * t)])
    assert np.abs(jacobian @ residual).max() <= 1e-9
    assert 1.0 + change[0] == pytest.approx(1.3, abs=0.02)


def test_a_search_does_not_go_where_there_is_no_model():
    problem = EliminatedProblem(
        np.array([1.0]),
        lambda change: np.inf if change[0] > 0.5 else float((change[0] - 2.0) ** 2),
        lambda change: NormalEquations(np.ones((1, 1)), change - 2.0, float((change[0] - 2.0) ** 2)),
    )
    end = minimize(problem, LevenbergMarquardt(max_iterations=30, acceleration=0.0))
    assert 0.4 <= problem.changes(end.theta)[0] <= 0.5


def line(slopes, made):
    """Least squares of a straight line whose columns have these lengths, from 0 to a minimum at 2; each call is told to `made`."""

    def normal(changes):
        made.append(changes.copy())
        residual = slopes * (changes - 2.0)
        return NormalEquations(np.diag(slopes**2), slopes * residual, float(residual @ residual))

    return EliminatedProblem(
        np.ones(len(slopes)), lambda changes: float(np.sum((slopes * (changes - 2.0)) ** 2)), normal
    )


def test_the_changes_to_the_minimum_are_found_and_no_equations_are_made_twice_in_a_row():
    made = []
    changes, has_converged = minimize_eliminated(
        line(np.array([1.0, 30.0]), made), LevenbergMarquardt(largest_step=10.0, acceleration=0.0)
    )
    assert has_converged
    assert changes == pytest.approx([2.0, 2.0], rel=1e-6)
    assert not np.any(made[0])
    assert all((first != second).any() for first, second in pairwise(made))


@pytest.mark.parametrize("slope", [0.0, np.inf, np.nan])
def test_unknowns_without_an_effect_at_the_start_are_not_searched_for(slope):
    assert minimize_eliminated(line(np.array([1.0, slope]), []), LevenbergMarquardt(acceleration=0.0)) is None

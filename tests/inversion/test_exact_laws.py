"""Degrees of freedom and strengths by their definition."""

import numpy as np
import pytest
from fit_cases import line_case

from structid import estimate
from structid.inversion.covariance import chi_square_law
from structid.inversion.problem import RowNoise
from structid.unknowns.priors import Coupling


def test_chi_square_has_as_many_degrees_of_freedom_as_rows_beyond_parameters():
    problem = line_case(np.random.default_rng(0).standard_normal(12))
    at = problem.linearize(problem.theta_start)
    assert chi_square_law(problem, problem.theta_start, at) == (1.0, 10.0)
    answer = estimate(problem)
    residual = problem.residual(answer.theta)
    assert answer.goodness.degrees_of_freedom == 10
    assert answer.chi_square_per_dof == pytest.approx(residual @ residual / 10, rel=1e-12)


@pytest.mark.parametrize("n_changes", [5, 40])
def test_chi_square_of_errors_that_vary_together_has_their_mean_and_variance(n_changes, monkeypatch):
    """For normal errors of covariance S past the projection P: mean tr(PS), variance 2 tr(PSPS)."""
    problem = line_case(np.zeros(12))
    changes = np.random.default_rng(1).standard_normal((n_changes, 12))
    monkeypatch.setattr(type(problem), "noise_law", lambda self, theta: RowNoise(factor=changes))
    at = problem.linearize(problem.theta_start)
    scale, freedom = chi_square_law(problem, problem.theta_start, at)
    projection = np.eye(12) - at.jacobian @ np.linalg.pinv(at.jacobian)
    product = projection @ changes.T @ changes
    assert scale * freedom == pytest.approx(np.trace(product), rel=1e-10)
    assert 2 * scale**2 * freedom == pytest.approx(2 * np.trace(product @ product), rel=1e-10)


def test_a_strength_multiplies_the_information_of_rows():
    rows = Coupling("rows", np.array([[1.0, -1.0, 0.0], [0.0, 2.0, 1.0]]), np.array([0.5, -1.0]))
    stronger = rows.scaled(np.array([4.0, 9.0]))
    matrix = stronger.rows(np.ones(3))[1]
    np.testing.assert_allclose(matrix.T @ matrix, rows.matrix.T @ np.diag([4.0, 9.0]) @ rows.matrix, rtol=1e-14)
    np.testing.assert_allclose(stronger.residual(np.ones(3)) ** 2, [4 * 0.25, 9 * 16.0], rtol=1e-14)

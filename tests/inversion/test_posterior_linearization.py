"""Posterior linearization: exact where the residual is linear, past wrong minima where it waves."""

import numpy as np
import pytest
from fit_cases import Case, line_case

from structid import LevenbergMarquardt
from structid.core.errors import SingularModelError
from structid.inversion import minimize
from structid.inversion.search.posterior_linearization import posterior_linearized

WAVE_NUMBER, SIGMA = 3.0, 0.05


def waves(x, p):
    return p[1] * np.cos(p[0] * x)


def waves_slope(x, p):
    return np.stack([-p[1] * x * np.sin(p[0] * x), np.cos(p[0] * x)], axis=1)


class Waves(Case):
    """Fails above a wave number where there is a `limit`."""

    limit = np.inf

    def residual(self, theta):
        if self.physical(theta)[0] > self.limit:
            raise SingularModelError("too short")
        return super().residual(theta)


def wave(seed, off=0.3):
    """Ten periods of a wave in sixty rows, wave number and height off at random."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.2, 20, 60)
    y = waves(x, (WAVE_NUMBER, 1.0)) + SIGMA * rng.standard_normal(len(x))
    start = np.array([WAVE_NUMBER, 1.0]) * np.exp(off * rng.standard_normal(2))
    return Waves(waves, waves_slope, x, y, tuple(start), ("log", "log"), SIGMA)


def fits(problem, theta):
    return minimize(problem, LevenbergMarquardt(), theta).costs[-1] < 2 * problem.n_data


def test_of_a_line_it_is_the_posterior_of_tempered_data():
    problem = line_case(0.1 * np.random.default_rng(0).standard_normal(30))
    at = problem.linearize(problem.theta_start)
    spread = 0.5 * np.abs(problem.theta_start)
    precision = at.jacobian.T @ at.jacobian / 3 + np.diag(spread**-2)
    expected = problem.theta_start - np.linalg.solve(precision, at.jacobian.T @ at.residual / 3)
    assert (np.abs(expected - problem.theta_start) < 2 * spread).all()
    assert posterior_linearized(problem, problem.theta_start, 0.5) == pytest.approx(expected, rel=1e-9)


def test_a_wave_is_found_among_wrong_minima():
    cases = [wave(seed) for seed in range(20)]
    assert sum(fits(case, case.theta_start) for case in cases) < 8
    found = [posterior_linearized(case, case.theta_start, 0.5) for case in cases]
    assert all(fits(case, theta) for case, theta in zip(cases, found, strict=True))


def test_draws_without_a_model_are_left_out():
    problem = wave(4)
    problem.limit = 1.2 * WAVE_NUMBER
    assert fits(problem, posterior_linearized(problem, problem.theta_start, 0.5))
    problem.limit = 0.0
    assert posterior_linearized(problem, problem.theta_start, 0.5) == pytest.approx(problem.theta_start, rel=0)


def test_the_same_seed_gives_the_same_bits_and_each_round_is_told():
    problem, told = wave(5), []
    first = posterior_linearized(problem, problem.theta_start, 0.5, 1, lambda *at: told.append(at))
    assert (first == posterior_linearized(problem, problem.theta_start, 0.5, 1)).all()
    assert [count for count, _ in told] == list(range(len(told)))
    assert told[-1][1] < told[0][1]

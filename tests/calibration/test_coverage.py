"""Coverage of 95 % intervals: the small form of benchmarks/accuracy/interval_coverage.py, seeds 0 on, every repeat counted."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "accuracy" / "interval_coverage.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("coverage_benchmark", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def covered(benchmark, case, repeats):
    """Part of the intervals of each row that hold the truth."""
    results = [benchmark.CASES[case].repeat(seed) for seed in range(repeats)]
    return {row: float(np.mean([result[row][0] for result in results])) for row in results[0]}


@pytest.mark.parametrize(
    ("case", "repeats", "slack"), [("frf", 20, 0.05), ("motion", 20, 0.05), ("near", 80, 0.07), ("weak", 80, 0.07)]
)
def test_intervals_cover(benchmark, case, repeats, slack):
    """Within 95 % -/+ about three binomial deviations: 120 correlated intervals of 20 repeats, or one a repeat of 120."""
    found = covered(benchmark, case, repeats)
    row = {"frf": "frf", "motion": "motion-force", "near": "near-profile", "weak": "weak-profile"}[case]
    assert 0.95 - slack <= found[row] <= min(0.95 + slack, 0.995), found


def test_covariance_that_carries_model_error_covers_and_that_of_the_noise_does_not(benchmark):
    found = covered(benchmark, "error", 15)
    assert found["error-model"] >= 0.85
    assert found["error-noise"] <= 0.5


def test_jacobian_of_the_oscillator_is_its_difference_quotient(benchmark):
    problem = benchmark.oscillator(benchmark.NOMINAL, 0.1, np.random.default_rng(0), (2.0, 5.0), 0.2)
    theta = problem.theta_start + 0.1
    numbers = np.stack(
        [(problem.residual(theta + e) - problem.residual(theta - e)) / 2e-6 for e in 1e-6 * np.eye(3)], axis=1
    )
    jacobian = problem.linearize(theta).jacobian
    assert np.abs(jacobian - numbers).max() <= 1e-6 * np.abs(jacobian).max()

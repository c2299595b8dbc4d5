"""Coverage of the 95 % intervals on a twin of the measured frame: the small form of benchmarks/accuracy/frame_twin.py."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "accuracy" / "frame_twin.py"
STRIDE = 8


@pytest.mark.parametrize(
    ("repeats", "low", "high", "of_chi_square"),
    [(10, 0.87, 0.995, 0.036), pytest.param(30, 0.90, 0.99, 0.02, marks=pytest.mark.long)],
)
def test_intervals_of_the_frame_twin_cover(repeats, low, high, of_chi_square):
    """Repeats of 15 parameters, seeds 0 on, starts 10 % off, every one counted: 450 intervals of 30, 15 of a repeat correlated.

    The binomial deviation of the mean coverage of 30 is 1.0 % for independent intervals and about twice that for these:
    limits are 95 % -/+ 5 %, of 10 repeats -/+ 8 %. The mean of chi-square per degree of freedom (72,000 rows of 30 repeats,
    deviation 0.5 %) is 1 within four deviations.
    """
    spec = importlib.util.spec_from_file_location("frame_twin", BENCHMARK)
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    results = [benchmark.repeat((seed, STRIDE), spread=0.1) for seed in range(repeats)]
    inside = np.abs([r[0] for r in results]) <= 1.959964
    chi = np.array([r[2] for r in results])
    assert all(r[3] == "converged" for r in results)
    assert low <= inside.mean() <= high
    assert abs(chi.mean() - 1) <= of_chi_square

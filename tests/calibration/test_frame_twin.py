"""Coverage of the 95 % intervals on a twin of the measured frame: the small form of benchmarks/accuracy/frame_twin.py."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "accuracy" / "frame_twin.py"
STRIDE = 8


@pytest.mark.long
def test_intervals_of_the_frame_twin_cover():
    """30 repeats of 15 parameters, seeds 0 on, starts 10 % off, every one counted: 450 intervals, 15 of a repeat correlated.

    The binomial deviation of the mean coverage is 1.0 % for independent intervals and about twice that for these: limits are
    95 % -/+ 5 %. The mean of chi-square per degree of freedom (72,000 rows, deviation 0.5 %) is 1 within four deviations.
    """
    spec = importlib.util.spec_from_file_location("frame_twin", BENCHMARK)
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    results = [benchmark.repeat((seed, STRIDE), spread=0.1) for seed in range(30)]
    inside = np.abs([r[0] for r in results]) <= 1.959964
    chi = np.array([r[2] for r in results])
    assert all(r[3] == "converged" for r in results)
    assert 0.90 <= inside.mean() <= 0.99
    assert abs(chi.mean() - 1) <= 0.02

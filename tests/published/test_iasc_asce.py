"""The IASC-ASCE benchmark, phase I, in small: its frame, and what is found from the first seconds of its records."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from structid import parse_dof

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "benchmarks" / "accuracy" / "iasc_asce.py"
RECORDS = ROOT.parent / "shared" / "data" / "iasc_asce_phase_1"
pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="benchmarks are not part of the distribution")


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("iasc_asce", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["iasc_asce"] = module
    spec.loader.exec_module(module)
    return module


def matrices(benchmark, case):
    frame = benchmark.frame(case)
    rows = [frame.dofs.index(parse_dof(f"{10 * f + 10}{d}")) for f in range(1, 5) for d in ("X", "Y", "RZ")]
    return [frame.matrix(kind, frame.values).toarray()[np.ix_(rows, rows)] for kind in ("mass", "stiffness")]


def test_the_frame_has_the_frequencies_that_were_published(benchmark):
    mass, stiffness = matrices(benchmark, 3)
    frequency = np.sqrt(linalg.eigh(stiffness, mass, eigvals_only=True)) / (2 * np.pi)
    published = [9.411, 11.791, 16.383, 25.545, 32.006, 38.663, 44.643, 48.007]
    np.testing.assert_allclose(frequency[:8], published, atol=6e-4)
    lost = benchmark.LOST
    assert [round(100 * lost[1][1, axis], 2) for axis in "xy"] == [45.24, 71.03]
    assert [round(100 * lost[4][key], 2) for key in ((1, "y"), (3, "x"))] == [17.76, 11.31]
    assert round(100 * lost[6][1, "y"], 2) == 5.92


@pytest.mark.parametrize("case", [3, 4])
def test_the_matrices_are_those_of_the_generating_program(benchmark, case):
    path = RECORDS / f"c{case}_matrices_p0.npz"
    if not path.exists():
        pytest.skip("the benchmark's numbers are kept outside the package")
    with np.load(path) as file:
        for own, name in zip(matrices(benchmark, case), ("M", "K"), strict=True):
            np.testing.assert_allclose(own, file[name], atol=1e-6 * np.abs(file[name]).max())


def test_storeys_and_losses_from_three_seconds(benchmark):
    if not RECORDS.exists():
        pytest.skip("the benchmark's numbers are kept outside the package")
    healthy = benchmark.identified(3, benchmark.record(RECORDS, 3, 0, 1500))
    hurt = benchmark.identified(3, benchmark.record(RECORDS, 3, 3, 1500))
    for pattern, found in ((0, healthy), (3, hurt)):
        assert found.estimate.status.value == "converged"
        one = benchmark.judged(3, pattern, found, healthy)
        assert np.abs(one.error).max() < 0.002
        assert np.abs(one.loss_error).max() < 0.002
        assert one.is_right
    lost = {key: 1 - hurt.faces[key][0] / healthy.faces[key][0] for key in hurt.faces}
    assert max(lost, key=lambda key: lost[key]) == (1, 2)  # storey 1, the face x = 2.5
    assert abs(hurt.estimate.values[-1] - benchmark.DAMPING_RATIO) < 4 * hurt.estimate.std[-1]


@pytest.mark.long
def test_intervals_hold_the_truth_over_noise_of_other_seeds(benchmark, capsys):
    if not RECORDS.exists():
        pytest.skip("the benchmark's numbers are kept outside the package")
    benchmark.repeated(RECORDS, [1], 600, 12)
    words = capsys.readouterr().out
    covered = float(words.partition("intervals cover ")[2].partition(" %")[0])
    assert 83 <= covered <= 100  # of 48 values, correlated among four storeys

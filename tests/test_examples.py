"""Every example script runs, and gives its pinned number."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    ("script", "name", "value", "deviations"),
    [
        ("added_mass.py", "mass[outer]", 1.2, 4.0),
        ("cantilever.py", "bending_stiffness[beam:4]", 8.0, 4.0),
        ("own_matrices.py", "stiffness[upper]", 0.9, 4.0),
    ],
)
def test_example_finds_its_truth(script, name, value, deviations):
    found = runpy.run_path(str(EXAMPLES / script))["main"]().estimate
    estimated, std = found[name]
    assert abs(estimated - value) <= deviations * std
    assert std <= 0.02 * value
    assert found.covariance_basis == "noise"


def test_every_script_is_tried():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {"added_mass.py", "cantilever.py", "own_matrices.py"}

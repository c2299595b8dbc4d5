"""Steps of discrete systems, taken one by one or in stretches side by side."""

import numpy as np
import pytest

from structid.dynamics import exact_discretization
from structid.dynamics.exact_discretization import stepped


@pytest.mark.parametrize("shape", [(6,), (6, 1), (6, 4)])
@pytest.mark.parametrize("n_steps", [0, 1, 99, 100, 128, 1001])
@pytest.mark.parametrize("radius", [0.98, 1.02])
def test_stretches_side_by_side_equal_steps_one_by_one(shape, n_steps, radius):
    rng = np.random.default_rng(0)
    transition = rng.standard_normal((6, 6))
    transition *= radius / np.abs(np.linalg.eigvals(transition)).max()
    drive, state = rng.standard_normal((n_steps, *shape)), rng.standard_normal(shape)
    found = stepped(transition, drive, state)
    assert found.shape == (n_steps + 1, *shape)
    for k in range(n_steps + 1):
        assert found[k] == pytest.approx(state, rel=1e-9, abs=1e-11 * np.abs(found[: k + 1]).max())
        if k < n_steps:
            state = transition @ state + drive[k]


def test_long_steps_are_taken_one_by_one(monkeypatch):
    rng = np.random.default_rng(0)
    transition, drive, start = rng.standard_normal((9, 9)) / 9, rng.standard_normal((200, 9, 2)), np.zeros((9, 2))
    together = stepped(transition, drive, start)
    monkeypatch.setattr(exact_discretization, "_step_in_blocks", None)
    monkeypatch.setattr(exact_discretization, "_MOST_WORK", 100)
    assert stepped(transition, drive, start) == pytest.approx(together, rel=1e-10, abs=1e-12)

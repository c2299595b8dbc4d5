"""Free decays in closed form against the exponential of the state matrix."""

import numpy as np
import pytest
from scipy.linalg import expm

from structid.dynamics.transient import free_decay


@pytest.mark.parametrize("omega, ratio", [(3.0, 0.3), (5.0, 0.0), (0.0, 0.0)])
def test_a_damped_mode_moves_as_its_state_matrix_says(omega, ratio):
    time, start = np.array([0.0, 0.2, 1.1, 2.7]), np.array([0.7, -1.3])
    state = np.array([[0.0, 1.0], [-(omega**2), -2 * ratio * omega]])
    expected = np.array([expm(state * t) @ start for t in time])
    shape = np.array([[2.0], [-0.5]])
    found = free_decay(np.array([omega]), shape, time, start[0], start[1], ratio)
    np.testing.assert_allclose(found.displacement, expected[:, :1] @ shape.T, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(found.velocity, expected[:, 1:] @ shape.T, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(found.acceleration, (expected @ state[1])[:, None] @ shape.T, rtol=1e-12, atol=1e-12)

"""What tests of modes as a least-squares problem have in common: slopes by differences, and errors of sensors."""

from types import SimpleNamespace

import numpy as np

from structid import channel_errors


def require_exact_slope(problem, theta, tolerance=1e-6):
    alone = problem.residual(theta)  # found without slopes
    at = problem.linearize(theta)
    assert np.abs(at.residual - alone).max() <= 1e-9 * np.abs(alone).max()
    assert problem.n_data == len(problem.rows.lines) == len(problem.rows.series)
    step = 1e-5
    for j, unit in enumerate(np.eye(len(theta))):
        sides = [problem.residual(theta + sign * step * unit) for sign in (1, -1)]
        change = (sides[0] - sides[1]) / (2 * step)
        assert np.abs(at.jacobian[:, j] - change).max() < tolerance * np.abs(at.jacobian).max()


def gradient_errors(problem, theta):
    """Gradient of the sum of squares, and by differences."""
    at = problem.linearize(theta)
    step = 1e-6
    sums = [[np.sum(problem.residual(theta + s * step * u) ** 2) for s in (1, -1)] for u in np.eye(len(theta))]
    return 2 * at.jacobian.T @ at.residual, np.diff(sums, axis=1)[:, 0] / (-2 * step)


def gains(record, *unknowns):
    """Errors of the sensors of modes."""
    sensors = SimpleNamespace(outputs=record.channels, inputs=(), frequency=record.frequency)
    return channel_errors(sensors, unknowns)

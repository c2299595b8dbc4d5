"""Small formulas of an identification on numbers that have their answer in closed form."""

import numpy as np
import pytest

from structid import TimeRecord
from structid.core.dof import parse_dof
from structid.diagnose.checks.mesh import _limit
from structid.identification.ratios import _std
from structid.identification.record_fit import peaks
from structid.identification.setups.time import _frfs_of_hit, _Hit


@pytest.mark.parametrize("power", [2.0, 3.0, 4.0])
def test_frequencies_that_err_by_a_power_of_the_length_have_their_limit_exactly(power):
    limit, error = np.array([2.0, 5.0]), np.array([0.1, 0.4])
    coarse, fine, finest = (limit * (1 + error * part**power) for part in (1.0, 0.5, 0.25))
    found, order = _limit(coarse, [fine, finest])
    np.testing.assert_allclose(found, limit, rtol=1e-12)
    np.testing.assert_allclose(order, power, rtol=1e-10)


def test_a_peak_that_is_a_parabola_of_logarithms_is_found_between_its_lines():
    frequency = np.arange(1.0, 9.0, 0.25)
    values = -1j * np.exp(-2.0 * (frequency - 4.08) ** 2)[:, None, None]
    np.testing.assert_allclose(peaks(frequency, values, "receptance"), [4.08], rtol=1e-12)


def test_deviation_of_a_ratio_is_that_of_the_difference_of_logarithms():
    """The data do not see the sum: the covariance is the pseudo-inverse of the information."""
    jacobian = np.random.default_rng(0).standard_normal((20, 4))
    jacobian -= jacobian.mean(axis=1, keepdims=True)
    _, singular, rows = np.linalg.svd(jacobian)
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    for i in (1, 2, 3):
        variance = covariance[i, i] + covariance[0, 0] - 2 * covariance[i, 0]
        assert _std(i, 0, singular, rows) == pytest.approx(np.sqrt(variance), rel=1e-10)


def test_variance_of_an_frf_of_a_hit_is_that_of_noise_of_motion_and_force():
    """H = Y / F errs by (dY - H dF) / F; noise of a transform is the noise times the squares of its row."""
    rate, n, first, last = 100.0, 400, 10, 14
    rng = np.random.default_rng(1)
    force = np.zeros(n)
    force[first:last] = [20.0, 50.0, 40.0, 10.0]
    time = np.arange(n) / rate
    motion = np.exp(-0.3 * time) * np.sin(30.0 * time) + 1e-3 * rng.standard_normal(n)
    record = TimeRecord(
        rate, np.stack([force, motion], axis=1), ["1X", "2X"], ["force", "acceleration"], variance=[0.5, 1e-6]
    )
    frf = _frfs_of_hit(record, _Hit(0, first, last), [parse_dof("2X")])
    count = n - first
    row = np.exp(-np.outer(frf.laplace, np.arange(count)) / rate)
    given, seen = row[:, : last - first] @ force[first:last], row @ motion[first:]
    of_motion = 1e-6 * np.sum(np.abs(row) ** 2, axis=1)
    of_force = 0.5 * np.sum(np.abs(row[:, : last - first]) ** 2, axis=1)
    np.testing.assert_allclose(frf.values[:, 0, 0], seen / given, rtol=1e-9)
    expected = (of_motion + np.abs(seen / given) ** 2 * of_force) / np.abs(given) ** 2
    np.testing.assert_allclose(frf.variance[:, 0, 0], expected, rtol=1e-9)

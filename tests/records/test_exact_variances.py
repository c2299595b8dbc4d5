"""Variances that records carry are those of the textbook to rounding: a factor of a per cent shows."""

import numpy as np
import pytest

from structid.records import FrfRecord, TimeRecord, frf_from_time
from structid.records.half_plane import _integrate, poisson_weights
from structid.records.preparation import Preparation, prepare
from structid.records.record import coherence_variance, from_repeats

RATE, SEGMENT = 64.0, 32


@pytest.mark.parametrize("n_inputs", [1, 2])
def test_variance_of_h1_is_that_of_least_squares_over_segments(rng, n_inputs):
    """Y = H X over n segments is a regression: its covariance is (X X^H)^-1 times the residual's square over n - q."""
    n_segments, noise = 9, 0.4
    x = rng.normal(size=(n_segments * SEGMENT, n_inputs))
    y = x @ np.array([1.0, -0.6])[:n_inputs] + noise * rng.normal(size=len(x))
    loads = [f"{i + 1}X" for i in range(n_inputs)]
    record = TimeRecord(RATE, np.column_stack([x, y]), [*loads, "9X"], ["force"] * n_inputs + ["acceleration"])
    frf = frf_from_time(record, loads, ["9X"], "H1", SEGMENT, 0.0, "boxcar", detrend="none")
    lines = np.fft.rfft(np.column_stack([x, y]).reshape(n_segments, SEGMENT, -1), axis=1)
    for k in range(len(frf.frequency)):
        given, seen = lines[:, k, :n_inputs], lines[:, k, n_inputs]
        gain, square, *_ = np.linalg.lstsq(given, seen, rcond=None)
        variance = np.diag(np.linalg.inv(given.conj().T @ given)).real * float(square[0]) / (n_segments - n_inputs)
        explained = 1 - float(square[0]) / float(np.sum(np.abs(seen) ** 2))
        np.testing.assert_allclose(frf.values[k, 0], gain, rtol=1e-10)
        np.testing.assert_allclose(frf.variance[k, 0], variance, rtol=1e-9)
        np.testing.assert_allclose(frf.coherence[k, 0], explained, rtol=1e-9)


def test_variance_of_coherence_is_that_of_bendat_and_piersol():
    """|H| errs by sqrt(1 - g2) / (g sqrt(2 n)) of itself, Eq. (9.90); the complex value has twice the variance of one part."""
    coherence, n, size = np.array([0.99, 0.9, 0.5]), 25, np.array([2.0, 1.0, 0.1])
    deviation = size * np.sqrt(1 - coherence) / np.sqrt(coherence * 2 * n)
    found = coherence_variance(size * np.exp(0.3j), coherence, n)
    np.testing.assert_allclose(found, 2 * deviation**2, rtol=1e-12)


def frf(values, kind="accelerance", variance=None):
    return FrfRecord(np.array([2.0, 5.0]), values, ["1X"], ["2X"], kind, variance=variance)


def test_variance_of_repeats_is_that_of_their_mean():
    values = np.random.default_rng(3).normal(size=(2, 12, 2, 1, 1))
    values = values[0] + 1j * values[1]
    mean = from_repeats([frf(one) for one in values])
    centred = values - values.mean(axis=0)
    np.testing.assert_allclose(mean.variance, np.sum(np.abs(centred) ** 2, axis=0) / (11 * 12), rtol=1e-12)


def test_accelerance_is_receptance_times_minus_omega_squared():
    values = np.array([1.0 + 2j, -3.0 + 0.5j]).reshape(2, 1, 1)
    receptance = frf(values, variance=np.full((2, 1, 1), 0.04)).as_kind("receptance")
    square = (2 * np.pi * np.array([2.0, 5.0]).reshape(2, 1, 1)) ** 2
    np.testing.assert_allclose(receptance.values, -values / square, rtol=1e-13)
    np.testing.assert_allclose(receptance.variance, 0.04 / square**2, rtol=1e-13)


@pytest.mark.parametrize("detrend, terms", [("none", 0), ("mean", 1), ("linear", 2), (3, 4)])
def test_noise_loses_a_degree_of_freedom_for_each_term_of_a_trend(rng, detrend, terms):
    """The projection past a trend of so many terms has the trace n - terms."""
    record = TimeRecord(100.0, rng.normal(size=(50, 1)), ["1X"], ["velocity"], variance=[0.3])
    left = prepare(record, Preparation(detrend=detrend, outliers="none", dropouts="none")).record
    np.testing.assert_allclose(left.variance, 0.3 * (50 - terms) / 50, rtol=1e-12)


def test_noise_right_of_the_axis_is_that_of_real_and_imaginary_parts_on_their_way():
    """The integral is linear in both parts of each line: unit values show its weights, of which noise takes the squares."""
    frequency, s = np.linspace(0.1, 2.0, 40), np.array([3.0 + 1.5j, 1.0 + 6.0j])
    weights = poisson_weights(2 * np.pi * frequency, s)
    variance = np.linspace(0.5, 1.5, 40)

    def integral(values, variance=None):
        record = FrfRecord(frequency, values.reshape(-1, 1, 1), ["1X"], ["1X"], "receptance", variance=variance)
        integrated, error = _integrate([record] * 3, s, [weights] * 3)
        return integrated[:, 0, 0], error[:, 0, 0]

    ones = np.ones(40, dtype=complex)
    noise = integral(ones, variance[:, None, None])[1] - integral(ones)[1]
    of_parts = [np.array([integral(unit * row)[0] for row in np.eye(40)]) for unit in (1.0 + 0j, 1j)]
    expected = sum(variance / 2 @ np.abs(part) ** 2 for part in of_parts)
    np.testing.assert_allclose(noise, expected, rtol=1e-9)

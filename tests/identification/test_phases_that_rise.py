"""FRFs whose imaginary parts have the other sign are told by their phases, without a driving point."""

import numpy as np
import pytest

from structid.identification.setups.setup import record_warnings
from structid.records import FrfRecord


def record(values, frequency):
    return FrfRecord(frequency, values[:, :, None], ["2X", "3X-"], ["1X"], "mobility")


@pytest.mark.parametrize("count", [99, 400])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_conjugate_responses_are_told_from_those_that_follow_their_forces(count, noise):
    rng = np.random.default_rng(0)
    omega = 2 * np.pi * np.linspace(2, 60, count)
    natural, ratio, parts = np.array([60.0, 150, 290]), 0.02, np.array([[1, -0.5, 0.2], [0.4, 1, -0.7]])
    poles = natural**2 - omega[:, None] ** 2 + 2j * ratio * natural * omega[:, None]
    values = 1j * omega[:, None] * (parts[None] / poles[:, None]).sum(axis=2)
    size = np.sqrt(np.mean(np.abs(values) ** 2))
    values = values + noise * size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    frequency = omega / (2 * np.pi)
    assert record_warnings(record(values, frequency)) == ()
    told = record_warnings(record(values.conj(), frequency))
    assert (len(told) == 1 and "exp(-i omega t)" in told[0]) == (count >= 100)


def test_noise_alone_turns_neither_way():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((400, 2)) + 1j * rng.standard_normal((400, 2))
    assert record_warnings(record(values, np.linspace(1, 50, 400))) == ()

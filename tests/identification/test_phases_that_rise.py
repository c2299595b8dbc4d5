"""What is said of FRFs by themselves: imaginary parts of the other sign, without a driving point, and coherence."""

from dataclasses import replace

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


def test_sensors_of_low_coherence_are_named_in_one_warning():
    coherence = np.full((10, 3, 1), 0.99)
    coherence[:3, 0], coherence[:4, 1], coherence[:2, 2] = 0.5, 0.5, 0.5
    values = np.ones((10, 3, 1), dtype=complex)
    frf = FrfRecord(np.linspace(1, 2, 10), values, ["2X", "3X", "4X"], ["1X"], "mobility", coherence=coherence)
    assert record_warnings(frf) == ("coherence of 2X+, 3X+ is below 0.8 at up to 40 % of the lines",)
    alone = replace(frf, coherence=np.where(np.arange(3)[:, None] == 1, coherence, 1.0))
    assert record_warnings(alone) == ("coherence of 3X+ is below 0.8 at 40 % of the lines",)

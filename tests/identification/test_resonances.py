"""Peaks of a record beside those of a model."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from structid import FrfRecord, TimeRecord
from structid.identification.record_fit import prominent, resonances
from structid.identification.setups.time import frfs_of

FREQUENCY = np.arange(1.0, 30.0, 0.05)


def accelerance(*natural):
    f = FREQUENCY[:, None]
    return (-(f**2) / (np.array(natural) ** 2 - f**2 + 0.02j * np.array(natural) ** 2)).sum(axis=1)[:, None, None]


@pytest.mark.parametrize("kind", ["accelerance", "mobility", "receptance"])
def test_peaks_are_found_and_paired(kind):
    factor = (2j * np.pi * FREQUENCY[:, None, None]) ** {"accelerance": 0, "mobility": -1, "receptance": -2}[kind]
    record = FrfRecord(FREQUENCY, accelerance(5.0, 12.0, 20.0) * factor, ("1X",), ("1X",), kind)
    found = resonances(record, accelerance(5.1, 11.8, 28.0) * factor)
    assert [r.measured for r in found] == pytest.approx([5.0, 12.0, 20.0], rel=2e-3)
    assert [r.predicted for r in found[:2]] == pytest.approx([5.1, 11.8], rel=2e-3)
    assert np.isnan(found[2].predicted)


def test_a_peak_of_the_model_need_not_stand_out_like_one_of_noise():
    """A measured peak that stands out threefold: the model's, which stands out less, is paired, and not one 8 % away."""
    measured, weaker = (accelerance(10.0, 11.0) + weight * accelerance(12.0) for weight in (0.3, 0.2))
    record = FrfRecord(FREQUENCY, measured, ("1X",), ("1X",), "accelerance")
    found = resonances(record, weaker)
    assert len(found) == 3
    assert [r.predicted for r in found] == pytest.approx([r.measured for r in found], rel=2e-3)


def test_a_smooth_record_has_none():
    record = FrfRecord(FREQUENCY, np.ones((len(FREQUENCY), 1, 1)) * (1 + 0.1j), ("1X",), ("1X",), "accelerance")
    assert resonances(record, record.values) == ()


def test_prominent_maxima_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(200):
        level = np.cumsum(rng.standard_normal(120))
        np.testing.assert_array_equal(prominent(level, 2.5), find_peaks(level, prominence=2.5)[0])


@pytest.mark.parametrize("noise", [0.01, None])
def test_averaged_responses_end_where_the_force_sinks_into_its_noise(noise):
    """Force from 5 to 20 Hz; its noise, where it is known, tells what is driven."""
    rng, rate, n = np.random.default_rng(4), 100.0, 4000
    spectrum = np.fft.rfft(rng.standard_normal(n))
    frequency = np.fft.rfftfreq(n, 1 / rate)
    spectrum[(frequency < 5) | (frequency > 20)] = 0
    force = np.fft.irfft(spectrum, n)
    clean = np.column_stack([force / force.std(), np.roll(force, 3)])
    values = clean + 0.01 * rng.standard_normal(clean.shape)
    variance = None if noise is None else np.full(2, noise**2)
    record = TimeRecord(rate, values, ("1X+", "2X+"), ("force", "acceleration"), variance=variance)
    shown = frfs_of(record).frequency
    if noise is None:
        assert shown[-1] == 50
    else:
        assert shown[[0, -1]] == pytest.approx([5, 20], abs=0.3)

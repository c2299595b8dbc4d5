"""Finite Fourier transforms of a time record: values, noise and refusals."""

import numpy as np
import pytest

from structid import InputError, TimeRecord
from structid.records.spectra import finite_spectra


def sine_record(variance=(0.0, 0.04, 0.01)):
    time = np.arange(200) / 50.0
    table = np.column_stack([np.cos(2 * np.pi * 3 * time), np.sin(2 * np.pi * 3 * time), np.ones(200)])
    return TimeRecord(50.0, table, ("1X", "1X", "2X-"), ("force", "displacement", "acceleration"), variance=variance)


def test_finite_spectra_are_integrals_over_the_record():
    spectra = finite_spectra(sine_record(), band=(0.2, 24.0))
    line = int(np.argmin(np.abs(spectra.frequency - 3.0)))
    assert spectra.duration == 4.0
    assert spectra.force[line, 0] == pytest.approx(2.0, abs=1e-12)  # half the duration
    assert spectra.motion[line, 0] == pytest.approx(-2.0j, abs=1e-12)
    assert np.abs(np.delete(spectra.force, line, axis=0)).max() < 1e-12
    assert spectra.orders.tolist() == [0, 2]
    assert list(map(str, spectra.outputs)) == ["1X+", "2X-"]


@pytest.mark.parametrize("decay", [0.0, 1.0])
def test_finite_spectra_noise_is_that_of_simulated_noise(decay):
    rng = np.random.default_rng(0)
    std = np.array([0.5, 0.2, 0.1])
    quantities = ("force", "displacement", "acceleration")
    found = []
    for _ in range(200):
        record = TimeRecord(50.0, std * rng.standard_normal((200, 3)), ("1X", "1X", "2X"), quantities, variance=std**2)
        spectra = finite_spectra(record, band=(1.0, 20.0), decay=decay)
        found.append(np.concatenate([np.abs(spectra.force) ** 2, np.abs(spectra.motion) ** 2], axis=1).mean(axis=0))
    stated = np.concatenate([spectra.force_variance[0], spectra.motion_variance[0]])
    # 77 lines (20 with decay) by 200 records: 0.8 % (1.6 %) standard deviation
    np.testing.assert_allclose(np.mean(found, axis=0), stated, rtol=0.06)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"inputs": ["3X"]}, "no input channel 3X"),
        ({"outputs": ["3X"]}, "no output channel 3X"),
        ({"band": (3.01, 3.02)}, "no line lies between 3.01 and 3.02 Hz; lines are 0.25 Hz apart"),
    ],
)
def test_finite_spectra_name_what_is_missing(options, words):
    with pytest.raises(InputError, match=words):
        finite_spectra(sine_record(), **options)


def test_finite_spectra_need_noise_on_the_motion():
    with pytest.raises(InputError, match=r"`motion_variance` must be above 0, got 0 of 1X\+"):
        finite_spectra(sine_record((0.1, 0.0, 0.1)))

"""Peaks of a record beside those of a model."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from structid import FrfRecord
from structid.identification.resonances import prominent, resonances

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


def test_a_smooth_record_has_none():
    record = FrfRecord(FREQUENCY, np.ones((len(FREQUENCY), 1, 1)) * (1 + 0.1j), ("1X",), ("1X",), "accelerance")
    assert resonances(record, record.values) == ()


def test_prominent_maxima_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(200):
        level = np.cumsum(rng.standard_normal(120))
        np.testing.assert_array_equal(prominent(level, 2.5), find_peaks(level, prominence=2.5)[0])

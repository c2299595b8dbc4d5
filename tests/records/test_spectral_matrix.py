"""Spectra against scipy's, the mean square they add up to, and the scatter that the random error foretells."""

import numpy as np
import pytest
from scipy.signal import csd

from structid import InputError
from structid.records import TimeRecord
from structid.records.transforms.spectral_matrix import spectral_matrix

RNG = np.random.default_rng


def record(seed, n=6000, rate=50.0):
    values = RNG(seed).standard_normal((n, 3))
    values[:, 1] += values[:, 0]
    return TimeRecord(rate, values, ("1X", "2X", "3X"), ("velocity", "velocity", "acceleration"))


@pytest.mark.parametrize("length, overlap, window", [(256, 0.5, "hann"), (255, 0.25, "hamming"), (100, 0.0, "boxcar")])
def test_spectra_agree_with_scipy(length, overlap, window):
    given = record(1)
    found = spectral_matrix(given, length, overlap, window)
    for i in range(3):
        for j in range(3):
            options = {"fs": 50.0, "window": window, "nperseg": length, "noverlap": int(overlap * length)}
            frequency, expected = csd(given.values[:, j], given.values[:, i], **options)
            assert np.allclose(found.values[:, i, j], expected, rtol=1e-10, atol=1e-14)
    assert np.allclose(found.frequency, frequency)
    assert np.allclose(found.values, np.swapaxes(found.values, 1, 2).conj(), rtol=1e-13, atol=1e-18)


def test_records_count_by_their_segments():
    """Two records are the mean of both, weighted by their segments; one shorter than a segment adds nothing."""
    a, b, short = record(1, 6000), record(2, 3000), record(3, 100)
    both = spectral_matrix([a, b, short], 200, overlap=0.0)
    parts = [spectral_matrix(one, 200, overlap=0.0) for one in (a, b)]
    assert np.allclose(both.values, (30 * parts[0].values + 15 * parts[1].values) / 45, rtol=1e-12, atol=1e-15)
    assert both.averages == pytest.approx(45)


def test_relative_error_agrees_with_scatter():
    """100 seeds: standard deviation of auto and cross spectra, mean over lines, to 6 %."""
    found = [spectral_matrix(record(seed, 4000), 128) for seed in range(100)]
    size = np.abs(np.array([one.values for one in found]))[:, 2:-2]
    scatter = (size.std(axis=0) / size.mean(axis=0)).mean(axis=0)
    truth = np.array([one.relative_error for one in found])[:, 2:-2]
    assert np.diag(scatter) == pytest.approx(np.diag(truth.mean(axis=(0, 1))), rel=0.06)
    assert scatter[0, 1] == pytest.approx(np.median(truth[..., 0, 1]), rel=0.06)
    assert np.diag(truth[0, 0]) == pytest.approx(found[0].averages ** -0.5)


def test_silent_channel_and_bad_settings():
    given = record(1)
    values = np.array(given.values)
    values[:, 2] = 0
    silent = spectral_matrix(TimeRecord(50.0, values, given.channels, given.quantities), 100)
    assert np.isinf(silent.relative_error[3, 2, 2])
    assert silent.coherence[3, 2, 0] == 0
    for settings, word in (
        ({"segment_length": 7000}, "longer than the longest record"),
        ({"segment_length": 100, "overlap": 1.0}, "`overlap`"),
        ({"segment_length": 100, "window": "nuttal"}, "`window`"),
        ({"segment_length": 100, "detrend": "mean"}, "`detrend`"),
    ):
        with pytest.raises(InputError, match=word):
            spectral_matrix(given, **settings)

"""Peaks of the singular spectra, their bands, and how many modes a band holds."""

from pathlib import Path

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes
from spectral_cases import close_pair

from structid import InputError, TimeRecord
from structid.modal import ModalOptions, identify_modes
from structid.modal.correlations import outputs
from structid.modal.spectral.fdd import fdd
from structid.modal.spectral.peaks import (
    Spectrum,
    automatic_bands,
    automatic_peaks,
    mode_places,
    peaks_by_hand,
    singular_spectrum,
)

PALISADEN = Path(__file__).parents[3] / "shared" / "data" / "palisaden_building" / "acc_20Hz_full90min.npy"


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_peak(seed):
    values = np.random.default_rng(seed).standard_normal((6000, 4))
    record = TimeRecord(20.0, values, ("1X", "2X", "3X", "4X"), ("acceleration",) * 4)
    with pytest.raises(InputError, match="no peak of the first singular value that stands out"):
        fdd(record)


def test_frequencies_near_no_peak_are_named():
    t = np.arange(1500) / 10.0
    tone = TimeRecord(10.0, np.cos(2 * np.pi * t)[:, None] * [[1.0, 2.0]], ("1X", "2X"), ("velocity",) * 2)
    with pytest.raises(InputError, match=r"`frequencies` must be near peaks .* got 0\.4 Hz; the nearest peak is at"):
        fdd(tone, ModalOptions(frequencies=[0.4], segment=50))


def test_a_spectrum_without_peaks_says_so():
    falling = np.linspace(2.0, 1.0, 20)[:, None]
    spectrum = Spectrum(np.arange(20.0), falling, np.ones((20, 1, 1), complex), 10.0, 40)
    with pytest.raises(InputError, match=r"got 5 Hz; it has no peak\. Look at the singular values"):
        peaks_by_hand(spectrum, [5.0])


def test_bands_hold_one_mode_each_where_peaks_are_apart():
    spectrum = singular_spectrum(outputs(ambient_chain(4)), 256)
    bands = automatic_bands(spectrum, automatic_peaks(spectrum).tolist())
    assert [band.n_modes for band in bands] == [1, 1, 1, 1]
    for band, f in zip(bands, chain_modes()[0] / (2 * np.pi), strict=True):
        assert band.low < f < band.high


def test_the_second_singular_value_adds_modes_that_fall_together_only():
    """A crest in the valley beside a band's only peak is no mode; a crest under a peak is one."""
    apart = singular_spectrum(outputs(ambient_chain(0)), 256)
    assert len(mode_places(apart, 2.75, 3.25, automatic_peaks(apart).tolist())) == 1
    together = singular_spectrum(outputs(close_pair(0)), 256)
    assert len(automatic_peaks(together)) == 1
    assert len(mode_places(together, 0.8, 1.2, automatic_peaks(together).tolist())) == 2


def test_palisaden_building_shows_its_three_modes():
    """Within 0.5 % of the published frequencies, automatically."""
    if not PALISADEN.exists():
        pytest.skip("the ambient record of the Palisaden building is not part of the package: shared/data is missing")
    values = np.load(PALISADEN).astype(float)
    record = TimeRecord(20.0, values, ("1X", "1Y", "2X", "2Y", "3X", "3Y"), ("acceleration",) * 6)
    found = identify_modes(record, "bayesian_fft")
    assert found.frequency[:3] == pytest.approx([1.882, 2.422, 2.687], rel=0.005)
    assert (found.frequency[3:] > 3).all()
    std = np.sqrt(np.diag(found.covariance))[:3]
    assert (std > 5e-4).all()
    assert (std < 0.005).all()

"""Peaks of the spectral matrix: a chain of known modes, and a spectrum written out."""

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes

from structid import InputError, TimeRecord
from structid.modal import HardCriteria, ModalOptions, identify_modes, modal_identification
from structid.modal.correlations import outputs
from structid.modal.spectral.peaks import singular_spectrum
from structid.similarity import mac


def test_peaks_are_the_modes_of_the_chain():
    """Frequencies within half the width of a peak of 1 % damping, one line at the least."""
    omega, shapes = chain_modes()
    found = identify_modes(ambient_chain(0, 1200.0), "fdd", frequencies=[0.56, 1.6, 2.42, 3.0], segment=1024)
    assert np.abs(found.frequency / (omega / (2 * np.pi)) - 1).max() <= 0.02
    assert np.diag(mac(found.mode_shapes, shapes)).min() >= 0.98
    assert np.isnan(found.damping_ratio).all()


def test_singular_values_hold_the_power_of_all_channels():
    """The sum over lines of the trace is the mean square of four channels scaled to 1."""
    found = singular_spectrum(outputs(ambient_chain(1)), 512)
    assert found.values.sum() * found.frequency[1] == pytest.approx(4.0, rel=0.05)
    assert np.abs(found.vectors[40].conj().T @ found.vectors[40] - np.eye(4)).max() <= 1e-12


def test_bad_settings_are_named():
    record = ambient_chain(0, 60.0)
    with pytest.raises(InputError, match="`segment` must lie from 8 to 600"):
        identify_modes(record, "fdd", frequencies=[0.5], segment=2048)
    with pytest.raises(InputError, match="`frequencies` must lie between 0 and 5 Hz"):
        modal_identification(record, "fdd", ModalOptions(frequencies=[0.0], segment=256))
    with pytest.raises(InputError, match="different peaks"):
        identify_modes(record, "fdd", frequencies=[1.59, 1.591], segment=256)


def test_peaks_stand_out_by_themselves():
    """Through the door, with the frequencies of the chain within half the line spacing of 0.039 Hz and a half."""
    found = identify_modes(ambient_chain(4), "fdd")
    assert np.abs(found.frequency - chain_modes()[0] / (2 * np.pi)).max() <= 0.03
    assert np.diag(mac(found.mode_shapes, chain_modes()[1])).min() >= 0.98
    assert found.covariance is None
    assert any("lines 0.0391 Hz apart" in note and "without covariance" in note for note in found.warnings)
    low = identify_modes(ambient_chain(4), "fdd", criteria=HardCriteria(frequency=(0.0, 2.0)))
    assert low.n_modes == 2


def test_noise_has_no_peak():
    values = np.random.default_rng(0).standard_normal((3000, 3))
    with pytest.raises(InputError, match="no peak of the first singular value that stands out of its errors"):
        identify_modes(TimeRecord(10.0, values, ("1X", "2X", "3X"), ("velocity",) * 3), "fdd")

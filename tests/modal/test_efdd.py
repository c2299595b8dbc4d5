"""Enhanced frequency domain decomposition: the window taken out exactly, spread over pieces, peaks, bad input."""

from pathlib import Path

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes
from scipy.linalg import toeplitz
from spectral_cases import close_pair

from structid import InputError, TimeRecord
from structid.modal import HardCriteria, ModalOptions, identify_modes
from structid.modal.correlations import outputs
from structid.modal.spectral.bell import Bell, bell_fit, bell_spectrum, window_correlation
from structid.modal.spectral.efdd import efdd
from structid.modal.spectral.peaks import automatic_bands, automatic_peaks, hann, mode_places, singular_spectrum
from structid.similarity import mac

PALISADEN = Path(__file__).parents[3] / "shared" / "data" / "palisaden_building" / "acc_20Hz_full90min.npy"
RATE, SEGMENT = 10.0, 256


def bell(frequency, ratio, flat=0.0, derivative=0.0):
    """The expected bell itself, as two equal segments; lines of RATE / (2 SEGMENT)."""
    lines = np.arange(20, 45) * RATE / (2 * SEGMENT)
    empty = Bell(lines, np.ones((2, len(lines))), SEGMENT, RATE, 0.0, derivative)
    values = bell_spectrum(empty, frequency, ratio, window_correlation(SEGMENT))[0]
    values = values / values.max() + flat
    return Bell(lines, np.stack([values, values]), SEGMENT, RATE, float(lines[values.argmax()]), derivative)


def test_bell_is_the_mean_spectrum_of_windowed_segments():
    """E |sum of w y e^(-i omega t)|^2 as the quadratic form of the Toeplitz matrix of correlations."""
    frequency, ratio = 0.6, 0.02
    tau, omega = np.arange(SEGMENT) / RATE, 2 * np.pi * frequency
    damped = omega * np.sqrt(1 - ratio**2)
    lags = np.exp(-ratio * omega * tau) * (np.cos(damped * tau) + ratio * omega / damped * np.sin(damped * tau))
    case = bell(frequency, ratio)
    waves = hann(SEGMENT) * np.exp(-2j * np.pi * case.frequency[:, None] * tau)
    dense = np.einsum("ks,st,kt->k", waves, toeplitz(lags), waves.conj()).real / np.sum(hann(SEGMENT) ** 2)
    found = bell_spectrum(case, frequency, ratio, window_correlation(SEGMENT))[0]
    assert np.abs(found - dense).max() <= 1e-10 * dense.max()


@pytest.mark.parametrize("derivative", [0.0, 1.0, 2.0])
def test_slopes_of_a_bell_agree_with_differences(derivative):
    case, window = bell(0.6, 0.02, derivative=derivative), window_correlation(SEGMENT)
    value, slopes = bell_spectrum(case, 0.6, 0.02, window)
    for k, (a, b) in enumerate(((1e-5, 0.0), (0.0, 1e-5))):
        up, down = (bell_spectrum(case, 0.6 * np.exp(z * a), 0.02 * np.exp(z * b), window)[0] for z in (1, -1))
        assert np.abs(slopes[k] - (up - down) / 2e-5).max() <= 1e-6 * np.abs(value).max()


@pytest.mark.parametrize("lines", [0.3, 1.0, 4.0])
def test_the_window_is_taken_out_whatever_its_width(lines):
    """Damping ratios to 1e-4, with a half-power bandwidth of 0.3, 1 and 4 line spacings of the segment."""
    ratio = lines * RATE / SEGMENT / (2 * 0.6)
    found = bell_fit(bell(0.6, ratio, flat=0.002, derivative=1.0))
    assert found.converged
    assert found.frequency == pytest.approx(0.6, rel=1e-5)
    assert found.damping_ratio == pytest.approx(ratio, rel=1e-4)


def test_changes_are_what_leaving_a_segment_out_does():
    """To first order: 15 % of the largest of twenty segments, whose effects are of the second order in 1/20."""
    rng = np.random.default_rng(0)
    mean = bell(0.6, 0.03, flat=0.002)
    spectra = mean.spectra[:1] * rng.exponential(size=(40, len(mean.frequency)))
    whole = bell_fit(Bell(mean.frequency, spectra, SEGMENT, RATE, mean.peak, 0.0))
    assert np.abs(whole.changes.sum(axis=0)).max() <= 1e-12
    left = []
    for k in range(40):
        rest = bell_fit(Bell(mean.frequency, np.delete(spectra, k, axis=0), SEGMENT, RATE, mean.peak, 0.0))
        left.append([whole.frequency - rest.frequency, whole.damping_ratio - rest.damping_ratio])
    change = whole.changes * 40 / 39
    assert (np.abs(np.array(left) - change).max(axis=0) <= 0.15 * np.abs(change).max(axis=0)).all()


def test_modes_of_the_chain_are_unbiased_and_their_spread_is_that_of_repeats():
    """Sixteen seeds, segments of 25.6 s: half-power bandwidths of 0.3 to 1.5 lines. Mean within 4 standard errors."""
    omega, shapes = chain_modes()
    truth = np.concatenate([omega / (2 * np.pi), np.full(4, 0.01)])
    errors, stds, alike, turned = [], [], [], []
    for seed in range(16):
        found = efdd(ambient_chain(seed), ModalOptions(segment=256)).modes
        assert found.n_modes == 4
        errors.append(np.concatenate([found.frequency, found.damping_ratio]) - truth)
        stds.append(np.sqrt(np.diag(found.covariance)))
        alike.append(np.diag(mac(found.mode_shapes, shapes)))
        largest = np.abs(found.mode_shapes).argmax(axis=0)
        free = found.shape_std > 1e-12
        turned.append(
            np.mean(((found.mode_shapes.real - shapes / shapes[largest, range(4)])[free] / found.shape_std[free]) ** 2)
        )
    errors, stds = np.array(errors), np.array(stds)
    scatter = errors.std(axis=0, ddof=1)
    assert (np.abs(errors.mean(axis=0)) <= 4 * scatter / 4).all()
    assert np.mean(np.square(errors / stds)) == pytest.approx(1.0, abs=0.5)
    assert np.mean(turned) == pytest.approx(1.0, abs=0.5)
    assert np.min(alike) >= 0.98


def test_segments_grow_where_bells_are_narrow():
    found = identify_modes(ambient_chain(4, 1200.0), "efdd")
    assert found.source == "enhanced frequency domain decomposition, segments of 204.8 s"
    assert found.n_modes == 4
    assert any("half-power bandwidth of the mode at 0.55" in note and "Hann window alone is 1.4" in note
               for note in found.warnings)  # fmt: skip


def test_no_covariance_says_why():
    record = ambient_chain(4)
    assert efdd(record, ModalOptions(n_pieces=0)).modes.covariance is None
    few = efdd(record, ModalOptions(segment=2048, frequencies=[1.59, 2.44])).modes
    assert few.covariance is None
    assert any("4 segments are too few for a covariance, which needs 5" in note for note in few.warnings)
    some = efdd(record, ModalOptions(segment=512, n_pieces=6)).modes
    assert any("6 pieces cannot tell how 8 numbers vary together" in note for note in some.warnings)
    assert some.covariance[0, 1] == 0.0
    assert some.covariance[0, 4] != 0.0


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_peak(seed):
    values = np.random.default_rng(seed).standard_normal((6000, 4))
    record = TimeRecord(20.0, values, ("1X", "2X", "3X", "4X"), ("acceleration",) * 4)
    with pytest.raises(InputError, match="no peak of the first singular value that stands out"):
        efdd(record)


def test_modes_outside_the_criteria_are_left_out():
    record = ambient_chain(4)
    found = identify_modes(record, "efdd", criteria=HardCriteria(frequency=(1.0, 2.7)))
    assert found.frequency == pytest.approx([1.592, 2.438], rel=0.01)
    all_four = identify_modes(record, "efdd")
    limit = float(np.sort(all_four.damping_ratio)[1:3].mean())
    few = identify_modes(record, "efdd", criteria=HardCriteria(damping_ratio=(0.0, limit)))
    np.testing.assert_array_equal(few.frequency, all_four.frequency[all_four.damping_ratio < limit])
    assert sum("does not meet `criteria`: left out" in note for note in few.warnings) == 2
    with pytest.raises(InputError, match="no peak whose mode meets `criteria`"):
        identify_modes(record, "efdd", criteria=HardCriteria(damping_ratio=(0.1, 0.2)))


def test_frequencies_near_no_peak_are_named():
    t = np.arange(1500) / 10.0
    tone = TimeRecord(10.0, np.cos(2 * np.pi * t)[:, None] * [[1.0, 2.0]], ("1X", "2X"), ("velocity",) * 2)
    with pytest.raises(InputError, match=r"`frequencies` must be near peaks .* got 0\.4 Hz; the nearest peak is at"):
        efdd(tone, ModalOptions(frequencies=[0.4], segment=50))


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
    found = identify_modes(record, "efdd")
    assert found.frequency[:3] == pytest.approx([1.882, 2.422, 2.687], rel=0.005)
    assert (found.frequency[3:] > 3).all()
    std = np.sqrt(np.diag(found.covariance))[:3]
    assert (std > 5e-4).all()
    assert (std < 0.005).all()
